"""How a hand comes to a grasp: in open, on a smooth path clear of the object and the table, then closing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix
from neuralgrasps.hands.extent import lowest_height
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import pose_links
from neuralgrasps.human.forearm import ForearmSize, WristAxes, is_clear
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.synthesis.clusters import hand_clearance
from neuralgrasps.synthesis.prepared import prepare_hand

_SPACING_M = 0.004
_DEEPEST_M = 1.0e-3  # that an open hand on its way may overlap the object at points 4 mm apart; the grasp has 0.5 mm
_ABOVE_TABLE_M = 0.002
_COMING, _CLOSING = 20, 8  # places of the path that are looked at
_STRAIGHT_M = 0.09  # of the way back before it bends
_BLENDS_M = (0.03, 0.0, 0.06)  # of the way that the hand closes on
_OPENINGS = (1.0, 0.7, 0.45, 0.3)
_WIDE = {"mcp": 0.05, "pip": 0.22, "dip": 0.15}  # joints of an open hand's fingers, rad


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HandPath:
    """A way to a grasp, of two parameters: how far the hand still is, 1 to 0, and how far it is closed, 0 to 1.

    Attributes:
        X_WH: (4, 4) the grasp; q: (J,) its joints; q_open: (J,) the hand on its way.
        bend_W: (4, 3) control points of the way's curve from the grasp outwards, the first 0, metres.
        turn_H: (3,) axis of the turn of the far hand about its wrist; turn_rad: by how much.
        blend: how far away the hand is when it begins to close.
    """

    X_WH: np.ndarray
    q: np.ndarray
    q_open: np.ndarray
    bend_W: np.ndarray
    turn_H: np.ndarray
    turn_rad: float
    blend: float

    def poses(self, away: np.ndarray) -> np.ndarray:
        """(T, 4, 4) hands that are `away` (T,)."""
        u = np.asarray(away)[:, None]
        p = self.bend_W
        X = np.tile(self.X_WH, (len(u), 1, 1))
        X[:, :3, 3] += 3 * (1 - u) ** 2 * u * p[1] + 3 * (1 - u) * u**2 * p[2] + u**3 * p[3]
        angle = self.turn_rad * (np.maximum(u[:, 0] - 0.25, 0.0) / 0.75) ** 2
        X[:, :3, :3] = self.X_WH[:3, :3] @ axis_angle_matrix(self.turn_H, angle)
        return X

    def joints(self, closed: np.ndarray) -> np.ndarray:
        """(T, J) joints of hands that are `closed` (T,)."""
        return self.q_open + np.asarray(closed)[:, None] * (self.q - self.q_open)


def find_path(
    hand: Hand,
    obj: ObjectModel,
    X_WO: np.ndarray,
    X_WH: np.ndarray,
    q: np.ndarray,
    forearm_H: np.ndarray,
    *,
    scale: float,
    rng: np.random.Generator,
) -> HandPath | None:
    """A path of the hand to a grasp; None where every one tried would meet the object or the table.

    Args:
        hand: a human hand of this `scale`.
        X_WO: (4, 4) the object; W with the table at z = 0, up.
        X_WH: (4, 4) the hand at the grasp; q: (J,) its joints; forearm_H: (3,) direction to the elbow.
        rng: draws where the hand comes from and the order in which ways are tried.
    """  # fmt: skip
    wide = _wide_posture(hand, q)
    turn_H = rng.standard_normal(3)
    turn_H /= np.linalg.norm(turn_H)
    turn_rad = np.radians(rng.uniform(5.0, 22.0))
    for bend_W in _ways(hand, X_WH, forearm_H, rng):
        for opening in _OPENINGS:
            for blend_m in _BLENDS_M:
                path = HandPath(
                    X_WH=X_WH, q=q, q_open=q + opening * (wide - q), bend_W=bend_W, turn_H=turn_H, turn_rad=turn_rad,
                    blend=blend_m / (3.0 * float(np.linalg.norm(bend_W[1]))),
                )  # fmt: skip
                if _clear(path, hand, obj, X_WO, forearm_H, scale):
                    return path
    return None


def _ways(hand: Hand, X_WH: np.ndarray, forearm_H: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
    """Curves (4, 3) from a grasp outwards: back along the palm's normal, upwards, or along the arm."""
    axes, up = WristAxes.of(hand), np.array([0.0, 0.0, 1.0])
    back, arm = X_WH[:3, :3] @ axes.back, X_WH[:3, :3] @ forearm_H
    level = arm - arm[2] * up
    far = 0.30 * _unit(level + 0.35 * back) + up * rng.uniform(0.08, 0.22) + 0.05 * rng.standard_normal(3)
    first = [back, _unit(back + 0.6 * up), _unit(back + 0.6 * arm), _unit(up + 0.3 * back), _unit(arm + 0.3 * up), arm]
    ways = []
    for direction in first:
        start = _STRAIGHT_M / 1.5 * direction
        ways.append(np.stack([np.zeros(3), start, 2.2 * start + 0.35 * far + 0.02 * up, far + start]))
    return ways


def _wide_posture(hand: Hand, q: np.ndarray) -> np.ndarray:
    """The open hand for a grasp: fingers nearly straight and the thumb away, spread and turned as in the grasp."""
    wide = q.copy()
    for dof, name in enumerate(hand.tree.dof_names):
        finger, _, joint = name.partition("_")
        if finger == "thumb":
            if joint != "rotation":
                wide[dof] = min(q[dof], 0.6 * hand.q_open[dof] + 0.4 * q[dof])
        elif joint in _WIDE:
            wide[dof] = min(q[dof], _WIDE[joint])
    return wide


def _clear(path: HandPath, hand: Hand, obj: ObjectModel, X_WO: np.ndarray, forearm_H: np.ndarray, scale: float) -> bool:
    away = np.concatenate([np.linspace(1.0, path.blend, _COMING), np.linspace(path.blend, 0.0, _CLOSING)])
    closed = np.concatenate([np.zeros(_COMING), np.linspace(0.0, 1.0, _CLOSING)])
    X_WH, q = path.poses(away), path.joints(closed)
    level = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
    if (lowest_height(hand, X_WH, q, level) < _ABOVE_TABLE_M).any():
        return False
    tools = prepare_hand(hand, spacing=_SPACING_M)
    sdf = obj.sdf
    X_OH = np.ascontiguousarray(np.linalg.inv(X_WO) @ X_WH)
    gap = np.empty(len(q))
    _clearances(sdf.values, sdf.origin, sdf.inv_spacing, tools.packed, tools.clusters, X_OH, q, gap)
    if (gap < -_DEEPEST_M).any():
        return False
    points_W = obj.points_O @ X_WO[:3, :3].T + X_WO[:3, 3]
    size = ForearmSize.of(scale)
    return all(is_clear(X[:3, 3], X[:3, :3] @ forearm_H, points_W, size) for X in X_WH[:_COMING:3])


@njit(cache=True, error_model="numpy")
def _clearances(values, origin, inv_spacing, packed, clusters, X_OH, q, out):  # type: ignore[no-untyped-def]
    X_HL = np.zeros((packed.link_radius.shape[0], 4, 4))
    for i in range(q.shape[0]):
        pose_links(packed, q[i], X_HL)
        out[i] = hand_clearance(values, origin, inv_spacing, packed, clusters, X_OH[i], X_HL)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)
