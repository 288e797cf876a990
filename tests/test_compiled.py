"""The package's own `njit`: entries from Python are made for what Python calls, and only for that."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from neuralgrasps.compiled import njit

_KERNELS = """
from neuralgrasps.compiled import njit

@njit(cache=True)
def double(numbers):
    return 2.0 * numbers

@njit(cache=True)
def total(numbers):
    return double(numbers).sum()
"""


@pytest.fixture
def fresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A function that imports the kernels of a file anew, as another process would."""
    path = tmp_path / "kernels_of_a_test.py"
    path.write_text(_KERNELS)

    def load() -> ModuleType:
        spec = importlib.util.spec_from_file_location(path.stem, path)
        module = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, path.stem, module)
        spec.loader.exec_module(module)
        return module

    return load


@njit
def _double(numbers):
    return 2.0 * numbers


@njit
def _total(numbers):
    return _double(numbers).sum()


@njit
def _counts_down(number):
    return 0 if number == 0 else 1 + _counts_down(number - 1)


@njit
def _down_from(number):
    return _counts_down(number)


def test_what_compiled_code_calls_gets_no_entry_until_python_calls_it():
    numbers = np.arange(4.0)
    assert _total(numbers) == 12.0
    assert len(_total.overloads) == 1 and not _total.inner.overloads
    assert len(_double.inner.overloads) == 1 and not _double.overloads
    (made,) = _double.inner.overloads.values()
    assert "cpython" not in "".join(f.name for f in made.library.get_defined_functions())
    assert np.array_equal(_double(numbers), 2.0 * numbers)
    assert len(_double.overloads) == 1


def test_what_has_an_entry_serves_compiled_code_too():
    numbers = np.arange(4.0, dtype=np.float32)
    _double(numbers)
    assert _total(numbers) == 12.0
    assert len(_double.overloads) == len(_double.inner.overloads) + 1


def test_recursion_compiles():
    assert _down_from(5) == 5 and _counts_down(3) == 3


def test_both_kinds_are_found_on_disk_again(fresh):
    numbers = np.arange(4.0)
    first = fresh()
    assert first.total(numbers) == 12.0
    second = fresh()
    assert second.total(numbers) == 12.0 and np.array_equal(second.double(numbers), 2.0 * numbers)
    assert second.total.stats.cache_hits and not second.total.stats.cache_misses
    assert second.double.stats.cache_misses  # what the first left has no entry
    third = fresh()
    third.double(numbers)
    third.double.inner.compile(third.double.signatures[0])
    for kind in (third.double, third.double.inner):
        assert kind.stats.cache_hits and not kind.stats.cache_misses


def test_code_on_disk_with_an_entry_serves_compiled_code(fresh):
    numbers = np.arange(4.0)
    fresh().double(numbers)
    again = fresh()
    assert again.total(numbers) == 12.0
    assert again.double.inner.stats.cache_hits and not again.double.inner.stats.cache_misses
