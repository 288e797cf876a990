"""Following an object from one frame to the next."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.pose import pose_errors
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.perception.pose import estimate_pose
from neuralgrasps.perception.track import track_pose
from neuralgrasps.sim.camera import DepthNoise

NAMES = ("wedge", "box", "can", "corner", "rimmed")


def _before(X_CO, seed, *, metres=0.008, degrees=3.0, centre_O=(0.0, 0.0, 0.0)):
    """The pose a frame ago: moved and turned by so much about the object's middle, in a random direction."""
    rng = np.random.default_rng(seed)
    shift, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    X = X_CO.copy()
    middle = X_CO[:3, :3] @ np.asarray(centre_O) + X_CO[:3, 3]
    X[:3, :3] = Rotation.from_rotvec(np.deg2rad(degrees) * axis).as_matrix() @ X[:3, :3]
    X[:3, 3] = middle - X[:3, :3] @ np.asarray(centre_O) + metres * shift
    return X


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("given", ["table", "mask", "nothing"])
def test_a_small_motion_is_followed(things, look, standing, name, given):
    obj = things[name]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0))
    more = {"table": {"table": seen.table}, "mask": {"mask": seen.mask}, "nothing": {}}[given]
    for seed in range(3):
        before = _before(seen.X_CO, seed, centre_O=obj.symmetry.centre)
        errors = pose_errors(obj, track_pose(obj, seen.depth, seen.intrinsics, before, **more).X_CO, seen.X_CO)
        # with nothing given, the table's pixels next to the object pull a little
        assert errors.add_s_m < 1e-3 and errors.mssd_m < (2e-3 if given == "nothing" else 1e-3)


@pytest.mark.parametrize("name", ["wedge", "corner"])
def test_larger_motions_are_followed_with_a_table(things, look, standing, name):
    obj = things[name]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0))
    for seed in range(4):
        before = _before(seen.X_CO, seed, metres=0.015, degrees=10.0, centre_O=obj.symmetry.centre)
        found = track_pose(obj, seen.depth, seen.intrinsics, before, table=seen.table)
        assert pose_errors(obj, found.X_CO, seen.X_CO).mssd_m < 2e-3


def test_a_path_of_many_frames_is_followed(things, look, standing):
    obj = things["wedge"]
    X_WO = standing(obj, yaw_rad=1.0)
    X = look(obj.mesh, X_WO).X_CO
    for k in range(12):
        step = np.eye(4)
        step[:3, :3] = Rotation.from_euler("z", 4.0, degrees=True).as_matrix()
        step[:3, 3] = [0.004, -0.003, 0.0]
        X_WO = step @ X_WO
        seen = look(obj.mesh, X_WO, noise=DepthNoise(), seed=k)
        X = track_pose(obj, seen.depth, seen.intrinsics, X, table=seen.table).X_CO
        assert pose_errors(obj, X, seen.X_CO).mssd_m < 5e-3


@pytest.mark.parametrize("name", ["wedge", "corner", "can"])
def test_a_still_frame_keeps_the_pose(things, look, standing, name):
    obj = things[name]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0), noise=DepthNoise(), seed=3)
    X = first = estimate_pose(obj, table=seen.table, **seen.image).X_CO
    for _ in range(5):
        X = track_pose(obj, seen.depth, seen.intrinsics, X, table=seen.table).X_CO
        assert pose_errors(obj, X, first).mssd_m < 5e-4


def test_a_followed_object_is_one_to_be_sure_of(things, look, standing):
    obj = things["corner"]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0))
    found = track_pose(obj, seen.depth, seen.intrinsics, _before(seen.X_CO, 0), table=seen.table)
    assert found.converged and found.confidence > 0.8 and found.score > 0.9
    np.testing.assert_array_equal(found.alternatives_X_CO[0], found.X_CO)
    assert np.linalg.eigvalsh(found.covariance).min() > 0.0


@pytest.mark.parametrize("name", NAMES)
def test_an_object_taken_off_its_table_is_lost(things, look, standing, name):
    obj = things[name]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0))
    empty = look(box_mesh([0.001] * 3), _away())
    with pytest.raises(InputError, match=f"near the last pose of '{name}'.*estimate_pose"):
        track_pose(obj, empty.depth, empty.intrinsics, seen.X_CO, table=empty.table)


@pytest.mark.parametrize("name", NAMES)
def test_an_object_taken_off_a_table_nobody_knows_of_is_lost(things, look, standing, name):
    obj = things[name]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0))
    empty = look(box_mesh([0.001] * 3), _away())
    for seed in range(2):
        found = track_pose(obj, empty.depth, empty.intrinsics, _before(seen.X_CO, seed))
        assert found.confidence < 0.5


def test_another_object_in_its_place_is_noticed(things, look, standing):
    for name, other in (("wedge", "ball"), ("corner", "ball"), ("box", "corner")):
        was = look(things[name].mesh, standing(things[name], yaw_rad=1.0))
        now = look(things[other].mesh, standing(things[other], yaw_rad=1.0))
        found = track_pose(things[name], now.depth, now.intrinsics, was.X_CO, table=now.table)
        assert found.confidence < 0.5


def _away():
    X = np.eye(4)
    X[:3, 3] = [0.0, 0.0, -0.1]  # below the table
    return X


def test_the_same_frame_gives_the_same_pose(things, look, standing):
    obj = things["wedge"]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0))
    before = _before(seen.X_CO, 0)
    kept = before.copy()
    first, second = (track_pose(obj, seen.depth, seen.intrinsics, before, table=seen.table, seed=3) for _ in range(2))
    np.testing.assert_array_equal(first.X_CO, second.X_CO)
    np.testing.assert_array_equal(before, kept)
    assert first.seed == 3


def test_a_frame_that_cannot_be_used_is_named(things, look, standing):
    obj = things["wedge"]
    seen = look(obj.mesh, standing(obj))
    with pytest.raises(InputError, match="depth has shape"):
        track_pose(obj, seen.depth[1:], seen.intrinsics, seen.X_CO)
    with pytest.raises(InputError, match=r"X_CO_before is float64 of shape \(2, 4\); expected a 4 x 4 matrix"):
        track_pose(obj, seen.depth, seen.intrinsics, seen.X_CO[:2])
    with pytest.raises(InputError, match="mask is empty"):
        track_pose(obj, seen.depth, seen.intrinsics, seen.X_CO, mask=0 * seen.mask)
    with pytest.raises(InputError, match="0 points were measured near"):
        track_pose(obj, 0 * seen.depth, seen.intrinsics, seen.X_CO)
    with pytest.raises(InputError, match="0 points were measured near"):
        track_pose(obj, np.full_like(seen.depth, np.nan), seen.intrinsics, seen.X_CO)
    with pytest.raises(InputError):  # in millimetres
        track_pose(obj, 1e3 * seen.depth, seen.intrinsics, seen.X_CO)


def test_a_last_pose_that_is_no_number_is_named(things, look, standing):
    seen = look(things["wedge"].mesh, standing(things["wedge"]))
    with pytest.raises(InputError, match="X_CO_before"):
        track_pose(things["wedge"], seen.depth, seen.intrinsics, np.full((4, 4), np.nan))
