"""The `Arm` noun: a robot arm without its hand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from neuralgrasps.errors import RobotDescriptionError
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.hands.hand import ConvexPart
from neuralgrasps.kinematics.tree import KinematicTree


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmCamera:
    """A camera that the robot carries, or that stands beside it.

    Attributes:
        link: index of the link it is fixed to; 0 = the base.
        X_LC: (4, 4) camera (OpenCV: x right, y down, z forward) in that link.
        intrinsics: its image.
    """

    link: int
    X_LC: np.ndarray
    intrinsics: Intrinsics


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Arm:
    """A robot arm, on its base, up to the flange that a hand is mounted on.

    Frames: B the base (link 0; z up, x towards the work), F the flange link, M the mounting face on it (origin on the
    face, z out of it, as "tool0" of ISO 9787).

    Attributes:
        name: unique name.
        tree: all joints, also those that are not planned (a head's); `q` (Q,) are its independent joints.
        parts: convex solids of the links; the only geometry for planning and physics.
        flange: index of the flange link; X_FM: (4, 4) mounting face in it.
        joints: (D,) indices into `q` of the joints that are planned, base first; the others stay at `q_home`.
        continuous: (Q,) bool, joints that turn without end; their limits are -2 pi and 2 pi.
        q_home: (Q,) posture to start from: nothing touches, the camera sees the table.
        velocity, acceleration: (Q,) limits, rad/s or m/s and per second.
        camera: the camera that looks at the table, or None.
        table_height_m: of a table that suits the arm, above B.
        licence, provenance: where the model comes from. extra: "repairs", one sentence a line.
    """

    name: str
    tree: KinematicTree
    parts: tuple[ConvexPart, ...]
    flange: int
    X_FM: np.ndarray
    joints: np.ndarray
    continuous: np.ndarray
    q_home: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    camera: ArmCamera | None
    table_height_m: float
    licence: str
    provenance: str
    extra: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        count = self.tree.num_dofs
        for name in ("continuous", "q_home", "velocity", "acceleration"):
            if getattr(self, name).shape != (count,):
                raise RobotDescriptionError(
                    f"arm '{self.name}': {name} has shape {getattr(self, name).shape}; expected ({count},)."
                )
        for name in ("velocity", "acceleration"):
            bad = [n for n, v in zip(self.tree.dof_names, getattr(self, name), strict=True) if not 0 < v < np.inf]
            if bad:
                raise RobotDescriptionError(
                    f"arm '{self.name}': joints {bad} have no usable {name} limit; expected a positive number."
                )
        outside = (self.q_home < self.tree.lower - 1e-9) | (self.q_home > self.tree.upper + 1e-9)
        if outside.any():
            names = [self.tree.dof_names[j] for j in np.flatnonzero(outside)]
            raise RobotDescriptionError(f"arm '{self.name}': q_home is outside the limits of {names}.")
        if not 0 <= self.flange < self.tree.num_links:
            raise RobotDescriptionError(f"arm '{self.name}': no link {self.flange}; expected the flange's index.")

    def __repr__(self) -> str:
        return f"Arm({self.name}: {len(self.joints)} planned joints of {self.tree.num_dofs}, {len(self.parts)} parts)"
