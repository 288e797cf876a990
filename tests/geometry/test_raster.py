"""The z-buffer against closed forms and against trimesh's ray casting."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
import trimesh

from neuralgrasps.errors import ShapeError
from neuralgrasps.geometry.camera import Intrinsics, look_at, pixel_rays
from neuralgrasps.geometry.raster import depth_images, raster_labels, rasterise

CAMERA = Intrinsics.from_fov(math.pi / 4, 160, 120)


class Triangles(NamedTuple):
    vertices: np.ndarray
    faces: np.ndarray


def triangles(mesh: trimesh.Trimesh) -> Triangles:
    return Triangles(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32))


def camera_pose(eye, target=(0, 0, 0)) -> np.ndarray:
    return np.linalg.inv(look_at(np.asarray(eye, float), np.asarray(target, float)))


def plane(half: float) -> Triangles:
    corners = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]], float)
    return Triangles(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def test_sphere_depth_is_analytic():
    radius, distance = 0.05, 0.4
    mesh = triangles(trimesh.creation.icosphere(subdivisions=5, radius=radius))
    image = rasterise([mesh], camera_pose([distance, 0, 0])[None], CAMERA)
    rays = pixel_rays(CAMERA)
    length2 = (rays**2).sum(-1)
    discriminant = distance**2 - length2 * (distance**2 - radius**2)  # |z d - c|^2 = r^2 with c on the axis
    expected = (distance - np.sqrt(np.maximum(discriminant, 0))) / length2
    inside = discriminant > 2e-4  # away from the silhouette of the tessellation
    assert inside.sum() > 500
    assert np.isfinite(image.depth[inside]).all()
    assert np.abs(image.depth - expected)[inside].max() < 5e-5
    assert not np.isfinite(image.depth[discriminant < 0]).any()


def test_plane_depth_is_analytic_and_has_no_seam():
    eye = np.array([0.3, -0.2, 0.5])
    X_CM = camera_pose(eye)
    depth = rasterise([plane(5.0)], X_CM[None], CAMERA).depth
    normal_C, point_C = X_CM[:3, 2], X_CM[:3, 3]
    expected = (normal_C @ point_C) / (pixel_rays(CAMERA) @ normal_C)
    np.testing.assert_allclose(depth, expected, rtol=1e-6)


def test_plane_through_the_camera_is_clipped_at_the_near_depth():
    X_CM = camera_pose([0.0, 0.0, 0.1], [1.0, 0.0, 0.1])  # looks along the plane, which passes below and behind
    depth = rasterise([plane(2.0)], X_CM[None], CAMERA, near_m=0.3).depth
    rays = pixel_rays(CAMERA)
    with np.errstate(divide="ignore"):
        expected = np.where(rays[..., 1] > 0, 0.1 / rays[..., 1], np.inf)
    expected[(expected < 0.3) | (expected > 2.0)] = np.inf
    assert np.isfinite(expected).sum() > 1000
    np.testing.assert_allclose(depth, expected, rtol=1e-6)


def test_box_front_face_coverage_and_barycentrics():
    mesh = triangles(trimesh.creation.box(extents=[0.1, 0.08, 0.06]))
    X_CM = camera_pose([0.5, 0, 0])
    image = rasterise([mesh], X_CM[None], CAMERA)
    hit = image.mesh_index == 0
    half_v = CAMERA.fy * 0.03 / 0.45
    half_u = CAMERA.fx * 0.04 / 0.45
    rows = np.abs(np.arange(120) - CAMERA.cy) <= half_v
    columns = np.abs(np.arange(160) - CAMERA.cx) <= half_u
    np.testing.assert_array_equal(hit, rows[:, None] & columns[None, :])
    np.testing.assert_allclose(image.depth[hit], 0.45, rtol=1e-6)
    assert (image.face_index[~hit] == -1).all() and (image.mesh_index[~hit] == -1).all()
    corners = mesh.vertices[mesh.faces[image.face_index[hit]]]
    points = np.einsum("nk,nkd->nd", image.barycentric[hit], corners) @ X_CM[:3, :3].T + X_CM[:3, 3]
    np.testing.assert_allclose(points, (pixel_rays(CAMERA) * image.depth[..., None])[hit], atol=1e-7)


@pytest.mark.parametrize("seed", range(4))
def test_agrees_with_ray_casting_on_random_scenes(seed):
    rng = np.random.default_rng(seed)
    camera = Intrinsics(70.0, 75.0, 30.3, 25.1, 64, 48)
    solids = [
        trimesh.creation.icosphere(subdivisions=2, radius=0.06),
        trimesh.creation.box(extents=[0.05, 0.1, 0.2]),
        trimesh.creation.annulus(r_min=0.03, r_max=0.07, height=0.05),
    ]
    poses = []
    for _ in solids:
        pose = trimesh.transformations.random_rotation_matrix(rng.random(3))
        pose[:3, 3] = rng.normal(scale=0.05, size=3) + np.array([0, 0, 0.35])
        poses.append(pose)
    image = rasterise([triangles(s) for s in solids], np.stack(poses), camera)
    rays = pixel_rays(camera).reshape(-1, 3)
    reference = np.full(len(rays), np.inf)
    nearest = np.full(len(rays), -1)
    for index, (solid, pose) in enumerate(zip(solids, poses, strict=True)):
        moved = solid.copy().apply_transform(pose)
        points, ray, _ = moved.ray.intersects_location(np.zeros_like(rays), rays)
        for z, r in zip(points[:, 2], ray, strict=True):
            if z < reference[r]:
                reference[r], nearest[r] = z, index
    depth, mesh_index = image.depth.ravel(), image.mesh_index.ravel()
    same = np.isfinite(depth) == np.isfinite(reference)
    assert same.mean() > 0.999  # rays through an edge may fall either way in the reference
    both = same & np.isfinite(depth)
    assert np.abs(depth[both] - reference[both]).max() < 1e-5
    assert (mesh_index == nearest)[both].mean() > 0.999


def test_nearer_mesh_hides_the_farther_and_order_does_not_matter():
    small, big = triangles(trimesh.creation.icosphere(radius=0.02)), triangles(trimesh.creation.icosphere(radius=0.05))
    X_CM = np.stack([np.eye(4), np.eye(4)])
    X_CM[0, :3, 3], X_CM[1, :3, 3] = [0, 0, 0.3], [0, 0, 0.6]
    image = rasterise([small, big], X_CM, CAMERA)
    assert image.mesh_index[60, 80] == 0
    assert (image.mesh_index == 1).sum() > 0
    swapped = rasterise([big, small], X_CM[::-1], CAMERA)
    np.testing.assert_array_equal(image.depth, swapped.depth)
    np.testing.assert_array_equal(image.mesh_index == 0, swapped.mesh_index == 1)


def test_closed_mesh_has_no_pinholes():
    mesh = triangles(trimesh.creation.icosphere(subdivisions=6, radius=0.05))
    image = rasterise([mesh], camera_pose([0.15, 0.02, 0.01])[None], CAMERA)
    hit = np.isfinite(image.depth)
    for row in hit:
        columns = np.flatnonzero(row)
        assert len(columns) == 0 or len(columns) == columns[-1] - columns[0] + 1


def test_moving_scene_and_camera_together_changes_nothing(assets):
    scan = triangles(trimesh.load(assets / "ycb" / "006_mustard_bottle.ply", process=False))
    X_CM = camera_pose([0.3, 0.2, 0.2], scan.vertices.mean(0))
    move = trimesh.transformations.random_rotation_matrix(np.array([0.1, 0.5, 0.9]))
    moved = Triangles(scan.vertices @ move[:3, :3].T, scan.faces)
    first = rasterise([scan], X_CM[None], CAMERA).depth
    second = rasterise([moved], (X_CM @ np.linalg.inv(move))[None], CAMERA).depth
    both = np.isfinite(first) & np.isfinite(second)
    assert both.sum() > 1500 and (np.isfinite(first) ^ np.isfinite(second)).sum() <= 2
    # float32 depth and grazing faces: the median is exact, single silhouette pixels may pick the face behind
    assert np.median(np.abs(first[both] - second[both])) < 1e-6
    assert (np.abs(first[both] - second[both]) > 1e-5).mean() < 1e-3


def test_depth_images_equal_the_full_raster():
    mesh = triangles(trimesh.creation.torus(0.05, 0.02))
    poses = np.stack([camera_pose(eye) for eye in ([0.3, 0, 0], [0.1, 0.2, 0.2], [0, 0.05, 0.1])])
    batch = depth_images(mesh, poses, CAMERA)
    for depth, pose in zip(batch, poses, strict=True):
        np.testing.assert_array_equal(depth, rasterise([mesh], pose[None], CAMERA).depth)


def test_nothing_to_see():
    mesh = triangles(trimesh.creation.icosphere(radius=0.05))
    behind = np.eye(4)
    behind[2, 3] = -0.5
    degenerate = Triangles(np.full((3, 3), 0.5), np.array([[0, 1, 2]], np.int32))
    image = rasterise([mesh, degenerate], np.stack([behind, np.eye(4)]), CAMERA)
    assert not np.isfinite(image.depth).any()
    assert np.isinf(rasterise([], np.zeros((0, 4, 4)), CAMERA).depth).all()


def test_poses_must_match_the_meshes():
    with pytest.raises(ShapeError, match="one pose per mesh"):
        rasterise([plane(1.0)], np.eye(4), CAMERA)
    with pytest.raises(ShapeError, match=r"\(N, 4, 4\)"):
        depth_images(plane(1.0), np.eye(4), CAMERA)


def test_near_depth_cuts_into_a_solid():
    mesh = triangles(trimesh.creation.icosphere(subdivisions=4, radius=0.05))
    depth = rasterise([mesh], camera_pose([0.3, 0, 0])[None], CAMERA, near_m=0.26).depth
    assert depth[60, 80] == pytest.approx(0.35, abs=1e-3)  # the front cap is cut away: the far inside is seen
    assert np.nanmin(depth) >= 0.26


def test_labels_and_depth_agree_with_the_full_rasteriser():
    meshes = [triangles(trimesh.creation.icosphere(subdivisions=3, radius=0.05)), plane(0.2)]
    X_CM = np.stack([camera_pose([0.3, 0.1, 0.2])] * 2)
    X_CM[1, :3, 3] += [0.02, 0.01, 0.05]
    expected = rasterise(meshes, X_CM, CAMERA)
    points = np.concatenate([m.vertices @ X[:3, :3].T + X[:3, 3] for m, X in zip(meshes, X_CM, strict=True)])
    faces = np.concatenate([meshes[0].faces, meshes[1].faces + len(meshes[0].vertices)])
    face_labels = np.repeat(np.array([3, 5], np.int8), [len(m.faces) for m in meshes])
    depth, labels = np.full((120, 160), np.inf, np.float32), np.zeros((120, 160), np.int8)
    raster_labels(
        points, faces, face_labels, CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, 1e-3, depth, labels
    )  # fmt: skip
    np.testing.assert_array_equal(depth, expected.depth)
    np.testing.assert_array_equal(labels, np.array([3, 5, 0])[expected.mesh_index])
    assert all((labels == value).sum() > 300 for value in (0, 3, 5))
