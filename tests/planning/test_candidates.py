"""Which grasps a scene rules out, and the order of the others, against numbers worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.geometry.se3_numpy import inverse_np, rpy_matrix
from neuralgrasps.grasps.grasp_set import GraspSet, Verdict
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.parts import part_mesh
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.planning.candidates import gravity_lever, rank_candidates
from neuralgrasps.planning.world import BoxObstacle, PlacedObject, PlanningWorld, box_distance, table_box

HEIGHT = 0.5  # of the table


@pytest.fixture(scope="module")
def robot(make_robot) -> Manipulator:
    return make_robot("fetch")


@pytest.fixture(scope="module")
def bar(make_object):
    """40 x 60 x 100 mm, its frame in its middle."""
    return make_object("bar", box_mesh([0.02, 0.03, 0.05]))


def hand_frame(hand: Hand, X_pad: np.ndarray) -> np.ndarray:
    """X_OH of a jaw whose pads' middle is at X_pad (4, 4): its x along the closing direction, its z the approach."""
    X_HG = hand.X_HP.copy()
    X_HG[:3, 3] = hand.jaw_pad_H
    return X_pad @ inverse_np(X_HG)


def pad_frame(*, closing: np.ndarray, approach: np.ndarray, at: np.ndarray) -> np.ndarray:
    X = np.eye(4)
    X[:3, 0], X[:3, 1], X[:3, 2], X[:3, 3] = closing, np.cross(approach, closing), approach, at
    return X


X, Y, Z = np.eye(3)


def grasps_of(hand: Hand, obj, pads: list[np.ndarray], *, opening: list[float] | None = None) -> GraspSet:
    """Jaw grasps at pad frames; `opening` of the jaw at each, 0 to 1."""
    count = len(pads)
    share = np.array([0.5] * count if opening is None else opening)[:, None]
    closed = np.where(hand.closing_rate < 0, hand.tree.lower, hand.tree.upper)
    q = closed + share * (hand.q_open - closed)
    none = np.zeros((count, 0, 3))
    return GraspSet(
        hand=hand.name, object=obj.name, X_OH=np.stack([hand_frame(hand, p) for p in pads]), q=q, q_pregrasp=q,
        q_squeeze=q, contact_points_O=none, contact_normals_O=none, contact_links=np.zeros((count, 0), np.int32),
        epsilon=np.zeros(count), penetration_m=np.zeros(count),
    )  # fmt: skip


def standing(obj, *, x: float = 0.7, y: float = 0.0, lift: float = 0.0) -> PlacedObject:
    X_BO = np.eye(4)
    X_BO[:3, 3] = [x, y, HEIGHT - obj.mesh.bounds[0, 2] + lift]
    return PlacedObject(obj=obj, X_BO=X_BO)


def world_of(target: PlacedObject, **more) -> PlanningWorld:
    return PlanningWorld(boxes=(table_box(HEIGHT, centre=(0.7, 0.0), size=(0.8, 0.8)),), target=target, **more)


def from_above(dz: float = 0.0) -> np.ndarray:
    return pad_frame(closing=X, approach=-Z, at=np.array([0.0, 0.0, dz]))


def lowest(hand: Hand, X_BH: np.ndarray, q: np.ndarray) -> float:
    X_BL = X_BH @ forward_numpy(hand.tree, q)
    return min(float(part_mesh(p).transformed(X_BL[p.link]).vertices[:, 2].min()) for p in hand.parts)


def test_what_a_jaw_can_hardly_span_is_dropped(robot, bar) -> None:
    grasps = grasps_of(robot.hand, bar, [from_above(0.03)] * 4, opening=[0.5, 0.969, 0.971, 1.0])
    ranked = rank_candidates(robot, grasps, world_of(standing(bar)), clearance_m=0.004)
    assert sorted(ranked.index) == [0, 1]
    assert ranked.dropped["too wide for the jaw"] == 2 and ranked.dropped["hand hits what is around"] == 0
    assert ranked.index[0] == 0  # more room beside the object


def test_width_is_no_matter_for_other_hands(make_object, bar, box_of_allegro) -> None:
    robot, grasps = box_of_allegro
    ranked = rank_candidates(robot, grasps, world_of(standing(bar)), clearance_m=0.004)
    assert ranked.dropped["too wide for the jaw"] == 0 and len(ranked.index) == len(grasps)


@pytest.fixture(scope="module")
def box_of_allegro(bar) -> tuple[Manipulator, GraspSet]:
    from neuralgrasps.arms.mount import mount  # noqa: PLC0415
    from neuralgrasps.arms.zoo import load_arm  # noqa: PLC0415

    hand = load_hand("allegro")
    X_OP = pad_frame(closing=X, approach=-Z, at=np.array([0.0, 0.0, 0.2]))
    none = np.zeros((1, 0, 3))
    grasps = GraspSet(
        hand=hand.name, object=bar.name, X_OH=(X_OP @ inverse_np(hand.X_HP))[None], q=hand.q_open[None],
        q_pregrasp=hand.q_open[None], q_squeeze=hand.q_open[None], contact_points_O=none, contact_normals_O=none,
        contact_links=np.zeros((1, 0), np.int32), epsilon=np.zeros(1), penetration_m=np.zeros(1),
    )  # fmt: skip
    return mount(load_arm("panda"), hand), grasps


@pytest.mark.parametrize("dz", [0.03, 0.0, -0.02])
def test_clearance_is_that_of_the_lowest_point(robot, bar, dz: float) -> None:
    """Points 12 mm apart see edges exactly, and the table is level: nothing is lost between them."""
    target, grasps = standing(bar), grasps_of(robot.hand, bar, [from_above(dz)])
    ranked = rank_candidates(robot, grasps, world_of(target), clearance_m=-1.0)
    height = lowest(robot.hand, target.X_BO @ grasps.X_OH[0], grasps.q[0]) - HEIGHT
    assert ranked.clearance_m[0] == pytest.approx(height, abs=0.002)


def test_a_hand_in_the_table_or_a_neighbour_is_dropped(robot, bar) -> None:
    target = standing(bar)
    grasps = grasps_of(robot.hand, bar, [from_above(0.03), from_above(-0.06)])
    alone = rank_candidates(robot, grasps, world_of(target), clearance_m=0.004)
    assert list(alone.index) == [0] and alone.dropped["hand hits what is around"] == 1
    beside = standing(bar, x=target.X_BO[0, 3] + 0.055)  # where the finger is
    both = rank_candidates(robot, grasps, world_of(target, objects=(beside,)), clearance_m=0.004)
    assert len(both.index) == 0 and both.dropped["hand hits what is around"] == 2
    far = standing(bar, y=0.3)
    assert list(rank_candidates(robot, grasps, world_of(target, objects=(far,)), clearance_m=0.004).index) == [0]


def test_the_open_hand_counts_too(robot, bar) -> None:
    """The closed jaw clears a post that the open one, from which it closes, does not."""
    target = standing(bar)
    grasps = grasps_of(robot.hand, bar, [from_above(0.03)], opening=[0.4])
    wide = replace(grasps, q_pregrasp=robot.hand.q_open[None])
    at = target.X_BO[:3, 3] + [0.062, 0.0, 0.03]
    X_BX = np.eye(4)
    X_BX[:3, 3] = at
    post = BoxObstacle(name="post", X_BX=X_BX, half=np.array([0.005, 0.03, 0.03]))
    world = replace(world_of(target), boxes=(*world_of(target).boxes, post))
    assert len(rank_candidates(robot, grasps, world, clearance_m=0.002).index) == 1
    assert len(rank_candidates(robot, wide, world, clearance_m=0.002).index) == 0


def test_the_lever_of_gravity(robot, bar) -> None:
    """The pads' line runs along x: an offset along x or z has no lever, one along y all of it."""
    pads = [
        pad_frame(closing=X, approach=-Z, at=np.array(at))
        for at in ([0.0, 0.0, 0.03], [0.01, 0.0, 0.0], [0.0, 0.025, 0.03], [0.0, -0.02, 0.0])
    ]
    grasps = grasps_of(robot.hand, bar, pads)
    target = standing(bar)
    lever = gravity_lever(robot.hand, target, target.X_BO @ grasps.X_OH)
    np.testing.assert_allclose(lever, [0.0, 0.0, 0.025, 0.02], atol=1e-6)
    turned = PlacedObject(obj=bar, X_BO=target.X_BO.copy())
    turned.X_BO[:3, :3] = rpy_matrix([np.pi / 2, 0.0, 0.7])[:3, :3]  # lies: the z axis of O is level now
    lever = gravity_lever(robot.hand, turned, turned.X_BO @ grasps.X_OH)
    np.testing.assert_allclose(lever, [0.03, 0.0, 0.03, 0.0], atol=1e-6)


def test_the_score_is_the_sum_that_is_stated(robot, bar) -> None:
    """All are far from the table, so that the clearance of each is full; and all are equally strong."""
    at = [[0.0, 0.0, 0.03], [0.0, 0.02, 0.03], [0.0, 0.0, 0.03], [0.0, 0.0, 0.03]]
    pads = [pad_frame(closing=X, approach=-Z, at=np.array(a)) for a in at]
    grasps = grasps_of(robot.hand, bar, pads, opening=[0.5, 0.5, 0.5, 0.8])
    grasps = replace(grasps, epsilon=np.array([0.2, 0.2, 0.6, 0.2]))
    world = world_of(standing(bar, lift=0.2))
    ranked = rank_candidates(robot, grasps, world, clearance_m=0.004)
    np.testing.assert_array_equal(ranked.index, [2, 0, 3, 1])
    best = ranked.score[0]  # worse by 0.4 of epsilon, 0.3 of opening, a lever of 2 cm
    np.testing.assert_allclose(best - ranked.score, [0.0, 0.2, 0.2 + 0.15, 0.2 + 0.4], atol=1e-6)
    assert (ranked.clearance_m >= 0.02).all()

    held = Verdict(
        success=np.array([False, True, False, False]), displacement_m=np.zeros(4), rotation_rad=np.zeros(4),
        parameters={},
    )  # fmt: skip
    shaken = rank_candidates(robot, replace(grasps, verdicts={"shake": held}), world, clearance_m=0.004)
    assert shaken.index[0] == 1 and shaken.score[0] == pytest.approx(best - 0.6 + 1.0)


def test_preference_adds_to_the_score_and_changes_the_order(robot, bar) -> None:
    grasps = grasps_of(robot.hand, bar, [from_above(0.03)] * 3)
    grasps = replace(grasps, epsilon=np.array([0.3, 0.2, 0.1]))
    world = world_of(standing(bar))
    plain = rank_candidates(robot, grasps, world, clearance_m=0.004)
    np.testing.assert_array_equal(plain.index, [0, 1, 2])
    liked = rank_candidates(robot, grasps, world, clearance_m=0.004, preference=np.array([0.0, 0.5, 1.0]))
    np.testing.assert_array_equal(liked.index, [2, 1, 0])
    np.testing.assert_allclose(liked.score, plain.score[::-1] + np.array([1.0, 0.5, 0.0]), atol=1e-12)


def test_equal_scores_keep_their_order(robot, bar) -> None:
    grasps = grasps_of(robot.hand, bar, [from_above(0.03)] * 5)
    ranked = rank_candidates(robot, grasps, world_of(standing(bar)), clearance_m=0.004)
    np.testing.assert_array_equal(ranked.index, np.arange(5))


def test_distance_to_a_box() -> None:
    X_BX = np.eye(4)
    X_BX[:3, :3], X_BX[:3, 3] = rpy_matrix([0.0, 0.0, np.pi / 2])[:3, :3], [1.0, 0.0, 0.0]
    box = BoxObstacle(name="box", X_BX=X_BX, half=np.array([0.1, 0.2, 0.3]))  # 0.2 along x of B now
    points = np.array([[1.0, 0, 0], [1.3, 0, 0], [1.0, 0.25, 0], [1.23, 0.14, 0.0], [1.0, 0.0, 0.29], [1.0, 0.09, 0.0]])
    np.testing.assert_allclose(box_distance(box, points), [-0.1, 0.1, 0.15, 0.05, -0.01, -0.01], atol=1e-12)
