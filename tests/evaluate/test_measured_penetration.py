"""Overlap measured against the mesh itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.evaluate.grasps import measured_penetration
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.grasps.grasp_set import GraspSet, empty_grasps
from neuralgrasps.hands.hand import ConvexPart, PartKind
from neuralgrasps.hands.zoo import load_hand

HALF = np.array([0.02, 0.03, 0.05])


@pytest.fixture(scope="module")
def hand():
    return load_hand("panda")


@pytest.fixture(scope="module")
def box(make_object):
    return make_object("box", box_mesh(HALF), cells=40)


def _grasps(hand, joints) -> GraspSet:
    """The pads' middle at the box's middle, the jaw closed to `joints`."""
    X_OP = np.eye(4)
    X_OP[:3, :3] = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]).T  # closes along x, approaches along y
    X_HP = hand.X_HP.copy()
    X_HP[:3, 3] = hand.jaw_pad_H
    q = np.array(joints, float)[:, None]
    count = len(q)
    return GraspSet(
        hand=hand.name, object="box",
        X_OH=np.repeat((X_OP @ np.linalg.inv(X_HP))[None], count, 0), q=q, q_pregrasp=q, q_squeeze=q,
        contact_points_O=np.zeros((count, 0, 3)), contact_normals_O=np.zeros((count, 0, 3)),
        contact_links=np.zeros((count, 0), np.int32), epsilon=np.zeros(count), penetration_m=np.zeros(count),
    )  # fmt: skip


def test_pads_pushed_past_contact_overlap_by_the_push(hand, box):
    # one jaw joint of the panda is half the opening: at 20 mm the pads touch the 40 mm box
    depth = measured_penetration(hand, box, _grasps(hand, [0.03, 0.0202, 0.019, 0.017, 0.014]))
    assert depth[0] == 0.0 and depth[1] == 0.0
    np.testing.assert_allclose(depth[2:], [0.001, 0.003, 0.006], atol=1e-4)


def test_the_answer_does_not_depend_on_the_batch(hand, box):
    grasps = _grasps(hand, np.linspace(0.012, 0.03, 150))
    all_at_once = measured_penetration(hand, box, grasps, spacing=0.006)
    one_by_one = np.concatenate(
        [measured_penetration(hand, box, grasps[i : i + 10], spacing=0.006) for i in range(0, 150, 10)]
    )
    np.testing.assert_array_equal(all_at_once, one_by_one)


def test_no_grasps_have_no_overlap(hand, box):
    assert measured_penetration(hand, box, empty_grasps(hand.name, "box", num_joints=1)).shape == (0,)


def test_the_grid_is_not_what_is_measured(hand, box):
    coarse = replace(box, sdf=replace(box.sdf, values=box.sdf.values + 0.002))  # a grid that is 2 mm off
    exact = measured_penetration(hand, box, _grasps(hand, [0.017]))
    assert measured_penetration(hand, coarse, _grasps(hand, [0.017])) == pytest.approx(exact)


@pytest.mark.parametrize("spacing", [0.002, 0.004])
def test_an_edge_that_cuts_into_a_flat_link_between_its_points_is_found(make_object, spacing):
    """A box stands on its edge in a 40 x 40 mm plate, 1.5 mm deep: no plate point and no face point is that deep."""
    panda = load_hand("panda")
    plate = ConvexPart(link=0, kind=PartKind.BOX, size=np.array([0.02, 0.02, 0.005]), X_LP=np.eye(4))
    hand = replace(panda, parts=(plate,))
    obj = make_object("box", box_mesh([0.01, 0.01, 0.015]), cells=60)
    X_OH = np.eye(4)  # the plate's z along the box's diagonal in x and z, its y along the edge
    side = np.sqrt(0.5)
    X_OH[:3, :3] = np.array([[side, 0, side], [0, 1, 0], [-side, 0, side]])
    corner = np.array([0.01, 0.0, 0.015])
    X_OH[:3, 3] = corner + X_OH[:3, 2] * (0.005 - 0.0015)
    grasps = _grasps(hand, [0.02])
    grasps = replace(grasps, X_OH=X_OH[None])
    assert measured_penetration(hand, obj, grasps, spacing=spacing) == pytest.approx(0.0015, abs=1e-9)


def test_points_of_the_object_alone_can_find_the_overlap(make_object):
    """A pin stands in the middle of a plate, far from the plate's edges and thinner than the spacing of its points."""
    panda = load_hand("panda")
    plate = ConvexPart(link=0, kind=PartKind.BOX, size=np.array([0.02, 0.02, 0.005]), X_LP=np.eye(4))
    hand, pin = replace(panda, parts=(plate,)), make_object("box", box_mesh([0.0004, 0.0004, 0.02]), cells=60)
    X_OH = np.eye(4)
    X_OH[:3, 3] = 0.0007, 0.0003, -0.025 + 0.002
    grasps = replace(_grasps(hand, [0.02]), X_OH=X_OH[None])
    assert measured_penetration(hand, pin, grasps) == pytest.approx(0.002, abs=1e-9)
