"""What importing a module loads: workers start in a second, because they load no torch."""

from __future__ import annotations

import subprocess
import sys

import pytest

WORKERS = (
    "neuralgrasps.synthesis.synthesise",
    "neuralgrasps.sim.grasp_trial",
    "neuralgrasps.dataset.collect",
    "neuralgrasps.dataset.shards",
    "neuralgrasps.hands.zoo",
    "neuralgrasps.objects.zoo",
)


def loaded_by(statement: str, names: tuple[str, ...]) -> set[str]:
    """Which of `names` a new process has loaded after `statement`."""
    code = f"import sys\n{statement}\nprint(*(n for n in {names!r} if n in sys.modules))"
    return set(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split())


def test_workers_load_no_torch():
    assert loaded_by("\n".join(f"import {module}" for module in WORKERS), ("numpy", "torch")) == {"numpy"}


def test_the_package_itself_loads_nothing_heavy():
    heavy = ("torch", "numpy", "numba", "scipy", "mujoco", "trimesh", "tyro")
    assert loaded_by("import neuralgrasps", heavy) == set()
    assert loaded_by("import neuralgrasps.cli.main", ("torch", "mujoco", "numba")) == set()


@pytest.mark.parametrize("name", ["load_hand", "GraspSet", "synthesise"])
def test_public_names_come_when_asked_for(name):
    assert loaded_by(f"from neuralgrasps import {name}", ("torch", "numpy")) == {"numpy"}
