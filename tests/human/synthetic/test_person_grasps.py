"""Grasps of people: held in physics, clear of the table, with an arm that a person could have."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.mesh import box_mesh, signed_distance
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.hands.extent import lowest_height
from neuralgrasps.hands.variants import scaled_hand
from neuralgrasps.human.forearm import ForearmSize, WristAxes, forearm_directions, is_clear, tapered_mesh
from neuralgrasps.human.skeleton import human_hand, joint_points
from neuralgrasps.human.synthetic.hand_path import find_path
from neuralgrasps.human.synthetic.person_grasps import person_grasps, table_frame
from neuralgrasps.objects.cache import home_folder
from neuralgrasps.planning.grasp_cache import forget

SCALE = 0.8
STANDING = Plane(np.array([0.0, 0.0, 1.0]), 0.05)


@pytest.fixture(scope="module")
def brick(make_object):
    return make_object("brick", box_mesh([0.022, 0.035, 0.05]))


@pytest.fixture(scope="module")
def people(brick):
    return person_grasps(brick, scale=SCALE, side="left", plane_O=STANDING)


def test_every_grasp_held_and_clears_the_table_closed_and_open(people):
    grasps = people.grasps
    assert len(grasps) >= 6 and people.reason == "" and grasps.protocol == "dexgraspbench"
    assert grasps.validated.all()
    for q in (grasps.q, grasps.q_pregrasp):
        assert (lowest_height(people.hand, grasps.X_OH, q, STANDING) > 0.0).all()


def test_the_forearm_is_clear_of_the_object_and_the_table_and_bent_as_a_wrist_bends(people, brick):
    size, axes = ForearmSize.of(SCALE), WristAxes.of(people.hand)
    X_WO = table_frame(STANDING)
    for X_OH, forearm_H in zip(people.grasps.X_OH, people.forearm_H, strict=True):
        assert np.linalg.norm(forearm_H) == pytest.approx(1.0)
        extension = np.degrees(np.arctan2(forearm_H @ axes.back, forearm_H @ axes.out))
        assert -46 < extension < 59 and -0.5 < forearm_H @ axes.thumb < 0.3
        X_WH = X_WO @ X_OH
        wrist, out = X_WH[:3, 3], X_WH[:3, :3] @ forearm_H
        start, end = wrist + 0.02 * out, wrist + size.length_m * out
        surface = tapered_mesh(start, end, float(size.radius(np.array(0.02))), size.elbow_m).vertices
        beyond = surface[(surface - start) @ out > 0.0]  # before it the forearm is inside the hand
        assert beyond[:, 2].min() > -0.02 and end[2] > size.elbow_m
        X_OW = np.linalg.inv(X_WO)
        assert signed_distance(brick.mesh, beyond @ X_OW[:3, :3].T + X_OW[:3, 3]).min() > 0.0


def test_a_left_hand_is_a_left_hand(people):
    joints = joint_points(people.hand, np.eye(4), people.hand.q_open)
    fingers, thumb, palm = joints[9] - joints[0], joints[4] - joints[0], people.hand.X_HP[:3, 2]
    assert np.cross(fingers, palm) @ thumb < 0.0  # palm towards you, fingers up: the thumb is on your left
    right = joint_points(human_hand("right"), np.eye(4), people.hand.q_open)
    assert np.cross(right[9], human_hand("right").X_HP[:3, 2]) @ right[4] > 0.0


def test_made_once_and_kept(people, brick):
    kept = sorted((home_folder() / "cache").rglob("*.safetensors"))
    forget()
    again = person_grasps(brick, scale=SCALE, side="left", plane_O=STANDING)
    np.testing.assert_array_equal(again.grasps.X_OH, people.grasps.X_OH)
    np.testing.assert_array_equal(again.forearm_H, people.forearm_H)
    assert sorted((home_folder() / "cache").rglob("*.safetensors")) == kept


def test_an_object_too_wide_for_the_hand_says_so(make_object):
    slab = make_object("slab", box_mesh([0.12, 0.13, 0.02]))
    found = person_grasps(slab, scale=0.7, plane_O=Plane(np.array([0.0, 0.0, 1.0]), 0.02))
    assert len(found.grasps) == 0 and "too wide" in found.reason


def test_sizes_that_no_person_has_are_refused(brick):
    with pytest.raises(InputError, match=r"0\.66"):
        person_grasps(brick, scale=1.0, plane_O=STANDING)


def test_the_wrist_bends_back_where_the_hand_is_low():
    """A flat hand just above the table leaves no room for a level forearm; high above it, the easiest one rises."""
    hand, nothing = scaled_hand(human_hand(), SCALE), np.full((1, 3), 9.0)
    axes, X = WristAxes.of(hand), np.tile(np.eye(4), (2, 1, 1))
    X[:, :3, :3] = np.stack([axes.out, np.cross(axes.back, axes.out), axes.back])  # the back of the hand up
    X[:, 2, 3] = [0.02, 0.5]
    direction_H, effort = forearm_directions(hand, X, nothing, scale=SCALE)
    slope = np.degrees(np.arcsin(direction_H @ axes.back))
    assert slope[0] > 5 and 10 < slope[1] < 40 and (effort < 3).all()


def test_no_forearm_fits_a_hand_whose_thumb_points_down():
    hand, nothing = scaled_hand(human_hand(), SCALE), np.full((1, 3), 9.0)
    axes, X = WristAxes.of(hand), np.eye(4)
    X[:3, :3] = np.stack([axes.out, np.cross(-axes.thumb, axes.out), -axes.thumb])
    X[2, 3] = 0.3
    assert np.isinf(forearm_directions(hand, X[None], nothing, scale=SCALE)[1]).all()
    X[:3, :3] = np.stack([axes.out, np.cross(axes.thumb, axes.out), axes.thumb])
    assert np.isfinite(forearm_directions(hand, X[None], nothing, scale=SCALE)[1]).all()


def test_a_forearm_is_clear_by_its_radius():
    size, wrist, along = ForearmSize.of(SCALE), np.array([0.0, 0.0, 0.3]), np.array([1.0, 0.0, 0.0])
    radius = float(size.radius(np.array(0.1)))
    assert radius == pytest.approx(0.0236 + 0.1 / 0.27 * 0.0172)
    for gap, clear in ((0.002, False), (0.006, True)):
        beside = np.array([[0.1, radius + gap, 0.3]])
        assert is_clear(wrist, along, beside, size) is clear
    nothing = np.full((1, 3), 9.0)
    for height, clear in ((size.elbow_m + 0.004, False), (size.elbow_m + 0.008, True)):
        assert is_clear(np.array([0.0, 0.0, height]), along, nothing, size) is clear


@pytest.mark.parametrize(("aside", "found"), [(0.0, False), (0.6, False), (1.5, True)])  # in it, fingers in it, off it
def test_no_way_leads_through_an_object(make_object, aside, found):
    hand, block = scaled_hand(human_hand(), SCALE), make_object("block", box_mesh([0.5, 0.5, 0.2]))
    axes, X_WO, X_WH = WristAxes.of(hand), np.eye(4), np.eye(4)
    X_WO[2, 3] = 0.2
    X_WH[:3, :3] = np.stack([axes.out, np.cross(axes.back, axes.out), axes.back])
    X_WH[:3, 3] = [aside, 0.0, 0.2]
    rng = np.random.default_rng(0)
    path = find_path(hand, block, X_WO, X_WH, hand.preshape_upper, axes.out, scale=SCALE, rng=rng)
    assert (path is not None) == found
    if path is not None:
        np.testing.assert_allclose(path.poses(np.zeros(1))[0], X_WH, atol=1e-12)
        np.testing.assert_array_equal(path.joints(np.ones(1))[0], hand.preshape_upper)
        assert path.poses(np.ones(1))[0, 2, 3] > 0.25
