"""What may be wrong with the frames of a demonstration, said when the object is not found in them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neuralgrasps.perception.frame import Frame

_LEAST_MEASURED = 0.4  # share of the pixels in the middle of the image that should have a depth
_NEAREST_M, _FARTHEST_M = 0.25, 2.0  # where the object is expected


def depth_trouble(frames: Sequence[Frame]) -> str:
    """What speaks against the depth of the frames, as sentences after a blank; "" when nothing does.

    Both are of the middle half of the images, and the median over the frames.
    """
    middles = [_middle(frame.depth) for frame in frames]
    measured = float(np.median([(depth > 0).mean() for depth in middles]))
    medians = [np.median(depth[depth > 0]) for depth in middles if (depth > 0).any()]
    said = ""
    if measured < _LEAST_MEASURED:
        said += (
            f" Only {100 * measured:.0f} % of the pixels in the middle of the images have a depth (expected at least "
            f"{100 * _LEAST_MEASURED:.0f} %): is the camera too near, in sunlight, or looking at something shiny?"
        )
    if medians and not _NEAREST_M <= (z := float(np.median(medians))) <= _FARTHEST_M:
        said += (
            f" The median depth there is {z:.2f} m; expected {_NEAREST_M:g} to {_FARTHEST_M:g} m: check the depth "
            f"scale, or move the camera {'nearer' if z > _FARTHEST_M else 'away'}."
        )
    return said


def _middle(depth: np.ndarray) -> np.ndarray:
    """The middle half of an image, both ways."""
    h, w = depth.shape
    return depth[h // 4 : h - h // 4, w // 4 : w - w // 4]
