"""The table in a depth image: the plane that things stand on, and how far it reaches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from neuralgrasps.compiled import njit
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.perception.frame import Frame
from neuralgrasps.perception.plane_search import (
    Cells,
    cell_points,
    cells_on,
    fitted_plane,
    image_cells,
    in_band,
    plane_of,
    search_planes,
)

_PLANES = 6
_LEAST_SHARE = 0.005  # of the image's blocks: a smaller plane is no table
_LEAST_AREA_M2 = 0.03
_THING_M = (0.015, 0.4)  # heights of what stands on a table
_FOOT_M = 0.05  # it begins below this height
_LEAST_THING_SHARE = 0.001
_LEVEL_COS = np.cos(np.deg2rad(20.0))  # a table is not more tilted in the world than this
_PARALLEL_COS = np.cos(np.deg2rad(12.0))
_STOREY_M = 0.25  # a table is at least so much above a floor that carries more, a box on a table is not
_JOIN_M = 0.25  # parts of one table, cut by what stands before them, are not further apart


@dataclass(frozen=True, slots=True)
class TableExtent:
    """The convex outline of a table's seen part, in its plane.

    Attributes:
        axes: (2, 3) unit vectors along the plane, camera frame.
        edges: (E, 3) a, b, c with a^2 + b^2 = 1: a point of plane coordinates (s, t) is inside where
            a s + b t + c <= 0 for all edges.
        area_m2: of the outline.
    """

    axes: np.ndarray
    edges: np.ndarray
    area_m2: float

    def outside_m(self, points_C: np.ndarray) -> np.ndarray:
        """How far points (..., 3), moved onto the plane along its normal, lie outside; (...) float64, metres.

        Negative inside. Beyond a corner it is less than the distance.
        """
        points_C = np.asarray(points_C, np.float64)
        flat = np.ascontiguousarray((points_C @ self.axes.T).reshape(-1, 2))
        return _outside(flat, self.edges).reshape(points_C.shape[:-1])


@dataclass(frozen=True, slots=True)
class TableFit:
    """A table found in a frame.

    Attributes:
        plane: its top in the camera frame; the normal points to the camera's side, up.
        inlier_share: share of the measured pixels that lie on it.
        rms_m: root mean square height of these pixels above the plane, metres.
        mask: (h, w) bool, its pixels.
        extent: its outline.
    """

    plane: Plane
    inlier_share: float
    rms_m: float
    mask: np.ndarray
    extent: TableExtent


@dataclass(frozen=True, slots=True)
class _Candidate:
    plane: Plane
    main: np.ndarray
    extent: TableExtent
    share: float
    things: float

    @property
    def score(self) -> float:
        """Geometric mean of two shares of the image: of the plane, and of what stands on it (at most as much)."""
        return float(np.sqrt(self.share * (min(self.things, self.share) + _LEAST_THING_SHARE / 2)))


def find_table(frame: Frame, *, max_depth_m: float | None = None, seed: int = 0) -> TableFit:
    """The plane that things stand on.

    The large planes of the image are found one after the other. The table is the one with the most pixels on it and on
    clusters of sensible height that stand within its outline; where such planes lie over each other, as a table over a
    floor, the highest that carries something. With a camera pose only planes that are level in the world (z up) count.

    Args:
        max_depth_m: pixels farther away are left out; None keeps all.
        seed: of the hypotheses tried.
    Raises:
        InputError: no plane of a table's size, none that is level, or a camera pose that puts the table upside down.
    """
    if max_depth_m is not None and not max_depth_m > 0:
        raise InputError(f"max_depth_m is {max_depth_m}; expected metres, above 0.")
    cells = image_cells(frame, np.inf if max_depth_m is None else max_depth_m)
    least = max(20, int(_LEAST_SHARE * cells.inverse.size))
    planes = [plane_of(w) for w in search_planes(cells, count=_PLANES, least=least, seed=seed)]
    points = cell_points(cells)
    found = [c for c in (_judged(cells, points, plane) for plane in planes) if c is not None]
    best = _chosen(frame, found, max_depth_m)
    near = _within_outline(best.main, cells.step, frame.depth.shape)
    plane = fitted_plane(frame, best.plane, near & in_band(frame, best.plane))
    mask = near & in_band(frame, plane)
    return TableFit(
        plane=plane,
        inlier_share=float(mask.sum() / (frame.depth > 0).sum()),
        rms_m=float(np.sqrt(np.mean(frame.height(plane)[mask] ** 2))),
        mask=mask,
        extent=best.extent,
    )


def table_extent(frame: Frame, plane: Plane) -> TableExtent | None:
    """Outline of the seen part of a known table; None where no patch of it is seen.

    Args:
        plane: the table's top, camera frame, normal up.
    """
    cells = image_cells(frame, np.inf)
    seen = _seen_part(cells, cell_points(cells), plane)
    return None if seen is None else seen[1]


def _judged(cells: Cells, points: np.ndarray, plane: Plane) -> _Candidate | None:
    seen = _seen_part(cells, points, plane)
    if seen is None:
        return None
    main, extent = seen
    height = plane.height(points)
    above = (height > _THING_M[0]) & (height < _THING_M[1])
    above[above] = extent.outside_m(points[above]) < 0.0
    labels, _ = ndimage.label(above, np.ones((3, 3)))
    sizes = np.bincount(labels[above], minlength=2)
    stands = np.bincount(labels[above & (height < _FOOT_M)], minlength=len(sizes)) > 0
    things = int(sizes[(sizes >= 6) & stands].sum())
    return _Candidate(plane, main, extent, main.sum() / main.size, things / main.size)


def _chosen(frame: Frame, found: list[_Candidate], max_depth_m: float | None) -> _Candidate:
    if not found:
        near = "" if max_depth_m is None else f" within {max_depth_m:g} m"
        raise InputError(
            f"no table was found in '{frame.name}'{near}: no flat part covers {100 * _LEAST_SHARE:g} % of the image. "
            "Let the camera see more of the table, check the intrinsics and --depth-scale, or give the table's height."
        )
    level = found if frame.X_WC is None else _level(frame, found)
    large = [c for c in level if c.extent.area_m2 >= _LEAST_AREA_M2] or level
    best = max(large, key=lambda c: c.score)
    nearer = [
        c
        for c in large
        if c.plane.normal @ best.plane.normal > _PARALLEL_COS
        and c.plane.offset_m < best.plane.offset_m - _STOREY_M
        and c.things >= _LEAST_THING_SHARE
    ]
    return min(nearer, key=lambda c: c.plane.offset_m, default=best)


def _level(frame: Frame, found: list[_Candidate]) -> list[_Candidate]:
    assert frame.X_WC is not None
    up = np.array([frame.X_WC[2, :3] @ c.plane.normal for c in found])
    level = [c for c, z in zip(found, up, strict=True) if z > _LEVEL_COS]
    if level:
        return level
    if (up < -_LEVEL_COS).any():
        raise InputError(
            f"the level planes in '{frame.name}' face down in the world: the camera pose X_WC is upside down, or the "
            "world's z does not point up. X_WC maps camera points into the world (x right, y down, z forward); is it "
            "the inverse?"
        )
    tilt = np.rad2deg(np.arccos(np.clip(up.max(), -1, 1)))
    raise InputError(
        f"no plane in '{frame.name}' is level in the world: the best is tilted by {tilt:.0f} degrees, as a wall. Check "
        "the camera pose X_WC (world z up), leave it out, or give the table's height."
    )


def _seen_part(cells: Cells, points: np.ndarray, plane: Plane) -> tuple[np.ndarray, TableExtent] | None:
    """The largest connected part of a plane with the parts near it, as blocks (r, c) bool, and their outline."""
    labels, count = ndimage.label(ndimage.binary_opening(cells_on(cells, plane), np.ones((3, 3))), np.ones((3, 3)))
    if not count:
        return None
    sizes = np.bincount(labels.ravel())[1:]
    order = np.argsort(-sizes, kind="stable") + 1
    main = labels == order[0]
    extent = _outline(points, main, plane)
    if extent is None:
        return None
    for label in order[1:8]:
        if sizes[label - 1] < 0.02 * sizes[order[0] - 1]:
            break
        part = labels == label
        if np.percentile(extent.outside_m(points[part]), 5) < _JOIN_M:
            main |= part
            extent = _outline(points, main, plane) or extent
    return main, extent


def _outline(points_C: np.ndarray, mask: np.ndarray, plane: Plane) -> TableExtent | None:
    """Outline of the points (r, c, 3) of a mask (r, c).

    A camera maps convex outlines on a plane to convex ones: only the ends of the image's rows can be corners.
    """
    rows = np.flatnonzero(mask.any(axis=1))
    first, last = mask[rows].argmax(axis=1), mask.shape[1] - 1 - mask[rows, ::-1].argmax(axis=1)
    ends = np.concatenate([points_C[rows, first], points_C[rows, last]])
    axis = np.cross(plane.normal, np.eye(3)[np.argmin(np.abs(plane.normal))])
    axis /= np.linalg.norm(axis)
    axes = np.stack([axis, np.cross(plane.normal, axis)])
    try:
        hull = ConvexHull(ends @ axes.T)
    except (QhullError, ValueError):
        return None
    return TableExtent(axes, np.ascontiguousarray(hull.equations), float(hull.volume))


def _within_outline(blocks: np.ndarray, step: int, shape: tuple[int, ...]) -> np.ndarray:
    """(h, w) bool: pixels within the convex outline of some blocks and 3 blocks around, which the edge may have cut."""
    row, column = np.nonzero(blocks)
    corners = np.stack([column, row], axis=1)
    corners = corners[ConvexHull(corners).vertices]
    image = Image.new("L", blocks.shape[::-1])
    ImageDraw.Draw(image).polygon([(int(u), int(v)) for u, v in corners], fill=1, outline=1)
    grown = ndimage.binary_dilation(np.asarray(image) > 0, np.ones((3, 3)), iterations=3)
    index = [np.minimum(np.arange(n) // step, m - 1) for n, m in zip(shape, blocks.shape, strict=True)]
    return grown[np.ix_(*index)]


@njit(cache=True, error_model="numpy")
def _outside(points, edges):  # type: ignore[no-untyped-def]
    out = np.full(len(points), np.nan)
    for i in range(len(points)):
        s, t = points[i]
        if not np.isfinite(s):
            continue
        most = -np.inf
        for k in range(len(edges)):
            most = max(most, edges[k, 0] * s + edges[k, 1] * t + edges[k, 2])
        out[i] = most
    return out
