"""Regions of surfaces against areas worked out by hand, and hands' distances to them against dense points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from neuralgrasps.apply.constraint_text import parse_region
from neuralgrasps.apply.region_kernels import group_triangles, surface_distances
from neuralgrasps.apply.regions import Ball, Box, Points, Region, Side, split_surface
from neuralgrasps.errors import InputError, UnknownNameError
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.primitives import box_mesh, sphere_mesh
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix
from neuralgrasps.hands.extent import lowest_height
from neuralgrasps.hands.packed import hand_distance_many, pack_shapes
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.objects.object_model import ObjectModel

Make = Callable[..., ObjectModel]
HALF = np.array([0.02, 0.03, 0.06])


@pytest.fixture(scope="module")
def brick(make_object: Make) -> ObjectModel:
    return make_object("brick", box_mesh(HALF))


def _area(half: np.ndarray) -> float:
    return 8 * float(half[0] * half[1] + half[1] * half[2] + half[2] * half[0])


@pytest.mark.parametrize("name", ["+z", "-z", "top", "bottom"])
def test_a_side_is_its_face_and_a_band_below_it(brick: ObjectModel, name: str) -> None:
    x, y, z = 2 * HALF
    band = x * y + 2 * (x + y) * z * 0.25
    assert split_surface(brick, [Side(name, 0.25)]).share == pytest.approx(band / _area(HALF), rel=0.01)


def test_sides_follow_what_is_up(brick: ObjectModel) -> None:
    lying = split_surface(brick, [Side("top")], up_O=np.array([1.0, 0, 0]))
    assert lying.inside.reshape(-1, 3)[:, 0].min() == pytest.approx(HALF[0] * (1 - 2 / 3), abs=6e-4)
    middle = split_surface(brick, [Side("side", 0.25)])
    assert np.abs(middle.inside.reshape(-1, 3)[:, 2]).max() == pytest.approx(HALF[2] / 2, abs=6e-4)


def test_all_of_a_side_is_all_of_the_surface(brick: ObjectModel) -> None:
    assert split_surface(brick, [Side("top", 1.0)]).share == 1.0


def test_a_ball_takes_a_cap_of_a_sphere(make_object: Make) -> None:
    obj = make_object("ball", sphere_mesh(0.04, segments=48))
    cap = split_surface(obj, [Ball((0.0, 0.0, 0.04), 0.02)])  # a cap of chord r has the area pi r^2
    assert cap.share == pytest.approx(0.02**2 / (4 * 0.04**2), rel=0.03)


def test_a_box_and_points_take_what_is_in_them(brick: ObjectModel) -> None:
    corner = split_surface(brick, [Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))])
    assert corner.share == pytest.approx(1 / 8, rel=0.01)
    patch = split_surface(brick, [Points(np.array([[HALF[0], 0.0, 0.0], [np.nan, 0, 0]]), reach_m=0.01)])
    assert patch.share == pytest.approx(np.pi * 0.01**2 / _area(HALF), rel=0.05)
    both = split_surface(brick, [Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), Side("-z", 0.25)])
    assert both.share == pytest.approx(corner.share + split_surface(brick, [Side("-z", 0.25)]).share, rel=0.01)


@pytest.mark.parametrize("hand_name", ["fetch", "allegro"])
@pytest.mark.parametrize("region", [Side("+z", 0.3), Ball((0.02, 0.0, 0.0), 0.02)])
def test_distances_are_those_of_dense_points(brick: ObjectModel, hand_name: str, region: Region) -> None:
    hand, surface = load_hand(hand_name), split_surface(brick, [region])
    packed, rng = pack_shapes(hand), np.random.default_rng(3)
    X_OH = np.tile(np.eye(4), (6, 1, 1))
    for X in X_OH:
        X[:3, :3] = axis_angle_matrix(rng.normal(size=(1, 3)), np.array([rng.uniform(0, 3)]))[0]
        X[:3, 3] = rng.normal(size=3) * 0.1
    q = rng.uniform(hand.tree.lower, hand.tree.upper, size=(6, hand.num_dofs))
    found = surface_distances(packed, surface.inside_groups, X_OH, q)
    points = np.concatenate([surface.inside.reshape(-1, 3), surface.inside.mean(axis=1)])
    dense = np.empty((6, len(points)))
    for n in range(6):
        hand_distance_many(packed, X_OH[n], q[n], points, dense[n])
    outside = dense.min(axis=1) > 0.002  # a hand that cuts through is as deep as any point tells
    assert outside.sum() >= 2
    assert (found <= dense.min(axis=1) + 1e-4).all()  # `within`
    assert (found[outside] >= dense.min(axis=1)[outside] - 0.003).all()  # points are up to 3 mm from any other
    capped = surface_distances(packed, surface.inside_groups, X_OH, q, most=0.01, enough=0.01)
    assert ((capped >= 0.01) == (found >= 0.01)).all()


def test_a_large_triangle_is_as_near_as_its_nearest_point() -> None:
    """A hand above the middle of a tilted plane: the support function of its parts has the distance exactly."""
    hand, normal = load_hand("panda"), np.array([0.2, 0.1, 1.0]) / np.linalg.norm([0.2, 0.1, 1.0])
    plane = Plane(normal, 0.2)
    flat = np.array([[-2.0, -2], [2, -2], [0, 3]])
    wide = np.column_stack([flat, -(flat @ normal[:2] + 0.2) / normal[2]])[None]
    X_OH, q = np.eye(4)[None], hand.q_open[None]
    found = surface_distances(pack_shapes(hand), group_triangles(wide, size=1.0), X_OH, q)
    assert found[0] == pytest.approx(lowest_height(hand, X_OH, q, plane)[0], abs=1.1e-4)


def test_no_surface_is_infinitely_far() -> None:
    hand = load_hand("panda")
    nothing = group_triangles(np.zeros((0, 3, 3)), size=0.01)
    assert surface_distances(pack_shapes(hand), nothing, np.eye(4)[None], hand.q_open[None])[0] == np.inf


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("topp", "Did you mean 'top'"),
        ("top:0", "share is 0"),
        ("top:2", "share is 2"),
        ("top:", "cannot be read"),
        ("box:0,0,0,0,1,1", "x goes from 0 to 0"),
        ("box:0,0,0,1,1", "expected box:x0,y0,z0,x1,y1,z1"),
        ("box:0,0,0,1,1,nan", "not finite"),
        ("sphere:0,0,0,0", "radius is 0"),
        ("sphere:0,0,0,x", "expected sphere:x,y,z,r"),
        ("file:", "names no file"),
        ("file:nowhere.ply", "does not exist"),
    ],
)
def test_regions_that_make_no_sense_are_named(text: str, message: str) -> None:
    with pytest.raises((InputError, UnknownNameError)) as caught:
        parse_region(text)
    assert message in str(caught.value)


def test_a_region_beside_the_object_is_named(brick: ObjectModel) -> None:
    with pytest.raises(InputError, match=r"none of the surface .*-60\] to \[20, 30, 60\] mm"):
        split_surface(brick, [Side("top"), Ball((1.0, 0.0, 0.0), 0.1)])
    with pytest.raises(InputError, match="no finite point"):
        Points(np.full((3, 3), np.nan))


def test_a_small_region_in_the_middle_of_a_face_is_found(brick: ObjectModel) -> None:
    assert split_surface(brick, [Ball((HALF[0], 0.0101, 0.0203), 0.003)]).share > 0


def test_regions_are_named_as_they_are_typed() -> None:
    for text in ("top", "-z:0.2", "box:0,0,0,0.1,0.2,0.3", "sphere:0,0,0.1,0.02"):
        assert str(parse_region(text)) == text
