"""Reasons for too few grasps: the sizes they quote are right, and each obstacle is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.geometry.primitives import box_mesh, sphere_mesh
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.synthesis.candidates import OUTCOMES, GraspProblem
from neuralgrasps.synthesis.feasibility import (
    KINDS,
    TOO_SMALL,
    TOO_THIN,
    TOO_WIDE,
    grip_widths,
    hand_span,
    shortfall_kind,
    why_short,
)
from neuralgrasps.synthesis.synthesise import SynthesisConfig, synthesise

ProblemOf = Callable[[str, str], GraspProblem]
MakeObject = Callable[..., ObjectModel]


def _why(problem: GraspProblem, *, tried: int = 0, held: int = 0, by_kind: bool = False, **outcomes: int):
    counts = {name: outcomes.get(name.replace(" ", "_").replace("-", "_"), 0) for name in OUTCOMES}
    return why_short(
        problem, outcomes=counts, tried=tried, held=held, missing="7 grasps", other_kind=2, by_kind=by_kind, rounds=3,
        protocol="dexgraspbench",
    )  # fmt: skip


def test_widths_of_a_box_are_its_sides(solids: dict[str, ObjectModel]) -> None:
    widths = grip_widths(solids["box"], 0.3) * 1e3  # 40 x 60 x 100 mm
    assert widths[0] == pytest.approx(40, abs=0.7) and (np.diff(widths) >= 0).all()
    sides = np.array([40, 60, 100])
    leaning = widths / np.array([side for side in sides])[:, None]
    # a ray in the friction cone is longer than the side it crosses by at most 1 / cos(atan(0.3))
    assert ((leaning > 0.98) & (leaning < 1.06)).any(axis=0).all()
    for side in sides:
        assert np.isclose(widths, side, rtol=0.01).any()


def test_widths_do_not_depend_on_where_the_object_lies(make_object: MakeObject) -> None:
    X = np.eye(4)
    X[:3, 3] = (0.4, -0.2, 1.0)
    mesh = box_mesh([0.02, 0.03, 0.05])
    a, b = (grip_widths(make_object("b", m), 0.3)[0] for m in (mesh, mesh.transformed(X)))
    assert a == pytest.approx(b, abs=5e-4)


def test_spans_of_known_hands(hands: dict[str, Hand], problem_of: ProblemOf) -> None:
    assert hand_span(hands["panda"], problem_of("panda", "ball")) == pytest.approx(0.08)
    # Barrett BH8-282: 33 cm from tip to tip with the fingers straight; Allegro: thumb to finger about 22 cm
    for name, low, high in (("barrett", 0.24, 0.34), ("allegro", 0.18, 0.26), ("human", 0.15, 0.23)):
        assert low < hand_span(hands[name], problem_of(name, "ball")) < high, name


def test_wide_objects_quote_width_and_aperture(problem_of: ProblemOf) -> None:
    found = _why(problem_of("panda", "cube"))
    assert str(found) == "too wide: narrowest graspable width 300 mm, aperture 80 mm"
    assert _why(problem_of("panda", "box")).kind == "no room"  # 40 mm one way, 100 mm another: not too wide
    assert "fingers span" in _why(problem_of("allegro", "cube"), few_contacts=900).clause


@pytest.mark.parametrize(
    ("counts", "kind", "says"),
    [
        ({"collides": 90, "few_contacts": 10}, "no room", "90 of 100 closed hands hit the object"),
        ({"no_force_closure": 80, "penetrates": 1}, "no force closure", "80 of 81"),
        ({"penetrates": 5}, "overlaps", "5 of 5"),
        ({"few_contacts": 5}, "few contacts", "fewer than two links"),
        ({}, "no room", "no open hand comes near"),
        ({"valid": 5}, "overlaps", "none of 5"),
        ({"valid": 5, "by_kind": True}, "few of a kind", "7 grasps missing after 3 rounds; of 5 valid"),
        ({"valid": 5, "by_kind": True, "tried": 10, "held": 3}, "slips", "7 of 10 slipped under 'dexgraspbench'"),
        ({"valid": 5, "tried": 10, "held": 3}, "slips", "7 of 10 slipped under 'dexgraspbench'"),
        ({"valid": 5, "collides": 95, "tried": 4, "held": 3}, "rare", "5 of 100 closed hands"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_each_obstacle_is_named(problem_of: ProblemOf, counts: dict[str, int], kind: str, says: str) -> None:
    found = _why(problem_of("barrett", "box"), **counts)
    assert found.kind == kind and says in found.clause
    assert shortfall_kind(str(found)) == kind


def test_small_and_thin_objects(problem_of: ProblemOf, make_object: MakeObject) -> None:
    ball, plate = make_object("pearl", sphere_mesh(0.003), cells=8), make_object("sheet", box_mesh([0.1, 0.08, 0.0005]))
    pearl = replace(problem_of("human", "ball"), obj=ball)
    found = _why(pearl, few_contacts=50)
    assert found.kind == TOO_SMALL and "largest side 6 mm" in found.clause
    sheet = replace(problem_of("panda", "ball"), obj=plate)
    found = _why(sheet)
    assert found.kind == TOO_THIN and found.clause.startswith("1.0 mm")


def test_only_a_kind_is_taken_out_of_a_reason() -> None:
    assert [shortfall_kind(f"{kind}: because") for kind in KINDS] == list(KINDS)
    assert shortfall_kind("") == shortfall_kind("an older file: none") == ""


def test_synthesis_gives_the_reason(hands: dict[str, Hand], solids: dict[str, ObjectModel]) -> None:
    found = synthesise(hands["panda"], solids["cube"], config=SynthesisConfig(count=2, max_rounds=1))
    assert not found.converged and len(found.grasps) == 0
    assert shortfall_kind(found.reason) == TOO_WIDE
