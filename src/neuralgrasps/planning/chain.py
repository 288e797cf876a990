"""The joints between a robot's base and its hand, packed for kernels that need the hand pose only.

A `Chain` keeps what moves the hand and nothing else: fixed links are multiplied together, joints that are not planned
are set to their home position, and every axis is turned onto z, so that one joint costs one rigid product and a plane
rotation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.compiled import njit
from neuralgrasps.errors import RobotDescriptionError
from neuralgrasps.kinematics.forward_kernels import joint_motion
from neuralgrasps.kinematics.tree import REVOLUTE, KinematicTree


class Chain(NamedTuple):
    """Arrays of a chain of M moving joints driven by D planned joints `q`.

    Joint m turns about, or slides along, the z axis of its frame by `sum(gain * q[dof]) + offset[m]` over the entries
    `start[m]` to `start[m + 1]` of `dof` and `gain`.

    Attributes:
        X_before: (M, 3, 4) frame of a joint in the frame the joint before it moves (the base for the first).
        is_turn: (M,) bool, True for revolute, False for prismatic.
        start: (M + 1,), dof, gain: which planned joints drive a joint, and how fast. offset: (M,) rad or metres.
        X_tool: (3, 4) the hand base in the frame the last joint moves.
        lower, upper: (D,) limits of `q`.
        turns: (D,) bool, a full turn more or less is the same posture.
        free: (D,) bool, `turns` and limits at least one turn apart: every angle is within limits.
    """

    X_before: np.ndarray
    is_turn: np.ndarray
    start: np.ndarray
    dof: np.ndarray
    gain: np.ndarray
    offset: np.ndarray
    X_tool: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    turns: np.ndarray
    free: np.ndarray


def pack_chain(manipulator: Manipulator) -> Chain:
    """The chain from the base of `manipulator` to its hand base.

    Raises:
        RobotDescriptionError: limits that contradict each other or are not finite; no planned joint moves the hand.
    """
    lower, upper = (np.ascontiguousarray(v, float) for v in (manipulator.lower, manipulator.upper))
    bad = [n for n, lo, hi in zip(manipulator.arm_names, lower, upper, strict=True) if not -np.inf < lo < hi < np.inf]
    if bad:
        raise RobotDescriptionError(
            f"{manipulator.name}: joints {bad} have limits that cannot be used; expected finite numbers, lower < upper."
        )
    tree, dofs = manipulator.tree, np.asarray(manipulator.arm_dofs)
    moving, X_before, X_tool = _moving_joints(tree, dofs, manipulator.q_home, manipulator.hand_link)
    if not moving:
        raise RobotDescriptionError(f"{manipulator.name}: none of the planned joints {manipulator.arm_names} moves it.")
    coupling = tree.coupling[moving][:, dofs]
    rows, columns = np.nonzero(coupling)
    turns = _whole_turns(tree, dofs)
    return Chain(
        X_before=X_before,
        is_turn=tree.joint_types[moving] == REVOLUTE,
        start=np.searchsorted(rows, np.arange(len(moving) + 1)).astype(np.int64),
        dof=columns.astype(np.int64),
        gain=coupling[rows, columns],
        offset=_resting(tree, dofs, manipulator.q_home)[moving],
        X_tool=X_tool,
        lower=lower,
        upper=upper,
        turns=turns,
        free=turns & (upper - lower >= 2.0 * math.pi),
    )


def sliding_dofs(chain: Chain) -> np.ndarray:
    """(D,) bool: planned joints in metres, those that drive a joint that slides."""
    joint = np.repeat(np.arange(len(chain.is_turn)), np.diff(chain.start))
    slides = np.zeros(len(chain.lower), bool)
    slides[chain.dof[~chain.is_turn[joint]]] = True
    return slides


def _resting(tree: KinematicTree, dofs: np.ndarray, q_home: np.ndarray) -> np.ndarray:
    """Joint positions (L,) with the planned joints at 0 and all others at home."""
    q = np.array(q_home, float)
    q[dofs] = 0.0
    return tree.joint_positions(q)


def _moving_joints(
    tree: KinematicTree, dofs: np.ndarray, q_home: np.ndarray, hand_link: int
) -> tuple[list[int], np.ndarray, np.ndarray]:
    """Links (M,) whose joint moves the hand, base first; their frames (M, 3, 4), z along the axis; the hand (3, 4)."""
    path = [hand_link]
    while tree.parents[path[-1]] >= 0:
        path.append(int(tree.parents[path[-1]]))
    rest = _resting(tree, dofs, q_home)
    moving, frames, X = [], [], np.eye(4)
    for i in reversed(path):
        X = X @ tree.X_parent_joint[i]
        if tree.coupling[i, dofs].any():
            Z = _z_onto(tree.axes[i])
            moving.append(i)
            frames.append((X @ Z)[:3])
            X = Z.T  # a pure rotation: its inverse
        else:
            X = X @ joint_motion(int(tree.joint_types[i]), tree.axes[i], rest[i])
    return moving, np.array(frames), np.ascontiguousarray(X[:3])


def _z_onto(axis: np.ndarray) -> np.ndarray:
    """(4, 4) rotation that takes z onto `axis`."""
    x = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    x /= np.linalg.norm(x)
    Z = np.eye(4)
    Z[:3, :3] = np.stack([x, np.cross(axis, x), axis], axis=1)
    return Z


def _whole_turns(tree: KinematicTree, dofs: np.ndarray) -> np.ndarray:
    """(D,) bool: 2 pi more of a planned joint turns every joint it drives by whole turns."""
    gains = tree.coupling[:, dofs]
    fine = (gains == 0.0) | ((tree.joint_types[:, None] == REVOLUTE) & (gains == np.round(gains)))
    return np.asarray(fine.all(axis=0) & (gains != 0.0).any(axis=0))


@njit(cache=True, error_model="numpy")
def chain_pose(chain, q, lines, out):  # type: ignore[no-untyped-def]
    """Write the hand pose `out` (3, 4) in B at `q` (D,), and `lines` (M, 6): each axis and a point on it in B."""
    r00, r01, r02, tx = 1.0, 0.0, 0.0, 0.0
    r10, r11, r12, ty = 0.0, 1.0, 0.0, 0.0
    r20, r21, r22, tz = 0.0, 0.0, 1.0, 0.0
    count = chain.is_turn.shape[0]
    for m in range(count + 1):
        X = chain.X_before[m] if m < count else chain.X_tool
        b00, b01, b02, bx = X[0, 0], X[0, 1], X[0, 2], X[0, 3]
        b10, b11, b12, by = X[1, 0], X[1, 1], X[1, 2], X[1, 3]
        b20, b21, b22, bz = X[2, 0], X[2, 1], X[2, 2], X[2, 3]
        tx += r00 * bx + r01 * by + r02 * bz
        ty += r10 * bx + r11 * by + r12 * bz
        tz += r20 * bx + r21 * by + r22 * bz
        x, y, z = r00, r01, r02
        r00, r01, r02 = x * b00 + y * b10 + z * b20, x * b01 + y * b11 + z * b21, x * b02 + y * b12 + z * b22
        x, y, z = r10, r11, r12
        r10, r11, r12 = x * b00 + y * b10 + z * b20, x * b01 + y * b11 + z * b21, x * b02 + y * b12 + z * b22
        x, y, z = r20, r21, r22
        r20, r21, r22 = x * b00 + y * b10 + z * b20, x * b01 + y * b11 + z * b21, x * b02 + y * b12 + z * b22
        if m == count:
            break
        p = chain.offset[m]
        for k in range(chain.start[m], chain.start[m + 1]):
            p += chain.gain[k] * q[chain.dof[k]]
        if chain.is_turn[m]:
            s, c = math.sin(p), math.cos(p)
            r00, r01 = c * r00 + s * r01, c * r01 - s * r00
            r10, r11 = c * r10 + s * r11, c * r11 - s * r10
            r20, r21 = c * r20 + s * r21, c * r21 - s * r20
        else:
            tx, ty, tz = tx + p * r02, ty + p * r12, tz + p * r22
        lines[m, 0], lines[m, 1], lines[m, 2] = r02, r12, r22
        lines[m, 3], lines[m, 4], lines[m, 5] = tx, ty, tz
    out[0, 0], out[0, 1], out[0, 2], out[0, 3] = r00, r01, r02, tx
    out[1, 0], out[1, 1], out[1, 2], out[1, 3] = r10, r11, r12, ty
    out[2, 0], out[2, 1], out[2, 2], out[2, 3] = r20, r21, r22, tz


@njit(cache=True, error_model="numpy")
def chain_jacobian(chain, lines, pose, rotation_weight, out):  # type: ignore[no-untyped-def]
    """Write `out` (D, 6): velocity of the hand origin, and its angular velocity times `rotation_weight`, in B.

    Args:
        chain: the packed chain.
        lines: (M, 6), pose: (3, 4), both from `chain_pose`.
        rotation_weight: metres per rad.
        out: (D, 6), one row per planned joint.
    """
    out[:] = 0.0
    for m in range(chain.is_turn.shape[0]):
        zx, zy, zz = lines[m, 0], lines[m, 1], lines[m, 2]
        turn = chain.is_turn[m]
        dx, dy, dz = pose[0, 3] - lines[m, 3], pose[1, 3] - lines[m, 4], pose[2, 3] - lines[m, 5]
        for k in range(chain.start[m], chain.start[m + 1]):
            g, row = chain.gain[k], out[chain.dof[k]]
            if turn:
                row[0] += g * (zy * dz - zz * dy)
                row[1] += g * (zz * dx - zx * dz)
                row[2] += g * (zx * dy - zy * dx)
                row[3] += g * rotation_weight * zx
                row[4] += g * rotation_weight * zy
                row[5] += g * rotation_weight * zz
            else:
                row[0] += g * zx
                row[1] += g * zy
                row[2] += g * zz


@njit(cache=True, error_model="numpy")
def chain_poses(chain, q):  # type: ignore[no-untyped-def]
    """Hand poses (N, 3, 4) in B at `q` (N, D)."""
    out = np.empty((q.shape[0], 3, 4))
    lines = np.empty((chain.is_turn.shape[0], 6))
    for n in range(q.shape[0]):
        chain_pose(chain, q[n], lines, out[n])
    return out
