"""Conditions on grasps: each against a plain check, what they say, and what they refuse."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from neuralgrasps.apply.constraint_text import parse_angle, parse_approach, parse_regions, parse_side_up
from neuralgrasps.apply.constraints import ApproachCone, GraspConstraints
from neuralgrasps.apply.regions import Ball, Side, split_surface
from neuralgrasps.errors import InputError, ShapeError, UnknownNameError
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.packed import hand_distance_many, pack_shapes
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.synthesis.contacts import TOUCH_M
from tests.apply.conftest import BoxWorld

Make = Callable[..., ObjectModel]
TALL = np.array([0.02, 0.03, 0.06])


def _allowed(world: BoxWorld, **wanted: Any) -> np.ndarray:
    g = world.grasps
    return GraspConstraints(obj=world.obj, **wanted).allows(world.hand, g.X_OH, g.q, g.q_pregrasp)


def _dense(world: BoxWorld, triangles: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(N,) distance of the grasps' hands, at joints q, to points close together on triangles."""
    points, out = np.concatenate([triangles.reshape(-1, 3), triangles.mean(axis=1)]), np.empty(len(world.grasps))
    far = np.empty(len(points))
    for n, X in enumerate(world.grasps.X_OH):
        hand_distance_many(pack_shapes(world.hand), np.array(X), np.array(q[n]), points, far)
        out[n] = far.min()
    return out


@pytest.mark.parametrize("margin", [0.0, 0.005, 0.02, 0.05])
def test_what_is_kept_free_is_far_from_the_whole_hand(box_world: BoxWorld, margin: float) -> None:
    g, region = box_world.grasps, Side("+z", 0.3)
    inside = split_surface(box_world.obj, [region]).inside
    nearest = np.minimum(_dense(box_world, inside, g.q), _dense(box_world, inside, g.q_pregrasp))
    allowed = _allowed(box_world, keep_free=(region,), margin_m=margin)
    sure = np.abs(nearest - margin) > 0.003  # the points are up to 3 mm from any other of the surface
    assert (allowed == (nearest >= margin))[sure].all() and sure.sum() >= 4


def test_a_hand_that_only_hovers_over_what_is_kept_free_is_refused(box_world: BoxWorld) -> None:
    """No contact lies in the region, and fingers reach over it all the same."""
    g, hand = box_world.grasps, box_world.hand
    reach = _dense(box_world, split_surface(box_world.obj, [Side("+z", 0.02)]).inside, g.q)
    grasp = int(np.flatnonzero(reach > 0.002)[np.argmin(reach[reach > 0.002])])
    free = (Side("+z", 0.02),)
    near = GraspConstraints(obj=box_world.obj, keep_free=free, margin_m=float(reach[grasp]) + 0.004)
    far = GraspConstraints(
        obj=box_world.obj, keep_free=free, margin_m=float(reach[grasp]) - 0.004 if reach[grasp] > 0.004 else 0
    )
    X, q = g.X_OH[[grasp]], g.q[[grasp]]
    assert not near.allows(hand, X, q)[0] and far.allows(hand, X, q)[0]
    assert near.clearance(hand, X, q)[0] == pytest.approx(reach[grasp], abs=0.003)


def test_the_hand_before_closing_keeps_clear_too(box_world: BoxWorld) -> None:
    g, hand = box_world.grasps, box_world.hand
    opened = np.tile(hand.q_open, (len(g), 1))
    rules = GraspConstraints(
        obj=box_world.obj, keep_free=tuple(Side(s, 0.01) for s in ("+x", "-x", "+y", "-y")), margin_m=0.002
    )
    shut, wide = rules.allows(hand, g.X_OH, g.q), rules.allows(hand, g.X_OH, opened)
    assert (wide & ~shut).any()  # jaws that hold the box touch its sides, open ones do not
    assert (rules.allows(hand, g.X_OH, opened, g.q) == (wide & shut)).all()


def test_only_a_region_is_touched(box_world: BoxWorld) -> None:
    g = box_world.grasps
    for region in (Side("-x", 0.6), Side("top"), Side("side", 0.1)):
        outside = split_surface(box_world.obj, [region]).outside
        nearest = _dense(box_world, outside, g.q)
        allowed = _allowed(box_world, only_region=(region,))
        assert not allowed[nearest < TOUCH_M - 1e-4].any() and allowed[nearest > TOUCH_M + 0.003].all()
    contacts = g.contact_points_O[g.contact_links >= 0]
    everywhere = tuple(Ball(tuple(p), 0.05) for p in contacts[::5])
    assert _allowed(box_world, only_region=everywhere).all()


def test_a_hand_that_touches_nothing_touches_only_there(box_world: BoxWorld) -> None:
    g = box_world.grasps
    away = np.array(g.X_OH)
    away[:, :3, 3] += 1.0
    rules = GraspConstraints(obj=box_world.obj, only_region=(Side("top", 0.1),))
    assert rules.allows(box_world.hand, away, g.q).all()


@pytest.mark.parametrize("axis", [(0, 0, -2.0), (1.0, 1.0, 0)])
def test_the_palm_comes_within_the_cone(box_world: BoxWorld, axis: tuple[float, float, float]) -> None:
    g = box_world.grasps
    comes = g.X_OH[:, :3, :3] @ box_world.hand.X_HP[:3, 2]
    off = np.arccos(np.clip(comes @ np.array(axis) / np.linalg.norm(axis), -1, 1))
    for half_angle in (0.3, 1.0, np.pi):
        allowed = _allowed(box_world, approach=ApproachCone(axis=axis, half_angle_rad=half_angle))
        assert (allowed == (off <= half_angle + 1e-9)).all()


def test_down_is_against_what_is_up(box_world: BoxWorld) -> None:
    down = parse_approach("down", "40deg")
    for side in ("+z", "-x"):
        rules = GraspConstraints(obj=box_world.obj, approach=down, side_up=side)
        assert rules.approach_O == pytest.approx(-rules.up_O) and str(rules.approach) == "world:-z within 40°"
    X_WO = np.eye(4)
    X_WO[:3, :3] = axis_angle_matrix(np.array([[0.0, 0, 1]]), np.array([np.pi / 2]))[0]
    turned = GraspConstraints(obj=box_world.obj, approach=parse_approach("world:+x", "40deg"), X_WO=X_WO)
    assert turned.approach_O == pytest.approx([0, -1, 0], abs=1e-12)


def test_the_side_that_is_up_gives_the_table(box_world: BoxWorld) -> None:
    for name, axis, half in (("+x", 0, TALL[0]), ("-z", 2, TALL[2])):
        rules = GraspConstraints(obj=box_world.obj, side_up=name)
        assert rules.support is not None
        assert abs(rules.support.plane.normal[axis]) == pytest.approx(1)
        assert rules.support.plane.offset_m == pytest.approx(half)
        g = box_world.grasps
        assert (rules.allows(box_world.hand, g.X_OH, g.q) == rules.support.allows(box_world.hand, g.X_OH, g.q)).all()
    lying = GraspConstraints(obj=box_world.obj, side_up="+x", keep_free=(Side("top", 0.1),))
    assert lying.marked(np.array([[TALL[0], 0, 0], [0, 0, TALL[2]]]))[0].tolist() == [True, False]


def _rules(world: BoxWorld) -> GraspConstraints:
    return GraspConstraints(
        obj=world.obj, keep_free=(Side("+z", 0.2),), only_region=(Side("side", 0.2),), side_up="+z",
        approach=ApproachCone(axis=(0, 0, -1), half_angle_rad=2.0), margin_m=0.01,
    )  # fmt: skip


def test_all_conditions_hold_at_once_in_any_order(box_world: BoxWorld) -> None:
    g, hand, rules = box_world.grasps, box_world.hand, _rules(box_world)
    together = rules.allows(hand, g.X_OH, g.q, g.q_pregrasp)
    each = rules.verdicts(hand, g.X_OH, g.q, g.q_pregrasp)
    assert len(each) == 4 and tuple(each) == rules.names
    assert (np.all(list(each.values()), axis=0) == together).all()
    one = [rules.allows(hand, g.X_OH[[i]], g.q[[i]], g.q_pregrasp[[i]])[0] for i in range(len(g))]
    assert together.tolist() == one
    assert len(rules.allows(hand, g.X_OH[:0], g.q[:0])) == 0


def test_it_says_which_condition_took_how_many(box_world: BoxWorld) -> None:
    g, hand = box_world.grasps, box_world.hand
    none = GraspConstraints(obj=box_world.obj, keep_free=(Side("+z", 0.9),), margin_m=0.01)
    assert none.describe(hand, g.X_OH, g.q) == (
        f"of {len(g)} candidates, 'keep +z:0.9 free by 10 mm' takes {len(g)}; 0 left"
    )
    rules = _rules(box_world)
    text = rules.describe(hand, g.X_OH, g.q, g.q_pregrasp)
    left = int(rules.allows(hand, g.X_OH, g.q, g.q_pregrasp).sum())
    assert text.startswith(f"of {len(g)} candidates") and text.endswith(f"{left} left") and "by nothing else" in text
    assert not GraspConstraints(obj=box_world.obj) and bool(rules)
    assert "no constraints" in GraspConstraints(obj=box_world.obj).describe(hand, g.X_OH, g.q)


def test_hand_and_object_moved_together_change_nothing(box_world: BoxWorld, make_object: Make) -> None:
    """The same box turned by 90 degrees in its frame, the grasps with it: other names, the same verdicts."""
    turn = np.eye(4)
    turn[:3, :3] = axis_angle_matrix(np.array([[1.0, 0, 0]]), np.array([np.pi / 2]))[0]  # y -> z, z -> -y
    lying = make_object("lying", box_mesh([TALL[0], TALL[2], TALL[1]]))
    g: GraspSet = box_world.grasps
    before = _allowed(box_world, keep_free=(Side("+z", 0.3),), margin_m=0.004)
    moved = GraspConstraints(obj=lying, keep_free=(Side("-y", 0.3),), margin_m=0.004)
    assert (moved.allows(box_world.hand, turn @ g.X_OH, g.q, g.q_pregrasp) == before).all()


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        ({"keep_free": (Side("top", 1.0),)}, "nothing is left to touch"),
        ({"keep_free": (Side("top", 0.7), Side("bottom", 0.4))}, "covers all of the surface"),
        ({"keep_free": (Side("top", 0.5),), "only_region": (Side("top", 0.4),)}, "lies in what is kept free"),
        ({"keep_free": (Ball((1.0, 0, 0), 0.1),)}, "none of the surface"),
        ({"approach": ("+z", "30deg"), "side_up": "+z"}, "through the table"),
        ({"approach": ("down", "30deg")}, "which side of the object is up"),
        ({"approach": ("world:+x", "30deg"), "side_up": "+z"}, "not vertical"),
        ({"margin_m": -1.0}, "margin_m is -1.0"),
        ({"margin_m": np.nan}, "margin_m is nan"),
        ({"side_up": "+w"}, "side '+w' is not known"),
    ],
)
def test_conditions_that_nothing_can_meet_are_named(box_world: BoxWorld, wanted: dict[str, Any], message: str) -> None:
    if "approach" in wanted:
        wanted = wanted | {"approach": parse_approach(*wanted["approach"])}
    with pytest.raises((InputError, UnknownNameError)) as caught:
        GraspConstraints(obj=box_world.obj, **wanted)
    assert message in str(caught.value)


def test_an_object_that_would_fall_over_is_named(make_object: Make) -> None:
    box = box_mesh([0.03, 0.03, 0.05])
    vertices = np.array(box.vertices)
    vertices[vertices[:, 2] > 0, :2] *= 0.02
    cone = Mesh(vertices, box.faces)
    with pytest.raises(InputError, match=r"does not rest with its -z side up.* It rests with .*\+z"):
        GraspConstraints(obj=make_object("cone", cone), side_up="-z")


def test_approaches_as_they_are_typed() -> None:
    assert parse_approach("-z", "30deg").unit.tolist() == [0, 0, -1]
    assert parse_approach(" -z", "0.5rad").half_angle_rad == 0.5
    assert parse_approach("0,0,-2", "30°").half_angle_rad == pytest.approx(np.pi / 6)
    assert parse_approach("world:0,0,1", "5deg").frame == "world" and parse_side_up("top") == "+z"
    assert [str(r) for r in parse_regions(["top", "-x:0.5"])] == ["top", "-x:0.5"]
    assert parse_angle("90deg") == pytest.approx(np.pi / 2)


@pytest.mark.parametrize(
    ("axis", "angle", "message"),
    [
        ("-z", "0deg", "holds no direction"),
        ("-z", "200deg", "at most 180"),
        ("-z", "30", "has no unit"),
        ("-z", "xdeg", "cannot be read"),
        ("z", "30deg", "Did you mean"),
        ("0,0,0", "30deg", "is no direction"),
        ("0,1", "30deg", "expected an axis x,y,z"),
    ],
)
def test_approaches_that_make_no_sense_are_named(axis: str, angle: str, message: str) -> None:
    with pytest.raises((InputError, UnknownNameError)) as caught:
        parse_approach(axis, angle)
    assert message in str(caught.value)


def test_wrong_arrays_are_named(box_world: BoxWorld) -> None:
    with pytest.raises(ShapeError, match="X_WO"):
        GraspConstraints(obj=box_world.obj, X_WO=np.eye(3))
