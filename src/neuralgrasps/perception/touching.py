"""Things that touch, told apart by the creases between them.

Where two convex bodies meet, the surface bends inwards. Pixels whose surroundings do so are taken out, what is left
falls into parts, and the parts grow back. A part counts as a thing of its own only if it is large and reaches down to
the table: handles and spouts bend inwards too, but mostly hang in the air.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.perception.frame import Frame


@dataclass(frozen=True, slots=True, kw_only=True)
class CreaseConfig:
    """Knobs of `split_touching`.

    Attributes:
        angle_deg: inward bend from one side of a pixel to the other that makes it a crease, degrees.
        reach_m: how far apart the two sides are looked at; surface normals are means over this distance, too.
        least_share: of a cluster's pixels is in a part that counts.
        min_pixels: and at least so many.
        foot_m: a part that counts begins below this height over the table.
    """

    angle_deg: float = 20.0
    reach_m: float = 0.012
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
    out: list[np.ndarray] = []
    height = frame.height(table)
    for mask in masks:
        rows, columns = np.nonzero(mask.any(axis=1))[0], np.nonzero(mask.any(axis=0))[0]
        if not len(rows):
            continue
        box = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
        parts = _parts(frame, mask[box], height[box], (rows[0], columns[0]), config)
        for label in range(1, parts.max() + 1):
            one = np.zeros(mask.shape, bool)
            one[box] = parts == label
            out.append(one)
    return sorted(out, key=lambda m: -int(m.sum()))


def _parts(
    frame: Frame, mask: np.ndarray, height: np.ndarray, corner: tuple[int, int], config: CreaseConfig
) -> np.ndarray:
    """(r, c) int64 labels from 1 of a cluster's parts, cut out at `corner` of the image."""
    k = frame.intrinsics
    depth = frame.depth[corner[0] : corner[0] + mask.shape[0], corner[1] : corner[1] + mask.shape[1]]
    camera = np.array([k.fx, k.fy, k.cx - corner[1], k.cy - corner[0]])
    reach = max(2, round(0.5 * config.reach_m * np.sqrt(k.fx * k.fy) / float(np.median(depth[mask]))))
    normals = _normals(depth, mask, camera, reach)
    smooth = mask & ~_creases(depth, mask, normals, camera, reach, 2.0 * np.sin(np.deg2rad(0.5 * config.angle_deg)))
    labels = _components(smooth)
    sizes = np.bincount(labels.ravel())
    stands = np.bincount(labels[height < config.foot_m], minlength=len(sizes)) >= 5
    counts = stands & (sizes >= max(config.min_pixels, config.least_share * mask.sum()))
    counts[0] = False
    if counts.sum() < 2:
        return mask.astype(np.int64)
    renumbered = np.where(counts, np.cumsum(counts), 0)
    return _grown(renumbered[labels], mask)


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
    """Labels spread over the rest of the mask, ring by ring; what they do not reach gets the nearest in the image."""
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
