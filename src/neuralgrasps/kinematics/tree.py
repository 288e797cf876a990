"""The kinematic tree that every hand and arm is reduced to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import RobotDescriptionError

FIXED, REVOLUTE, PRISMATIC = 0, 1, 2


@dataclass(frozen=True, slots=True, kw_only=True)
class KinematicTree:
    """Links joined by fixed, revolute or prismatic joints; parents come before children.

    Link i hangs on `parents[i]` by joint i. Its pose in the parent is
    `X_parent_joint[i] @ motion(axes[i], p[i])` with joint positions `p = coupling @ q + offset`.
    `q` holds the J independent joints; rigidly coupled (mimic) joints are rows of `coupling`.

    Attributes:
        link_names: L names; link 0 is the base.
        parents: (L,) int32, -1 for the base, `parents[i] < i`.
        joint_names: L names, the joint that moves link i ("" for the base).
        joint_types: (L,) int8: FIXED, REVOLUTE or PRISMATIC.
        X_parent_joint: (L, 4, 4) float64, joint frame in the parent link at zero position, metres.
        axes: (L, 3) float64 unit joint axes in the joint frame (zeros for fixed joints).
        coupling: (L, J) float64; offset: (L,) float64: joint positions from `q`, rad or metres.
        dof_names: J names of the independent joints.
        lower, upper: (J,) float64 limits of `q`, rad or metres.
        effort: (J,) float64, largest torque (N m) or force (N) per independent joint.
    """

    link_names: tuple[str, ...]
    parents: np.ndarray
    joint_names: tuple[str, ...]
    joint_types: np.ndarray
    X_parent_joint: np.ndarray
    axes: np.ndarray
    coupling: np.ndarray
    offset: np.ndarray
    dof_names: tuple[str, ...]
    lower: np.ndarray
    upper: np.ndarray
    effort: np.ndarray

    def __post_init__(self) -> None:
        links, dofs = self.num_links, self.num_dofs
        expected = {
            "parents": (links,),
            "joint_types": (links,),
            "X_parent_joint": (links, 4, 4),
            "axes": (links, 3),
            "coupling": (links, dofs),
            "offset": (links,),
            "lower": (dofs,),
            "upper": (dofs,),
            "effort": (dofs,),
        }
        for field, shape in expected.items():
            got = getattr(self, field).shape
            if got != shape:
                raise RobotDescriptionError(f"kinematic tree: {field} has shape {got}; expected {shape}.")
        if len(self.joint_names) != links:
            raise RobotDescriptionError(f"kinematic tree: {len(self.joint_names)} joint names for {links} links.")
        if self.parents[0] != -1 or any(not 0 <= p < i for i, p in enumerate(self.parents) if i):
            raise RobotDescriptionError("kinematic tree: parents must come before children and only link 0 has none.")
        bad = [n for n, lo, hi in zip(self.dof_names, self.lower, self.upper, strict=True) if not lo < hi]
        if bad:
            raise RobotDescriptionError(f"kinematic tree: lower limit not below upper limit for joints {bad}.")

    @property
    def num_links(self) -> int:
        return len(self.link_names)

    @property
    def num_dofs(self) -> int:
        return len(self.dof_names)

    def joint_positions(self, q: np.ndarray) -> np.ndarray:
        """Positions of all L joints (rad or metres) for independent joints `q` (..., J)."""
        return q @ self.coupling.T + self.offset
