"""Pictures: normals, cameras, shading and the figures made of them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from neuralgrasps.errors import InputError, ShapeError, StorageError
from neuralgrasps.geometry.camera import project
from neuralgrasps.geometry.mesh import Mesh, box_mesh, capsule_mesh, sphere_mesh
from neuralgrasps.geometry.raster import rasterise
from neuralgrasps.hands.zoo import hand_names, load_hand
from neuralgrasps.report.figures import (
    fine_mesh,
    posed_hand_surfaces,
    render_depth,
    render_grasp,
    render_hand,
    render_object,
    save_picture,
    values_at_vertices,
)
from neuralgrasps.report.palette import hand_colour, linear_rgb, oklab, srgb_to_linear
from neuralgrasps.report.shading import Style, Surface, shade
from neuralgrasps.report.smooth_normals import corner_normals
from neuralgrasps.report.views import best_direction, best_surface_direction, frame_camera, view_direction

SMALL = (120, 90)


def moved(mesh: Mesh, offset) -> Mesh:
    return Mesh(mesh.vertices + np.asarray(offset, float), mesh.faces)


def test_normals_are_smooth_on_a_sphere():
    mesh = sphere_mesh(0.05, segments=64)
    normals = corner_normals(mesh.vertices, mesh.faces)
    exact = mesh.vertices[mesh.faces] / 0.05
    assert (np.einsum("fkd,fkd->fk", normals, exact) > math.cos(math.radians(2))).all()


def test_normals_are_sharp_on_a_box_even_without_shared_vertices():
    box = box_mesh([0.01, 0.02, 0.03])
    soup = Mesh(box.vertices[box.faces].reshape(-1, 3), np.arange(3 * len(box.faces)).reshape(-1, 3))
    for mesh in (box, soup):
        normals = corner_normals(mesh.vertices, mesh.faces)
        corners = mesh.vertices[mesh.faces]
        flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        flat /= np.linalg.norm(flat, axis=1, keepdims=True)
        np.testing.assert_allclose(normals, np.repeat(flat[:, None], 3, 1), atol=1e-6)


def test_normals_join_across_duplicated_vertices():
    mesh = sphere_mesh(0.05, segments=32)
    soup = Mesh(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3))
    joined = corner_normals(mesh.vertices, mesh.faces)
    np.testing.assert_allclose(corner_normals(soup.vertices, soup.faces), joined, atol=1e-5)


@pytest.mark.parametrize("seed", range(5))
def test_camera_frames_all_points_and_touches_the_margin(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(200, 3)) * rng.uniform(0.01, 0.3, 3) + rng.normal(size=3)
    X_WC, k = frame_camera(points, view_direction(*rng.uniform(-80, 80, 2)), (400, 300), margin=0.1)
    X_CW = np.linalg.inv(X_WC)
    uv = project(points @ X_CW[:3, :3].T + X_CW[:3, 3], k)
    used = np.abs((uv - [k.cx, k.cy]) / [200, 150]).max(axis=0)
    assert used.max() == pytest.approx(0.9, abs=1e-6)


def test_camera_needs_something_to_look_at():
    with pytest.raises(InputError, match="nothing to look at"):
        frame_camera(np.zeros((0, 3)), np.array([1.0, 0, 0]), SMALL)


def test_best_view_is_not_hidden_behind_the_hand():
    hand = [moved(box_mesh([0.005, 0.08, 0.08]), [0.045, 0, 0])]  # a plate on the +x side of a ball
    direction = best_direction(hand, sphere_mesh(0.04))
    assert direction[0] < 0.3


def test_best_view_of_values_faces_them():
    mesh = sphere_mesh(0.05)
    values = np.clip(mesh.vertices[:, 1] / 0.05, 0, 1) ** 4  # contact around +y
    assert best_surface_direction(mesh, values)[1] > 0.8


def test_object_is_where_it_should_be_and_the_background_is_transparent():
    picture = render_object(sphere_mesh(0.05, segments=48), size=SMALL)
    assert picture.shape == (90, 120, 4) and picture.dtype == np.uint8
    assert picture[45, 60, 3] == 255
    assert picture[0, 0, 3] == 0 and picture[0, -1, 3] == 0
    opaque = picture[..., 3] == 255
    assert abs(opaque.sum() / (math.pi * (0.93 * 45) ** 2) - 1) < 0.1  # the ball fills the margin


def test_light_comes_from_above_and_the_ball_throws_a_shadow():
    ball = sphere_mesh(0.05, segments=48)
    picture = render_object(ball, size=SMALL, view=view_direction(0, 20)).astype(float)
    assert picture[15:30, 50:70, :3].mean() > picture[65:80, 50:70, :3].mean() + 20
    faint = (picture[..., 3] > 10) & (picture[..., 3] < 200)
    assert faint[60:].sum() > 3 * faint[:30].sum()
    X_WC, k = frame_camera(ball.vertices, view_direction(0, 20), SMALL)
    surface = Surface(mesh=ball, colour=np.full(3, 0.7))
    bare = shade([surface], X_WC, k, style=Style(ground=False))
    partial = (bare[..., 3] > 0) & (bare[..., 3] < 255)
    assert partial.sum() < 400  # only the antialiased silhouette


def test_a_lid_darkens_what_is_under_it():
    floor = box_mesh([0.1, 0.1, 0.005])
    lid = moved(box_mesh([0.06, 0.06, 0.005]), [0, 0, 0.03])
    X_WC, k = frame_camera(floor.vertices, view_direction(0, 18), SMALL)
    grey = np.full(3, 0.5)
    alone = shade([Surface(mesh=floor, colour=grey)], X_WC, k)
    covered = shade([Surface(mesh=floor, colour=grey), Surface(mesh=lid, colour=grey)], X_WC, k)
    image = rasterise([floor, lid], np.stack([np.linalg.inv(X_WC)] * 2), k)
    face_z = floor.vertices[floor.faces].mean(axis=1)[:, 2]
    top = (image.mesh_index == 0) & (face_z[image.face_index.clip(0, len(face_z) - 1)] > 0.004)
    under = np.zeros_like(top)
    under[:, 50:70] = top[:, 50:70]
    assert under.sum() > 50
    assert covered[under][:, :3].mean() < alone[under][:, :3].mean() - 25


def test_pictures_are_reproducible():
    mesh = capsule_mesh(0.02, 0.04)
    np.testing.assert_array_equal(render_object(mesh, size=SMALL), render_object(mesh, size=SMALL))


def test_vertex_values_colour_the_object():
    mesh = fine_mesh(box_mesh([0.03, 0.03, 0.03]))
    values = (mesh.vertices[:, 2] > 0.0).astype(float)
    picture = render_object(mesh, vertex_values=values, size=SMALL, view=view_direction(30, 20))
    lab = oklab(srgb_to_linear(picture[..., :3] / 255.0))
    assert lab[35, 60, 1] > 0.08 > lab[68, 60, 1]  # red above, plain below
    with pytest.raises(ShapeError, match="vertices"):
        render_object(mesh, vertex_values=values[:-1])


def test_fine_mesh_keeps_the_surface():
    mesh = fine_mesh(box_mesh([0.03, 0.02, 0.01]), longest_edge_m=0.01)
    corners = mesh.vertices[mesh.faces]
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).max() <= 0.01 + 1e-12
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    assert area == pytest.approx(8 * (0.03 * 0.02 + 0.03 * 0.01 + 0.02 * 0.01))


def test_values_at_vertices_follow_a_smooth_field():
    mesh = sphere_mesh(0.05, segments=24)
    dense = sphere_mesh(0.05, segments=96).vertices
    got = values_at_vertices(mesh, dense, 0.5 + 10 * dense[:, 2])
    np.testing.assert_allclose(got, 0.5 + 10 * mesh.vertices[:, 2], atol=0.02)
    with pytest.raises(ShapeError, match="one per point"):
        values_at_vertices(mesh, dense, np.zeros(3))


@pytest.mark.parametrize("name", hand_names())
def test_hands_are_drawn_in_their_colour(name):
    picture = render_hand(load_hand(name), size=SMALL)
    solid = picture[picture[..., 3] == 255][:, :3]
    assert len(solid) > 800
    lab, own = oklab(srgb_to_linear(solid / 255.0)), oklab(linear_rgb(hand_colour(name)))
    hue = np.abs(np.angle(np.exp(1j * (np.arctan2(lab[:, 2], lab[:, 1]) - np.arctan2(own[2], own[1])))))
    vivid = np.hypot(lab[:, 1], lab[:, 2]) > 0.06
    assert (vivid & (hue < 0.5)).sum() > 150


class Ball:
    """Enough of an object model for a picture."""

    mesh = sphere_mesh(0.04)


def test_grasp_shows_hand_and_object():
    hand = load_hand("panda")
    X_OP = np.eye(4)
    X_OP[:3, :3] = np.diag([1.0, -1.0, -1.0])  # palm looks down on the ball
    X_OP[2, 3] = 0.09
    X_OH = X_OP @ np.linalg.inv(hand.X_HP)
    picture = render_grasp(hand, Ball, X_OH, hand.q_open, size=SMALL, view=view_direction(90, 5))
    lab = oklab(srgb_to_linear(picture[..., :3] / 255.0))
    plain = (picture[..., 3] == 255) & (lab[..., 0] > 0.75) & (np.hypot(lab[..., 1], lab[..., 2]) < 0.05)
    rows, columns = np.nonzero(plain)
    assert rows.mean() > 55 and abs(columns.mean() - 60) < 12  # the pale ball below, the hand above
    single = render_grasp(hand, Ball, X_OH[None], hand.q_open[None], size=SMALL, view=view_direction(90, 5))
    np.testing.assert_array_equal(picture, single)


def test_a_batch_of_grasps_is_refused():
    hand = load_hand("panda")
    with pytest.raises(ShapeError, match="one grasp"):
        posed_hand_surfaces(hand, np.stack([np.eye(4)] * 2), hand.q_open)
    with pytest.raises(ShapeError, match="joints"):
        posed_hand_surfaces(hand, np.eye(4), np.zeros(9))


def test_depth_picture_darkens_with_distance_and_greys_the_unknown():
    depth = np.tile(np.linspace(0.4, 1.2, 50), (10, 1))
    depth[0, :5] = [0.0, np.nan, np.inf, -1.0, 0.0]
    picture = render_depth(depth)
    assert len(np.unique(picture[0, :5].reshape(-1, 3), axis=0)) == 1
    assert (np.diff(oklab(srgb_to_linear(picture[5] / 255.0))[:, 0]) <= 1e-9).all()
    assert render_depth(np.zeros((4, 4))).shape == (4, 4, 3)
    with pytest.raises(ShapeError):
        render_depth(np.zeros((4, 4, 3)))


def test_save_picture(tmp_path):
    picture = render_object(sphere_mesh(0.05), size=(40, 30))
    save_picture(tmp_path / "ball.png", picture, background="#ffffff")
    assert (tmp_path / "ball.png").read_bytes()[:4] == b"\x89PNG"
    with pytest.raises(StorageError, match="does not exist"):
        save_picture(tmp_path / "missing" / "ball.png", picture)
