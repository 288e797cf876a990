"""What a plan was made from, and the opening of its gripper: the facts that stand beside the steps in a plan's file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import neuralgrasps
from neuralgrasps.errors import InputError
from neuralgrasps.export.frames import check_pose, pose_fields, xyz
from neuralgrasps.export.messages import Message
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.hands.hand import Hand
from neuralgrasps.kinematics.tree import PRISMATIC


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanOrigin:
    """Where a plan comes from; what is not known is None.

    Attributes:
        X_BO: (4, 4) the object in the robot base that was planned with, metres.
        confidence: of that pose, 0 to 1. table_B: top of the table in the robot base, normal up. seed: of the planner.
    """

    X_BO: np.ndarray | None = None
    confidence: float | None = None
    table_B: Plane | None = None
    seed: int | None = None

    def fields(self) -> Message:
        """As a plan's file has it: `object_pose` like `geometry_msgs/Pose`; the table's height is that under the
        object, or under the base where the object's pose is not known.

        Raises:
            ShapeError, InputError: `X_BO` is not a rigid transform, or the table stands upright.
        """
        X_BO = None if self.X_BO is None else check_pose(self.X_BO, "X_BO")
        return {
            "library": f"neuralgrasps {neuralgrasps.__version__}",
            "seed": None if self.seed is None else int(self.seed),
            "object_pose": None if X_BO is None else pose_fields(X_BO),
            "confidence": None if self.confidence is None else float(self.confidence),
            "table": None if self.table_B is None else _table(self.table_B, X_BO),
        }


def _table(plane: Plane, X_BO: np.ndarray | None) -> Message:
    normal = np.asarray(plane.normal, np.float64)
    if normal[2] < 0.1:
        raise InputError(f"the table's normal in the robot base is {normal.tolist()}; expected one that points up.")
    at = np.zeros(2) if X_BO is None else X_BO[:2, 3]
    height_m = 0.0 - float((plane.offset_m + normal[:2] @ at) / normal[2])  # 0, not -0
    return {"normal": xyz(normal), "height_m": height_m}


def gripper_opening(hand: Hand, q: np.ndarray) -> float | None:
    """Metres between the pads of a jaw at `q` (J,), clamped to its limits; 0 where it is closed as far as it goes.

    Both fingers count: twice the travel of one where both move. None for hands that are no jaw that slides.

    Raises:
        ShapeError: another number of joints.
    """
    hand.check_q(np.asarray(q))
    tree = hand.tree
    slide = np.flatnonzero((tree.coupling != 0).any(axis=1))
    if not hand.is_jaw or (tree.joint_types[slide] != PRISMATIC).any():
        return None
    closed = np.where(hand.closing_rate > 0, tree.upper, tree.lower)
    travel = np.clip(np.asarray(q, np.float64), tree.lower, tree.upper) - closed
    return float(np.abs(tree.coupling[slide] @ travel).sum())
