"""Crops of depth images and the way back."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.human.nets.crop import (
    CROP,
    DEPTH_UNIT_M,
    crop_points,
    full_mask,
    middle_depth,
    mirrored,
    take_crop,
    turned,
)
from neuralgrasps.human.nets.joint_images import CAMERA, CropMix, make_crops
from neuralgrasps.human.scenes.random_scene import SceneMix, draw_scene, random_scene
from neuralgrasps.human.scenes.surroundings import HAND
from tests.human.human_scenes import small_kit

VIEW = Intrinsics(CAMERA[0], CAMERA[0], CAMERA[1], CAMERA[2], CAMERA[3], CAMERA[4])


def _ramp(k: Intrinsics) -> np.ndarray:
    return 0.6 + 1e-4 * np.arange(k.width) + 2e-4 * np.arange(k.height)[:, None]


def test_crops_hold_depth_about_its_middle():
    k = Intrinsics(400.0, 400.0, 159.5, 119.5, 320, 240)
    crop = take_crop(_ramp(k), k, u=150.0, v=100.0, side=96.0)
    assert crop is not None
    assert crop.depth_m == pytest.approx(0.6 + 0.015 + 0.02, abs=1e-3)
    assert crop.conditions == pytest.approx([96 * crop.depth_m / 400, -9.5 / 400, -19.5 / 400, crop.depth_m], rel=1e-5)
    slope = np.diff(crop.inputs[0], axis=1) * DEPTH_UNIT_M
    np.testing.assert_allclose(slope, 1e-4, atol=1e-6)
    assert crop.inputs[1].all()


def test_beyond_the_image_nothing_is_measured():
    k = Intrinsics(400.0, 400.0, 159.5, 119.5, 320, 240)
    crop = take_crop(_ramp(k), k, u=0.0, v=0.0, side=96.0)
    assert crop is not None
    assert not crop.inputs[1, :47].any() and not crop.inputs[1, :, :47].any() and crop.inputs[1, 49:, 49:].all()
    assert take_crop(_ramp(k), k, u=-200.0, v=0.0, side=96.0) is None
    assert take_crop(np.zeros((240, 320)), k, u=100.0, v=100.0, side=50.0) is None


def test_points_come_back():
    k = Intrinsics(400.0, 400.0, 159.5, 119.5, 320, 240)
    crop = take_crop(_ramp(k), k, u=200.0, v=60.0, side=120.0, depth_m=0.65)
    assert crop is not None
    points = np.random.default_rng(0).uniform([-0.1, -0.2, 0.5], [0.1, 0.1, 0.8], (21, 3))
    u, v = (points[:, i] / points[:, 2] * 400 + c for i, c in enumerate((k.cx, k.cy)))
    votes = np.stack([(u - crop.u) / 120.0, (v - crop.v) / 120.0, (points[:, 2] - 0.65) / DEPTH_UNIT_M], axis=1)
    np.testing.assert_allclose(crop_points(votes, crop.conditions), points, atol=1e-6)
    other = crop_points(votes * [-1.0, 1.0, 1.0], mirrored(crop).conditions)
    np.testing.assert_allclose(other * [-1.0, 1.0, 1.0], points, atol=1e-6)


def test_a_mirrored_crop_is_the_crop_of_the_mirrored_image():
    k = Intrinsics(400.0, 400.0, 150.0, 119.5, 320, 240)
    flipped = Intrinsics(400.0, 400.0, 319.0 - 150.0, 119.5, 320, 240)
    depth = _ramp(k)
    one = take_crop(depth, k, u=200.25, v=60.0, side=101.0, depth_m=0.6)
    two = take_crop(depth[:, ::-1], flipped, u=319.0 - 200.25, v=60.0, side=101.0, depth_m=0.6)
    assert one is not None and two is not None
    np.testing.assert_allclose(mirrored(one).inputs, two.inputs, atol=1e-6)
    np.testing.assert_allclose(mirrored(one).conditions, two.conditions, atol=1e-6)


@pytest.mark.parametrize("side", [60.0, 96.0, 170.0])
def test_masks_come_back_to_the_pixels_they_were_taken_from(side):
    k = Intrinsics(400.0, 400.0, 159.5, 119.5, 320, 240)
    row, column = np.mgrid[:240, :320]
    disc = (column - 155) ** 2 + (row - 95) ** 2 < (0.3 * side) ** 2
    crop = take_crop(np.where(disc, 0.5, 0.9), k, u=150.3, v=100.6, side=side, depth_m=0.5)
    assert crop is not None
    back = full_mask(crop, crop.inputs[0] < 1.0, disc.shape)
    assert (back & disc).sum() / (back | disc).sum() > 0.94


def test_training_crops_are_the_crops_of_whole_images():
    """What the net learns from is what it will read: the same pixels, conditions and truth."""
    kit, seeds = small_kit(), np.arange(8, dtype=np.uint32)
    batch = make_crops(kit, seeds, crop=CropMix(strongest_noise=0.0))
    for n in range(len(seeds)):
        scene = random_scene(kit, int(seeds[n]), SceneMix())
        np.testing.assert_allclose(batch.joints_C[n], scene.joints_C, atol=1e-6)
        width, x, y, z0 = batch.conditions[n].astype(np.float64)
        depth, labels = draw_scene(scene, VIEW)
        crop = take_crop(
            depth, VIEW, u=x * VIEW.fx + VIEW.cx, v=y * VIEW.fy + VIEW.cy, side=width * VIEW.fx / z0, depth_m=z0
        )  # fmt: skip
        assert crop is not None
        both = (crop.inputs[1] > 0) & (batch.inputs[n, 1] > 0)
        assert both.sum() > 0.3 * CROP * CROP * crop.inputs[1].mean()
        assert np.median(np.abs(crop.inputs[0] - batch.inputs[n, 0])[both]) < 0.05
        hand = (labels == HAND)[np.maximum(crop.rows, 0)[:, None], np.maximum(crop.columns, 0)] & (crop.inputs[1] > 0)
        given = (batch.mask[n] > 0) & (crop.inputs[1] > 0)
        assert (hand & given).sum() >= 0.85 * (hand | given).sum()
        back = crop_points(batch.joints[n].astype(np.float64), batch.conditions[n].astype(np.float64))
        np.testing.assert_allclose(back, scene.joints_C, atol=1e-5)


def test_crops_do_not_depend_on_threads():
    kit, seeds = small_kit(), np.arange(5, dtype=np.uint32)
    for one, many in zip(make_crops(kit, seeds), make_crops(kit, seeds, threads=3), strict=True):
        np.testing.assert_array_equal(one, many)


def test_the_middle_depth_is_a_median_of_what_was_measured():
    seen = np.zeros((CROP, CROP), np.float32)
    assert middle_depth(seen) == 0.0
    seen[0, 0] = 0.9
    assert middle_depth(seen) == pytest.approx(0.9)
    seen[40:60, 40:60] = 0.5
    assert middle_depth(seen) == pytest.approx(0.5)


def test_a_turned_crop_is_the_crop_of_the_turned_image():
    k = Intrinsics(400.0, 400.0, 150.0, 110.0, 320, 240)
    depth = 0.5 + np.random.default_rng(0).uniform(0.0, 0.2, (k.height, k.width))
    crop = take_crop(depth, k, u=140.0, v=130.0, side=80.0, depth_m=0.6)
    around = Intrinsics(400.0, 400.0, k.width - 1 - k.cx, k.height - 1 - k.cy, k.width, k.height)
    other = take_crop(depth[::-1, ::-1], around, u=k.width - 1 - 140.0, v=k.height - 1 - 130.0, side=80.0, depth_m=0.6)
    assert crop is not None and other is not None
    said = turned(crop)
    np.testing.assert_allclose(said.conditions, other.conditions, rtol=1e-5)
    np.testing.assert_allclose(said.inputs[:, 1:-1, 1:-1], other.inputs[:, 1:-1, 1:-1], atol=0.02)
