"""Why `pose` may have found nothing, or may be wrong: what its options and its few models leave open."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from neuralgrasps.errors import InputError

if TYPE_CHECKING:
    from neuralgrasps.perception.frame import Frame
    from neuralgrasps.perception.table import TableFit

# Beyond these a table is more likely one of a wrong unit than one that a depth camera looks at.
_FAR_M, _ROUGH_M = 3.0, 0.015

FLAT_NOTE = "the points lie on one plane: many poses fit, and so does a piece of a table."
CLOUD_NOTE = "a cloud cannot rule out larger objects; --depth with --mask can."
LONE_NOTE = "only one object is known: a similar one may be taken for it."


def table_distance_m(frame: Frame, fit: TableFit) -> float:
    """Median depth of the table's pixels, metres."""
    return float(np.median(frame.depth[fit.mask]))


def scale_doubt(frame: Frame, fit: TableFit) -> str:
    """Asks for the scale of the depth image when the table is very far or very rough; "" otherwise."""
    distance = table_distance_m(frame, fit)
    if distance <= _FAR_M and fit.rms_m <= _ROUGH_M:
        return ""
    return f"the table is {distance:.1f} m away, {1e3 * fit.rms_m:.0f} mm rough: is --depth-scale right?"


def with_scale_doubt(error: InputError, frame: Frame) -> InputError:
    """The error of a frame without a table, with the same question when its depths are very large."""
    measured = frame.depth[frame.depth > 0]
    median = float(np.median(measured)) if measured.size else 0.0
    if median <= _FAR_M:
        return error
    return InputError(f"{error} The median depth is {median:.1f} m: is --depth-scale right?")
