"""What is drawn of a hand over a picture: where it is, as clear as it is trusted, in any part of the image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from neuralgrasps.errors import ShapeError
from neuralgrasps.geometry.camera import project
from neuralgrasps.geometry.mesh import merge_meshes
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.geometry.raster import rasterise
from neuralgrasps.hands.variants import mirror_matrix
from neuralgrasps.human.skeleton import TIPS, human_hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.report.hand_overlay import (
    FINGER_COLOURS,
    HandLayers,
    focus_window,
    hand_meshes,
    render_hand_overlay,
)
from tests.human.shown import CAMERA, ShownVideo, shown_video

GREY = np.full((CAMERA.height, CAMERA.width, 3), 90, np.uint8)


@pytest.fixture(scope="module")
def video(make_object: Callable[..., ObjectModel]) -> ShownVideo:
    return shown_video(make_object("brick", box_mesh(np.array([0.03, 0.03, 0.08]))), (0.03,))


def drawn(layers: HandLayers, **options: object) -> np.ndarray:
    return render_hand_overlay(GREY, layers, CAMERA, scale=3, labels=False, **options)  # type: ignore[arg-type]


def rgb(colour: str) -> np.ndarray:
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])


def tip_pixels(video: ShownVideo) -> np.ndarray:
    """(5, 2) row and column of the fingertips at three pixels a pixel."""
    assert video.seen[0] is not None
    uv = project(video.seen[0].points_C[list(TIPS)], CAMERA)
    return np.round((uv + 0.5) * 3 - 0.5).astype(int)[:, ::-1]


def test_each_fingertip_carries_the_colour_of_its_finger(video: ShownVideo):
    seen = video.seen[0]
    assert seen is not None
    picture = drawn(HandLayers(joints=replace(seen, mask=None)))
    for (row, column), colour in zip(tip_pixels(video), FINGER_COLOURS, strict=True):
        near = picture[row - 3 : row + 4, column - 3 : column + 4].reshape(-1, 3).astype(int)
        assert np.abs(near - rgb(colour)).max(axis=1).min() < 12


def test_a_joint_fades_with_its_weight_and_is_left_out_at_none(video: ShownVideo):
    seen = video.seen[0]
    assert seen is not None
    change = []
    for weight in (1.0, 0.2, 0.0):
        picture = drawn(HandLayers(joints=replace(seen, mask=None, weight=np.full(21, weight))))
        change.append(float(np.abs(picture.astype(int) - 90).sum()))
    assert change[0] > 1.5 * change[1] > 0
    assert change[2] == 0


def test_unknown_joints_are_left_out(video: ShownVideo):
    seen = video.seen[0]
    assert seen is not None
    points = np.full((21, 3), np.nan)
    assert np.array_equal(drawn(HandLayers(joints=replace(seen, mask=None, points_C=points))), drawn(HandLayers()))


def test_the_fitted_hand_covers_its_silhouette_and_nothing_else(video: ShownVideo):
    fitted = video.fits[0]
    assert fitted is not None
    picture = drawn(HandLayers(fitted=fitted))
    changed = np.abs(picture.astype(int) - 90).max(axis=2) > 8
    outline = rasterise([merge_meshes(hand_meshes(fitted))], np.eye(4)[None], CAMERA.scaled(3)).mesh_index >= 0
    assert changed[ndimage.binary_erosion(outline, iterations=2)].mean() > 0.98
    assert not changed[~ndimage.binary_dilation(outline, iterations=7)].any()


def test_what_lies_behind_the_measured_depth_is_fainter(video: ShownVideo):
    fitted = video.fits[0]
    assert fitted is not None
    shape = (CAMERA.height, CAMERA.width)
    free, hidden = (drawn(HandLayers(fitted=fitted), depth=np.full(shape, d)) for d in (2.0, 0.2))
    strength = [np.abs(p.astype(int) - 90).sum() for p in (free, hidden)]
    assert strength[1] < 0.75 * strength[0]
    assert strength[1] > 0


def test_a_part_of_the_image_is_that_part_of_the_whole(video: ShownVideo):
    left, top, width, height = 70, 40, 180, 135
    for layers in (HandLayers(box=video.boxes[0]), HandLayers(joints=video.seen[0]), HandLayers(fitted=video.fits[0])):
        part, whole = (np.abs(p.astype(int) - 90).max(axis=2) > 40 for p in (
            drawn(layers, window=(left, top, width, height)), drawn(layers)
        ))  # fmt: skip
        whole = whole[3 * top : 3 * (top + height), 3 * left : 3 * (left + width)]
        assert part.shape == whole.shape
        assert part.any()
        for one, other in ((part, whole), (whole, part)):  # the pen is as wide as the picture wants it
            inner = one[12:-12, 12:-12]
            assert ndimage.binary_dilation(other, iterations=4)[12:-12, 12:-12][inner].mean() > 0.995


def test_the_mirrored_left_hand_is_drawn_mirrored(video: ShownVideo):
    fitted = video.fits[0]
    assert fitted is not None
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    left = replace(fitted, side="left", X_CH=mirror @ fitted.X_CH @ mirror_matrix(human_hand("right")))
    camera = replace(CAMERA, cx=CAMERA.width - 1 - CAMERA.cx)
    picture = render_hand_overlay(GREY, HandLayers(fitted=left), camera, scale=3, labels=False)
    changed = np.abs(picture.astype(int) - 90).max(axis=2) > 8
    expected = np.abs(drawn(HandLayers(fitted=fitted)).astype(int) - 90).max(axis=2)[:, ::-1] > 8
    assert (changed & expected).sum() > 0.97 * (changed | expected).sum()


def test_the_window_holds_hand_and_object_in_the_wanted_shape(video: ShownVideo):
    layers = [HandLayers(box=video.boxes[0], joints=video.seen[0])]
    left, top, width, height = focus_window(layers, CAMERA, aspect=4 / 3)
    box = video.boxes[0]
    assert box is not None
    assert left <= box.u_min and box.u_max <= left + width
    assert top <= box.v_min and box.v_max <= top + height
    assert width / height == pytest.approx(4 / 3, abs=0.03)
    assert min(left, top) >= 0 and left + width <= CAMERA.width and top + height <= CAMERA.height
    assert width < CAMERA.width


def test_the_window_is_the_whole_image_when_nothing_was_seen():
    assert focus_window([HandLayers()], CAMERA) == (0, 0, CAMERA.width, CAMERA.height)


def test_labels_name_side_and_doubt(video: ShownVideo):
    box = video.boxes[0]
    assert box is not None
    sure, unsure = (
        render_hand_overlay(GREY, HandLayers(box=replace(box, side_score=s)), CAMERA, scale=3) for s in (0.9, 0.55)
    )
    assert (sure != drawn(HandLayers(box=box))).any()  # a label was added
    assert (sure != unsure).any()  # and it says that the side is in doubt


def test_a_mask_of_another_size_is_refused(video: ShownVideo):
    seen = video.seen[0]
    assert seen is not None
    with pytest.raises(ShapeError, match="mask has shape"):
        drawn(HandLayers(joints=replace(seen, mask=np.zeros((10, 10), bool))))
