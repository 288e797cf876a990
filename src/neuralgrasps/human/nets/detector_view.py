"""A depth image brought to the focal length and size that the hand detector sees, and boxes brought back."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.camera import Intrinsics

FOCAL_PX = 145.0
"""Focal length of all images that the network sees: a camera of 640 x 480 with 580, at a quarter of its size."""
PATCH = 16
"""Their sizes are multiples of this."""

_LARGEST_PX = 320  # the image covers no more than this, however wide the camera
_TAPS = 3  # depths looked at per pixel, along each side
_FEWEST = 3  # of 9, that must have been measured


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectorView:
    """What the detector sees of a frame.

    Attributes:
        depth: (h, w) float32 metres, 0 = not measured; h and w are multiples of `PATCH`, padded at right and bottom.
        scale: (2,) its pixels per pixel of the frame, along u and v.
    """

    depth: np.ndarray
    scale: np.ndarray

    def to_frame(self, boxes: np.ndarray) -> np.ndarray:
        """Boxes (N, 4) of this image, u_min, v_min, u_max, v_max, in pixels of the frame."""
        return (np.asarray(boxes, np.float64) + 0.5) / np.tile(self.scale, 2) - 0.5


def detector_view(depth: np.ndarray, intrinsics: Intrinsics) -> DetectorView:
    """Resample a depth image (h, w), metres, 0 = not measured: medians where pixels shrink, nearest where they grow."""
    k = intrinsics
    focal = FOCAL_PX * min(1.0, _LARGEST_PX / (FOCAL_PX * max(k.width / k.fx, k.height / k.fy)))
    scale = np.array([focal / k.fx, focal / k.fy])
    size = [max(round(n * s), 1) for n, s in zip((k.width, k.height), scale, strict=True)]
    out = np.zeros([math.ceil(n / PATCH) * PATCH for n in reversed(size)], np.float32)
    _resample(np.ascontiguousarray(depth, np.float64), scale[0], scale[1], size[0], size[1], out)
    return DetectorView(depth=out, scale=scale)


@njit(cache=True, error_model="numpy")
def _resample(depth, scale_u, scale_v, width, height, out):  # type: ignore[no-untyped-def]
    rows, columns = depth.shape
    taps_u = _TAPS if scale_u < 1.0 else 1
    taps_v = _TAPS if scale_v < 1.0 else 1
    fewest = max(1, _FEWEST * taps_u * taps_v // (_TAPS * _TAPS))
    found = np.empty(_TAPS * _TAPS)
    for v in range(height):
        for u in range(width):
            count = 0
            for j in range(taps_v):
                row = int((v + (j + 0.5) / taps_v) / scale_v)
                for i in range(taps_u):
                    column = int((u + (i + 0.5) / taps_u) / scale_u)
                    if row >= rows or column >= columns or not depth[row, column] > 0.0:
                        continue
                    z = depth[row, column]
                    at = count
                    while at > 0 and found[at - 1] > z:
                        found[at] = found[at - 1]
                        at -= 1
                    found[at] = z
                    count += 1
            if count >= fewest:
                out[v, u] = found[(count - 1) // 2]
