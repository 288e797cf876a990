"""The checker against a slow, plain reference: exact distances of dense points on every part."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.geometry.primitives import box_mesh, sphere_mesh
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.geometry.se3_numpy import inverse_np, make_transform_np, rpy_matrix
from neuralgrasps.hands.chains import moved_links, rigid_bodies
from neuralgrasps.hands.parts import bounding_sphere, part_distances, part_mesh, sample_part
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.collision import CollisionChecker, CollisionConfig
from neuralgrasps.planning.collision_robot import ARM_EXCESS_M, robot_shape
from neuralgrasps.planning.world import BoxObstacle, PlacedObject, PlanningWorld, table_box

_SPACING = 0.006  # of the reference's points
_ROBOTS = ("fetch", "panda")


@cache
def _points(robot: Manipulator) -> tuple[np.ndarray, ...]:
    """Surface points of each part, link frame, its corners included."""
    return tuple(np.concatenate([sample_part(p, 1 / _SPACING**2)[0], part_mesh(p).vertices]) for p in robot.parts)


def _posed(robot: Manipulator, q_arm: np.ndarray, q_hand: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    X_BL = forward_numpy(robot.tree, robot.full_q(q_arm, q_hand))
    points = [
        p @ X_BL[part.link][:3, :3].T + X_BL[part.link][:3, 3]
        for part, p in zip(robot.parts, _points(robot), strict=True)
    ]
    return X_BL, points


def _in_frame(X: np.ndarray, points: np.ndarray) -> np.ndarray:
    return (points - X[:3, 3]) @ X[:3, :3]


def _box_distance(box: BoxObstacle, points: np.ndarray) -> np.ndarray:
    d = np.abs(_in_frame(box.X_BX, points)) - box.half
    return np.linalg.norm(np.maximum(d, 0), axis=1) + np.minimum(d.max(axis=1), 0)


def _world_gap(robot: Manipulator, world: PlanningWorld, q_arm: np.ndarray, q_hand: np.ndarray) -> float:
    """Least distance of any moving part to the world, by its points; less than it by the points' spacing at most."""
    X_BL, points = _posed(robot, q_arm, q_hand)
    moving = moved_links(robot.tree)[:, robot.arm_dofs].any(axis=1)
    gap = np.inf
    for part, p in zip(robot.parts, points, strict=True):
        if not moving[part.link]:
            continue
        gap = min(gap, *(float(_box_distance(b, p).min()) for b in world.boxes), np.inf)
        placed = [*world.objects, *([world.target] if world.target else [])]
        gap = min(gap, *(float(query_grid_numpy(o.obj.sdf, _in_frame(o.X_BO, p)).min()) for o in placed), np.inf)
        if len(world.cloud_B):
            gap = min(gap, float(part_distances(part, _in_frame(X_BL[part.link], world.cloud_B)).min()))
    return gap


def _self_gap(robot: Manipulator, q_arm: np.ndarray, q_hand: np.ndarray) -> float:
    """Least distance of links on bodies that the arm moves against each other and that are not neighbours."""
    X_BL, points = _posed(robot, q_arm, q_hand)
    body = rigid_bodies(robot.tree)
    parent = np.array([body[robot.tree.parents[b]] if robot.tree.parents[b] >= 0 else -1 for b in body])
    moved = moved_links(robot.tree)[:, robot.arm_dofs]
    gap = np.inf
    for i, a in enumerate(robot.parts):
        for b in robot.parts:
            A, B = body[a.link], body[b.link]
            if A == B or parent[a.link] == B or parent[b.link] == A or (moved[a.link] == moved[b.link]).all():
                continue
            centre, radius = bounding_sphere(b)
            away = np.linalg.norm(points[i] - (X_BL[b.link][:3, :3] @ centre + X_BL[b.link][:3, 3]), axis=1) - radius
            near = away < min(gap, 0.05)
            if near.any():
                gap = min(gap, float(part_distances(b, _in_frame(X_BL[b.link], points[i][near])).min()))
    return gap


@pytest.fixture(scope="module")
def scene(make_object: Callable[..., ObjectModel]) -> Callable[[str], PlanningWorld]:
    """A table with a target, two neighbours, a shelf and a cloud, before either robot."""
    ball, brick = make_object("ball", sphere_mesh(0.05)), make_object("brick", box_mesh([0.05, 0.12, 0.18]))

    def build(name: str) -> PlanningWorld:
        height, x = (0.7, 0.75) if name == "fetch" else (0.05, 0.5)

        def at(dx: float, dy: float, dz: float, turn: float) -> np.ndarray:
            return make_transform_np(rpy_matrix([0, 0, turn]), [x + dx, dy, height + dz])

        cloud = np.random.default_rng(0).uniform(-0.06, 0.06, (400, 3)) + np.array([x - 0.1, -0.35, height + 0.08])
        return PlanningWorld(
            boxes=(
                table_box(height, centre=(x, 0), size=(0.7, 1.2)),
                BoxObstacle(name="shelf", X_BX=at(0.1, 0.5, 0.3, 0.5), half=np.array([0.15, 0.02, 0.3])),
            ),
            target=PlacedObject(obj=brick, X_BO=at(0, 0, 0.09, 0.4)),
            objects=(
                PlacedObject(obj=ball, X_BO=at(0.1, 0.2, 0.05, 0)),
                PlacedObject(obj=brick, X_BO=at(0.2, -0.2, 0.09, 1)),
            ),
            cloud_B=cloud,
        )

    return build


def _postures(robot: Manipulator, count: int, seed: int, world: PlanningWorld) -> np.ndarray:
    """Random ones whose hand is within reach of what stands on the table."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(np.maximum(robot.lower, -3), np.minimum(robot.upper, 3), (60 * count, len(robot.lower)))
    assert world.target is not None
    away = np.linalg.norm(robot.hand_pose(q)[:, :3, 3] - world.target.X_BO[:3, 3], axis=1)
    return q[np.argsort(away)[: 3 * count : 3]]


def test_home_is_free_and_pairs_are_known(make_robot: Callable[[str], Manipulator]) -> None:
    for name in _ROBOTS:
        robot = make_robot(name)
        checker = CollisionChecker(robot, PlanningWorld(), robot.hand.q_open)
        home = robot.q_home[robot.arm_dofs]
        assert checker.is_free(home[None])[0], checker.describe(home)
        assert checker.describe(home) == ""
        assert robot_shape(robot).always == ()  # nothing is left out but neighbours


@pytest.mark.parametrize("name", _ROBOTS)
def test_never_free_in_touch_with_the_world_and_free_where_the_margin_and_excess_are_kept(
    name: str, make_robot: Callable[[str], Manipulator], scene: Callable[[str], PlanningWorld]
) -> None:
    robot, world = make_robot(name), scene(name)
    checker = CollisionChecker(robot, world, robot.hand.q_open)
    checker.arrays.pair_margins[:] = -1.0  # the robot against itself is another test
    q = _postures(robot, 90, 1, world)
    free = checker.is_free(q)
    gap = np.array([_world_gap(robot, world, row, robot.hand.q_open) for row in q])
    assert 0.1 < free.mean() < 0.9
    assert not free[gap < 0.005].any()  # the least margin, the target's
    # margin, spheres' excess, grid or cloud error, and what the reference's points may miss
    assert free[gap > 0.010 + ARM_EXCESS_M + 0.012 + _SPACING / 2].all()
    alarms = ~free & (gap > 0.010 + 0.001)
    assert alarms.sum() <= 0.03 * len(q)


@pytest.mark.parametrize("name", _ROBOTS)
def test_self_collision_agrees_with_the_reference(name: str, make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot(name)
    checker = CollisionChecker(robot, PlanningWorld(), robot.hand.q_open)
    q = np.random.default_rng(5).uniform(robot.lower, robot.upper, (1500, len(robot.lower)))
    free = checker.is_free(q)
    some = [*np.flatnonzero(free)[:12], *np.flatnonzero(~free)[:14]]
    q, free = q[some], free[some]
    gap = np.array([_self_gap(robot, row, robot.hand.q_open) for row in q])
    assert not free[gap <= 0.0].any()
    assert (gap <= 0.0).sum() >= 5
    assert free[gap >= checker.config.self_margin_m + 1e-9 + _SPACING].all()  # exact distances: no false alarms
    # where the pair's margin is whole, so is what is kept
    kept = np.minimum(checker.config.self_margin_m, checker.arrays.pair_margins.min())
    assert (gap[free] >= kept - 1e-9).all()


def test_fingers_against_the_arm_are_checked(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("fetch")
    shape = robot_shape(robot)
    names = [robot.tree.link_names[i] for i in shape.links]
    pairs = {frozenset((names[i], names[j])) for i, j in shape.pair}
    assert frozenset(("hand/r_gripper_finger_link", "torso_lift_link")) in pairs
    assert frozenset(("forearm_roll_link", "base_link")) in pairs
    assert frozenset(("wrist_flex_link", "wrist_roll_link")) not in pairs  # neighbours
    assert frozenset(("hand/r_gripper_finger_link", "hand/l_gripper_finger_link")) not in [
        frozenset((names[i], names[j]))
        for i, j in CollisionChecker(robot, PlanningWorld(), robot.hand.q_open).arrays.pairs
    ]


def test_the_base_is_not_checked_against_the_table_but_what_moves_is(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("fetch")
    home = robot.q_home[robot.arm_dofs]
    inside_base = BoxObstacle(name="crate", X_BX=make_transform_np(None, [0, 0, 0.1]), half=np.full(3, 0.05))
    assert CollisionChecker(robot, PlanningWorld(boxes=(inside_base,)), robot.hand.q_open).is_free(home[None])[0]
    X = make_transform_np(None, robot.hand_pose(home)[:3, 3])
    in_hand = BoxObstacle(name="crate", X_BX=X, half=np.full(3, 0.05))
    checker = CollisionChecker(robot, PlanningWorld(boxes=(in_hand,)), robot.hand.q_open)
    assert not checker.is_free(home[None])[0]
    assert "hand/gripper_link is" in checker.describe(home) and "the crate" in checker.describe(home)
    assert checker.clearance(home) == 0.0


@pytest.mark.parametrize("name", _ROBOTS)
def test_edges_called_free_are_free_ten_times_as_densely(
    name: str, make_robot: Callable[[str], Manipulator], scene: Callable[[str], PlanningWorld]
) -> None:
    robot, world = make_robot(name), scene(name)
    checker = CollisionChecker(robot, world, robot.hand.q_open)
    tight = CollisionConfig(margin_m=0.0, target_margin_m=0.0, self_margin_m=0.0)
    exact = CollisionChecker(robot, world, robot.hand.q_open, config=tight)
    q = _postures(robot, 300, 2, world)
    q = q[checker.is_free(q)]
    rng = np.random.default_rng(3)
    free = 0
    for a in q:
        step = rng.normal(size=len(a))
        b = np.clip(a + step / np.linalg.norm(step) * rng.uniform(0.1, 1.5), robot.lower, robot.upper)
        dense = a + np.linspace(0, 1, 10 * int(np.ceil(np.abs(b - a).max() / 0.02)) + 1)[:, None] * (b - a)
        if checker.edge_is_free(a, b):
            free += 1
            assert exact.is_free(dense).all()
        else:
            assert not checker.is_free(dense).all()
        assert checker.edge_is_free(a, a)
    assert 10 < free < len(q) - 10


@pytest.mark.parametrize("name", _ROBOTS)
def test_an_edge_that_jumps_over_a_thin_plate_is_not_free(name: str, make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot(name)
    home = robot.q_home[robot.arm_dofs]
    other = home.copy()
    other[robot.arm_names.index("shoulder_pan_joint") if name == "fetch" else 0] -= 0.9
    ends = robot.hand_pose(np.stack([home, home + 0.5 * (other - home), other]))[:, :3, 3]
    along = ends[2] - ends[0]
    x = along / np.linalg.norm(along)
    z = np.cross(x, [0.0, 0.0, 1.0])
    z /= np.linalg.norm(z)
    X = make_transform_np(np.stack([x, np.cross(z, x), z], axis=1), ends[1])
    plate = BoxObstacle(name="plate", X_BX=X, half=np.array([0.0005, 0.03, 0.03]))
    checker = CollisionChecker(robot, PlanningWorld(boxes=(plate,)), robot.hand.q_open)
    assert checker.is_free(np.stack([home, other])).all()
    assert not checker.edge_is_free(home, other)
    assert not checker.edge_is_free(other, home)


def _moved_robot(robot: Manipulator, X: np.ndarray) -> Manipulator:
    """The same robot standing at X (4, 4) in its base frame."""
    tree = robot.tree
    joints = tree.X_parent_joint.copy()
    joints[tree.parents == 0] = X @ joints[tree.parents == 0]
    parts = tuple(replace(p, X_LP=X @ p.X_LP) if p.link == 0 else p for p in robot.parts)
    return replace(robot, tree=replace(tree, X_parent_joint=joints), parts=parts)


@pytest.mark.parametrize("name", _ROBOTS)
def test_moving_everything_together_changes_nothing(
    name: str, make_robot: Callable[[str], Manipulator], scene: Callable[[str], PlanningWorld]
) -> None:
    robot, world = make_robot(name), replace(scene(name), cloud_B=np.zeros((0, 3)))  # its grid lies along B's axes
    X = make_transform_np(rpy_matrix([0.3, -0.7, 1.9]), [0.4, -1.2, 0.3])
    assert world.target is not None
    moved = PlanningWorld(
        boxes=tuple(replace(b, X_BX=X @ b.X_BX) for b in world.boxes),
        target=replace(world.target, X_BO=X @ world.target.X_BO),
        objects=tuple(replace(o, X_BO=X @ o.X_BO) for o in world.objects),
    )
    there = _moved_robot(robot, X)
    q = _postures(robot, 300, 4, world)
    q_hand = robot.hand.q_open
    for phase in ("for_transfer", "for_approach"):
        a = getattr(CollisionChecker(robot, world, q_hand), phase)()
        b = getattr(CollisionChecker(there, moved, q_hand), phase)()
        free = a.is_free(q)
        assert 0.05 < free.mean() < 0.95
        np.testing.assert_array_equal(free, b.is_free(q))
        for row in q[:20]:
            assert a.clearance(row) == pytest.approx(b.clearance(row), abs=1e-6)


@pytest.mark.parametrize("name", _ROBOTS)
def test_the_approach_knows_the_hand_exactly(
    name: str, make_robot: Callable[[str], Manipulator], scene: Callable[[str], PlanningWorld]
) -> None:
    robot, world = make_robot(name), scene(name)
    only_target = PlanningWorld(target=world.target)
    q_hand = robot.hand.q_open
    approach = CollisionChecker(robot, only_target, q_hand).for_approach()
    transfer = CollisionChecker(robot, only_target, q_hand)
    q = _postures(robot, 400, 6, world)
    for checker in (approach, transfer):
        checker.arrays.pair_margins[:] = -1.0
    gap = np.array([_world_gap(robot, only_target, row, q_hand) for row in q[::4]])
    free, wide = approach.is_free(q[::4]), transfer.is_free(q[::4])
    assert not free[gap < -0.002].any()  # what points 5.5 mm apart can miss of an edge
    assert (wide <= free).all() and wide.sum() < free.sum()
    hand_only = np.array([_hand_gap(robot, only_target, row, q_hand) for row in q[::4]])
    arm_is_farther = hand_only < gap + 1e-9
    near = arm_is_farther & (gap > 0.001 + 0.002)  # its margin, and the samples' own error
    assert near.sum() > 5
    assert free[near].mean() > 0.9  # the arm behind it may have its spheres in the way


def _hand_gap(robot: Manipulator, world: PlanningWorld, q_arm: np.ndarray, q_hand: np.ndarray) -> float:
    _, points = _posed(robot, q_arm, q_hand)
    hand = np.concatenate([p for part, p in zip(robot.parts, points, strict=True) if part.link >= robot.hand_link])
    assert world.target is not None
    return float(query_grid_numpy(world.target.obj.sdf, _in_frame(world.target.X_BO, hand)).min())


def _held(robot: Manipulator, obj: ObjectModel) -> tuple[PlanningWorld, np.ndarray, np.ndarray]:
    """A world in which the object stands on a small table, before the hand of the robot at home; q_arm and X_HO."""
    q = robot.q_home[robot.arm_dofs].copy()
    q[0] = 0.2
    X_BH = robot.hand_pose(q)
    X_BO = make_transform_np(None, X_BH[:3, 3] + 0.12 * (X_BH[:3, :3] @ robot.hand.X_HP[:3, 2]))
    low = obj.mesh.bounds[0][2] + X_BO[2, 3]
    table = table_box(low, centre=(X_BO[0, 3], X_BO[1, 3]), size=(0.1, 0.1))
    world = PlanningWorld(boxes=(table,), target=PlacedObject(obj=obj, X_BO=X_BO))
    return world, q, inverse_np(X_BH) @ X_BO


def test_the_lift_starts_in_touch_and_must_not_sink(
    make_robot: Callable[[str], Manipulator], make_object: Callable[..., ObjectModel]
) -> None:
    robot, obj = make_robot("fetch"), make_object("ball", sphere_mesh(0.03))
    world, q, X_HO = _held(robot, obj)
    lift = CollisionChecker(robot, world, robot.hand.q_open).for_lift(robot.hand.q_open, X_HO)
    lift.arrays.pair_margins[:] = -1.0
    lift.arrays.margins[:] = -1.0  # only what is carried

    def at(height: float) -> bool:
        moved = q.copy()
        moved[0] += height  # the torso's lift
        return bool(lift.is_free(moved[None])[0])

    assert robot.arm_names[0].startswith("torso")
    assert at(0.0) and at(0.002) and at(0.05) and at(-0.0008)
    assert not at(-0.0013) and not at(-0.01)
    sunk = q.copy()
    sunk[0] -= 0.01
    assert "the carried ball is" in lift.describe(sunk) and "the table" in lift.describe(sunk)


def test_what_is_carried_meets_neighbours_cloud_and_arm(
    make_robot: Callable[[str], Manipulator], make_object: Callable[..., ObjectModel]
) -> None:
    robot, obj = make_robot("fetch"), make_object("ball", sphere_mesh(0.03))
    world, q, X_HO = _held(robot, obj)
    assert world.target is not None
    above = world.target.X_BO.copy()
    above[2, 3] += 0.10
    raised = q + np.array([0.08, 0, 0, 0, 0, 0, 0, 0])
    cloud = above[:3, 3] + np.random.default_rng(0).uniform(-0.01, 0.01, (50, 3))
    for blocked in (
        replace(world, objects=(PlacedObject(obj=obj, X_BO=above),)),
        replace(world, cloud_B=cloud),
        replace(world, boxes=(*world.boxes, BoxObstacle(name="lid", X_BX=above, half=np.full(3, 0.02)))),
    ):
        lift = CollisionChecker(robot, blocked, robot.hand.q_open).for_lift(robot.hand.q_open, X_HO)
        lift.arrays.margins[:] = -1.0
        lift.arrays.pair_margins[:] = -1.0
        assert lift.is_free(q[None])[0]
        assert not lift.is_free(raised[None])[0]
    # held where the torso is: not free; the hand itself may touch it
    X_BH = robot.hand_pose(q)
    in_torso = inverse_np(X_BH) @ make_transform_np(
        None, forward_numpy(robot.tree, robot.full_q(q))[1, :3, 3] + [0, 0, 0.3]
    )
    checker = CollisionChecker(robot, replace(world, boxes=()), robot.hand.q_open)
    assert not checker.for_lift(robot.hand.q_open, in_torso).is_free(q[None])[0]
    in_hand = np.eye(4)
    held = checker.for_lift(robot.hand.q_open, in_hand)
    held.arrays.pair_margins[:] = -1.0
    assert held.is_free(q[None])[0]


def test_phases_share_the_world_and_with_hand_moves_the_fingers(
    make_robot: Callable[[str], Manipulator], scene: Callable[[str], PlanningWorld]
) -> None:
    robot, world = make_robot("fetch"), scene("fetch")
    q = _postures(robot, 100, 8, world)
    opened = CollisionChecker(robot, world, robot.hand.q_open)
    closed = robot.hand.tree.lower
    again, fresh = opened.with_hand(closed), CollisionChecker(robot, world, closed)
    np.testing.assert_array_equal(again.is_free(q), fresh.is_free(q))
    np.testing.assert_array_equal(again.with_hand(robot.hand.q_open).is_free(q), opened.is_free(q))
    assert not np.array_equal(again.arrays.parts, opened.arrays.parts)
    np.testing.assert_array_equal(again.for_approach().for_transfer().is_free(q), again.is_free(q))


def test_clearance_is_the_distance_to_a_box(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("panda")
    q = robot.q_home[robot.arm_dofs]
    box = BoxObstacle(
        name="box", X_BX=make_transform_np(rpy_matrix([0.2, 0.4, 0]), [0.65, 0.1, 0.4]), half=np.full(3, 0.1)
    )
    world = PlanningWorld(boxes=(box,))
    checker = CollisionChecker(robot, world, robot.hand.q_open)
    reference = _world_gap(robot, world, q, robot.hand.q_open)
    assert 0.0 < reference < 0.3
    assert reference - _SPACING <= checker.clearance(q, cap_m=1.0) <= reference + 1e-9
    assert checker.clearance(q, cap_m=0.01) == 0.01


def test_bad_input_is_refused(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("panda")
    checker = CollisionChecker(robot, PlanningWorld(), robot.hand.q_open)
    with pytest.raises(ShapeError, match="q_arm has shape"):
        checker.is_free(np.zeros((2, 3)))
    with pytest.raises(ShapeError, match="joints"):
        CollisionChecker(robot, PlanningWorld(), np.zeros(9))
    with pytest.raises(InputError, match="no target to lift"):
        checker.for_lift(robot.hand.q_open, np.eye(4))
    with pytest.raises(InputError, match="margin_m is -1"):
        CollisionConfig(margin_m=-1.0)
    with pytest.raises(InputError, match="max_step_m"):
        CollisionConfig(max_step_m=0.0)


def test_a_path_is_free_where_all_its_edges_are(
    make_robot: Callable[[str], Manipulator], scene: Callable[[str], PlanningWorld]
) -> None:
    robot, world = make_robot("fetch"), scene("fetch")
    checker = CollisionChecker(robot, world, robot.hand.q_open)
    q = _postures(robot, 200, 11, world)
    q = q[checker.is_free(q)]
    home = robot.q_home[robot.arm_dofs]
    verdicts = []
    for a, b in pairwise(q):
        path = home + np.array([[0.0], [0.3]]) * (a - home), home + 0.3 * (b - home)
        way = np.vstack(path)
        verdicts.append(checker.path_is_free(way))
        assert verdicts[-1] == all(checker.edge_is_free(*edge) for edge in pairwise(way))
    assert any(verdicts) and not all(verdicts)
    assert checker.path_is_free(home[None])
