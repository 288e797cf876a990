"""What the pose search takes of a view, against plain references."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.geometry.camera import Intrinsics, back_project, project
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.perception.observation import observe_around, observe_depth, observe_points
from neuralgrasps.perception.observation_kernels import distance_outside, filled
from neuralgrasps.perception.pose_model import pose_model

FINE = Intrinsics.from_fov(np.deg2rad(35.0), 640, 480)
REACH_M = 0.17


def _placed(x, y, z):
    X = np.eye(4)
    X[:3, 3] = [x, y, z]
    return X


@pytest.fixture(scope="module")
def fine(things, look, standing):
    """A box before a wall, so that every pixel is measured, in an image of 640 x 480."""
    wall = (box_mesh([2.0, 2.0, 0.01]), _placed(0.0, 0.0, -0.3))
    return look(things["box"].mesh, standing(things["box"], yaw_rad=1.0), others=[wall], intrinsics=FINE)


def test_distance_outside_is_the_euclidean_distance_transform():
    rng = np.random.default_rng(0)
    shapes = [(1, 1), (1, 40), (40, 1), (17, 23), (64, 31), (50, 80)]
    for height, width in shapes:
        for share in (0.001, 0.02, 0.3, 0.9):
            mask = rng.random((height, width)) < share
            mask[rng.integers(height), rng.integers(width)] = True
            np.testing.assert_allclose(distance_outside(mask), ndimage.distance_transform_edt(~mask), atol=1e-9)


def test_distance_from_an_empty_mask_is_longer_than_the_image():
    assert distance_outside(np.zeros((30, 40), bool)).min() >= 50.0 - 1e-9


def test_holes_next_to_a_surface_take_the_nearest_depth_within_two_pixels():
    rng = np.random.default_rng(1)
    depth = np.where(rng.random((60, 70)) < 0.15, rng.uniform(0.5, 2.0, (60, 70)), 0.0)
    mask = rng.random((60, 70)) < 0.2
    far = np.where(depth > 0.0, depth, np.inf)
    nearest = ndimage.minimum_filter(far, size=5, mode="constant", cval=np.inf)
    expected = np.where((depth > 0.0) | mask, depth, np.where(np.isfinite(nearest), nearest, 0.0))
    np.testing.assert_array_equal(filled(depth, mask), expected)
    assert (expected == 0.0).any() and (expected != depth).any()


def _pixels(scene, intrinsics):
    """Where in the whole image the pixels of the thinned one lie: (h, w) rows and columns, from the ray of each."""
    i, j = np.indices(scene.depth.shape, dtype=np.float64)
    rays = [(j - scene.camera[2]) / scene.camera[0], (i - scene.camera[3]) / scene.camera[1], np.ones_like(i)]
    uv = project(np.stack(rays, axis=-1), intrinsics)
    np.testing.assert_allclose(uv, np.rint(uv), atol=1e-6)
    return np.rint(uv[..., 1]).astype(int), np.rint(uv[..., 0]).astype(int)


@pytest.mark.parametrize("side", ["middle", "left top", "right bottom"])
def test_a_thinned_image_shows_the_same_depth_along_the_same_ray(fine, side):
    depth, mask, k = fine.depth, fine.mask, FINE
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    if side == "left top":  # the image ends within the object
        cut = (slice(rows[0] + 20, None), slice(columns[0] + 30, None))
    elif side == "right bottom":
        cut = (slice(None, rows[-1] - 20), slice(None, columns[-1] - 30))
    else:
        cut = (slice(None), slice(None))
    top, left = cut[0].start or 0, cut[1].start or 0
    depth, mask = depth[cut], mask[cut]
    k = Intrinsics(k.fx, k.fy, k.cx - left, k.cy - top, depth.shape[1], depth.shape[0])
    scene = observe_depth(depth, k, mask, reach_m=REACH_M)
    row, column = _pixels(scene, k)
    stride = row[1, 0] - row[0, 0]
    assert stride == column[0, 1] - column[0, 0] == round(np.sqrt(mask.sum() / 2500)) > 1
    np.testing.assert_allclose(scene.depth, depth[row, column])
    np.testing.assert_array_equal(scene.outside == 0.0, mask[row, column])
    # the image's border in pixels of the thinned one
    first, last, upper, lower = scene.image_box
    assert (first * stride + column[0, 0], last * stride + column[0, 0]) == pytest.approx((0, k.width - 1))
    assert (upper * stride + row[0, 0], lower * stride + row[0, 0]) == pytest.approx((0, k.height - 1))
    # as much around the mask as the object may reach
    reach = REACH_M / np.percentile(depth[mask], 6) * k.fx - 2 * stride
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    for shown, seen, size in ((column[0], columns, k.width), (row[:, 0], rows, k.height)):
        assert shown[0] <= max(0.0, seen[-1] - reach)
        assert shown[-1] >= min(size - 1, seen[0] + reach) - stride


def test_the_points_are_those_of_the_mask(fine, things):
    scene = observe_depth(fine.depth, FINE, fine.mask, reach_m=REACH_M)
    assert len(scene.points) == 4000
    inner = ndimage.binary_erosion(fine.mask, iterations=3)
    uv = np.rint(project(scene.points, FINE)).astype(int)
    assert fine.mask[uv[:, 1], uv[:, 0]].all()
    seen = scene.points[inner[uv[:, 1], uv[:, 0]]]
    to_surface = query_grid_numpy(things["box"].sdf, (seen - fine.X_CO[:3, 3]) @ fine.X_CO[:3, :3])
    assert len(seen) > 3000 and np.abs(to_surface).max() < 5e-4
    np.testing.assert_allclose(scene.centroid, scene.points.mean(axis=0))
    # any first part is a fair sample
    np.testing.assert_allclose(scene.points[:400].mean(axis=0), scene.centroid, atol=0.004)


def test_pixels_that_fly_between_object_and_wall_are_no_points(fine):
    depth = fine.depth.copy()
    rim = np.argwhere(fine.mask & ~ndimage.binary_erosion(fine.mask))[::3]
    depth[rim[:, 0], rim[:, 1]] += 0.06
    scene = observe_depth(depth, FINE, fine.mask, reach_m=REACH_M)
    assert scene.points[:, 2].max() < fine.depth[fine.mask].max() + 0.005
    assert len(rim) > 100


@pytest.mark.parametrize("nothing", [np.nan, np.inf, -np.inf, -1.0])
def test_all_ways_of_saying_not_measured_are_one(fine, nothing):
    rng = np.random.default_rng(0)
    lost = rng.random(fine.depth.shape) < 0.2
    zeros, other = np.where(lost, 0.0, fine.depth), np.where(lost, nothing, fine.depth)
    first, second = (observe_depth(d, FINE, fine.mask, reach_m=REACH_M) for d in (zeros, other))
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a, b)


def test_what_lies_far_around_changes_nothing(look, things, standing):
    coarse = Intrinsics.from_fov(np.deg2rad(50.0), 320, 240)
    seen = look(things["box"].mesh, standing(things["box"], yaw_rad=1.0), intrinsics=coarse)
    first = observe_depth(seen.depth, coarse, seen.mask, reach_m=REACH_M)
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.3, 2.0, (400, 500)).astype(np.float32)
    mask = np.zeros((400, 500), bool)
    inside = (slice(37, 37 + 240), slice(91, 91 + 320))
    depth[inside], mask[inside] = seen.depth, seen.mask
    larger = replace(coarse, cx=coarse.cx + 91, cy=coarse.cy + 37, width=500, height=400)
    second = observe_depth(depth, larger, mask, reach_m=REACH_M)
    for name, a, b in zip(first._fields, first, second, strict=True):
        if name == "image_box":
            assert (b[[1, 3]] - b[[0, 2]] > a[[1, 3]] - a[[0, 2]]).all()
        else:
            np.testing.assert_allclose(a, b, atol=1e-12)


def test_sides_that_something_hides_are_known(look, things, standing):
    upright = standing(things["box"], yaw_rad=0.345)
    towards = np.array([np.cos(0.345), np.sin(0.345)])  # of the camera
    aside = np.array([-towards[1], towards[0]])  # the image's right
    for sign, side, other in ((1.0, 1, 0), (-1.0, 0, 1)):
        place = 0.10 * towards + sign * 0.055 * aside
        post = (box_mesh([0.02, 0.02, 0.15]), _placed(*place, 0.15))
        seen = look(things["box"].mesh, upright, others=[post])
        scene = observe_depth(seen.depth, seen.intrinsics, seen.mask, reach_m=REACH_M)
        assert scene.free[side] < 0.3
        assert scene.free[other] > 0.9
    free = look(things["box"].mesh, upright)
    assert observe_depth(free.depth, free.intrinsics, free.mask, reach_m=REACH_M).free.min() > 0.9
    column = int(np.flatnonzero(free.mask.any(axis=0)).mean())  # the image ends in the middle of the object
    k = replace(free.intrinsics, width=column)
    cut = observe_depth(free.depth[:, :column], k, free.mask[:, :column], reach_m=REACH_M)
    assert cut.free[1] < 0.1 and cut.free[0] > 0.9


def test_points_without_an_image_lie_on_the_pixels_of_their_own(fine):
    points = fine.points_C[::7]
    scene = observe_points(points, reach_m=REACH_M)
    uv = scene.points[:, :2] / scene.points[:, 2:] * scene.camera[:2] + scene.camera[2:]
    column, row = np.rint(uv).astype(int).T
    assert (scene.outside[row, column] == 0.0).all()
    assert (scene.depth[row, column] <= scene.points[:, 2] + 1e-12).all()  # the nearest of a pixel
    assert ((scene.depth > 0.0) == (scene.outside == 0.0)).all()
    shown = np.count_nonzero(scene.depth)
    assert 0.2 * len(points) < shown <= len(points)
    # no point of an object of that reach falls beside the image
    margin = REACH_M / scene.points[:, 2].max() * scene.camera[0]
    assert uv.min() >= margin - 1.0 and (np.array(scene.depth.shape[::-1]) - uv).min() >= margin - 1.0
    np.testing.assert_array_equal(np.sort(scene.points, axis=0), np.sort(points, axis=0))


def test_points_on_a_line_have_a_small_image_too():
    line = np.column_stack([np.linspace(-0.05, 0.05, 200), np.zeros(200), np.full(200, 0.6)])
    assert observe_points(line, reach_m=REACH_M).depth.size < 1_000_000


def test_points_in_any_order_give_the_same_image(fine):
    points = fine.points_C[::7]
    first, second = (observe_points(p, reach_m=REACH_M) for p in (points, points[::-1]))
    for name in ("depth", "outside", "camera", "image_box"):
        np.testing.assert_allclose(getattr(first, name), getattr(second, name), atol=1e-12)


def test_pixels_near_the_last_pose_are_the_objects(look, things, standing):
    model = pose_model(things["wedge"])
    seen = look(things["wedge"].mesh, standing(things["wedge"], yaw_rad=1.0))
    scene = observe_around(seen.depth, seen.intrinsics, model, seen.X_CO, gate_m=0.008, table=seen.table)
    row, column = _pixels(scene, seen.intrinsics)
    np.testing.assert_array_equal(scene.depth[seen.mask[row, column]], seen.depth[row, column][seen.mask[row, column]])
    found = scene.outside == 0.0
    assert not (found & ~seen.mask[row, column]).any()
    # but for a seam next to the table
    above = seen.table.height(scene.points)
    assert found.sum() == len(scene.points) > 0.9 * seen.mask[row, column].sum()
    assert above.min() > 0.004
    without = observe_around(seen.depth, seen.intrinsics, model, seen.X_CO, gate_m=0.008)
    assert (without.outside == 0.0).sum() > found.sum() and without.outside[seen.mask[row, column]].max() == 0.0


def test_an_object_that_left_the_image_has_no_points(look, things, standing):
    seen = look(things["wedge"].mesh, standing(things["wedge"]))
    model = pose_model(things["wedge"])
    for shift in ([0.0, 0.0, -2.0], [3.0, 0.0, 0.0], [0.0, -3.0, 0.0]):  # behind, beside, above
        gone = seen.X_CO.copy()
        gone[:3, 3] += shift
        assert len(observe_around(seen.depth, seen.intrinsics, model, gone, gate_m=0.02).points) == 0


def _turned_back(points, count):
    """The first so many points behind the camera."""
    out = points.copy()
    out[:count] *= -1.0
    return out


def test_up_to_half_of_the_points_may_lie_behind_the_camera(fine):
    points = fine.points_C[::7]
    kept = observe_points(points[60:], reach_m=REACH_M)
    for bad in (_turned_back(points, 60), np.concatenate([points[60:], points[60:] * [1, 1, -1]])):
        for a, b in zip(observe_points(bad, reach_m=REACH_M), kept, strict=True):
            np.testing.assert_array_equal(a, b)


def test_zeros_of_an_organised_cloud_are_no_points(fine):
    points = fine.points_C[::7]
    padded = np.concatenate([np.zeros((len(points) // 2, 3)), points, np.zeros((3 * len(points), 3))])
    for a, b in zip(observe_points(padded, reach_m=REACH_M), observe_points(points, reach_m=REACH_M), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_mask_of_whole_numbers_is_one_of_what_is_not_zero(fine):
    expected = observe_depth(fine.depth, FINE, fine.mask, reach_m=REACH_M)
    for mask in (255 * fine.mask.astype(np.uint8), -3 * fine.mask.astype(np.int64)):
        for a, b in zip(observe_depth(fine.depth, FINE, mask, reach_m=REACH_M), expected, strict=True):
            np.testing.assert_array_equal(a, b)


def test_what_cannot_be_observed_is_named(fine):
    points, k = fine.points_C, FINE
    cases = [
        (lambda: observe_points(points[:19], reach_m=0.1), "19 finite points"),
        (lambda: observe_points(np.zeros((0, 3)), reach_m=0.1), "0 finite points"),
        (lambda: observe_points(np.full((50, 3), np.nan), reach_m=0.1), "0 finite points"),
        (lambda: observe_points(1e3 * points, reach_m=0.1), "millimetres.*1000"),
        (lambda: observe_points(points[:99] * [1, -1, -1], reach_m=0.1), "only 0 of 99 points lie before.*z forward"),
        (lambda: observe_points(points - [0, 0, points[:, 2].max()], reach_m=0.1), "only 0 of .*before the camera"),
        (lambda: observe_points(_turned_back(points[:100], 51), reach_m=0.1), "only 49 of 100 points lie before"),
        (lambda: observe_points(_turned_back(points[:30], 11), reach_m=0.1), "only 19 of 30 points lie before"),
        (lambda: observe_points(np.tile(points[:1], (50, 1)), reach_m=0.1), "one spot"),
        (lambda: observe_depth(fine.depth[:-1], k, fine.mask, reach_m=0.1), "depth has shape.*480 x 640"),
        (lambda: observe_depth(fine.depth, k, fine.mask[:, 1:], reach_m=0.1), "mask has shape.*480 x 640"),
        (lambda: observe_depth(fine.depth, k, np.zeros_like(fine.mask), reach_m=0.1), "mask is empty"),
        (lambda: observe_depth(0 * fine.depth, k, fine.mask, reach_m=0.1), "0 finite points"),
        (lambda: observe_depth(1e3 * fine.depth, k, fine.mask, reach_m=0.1), "metres"),
        (lambda: observe_depth((1e3 * fine.depth).astype(np.int32), k, fine.mask, reach_m=0.1),
         "depth holds int32; expected metres as floating point"),
        (lambda: observe_depth((1e3 * fine.depth).astype(np.uint16), k, fine.mask, reach_m=0.1), "depth holds uint16"),
        (lambda: observe_depth(fine.depth, k, 1.0 * fine.mask, reach_m=0.1), "mask holds float64; expected bool"),
        (lambda: observe_depth(fine.depth, k, fine.mask.astype(str), reach_m=0.1), "mask holds <U5; expected bool"),
        (lambda: observe_depth(fine.depth, k, None, points_C=points - [3, 0, 0], reach_m=0.1), "fall into the image"),
    ]  # fmt: skip
    for call, message in cases:
        with pytest.raises(InputError, match=message):
            call()
    with pytest.raises(ShapeError, match="points_C has shape"):
        observe_points(points[:, :2], reach_m=0.1)


def test_points_on_an_image_take_their_pixels_from_it(fine):
    masked = observe_depth(fine.depth, FINE, fine.mask, reach_m=REACH_M)
    pointed = observe_depth(
        fine.depth, FINE, None, points_C=back_project(fine.depth, FINE, mask=fine.mask), reach_m=REACH_M
    )
    for a, b in zip(masked, pointed, strict=True):
        np.testing.assert_array_equal(a, b)
