"""The compiled parts of the pose search against finite differences and plain references."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.geometry.se3 import exp_se3
from neuralgrasps.perception.observation import Observation, observe_depth
from neuralgrasps.perception.observation_kernels import distance_outside
from neuralgrasps.perception.pose_kernels import (
    UNMEASURED,
    Terms,
    coarse_scores,
    move,
    normal_equations,
    polish,
    slide,
    stick_out,
)
from neuralgrasps.perception.pose_model import pose_model

TERMS = Terms(0.006, 0.0, 0.3, 0.2, 0.006, 200, 128)
NONE = np.zeros((0, 4))


@pytest.fixture(scope="module")
def wedge(things):
    return pose_model(things["wedge"])


@pytest.fixture(scope="module")
def view(things, look, standing):
    return look(things["wedge"].mesh, standing(things["wedge"], yaw_rad=1.0))


@pytest.fixture(scope="module")
def scene(view, wedge):
    """The view without its table."""
    return observe_depth(view.depth, view.intrinsics, view.mask, reach_m=wedge.diameter)


def _nudged(X, twist, centre):
    out = np.empty((4, 4))
    move(X, np.asarray(centre, np.float64), np.asarray(twist, np.float64), out)
    return out


def _near(X, seed, *, metres=0.006, radians=0.08, centre=(0.0, 0.0, 0.7)):
    rng = np.random.default_rng(seed)
    return _nudged(X, np.concatenate([rng.uniform(-metres, metres, 3), rng.uniform(-radians, radians, 3)]), centre)


def _equations(model, scene, contacts, terms, X, centre):
    H, b = np.full((6, 6), np.nan), np.full(6, np.nan)
    return normal_equations(model, scene, contacts, terms, X, centre, H, b), H, b


def _slope(cost, X, centre, steps):
    """Central differences of cost(pose) along the six twists."""
    return np.array(
        [
            (cost(_nudged(X, h * np.eye(6)[k], centre)) - cost(_nudged(X, -h * np.eye(6)[k], centre))) / (2.0 * h)
            for k, h in enumerate(steps)
        ]
    )


def _flat(table):
    return np.append(table.normal, table.offset_m)


def _contacts(view, wedge):
    points = wedge.points[::200] @ view.X_CO[:3, :3].T + view.X_CO[:3, 3]
    return np.column_stack([points + np.array([0.002, -0.001, 0.003]), np.linspace(0.02, 0.1, len(points))])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("term", ["points", "table near", "table far", "rest", "contact", "all"])
def test_the_gradient_is_that_of_the_cost(wedge, view, scene, term, seed):
    X, centre = _near(view.X_CO, seed, centre=scene.centroid), scene.centroid
    table = _flat(view.table)
    table[3] += 0.03 if term == "table far" else 0.0
    with_table = scene._replace(table=table)
    rest = TERMS._replace(table=0.0)
    # what each adds: (scene, terms, contacts) with it, and without it
    cases = {
        "points": ((scene, TERMS, NONE), None),
        "table near": ((with_table, TERMS._replace(rest=0.0), NONE), (scene, TERMS, NONE)),
        "table far": ((with_table, TERMS._replace(rest=0.0), NONE), (scene, TERMS, NONE)),
        "rest": ((with_table, rest, NONE), (scene, TERMS, NONE)),
        "contact": ((scene, TERMS, _contacts(view, wedge)), (scene, TERMS, NONE)),
        "all": ((with_table, TERMS, _contacts(view, wedge)), None),
    }

    def evaluated(pose):
        first, second = cases[term]
        cost, H, b = _equations(wedge, first[0], first[2], first[1], pose, centre)
        if second is None:
            return cost, H, b
        cost0, H0, b0 = _equations(wedge, second[0], second[2], second[1], pose, centre)
        return cost - cost0, H - H0, b - b0

    cost, H, b = evaluated(X)
    slope = _slope(lambda pose: evaluated(pose)[0], X, centre, [1e-6] * 6)
    assert cost > 0.0 and np.abs(b).max() > 1e-4
    for part in (slice(0, 3), slice(3, 6)):  # per metre, per radian
        np.testing.assert_allclose(-2.0 * b[part], slope[part], atol=1e-3 * np.abs(b[part]).max() + 1e-7)
    np.testing.assert_allclose(H, H.T, atol=1e-9 * np.abs(H).max())
    assert np.linalg.eigvalsh(H).min() > -1e-9 * np.linalg.eigvalsh(H).max()


def test_a_pose_that_leans_far_is_not_pulled_to_a_rest(wedge, view, scene):
    leaning = view.X_CO.copy()
    leaning[:3, :3] = leaning[:3, :3] @ Rotation.from_euler("x", 30.0, degrees=True).as_matrix()
    terms, centre = TERMS._replace(table=0.0), scene.centroid
    with_table = scene._replace(table=_flat(view.table))
    first = _equations(wedge, with_table, NONE, terms, leaning, centre)
    second = _equations(wedge, scene, NONE, terms, leaning, centre)
    assert first[0] > second[0]
    np.testing.assert_allclose(first[2], second[2], atol=1e-12)
    upright = _equations(wedge, with_table, NONE, terms, view.X_CO, centre)
    assert upright[0] - _equations(wedge, scene, NONE, terms, view.X_CO, centre)[0] < 0.05 * (first[0] - second[0])


def _patch(wedge, *, depth_m, seed=0):
    """Surface points before a mask's edge, in an image of very fine pixels: the image's steps then hardly matter."""
    pixels, focal, z = 700, 20_000.0, 0.7
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-0.006, 0.010, 400), rng.uniform(-0.010, 0.010, 400), np.zeros(400)])
    points[:, 2] = rng.uniform(-0.005, 0.005, 400)
    normals = -(points + np.array([0.0, 0.0, z]))
    model = wedge._replace(points=points, normals=normals / np.linalg.norm(normals, axis=1, keepdims=True))
    i, j = np.indices((pixels, pixels), dtype=np.float64)
    outside = np.maximum(np.hypot(i - 500.0, j + 300.0) - 330.0, 0.0)  # a disc's, beyond the left border
    camera = np.array([focal, focal, 0.5 * pixels, 0.5 * pixels])
    scene = Observation(
        np.array([[0.0, 0.0, z]] * 50), np.array([0.0, 0.0, z]), np.full((pixels, pixels), depth_m), outside, camera,
        np.array([0.0, pixels - 1.0, 0.0, pixels - 1.0]), np.ones(4), np.zeros(4),
    )  # fmt: skip
    X = np.eye(4)
    X[2, 3] = z
    return model, scene, X


@pytest.mark.parametrize("depth_m", [1.0, 0.0])
def test_the_gradient_of_free_space_is_that_of_its_cost(wedge, depth_m):
    model, scene, X = _patch(wedge, depth_m=depth_m)
    on, off = TERMS._replace(free=1.0, model_points=400), TERMS._replace(free=0.0)
    assert _equations(model, scene, NONE, off, X, scene.centroid)[0] > 0.0  # of the points, to be taken off

    def evaluated(pose):
        first, second = (_equations(model, scene, NONE, terms, pose, scene.centroid) for terms in (on, off))
        return tuple(a - b for a, b in zip(first, second, strict=True))

    cost, H, b = evaluated(X)
    slope = _slope(lambda pose: evaluated(pose)[0], X, scene.centroid, [1e-3] * 3 + [0.06] * 3)
    assert cost > 0.0
    np.testing.assert_allclose(-2.0 * b[:3], slope[:3], atol=0.02 * np.abs(slope[:3]).max())
    np.testing.assert_allclose(-2.0 * b[3:], slope[3:], atol=0.02 * np.abs(slope[3:]).max())
    assert np.linalg.eigvalsh(H).min() > -1e-9 * np.linalg.eigvalsh(H).max()


def test_what_a_nearer_thing_hides_is_no_free_space(wedge):
    model, scene, X = _patch(wedge, depth_m=0.5)
    on, off = TERMS._replace(free=1.0, model_points=400), TERMS._replace(free=0.0)
    first, second = (_equations(model, scene, NONE, terms, X, scene.centroid) for terms in (on, off))
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a, b)


def test_how_far_a_point_sticks_out_of_the_mask():
    depth, mask = np.full((60, 80), 1.0), np.zeros((60, 80), bool)
    mask[20:40, 30:50] = True
    outside, camera, box = (
        distance_outside(mask),
        np.array([100.0, 100.0, 40.0, 30.0]),
        np.array([0.0, 79.0, 0.0, 59.0]),
    )

    def sticks(x, y, z, depth=depth):
        return stick_out(depth, outside, camera, box, 0.006, x, y, z)

    assert sticks(0.0, 0.0, 0.5)[0] == 0.0  # inside the mask
    # column 60 is 11 pixels right of the mask's last one; one pixel is slack, a pixel is 5 mm wide at 0.5 m
    assert sticks(0.1, 0.0, 0.5) == pytest.approx((10 * 0.005, 30, 60))
    assert sticks(0.1, 0.0, 0.5, np.zeros_like(depth))[0] == pytest.approx(UNMEASURED * 10 * 0.005)
    assert sticks(0.1, 0.0, 0.5, np.full_like(depth, 0.4))[0] == 0.0  # hidden
    assert sticks(0.1, 0.0, 0.5, np.full_like(depth, 0.502))[0] == 0.0  # within the sensor's noise
    assert sticks(0.5, 0.0, 0.5)[0] == 0.0  # not in the image
    assert sticks(0.0, 0.0, -0.5)[0] == 0.0  # behind the camera


def test_the_cost_of_a_small_motion_is_that_of_the_normal_equations(things, wedge, view, scene):
    posed = wedge.points @ view.X_CO[:3, :3].T + view.X_CO[:3, 3]
    facing = ((wedge.normals @ view.X_CO[:3, :3].T) * posed).sum(axis=1) < -0.1
    inward, outward = (wedge.points + shift * wedge.normals for shift in (-0.003, 0.003))
    depth = query_grid_numpy(things["wedge"].sdf, outward) - query_grid_numpy(things["wedge"].sdf, inward)
    exact = np.abs(depth - 0.006) < 1e-4  # 3 mm or more from any edge
    seen = scene._replace(points=np.ascontiguousarray(posed[facing & exact][:200]))
    base, H, b = _equations(wedge, seen, NONE, TERMS, view.X_CO, scene.centroid)
    assert len(seen.points) == 200 and base < 1e-8
    for seed in range(4):
        twist = np.random.default_rng(seed).normal(size=6) * ([2e-4] * 3 + [3e-3] * 3)
        moved = _equations(wedge, seen, NONE, TERMS, _nudged(view.X_CO, twist, scene.centroid), scene.centroid)[0]
        assert moved - base == pytest.approx(twist @ H @ twist - 2.0 * b @ twist, rel=0.1)


def test_moving_is_a_turn_about_the_centre_and_a_shift():
    rng = np.random.default_rng(0)
    for scale in (0.0, 1e-10, 1e-3, 1.0, 3.0):
        X, centre, twist = np.eye(4), rng.normal(size=3), rng.normal(size=6) * scale
        X[:3, :3], X[:3, 3] = Rotation.random(random_state=1).as_matrix(), rng.normal(size=3)
        about, back = np.eye(4), np.eye(4)
        about[:3, 3], back[:3, 3] = centre + twist[:3], -centre
        turn = exp_se3(torch.tensor(np.concatenate([np.zeros(3), twist[3:]]))).numpy()
        np.testing.assert_allclose(_nudged(X, twist, centre), about @ turn @ back @ X, atol=1e-12)


def test_moving_agrees_with_the_exponential_to_first_order():
    X, twist = np.eye(4), np.array([3.0, -2.0, 1.0, 0.5, -1.0, 2.0]) * 1e-5
    np.testing.assert_allclose(_nudged(X, twist, np.zeros(3)), exp_se3(torch.tensor(twist)).numpy(), atol=1e-8)


def _plain_coarse_score(obj, model, scene, X, *, points, model_points, clip, free, margin):
    observed = (scene.points[:points] - X[:3, 3]) @ X[:3, :3]
    first = np.minimum(np.abs(query_grid_numpy(obj.sdf, observed)), clip).mean()
    posed = model.points[:model_points] @ X[:3, :3].T + X[:3, 3]
    facing = ((model.normals[:model_points] @ X[:3, :3].T) * posed).sum(axis=1) < 0.0
    out = []
    for x, y, z in posed[facing]:
        u, v = scene.camera[0] * x / z + scene.camera[2], scene.camera[1] * y / z + scene.camera[3]
        left, right, top, bottom = scene.image_box
        i, j = int(np.floor(v + 0.5)), int(np.floor(u + 0.5))
        i, j = np.clip(i, 0, scene.depth.shape[0] - 1), np.clip(j, 0, scene.depth.shape[1] - 1)
        seen = scene.depth[i, j]
        inside_image = left <= u <= right and top <= v <= bottom
        if not inside_image or 0.0 < seen < z + margin * (0.5 + z * z):
            out.append(0.0)
        else:
            far = max(scene.outside[i, j] - 1.0, 0.0) * z / scene.camera[0]
            out.append(min(far * (1.0 if seen > 0.0 else UNMEASURED), clip))
    return first + free * np.mean(out)


def test_coarse_scores_are_those_of_a_plain_loop(things, wedge, view, scene):
    poses = np.stack([view.X_CO, *(_near(view.X_CO, s, metres=0.04, radians=1.0) for s in range(12))])
    knobs = {"points": 48, "model_points": 64, "clip": 0.02, "free": 1.0, "margin": 0.006}
    fast = np.empty(len(poses))
    coarse_scores(wedge, scene, poses, 48, 64, 0.02, 1.0, 0.006, fast)
    slow = [_plain_coarse_score(things["wedge"], wedge, scene, X, **knobs) for X in poses]
    # the fast one takes the distance at the nearest of coarse nodes
    np.testing.assert_allclose(fast, slow, atol=0.5 / wedge.coarse_inv_spacing)
    assert fast.argmin() == 0
    free_only = np.empty(len(poses))
    coarse_scores(wedge, scene, poses, 48, 64, 0.0, 1.0, 0.006, free_only)
    assert (free_only == 0.0).all()


def test_sliding_brings_a_shifted_pose_back(wedge, view, scene):
    poses = np.stack([view.X_CO] * 3)
    poses[:, :3, 3] += [[0.012, -0.006, 0.01], [-0.01, 0.01, -0.012], [0.0, 0.0, 0.015]]
    before = np.linalg.norm(poses[:, :3, 3] - view.X_CO[:3, 3], axis=1)
    rotations = poses[:, :3, :3].copy()
    slide(wedge, scene, poses, 100, 4)
    after = np.linalg.norm(poses[:, :3, 3] - view.X_CO[:3, 3], axis=1)
    assert (after < 0.003).all() and (after < 0.3 * before).all()
    np.testing.assert_array_equal(poses[:, :3, :3], rotations)


def test_polishing_never_raises_the_cost_and_ends_at_the_truth(wedge, view, scene):
    terms = Terms(0.010, 1.0, 0.1, 0.05, 0.006, 500, 256)
    with_table = scene._replace(table=_flat(view.table))
    starts = np.stack([_near(view.X_CO, s, metres=0.008, radians=0.12, centre=scene.centroid) for s in range(6)])
    poses, cost = starts.copy(), np.empty(6)
    polish(wedge, with_table, NONE, terms, poses, 15, cost)
    for start, pose, after in zip(starts, poses, cost, strict=True):
        assert after < _equations(wedge, with_table, NONE, terms, start, scene.centroid)[0]
        assert after == pytest.approx(_equations(wedge, with_table, NONE, terms, pose, scene.centroid)[0])
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)
        gap = np.linalg.inv(view.X_CO) @ pose
        assert np.linalg.norm(gap[:3, :3] @ wedge.centre + gap[:3, 3] - wedge.centre) < 1e-3
        assert np.rad2deg(Rotation.from_matrix(gap[:3, :3]).magnitude()) < 1.0


def test_polishing_from_anywhere_never_raises_the_cost(wedge, view, scene):
    terms = Terms(0.004, 1.0, 0.1, 0.05, 0.006, 120, 64)
    starts = np.stack([_near(view.X_CO, s, metres=0.05, radians=1.5, centre=scene.centroid) for s in range(40)])
    for steps in (1, 3):
        poses, cost = starts.copy(), np.empty(len(starts))
        polish(wedge, scene, NONE, terms, poses, steps, cost)
        before = np.array([_equations(wedge, scene, NONE, terms, X, scene.centroid)[0] for X in starts])
        assert (cost <= before).all() and (cost < 0.99 * before).sum() > 20
