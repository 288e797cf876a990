"""Codes of grasps that nobody has seen: near a known code, between two, or from a density over known codes.

Every code is drawn from a generator of its own, so the first codes of a longer draw are those of a shorter one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from neuralgrasps.errors import InputError
from neuralgrasps.model.codes import CONTACT_BLOCK, PALM_BLOCK
from neuralgrasps.seeds import child_rng

_ROTATION = slice(PALM_BLOCK.start + 3, PALM_BLOCK.stop)  # two columns of the palm's rotation
LOCAL_NEIGHBOURS = 5  # whose differences from a code span its kernel
LOCAL_STEP = 0.35  # standard deviation of a kernel, in differences to neighbours


@dataclass(frozen=True, slots=True, kw_only=True)
class SampledCodes:
    """Codes of one hand on one object, and what they were made from.

    Attributes:
        values: (N, 128) float64; the palm part is a rotation.
        source: (N,) int64, row of the known code each began with, -1 where it began with none.
        neighbour: (N,) int64, row of the other known code, -1 where there is none.
    """

    values: np.ndarray
    source: np.ndarray
    neighbour: np.ndarray

    def __len__(self) -> int:
        return len(self.values)


def palm_rotations(values: np.ndarray) -> np.ndarray:
    """(N, 3, 3) palm rotations of codes (N, 128), made orthonormal column by column."""
    x, y = values[:, _ROTATION][:, :3], values[:, _ROTATION][:, 3:]
    x = x / np.linalg.norm(x, axis=1, keepdims=True)
    y = y - (x * y).sum(axis=1, keepdims=True) * x
    y = y / np.linalg.norm(y, axis=1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=2)


def with_rotations(values: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Codes (N, 128) with the palm rotations (N, 3, 3) in place of theirs."""
    out = np.array(values, np.float64)
    out[:, _ROTATION] = np.concatenate([R[:, :, 0], R[:, :, 1]], axis=1)
    return out


def noisy_codes(known: np.ndarray, *, count: int, spread: float, seed: int) -> SampledCodes:
    """Known codes, each at most once before any comes again, plus Gaussian noise.

    Args:
        known: (M, 128) codes of one hand on one object, M >= 1.
        spread: of the noise, in standard deviations over `known` of each component; 0 = the known codes.
    """
    values = np.asarray(known, np.float64)
    scale = spread * values.std(axis=0)
    source = _rows_in_turn(len(values), count, seed)
    draws = np.stack([child_rng(seed, "noise", i).standard_normal(values.shape[1]) for i in range(count)])
    return SampledCodes(
        values=_codes(values[source] + draws * scale), source=source, neighbour=np.full(count, -1, np.int64)
    )


def interpolate_codes(first: np.ndarray, second: np.ndarray, share: float = 0.5) -> np.ndarray:
    """(N, 128) codes on the way from `first` to `second` (N, 128): palm rotation along the geodesic, the rest straight.

    Args:
        share: of the way, 0 = first, 1 = second.
    """
    Ra, Rb = palm_rotations(first), palm_rotations(second)
    turn = Rotation.from_matrix(np.swapaxes(Ra, 1, 2) @ Rb).as_rotvec()
    R = Ra @ Rotation.from_rotvec(share * turn).as_matrix()
    return with_rotations((1.0 - share) * np.asarray(first, np.float64) + share * np.asarray(second, np.float64), R)


def midpoint_codes(
    known: np.ndarray, features: np.ndarray, *, count: int, seed: int, share: float = 0.5, is_jaw: bool = False
) -> SampledCodes:
    """Codes between a known code and its nearest neighbour; when all are used up, the second nearest, and so on.

    No pair of codes is used twice.

    Args:
        known: (M, 128) codes of one hand on one object, M >= 2.
        features: (M, F) by whose Euclidean distance neighbours are found.
        share: of the way to the neighbour.
        is_jaw: the hand is the same when turned by 180 degrees about its approach, so a neighbour may be turned.
    Raises:
        InputError: fewer than `count` pairs.
    """
    pairs = _neighbour_pairs(features, seed)
    if len(pairs) < count:
        raise InputError(
            f"count is {count}; {len(known)} known codes have {len(pairs)} pairs to interpolate. Ask for fewer, or "
            "sample with noise."
        )
    source, neighbour = pairs[:count, 0], pairs[:count, 1]
    first, second = np.asarray(known, np.float64)[source], np.asarray(known, np.float64)[neighbour]
    if is_jaw:
        second = nearer_side(first, second)
    values = interpolate_codes(first, second, share)
    return SampledCodes(values=values, source=source, neighbour=neighbour)


def kernel_codes(known: np.ndarray, features: np.ndarray, *, count: int, seed: int, is_jaw: bool) -> SampledCodes:
    """Draws from a kernel density over known codes; each kernel is as long as the way to the neighbours.

    A known code plus a Gaussian combination of its differences to its `LOCAL_NEIGHBOURS` nearest: where known grasps
    lie close together the draws do too, and they stay on the surface that the known codes lie on.
    """
    values = np.asarray(known, np.float64)
    near = min(LOCAL_NEIGHBOURS, len(values) - 1)
    order = _order_by_distance(features)[:, :near]
    source = _rows_in_turn(len(values), count, seed)
    out = np.empty((count, values.shape[1]))
    for i, row in enumerate(source):
        first = np.repeat(values[row][None], near, axis=0)
        second = nearer_side(first, values[order[row]]) if is_jaw else values[order[row]]
        step = child_rng(seed, "kernel", i).standard_normal(near) * (LOCAL_STEP / np.sqrt(near))
        out[i] = values[row] + step @ (second - first)
    return SampledCodes(values=_codes(out), source=source, neighbour=np.full(count, -1, np.int64))


def gaussian_codes(known: np.ndarray, *, count: int, seed: int) -> SampledCodes:
    """Draws from one Gaussian with the mean and covariance of the known codes (M, 128)."""
    values = np.asarray(known, np.float64)
    centred = values - values.mean(axis=0)
    draws = np.stack([child_rng(seed, "gaussian", i).standard_normal(len(values)) for i in range(count)])
    out = values.mean(axis=0) + draws @ centred / np.sqrt(max(len(values) - 1, 1))
    none = np.full(count, -1, np.int64)
    return SampledCodes(values=_codes(out), source=none, neighbour=none)


def nearer_side(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """`second` (N, 128), turned by 180 degrees about the palm's approach where that is nearer to `first`."""
    Ra, Rb = palm_rotations(first), palm_rotations(second)
    turned = Rb * np.array([-1.0, -1.0, 1.0])
    nearer = np.einsum("nij,nij->n", Ra, turned) > np.einsum("nij,nij->n", Ra, Rb)
    return with_rotations(second, np.where(nearer[:, None, None], turned, Rb))


def _codes(values: np.ndarray) -> np.ndarray:
    """Values whose contact block is not negative and whose palm part is a rotation."""
    out = with_rotations(values, palm_rotations(values))
    out[:, CONTACT_BLOCK] = np.maximum(out[:, CONTACT_BLOCK], 0.0)
    return out


def _rows_in_turn(known: int, count: int, seed: int) -> np.ndarray:
    """(count,) rows in an order of the seed's, all of them before any comes again."""
    rounds = -(-count // known)
    return np.concatenate([child_rng(seed, "order", r).permutation(known) for r in range(rounds)])[:count]


def _order_by_distance(features: np.ndarray) -> np.ndarray:
    """(M, M - 1) rows by distance, nearest first, each without itself."""
    distance = cdist(features, features)
    np.fill_diagonal(distance, -1.0)
    return np.argsort(distance, axis=1, kind="stable")[:, 1:]


def _neighbour_pairs(features: np.ndarray, seed: int) -> np.ndarray:
    """(K, 2) all pairs of rows, nearest neighbours first, in an order of the seed's within each rank."""
    order = _order_by_distance(features)
    pairs: dict[tuple[int, int], tuple[int, int]] = {}
    for rank in range(order.shape[1]):
        for row in child_rng(seed, "pairs", rank).permutation(len(order)):
            a, b = int(row), int(order[row, rank])
            pairs.setdefault((min(a, b), max(a, b)), (a, b))
    return np.array(list(pairs.values()), np.int64).reshape(-1, 2)
