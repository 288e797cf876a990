"""Things that touch, told apart by the creases between them.

Where two convex bodies meet, the surface bends inwards. Pixels whose surroundings do so are taken out, what is left
falls into parts, and the parts grow back. A part counts as a thing of its own only if it is large and reaches down to
the table: handles and spouts bend inwards too, but mostly hang in the air.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.sparse.csgraph import connected_components

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.perception.frame import Frame


@dataclass(frozen=True, slots=True, kw_only=True)
class CreaseConfig:
    """Knobs of `split_touching`.

    Attributes:
        angle_deg: inward bend from one side of a pixel to the other that makes it a crease, degrees.
        reach_m: how far apart the two sides are looked at; surface normals are means over this distance, too.
        passes: creases are made wider on every side by this share of half the reach; the first that gives parts counts.
            The rims of two cans meet in a point without a crease and part in a later one.
        least_bent: share of the border between two parts that is a crease; others belong together.
        least_share: of a cluster's pixels is in a part that counts.
        min_pixels: and at least so many.
        foot_m: a part that counts begins below this height over the table.
    """

    angle_deg: float = 20.0
    reach_m: float = 0.012
    passes: tuple[float, ...] = (0.0, 1.0)
    least_bent: float = 0.7
    least_share: float = 0.12
    min_pixels: int = 200
    foot_m: float = 0.03


def split_touching(
    frame: Frame, masks: list[np.ndarray], table: Plane, *, config: CreaseConfig | None = None
) -> list[np.ndarray]:
    """Clusters, those of touching things cut along the creases between them; largest first.

    Args:
        masks: (h, w) bool each, not overlapping.
        table: what they stand on, camera frame, normal up.
    """
    config = config or CreaseConfig()
    low = np.nan_to_num(frame.height(table), nan=np.inf) < config.foot_m
    parts = []
    for mask in masks:
        least = max(config.min_pixels, int(config.least_share * mask.sum()))
        parts += _cut(frame, mask, low, least, config) if mask.sum() >= 2 * least else [mask]
    return sorted(parts, key=lambda m: -int(m.sum()))


def _cut(frame: Frame, mask: np.ndarray, low: np.ndarray, least: int, config: CreaseConfig) -> list[np.ndarray]:
    """The parts of one cluster, and theirs, of `least` pixels or more; itself if none. `low`: near the table."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    box = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    k, depth, inside = frame.intrinsics, np.ascontiguousarray(frame.depth[box]), np.ascontiguousarray(mask[box])
    camera = np.array([k.fx, k.fy, k.cx - columns[0], k.cy - rows[0]])
    reach = max(2, round(0.5 * config.reach_m * np.sqrt(k.fx * k.fy) / float(np.median(depth[inside]))))
    normals = _normals(depth, inside, camera, reach)
    creases = _creases(depth, inside, normals, camera, reach, 2.0 * np.sin(np.deg2rad(0.5 * config.angle_deg)))
    for wide in config.passes if creases.any() else ():
        labels = _parts(inside, creases, low[box], round(wide * reach), least, config.least_bent)
        if labels.max() > 1:
            parts = np.zeros((labels.max(), *mask.shape), bool)
            parts[:, *box] = labels == np.arange(1, labels.max() + 1)[:, None, None]
            return [one for part in parts for one in _cut(frame, part, low, least, config)]
    return [mask]


def _parts(
    mask: np.ndarray, creases: np.ndarray, low: np.ndarray, wide: int, least: int, least_bent: float
) -> np.ndarray:
    """(r, c) int64 labels from 1 of a cluster's parts, its creases made wider by `wide` pixels on every side."""
    labels = _components(mask & ~ndimage.maximum_filter(creases, 2 * wide + 1))
    sizes = np.bincount(labels.ravel())
    stands = np.bincount(labels[low], minlength=len(sizes)) >= 5
    counts = stands & (sizes >= least)
    counts[0] = False
    if counts.sum() < 2:
        return mask.astype(np.int64)
    grown = _grown(np.where(counts, np.cumsum(counts), 0)[labels], mask)
    border, bent = _borders(grown, creases, int(counts.sum()) + 1)
    _, joined = connected_components(bent < least_bent * border, directed=False)
    return np.where(grown > 0, joined[grown], 0)


@njit(cache=True, error_model="numpy")
def _normals(depth, mask, camera, reach):  # type: ignore[no-untyped-def]
    """(h, w, 3) unit normals towards the camera, from 5 x 5 samples up to `reach` pixels around; 0 where unknown.

    Planes w . (x, y, 1) = 1 / z are fitted by least squares: see `plane_search`.
    """
    fx, fy, cx, cy = camera
    out = np.zeros((depth.shape[0], depth.shape[1], 3))
    for i in range(depth.shape[0]):
        for j in range(depth.shape[1]):
            if not mask[i, j]:
                continue
            q0 = 1.0 / depth[i, j]
            n, sx, sy, sq, sxx, sxy, syy, sxq, syq = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for a in range(-2, 3):
                for b in range(-2, 3):
                    r, c = i + a * reach // 2, j + b * reach // 2
                    if 0 <= r < depth.shape[0] and 0 <= c < depth.shape[1] and mask[r, c]:
                        q = 1.0 / depth[r, c] - q0
                        if abs(q) > 0.03 * q0:
                            continue
                        x, y = (c - j) / fx, (r - i) / fy
                        n += 1.0
                        sx += x
                        sy += y
                        sq += q
                        sxx += x * x
                        sxy += x * y
                        syy += y * y
                        sxq += x * q
                        syq += y * q
            if n < 8.0:
                continue
            sxx, sxy, syy = sxx - sx * sx / n, sxy - sx * sy / n, syy - sy * sy / n
            sxq, syq = sxq - sx * sq / n, syq - sy * sq / n
            determinant = sxx * syy - sxy * sxy
            if not determinant > 1e-3 * sxx * syy:
                continue
            w0, w1 = (syy * sxq - sxy * syq) / determinant, (sxx * syq - sxy * sxq) / determinant
            w2 = q0 + sq / n - w0 * ((j - cx) / fx + sx / n) - w1 * ((i - cy) / fy + sy / n)
            length = np.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
            out[i, j, 0], out[i, j, 1], out[i, j, 2] = -w0 / length, -w1 / length, -w2 / length
    return out


@njit(cache=True, error_model="numpy")
def _creases(depth, mask, normals, camera, reach, bend):  # type: ignore[no-untyped-def]
    """(h, w) bool: the surface bends inwards across the pixel, (n1 - n2) . d > bend for a unit d from side 1 to 2."""
    fx, fy, cx, cy = camera
    out = np.zeros(mask.shape, np.bool_)
    for i in range(mask.shape[0]):
        for j in range(mask.shape[1]):
            if not mask[i, j]:
                continue
            for di, dj in ((0, reach), (reach, 0), (reach, reach), (reach, -reach)):
                r1, c1, r2, c2 = i - di, j - dj, i + di, j + dj
                if min(r1, r2, c1, c2) < 0 or max(r1, r2) >= mask.shape[0] or max(c1, c2) >= mask.shape[1]:
                    continue
                if not (mask[r1, c1] and mask[r2, c2]) or not (normals[r1, c1, 2] < 0.0 and normals[r2, c2, 2] < 0.0):
                    continue
                z1, z2 = depth[r1, c1], depth[r2, c2]
                dx = (c2 - cx) / fx * z2 - (c1 - cx) / fx * z1
                dy = (r2 - cy) / fy * z2 - (r1 - cy) / fy * z1
                dz = z2 - z1
                length = np.sqrt(dx * dx + dy * dy + dz * dz)
                inwards = (
                    (normals[r1, c1, 0] - normals[r2, c2, 0]) * dx
                    + (normals[r1, c1, 1] - normals[r2, c2, 1]) * dy
                    + (normals[r1, c1, 2] - normals[r2, c2, 2]) * dz
                )
                if inwards > bend * length:
                    out[i, j] = True
                    break
    return out


@njit(cache=True, error_model="numpy")
def _components(mask):  # type: ignore[no-untyped-def]
    """(h, w) int64 4-connected labels from 1."""
    labels = np.zeros(mask.shape, np.int64)
    stack = np.empty((mask.size, 2), np.int64)
    count = 0
    for i in range(mask.shape[0]):
        for j in range(mask.shape[1]):
            if not mask[i, j] or labels[i, j]:
                continue
            count += 1
            labels[i, j] = count
            stack[0, 0], stack[0, 1] = i, j
            top = 1
            while top:
                top -= 1
                r, c = stack[top]
                for dr, dc in ((0, 1), (0, -1), (1, 0), (-1, 0)):
                    a, b = r + dr, c + dc
                    if 0 <= a < mask.shape[0] and 0 <= b < mask.shape[1] and mask[a, b] and not labels[a, b]:
                        labels[a, b] = count
                        stack[top, 0], stack[top, 1] = a, b
                        top += 1
    return labels


@njit(cache=True, error_model="numpy")
def _grown(labels, mask):  # type: ignore[no-untyped-def]
    """Labels spread over the rest of the mask, ring by ring, as far as it is connected to them."""
    out = labels.copy()
    queue = np.empty((labels.size, 2), np.int64)
    end = 0
    for i in range(labels.shape[0]):
        for j in range(labels.shape[1]):
            if labels[i, j]:
                queue[end, 0], queue[end, 1] = i, j
                end += 1
    start = 0
    while start < end:
        r, c = queue[start]
        start += 1
        for dr, dc in ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
            a, b = r + dr, c + dc
            if 0 <= a < labels.shape[0] and 0 <= b < labels.shape[1] and mask[a, b] and not out[a, b]:
                out[a, b] = out[r, c]
                queue[end, 0], queue[end, 1] = a, b
                end += 1
    return out


@njit(cache=True, error_model="numpy")
def _borders(labels, creases, count):  # type: ignore[no-untyped-def]
    """(count, count) int64 neighbouring pixels of two labels, and how many of these pairs lie at a crease."""
    border, bent = np.zeros((count, count), np.int64), np.zeros((count, count), np.int64)
    for i in range(1, labels.shape[0]):
        for j in range(1, labels.shape[1]):
            for r, c in ((i - 1, j), (i, j - 1)):
                a, b = labels[i, j], labels[r, c]
                if a and b and a != b:
                    low, high = min(a, b), max(a, b)
                    border[low, high] += 1
                    bent[low, high] += creases[i, j] or creases[r, c]
    return border, bent
