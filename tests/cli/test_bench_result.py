"""What benchmarks share: options over their defaults, conditions, and absent figures."""

from __future__ import annotations

import io
from dataclasses import dataclass, replace

import pytest

from neuralgrasps.cli.bench_result import absent_figures, conditions, with_options
from neuralgrasps.cli.terminal import Terminal, open_terminal
from neuralgrasps.geometry.primitives import box_mesh


@dataclass(frozen=True)
class Config:
    scenes: int = 20
    seed: int = 0


@pytest.fixture
def printed() -> io.StringIO:
    return io.StringIO()


@pytest.fixture
def terminal(printed: io.StringIO) -> Terminal:
    return open_terminal("bench", json_to_stdout=False, stdout=printed, stderr=io.StringIO())


def test_options_that_were_not_given_leave_the_default():
    assert with_options(Config(), seed=3, scenes=None) == Config(scenes=20, seed=3)
    assert with_options(Config(seed=5), seed=0, scenes=7) == Config(scenes=7, seed=0)


def test_conditions_say_config_processes_and_where_objects_are_from(make_object, monkeypatch):
    monkeypatch.setattr("neuralgrasps.parallel.available_cpus", lambda: 6)
    brick = make_object("brick", box_mesh([0.02, 0.02, 0.02]))
    objects = {"brick": replace(brick, provenance={"source": "brick.ply"}), "bare": replace(brick, provenance={})}
    said = conditions(Config(seed=2), objects, quick=True, workers=None, run="ycb7")
    assert said == {
        "scenes": 20, "seed": 2, "quick": True, "workers": 6, "run": "ycb7",
        "objects": {"brick": "brick.ply", "bare": ""},
    }  # fmt: skip
    assert conditions(Config(), {}, quick=False, workers=2)["workers"] == 2


def test_absent_figures_have_their_reason_and_are_printed_once_for_each(terminal, printed):
    reasons = {"contact": "no run", "extra": "no run"}
    absent = absent_figures(terminal, {"ours": 1.0}, ("ours", "contact", "far", "near"), reasons)
    assert absent == {"contact": "no run", "extra": "no run", "far": "not measured", "near": "not measured"}
    assert printed.getvalue().splitlines() == ["absent: contact, extra: no run", "absent: far, near: not measured"]
    assert absent_figures(terminal, {"ours": 1.0}, ("ours",), {}) == {}
