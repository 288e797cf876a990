"""Hands on arms: where a hand goes on the flange."""

from __future__ import annotations

import math

import numpy as np

from neuralgrasps.arms.arm import Arm
from neuralgrasps.arms.manipulator import Manipulator, mount_at
from neuralgrasps.errors import check_shape
from neuralgrasps.geometry.se3_numpy import make_transform_np, rpy_matrix
from neuralgrasps.hands.chains import rigid_bodies
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.parts import part_mesh, sample_part
from neuralgrasps.kinematics.forward_kernels import forward_numpy

# Mountings that makers publish, X_FH by the names of flange link and hand base.
_KNOWN = {
    ("wrist_roll_link", "gripper_link"): make_transform_np(None, (0.16645, 0.0, 0.0)),
    ("panda_link8", "panda_hand"): make_transform_np(rpy_matrix((0.0, 0.0, -math.pi / 4)), (0.0, 0.0, 0.0)),
}

_AROUND = 0.6  # cosine; fingers that lean less from the palm's normal stand around it
_WRIST = 0.02  # m of the palm's end that count as its wrist
_FLANGE_RADIUS = 0.035  # m; what is further from the axis may stand behind the face
_DENSITY = 1e5  # surface points per square metre


def mount(arm: Arm, hand: Hand, X_MH: np.ndarray | None = None) -> Manipulator:
    """`hand` on the face of `arm`.

    By default where its maker puts it, if that is known; else with its back on the face. A gripper, or a hand whose
    fingers stand around its palm, points its palm along the z axis of the face M and has the x axis of its palm along
    that of M. A hand whose fingers lie along its palm stands on its wrist: the fingers along z of M, the palm facing
    along x of M.

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
    R_HP = hand.X_HP[:3, :3]
    R_MP = np.eye(3) if hand.is_jaw else _stands(R_HP.T @ _finger_direction(hand))
    X_MH = make_transform_np(R_MP @ R_HP.T, (0.0, 0.0, 0.0))
    is_upright = R_MP[2, 2] > 0.5  # the palm looks out of the face
    points = _palm_points(hand) @ X_MH[:3, :3].T
    if is_upright:
        middle = X_MH[:3, :3] @ hand.X_HP[:3, 3]
    else:
        end = points[points[:, 2] < points[:, 2].min() + _WRIST]
        middle = (end.min(axis=0) + end.max(axis=0)) / 2
    near = np.linalg.norm(points[:, :2] - middle[:2], axis=1) < _FLANGE_RADIUS
    X_MH[:3, 3] = [-middle[0], -middle[1], -points[near if near.any() else slice(None), 2].min()]
    return X_MH


def _stands(fingers_P: np.ndarray) -> np.ndarray:
    """R_MP (3, 3) for a hand whose fingers point along `fingers_P` when it is open."""
    if fingers_P[2] > _AROUND:
        return np.eye(3)
    axis = int(np.argmax(np.abs(fingers_P[:2])))  # a palm's axes are those it was built along
    along = np.eye(3)[axis] * np.sign(fingers_P[axis])
    normal = np.array([0.0, 0.0, 1.0])
    return np.stack([normal, np.cross(along, normal), along])


def _finger_direction(hand: Hand) -> np.ndarray:
    """(3,) unit mean direction of the open fingers, from root to tip, in H."""
    X_HL = forward_numpy(hand.tree, hand.q_open)
    total = np.zeros(3)
    for finger in hand.fingers:
        points = [
            part_mesh(p).transformed(X_HL[p.link]).vertices.mean(axis=0) for p in hand.parts if p.link in finger.links
        ]
        root = X_HL[finger.links[0], :3, 3]
        way = points[-1] - root if points else np.zeros(3)
        total += way / max(float(np.linalg.norm(way)), 1e-9)
    return total / max(float(np.linalg.norm(total)), 1e-9)


def _palm_points(hand: Hand) -> np.ndarray:
    """(V, 3) on the surfaces of what does not move in the hand, in H; of all of it where that has no shape."""
    body = rigid_bodies(hand.tree)
    still = [p for p in hand.parts if body[p.link] == body[0]] or list(hand.parts)
    X_HL = forward_numpy(hand.tree, hand.q_open)
    return np.concatenate([sample_part(p, _DENSITY)[0] @ X_HL[p.link, :3, :3].T + X_HL[p.link, :3, 3] for p in still])
