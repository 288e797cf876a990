"""Straight motions of the hand: the line, the joints that follow it, and the reasons when they cannot."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.errors import InputError, NeuralGraspsError, ShapeError
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix, make_transform_np, rpy_matrix
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.planning.ik import IkSolver, ik_solver
from neuralgrasps.planning.straight import LineConfig, follow_line, line_path

RETREAT_M, STEPS = 0.10, 10


def hand_poses(robot: Manipulator, q_arm: np.ndarray) -> np.ndarray:
    return forward_numpy(robot.tree, robot.full_q(q_arm))[..., robot.hand_link, :, :]


def at_home(robot: Manipulator) -> np.ndarray:
    return robot.q_home[robot.arm_dofs].copy()


def retreat(X_BH: np.ndarray, direction_B: tuple[float, float, float]) -> np.ndarray:
    end = X_BH.copy()
    end[:3, 3] += RETREAT_M * np.asarray(direction_B)
    return line_path(X_BH, end, STEPS)


def test_a_line_is_even_in_place_and_turn() -> None:
    R = rpy_matrix([0.3, -0.8, 2.0])
    A = make_transform_np(R, [0.1, 0.2, 0.3])
    axis, angle = np.array([0.6, 0.0, 0.8]), 1.2
    B = make_transform_np(axis_angle_matrix(axis, angle) @ R, [0.5, 0.0, 0.3])
    X = line_path(A, B, 4)
    assert X.shape == (5, 4, 4)
    np.testing.assert_array_equal(X[0], A)
    np.testing.assert_array_equal(X[4], B)
    for k in range(5):
        np.testing.assert_allclose(X[k, :3, 3], [0.1 + 0.1 * k, 0.2 - 0.05 * k, 0.3], atol=1e-12)
        np.testing.assert_allclose(X[k, :3, :3], axis_angle_matrix(axis, angle * k / 4) @ R, atol=1e-12)


def test_a_line_without_a_turn_keeps_the_rotation_exactly() -> None:
    A = make_transform_np(rpy_matrix([0.3, -0.8, 2.0]))
    B = A.copy()
    B[2, 3] = 0.2
    for X in line_path(A, B, 7):
        np.testing.assert_allclose(X[:3, :3], A[:3, :3], atol=1e-12)


def test_a_line_of_half_a_turn() -> None:
    X = line_path(np.eye(4), make_transform_np(np.diag([1.0, -1.0, -1.0])), 2)
    np.testing.assert_allclose(np.abs(X[1, :3, :3]), [[1, 0, 0], [0, 0, 1], [0, 1, 0]], atol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"), [((np.eye(4), np.eye(4), 0), "steps is 0"), ((np.eye(3), np.eye(4), 3), "X_start")]
)
def test_a_line_of_nothing_is_refused(arguments: tuple[np.ndarray, np.ndarray, int], message: str) -> None:
    with pytest.raises(InputError, match=message):
        line_path(*arguments)


@pytest.mark.parametrize("name", ["fetch", "panda"])
@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (-0.6, 0.0, 0.8), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)])
def test_the_hand_stays_on_its_line(
    make_robot: Callable[[str], Manipulator], name: str, direction: tuple[float, float, float]
) -> None:
    robot = make_robot(name)
    q = at_home(robot)
    X = retreat(hand_poses(robot, q), direction)
    line = follow_line(robot, q, X)
    assert line.complete, line.reason
    np.testing.assert_array_equal(line.q[0], q)
    np.testing.assert_allclose(hand_poses(robot, line.q), X, atol=3e-4)
    assert np.linalg.norm(hand_poses(robot, line.q)[:, :3, 3] - X[:, :3, 3], axis=1).max() <= 2e-5
    assert (line.q >= robot.lower).all()
    assert (line.q <= robot.upper).all()
    between = np.concatenate([line.q[:-1] + s * np.diff(line.q, axis=0) for s in np.linspace(0, 1, 9)])
    off = hand_poses(robot, between)[:, :3, 3] - X[0, :3, 3]
    away = off - np.outer(off @ direction, direction)
    assert np.linalg.norm(away, axis=1).max() < 2e-4
    assert np.abs(np.diff(line.q, axis=0)).max() < 0.2


def test_a_solver_gives_what_its_robot_gives(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("fetch")
    q = at_home(robot)
    X = retreat(hand_poses(robot, q), (0.0, 0.0, 1.0))
    np.testing.assert_array_equal(follow_line(robot, q, X).q, follow_line(IkSolver(robot), q, X).q)


def test_a_start_beside_the_line_is_brought_onto_it(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("panda")
    q = at_home(robot)
    X = retreat(hand_poses(robot, q), (0.0, 0.0, 1.0))
    line = follow_line(robot, q + 0.02, X)
    assert line.complete
    assert np.linalg.norm(hand_poses(robot, line.q)[:, :3, 3] - X[:, :3, 3], axis=1).max() <= 2e-5
    jumped = follow_line(robot, q + 0.02, X, max_step_rad=0.005)
    assert not jumped.complete
    assert len(jumped.q) == 0


def test_a_line_that_leaves_the_workspace_says_where(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("planar")  # 0.6 m long
    q = np.array([0.0, 0.8, -0.8])  # the hand points along x, at x = 0.539
    X = hand_poses(robot, q)
    end = X.copy()
    end[0, 3] += 0.12
    line = follow_line(robot, q, line_path(X, end, 12), config=LineConfig(max_bow_m=0.1))
    assert not line.complete
    reach = np.hypot(0.5 + 0.1, 0.0) - X[0, 3]  # how far along x the hand can go at this height, about
    assert 0 < len(line.q) <= reach / 0.01 + 1
    np.testing.assert_allclose(hand_poses(robot, line.q)[:, 0, 3], X[0, 3] + 0.01 * np.arange(len(line.q)), atol=3e-5)
    assert line.reason.startswith(f"pose {len(line.q) + 1} of 13: ")


def test_a_pose_out_of_reach_states_what_is_left(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("panda")
    q = at_home(robot)
    X = np.stack([hand_poses(robot, q)] * 2)
    X[1, 0, 3] += 3.0
    line = follow_line(robot, q, X)
    assert not line.complete
    np.testing.assert_array_equal(line.q, q[None])
    assert line.reason.startswith("pose 2 of 2: the hand stays ")
    assert float(line.reason.split("stays ")[1].split(" mm")[0]) > 2000


def test_a_jump_is_refused_with_the_joint_that_jumps(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("fetch")
    q = at_home(robot)
    X = hand_poses(robot, q)
    turned = X @ make_transform_np(rpy_matrix([0.6, 0.0, 0.0]))  # about the wrist roll axis
    path = np.stack([X, turned])
    line = follow_line(robot, q, path)
    assert not line.complete
    assert "would jump by 0." in line.reason
    assert "at most 0.35" in line.reason
    assert follow_line(robot, q, path, max_step_rad=0.7, config=LineConfig(max_bow_m=0.5)).complete


def test_a_slide_may_not_jump_either(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("fetch")
    q = at_home(robot)
    path = line_path(hand_poses(robot, q), hand_poses(robot, q) + 0.06 * np.eye(4)[:, [3, 3, 3, 2]] * [0, 0, 0, 1], 1)
    wide = {"max_step_rad": 3.0}
    assert follow_line(robot, q, path, **wide, config=LineConfig(max_bow_m=1.0)).complete
    line = follow_line(robot, q, path, **wide, config=LineConfig(max_bow_m=1.0, max_step_m=0.001))
    assert not line.complete
    assert line.reason.endswith("m; at most 0.00 is allowed")


def test_a_bow_between_poses_is_refused(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("planar")
    q = np.array([-0.9, 1.8, -0.9])
    X = hand_poses(robot, q)
    end = X.copy()
    end[1, 3] += 0.1
    coarse, fine = line_path(X, end, 1), line_path(X, end, 40)
    line = follow_line(robot, q, coarse, max_step_rad=2.0)
    assert not line.complete
    assert "leaves the line by" in line.reason
    assert follow_line(robot, q, coarse, max_step_rad=2.0, config=LineConfig(max_bow_m=0.2)).complete
    assert follow_line(robot, q, fine).complete


def test_a_continuous_joint_follows_past_half_a_turn(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("fetch")
    q = at_home(robot)
    roll = int(np.flatnonzero(robot.continuous)[-1])
    q[roll] = np.pi - 0.05
    ahead = q.copy()
    ahead[roll] += 0.5
    line = follow_line(robot, q, line_path(hand_poses(robot, q), hand_poses(robot, ahead), 5))
    assert line.complete, line.reason
    assert line.q[-1, roll] > np.pi
    np.testing.assert_allclose(line.q[-1], ahead, atol=0.2)


def test_a_joint_at_its_limit_is_drawn_away_where_the_arm_has_joints_to_spare(
    make_robot: Callable[[str], Manipulator],
) -> None:
    robot = make_robot("panda")
    q = at_home(robot)
    q[0] = robot.upper[0] - 0.05
    X = retreat(hand_poses(robot, q), (0.0, 0.0, 1.0))
    pulled, plain = follow_line(robot, q, X), follow_line(robot, q, X, config=LineConfig(pull=0.0))
    assert pulled.complete
    assert plain.complete
    assert robot.upper[0] - pulled.q[-1, 0] > robot.upper[0] - plain.q[-1, 0] + 0.05
    np.testing.assert_allclose(follow_line(robot, q + 1e-4, X).q[0], q, atol=1e-3)  # not at the first pose


def test_a_joint_held_at_its_limit_does_not_stop_the_line(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("fetch")
    q = at_home(robot)
    torso = 0
    assert robot.arm_names[torso].startswith("torso")
    q[torso] = robot.upper[torso]
    line = follow_line(robot, q, retreat(hand_poses(robot, q), (0.0, 0.0, 1.0)))
    assert line.complete, line.reason
    assert (line.q <= robot.upper).all()


def test_bad_input_is_refused(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("panda")
    q, X = at_home(robot), np.tile(np.eye(4), (3, 1, 1))
    flat = X.copy()
    flat[1, 0, 0] = 0.0
    with pytest.raises(ShapeError, match="q_arm has shape"):
        follow_line(robot, q[:5], X)
    with pytest.raises(InputError, match="q_arm is not finite"):
        follow_line(robot, q * np.nan, X)
    with pytest.raises(InputError, match=r"X_BH\[1\] is not rigid"):
        follow_line(robot, q, flat)
    with pytest.raises(ShapeError, match="X_BH has shape"):
        follow_line(robot, q, X[:, :3])
    for step in (0.0, -1.0, np.nan):
        with pytest.raises(NeuralGraspsError, match="max_step_rad"):
            follow_line(robot, q, X, max_step_rad=step)
    for name in ("position_tolerance_m", "max_step_m", "max_iterations", "max_bow_m"):
        with pytest.raises(InputError, match=name):
            LineConfig(**{name: 0})
    with pytest.raises(InputError, match="pull"):
        LineConfig(pull=-0.1)


def test_an_empty_path_is_complete(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("panda")
    line = follow_line(ik_solver(robot), at_home(robot), np.zeros((0, 4, 4)))
    assert line.complete
    assert line.q.shape == (0, 7)
