"""What the pose search keeps of an object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neuralgrasps.evaluate.pose import diameter_m
from neuralgrasps.geometry.camera import Intrinsics, back_project, look_at
from neuralgrasps.geometry.raster import rasterise
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.objects.resting import resting_poses
from neuralgrasps.perception.pose_model import ROTATIONS, pose_model, sphere_directions

NAMES = ("box", "ball", "can", "wedge", "corner", "bevelled", "rimmed")


def test_an_object_is_prepared_once(things):
    assert pose_model(things["box"]) is pose_model(things["box"])
    assert pose_model(replace(things["box"], name="other")) is pose_model(things["box"])
    assert pose_model(things["box"]) is not pose_model(things["can"])


@pytest.mark.parametrize("name", NAMES)
def test_sizes_and_surface(things, name):
    obj, model = things[name], pose_model(things[name])
    assert model.diameter == pytest.approx(diameter_m(obj), rel=0.01)
    assert np.linalg.norm(model.hull - model.centre, axis=1).max() <= model.radius + 1e-12
    assert np.abs(query_grid_numpy(obj.sdf, model.points)).max() < 2e-3
    np.testing.assert_allclose(np.linalg.norm(model.normals, axis=1), 1.0)
    # any first part covers the object
    for count in (64, 256):
        gaps = np.linalg.norm(model.points[:, None] - model.points[None, :count], axis=-1).min(axis=1)
        assert gaps.max() < 2.5 * model.diameter / np.sqrt(count)
    np.testing.assert_array_equal(model.coarse, model.values[::2, ::2, ::2])
    assert (model.bounds[0] < obj.mesh.vertices.min(axis=0)).all()
    assert (model.bounds[1] > obj.mesh.vertices.max(axis=0)).all()


@pytest.mark.parametrize(
    ("name", "turns", "is_round", "share"),
    [("box", 4, False, 1 / 4), ("wedge", 1, False, 1.0), ("bevelled", 4, False, 1 / 4), ("can", 2, True, None),
     ("rimmed", 2, True, None), ("ball", 1, True, None)],
)  # fmt: skip
def test_turns_are_the_symmetry_and_what_looks_like_one(things, name, turns, is_round, share):
    model = pose_model(things[name])
    assert len(model.turns) == turns
    np.testing.assert_allclose(model.turns[0], np.eye(4), atol=1e-12)
    assert bool(model.axis.any()) == is_round
    if share is not None:
        assert len(model.rotations) == pytest.approx(share * ROTATIONS, rel=0.1)
    else:
        assert len(model.rotations) < 0.1 * ROTATIONS
    moved = model.points @ model.turns[:, :3, :3].transpose(0, 2, 1) + model.turns[:, None, :3, 3]
    worst = np.percentile(np.abs(query_grid_numpy(things[name].sdf, moved)), 95, axis=1)
    assert worst.max() < 3.0 * 0.02 * model.diameter


@pytest.mark.parametrize("name", ["box", "wedge", "can", "rimmed"])
def test_every_rotation_is_near_one_of_the_grid_up_to_symmetry(things, name):
    model = pose_model(things[name])
    asked = Rotation.random(300, random_state=0).as_matrix()
    if model.axis.any():
        goal, have = asked @ model.axis, model.rotations @ (model.turns[:, :3, :3] @ model.axis).T
        cosine = np.einsum("ni,rit->nrt", goal, have).max(axis=(1, 2))
    else:
        equal = asked[:, None] @ model.turns[:, :3, :3].transpose(0, 2, 1)
        cosine = 0.5 * (np.einsum("ntij,rij->ntr", equal, model.rotations).max(axis=(1, 2)) - 1.0)
    gap = np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0)))
    assert gap.max() < 16.0 and np.median(gap) < 9.0
    np.testing.assert_allclose(np.linalg.det(model.rotations), 1.0)


def test_rests_are_the_stable_poses(things):
    box = pose_model(things["box"])
    assert len(box.rests) == 6 and len(box.rest_starts) == 3
    down = {tuple(np.rint(d).astype(int)) for d in box.rests}
    assert down == {(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)}
    wedge = pose_model(things["wedge"])
    poses, shares = resting_poses(things["wedge"].mesh.vertices, things["wedge"].com_O, min_share=0.02)
    assert len(poses) >= 3 and shares.min() >= 0.02
    for pose in poses:
        assert (wedge.rests @ -pose[2, :3]).max() > 0.9999
    can = pose_model(things["can"])
    assert len(can.rest_starts) == 2  # on an end, or lying


@pytest.mark.parametrize("name", ["corner", "rimmed", "wedge"])
def test_visible_centroids_are_those_of_a_rendered_view(things, name):
    obj, model = things[name], pose_model(things[name])
    far = Intrinsics.from_fov(np.deg2rad(2.0), 80, 80)  # from so far that rays are parallel
    for k in range(0, len(model.views), 40):
        X_OC = look_at(model.centre - 6.0 * model.views[k], model.centre)
        image = rasterise([obj.mesh], np.linalg.inv(X_OC)[None], far)
        points = back_project(np.where(np.isfinite(image.depth), image.depth, 0.0), far)
        seen = (points @ X_OC[:3, :3].T + X_OC[:3, 3]).mean(axis=0)
        assert np.linalg.norm(model.visible[k] - seen) < 0.06 * model.diameter


def test_directions_are_evenly_spread():
    d = sphere_directions(400)
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1.0)
    nearest = np.sort(np.arccos(np.clip(d @ d.T, -1, 1)), axis=1)[:, 1]
    assert nearest.min() > 0.6 * np.sqrt(4 * np.pi / 400) and nearest.max() < 1.3 * np.sqrt(4 * np.pi / 400)
    np.testing.assert_allclose(d.mean(axis=0), 0.0, atol=0.01)
