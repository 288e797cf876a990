"""Clusters of pixels that stand on a table: connected surfaces above it, cut where the depth jumps."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import back_project
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.perception.frame import Frame
from neuralgrasps.perception.table import TableExtent, table_extent
from neuralgrasps.perception.touching import CreaseConfig, split_touching

_APART_PX = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class ClusterConfig:
    """Knobs of `find_clusters`.

    Attributes:
        min_height_m, max_height_m: band above the table that belongs to objects; min_height_m grows with the square of
            the depth beyond 1 m.
        jump_m: neighbouring pixels whose depths differ by more are apart: at 1 m, growing with the square of the depth,
            and more by what a surface slanted by `slant_deg` changes from one pixel to the next.
        slant_deg: see there, degrees.
        min_pixels: smaller clusters are dropped.
        margin_m: clusters begin within the table's outline and reach at most this far beyond it: what stands at the
            edge hides the edge.
        least_share: of a connected surface lies above the table, below `max_height_m` and within the margin; a wall and
            the back of a chair go on elsewhere.
        fragment_m2: clusters seen with less area are given to the neighbour they lost touch with, where the image shows
            one within 6 pixels at nearly the same depth, or dropped.
        creases: how things that touch are told apart; None leaves them together.
    """

    min_height_m: float = 0.006
    max_height_m: float = 0.5
    jump_m: float = 0.008
    slant_deg: float = 78.0
    min_pixels: int = 50
    margin_m: float = 0.12
    least_share: float = 0.35
    fragment_m2: float = 4e-4
    creases: CreaseConfig | None = field(default_factory=CreaseConfig)


def find_clusters(
    frame: Frame, table: Plane, *, extent: TableExtent | None = None, config: ClusterConfig | None = None
) -> list[np.ndarray]:
    """Connected surfaces that stand on a table, one mask each.

    Things that touch, without a step in depth between them, are told apart where the surface bends inwards between
    them; others, as two boxes side by side with their faces in line, stay one cluster. A thing that another hides the
    middle of gives two.

    Args:
        table: its top in the camera frame, normal up.
        extent: its outline; None to look for it. A table of which no patch is seen has no end.
    Returns:
        Masks (h, w) bool, largest first; empty when nothing stands there.
    Raises:
        InputError: the camera is below the table's top.
    """
    config = config or ClusterConfig()
    if table.offset_m <= 0:
        raise InputError(
            f"the camera is {-table.offset_m:.3g} m below the table's top; expected above it. Is the camera pose or "
            "the table's height wrong, or the plane's normal turned down?"
        )
    if extent is None:
        extent = table_extent(frame, table)
    k = frame.intrinsics
    height = frame.height(table)
    with np.errstate(invalid="ignore"):
        low = config.min_height_m * np.maximum(frame.depth, 1.0) ** 2
        above = (height > low) & (height < config.max_height_m)
        surface = above | (height < -2.0 * low) | (height >= config.max_height_m)
    slope = np.tan(np.deg2rad(config.slant_deg)) / np.sqrt(k.fx * k.fy)
    labels = _labelled(frame.depth, surface, config.jump_m, slope)
    outside = np.full(height.shape, -np.inf)
    if extent is not None:
        outside[above] = extent.outside_m(back_project(frame.depth, k, mask=above))
    masks = _kept(labels, above & (outside < config.margin_m), outside < 0.0, config)
    if config.creases is not None:
        masks = split_touching(frame, masks, table, config=config.creases)
    return _joined(frame, masks, config)


def _kept(labels: np.ndarray, belongs: np.ndarray, inside: np.ndarray, config: ClusterConfig) -> list[np.ndarray]:
    """Masks of the labels (1, 2, ...) by the pixels that may belong to a thing on the table; largest first."""
    total = np.bincount(labels.ravel())
    size = np.bincount(labels[belongs], minlength=len(total))
    within = np.bincount(labels[belongs & inside], minlength=len(total))
    good = (size >= config.min_pixels) & (size >= config.least_share * total) & (within >= 0.05 * size)
    good[0] = False
    order = np.flatnonzero(good)
    order = order[np.argsort(-size[order], kind="stable")]
    return [(labels == label) & belongs for label in order]


def _joined(frame: Frame, masks: list[np.ndarray], config: ClusterConfig) -> list[np.ndarray]:
    """Clusters with the fragments among them, smallest first, given to their neighbours or dropped; largest first."""
    k = frame.intrinsics
    labels = np.zeros(frame.depth.shape, np.int64)
    for i, mask in enumerate(masks, start=1):
        labels[mask] = i
    area_m2 = [(frame.depth[mask] ** 2).sum() / (k.fx * k.fy) for mask in masks]
    for i in range(len(masks), 0, -1):
        if area_m2[i - 1] < config.fragment_m2:
            row, column = np.nonzero(labels == i)
            votes = _neighbours(frame.depth, labels, row, column, len(masks) + 1, _APART_PX, config.jump_m)
            labels[row, column] = votes.argmax()  # 0 without any vote
    sizes = np.bincount(labels.ravel(), minlength=len(masks) + 1)[1:]
    return [labels == i + 1 for i in np.argsort(-sizes, kind="stable") if sizes[i]]


@njit(cache=True, error_model="numpy")
def _neighbours(depth, labels, row, column, count, reach, jump):  # type: ignore[no-untyped-def]
    """Pixels of every other label within `reach` pixels and a jump of the pixels given, once for each of these."""
    votes = np.zeros(count, np.int64)
    for k in range(len(row)):
        i, j = row[k], column[k]
        for r in range(max(i - reach, 0), min(i + reach + 1, labels.shape[0])):
            for c in range(max(j - reach, 0), min(j + reach + 1, labels.shape[1])):
                if labels[r, c] and labels[r, c] != labels[i, j]:
                    near = min(depth[i, j], depth[r, c])
                    votes[labels[r, c]] += abs(depth[i, j] - depth[r, c]) < jump * max(near * near, 1.0)
    return votes


@njit(cache=True, error_model="numpy")
def _root(parent, i):  # type: ignore[no-untyped-def]
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, error_model="numpy")
def _linked(a, b, far, jump, slope):  # type: ignore[no-untyped-def]
    """Whether neighbouring pixels of depths a and b, `far` pixels apart, are of one surface."""
    near = min(a, b)
    return abs(a - b) <= jump * near * near + slope * far * near


@njit(cache=True, error_model="numpy")
def _labelled(depth, part, jump, slope):  # type: ignore[no-untyped-def]
    """(h, w) int64 labels of 8-connected surfaces from 1 in order of their first pixel; 0 elsewhere.

    Pixels with fewer than half of their neighbours on the same surface, such as those flying between two, link nothing;
    they join the surface of the nearest linked neighbour afterwards.
    """
    rows, columns = depth.shape
    core = np.zeros(depth.shape, np.bool_)
    for i in range(rows):
        for j in range(columns):
            if not part[i, j]:
                continue
            same = 0
            for di in range(-1, 2):
                for dj in range(-1, 2):
                    r, c = i + di, j + dj
                    if (di != 0 or dj != 0) and 0 <= r < rows and 0 <= c < columns and part[r, c]:
                        same += _linked(depth[i, j], depth[r, c], np.sqrt(float(di * di + dj * dj)), jump, slope)
            core[i, j] = same >= 5
    parent = np.arange(rows * columns)
    for i in range(rows):
        for j in range(columns):
            if not core[i, j]:
                continue
            for di, dj in ((0, -1), (-1, -1), (-1, 0), (-1, 1)):
                r, c = i + di, j + dj
                if r < 0 or not 0 <= c < columns or not core[r, c]:
                    continue
                if _linked(depth[i, j], depth[r, c], np.sqrt(float(di * di + dj * dj)), jump, slope):
                    a, b = _root(parent, i * columns + j), _root(parent, r * columns + c)
                    parent[max(a, b)] = min(a, b)
    labels = np.zeros(depth.shape, np.int64)
    count = 0
    for i in range(rows):
        for j in range(columns):
            if core[i, j]:
                root = _root(parent, i * columns + j)
                if root == i * columns + j:
                    count += 1
                    labels[i, j] = count
                else:
                    labels[i, j] = labels[root // columns, root % columns]
    for i in range(rows):
        for j in range(columns):
            if part[i, j] and not core[i, j]:
                least = np.inf
                for di in range(-1, 2):
                    for dj in range(-1, 2):
                        r, c = i + di, j + dj
                        if 0 <= r < rows and 0 <= c < columns and core[r, c]:
                            off = abs(depth[r, c] - depth[i, j])
                            if off < least and _linked(depth[i, j], depth[r, c], 1.5, jump, slope):
                                least = off
                                labels[i, j] = labels[r, c]
    return labels
