"""Which measured points are the hand's."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.hands.packed import hand_distance_many, pack_shapes
from neuralgrasps.human.fit.hand_cloud import CloudConfig, hand_cloud, merged_cloud
from neuralgrasps.human.seen import HandBox, SeenJoints
from neuralgrasps.human.skeleton import human_hand
from neuralgrasps.perception.table import find_table

LAST = 23


def _seen(video, *, mask=True, number=LAST):
    return SeenJoints(
        points_C=video.joints_C[number], weight=np.ones(21), mask=video.masks[number] if mask else None, side="right",
        source="truth",
    )  # fmt: skip


def _off_hand(video, cloud, number=LAST):
    """Distance of points to the true hand's surface, metres."""
    out, X = np.empty(len(cloud)), video.X_CH[number].copy()
    X[:3, 3] /= 0.8
    hand_distance_many(pack_shapes(human_hand()), X, video.q[number], cloud / 0.8, out)
    return 0.8 * np.abs(out)


def test_masked_points_lie_on_the_hand(grasp_video):
    cloud = hand_cloud(grasp_video.frames[LAST], _seen(grasp_video))
    assert len(cloud) > 200
    assert np.median(_off_hand(grasp_video, cloud)) < 0.002


def test_without_a_mask_object_table_and_forearm_are_left_out(grasp_video):
    frame, held = grasp_video.frames[LAST], (grasp_video.obj, grasp_video.X_CO[LAST])
    seen, table = _seen(grasp_video, mask=False), find_table(grasp_video.frames[0]).plane
    bare = hand_cloud(frame, seen)
    cloud = hand_cloud(frame, seen, obj=held, table=table)
    share = [(_off_hand(grasp_video, c) > 0.008).mean() for c in (bare, cloud)]
    assert share[1] < 0.05 < share[0]
    assert (table.height(cloud) > 0.007).all()
    wrist, knuckles = grasp_video.joints_C[LAST][0], grasp_video.joints_C[LAST][[5, 9, 13, 17]].mean(axis=0)
    away = (wrist - knuckles) / np.linalg.norm(wrist - knuckles)
    assert ((cloud - wrist) @ away).max() < 0.006


def test_points_outside_the_box_are_left_out(grasp_video):
    box = HandBox(u_min=110, v_min=0, u_max=140, v_max=239, score=1.0, side="right", side_score=1.0)
    frame, k = grasp_video.frames[LAST], grasp_video.frames[LAST].intrinsics
    cloud = hand_cloud(frame, _seen(grasp_video), box=box)
    u = k.fx * cloud[:, 0] / cloud[:, 2] + k.cx
    assert len(cloud) and u.min() >= 109.5 and u.max() <= 140.5


def test_no_joints_no_points(grasp_video):
    seen = SeenJoints(points_C=np.full((21, 3), np.nan), weight=np.zeros(21), mask=None, side="right", source="none")
    assert hand_cloud(grasp_video.frames[LAST], seen).shape == (0, 3)
    away = SeenJoints(
        points_C=grasp_video.joints_C[LAST] + np.array([2.0, 0.0, 0.0]), weight=np.ones(21), mask=None, side="right",
        source="aside",
    )  # fmt: skip
    assert hand_cloud(grasp_video.frames[LAST], away).shape == (0, 3)


def test_counts_are_kept(grasp_video):
    cloud = hand_cloud(grasp_video.frames[LAST], _seen(grasp_video), config=CloudConfig(most=60))
    assert len(cloud) == 60


def test_merging_lowers_noise_and_drops_strays():
    rng = np.random.default_rng(0)
    plane = np.stack(np.meshgrid(np.linspace(0, 0.05, 40), np.linspace(0, 0.05, 40)), axis=-1).reshape(-1, 2)
    clouds = [np.column_stack([plane, 0.005 + 0.001 * rng.normal(size=len(plane))]) for _ in range(10)]
    stray = np.array([[0.02, 0.02, -0.05]])
    merged = merged_cloud([*clouds, stray], cell_m=0.01, least=2, most=500)
    assert np.std(merged[:, 2]) < 0.0003
    assert merged[:, 2].min() > -0.02
    assert len(merged_cloud([*clouds, stray], cell_m=0.01, least=1)) == len(merged) + 1
    assert merged_cloud([]).shape == (0, 3)
    assert len(merged_cloud(clouds, cell_m=0.001, most=77)) == pytest.approx(77)
