"""The part of a depth image around a hand, as a fit uses it: where the hand may be, and where it would hide things."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.errors import check_shape
from neuralgrasps.perception.frame import Frame

_MARGIN = 0.35  # of the mask's longer side, around it
_MOST_PX = 120  # of the crop; a larger one is thinned
_FAR = 1 << 14


class HandView(NamedTuple):
    """A crop of a depth image.

    Attributes:
        depth: (h, w) float64, metres, 0 = not measured.
        near: (h, w, 2) int64 row and column of the nearest pixel that may show the hand: in its mask, or not measured.
        camera: (4,) fx, fy, cx, cy of the crop.
    """

    depth: np.ndarray
    near: np.ndarray
    camera: np.ndarray


def no_view() -> HandView:
    """A view that says nothing."""
    return HandView(np.zeros((0, 0)), np.zeros((0, 0, 2), np.int64), np.ones(4))


def hand_view(frame: Frame, mask: np.ndarray, *, mirrored: bool = False) -> HandView:
    """The crop around a mask (h, w) of the hand, of the image or its mirror image; an empty mask: no view.

    Raises:
        ShapeError: the mask is not of the image's size.
    """
    check_shape("mask", np.shape(mask), frame.depth.shape)
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return no_view()
    margin = int(_MARGIN * max(rows[-1] - rows[0], columns[-1] - columns[0])) + 2
    top, left = max(int(rows[0]) - margin, 0), max(int(columns[0]) - margin, 0)
    bottom, right = int(rows[-1]) + margin + 1, int(columns[-1]) + margin + 1
    step = 1 + max(bottom - top, right - left) // _MOST_PX
    place = np.s_[top:bottom:step, left:right:step]
    depth, shown = np.asarray(frame.depth[place], np.float64), np.asarray(mask[place], bool)
    camera, k = np.empty(4), frame.intrinsics
    camera[:] = k.fx / step, k.fy / step, (k.cx - left) / step, (k.cy - top) / step
    if mirrored:
        depth, shown = depth[:, ::-1], shown[:, ::-1]
        camera[2] = depth.shape[1] - 1 - camera[2]
    near = np.empty((*depth.shape, 2), np.int64)
    nearest_allowed(np.ascontiguousarray(shown | (depth == 0.0)), near)
    return HandView(np.ascontiguousarray(depth), near, camera)


@njit(cache=True, error_model="numpy")
def nearest_allowed(allowed, near):  # type: ignore[no-untyped-def]
    """Row and column of (about) the nearest True pixel of `allowed` (h, w) into `near` (h, w, 2).

    Two passes over the eight neighbours (Danielsson 1980); where none is True, the pixel itself stands.
    """
    height, width = allowed.shape
    for v in range(height):
        for u in range(width):
            near[v, u, 0], near[v, u, 1] = (v, u) if allowed[v, u] else (-_FAR, -_FAR)
    for turn in range(2):
        step = 1 if turn == 0 else -1
        for i in range(height):
            v = i if turn == 0 else height - 1 - i
            for k in range(width):
                u = k if turn == 0 else width - 1 - k
                _take(near, v, u, v - step, u)
                _take(near, v, u, v, u - step)
                _take(near, v, u, v - step, u - 1)
                _take(near, v, u, v - step, u + 1)
            for k in range(width):
                u = width - 1 - k if turn == 0 else k
                _take(near, v, u, v, u + step)
    for v in range(height):
        for u in range(width):
            if near[v, u, 0] < 0:
                near[v, u, 0], near[v, u, 1] = v, u


@njit(cache=True, inline="always", error_model="numpy")
def _take(near, v, u, row, column):  # type: ignore[no-untyped-def]
    """Take over a neighbour's nearest pixel if it is nearer."""
    if 0 <= row < near.shape[0] and 0 <= column < near.shape[1] and near[row, column, 0] >= 0:
        dv, du = near[row, column, 0] - v, near[row, column, 1] - u
        ov, ou = near[v, u, 0] - v, near[v, u, 1] - u
        if dv * dv + du * du < ov * ov + ou * ou:
            near[v, u, 0], near[v, u, 1] = near[row, column, 0], near[row, column, 1]
