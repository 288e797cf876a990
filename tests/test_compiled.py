"""Compiled code on disk: used again, and dropped when what it names has moved."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

_MODULE = """
from typing import NamedTuple
import numpy as np
from neuralgrasps.compiled import njit

class {name}(NamedTuple):
    values: np.ndarray

@njit(cache=True)
def total(pair):
    return pair.values.sum()

print(total({name}(np.arange(4.0))), sum(total.stats.cache_hits.values()))
"""


def _run(folder: Path, name: str) -> str:
    (folder / "kernels.py").write_text(_MODULE.format(name=name))
    done = subprocess.run(
        [sys.executable, "-c", "import kernels"], cwd=folder, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_code_is_kept_and_dropped_when_a_type_it_names_is_gone(tmp_path: Path) -> None:
    assert _run(tmp_path, "Pair") == "6.0 0"
    assert _run(tmp_path, "Pair") == "6.0 1"
    assert _run(tmp_path, "Sum") == "6.0 0"  # numba alone: AttributeError, there is no kernels.Pair
    assert _run(tmp_path, "Sum") == "6.0 1"
