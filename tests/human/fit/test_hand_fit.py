"""The hand fit: known answers, derivatives, both sides, sizes, and what it says of bad input."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.geometry.camera import Intrinsics, back_project
from neuralgrasps.hands.least_squares import moved_pose
from neuralgrasps.hands.packed import hand_distance_many, pack_shapes
from neuralgrasps.hands.surface import hand_mesh
from neuralgrasps.hands.variants import scaled_hand
from neuralgrasps.human.fit.again import other_starts
from neuralgrasps.human.fit.fit_config import HandFitConfig
from neuralgrasps.human.fit.hand_fit import fit_hand
from neuralgrasps.human.fit.hand_size import fit_size
from neuralgrasps.human.fit.kernels import hand_cost
from neuralgrasps.human.fit.problem import hand_problem
from neuralgrasps.human.fit.steps import curvature
from neuralgrasps.human.fit.view import nearest_allowed
from neuralgrasps.human.postures import usual_postures
from neuralgrasps.human.seen import FittedHand, SeenJoints, Side
from neuralgrasps.human.skeleton import human_hand, joint_points
from neuralgrasps.objects.zoo import load_object
from neuralgrasps.perception.frame import Frame
from neuralgrasps.sim.camera import render_depth_view

CAMERA = Intrinsics(450.0, 450.0, 159.5, 119.5, 320, 240)


def _turn(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    R = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    return R * np.linalg.det(R)


def _posed(seed: int, *, side: Side = "right", scale: float = 0.8) -> FittedHand:
    """A true hand in front of the camera, as a result without residuals."""
    rng = np.random.default_rng(100 + seed)
    hand, usual = scaled_hand(human_hand(side), scale), usual_postures()
    q = np.clip(usual.closed + 0.1 * rng.standard_normal(20), hand.tree.lower, hand.tree.upper)
    X_CH = np.eye(4)
    X_CH[:3, :3] = _turn(seed)
    middle = joint_points(hand, X_CH, q).mean(axis=0)
    X_CH[:3, 3] = [0.0, 0.0, 0.6] - middle
    return FittedHand(
        X_CH=X_CH, q=q, scale=scale, side=side, joints_C=joint_points(hand, X_CH, q), cloud_rms_m=0.0, joint_rms_m=0.0,
        penetration_m=0.0, confidence=1.0,
    )  # fmt: skip


def _frame_of(true: FittedHand) -> tuple[Frame, np.ndarray]:
    """What an exact camera sees of a hand before a wall, and the hand's mask."""
    view = render_depth_view([hand_mesh(true.hand, true.q)], true.X_CH[None], X_WC=np.eye(4), intrinsics=CAMERA)
    mask = view.mesh_index == 0
    return Frame(np.where(mask, view.depth, 1.2), CAMERA), mask


def _seen(true: FittedHand, *, noise_m: float, seed: int = 0, mask: np.ndarray | None = None) -> SeenJoints:
    noise = noise_m * np.random.default_rng(seed).standard_normal((21, 3))
    return SeenJoints(points_C=true.joints_C + noise, weight=np.ones(21), mask=mask, side=true.side, source="test")


def _surface_rms(fit: FittedHand, true: FittedHand) -> float:
    """Root mean square distance of points of the true hand's front to the fitted hand."""
    frame, mask = _frame_of(true)
    points = back_project(frame.depth, CAMERA, mask=mask)[::5]
    out = np.empty(len(points))
    hand_distance_many(pack_shapes(fit.hand), fit.X_CH.copy(), fit.q.copy(), points, out)
    return float(np.sqrt(np.mean(out**2)))


@pytest.mark.parametrize("side", ["right", "left"])
def test_exact_joints_and_cloud_give_the_hand_back(side: Side) -> None:
    true = _posed(1, side=side)
    frame, mask = _frame_of(true)
    fit = fit_hand(
        _seen(true, noise_m=0.0, mask=mask),
        back_project(frame.depth, CAMERA, mask=mask),
        side=side,
        scale=0.8,
        frame=frame,
    )
    assert np.abs(fit.joints_C - true.joints_C).max() < 0.006
    assert fit.cloud_rms_m < 0.001
    assert fit.side == side
    np.testing.assert_allclose(fit.joints_C, joint_points(fit.hand, fit.X_CH, fit.q), atol=1e-9)
    assert np.linalg.det(fit.X_CH[:3, :3]) == pytest.approx(1.0)


def test_the_cloud_mends_noisy_joints() -> None:
    before, after = [], []
    for seed in range(4):
        true = _posed(seed)
        frame, mask = _frame_of(true)
        seen = _seen(true, noise_m=0.01, seed=seed, mask=mask)
        before.append(_surface_rms(fit_hand(seen, None, side="right", scale=0.8), true))
        cloud = back_project(frame.depth, CAMERA, mask=mask)
        after.append(_surface_rms(fit_hand(seen, cloud, side="right", scale=0.8, frame=frame), true))
    assert np.mean(after) < 0.002
    assert np.mean(after) < 0.5 * np.mean(before)


def test_points_are_of_the_hands_front() -> None:
    errors = []
    for seed in range(5):
        true = _posed(seed)
        frame, mask = _frame_of(true)
        seen = _seen(true, noise_m=0.004, seed=seed)
        seen.points_C[:, 2] -= 0.022  # the hand's back comes to where its front is
        fit = fit_hand(seen, back_project(frame.depth, CAMERA, mask=mask), side="right", scale=0.8)
        errors.append(np.linalg.norm(fit.joints_C - true.joints_C, axis=1).mean())
    assert max(errors) < 0.006


def test_a_left_hand_is_fitted_as_its_mirror_image() -> None:
    true = _posed(2)
    frame, mask = _frame_of(true)
    seen, cloud = _seen(true, noise_m=0.01, mask=mask), back_project(frame.depth, CAMERA, mask=mask)
    flip = np.array([-1.0, 1.0, 1.0])
    k = CAMERA
    mirrored_camera = Intrinsics(k.fx, k.fy, k.width - 1 - k.cx, k.cy, k.width, k.height)
    mirrored = SeenJoints(
        points_C=seen.points_C * flip, weight=seen.weight, mask=mask[:, ::-1], side="left", source="test"
    )
    right = fit_hand(seen, cloud, side="right", scale=0.8)
    left = fit_hand(mirrored, cloud * flip, side="left", scale=0.8)
    np.testing.assert_allclose(left.joints_C, right.joints_C * flip, atol=1e-9)
    np.testing.assert_allclose(left.q, right.q, atol=1e-9)
    in_view = fit_hand(
        mirrored, cloud * flip, side="left", scale=0.8, frame=Frame(frame.depth[:, ::-1], mirrored_camera)
    )
    assert np.abs(in_view.joints_C - left.joints_C).max() < 0.002  # free space holds in the mirror image too


def test_the_wrong_side_leaves_more() -> None:
    for seed in range(4):
        true = _posed(seed)
        frame, mask = _frame_of(true)
        seen, cloud = _seen(true, noise_m=0.005, mask=mask), back_project(frame.depth, CAMERA, mask=mask)
        right = fit_hand(seen, cloud, side="right", scale=0.8)
        left = fit_hand(seen, cloud, side="left", scale=0.8)
        assert left.joint_rms_m > 1.5 * right.joint_rms_m
        assert left.confidence < right.confidence


def test_derivatives_are_those_of_the_cost() -> None:
    true, obj = _posed(3), load_object("potted_meat_can")
    X_CO = np.eye(4)
    X_CO[:3, 3] = true.joints_C[9] + [0.01, 0.0, 0.02]
    frame, mask = _frame_of(true)
    cloud = 0.995 * back_project(frame.depth, CAMERA, mask=mask)[::40]  # 3 mm before the hand
    problem = hand_problem(
        _seen(true, noise_m=0.01), cloud, side="right", scale=None, obj=(obj, X_CO), frame=None, config=HandFitConfig()
    )
    packed = pack_shapes(human_hand())
    _, slope = hand_cost(packed, problem, true.X_CH, true.q, 0.8)

    def cost(step: np.ndarray) -> float:
        X = true.X_CH.copy()
        moved_pose(true.X_CH, np.append(step[:3] * 0.8, step[3:6]), X)
        return float(hand_cost(packed, problem, X, true.q + step[6:26], 0.8 * np.exp(step[26]))[0])

    numeric = [(cost(1e-6 * axis) - cost(-1e-6 * axis)) / 2e-6 for axis in np.eye(27)]
    np.testing.assert_allclose(slope, numeric, atol=1e-5 * np.abs(slope).max())


def test_derivatives_of_points_that_the_front_hides() -> None:
    """Of points behind the hand, which count by how far along the ray its front is."""
    true = _posed(3)
    frame, mask = _frame_of(true)
    cloud = 1.03 * back_project(frame.depth, CAMERA, mask=mask)[::400]
    config = HandFitConfig(cloud_width_m=0.05)
    seen = _seen(true, noise_m=0.0)
    problem = hand_problem(seen, cloud, side="right", scale=0.8, obj=None, frame=None, config=config)
    packed, off = pack_shapes(human_hand()), []
    for point in cloud:
        alone = problem._replace(joint_weight=np.zeros(21), cloud_C=point[None].copy())
        slope = hand_cost(packed, alone, true.X_CH, true.q, 0.8)[1][:3]
        costs = []
        for step in np.concatenate([np.eye(3), -np.eye(3)]) * 1e-6:
            X = true.X_CH.copy()
            X[:3, 3] += 0.8 * X[:3, :3] @ step
            costs.append(hand_cost(packed, alone, X, true.q, 0.8)[0])
        numeric = (np.array(costs[:3]) - costs[3:]) / 2e-6
        off.append(np.linalg.norm(slope - numeric) / max(np.linalg.norm(numeric), 1e-9))
    assert len(off) > 5 and np.median(off) < 0.1


def test_joints_stay_within_limits() -> None:
    true = _posed(4)
    fit, tree = fit_hand(_seen(true, noise_m=0.05, seed=1), None, side="right", scale=0.8), human_hand().tree
    assert (fit.q >= tree.lower).all()
    assert (fit.q <= tree.upper).all()
    assert fit.confidence < 0.5
    assert fit.reasons


def test_unknown_joints_and_stray_points_do_little() -> None:
    true = _posed(5)
    frame, mask = _frame_of(true)
    cloud = back_project(frame.depth, CAMERA, mask=mask)
    stray = cloud[::20] + np.array([0.0, 0.0, 0.05])
    seen = _seen(true, noise_m=0.004)
    seen.points_C[[3, 4, 11, 12]] = np.nan
    fit = fit_hand(seen, np.concatenate([cloud, stray]), side="right", scale=0.8)
    assert _surface_rms(fit, true) < 0.002


def test_the_size_is_found_from_frames() -> None:
    for scale in (0.72, 0.86):
        hands = [_posed(seed, scale=scale) for seed in range(4)]
        seen = [_seen(hand, noise_m=0.005, seed=i) for i, hand in enumerate(hands)]
        clouds = [back_project(frame.depth, CAMERA, mask=mask) for frame, mask in map(_frame_of, hands)]
        assert fit_size(seen, clouds, side="right") == pytest.approx(scale, rel=0.02)


def test_a_fit_goes_on_from_the_last_frame() -> None:
    true = _posed(6)
    frame, mask = _frame_of(true)
    fit = fit_hand(None, back_project(frame.depth, CAMERA, mask=mask), side="right", scale=None, start=true)
    assert np.linalg.norm(fit.joints_C - true.joints_C, axis=1).mean() < 0.003


def test_nothing_seen_is_no_hand_to_trust() -> None:
    true = _posed(6)
    unseen = _seen(true, noise_m=0.0)
    unseen.points_C[:] = np.nan
    fit = fit_hand(unseen, None, side="right", scale=0.8, start=true)
    assert fit.confidence < 0.01
    assert fit.reasons == ("neither joints nor depth points of the hand: nothing says where it is",)


def test_a_start_is_kept_where_no_joint_tells_of_the_hand() -> None:
    true = _posed(6)
    frame, mask = _frame_of(true)
    unseen = _seen(true, noise_m=0.0)
    unseen.points_C[:] = np.nan
    cloud = back_project(frame.depth, CAMERA, mask=mask)
    problem = hand_problem(unseen, cloud, side="right", scale=0.8, obj=None, frame=None, config=HandFitConfig())
    X, q, sizes = other_starts(problem, true.X_CH, true.q, 0.8)
    np.testing.assert_allclose(X[:, :3, 3], true.X_CH[None, :3, 3].repeat(2, axis=0), atol=0.1)
    assert np.isfinite(q).all()
    assert (sizes == 0.8).all()


def test_the_curvature_of_a_joint_at_its_limit_stands_alone() -> None:
    true, packed = _posed(3), pack_shapes(human_hand())
    seen = _seen(true, noise_m=0.02)
    problem = hand_problem(seen, None, side="right", scale=0.8, obj=None, frame=None, config=HandFitConfig())
    problem = problem._replace(q_mean=packed.lower - 0.5)  # as if fingers were usually bent back
    pressed = 0
    for j, q in enumerate(np.repeat(true.q[None], 20, axis=0)):
        q[j] = packed.lower[j]
        A, _ = curvature(packed, problem, true.X_CH, q, 0.8)
        others = np.delete(np.arange(27), 6 + j)
        held = hand_cost(packed, problem, true.X_CH, q, 0.8)[1][6 + j] > 0.0
        pressed += held
        assert A[6 + j, others].any() != held
        assert A[others, 6 + j].any() != held
        assert A[6 + j, 6 + j] > 0.0
    assert 0 < pressed < 20


def test_the_hand_leaves_the_object() -> None:
    true, obj = _posed(7), load_object("potted_meat_can")
    X_CO = np.eye(4)
    X_CO[:3, 3] = true.joints_C[[8, 12]].mean(axis=0) + np.array([0.0, 0.0, 0.02])
    seen = _seen(true, noise_m=0.005)
    deep = fit_hand(seen, None, side="right", scale=0.8, obj=(obj, X_CO), config=HandFitConfig(deep_sd_m=10.0))
    clear = fit_hand(seen, None, side="right", scale=0.8, obj=(obj, X_CO))
    assert deep.penetration_m > 0.008
    assert clear.penetration_m < 0.5 * deep.penetration_m


def test_the_nearest_allowed_pixel() -> None:
    allowed = np.random.default_rng(0).random((23, 31)) < 0.03
    near = np.empty((23, 31, 2), np.int64)
    nearest_allowed(allowed, near)
    places = np.argwhere(allowed)
    grid = np.stack(np.meshgrid(np.arange(23), np.arange(31), indexing="ij"), axis=-1)
    true = np.linalg.norm(grid[:, :, None] - places, axis=-1).min(axis=-1)
    assert allowed[near[..., 0], near[..., 1]].all()
    assert np.abs(np.linalg.norm(near - grid, axis=-1) - true).max() < 0.3  # two passes are not quite exact


def test_bad_input_is_named() -> None:
    true = _posed(8)
    with pytest.raises(InputError, match="neither joints nor a start"):
        fit_hand(None, np.zeros((50, 3)), side="right", scale=0.8)
    with pytest.raises(InputError, match="scale is -1"):
        fit_hand(_seen(true, noise_m=0.0), None, side="right", scale=-1.0)
    with pytest.raises(ShapeError, match="cloud_C has shape"):
        fit_hand(_seen(true, noise_m=0.0), np.zeros((50, 2)), side="right", scale=0.8)
    with pytest.raises(InputError, match="expected as many"):
        fit_size([], [], side="right")
    seen = _seen(true, noise_m=0.0)
    seen.points_C[3:] = np.nan
    with pytest.raises(InputError, match="fewer than 4"):
        fit_hand(seen, None, side="right", scale=0.8)
