"""When two poses count as one, and that the search keeps the better."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neuralgrasps.perception.observation import observe_depth
from neuralgrasps.perception.pose_model import pose_model
from neuralgrasps.perception.pose_search import NO_CONTACTS, PoseConfig, distinct, evidence_of, polished, search
from neuralgrasps.perception.pose_visibility import COST, IN_MASK


def _turned(X, axis, degrees, centre=(0.0, 0.0, 0.0), shift=(0.0, 0.0, 0.0)):
    """X after a motion of the object: a turn about an axis through a point of it, then a shift."""
    M = np.eye(4)
    M[:3, :3] = Rotation.from_rotvec(np.deg2rad(degrees) * np.asarray(axis, float)).as_matrix()
    M[:3, 3] = np.asarray(centre) - M[:3, :3] @ np.asarray(centre) + np.asarray(shift)
    return X @ M


def _kept(model, *poses, turns=None):
    cost = np.arange(len(poses), dtype=np.float64)
    return distinct(model, np.stack(poses), cost, len(poses), model.same if turns is None else turns).tolist()


@pytest.fixture(scope="module")
def X():
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.random(random_state=3).as_matrix(), [0.1, -0.2, 0.8]
    return pose


def test_poses_eight_degrees_or_ten_millimetres_apart_are_two(things, X):
    model = pose_model(things["wedge"])
    for axis in np.eye(3):
        assert _kept(model, X, _turned(X, axis, 7.0, model.centre)) == [0]
        assert _kept(model, X, _turned(X, axis, 9.0, model.centre)) == [0, 1]
        assert _kept(model, X, _turned(X, axis, 0.0, shift=0.009 * axis)) == [0]
        assert _kept(model, X, _turned(X, axis, 0.0, shift=0.011 * axis)) == [0, 1]


def test_the_cheaper_of_two_alike_is_kept(things, X):
    model = pose_model(things["wedge"])
    poses = np.stack([_turned(X, [0, 0, 1], a, model.centre) for a in (0.0, 3.0, 90.0, 95.0)])
    assert distinct(model, poses, np.array([2.0, 1.0, 3.0, 0.5]), 4, model.same).tolist() == [3, 1]
    assert distinct(model, poses, np.array([2.0, 1.0, 3.0, 0.5]), 1, model.same).tolist() == [3]


def test_turns_of_a_symmetric_object_are_one_pose(things, X):
    box = pose_model(things["box"])
    for axis in np.eye(3):
        assert _kept(box, X, _turned(X, axis, 180.0, box.centre)) == [0]
        assert _kept(box, X, _turned(X, axis, 90.0, box.centre)) == [0, 1]
        assert _kept(box, X, _turned(X, axis, 180.0, box.centre), turns=box.turns[:1]) == [0, 1]
    can = pose_model(things["can"])
    for degrees in (13.0, 77.0, 180.0):
        assert _kept(can, X, _turned(X, [0, 0, 1], degrees, can.centre)) == [0]
    assert _kept(can, X, _turned(X, [1, 0, 0], 180.0, can.centre)) == [0]
    assert _kept(can, X, _turned(X, [1, 0, 0], 30.0, can.centre)) == [0, 1]


def test_what_only_looks_alike_is_two_poses(things, X):
    bevelled, rimmed = pose_model(things["bevelled"]), pose_model(things["rimmed"])
    half = _turned(X, [0, 0, 1], 180.0, bevelled.centre)
    assert _kept(bevelled, X, half) == [0, 1]
    assert _kept(bevelled, X, half, turns=bevelled.turns) == [0]
    upside_down = _turned(X, [1, 0, 0], 180.0, rimmed.centre)
    assert _kept(rimmed, X, upside_down) == [0, 1]
    assert _kept(rimmed, X, upside_down, turns=rimmed.turns) == [0]
    assert _kept(rimmed, X, _turned(X, [0, 0, 1], 100.0, rimmed.centre)) == [0]


def test_candidates_come_cheapest_first_and_none_is_cheaper_than_the_truth(things, look, standing):
    for name in ("wedge", "bevelled", "rimmed"):
        model = pose_model(things[name])
        seen = look(things[name].mesh, standing(things[name], yaw_rad=1.0))
        scene = observe_depth(seen.depth, seen.intrinsics, seen.mask, reach_m=model.diameter)
        config = PoseConfig()
        found = search(model, scene, NO_CONTACTS, config)
        assert (np.diff(found.cost) >= 0.0).all() and len(found.X_CO) <= config.finalists
        truth = polished(model, scene, NO_CONTACTS, seen.X_CO[None], config, 2)
        assert found.cost[0] < truth.cost[0] + 1e-3
        assert found.evidence.shape == (len(found.cost), 6)
        np.testing.assert_allclose(evidence_of(model, scene, found.X_CO, config)[:, COST], found.evidence[:, COST])


def test_each_round_looks_at_about_as_many_pixels_as_asked(things, look, standing):
    model = pose_model(things["box"])
    seen = look(things["box"].mesh, standing(things["box"], yaw_rad=1.0))
    scene = observe_depth(seen.depth, seen.intrinsics, seen.mask, reach_m=model.diameter)
    config = PoseConfig(ray_cells=(60, 200, 900))
    for stage, cells in enumerate(config.ray_cells):
        count = evidence_of(model, scene, seen.X_CO[None], config, stage)[0, IN_MASK]
        assert 0.5 * cells < count < 2.0 * cells
