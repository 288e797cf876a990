"""How much a closed hand can lift: the largest weight that its contacts and its motors can carry together.

Forces f >= 0 along the edges of the contacts' friction cones balance a weight w at the object's centre of mass, and
the joint torques that exert them (J' f) stay within the motors' limits:

    max w   over f >= 0, 0 <= w <= most,   G f + w g = 0,   -1 <= T f <= 1,   sum f <= press,

where the columns of G are the edges' wrenches, g is the unit weight's, and the columns of T are the edges' torques over
the limits. Epsilon asks the same of every direction at a total normal force of 1 N, and knows no motors. Links that no
motor holds, a palm, press as hard as they need to.

The linear program is solved by the simplex method on a dense tableau, 20-60 pivots in practice. f = 0 is feasible, so
no first phase is needed: six pivots at zero bring the balance into the basis.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.grasps.wrench_space import fill_grasp_wrenches
from neuralgrasps.kinematics.jacobian import frame_jacobian
from neuralgrasps.kinematics.tree import KinematicTree

MOST_PRESS = 500.0  # N, sum of the normal forces of a grip; only grips that wedge themselves come near
_TINY = 1e-9
_ZERO = 1e-12
_MAX_PIVOTS = 2000
_FEW_STILL = 30  # pivots in a row without progress after which the smallest index is taken, which cannot cycle


class LiftGrip(NamedTuple):
    """The grip that lifts the most.

    Attributes:
        weight: N, the largest it carries, at most what was asked for.
        forces: (C, 3) on the object at each contact, in the frame of the contacts, N.
        torques: (J,) of the joints that exert them, N m or N.
    """

    weight: float
    forces: np.ndarray
    torques: np.ndarray


class Joints(NamedTuple):
    """Arrays of a `KinematicTree` that Jacobians are made of: parents, types (L,), axes (L, 3), coupling (L, J)."""

    parents: np.ndarray
    joint_types: np.ndarray
    axes: np.ndarray
    coupling: np.ndarray


def joints_of(tree: KinematicTree) -> Joints:
    """The joints of a tree for the compiled functions here."""
    return Joints(tree.parents, tree.joint_types, tree.axes, tree.coupling)


@njit(cache=True, error_model="numpy")
def _pivot(tableau, row, column):  # type: ignore[no-untyped-def]
    """Exchange the basic variable of `row` with the free one of `column`, in place."""
    rows, columns = tableau.shape
    scale = 1.0 / tableau[row, column]
    for j in range(columns):
        tableau[row, j] *= scale
    for i in range(rows):
        factor = tableau[i, column]
        if i == row or abs(factor) < _ZERO:
            tableau[i, column] = 0.0 if i != row else tableau[i, column]
            continue
        for j in range(columns):
            tableau[i, j] -= factor * tableau[row, j]
        tableau[i, column] = -factor * scale
    tableau[row, column] = scale


@njit(cache=True, error_model="numpy")
def _enter_balance(tableau, basis, free, locked):  # type: ignore[no-untyped-def]
    """Bring a force into the basis for each of the six equations, at zero; `locked` marks columns that stay zero."""
    for row in range(6):
        best, column = 1e-9, -1
        for j in range(free.shape[0]):
            if not locked[j] and abs(tableau[row, j]) > best:
                best, column = abs(tableau[row, j]), j
        if column >= 0:
            _pivot(tableau, row, column)
            basis[row], free[column] = free[column], basis[row]
            locked[column] = True


@njit(cache=True, error_model="numpy")
def _entering(tableau, free, locked, careful):  # type: ignore[no-untyped-def]
    """The column that raises the objective most, or, if `careful`, the raising one of the smallest index; -1: none."""
    last, column, best = tableau.shape[0] - 1, -1, -_TINY
    for j in range(free.shape[0]):
        if locked[j] or tableau[last, j] >= -_TINY:
            continue
        if careful:
            if column < 0 or free[j] < free[column]:
                column = j
        elif tableau[last, j] < best:
            best, column = tableau[last, j], j
    return column


@njit(cache=True, error_model="numpy")
def _leaving(tableau, basis, column):  # type: ignore[no-untyped-def]
    """The row whose variable first falls to zero, of several that of the smallest index; -1: none."""
    right, row, least = tableau.shape[1] - 1, -1, np.inf
    for i in range(basis.shape[0]):
        slope = tableau[i, column]
        if slope <= _TINY:
            continue
        ratio = max(tableau[i, right], 0.0) / slope
        if ratio < least - 1e-12 or (ratio <= least + 1e-12 and row >= 0 and basis[i] < basis[row]):
            least, row = min(ratio, least), i
    return row


@njit(cache=True, error_model="numpy")
def strongest_lift(wrenches, torques, effort, pull, most, press=MOST_PRESS):  # type: ignore[no-untyped-def]
    """The largest weight, and the edge forces that carry it.

    Args:
        wrenches: (W, 6) of unit edge forces on the object, rows of `wrench_space.grasp_wrenches`.
        torques: (W, J) of the joints that exert these. effort: (J,) limits, > 0.
        pull: (6,) wrench of a weight of 1 N, torque divided by the same length.
        most: N, no more is asked for. press: N, bound on the sum of all normal forces.
    Returns:
        weight in [0, most], and f (W,) float64 >= 0.
    """
    count, joints = torques.shape
    rows = 6 + 2 * joints + 2
    tableau = np.zeros((rows + 1, count + 2))  # free variables f, w, and the right side; the last row is the objective
    for i in range(count):
        for k in range(6):
            tableau[k, i] = wrenches[i, k]
        for j in range(joints):
            tableau[6 + 2 * j, i] = torques[i, j] / effort[j]
            tableau[7 + 2 * j, i] = -torques[i, j] / effort[j]
        tableau[rows - 1, i] = 1.0 / press
    for k in range(6):
        tableau[k, count] = pull[k]
    tableau[rows - 2, count] = 1.0
    tableau[rows, count] = -1.0
    for r in range(6, rows):
        tableau[r, count + 1] = 1.0
    tableau[rows - 2, count + 1] = most
    basis, free = np.arange(count + 1, count + 1 + rows), np.arange(count + 1)
    locked = np.zeros(count + 1, np.bool_)
    _enter_balance(tableau, basis, free, locked)
    still, value = 0, 0.0
    for _ in range(_MAX_PIVOTS):
        column = _entering(tableau, free, locked, still > _FEW_STILL)
        row = _leaving(tableau, basis, column) if column >= 0 else -1
        if row < 0:
            break
        _pivot(tableau, row, column)
        basis[row], free[column] = free[column], basis[row]
        still = still + 1 if tableau[rows, count + 1] <= value + 1e-12 else 0
        value = max(value, tableau[rows, count + 1])
    f = np.zeros(count + 1)
    for i in range(rows):
        if basis[i] <= count:
            f[basis[i]] = max(tableau[i, count + 1], 0.0)
    return f[count], f[:count]


@njit(cache=True, error_model="numpy")
def edge_torques(joints, X_HL, X_OH, points, links, wrenches, com, length, per_contact, out):  # type: ignore[no-untyped-def]
    """out (W, J): joint torques that exert each edge's unit force, and its moment, on the object.

    `joints` is a `Joints`; row i belongs to contact i // per_contact.
    """
    jacobian = np.empty((6, out.shape[1]))
    point, force, moment = np.empty(3), np.empty(3), np.empty(3)
    for c in range(len(out) // per_contact):
        for r in range(3):
            point[r] = 0.0
            for k in range(3):
                point[r] += X_OH[k, r] * (points[c, k] - X_OH[k, 3])
        frame_jacobian(
            joints.parents, joints.joint_types, joints.axes, joints.coupling, X_HL, links[c], point, jacobian
        )
        lx, ly, lz = points[c, 0] - com[0], points[c, 1] - com[1], points[c, 2] - com[2]
        for i in range(c * per_contact, (c + 1) * per_contact):
            w = wrenches[i]
            # what is left of the torque about the centre of mass is the moment in the contact itself
            moment[0] = w[3] * length - (ly * w[2] - lz * w[1])
            moment[1] = w[4] * length - (lz * w[0] - lx * w[2])
            moment[2] = w[5] * length - (lx * w[1] - ly * w[0])
            for r in range(3):
                force[r] = X_OH[0, r] * w[0] + X_OH[1, r] * w[1] + X_OH[2, r] * w[2]
            mx = X_OH[0, 0] * moment[0] + X_OH[1, 0] * moment[1] + X_OH[2, 0] * moment[2]
            my = X_OH[0, 1] * moment[0] + X_OH[1, 1] * moment[1] + X_OH[2, 1] * moment[2]
            mz = X_OH[0, 2] * moment[0] + X_OH[1, 2] * moment[1] + X_OH[2, 2] * moment[2]
            for j in range(out.shape[1]):
                total = jacobian[3, j] * mx + jacobian[4, j] * my + jacobian[5, j] * mz
                for r in range(3):
                    total += jacobian[r, j] * force[r]
                out[i, j] = total


@njit(cache=True, error_model="numpy")
def lift_grip(  # type: ignore[no-untyped-def]
    joints, X_HL, X_OH, points, normals, links, com, up, most, effort, friction, torsion, length, edges=8
):
    """The `LiftGrip` of one closed hand.

    Args:
        joints: see `joints_of`. X_HL: (L, 4, 4) link poses. X_OH: (4, 4) hand in O.
        points, normals (C, 3), links (C,): contacts, in O, normals outward from the object; no padding.
        com: (3,) centre of mass in O. up: (3,) unit direction against the weight. most: N.
        effort: (J,) limits, N m or N. friction, torsion, length, edges: as for `grasp_wrenches`; torsion > 0.
    """
    contacts, motors = len(points), len(effort)
    rows = edges + (2 if torsion > 0.0 else 0)
    wrenches, torques = np.empty((contacts * rows, 6)), np.empty((contacts * rows, motors))
    fill_grasp_wrenches(points, normals, contacts, com, friction, edges, torsion, length, wrenches)
    edge_torques(joints, X_HL, X_OH, points, links, wrenches, com, length, rows, torques)
    pull = np.zeros(6)
    for k in range(3):
        pull[k] = -up[k]
    weight, f = strongest_lift(wrenches, torques, effort, pull, most)
    forces, torque = np.zeros((contacts, 3)), np.zeros(motors)
    for i in range(contacts * rows):
        for k in range(3):
            forces[i // rows, k] += f[i] * wrenches[i, k]
        for j in range(motors):
            torque[j] += f[i] * torques[i, j]
    return LiftGrip(weight, forces, torque)


@njit(cache=True, error_model="numpy", nogil=True)
def lift_weights(  # type: ignore[no-untyped-def]
    joints, X_HL, X_OH, points, normals, links, com, up, most, effort, friction, torsion, length, out
):
    """out (N,): the weight of `lift_grip` of each of N hands, N.

    X_HL (N, L, 4, 4), X_OH (N, 4, 4), points, normals (N, C, 3); links (N, C), -1 behind the last contact of a hand.
    """
    for i in range(X_OH.shape[0]):
        count = 0
        while count < links.shape[1] and links[i, count] >= 0:
            count += 1
        out[i] = 0.0
        if count > 0:
            out[i] = lift_grip(
                joints, X_HL[i], X_OH[i], points[i, :count], normals[i, :count], links[i, :count], com, up, most,
                effort, friction, torsion, length,
            ).weight  # fmt: skip
