"""Inverse kinematics of built-in arms and of arms made here, against plain forward kinematics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.errors import InputError, NeuralGraspsError, RobotDescriptionError, ShapeError
from neuralgrasps.geometry.se3_numpy import inverse_np, make_transform_np, rpy_matrix
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.kinematics.tree import PRISMATIC, REVOLUTE
from neuralgrasps.objects.zoo import load_object
from neuralgrasps.planning.chain import chain_jacobian, chain_pose, chain_poses, pack_chain, sliding_dofs
from neuralgrasps.planning.ik import IkConfig, IkSolver, ik_solver, ik_starts, solve_ik
from neuralgrasps.planning.ik_kernels import add_pull, damped_step, work_arrays
from neuralgrasps.planning.posture_table import APART_RAD
from neuralgrasps.planning.reach import beyond_reach

ROBOTS = ("fetch", "panda", "six", "planar", "coupled")


def random_postures(robot: Manipulator, count: int, seed: int) -> np.ndarray:
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    return np.random.default_rng(seed).uniform(lower, upper, (count, len(lower)))


def reference_poses(robot: Manipulator, q_arm: np.ndarray) -> np.ndarray:
    return forward_numpy(robot.tree, robot.full_q(q_arm))[..., robot.hand_link, :, :]


def errors(X: np.ndarray, X_wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance (m) and angle (rad) between poses (..., 4, 4)."""
    E = inverse_np(X) @ X_wanted
    sine = np.linalg.norm(E[..., [2, 0, 1], [1, 2, 0]] - E[..., [1, 2, 0], [2, 0, 1]], axis=-1) / 2
    return np.linalg.norm(E[..., :3, 3], axis=-1), np.arctan2(
        sine, (np.trace(E[..., :3, :3], axis1=-2, axis2=-1) - 1) / 2
    )


@pytest.fixture(params=ROBOTS)
def robot(request: pytest.FixtureRequest, make_robot: Callable[[str], Manipulator]) -> Manipulator:
    return make_robot(request.param)


def test_chain_gives_the_poses_of_the_whole_tree(robot: Manipulator) -> None:
    q = random_postures(robot, 50, 1)
    np.testing.assert_allclose(chain_poses(pack_chain(robot), q), reference_poses(robot, q)[:, :3], atol=1e-12)


def test_joints_that_are_not_planned_stay_at_home(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("fetch")
    fixed = replace(robot, arm_dofs=robot.arm_dofs[1:], **{k: getattr(robot, k)[1:] for k in _LIMITS})
    q = random_postures(fixed, 20, 2)
    np.testing.assert_allclose(chain_poses(pack_chain(fixed), q), reference_poses(fixed, q)[:, :3], atol=1e-12)
    assert IkSolver(fixed).solve(fixed.hand_pose(q)).reached.all()


_LIMITS = ("lower", "upper", "velocity", "acceleration", "continuous")


def test_jacobian_matches_finite_differences(robot: Manipulator) -> None:
    chain, weight, step = pack_chain(robot), 0.3, 1e-6
    lines, pose, J = np.empty((len(chain.is_turn), 6)), np.empty((3, 4)), np.empty((len(chain.lower), 6))
    for q in random_postures(robot, 5, 3):
        chain_pose(chain, q, lines, pose)
        chain_jacobian(chain, lines, pose, weight, J)
        for d in range(len(q)):
            plus, minus = (reference_poses(robot, q + sign * step * np.eye(len(q))[d]) for sign in (1, -1))
            W = (plus[:3, :3] - minus[:3, :3]) / (2 * step) @ pose[:, :3].T  # [w] = dR R'
            expected = [*(plus - minus)[:3, 3] / (2 * step), *(weight * W[[2, 0, 1], [1, 2, 0]])]
            np.testing.assert_allclose(J[d], expected, atol=1e-8)


def test_a_pull_leaves_the_hand_alone(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("fetch")
    chain = pack_chain(robot)
    work = work_arrays(chain)
    rng = np.random.default_rng(20)
    for q in 0.9 * random_postures(robot, 5, 20):
        chain_pose(chain, q, work.lines, work.pose)
        chain_jacobian(chain, work.lines, work.pose, 0.3, work.jacobian)
        work.error[:] = wanted = rng.normal(scale=0.01, size=6)
        damped_step(chain, q, 1e-9, work)
        np.testing.assert_allclose(work.jacobian.T @ work.step, wanted, atol=1e-5)
        plain, wish = work.step.copy(), rng.normal(size=8)
        add_pull(wish, work)
        np.testing.assert_allclose(work.jacobian.T @ work.step, wanted, atol=1e-5)
        assert (work.step - plain) @ wish > 0.01


def test_a_joint_at_its_limit_leaves_the_work_to_others(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("fetch")
    chain = pack_chain(robot)
    work = work_arrays(chain)
    q = robot.q_home[robot.arm_dofs].copy()
    q[0] = robot.upper[0]  # the torso is up
    chain_pose(chain, q, work.lines, work.pose)
    chain_jacobian(chain, work.lines, work.pose, 0.3, work.jacobian)
    for dz in (0.01, -0.01):
        work.error[:] = wanted = np.array([0.0, 0.0, dz, 0.0, 0.0, 0.0])
        damped_step(chain, q, 1e-9, work)
        np.testing.assert_allclose(work.jacobian.T @ work.step, wanted, atol=1e-5)
        assert (work.step[0] == 0.0) if dz > 0 else (work.step[0] < 0.0)


def test_solutions_reach_their_pose_within_limits(robot: Manipulator) -> None:
    X = reference_poses(robot, random_postures(robot, 60, 4))
    result = ik_solver(robot).solve(X, starts=16)
    assert result.reached.mean() > 0.98
    off, turned = errors(reference_poses(robot, result.q), X[:, None])
    assert off[result.converged].max() <= 1e-4 + 1e-12
    assert turned[result.converged].max() <= np.radians(0.1) + 1e-9
    np.testing.assert_allclose(off, result.position_error_m, atol=1e-9)
    np.testing.assert_allclose(turned, result.rotation_error_rad, atol=1e-6)
    assert (result.q >= robot.lower).all()
    assert (result.q <= robot.upper).all()
    assert (result.converged | (off > 1e-4) | (turned > np.radians(0.1))).all()


def test_few_near_starts_are_enough(make_robot: Callable[[str], Manipulator]) -> None:
    for name, share in (("fetch", 0.97), ("panda", 0.95), ("six", 0.95)):
        robot = make_robot(name)
        X = reference_poses(robot, random_postures(robot, 200, 5))
        assert ik_solver(robot).solve(X, starts=4).reached.mean() >= share, name
        assert ik_solver(robot).solve(X, starts=16).reached.mean() >= 0.995, name


def test_a_planar_arm_by_hand(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("planar")  # links of 0.3, 0.2 and 0.1 m in the plane
    q = np.array([0.4, 0.9, -0.5])
    x, y = (0.3 * np.cos(0.4) + 0.2 * np.cos(1.3), 0.3 * np.sin(0.4) + 0.2 * np.sin(1.3))  # of the last joint
    X = make_transform_np(rpy_matrix([0, 0, 0.8]), [x + 0.1 * np.cos(0.8), y + 0.1 * np.sin(0.8), 0.0])
    found = IkSolver(robot).solutions(X, max_solutions=5, starts=40)
    # elbow on either side of the line to the last joint, at the angle of the cosine rule
    bend = np.arccos((x * x + y * y - 0.13) / 0.12)
    assert len(found) == 2
    np.testing.assert_allclose(sorted(found[:, 1]), [-bend, bend], atol=2e-3)
    np.testing.assert_allclose(found[found[:, 1] > 0][0], q, atol=2e-3)


def test_batch_equals_loop(robot: Manipulator) -> None:
    solver = ik_solver(robot)
    X = reference_poses(robot, random_postures(robot, 8, 6))
    together = solver.solve(X, starts=5)
    for n in range(len(X)):
        alone = solver.solve(X[n], starts=5)
        for field in ("q", "converged", "distinct", "position_error_m", "rotation_error_rad", "iterations"):
            np.testing.assert_array_equal(getattr(alone, field)[0], getattr(together, field)[n])
    starts = solver.starts(X, 5)
    np.testing.assert_array_equal(solver.solve(X, starts=starts).q, together.q)


def test_same_seed_same_answer_another_seed_another_table(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("panda")
    X = reference_poses(robot, random_postures(robot, 4, 7))
    a, b, c = (IkSolver(robot, seed=seed).solve(X, starts=3).q for seed in (0, 0, 1))
    np.testing.assert_array_equal(a, b)
    assert (a != c).any()


def test_search_stops_at_enough_distinct_solutions(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("panda")
    solver = ik_solver(robot)
    X = reference_poses(robot, random_postures(robot, 20, 8))
    result = solver.solve(X, starts=24, max_solutions=3)
    assert (result.distinct.sum(axis=1) <= 3).all()
    skipped = result.iterations < 0
    assert skipped.any()
    assert not result.converged[skipped].any()
    assert np.isinf(result.position_error_m[skipped]).all()
    for n in range(len(X)):
        q = solver.solutions(X[n], max_solutions=3, starts=24)
        np.testing.assert_array_equal(q, result.solutions(n))
        gaps = np.abs(q[:, None] - q[None]).max(axis=-1)[np.triu_indices(len(q), 1)]
        assert (gaps >= solver.config.apart).all()


def test_equal_starts_are_one_solution(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("six")
    q = random_postures(robot, 1, 9)
    result = solve_ik(robot, reference_poses(robot, q), starts=np.concatenate([q, q, q + 2 * np.pi]))
    assert result.converged.all()
    assert result.distinct.tolist() == [[True, False, False]]
    # half a turn from `q_near` a solution may come back on either side of it
    beside = q + np.random.default_rng(0).normal(scale=1e-2, size=(16, 6))
    result = solve_ik(robot, reference_poses(robot, q), starts=beside, q_near=q[0] - np.sign(q[0]) * np.pi)
    assert result.converged.all()
    assert np.ptp(result.q[0], axis=0).max() > 6.0
    assert result.distinct.sum() == 1


def test_turning_joints_come_back_near_a_posture(make_robot: Callable[[str], Manipulator]) -> None:
    for name in ("fetch", "six"):
        robot = make_robot(name)
        free = robot.upper - robot.lower >= 2 * np.pi
        X = reference_poses(robot, random_postures(robot, 20, 10))
        rng = np.random.default_rng(0)
        for near in rng.uniform(robot.lower, robot.upper, (3, len(free))):
            result = ik_solver(robot).solve(X, starts=4, q_near=near)
            for other in (result.q + 2 * np.pi, result.q - 2 * np.pi):
                allowed = free & (other >= robot.lower) & (other <= robot.upper)
                assert (np.abs(other - near)[allowed] >= np.abs(result.q - near)[allowed] - 1e-9).all()


def test_a_posture_given_is_tried_first(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("fetch")
    for q in random_postures(robot, 10, 11):
        found = ik_solver(robot).solutions(robot.hand_pose(q), max_solutions=1, q_near=q)
        np.testing.assert_array_equal(found, q[None])


def test_solutions_come_in_the_order_of_the_way_from_a_posture(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("fetch")
    near = robot.q_home[robot.arm_dofs]
    for X in reference_poses(robot, random_postures(robot, 10, 19)):
        found = ik_solver(robot).solutions(X, max_solutions=8, q_near=near)
        seconds = (np.abs(found - near) / robot.velocity).max(axis=1)
        assert len(found) > 1
        assert (np.diff(seconds) >= 0).all()


def test_unreachable_poses_say_so(robot: Manipulator) -> None:
    X = reference_poses(robot, random_postures(robot, 5, 12))
    X[:, 0, 3] += 5.0
    result = ik_solver(robot).solve(X, starts=4)
    assert not result.converged.any()
    assert (result.position_error_m > 2.0).all()
    assert np.isfinite(result.position_error_m).all()
    assert ik_solver(robot).solutions(X[0]).shape == (0, len(robot.lower))
    assert not ik_solver(robot).may_reach(X).any()


def test_a_hand_out_of_the_plane_is_unreachable_for_a_planar_arm(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("planar")
    X = reference_poses(robot, random_postures(robot, 5, 13))
    X[:, 2, 3] += 0.05
    result = ik_solver(robot).solve(X, starts=4)
    assert not result.converged.any()
    assert (result.position_error_m >= 0.04).all()


def test_reach_never_refuses_what_can_be_reached(robot: Manipulator) -> None:
    rng = np.random.default_rng(14)
    q = rng.uniform(robot.lower, robot.upper, (20_000, len(robot.lower)))
    ends = rng.random(q.shape) < 0.5  # postures at limits are the outermost
    q = np.where(ends, np.where(rng.random(q.shape) < 0.5, robot.lower, robot.upper), q)
    straight = q * (rng.random(q.shape) < 0.3)  # and stretched ones
    for some in (q, np.clip(straight, robot.lower, robot.upper)):
        assert ik_solver(robot).may_reach(ik_solver(robot).hand_pose(some)).all()


def test_reach_is_a_tight_bound_for_a_stretched_arm(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("planar")
    solver = ik_solver(robot)
    X = robot.hand_pose(np.zeros(3))
    assert solver.may_reach(X[None]).all()
    X[0, 3] += 1e-4
    assert not solver.may_reach(X[None]).any()


def test_reach_follows_what_slides_before_the_shoulder(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("fetch")
    solver = ik_solver(robot)
    torso = int(np.flatnonzero(sliding_dofs(solver.chain))[0])
    assert solver.reach.b_B[2] - solver.reach.a_B[2] == pytest.approx(robot.upper[torso] - robot.lower[torso])
    X = np.tile(np.eye(4), (200, 1, 1))
    X[:, :3, 3] = np.random.default_rng(15).uniform([0.3, -0.7, 0.0], [1.3, 0.7, 2.0], (200, 3))
    may, can = solver.may_reach(X), solver.solve(X, starts=8).reached
    assert not (can & ~may).any()
    assert 0.2 < may.mean() < can.mean() + 0.1


def test_starts_lie_near_their_pose(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("panda")
    X = reference_poses(robot, random_postures(robot, 10, 16))
    starts = ik_starts(robot, 6, X_BH=X)
    spread = ik_starts(robot, 6)
    assert starts.shape == (10, 6, 7)
    assert spread.shape == (6, 7)
    near, _ = errors(reference_poses(robot, starts), X[:, None])
    far, _ = errors(reference_poses(robot, spread)[None], X[:, None])
    assert near.mean() < 0.5 * far.mean()
    assert (np.abs(starts[:, :, None] - starts[:, None]).max(axis=-1) + np.eye(6) >= APART_RAD).all()  # no two alike


def test_the_nearest_postures_of_the_table_are_found(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("six")
    solver = ik_solver(robot)
    for X in reference_poses(robot, random_postures(robot, 5, 17)):
        off, turned = errors(solver.hand_pose(solver.table.q), X)
        first = solver.starts(X, 1)[0, 0]
        chord = 4 * 0.3 * np.sin(turned / 4)  # what the table measures angles by: 8 (1 - |cos(a / 2)|), and its weight
        assert np.array_equal(first, solver.table.q[np.argmin(off**2 + chord**2)])


def test_coupled_joints_are_solved_together(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("coupled")  # one planned joint drives two hinges, one drives a hinge and a slide
    assert {PRISMATIC, REVOLUTE} <= set(robot.tree.joint_types.tolist())
    chain = pack_chain(robot)
    assert len(chain.dof) > len(chain.is_turn) or len(chain.is_turn) > len(chain.lower)
    q = random_postures(robot, 30, 18)
    assert solve_ik(robot, reference_poses(robot, q)).reached.all()


def test_bad_poses_are_refused(make_robot: Callable[[str], Manipulator]) -> None:
    solver = ik_solver(make_robot("panda"))
    good = np.tile(np.eye(4), (3, 1, 1))
    mirrored, scaled, nan, bottom = good.copy(), good.copy(), good.copy(), good.copy()
    mirrored[1, 2, 2], scaled[2] = -1.0, 1.01 * np.eye(4)
    nan[0, 0, 3], bottom[1, 3, 0] = np.nan, 0.1
    for X, index in ((mirrored, 1), (scaled, 2), (nan, 0), (bottom, 1)):
        with pytest.raises(InputError, match=rf"X_BH\[{index}\] is not (rigid|finite)"):
            solver.solve(X)
    for X in (np.eye(3), np.eye(4)[:3], np.zeros((2, 2, 4, 4))):
        with pytest.raises(ShapeError, match="X_BH has shape"):
            solver.solve(X)
    with pytest.raises(ShapeError, match="Use solve for many"):
        solver.solutions(good)
    assert solver.solve(np.zeros((0, 4, 4))).q.shape == (0, 16, 7)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"starts": np.zeros((2, 6))}, "starts has shape"),
        ({"starts": np.zeros((3, 2, 7))}, "starts has shape"),
        ({"starts": np.full((2, 7), np.nan)}, "not finite"),
        ({"starts": 0}, "0 starts"),
        ({"starts": 10**6}, "starts were asked for"),
        ({"q_near": np.zeros(5)}, "panda_joint|one value per joint"),
        ({"max_solutions": 0}, "max_solutions is 0"),
    ],
)
def test_bad_arguments_are_refused(
    make_robot: Callable[[str], Manipulator], arguments: dict[str, object], message: str
) -> None:
    with pytest.raises(NeuralGraspsError, match=message):
        ik_solver(make_robot("panda")).solve(np.eye(4), **arguments)  # type: ignore[arg-type]


def test_contradictory_limits_are_refused(make_robot: Callable[[str], Manipulator]) -> None:
    robot = make_robot("panda")
    for lower in (robot.upper + 0.1, np.full(7, -np.inf), np.full(7, np.nan)):
        with pytest.raises(RobotDescriptionError, match="expected finite numbers, lower < upper"):
            IkSolver(replace(robot, lower=lower))


def test_bad_numbers_are_refused() -> None:
    for name in ("position_tolerance_m", "damping", "max_iterations", "apart"):
        with pytest.raises(InputError, match=name):
            IkConfig(**{name: 0})


def test_objects_that_no_hand_posture_touches_are_beyond_reach(make_robot: Callable[[str], Manipulator]) -> None:
    robot, obj = make_robot("fetch"), load_object("gelatin_box")
    bound, X = ik_solver(robot).reach, np.eye(4)
    X[:3, 3] = [0.6, 0.0, 0.7]
    assert beyond_reach(bound, robot.hand, obj, X) == 0.0
    X[0, 3] = 3.0
    far = beyond_reach(bound, robot.hand, obj, X)
    assert 1.0 < far < 2.2
    X[0, 3] = 3.5
    assert beyond_reach(bound, robot.hand, obj, X) == pytest.approx(far + 0.5, abs=0.02)
