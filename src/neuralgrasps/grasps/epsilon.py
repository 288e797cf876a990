"""The Ferrari-Canny quality of a grasp, exact and fast.

Epsilon is the radius of the largest ball around the origin in the grasp wrench space, the convex hull of the wrenches
of all contacts' cone edges ("L1": the normal forces of all contacts sum to at most 1); 0 when the origin is not in its
interior (no force closure).
Source: Ferrari & Canny 1992, "Planning optimal grasps".
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.spatial import ConvexHull, QhullError

LARGEST_POLAR = 1e7  # epsilon below 1 / this is reported as 0
MAX_PIVOTS = 400
STARTS = 64
_ESCAPE = 1.3  # local maxima within this factor of the best are escaped from
_PERTURBATION = 1e-9


def _fixed_axes() -> np.ndarray:
    """(96, 6) unit axes; with their opposites the 192 directions of the quick rejection."""
    axes = np.random.default_rng(192).standard_normal((90, 6))
    axes = np.concatenate([np.eye(6), axes / np.linalg.norm(axes, axis=1, keepdims=True)])
    axes.flags.writeable = False
    return axes


_AXES = _fixed_axes()


@njit(cache=True, error_model="numpy")
def _lowest_supports(columns, count, starts, start_directions):  # type: ignore[no-untyped-def]
    """Lowest support over the 192 directions; fills `starts` of the lowest, stops at the first that is <= 0."""
    lowest = np.full(starts, np.inf)
    values = np.empty(count)
    for a in range(len(_AXES)):
        for i in range(count):
            values[i] = 0.0
        for k in range(6):
            weight = _AXES[a, k]
            if weight != 0.0:
                for i in range(count):
                    values[i] += weight * columns[k, i]
        high = low = values[0]
        for i in range(1, count):
            high = max(high, values[i])
            low = min(low, values[i])
        for side in range(2):
            support = high if side == 0 else -low
            sign = 1.0 if side == 0 else -1.0
            if support <= 0.0:
                return 0.0
            if support < lowest[starts - 1]:
                slot = starts - 1
                while slot > 0 and lowest[slot - 1] > support:
                    lowest[slot] = lowest[slot - 1]
                    start_directions[slot] = start_directions[slot - 1]
                    slot -= 1
                lowest[slot] = support
                for k in range(6):
                    start_directions[slot, k] = sign * _AXES[a, k]
    return lowest[0]


@njit(cache=True, error_model="numpy")
def _ratio(slack, column, count):  # type: ignore[no-untyped-def]
    """Step to the first constraint that blocks a move along `column` (d slack / d t), and its index (-1 = none)."""
    step, block = np.inf, -1
    for i in range(count):
        rate = -column[i]
        if rate > 1e-11 and slack[i] < step * rate:
            step, block = slack[i] / rate, i
    return max(step, 0.0), block


@njit(cache=True, error_model="numpy")
def _pivot(table, edges, slack, x, count, column, row, step):  # type: ignore[no-untyped-def]
    """Move along `column` by `step` until slack `row` is 0, then let that slack take the column's place."""
    for i in range(count):
        slack[i] += step * table[column, i]
    for k in range(6):
        x[k] += step * edges[column, k]
    slack[row] = 0.0
    scale = 1.0 / table[column, row]
    for i in range(count):
        table[column, i] *= scale
    for k in range(6):
        edges[column, k] *= scale
    for j in range(6):
        factor = table[j, row]
        if j != column and factor != 0.0:
            for i in range(count):
                table[j, i] -= factor * table[column, i]
            for k in range(6):
                edges[j, k] -= factor * edges[column, k]
            table[j, row] = 0.0
    table[column, row] = 1.0


@njit(cache=True, error_model="numpy")
def _to_vertex(columns, count, direction, table, edges, slack, x, basis):  # type: ignore[no-untyped-def]
    """Climb from the origin along `direction`, then along growing |x|, to a vertex. False: the polar is unbounded."""
    for i in range(count):
        # distinct right-hand sides make every vertex simple (no ties, no cycling); removed again in `_radius`
        slack[i] = 1.0 + _PERTURBATION * (1.0 + (i * 0.6180339887498949) % 1.0)
    for j in range(6):
        x[j] = 0.0
        basis[j] = -1
        for k in range(6):
            edges[j, k] = 1.0 if j == k else 0.0
        for i in range(count):
            table[j, i] = -columns[j, i]
    weights, move = np.empty(6), np.empty(count)
    for level in range(6):
        largest = 0.0
        for j in range(6):
            weights[j] = 0.0
            if basis[j] < 0:
                for k in range(6):
                    weights[j] += edges[j, k] * (direction[k] if level == 0 else x[k])
                largest = max(largest, abs(weights[j]))
        if largest < 1e-9:  # |x| is stationary: any free direction increases it to second order
            for j in range(6):
                weights[j] = 0.0
            for j in range(6):
                if basis[j] < 0:
                    weights[j] = largest = 1.0
                    break
        for j in range(6):
            weights[j] /= largest
        for i in range(count):
            move[i] = 0.0
        for j in range(6):
            if weights[j] != 0.0:
                for i in range(count):
                    move[i] += weights[j] * table[j, i]
        step, row = _ratio(slack, move, count)
        if row < 0:
            return False
        for i in range(count):
            slack[i] += step * move[i]
        for k in range(6):
            for j in range(6):
                x[k] += step * weights[j] * edges[j, k]
        column, size = -1, 0.0
        for j in range(6):
            if basis[j] < 0 and abs(table[j, row]) > size:
                column, size = j, abs(table[j, row])
        if column < 0:
            return False
        _pivot(table, edges, slack, x, count, column, row, 0.0)
        basis[column] = row
        if _squared(x) > LARGEST_POLAR * LARGEST_POLAR:
            return False
    return True


@njit(cache=True, error_model="numpy")
def _squared(x):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(6):
        total += x[k] * x[k]
    return total


@njit(cache=True, error_model="numpy")
def _is_bounded(columns, count, table, edges, slack, x, basis):  # type: ignore[no-untyped-def]
    """Exact test of force closure from any vertex: is max c.x with c = -mean(w) bounded?

    A direction r of the polar's recession cone has w_i.r <= 0 for all i, hence c.r > 0 unless all are 0 (which
    `_to_vertex` has excluded): the linear programme is unbounded exactly when the polar is.
    """
    objective = np.zeros(6)
    for k in range(6):
        for i in range(count):
            objective[k] -= columns[k, i] / count
    for _ in range(MAX_PIVOTS):
        column, best = -1, 1e-12
        for j in range(6):
            gain = size = 0.0
            for k in range(6):
                gain += objective[k] * edges[j, k]
                size += edges[j, k] * edges[j, k]
            gain /= np.sqrt(size)
            if gain > best:
                column, best = j, gain
        if column < 0:
            return True
        step, row = _ratio(slack, table[column], count)
        if row < 0:
            return False
        _pivot(table, edges, slack, x, count, column, row, step)
        basis[column] = row
        if _squared(x) > LARGEST_POLAR * LARGEST_POLAR:
            return False
    return True


@njit(cache=True, error_model="numpy")
def _is_new_vertex(basis, visited):  # type: ignore[no-untyped-def]
    """Whether the set of rows `basis` was not in the hash table `visited` (zeros = free slots); adds it."""
    key = np.uint64(0)
    for j in range(6):  # a sum of mixed indices does not depend on their order
        z = np.uint64(basis[j] + 1) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        key += z ^ (z >> np.uint64(27))
    key |= np.uint64(1)
    slot = int(key >> np.uint64(40)) % len(visited)
    for _ in range(len(visited)):
        if visited[slot] == key:
            return False
        if visited[slot] == 0:
            visited[slot] = key
            return True
        slot = (slot + 1) % len(visited)
    return True


@njit(cache=True, error_model="numpy")
def _climb(count, table, edges, slack, x, basis, visited):  # type: ignore[no-untyped-def]
    """Walk to the farthest neighbouring vertex until none is farther, or another walk has been there.

    Returns 1 at a new local maximum, 0 when it joined an earlier walk, -1 when an edge has no end.
    """
    for _ in range(MAX_PIVOTS):
        if not _is_new_vertex(basis, visited):
            return 0
        best, best_column, best_row, best_step = _squared(x) * (1.0 + 1e-12), -1, -1, 0.0
        for j in range(6):
            step, row = _ratio(slack, table[j], count)
            if row < 0:
                return -1
            there = 0.0
            for k in range(6):
                there += (x[k] + step * edges[j, k]) ** 2
            if there > best:
                best, best_column, best_row, best_step = there, j, row, step
        if best_column < 0:
            return 1
        _pivot(table, edges, slack, x, count, best_column, best_row, best_step)
        basis[best_column] = best_row
        if best > LARGEST_POLAR * LARGEST_POLAR:
            return -1
    return 1


@njit(cache=True, error_model="numpy")
def _radius(columns, basis):  # type: ignore[no-untyped-def]
    """1 / |x| at the vertex of the unperturbed constraints `basis`."""
    matrix, ones = np.empty((6, 6)), np.ones(6)
    for j in range(6):
        for k in range(6):
            matrix[j, k] = columns[k, basis[j]]
    for j in range(6):
        pivot = j
        for r in range(j + 1, 6):
            if abs(matrix[r, j]) > abs(matrix[pivot, j]):
                pivot = r
        if matrix[pivot, j] == 0.0:
            return 0.0
        for k in range(6):
            matrix[j, k], matrix[pivot, k] = matrix[pivot, k], matrix[j, k]
        ones[j], ones[pivot] = ones[pivot], ones[j]
        for r in range(j + 1, 6):
            factor = matrix[r, j] / matrix[j, j]
            ones[r] -= factor * ones[j]
            for k in range(j, 6):
                matrix[r, k] -= factor * matrix[j, k]
    for j in range(5, -1, -1):
        for k in range(j + 1, 6):
            ones[j] -= matrix[j, k] * ones[k]
        ones[j] /= matrix[j, j]
    return 1.0 / np.sqrt(_squared(ones))


@njit(cache=True, error_model="numpy")
def _escape(columns, count, table, edges, slack, x, basis, visited, best):  # type: ignore[no-untyped-def]
    """Least radius found at a local maximum and by climbing again from each of its neighbours; 0.0 = unbounded."""
    result = _radius(columns, basis)
    if result > _ESCAPE * best:
        return result
    table0, edges0, slack0, x0, basis0 = table.copy(), edges.copy(), slack.copy(), x.copy(), basis.copy()
    column = 0
    while column < 6:
        table[:], edges[:], slack[:], x[:], basis[:] = table0, edges0, slack0, x0, basis0
        step, row = _ratio(slack, table[column], count)
        if row < 0:
            return 0.0
        _pivot(table, edges, slack, x, count, column, row, step)
        basis[column] = row
        column += 1
        end = _climb(count, table, edges, slack, x, basis, visited)
        if end < 0:
            return 0.0
        if end > 0:
            radius = _radius(columns, basis)
            if radius < result:
                result, column = radius, 0
                table0[:], edges0[:], slack0[:], x0[:], basis0[:] = table, edges, slack, x, basis
    return result


@njit(cache=True, error_model="numpy")
def epsilon(wrenches, starts=STARTS):  # type: ignore[no-untyped-def]
    """Radius of the largest origin-centred ball in the hull of `wrenches`; 0.0 without force closure.

    epsilon = 1 / max |x| over the polar polytope {x : w_i.x <= 1}. The grasp is rejected when any of 192 fixed
    directions has support <= 0; force closure is then decided exactly by one linear programme; the maximum is found by
    vertex walks (simplex pivots that increase |x|) from above the `starts` directions of lowest support.

    The walks may miss the global maximum and then return too much. How many grasps (2-24 contacts on boxes, balls and
    cans, and random wrenches; a quarter not force closure) differ from Qhull by over 1e-6: with 8 starts 39 of 9,200
    (largest difference 0.03), with 16 3 of 5,200, with 32 1 of 5,200, with 64 none of 9,200 (largest 6e-9). They take
    0.13, 0.21, 0.35 and 0.64 ms; Qhull takes 13 ms. Whether there is force closure never differed.

    Args:
        wrenches: (W, 6) float64, see `wrench_space.grasp_wrenches`.
        starts: walks, 1 to 192; 8 or 16 are enough to rank candidates.
    """
    count = len(wrenches)
    if count < 7:
        return 0.0
    columns = np.empty((6, count))
    for i in range(count):
        for k in range(6):
            columns[k, i] = wrenches[i, k]
    directions = np.zeros((starts, 6))
    if _lowest_supports(columns, count, starts, directions) <= 0.0:
        return 0.0
    table, edges = np.empty((6, count)), np.empty((6, 6))
    slack, x, basis = np.empty(count), np.empty(6), np.empty(6, np.int64)
    visited = np.zeros(4096, np.uint64)
    result = np.inf
    for start in range(starts + 1):
        # the first walk starts from the vertex that decides force closure
        if not _to_vertex(columns, count, directions[max(start - 1, 0)], table, edges, slack, x, basis):
            return 0.0
        if start == 0 and not _is_bounded(columns, count, table, edges, slack, x, basis):
            return 0.0
        end = _climb(count, table, edges, slack, x, basis, visited)
        if end < 0:
            return 0.0
        if end > 0:
            radius = _escape(columns, count, table, edges, slack, x, basis, visited, result)
            if radius == 0.0:
                return 0.0
            result = min(result, radius)
    return result


@njit(cache=True, error_model="numpy")
def epsilon_upper_bound(wrenches):  # type: ignore[no-untyped-def]
    """Lowest support over 192 fixed directions, never below epsilon; 0.0 proves that there is no force closure.

    Costs 0.015 ms. Use it to reject, never to accept: about half of the grasps without force closure pass it, and its
    median is 1.8 times epsilon.
    """
    count = len(wrenches)
    columns = np.empty((6, count))
    for i in range(count):
        for k in range(6):
            columns[k, i] = wrenches[i, k]
    return max(_lowest_supports(columns, count, 1, np.zeros((1, 6))), 0.0) if count else 0.0


@njit(cache=True, error_model="numpy")
def epsilon_batch(wrenches, counts, starts=STARTS):  # type: ignore[no-untyped-def]
    """`epsilon` of each of (N, W, 6) wrench sets of which the first counts[n] rows are used -> (N,) float64."""
    out = np.empty(len(wrenches))
    for n in range(len(wrenches)):
        out[n] = epsilon(wrenches[n, : counts[n]], starts)
    return out


def epsilon_qhull(wrenches: np.ndarray) -> float:
    """The same quality from a full convex hull in 6D (Qhull, joggled input): slow, the reference of the tests."""
    if len(wrenches) < 7:
        return 0.0
    try:
        hull = ConvexHull(np.asarray(wrenches, np.float64), qhull_options="QJ")
    except QhullError:
        return 0.0
    radius = float(-hull.equations[:, -1].max())
    return radius if radius > 1e-9 else 0.0
