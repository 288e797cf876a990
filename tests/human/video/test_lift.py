"""Joints of a picture in metres."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.geometry.camera import project
from neuralgrasps.human.video.lift import PictureJoints, lift_joints, lift_video

LAST = 23


def _picture(video, number=LAST, *, relative=True, noise_px=0.0, **changes):
    points, k = video.joints_C[number], video.frames[number].intrinsics
    pixels = project(points, k) + noise_px * np.random.default_rng(number).normal(size=(21, 2))
    depths = (points[:, 2] / points[0, 2] - 1.0) * k.fx if relative else None
    picture = PictureJoints(
        pixels=pixels, relative=depths, score=np.ones(21), side="right", side_known=True, source="test"
    )
    return replace(picture, **changes)


def _error(seen, video, number=LAST):
    return float(np.nanmean(np.linalg.norm(seen.points_C - video.joints_C[number], axis=1)))


def test_joints_lie_on_their_rays_near_the_truth(grasp_video):
    picture = _picture(grasp_video)
    seen = lift_joints(picture, grasp_video.frames[LAST], scale=0.8)
    np.testing.assert_allclose(project(seen.points_C, grasp_video.frames[LAST].intrinsics), picture.pixels, atol=1e-6)
    assert _error(seen, grasp_video) < 0.012
    assert seen.side == "right" and seen.source == "test"


def test_without_relative_depths_a_posture_is_found(grasp_video):
    seen = lift_joints(_picture(grasp_video, relative=False), grasp_video.frames[LAST])
    assert _error(seen, grasp_video) < 0.025


def test_weak_relative_depths_are_stretched(grasp_video):
    picture = _picture(grasp_video)
    seen = lift_joints(replace(picture, relative=0.7 * picture.relative), grasp_video.frames[LAST])
    assert _error(seen, grasp_video) < 0.015


def test_a_joint_behind_something_is_trusted_less_and_placed_by_its_bones(grasp_video):
    frame = grasp_video.frames[LAST]
    picture = _picture(grasp_video)
    before = lift_joints(picture, frame, scale=0.8)
    shown = int(np.argmax(np.where(np.arange(21) % 4 == 0, before.weight, 0.0)[4:])) + 4  # a tip that is well seen
    u, v = np.round(picture.pixels[shown]).astype(int)
    depth = frame.depth.copy()
    depth[v - 6 : v + 7, u - 6 : u + 7] = before.points_C[shown, 2] - 0.15
    after = lift_joints(picture, replace(frame, depth=depth), scale=0.8)
    assert after.weight[shown] < 0.5 * before.weight[shown]
    assert abs(after.points_C[shown, 2] - grasp_video.joints_C[LAST, shown, 2]) < 0.03


def test_unknown_joints_stay_unknown(grasp_video):
    picture = _picture(grasp_video)
    pixels = picture.pixels.copy()
    pixels[[4, 8]] = np.nan
    seen = lift_joints(replace(picture, pixels=pixels), grasp_video.frames[LAST])
    assert np.isnan(seen.points_C[[4, 8]]).all() and (seen.weight[[4, 8]] == 0).all()
    assert np.isfinite(np.delete(seen.points_C, [4, 8], axis=0)).all()


def test_nothing_to_lift(grasp_video):
    picture, frame = _picture(grasp_video), grasp_video.frames[LAST]
    few = picture.pixels.copy()
    few[5:] = np.nan
    assert lift_joints(replace(picture, pixels=few), frame) is None
    empty = np.zeros_like(frame.depth)
    empty[0, 0] = 0.5
    assert lift_joints(picture, replace(frame, depth=empty)) is None
    with pytest.raises(ShapeError, match="pixels of joints"):
        lift_joints(replace(picture, pixels=np.zeros((20, 2))), frame)
    with pytest.raises(InputError, match="scale is -1"):
        lift_joints(picture, frame, scale=-1.0)


def test_the_side_of_a_video_is_found(grasp_video):
    numbers = range(14, 24)
    pictures = [None, *(_picture(grasp_video, n, relative=False, noise_px=1.0, side_known=False) for n in numbers)]
    pictures[1] = replace(pictures[1], side="left")
    seen = lift_video(pictures, [grasp_video.frames[0], *(grasp_video.frames[n] for n in numbers)])
    assert seen[0] is None and {s.side for s in seen[1:]} == {"right"}
    mirrored = grasp_video.mirrored()
    pictures = [_picture(mirrored, n, relative=False, side_known=False) for n in numbers]
    assert {s.side for s in lift_video(pictures, [mirrored.frames[n] for n in numbers])} == {"left"}
