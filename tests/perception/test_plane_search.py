"""Planes found and fitted in inverse depth, against plain references."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from neuralgrasps.geometry.camera import Intrinsics, pixel_rays
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.perception.clusters import _labelled
from neuralgrasps.perception.frame import Frame
from neuralgrasps.perception.plane_search import (
    _weighted_fit,
    fitted_plane,
    image_cells,
    in_band,
    plane_of,
    search_planes,
)
from neuralgrasps.perception.touching import _components

CAMERA = Intrinsics.from_fov(np.deg2rad(50.0), 320, 240)
PLANES = [np.array([0.1, 1.4, 0.9]), np.array([-0.9, 0.2, 0.7]), np.array([0.3, 0.1, 0.8])]


def _frame(noise=0.0):
    """Three planes w . p = 1, the nearest of which is seen, with noise of 1 / z."""
    rng = np.random.default_rng(0)
    inverse = np.max([pixel_rays(CAMERA) @ w for w in PLANES], axis=0)
    return Frame(1.0 / (inverse + noise * rng.standard_normal(inverse.shape)), CAMERA)


def test_a_fit_is_the_weighted_least_squares_solution():
    rng = np.random.default_rng(1)
    x, y = rng.uniform(-0.5, 0.5, (2, 400))
    w = np.array([0.3, -0.2, 1.1])
    q = np.stack([x, y, np.ones(400)], axis=1) @ w + 0.01 * rng.standard_normal(400)
    weight = np.clip(1.0 - ((q - np.stack([x, y, np.ones(400)], axis=1) @ w) / 0.02) ** 2, 0.0, None)
    A = np.stack([x, y, np.ones(400)], axis=1) * weight[:, None]
    np.testing.assert_allclose(_weighted_fit(x, y, q, w, 0.02), np.linalg.lstsq(A, q * weight)[0], atol=1e-9)
    flat = np.zeros(5)  # no plane through points on one line
    np.testing.assert_array_equal(_weighted_fit(flat, flat, flat + 1.0, w, np.inf), w)


@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_every_plane_is_found(noise):
    found = search_planes(image_cells(_frame(noise), np.inf), count=6, least=100, seed=0)
    assert len(found) == 3
    for w in PLANES:
        assert min(np.abs(w - one).max() for one in found) < 2e-3


def test_what_lies_beyond_the_farthest_depth_is_left_out():
    frame = _frame()
    cells = image_cells(frame, 0.9)
    assert 1.0 / cells.inverse[cells.inverse > 0].min() < 0.9
    assert (cells.inverse == 0).any()


def test_the_band_is_around_the_plane_along_the_rays():
    frame = _frame()
    plane = plane_of(PLANES[0])
    on_plane = -plane.offset_m / (pixel_rays(CAMERA) @ plane.normal)
    off = np.abs(frame.depth - on_plane)
    np.testing.assert_array_equal(
        in_band(frame, plane), (on_plane > 0) & (off < np.maximum(0.008 * frame.depth**2, 0.003))
    )


def test_a_fitted_plane_does_not_heed_strays():
    frame = _frame(0.002)
    on = pixel_rays(CAMERA) @ PLANES[0] > np.max([pixel_rays(CAMERA) @ w for w in PLANES[1:]], axis=0)
    depth = frame.depth.copy()
    depth[on & (np.random.default_rng(2).random(depth.shape) < 0.2)] *= 0.97
    start = PLANES[0] + [0.01, -0.01, 0.01]
    plane = fitted_plane(Frame(depth, CAMERA), plane_of(start), on)
    truth = plane_of(PLANES[0])
    assert isinstance(plane, Plane)
    assert np.rad2deg(np.arccos(plane.normal @ truth.normal)) < 0.05 and abs(plane.offset_m - truth.offset_m) < 5e-4


def test_labels_are_those_of_a_plain_labelling():
    rng = np.random.default_rng(3)
    mask = ndimage.binary_opening(rng.random((60, 80)) < 0.8, np.ones((3, 3)))
    ours, count = _components(mask), ndimage.label(mask)[1]
    np.testing.assert_array_equal(ours, ndimage.label(mask)[0])
    assert ours.max() == count
    # on a level surface nothing jumps: 8-connected regions of pixels with 5 neighbours or more
    core = mask & (ndimage.convolve(mask.astype(int), np.ones((3, 3), int), mode="constant") - 1 >= 5)
    labels = _labelled(np.where(mask, 1.0, 0.0), mask, 0.01, 0.001)
    np.testing.assert_array_equal(labels[core], ndimage.label(core, np.ones((3, 3)))[0][core])
