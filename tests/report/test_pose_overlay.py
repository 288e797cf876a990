"""Lines, labels and pictures of found poses."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from neuralgrasps.errors import ShapeError
from neuralgrasps.geometry.camera import Intrinsics, look_at, project
from neuralgrasps.geometry.mesh import load_mesh, merge_meshes
from neuralgrasps.geometry.primitives import box_mesh, cylinder_mesh, sphere_mesh
from neuralgrasps.geometry.raster import rasterise
from neuralgrasps.report.labels import Label, draw_labels, place_labels
from neuralgrasps.report.model_lines import model_lines
from neuralgrasps.report.palette import oklab, srgb_to_linear
from neuralgrasps.report.pose_overlay import (
    MODEL_COLOURS,
    DrawnModel,
    model_colour,
    render_pose_overlay,
    render_relief,
)

CAMERA = Intrinsics.from_fov(math.radians(40), 160, 120)


def seen_from(*eye: float) -> np.ndarray:
    return np.linalg.inv(look_at(np.array(eye), np.zeros(3)))


def box_edges(half: np.ndarray, X_CO: np.ndarray, visible: bool) -> np.ndarray:
    """(M, 3) points along the edges of a box that has a visible face (or none) beside them, camera frame."""
    points = []
    for axis in range(3):
        a, b = (k for k in range(3) if k != axis)
        for sa in (-1, 1):
            for sb in (-1, 1):
                line = np.zeros((200, 3))
                line[:, axis] = np.linspace(-half[axis], half[axis], 200)
                line[:, a], line[:, b] = sa * half[a], sb * half[b]
                eye = np.linalg.inv(X_CO)[:3, 3]
                faces = [sa * eye[a] > half[a], sb * eye[b] > half[b]]
                if any(faces) == visible:
                    points.append(line)
    return np.concatenate(points) @ X_CO[:3, :3].T + X_CO[:3, 3]


def test_lines_of_a_box_are_its_visible_edges():
    half = np.array([0.05, 0.03, 0.08])
    X_CO = seen_from(0.35, -0.3, 0.3)
    fine = CAMERA.scaled(4)
    lines = model_lines(box_mesh(half), X_CO, fine)
    rows, columns = np.nonzero(lines.contour | lines.crease)
    drawn = np.stack([columns + lines.left, rows + lines.top], axis=1)
    edges = project(box_edges(half, X_CO, visible=True), fine)
    assert np.quantile(KDTree(edges).query(drawn)[0], 0.99) < 3.0  # nothing drawn that is no edge
    assert np.quantile(KDTree(drawn).query(edges)[0], 0.97) < 4.0  # and every edge drawn
    inner = project(box_edges(half, X_CO, visible=False), fine)
    assert np.median(KDTree(drawn).query(inner)[0]) > 10.0
    assert lines.crease.any() and not (lines.crease & lines.contour).any()


def test_round_things_have_no_creases_and_a_cylinder_one_rim():
    ball = model_lines(sphere_mesh(0.05), seen_from(0.5, 0, 0.1), CAMERA.scaled(4))
    assert not ball.crease.any()
    radius, half = 0.04, 0.06
    can = model_lines(cylinder_mesh(radius, half), seen_from(0.4, 0, 0.3), CAMERA.scaled(4))
    rows, columns = np.nonzero(can.crease)
    angle = np.linspace(0, 2 * np.pi, 400)
    rim = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(400, half)], axis=1)
    X_CO = seen_from(0.4, 0, 0.3)
    near = project(rim @ X_CO[:3, :3].T + X_CO[:3, 3], CAMERA.scaled(4))
    assert len(rows) > 50
    assert KDTree(near).query(np.stack([columns + can.left, rows + can.top], axis=1))[0].max() < 4.0


def test_inner_contours_are_found():
    """Two boxes one behind the other are one mesh: the outline of the nearer one crosses the farther one."""
    near, far = box_mesh([0.02, 0.02, 0.02]), box_mesh([0.005, 0.08, 0.08])
    mesh = merge_meshes([near.transformed(_moved(0.06)), far])
    lines = model_lines(mesh, seen_from(0.6, 0.0, 0.0), CAMERA.scaled(4))
    height, width = lines.depth.shape
    middle = lines.contour[height // 2]
    assert middle.sum() == 4  # far, near, near, far
    assert lines.contour[:, width // 2].sum() == 4


def _moved(x: float) -> np.ndarray:
    X = np.eye(4)
    X[0, 3] = x
    return X


def test_scans_have_few_stray_lines(assets: Path):
    mesh = load_mesh(assets / "ycb" / "003_cracker_box.ply").mesh
    centre = mesh.vertices.mean(axis=0)
    X_CO = np.linalg.inv(look_at(centre + np.array([0.5, -0.45, 0.35]), centre))
    lines = model_lines(mesh, X_CO, Intrinsics(2133.6, 2135.0, 626.5, 483.1, 1280, 960))
    # three inner edges of a box of 158 x 210 x 60 mm: at most their length, and at least the two long ones
    length_m = lines.crease.sum() * float(np.median(lines.depth[np.isfinite(lines.depth)])) / 2133.6
    assert 0.2 < length_m < 0.5


def test_models_behind_the_camera_or_beside_the_image_draw_nothing():
    behind = seen_from(0.4, 0, 0)
    behind[2, 3] -= 2.0
    beside = seen_from(0.4, 0, 0)
    beside[0, 3] += 3.0
    grey = np.full((120, 160, 3), 90, np.uint8)
    for X_CO in (behind, beside):
        models = [DrawnModel(mesh=sphere_mesh(0.05), X_CO=X_CO, label="ball")]
        assert (render_pose_overlay(grey, models, CAMERA, scale=1) == grey).all()


def test_a_model_half_out_of_view_is_drawn():
    X_CO = seen_from(0.4, 0, 0)
    X_CO[0, 3] += 0.19
    models = [DrawnModel(mesh=sphere_mesh(0.05), X_CO=X_CO, label="a ball at the border")]
    picture = render_pose_overlay(np.full((120, 160, 3), 90, np.uint8), models, CAMERA)
    assert (picture != 90).any()


def test_overlay_changes_the_model_and_leaves_the_rest():
    mesh = sphere_mesh(0.05)
    X_CO = seen_from(0.4, 0, 0)
    depth = rasterise([mesh], X_CO[None], CAMERA).depth
    hit = np.isfinite(depth)
    plain = np.full((120, 160, 3), 120, np.uint8)
    picture = render_pose_overlay(plain, [DrawnModel(mesh=mesh, X_CO=X_CO)], CAMERA, scale=1).astype(int)
    changed = np.abs(picture - 120).max(axis=-1) > 6
    assert changed[hit].mean() > 0.97
    assert changed[~hit].sum() < 400  # the edging of the line
    outline = render_pose_overlay(plain, [DrawnModel(mesh=mesh, X_CO=X_CO, contour_only=True)], CAMERA, scale=1).astype(
        int
    )
    assert (np.abs(outline - 120).max(axis=-1) > 6)[hit].mean() < 0.4


def test_lines_behind_the_measured_surface_are_faint():
    mesh = box_mesh([0.05, 0.05, 0.05])
    X_CO = seen_from(0.4, -0.2, 0.2)
    free = np.full((120, 160), 3.0)
    hidden = free.copy()
    hidden[:, 80:] = 0.2  # something near covers the right half
    grey = np.full((120, 160, 3), 60, np.uint8)
    models = [DrawnModel(mesh=mesh, X_CO=X_CO)]
    seen, half = (
        np.abs(render_pose_overlay(grey, models, CAMERA, depth=d, scale=1).astype(int) - 60).sum(axis=-1)
        for d in (free, hidden)
    )
    assert np.array_equal(seen[:, :75], half[:, :75])
    assert 0.1 * seen[:, 85:].sum() < half[:, 85:].sum() < 0.5 * seen[:, 85:].sum()
    unmeasured = render_pose_overlay(grey, models, CAMERA, depth=np.zeros((120, 160)), scale=1)
    assert np.array_equal(np.abs(unmeasured.astype(int) - 60).sum(axis=-1), seen)  # nothing measured hides nothing


def test_overlay_is_of_the_cameras_size_and_refuses_others():
    depth = np.full((120, 160), 0.8)
    models = [DrawnModel(mesh=sphere_mesh(0.05), X_CO=seen_from(0.4, 0, 0), label="ball 99 %")]
    assert render_pose_overlay(depth, models, CAMERA).shape == (240, 320, 3)
    assert render_pose_overlay(depth, models, CAMERA, scale=3).shape == (360, 480, 3)
    with pytest.raises(ShapeError, match=r"\(120, 160\)"):
        render_pose_overlay(np.ones((10, 10)), models, CAMERA)
    with pytest.raises(ShapeError, match="depth has shape"):
        render_pose_overlay(np.zeros((120, 160, 3), np.uint8), models, CAMERA, depth=np.ones((10, 10)))


def test_model_colours_are_apart_and_bright():
    lab = oklab(
        np.stack([srgb_to_linear(np.array([int(c[i : i + 2], 16) for i in (1, 3, 5)]) / 255) for c in MODEL_COLOURS])
    )
    assert (lab[:, 0] > 0.7).all()
    gap = np.linalg.norm(lab[:, None] - lab[None], axis=-1) + np.eye(len(lab))
    assert gap.min() > 0.1
    assert model_colour(0) != model_colour(1) and model_colour(len(MODEL_COLOURS)) == model_colour(0)


def rectangles_overlap(spots: list[tuple[int, int]], sizes: list[tuple[int, int]]) -> bool:
    boxes = [(r, c, r + h, c + w) for (r, c), (h, w) in zip(spots, sizes, strict=True)]
    return any(
        a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3] for i, a in enumerate(boxes) for b in boxes[:i]
    )


def test_labels_keep_clear_of_each_other_and_of_models():
    rng = np.random.default_rng(0)
    for _ in range(10):
        targets, sizes = [], []
        for _ in range(6):
            row, column = rng.integers(0, 160), rng.integers(0, 240)
            target = np.zeros((240, 320), bool)
            target[row : row + 60, column : column + 50] = True
            targets.append(target)
            sizes.append((16, int(rng.integers(60, 120))))
        spots = place_labels(sizes, targets)
        assert not rectangles_overlap(spots, sizes)
        for (row, column), (height, width) in zip(spots, sizes, strict=True):
            assert min(row, column) >= 0 and row + height <= 240 and column + width <= 320


def test_a_lone_label_stands_just_above_its_target():
    target = np.zeros((240, 320), bool)
    target[120:180, 140:200] = True
    ((row, column),) = place_labels([(16, 80)], [target])
    assert row + 16 <= 120 and 120 - (row + 16) <= 8
    assert abs(column + 40 - 170) <= 8


def test_a_label_covers_neither_its_target_nor_another():
    own, other = np.zeros((240, 320), bool), np.zeros((240, 320), bool)
    own[120:180, 140:200] = True
    other[60:118, 60:280] = True  # right above, where the label would stand
    spots = place_labels([(16, 80), (16, 60)], [own, other])
    for (row, column), (height, width) in zip(spots, [(16, 80), (16, 60)], strict=True):
        assert not (own | other)[row : row + height, column : column + width].any()


def test_a_crowded_picture_still_gets_every_label():
    everywhere = np.ones((60, 90), bool)
    spots = place_labels([(20, 80)] * 4, [everywhere] * 4)
    assert len(spots) == 4
    assert place_labels([(20, 200)], [everywhere])[0][1] == 0  # wider than the picture: its start stays readable


def test_label_letters_stand_out_from_any_background():
    for level in (0, 128, 255):
        picture = np.full((120, 320, 3), level, np.uint8)
        target = np.zeros((120, 320), bool)
        target[80:110, 100:200] = True
        out = draw_labels(picture, [Label(text="mustard bottle 97 %", colour="#37d3ff", target=target)], size=20)
        plate = out[np.abs(out.astype(int) - level).max(axis=-1) > 8].mean(axis=-1)
        assert plate.max() > 240 and np.quantile(plate, 0.3) < 60
        assert (out[85:105] == level).all()  # the target itself is left free


def test_relief_darkens_with_distance_and_shades_slopes():
    depth = np.tile(np.linspace(0.5, 1.0, 160), (120, 1))
    depth[:10] = 0.0
    picture = render_relief(depth, CAMERA)
    assert len(np.unique(picture[2:6].reshape(-1, 3), axis=0)) == 1  # nothing measured: plain
    lightness = oklab(srgb_to_linear(picture[60] / 255.0))[:, 0]
    assert lightness[10] > lightness[80] > lightness[150]
    ball = rasterise([sphere_mesh(0.08)], seen_from(0.4, 0, 0)[None], CAMERA).depth
    shaded = render_relief(np.where(np.isfinite(ball), ball, 0.0), CAMERA).mean(axis=-1)
    assert shaded[45, 65] > shaded[75, 95] + 15  # lit from above and left
