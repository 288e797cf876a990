"""The evidence of an image for a pose: rays against rasterised meshes, and what must and must not cost."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.geometry.raster import depth_images
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.perception.observation import observe_depth
from neuralgrasps.perception.pose_kernels import UNMEASURED, move
from neuralgrasps.perception.pose_model import pose_model
from neuralgrasps.perception.pose_visibility import (
    CONFIRMED,
    COST,
    COVERED,
    EVIDENCE,
    EXPLAINED,
    FREE,
    IN_MASK,
    _cast,
    ray_evidence,
)

TOLERANCE_M, CLIP_M, MARGIN_M = 0.005, 0.020, 0.006


def _at(x, y, z):
    X = np.eye(4)
    X[:3, 3] = [x, y, z]
    return X


def _evidence(model, scene, *poses, stride=1):
    out = np.full((len(poses), EVIDENCE), np.nan)
    ray_evidence(model, scene, np.stack(poses), stride, TOLERANCE_M, CLIP_M, MARGIN_M, out)
    return out if len(poses) > 1 else out[0]


def _scene(seen, model):
    return observe_depth(seen.depth, seen.intrinsics, seen.mask, reach_m=model.diameter)


def _moved(X, v, w, centre):
    out = np.empty((4, 4))
    move(X, np.asarray(centre, np.float64), np.array([*v, *w]), out)
    return out


def _camera(scene):
    fx, fy, cx, cy = scene.camera
    return Intrinsics(fx, fy, cx, cy, scene.depth.shape[1], scene.depth.shape[0])


@pytest.fixture(scope="module", params=["corner", "rimmed", "box"])
def posed(request, things, look, standing):
    """(object, its arrays, what is seen of it, the same thinned)."""
    obj = things[request.param]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0))
    model = pose_model(obj)
    return obj, model, seen, _scene(seen, model)


def _cast_image(model, X, scene, start=1e-3, limit=1e3):
    inverse = np.ascontiguousarray(np.linalg.inv(X)[:3])
    hit, hidden = np.zeros(scene.depth.shape), np.zeros(scene.depth.shape, bool)
    for i, j in np.ndindex(hit.shape):
        rx, ry = (j - scene.camera[2]) / scene.camera[0], (i - scene.camera[3]) / scene.camera[1]
        hit[i, j], hidden[i, j] = _cast(model, inverse, rx, ry, start, limit)
    return hit, hidden


def test_rays_meet_the_mesh_where_it_is_rasterised(posed):
    obj, model, seen, scene = posed
    for seed in range(3):
        rng = np.random.default_rng(seed)
        X = _moved(seen.X_CO, rng.uniform(-0.01, 0.01, 3), rng.uniform(-1.0, 1.0, 3), scene.centroid)
        true = depth_images(obj.mesh, X[None], _camera(scene))[0]
        hit, hidden = _cast_image(model, X, scene)
        covered = np.isfinite(true)
        far = ndimage.binary_dilation(covered)
        assert covered.sum() > 500
        assert (hit[covered] > 0.0).mean() > 0.99  # one in a hundred may graze past
        assert not (hit[~far] > 0.0).any() and not hidden.any()
        # no edge, and no surface seen at so flat an angle that the hit's tolerance reaches far along the ray
        finite = np.where(covered, true, 9.0)
        step = ndimage.maximum_filter(finite, 3) - ndimage.minimum_filter(finite, 3)
        smooth = ndimage.binary_erosion(covered) & (step < 0.006) & (hit > 0.0)
        assert smooth.sum() > 0.4 * covered.sum()
        off = np.abs(hit[smooth] - true[smooth])
        assert np.percentile(off, 97) < 1e-3 and off.max() < 8e-3


def test_a_ray_ends_at_its_limit_and_starts_where_it_is_told(posed):
    _, model, seen, scene = posed
    whole, _ = _cast_image(model, seen.X_CO, scene)
    nearest = whole[whole > 0.0].min()
    hit, hidden = _cast_image(model, seen.X_CO, scene, limit=nearest - 0.01)
    assert (hit == 0.0).all() and hidden[whole > 0.0].all()
    hit, hidden = _cast_image(model, seen.X_CO, scene, start=whole.max() + 0.2)
    assert (hit == 0.0).all() and not hidden.any()


def _plain_evidence(obj, X, scene, stride):
    """The definition, with a rasterised mesh in place of rays."""
    predicted = depth_images(obj.mesh, X[None], _camera(scene))[0]
    i, j = (a.ravel() for a in np.indices(scene.depth.shape))
    grid = (i % stride == 0) & (j % stride == 0)
    z, hit, outside = scene.depth.ravel()[grid], predicted.ravel()[grid], scene.outside.ravel()[grid]
    rays = np.stack([(j - scene.camera[2]) / scene.camera[0], (i - scene.camera[3]) / scene.camera[1], 0 * i + 1.0], 1)
    rays = rays[grid]
    inside = (outside == 0.0) & (z > 0.0)
    d = np.abs(query_grid_numpy(obj.sdf, (rays * z[:, None] - X[:3, 3]) @ X[:3, :3]))
    near = (d < CLIP_M) & (hit < z + 0.03)
    d = np.where(near, np.maximum(d, np.minimum(0.5 * np.abs(hit - z), CLIP_M)), d)[inside]
    cost = (0.5 * d**2 / (d**2 + TOLERANCE_M**2) + 0.5 * np.minimum(d / CLIP_M, 1.0)).sum()
    beside = (outside > 0.0) & np.isfinite(hit) & ((z == 0.0) | (hit < z - MARGIN_M * (0.5 + z**2)))
    off = np.maximum(outside[beside] - 1.0, 0.0) * hit[beside] / scene.camera[0]
    share = np.where(z[beside] > 0.0, 1.0, UNMEASURED)
    cost += (share * off**2 / (off**2 + TOLERANCE_M**2)).sum()
    free = (share * np.minimum(off / TOLERANCE_M, 1.0)).sum()
    return np.array([cost, (d < TOLERANCE_M).sum(), free]) / inside.sum(), inside.sum()


@pytest.mark.parametrize("stride", [1, 3])
def test_evidence_is_that_of_a_rasterised_mesh(posed, stride):
    obj, model, seen, scene = posed
    poses = [seen.X_CO]
    for seed in range(6):
        rng = np.random.default_rng(seed)
        size = 0.3 * (seed + 1)
        poses.append(
            _moved(seen.X_CO, size * rng.uniform(-0.02, 0.02, 3), size * rng.uniform(-1, 1, 3), scene.centroid)
        )
    fast = _evidence(model, scene, *poses, stride=stride)
    for X, row in zip(poses, fast, strict=True):
        slow, count = _plain_evidence(obj, X, scene, stride)
        assert row[IN_MASK] == count > 100
        assert row[COST] == pytest.approx(slow[0], abs=0.05)
        assert row[EXPLAINED] == pytest.approx(slow[1], abs=0.04)
        assert row[FREE] == pytest.approx(slow[2], abs=0.06)
    assert np.ptp(fast[:, COST]) > 0.3


def test_the_truth_costs_nothing(posed):
    _, model, seen, scene = posed
    row = _evidence(model, scene, seen.X_CO)
    assert row[COST] < 0.02
    assert row[EXPLAINED] > 0.97 and row[CONFIRMED] > 0.95 and row[COVERED] > 0.85
    assert row[FREE] < 0.01


def test_an_object_elsewhere_explains_nothing(posed):
    _, model, seen, scene = posed
    for shift in ([0.3, 0.0, 0.0], [0.0, 0.0, 3.0], [0.0, 0.0, -3.0]):
        row = _evidence(model, scene, _at(*shift) @ seen.X_CO)
        assert row[COST] > 0.98
        assert row[EXPLAINED] == 0.0 and row[CONFIRMED] == 0.0


def test_what_a_nearer_thing_hides_costs_nothing(things, look, standing):
    obj = things["corner"]
    screen = (box_mesh([0.004, 0.04, 0.10]), _at(0.14, 0.09, 0.10))
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0), others=[screen])
    alone = look(obj.mesh, standing(obj, yaw_rad=1.0))
    model = pose_model(obj)
    assert 0.2 < seen.mask.sum() / alone.mask.sum() < 0.8
    row = _evidence(model, _scene(seen, model), seen.X_CO)
    assert row[COST] < 0.02 and row[FREE] < 0.01
    # the same mask where the screen is not: the camera saw past what should be there
    gone = np.where(seen.masks[0], alone.depth + 0.2, seen.depth)
    scene = observe_depth(gone, seen.intrinsics, seen.mask, reach_m=model.diameter)
    assert _evidence(model, scene, seen.X_CO)[COST] > 0.2
    # nothing measured there: a weak hint only
    lost = np.where(seen.masks[0], 0.0, seen.depth)
    scene = observe_depth(lost, seen.intrinsics, seen.mask, reach_m=model.diameter)
    assert 0.0 < _evidence(model, scene, seen.X_CO)[COST] < 0.15


def test_a_model_that_sticks_out_before_the_background_costs(things, look, standing):
    box = things["box"]
    seen = look(box.mesh, standing(box, yaw_rad=0.345))
    model = pose_model(box)
    scene = _scene(seen, model)
    side = seen.X_CO[:3, 1]  # along the face that the camera sees
    costs = [_evidence(model, scene, _moved(seen.X_CO, s * side, [0, 0, 0], scene.centroid)) for s in (0.0, 0.01, 0.02)]
    free = [row[FREE] for row in costs]
    assert free[0] < 0.01 and free[0] < free[1] < free[2] and free[2] > 0.05
    assert costs[0][COST] < costs[1][COST] < costs[2][COST]
    # behind the background it is hidden
    buried = _evidence(model, scene, _at(0.0, 0.0, 0.5) @ seen.X_CO)
    assert buried[FREE] == 0.0


def test_a_surface_before_the_measured_one_does_not_explain_it(things, look, standing):
    # the far inner side of a bend touches the measured points, its near side hides them: distances alone are fooled
    box = things["box"]
    seen = look(box.mesh, standing(box, yaw_rad=0.345))
    model = pose_model(box)
    scene = _scene(seen, model)
    sight = scene.centroid / np.linalg.norm(scene.centroid)
    nearer = _moved(seen.X_CO, -0.06 * sight, [0.0, 0.0, 0.0], scene.centroid)
    row = _evidence(model, scene, nearer)
    assert row[COST] > 0.7


def test_every_third_pixel_says_the_same(posed):
    _, model, seen, scene = posed
    X = _moved(seen.X_CO, [0.004, 0.0, 0.003], [0.1, -0.1, 0.1], scene.centroid)
    all_pixels, third = (_evidence(model, scene, X, stride=s) for s in (1, 3))
    np.testing.assert_allclose(
        third[[COST, EXPLAINED, CONFIRMED, COVERED]], all_pixels[[COST, EXPLAINED, CONFIRMED, COVERED]], atol=0.08
    )
    assert third[IN_MASK] == pytest.approx(all_pixels[IN_MASK] / 9, rel=0.2)
