"""Poses as messages have them, and the wrist link that they are of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.errors import InputError, check_shape
from neuralgrasps.export.messages import Message
from neuralgrasps.geometry.se3_numpy import inverse_np, make_transform_np, quaternion_matrix
from neuralgrasps.hands.hand import Hand
from neuralgrasps.kinematics.forward_kernels import forward_fast

_RIGID = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wrist:
    """The link whose pose stands for a hand's in messages.

    Attributes:
        link: its name on the robot.
        X_LH: (4, 4) the hand base in it.
    """

    link: str
    X_LH: np.ndarray


def wrist_of(manipulator: Manipulator) -> Wrist:
    """The arm's flange link: the last one before the hand, MoveIt's "parent link" of the end effector."""
    X_BL = forward_fast(manipulator.tree, manipulator.q_home)
    flange = manipulator.arm.flange
    return Wrist(
        link=manipulator.arm.tree.link_names[flange], X_LH=inverse_np(X_BL[flange]) @ X_BL[manipulator.hand_link]
    )


def hand_base(hand: Hand) -> Wrist:
    """The hand's own base link, for hands that are on no arm, or where the robot's wrist frame is the hand base."""
    return Wrist(link=hand.tree.link_names[0], X_LH=np.eye(4))


def check_pose(X: np.ndarray, name: str) -> np.ndarray:
    """(4, 4) float64, refused unless it is a rigid motion to 1e-6.

    Raises:
        ShapeError: another shape. InputError: not finite or not rigid.
    """
    X = np.asarray(X, np.float64)
    check_shape(name, X.shape, (4, 4))
    R = X[..., :3, :3]
    finite = bool(np.isfinite(X).all())
    if not finite or np.abs(R.T @ R - np.eye(3)).max() > _RIGID or np.linalg.det(R) < 0:
        raise InputError(f"{name} is not a rigid transform; expected a rotation (to 1e-6) and a translation.")
    if (X[3] != (0, 0, 0, 1)).any():
        raise InputError(f"{name} has the last row {X[3].tolist()}; expected 0 0 0 1.")
    return X


def quaternion_xyzw(X: np.ndarray) -> list[float]:
    """x, y, z, w of the rotation of X (4, 4), w >= 0."""
    return [float(v) for v in Rotation.from_matrix(X[:3, :3]).as_quat(canonical=True)]


def xyz(values: np.ndarray) -> Message:
    """(3,) numbers as the fields x, y, z."""
    return dict(zip("xyz", (float(v) for v in values), strict=True))


def pose_fields(X: np.ndarray) -> Message:
    """X (4, 4) as `geometry_msgs/Pose`: position x y z, orientation x y z w."""
    return {
        "position": xyz(X[:3, 3]),
        "orientation": dict(zip("xyzw", quaternion_xyzw(X), strict=True)),
    }


def pose_of(fields: Mapping[str, Mapping[str, float]]) -> np.ndarray:
    """X (4, 4) of a `geometry_msgs/Pose`; quaternions of any non-zero length.

    Raises:
        InputError: a quaternion of zero length.
    """
    p, q = fields["position"], fields["orientation"]
    return make_transform_np(quaternion_matrix([q[k] for k in "wxyz"]), [p[k] for k in "xyz"])
