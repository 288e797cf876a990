"""Hands on arms: where a hand goes on the flange."""

from __future__ import annotations

import math

import numpy as np

from neuralgrasps.arms.arm import Arm
from neuralgrasps.arms.manipulator import Manipulator, mount_at
from neuralgrasps.errors import check_shape
from neuralgrasps.geometry.se3_numpy import make_transform_np, rpy_matrix
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.parts import part_mesh
from neuralgrasps.kinematics.forward_kernels import forward_numpy

# Mountings that makers publish, X_FH by the names of flange link and hand base.
_KNOWN = {
    ("wrist_roll_link", "gripper_link"): make_transform_np(None, (0.16645, 0.0, 0.0)),
    ("panda_link8", "panda_hand"): make_transform_np(rpy_matrix((0.0, 0.0, -math.pi / 4)), (0.0, 0.0, 0.0)),
}


def mount(arm: Arm, hand: Hand, X_MH: np.ndarray | None = None) -> Manipulator:
    """`hand` on the face of `arm`.

    By default where its maker puts it, if that is known; else with its back on the face, its approach axis along the
    z axis of the face M, and the x axis of its palm along that of M.

    Args:
        X_MH: (4, 4) hand base in the mounting face, in place of the default.
    Raises:
        ShapeError: `X_MH` is not (4, 4).
    """
    if X_MH is not None:
        check_shape("X_MH", np.shape(X_MH), (4, 4))
        return mount_at(arm, hand, arm.X_FM @ np.asarray(X_MH, float))
    known = _KNOWN.get((arm.tree.link_names[arm.flange], hand.tree.link_names[0]))
    return mount_at(arm, hand, arm.X_FM @ default_mounting(hand) if known is None else known)


def default_mounting(hand: Hand) -> np.ndarray:
    """X_MH (4, 4) of a hand whose mounting nobody published."""
    X_PH = np.linalg.inv(hand.X_HP)
    vertices = _vertices(hand) @ X_PH[:3, :3].T + X_PH[:3, 3]
    X_MP = np.eye(4)
    X_MP[2, 3] = -float(vertices[:, 2].min())
    return X_MP @ X_PH


def _vertices(hand: Hand) -> np.ndarray:
    """(V, 3) of the open hand's parts, in H."""
    X_HL = forward_numpy(hand.tree, hand.q_open)
    meshes = [part_mesh(p).transformed(X_HL[p.link]) for p in hand.parts]
    return np.concatenate([m.vertices for m in meshes])
