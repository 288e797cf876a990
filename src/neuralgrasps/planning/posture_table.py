"""Random postures of an arm sorted by nothing, searched by hand pose: where inverse kinematics starts from."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.planning.chain import Chain, chain_poses

POOL = 4  # postures looked at per start that is asked for
APART_RAD = 0.6  # starts differ by this much in some joint, where the pool allows


class PostureTable(NamedTuple):
    """P random postures within limits and where they put the hand.

    Attributes:
        q: (P, D) rad or metres.
        pose: (7, P) float32, hand position in metres and unit quaternion (any order, any sign).
    """

    q: np.ndarray
    pose: np.ndarray


def build_posture_table(chain: Chain, count: int, rng: np.random.Generator) -> PostureTable:
    """`count` postures of `chain`, uniform within limits; joints that turn freely stay within half a turn of 0."""
    lower = np.where(chain.free, np.maximum(chain.lower, -math.pi), chain.lower)
    upper = np.where(chain.free, np.minimum(chain.upper, math.pi), chain.upper)
    narrow = upper - lower < math.pi  # limits that hardly hold an angle near 0
    lower, upper = np.where(narrow, chain.lower, lower), np.where(narrow, chain.upper, upper)
    q = rng.uniform(lower, upper, (count, len(lower)))
    pose = np.empty((7, count), np.float32)
    _write_poses(chain_poses(chain, q), pose)
    return PostureTable(q, pose)


@njit(cache=True, error_model="numpy")
def _quaternion(X):  # type: ignore[no-untyped-def]
    """Unit quaternion (x, y, z, w) of the rotation of X (3, 4), of either sign; from the largest of the four."""
    m00, m11, m22 = X[0, 0], X[1, 1], X[2, 2]
    if m00 + m11 + m22 > 0.0:
        x, y, z = X[2, 1] - X[1, 2], X[0, 2] - X[2, 0], X[1, 0] - X[0, 1]
        w = 1.0 + m00 + m11 + m22
    elif m00 >= m11 and m00 >= m22:
        x, y, z, w = 1.0 + m00 - m11 - m22, X[0, 1] + X[1, 0], X[0, 2] + X[2, 0], X[2, 1] - X[1, 2]
    elif m11 >= m22:
        x, y, z, w = X[0, 1] + X[1, 0], 1.0 + m11 - m00 - m22, X[1, 2] + X[2, 1], X[0, 2] - X[2, 0]
    else:
        x, y, z, w = X[0, 2] + X[2, 0], X[1, 2] + X[2, 1], 1.0 + m22 - m00 - m11, X[1, 0] - X[0, 1]
    s = 1.0 / math.sqrt(x * x + y * y + z * z + w * w)
    return s * x, s * y, s * z, s * w


@njit(cache=True, error_model="numpy")
def _write_poses(X, out):  # type: ignore[no-untyped-def]
    for n in range(X.shape[0]):
        for r in range(3):
            out[r, n] = X[n, r, 3]
        out[3, n], out[4, n], out[5, n], out[6, n] = _quaternion(X[n])


@njit(cache=True, error_model="numpy")
def _squared_distances(pose, X, weight, out):  # type: ignore[no-untyped-def]
    """`out` (P,): squared metres from `X`, an angle counting `weight` metres per rad (its chord, near enough)."""
    f = np.float32
    x, y, z = f(X[0, 3]), f(X[1, 3]), f(X[2, 3])
    qx, qy, qz, qw = _quaternion(X)
    a, b, c, d = f(qx), f(qy), f(qz), f(qw)
    turn, one = f(8.0 * weight * weight), f(1.0)  # angle^2 is about 8 (1 - |dot|)
    for n in range(pose.shape[1]):
        dx, dy, dz = pose[0, n] - x, pose[1, n] - y, pose[2, n] - z
        dot = abs(pose[3, n] * a + pose[4, n] * b + pose[5, n] * c + pose[6, n] * d)
        out[n] = dx * dx + dy * dy + dz * dz + turn * (one - dot)


@njit(cache=True, error_model="numpy")
def _smallest(values, chosen):  # type: ignore[no-untyped-def]
    """Write the indices of the smallest `values` to `chosen`, ascending, ties to the lower index."""
    count, filled = chosen.shape[0], 0
    bound = np.float32(np.inf)
    for n in range(values.shape[0]):
        if values[n] < bound:
            at = min(filled, count - 1)
            while at > 0 and values[chosen[at - 1]] > values[n]:
                chosen[at] = chosen[at - 1]
                at -= 1
            chosen[at] = n
            filled = min(filled + 1, count)
            if filled == count:
                bound = values[chosen[count - 1]]


@njit(cache=True, error_model="numpy")
def nearest_postures(table, X, weight, distances, out):  # type: ignore[no-untyped-def]
    """Write to `out` (K, D) postures whose hand pose is near `X` (3, 4), nearest first, no two alike where possible.

    Args:
        table: the postures.
        X: hand pose in B.
        weight: metres per rad.
        distances: (P,) float32 scratch.
        out: (K, D), K <= P.
    """
    count = out.shape[0]
    _squared_distances(table.pose, X, weight, distances)
    pool = np.empty(min(POOL * count, distances.shape[0]), np.int64)
    _smallest(distances, pool)
    used = np.zeros(pool.shape[0], np.bool_)
    made = 0
    for strict in (True, False):
        for i in range(pool.shape[0]):
            if made == count:
                return
            q = table.q[pool[i]]
            if not used[i] and not (strict and _is_near_any(q, out, made)):
                used[i] = True
                out[made] = q
                made += 1


@njit(cache=True, error_model="numpy")
def _is_near_any(q, rows, count):  # type: ignore[no-untyped-def]
    """Whether one of the first `count` rows is within APART_RAD of `q` in every joint."""
    for k in range(count):
        most = 0.0
        for d in range(q.shape[0]):
            most = max(most, abs(q[d] - rows[k, d]))
        if most < APART_RAD:
            return True
    return False
