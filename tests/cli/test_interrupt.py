"""Ctrl-C and SIGTERM: the right exit code, a word on what was kept, and no processes or half files left."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

# A background job of a shell ignores SIGINT and hands that on to its children; a program at a terminal does not.
AT_A_TERMINAL = (
    "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
    "from neuralgrasps.cli.main import run; sys.exit(run())"
)


def wait_for(path: Path, seconds: float = 180.0) -> None:
    end = time.monotonic() + seconds
    while not path.exists():
        assert time.monotonic() < end, f"{path} did not appear"
        time.sleep(0.02)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_stopped_work_says_what_was_kept(number: int, code: int, home: Path, tmp_path: Path) -> None:
    folder = tmp_path / "grasps"
    pairs = ("--hands", "panda", "fetch", "--objects", "gelatin_box", "--count", "5000", "--workers", "2")
    process = subprocess.Popen(
        [sys.executable, "-c", AT_A_TERMINAL, "synthesise", *pairs, "--out-dir", str(folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "NEURALGRASPS_HOME": str(home)},
    )
    wait_for(folder / "sources.json")  # from here on it works
    time.sleep(0.5)
    os.killpg(process.pid, number)
    out, err = process.communicate(timeout=120)
    assert process.returncode == code, err
    assert f"Finished pairs are kept in '{folder}'" in err and "Traceback" not in err and out == ""
    assert [p.name for p in folder.rglob("*")] == ["sources.json"]


def test_a_stopped_demo_keeps_its_grasps(home: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    options = ("--objects", "gelatin_box", "--hands", "panda", "--count", "6", "--workers", "1", "--out", str(out))
    process = subprocess.Popen(
        [sys.executable, "-c", AT_A_TERMINAL, "demo", *options],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "NEURALGRASPS_HOME": str(home)},
    )
    wait_for(out / "grasps" / "gelatin_box" / "panda.safetensors")
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert f"Finished grasps are kept in '{out}'" in err and "Traceback" not in err
    assert not (out / "report.html").exists()
    assert [p for p in out.rglob(".*")] == []
