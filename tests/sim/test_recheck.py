"""The independent check of joint paths: it sees a millimetre, and only what is there."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.geometry.se3_numpy import inverse_np, transform_points_np
from neuralgrasps.hands.parts import part_mesh
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.sim.recheck import _reach, _samples, recheck_path
from neuralgrasps.sim.self_contact import held_tree

from .tabletop_scene import ABOVE, Placed, Slab, World, box_in_jaw, fetch_above, table_under, translation
from .toy import HALF, toy_box

UP = np.eye(8)[0]


@pytest.fixture(scope="module")
def robot() -> Manipulator:
    return fetch_above()


def lowest(robot: Manipulator, q_arm: np.ndarray) -> float:
    """z of the hand's lowest point, metres, from its parts' meshes."""
    q = robot.full_q(q_arm, robot.hand.q_open)
    X_BL = forward_numpy(robot.tree, q)
    parts = [p for p in robot.parts if p.link >= robot.hand_link]
    return min(float(part_mesh(p).transformed(X_BL[p.link]).vertices[:, 2].min()) for p in parts)


def slab(height: float) -> Slab:
    return Slab("table", translation(0.75, 0.25, height - 0.02), np.array([0.4, 0.4, 0.02]))


def test_sees_a_millimetre_and_no_more(robot: Manipulator) -> None:
    """The torso lowers the jaw by 100 mm onto a table that it enters, or misses, by 1 mm."""
    path = np.stack([ABOVE, ABOVE - 0.1 * UP])
    bottom = lowest(robot, path[-1])
    hand = robot.hand.q_open
    free = recheck_path(robot, World(boxes=[slab(bottom - 0.001)]), path, q_hand=hand)
    assert free.free and free.first_contact == "" and free.depth_m == 0.0
    hit = recheck_path(robot, World(boxes=[slab(bottom + 0.001)]), path, q_hand=hand)
    assert not hit.free and hit.depth_m == pytest.approx(0.001, abs=2e-5)
    assert "table" in hit.first_contact and "hand/" in hit.first_contact
    assert free.samples == hit.samples >= 101


def test_sees_a_thin_obstacle_between_two_rows(robot: Manipulator) -> None:
    """Both ends are free; a 4 mm sheet in the middle of the swing is not."""
    path = np.stack([ABOVE - 0.4 * np.eye(8)[1], ABOVE + 0.4 * np.eye(8)[1]])
    X_BH = robot.hand_pose(ABOVE)
    across = np.array([-np.sin(ABOVE[1]), np.cos(ABOVE[1]), 0.0])  # the way the hand goes
    X = translation(*X_BH[:3, 3])
    X[:3, 1], X[:3, 0] = across, [across[1], -across[0], 0.0]
    sheet = Slab("sheet", X, np.array([0.1, 0.002, 0.1]))
    for row in path:
        assert recheck_path(robot, World(boxes=[sheet]), row[None], q_hand=robot.hand.q_open).free
    found = recheck_path(robot, World(boxes=[sheet]), path, q_hand=robot.hand.q_open)
    assert not found.free and "sheet" in found.first_contact
    first = float(found.first_contact.split(" at ")[1].split(" %")[0].split("%")[0])
    assert 15 < first < 50


def test_no_point_moves_farther_than_asked(robot: Manipulator) -> None:
    rng = np.random.default_rng(0)
    path = np.stack([ABOVE, rng.uniform(robot.lower, robot.upper)])
    tree = held_tree(robot)
    q = np.hstack([path, np.tile(robot.hand.q_open, (2, 1))])
    samples, share = _samples(tree, q, _reach(robot, tree, World(), None), 0.001)
    X_BL = forward_numpy(tree, samples)
    corners = [part_mesh(p, segments=8).vertices for p in robot.parts]
    worst = 0.0
    for part, vertices in zip(robot.parts, corners, strict=True):
        at = transform_points_np(X_BL[:, part.link], vertices)
        worst = max(worst, float(np.linalg.norm(np.diff(at, axis=0), axis=-1).max()))
    assert 2e-4 < worst <= 0.001  # the bound holds, and is not absurdly loose
    np.testing.assert_allclose(samples[[0, -1]], q, atol=1e-12)
    assert share[0] == 0.0 and share[-1] == 1.0


def test_reach_is_a_bound_over_all_postures(robot: Manipulator) -> None:
    tree = held_tree(robot)
    reach = _reach(robot, tree, World(), None)
    q = np.random.default_rng(1).uniform(tree.lower, tree.upper, (300, tree.num_dofs))
    X_BL = forward_numpy(tree, q)
    farthest = np.zeros(tree.num_links)
    for part in robot.parts:
        ends = transform_points_np(X_BL[:, part.link], part_mesh(part, segments=8).vertices)
        link = part.link
        while link >= 0:
            way = np.linalg.norm(ends - X_BL[:, link, None, :3, 3], axis=-1).max()
            farthest[link] = max(farthest[link], float(way))
            link = int(tree.parents[link])
    assert (farthest <= reach + 1e-9).all()
    assert (reach <= 1.5 * farthest + 0.1).all()


def test_self_contact_is_found(robot: Manipulator) -> None:
    folded = ABOVE.copy()
    folded[[2, 4, 6]] = [1.4, -2.2, -2.1]  # the elbow folds the hand back onto the arm
    found = recheck_path(robot, World(), np.stack([ABOVE, folded]), q_hand=robot.hand.q_open)
    assert not found.free and found.depth_m > 0.001


def test_target_and_neighbours(robot: Manipulator) -> None:
    """Lowering an open jaw over a box is free; a jaw closed by 1 mm too much touches it, unless it may."""
    box = toy_box()
    placed = Placed(box, box_in_jaw(robot))
    path, world = np.stack([ABOVE + 0.15 * UP, ABOVE]), World(target=placed)
    assert recheck_path(robot, world, path, q_hand=robot.hand.q_open).free
    tight = np.array([HALF[0] - 0.001])
    assert "box" in recheck_path(robot, world, path, q_hand=tight).first_contact
    assert recheck_path(robot, world, path, q_hand=tight, ignore_target=True).free
    assert not recheck_path(robot, World(objects=[placed]), path, q_hand=tight, ignore_target=True).free


def test_carried_object_may_leave_its_table_but_hit_nothing(robot: Manipulator) -> None:
    X_BO = box_in_jaw(robot)
    world = World(boxes=[table_under(X_BO, gap_m=-5e-5)], target=Placed(toy_box(), X_BO))
    X_HO = inverse_np(robot.hand_pose(ABOVE)) @ X_BO
    up, hand = np.stack([ABOVE, ABOVE + 0.2 * UP]), np.array([HALF[0]])
    assert recheck_path(robot, world, up, q_hand=hand, carried=X_HO).free
    down = recheck_path(robot, world, np.stack([ABOVE, ABOVE - 0.002 * UP]), q_hand=hand, carried=X_HO)
    assert "carried" in down.first_contact and down.depth_m == pytest.approx(0.00205, abs=1e-4)
    shelf = Slab("shelf", translation(X_BO[0, 3] + 0.01, X_BO[1, 3] + 0.1, X_BO[2, 3] + 0.15), np.full(3, 0.08))
    blocked = World(boxes=[*world.boxes, shelf], target=world.target)
    assert not recheck_path(robot, blocked, up, q_hand=hand, carried=X_HO).free


def test_base_in_a_table_is_found_although_neither_moves(robot: Manipulator) -> None:
    inside = Slab("table", translation(0.0, 0.0, 0.2), np.array([0.5, 0.5, 0.02]))
    assert (
        "neither moves"
        in recheck_path(robot, World(boxes=[inside]), ABOVE[None], q_hand=robot.hand.q_open).first_contact
    )


def test_wrong_arguments(robot: Manipulator) -> None:
    with pytest.raises(ShapeError, match="q_path"):
        recheck_path(robot, World(), np.zeros((3, 5)), q_hand=robot.hand.q_open)
    with pytest.raises(InputError, match="no target"):
        recheck_path(robot, World(), ABOVE[None], q_hand=robot.hand.q_open, carried=np.eye(4))
    with pytest.raises(InputError, match="finite"):
        recheck_path(robot, World(), np.full((1, 8), np.nan), q_hand=robot.hand.q_open)
