"""What a benchmark says about the machine. The demo it runs is tested where the demo is."""

from __future__ import annotations

from neuralgrasps.cli.bench import import_seconds, machine


def test_machine_and_import_time() -> None:
    found = machine()
    assert found["cores"] >= 1 and found["memory_gb"] > 0 and found["python"].count(".") == 2
    assert 0 < import_seconds() < 10
