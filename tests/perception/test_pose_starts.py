"""Where the pose search starts."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.evaluate.pose import pose_errors
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.perception.observation import observe_depth, observe_points
from neuralgrasps.perception.pose_model import pose_model
from neuralgrasps.perception.pose_starts import resting_rotations, start_poses


def _at(x, y, z, yaw_rad=0.0):
    X = np.eye(4)
    X[:2, :2] = [[np.cos(yaw_rad), -np.sin(yaw_rad)], [np.sin(yaw_rad), np.cos(yaw_rad)]]
    X[:3, 3] = [x, y, z]
    return X


def _nearest(obj, starts, truth):
    """The least MSSD, as a share of the size, of the ten starts near the truth that are turned best."""
    model = pose_model(obj)
    near = starts[np.linalg.norm((starts - truth) @ np.append(model.centre, 1.0), axis=1) < 0.03]
    equal = truth[:3, :3] @ obj.symmetry.rotations[:, :3, :3]
    best = np.argsort(-np.einsum("nij,sij->ns", near[:, :3, :3], equal).max(axis=1))[:10]
    return min((pose_errors(obj, X, truth).mssd_m for X in near[best]), default=np.inf) / model.diameter


@pytest.mark.parametrize("name", ["box", "can", "wedge", "corner"])
@pytest.mark.parametrize("how", ["image", "points"])
def test_one_start_is_near_the_truth(things, look, standing, name, how):
    obj, model = things[name], pose_model(things[name])
    seen = look(obj.mesh, standing(obj, yaw_rad=0.9))
    if how == "image":
        scene = observe_depth(seen.depth, seen.intrinsics, seen.mask, reach_m=model.diameter)
    else:
        scene = observe_points(seen.points_C, reach_m=model.diameter)
    starts = start_poses(model, scene, yaw_steps=36)
    assert len(starts) <= 2 * len(model.rotations)
    assert _nearest(obj, starts, seen.X_CO) < 0.2
    with_table = start_poses(
        model, scene._replace(table=np.append(seen.table.normal, seen.table.offset_m)), yaw_steps=36
    )
    assert _nearest(obj, with_table, seen.X_CO) < 0.12
    assert len(with_table) > len(starts)
    np.testing.assert_allclose(with_table[: len(starts) // 2, :3, :3], starts[: len(starts) // 2, :3, :3])


def _true_start(model, scene, X_CO):
    """The starts of the true rotation alone."""
    ray = scene.centroid / np.linalg.norm(scene.centroid)
    every = start_poses(model._replace(rotations=np.eye(3)[None]), scene, yaw_steps=1)[0, :3, :3]  # what it turns by
    np.testing.assert_allclose(every[:, 2], ray, atol=1e-12)
    return start_poses(model._replace(rotations=(every.T @ X_CO[:3, :3])[None]), scene, yaw_steps=1)


@pytest.mark.parametrize("name", ["box", "wedge", "corner", "rimmed"])
def test_the_true_rotation_is_put_in_its_place(things, look, standing, name):
    obj, model = things[name], pose_model(things[name])
    for yaw in (0.2, 1.4, 3.0):
        seen = look(obj.mesh, standing(obj, yaw_rad=yaw))
        scene = observe_depth(seen.depth, seen.intrinsics, seen.mask, reach_m=model.diameter)
        starts = _true_start(model, scene, seen.X_CO)
        np.testing.assert_allclose(starts[0, :3, :3], seen.X_CO[:3, :3], atol=1e-9)
        off = np.linalg.norm(starts[:, :3, 3] - seen.X_CO[:3, 3], axis=1)
        assert len(starts) == 1 and off[0] < 0.015


def test_a_hidden_side_does_not_pull_the_outline(things, look, standing):
    box = things["box"]
    model = pose_model(box)
    towards = np.array([np.cos(0.345), np.sin(0.345)])
    aside = np.array([-towards[1], towards[0]])
    upright = standing(box, yaw_rad=0.345)
    post = (box_mesh([0.01, 0.04, 0.15]), _at(*(0.09 * towards + 0.06 * aside), 0.15, 0.345))
    seen = look(box.mesh, upright, others=[post])
    whole = look(box.mesh, upright)
    assert 0.3 < seen.mask.sum() / whole.mask.sum() < 0.8
    scene = observe_depth(seen.depth, seen.intrinsics, seen.mask, reach_m=model.diameter)
    by_outline, by_centroid = np.linalg.norm(_true_start(model, scene, seen.X_CO)[:, :3, 3] - seen.X_CO[:3, 3], axis=1)
    assert by_outline < 0.012
    assert by_centroid > by_outline + 0.005  # what the hidden side would do
    # as if nothing hid it: the outline is pulled too
    ignored = _true_start(model, scene._replace(free=np.ones(4)), seen.X_CO)
    assert np.linalg.norm(ignored[0, :3, 3] - seen.X_CO[:3, 3]) > by_outline + 0.005


@pytest.mark.parametrize("name", ["box", "wedge", "can"])
def test_resting_rotations_stand_on_the_table(things, look, standing, name):
    model, steps = pose_model(things[name]), 12
    normal = look(things[name].mesh, standing(things[name])).table.normal
    R = resting_rotations(model, normal, steps)
    down = -normal @ R  # object frame
    gap = (down @ model.rest_starts.T).max(axis=1)
    np.testing.assert_allclose(gap, 1.0, atol=1e-9)
    rounds = sum(bool(model.axis.any()) and abs(model.axis @ d) > 0.999 for d in model.rest_starts)
    assert len(R) == steps * (len(model.rest_starts) - rounds) + rounds
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (len(R), 1, 1)), atol=1e-9)
    first = R[: steps if rounds == 0 else 1]
    if len(first) > 1:  # evenly turned
        step = np.arccos(np.clip(0.5 * (np.einsum("nij,nij->n", first[1:], first[:-1]) - 1.0), -1, 1))
        np.testing.assert_allclose(step, 2.0 * np.pi / steps, atol=1e-6)
