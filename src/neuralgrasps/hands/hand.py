"""The `Hand` noun: everything the library knows about one robot or human hand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from neuralgrasps.errors import RobotDescriptionError, ShapeError
from neuralgrasps.kinematics.tree import KinematicTree


class PartKind(IntEnum):
    """Convex shapes a link is made of. Sizes follow MuJoCo: half lengths, z is the long axis."""

    BOX = 0  # size = half extents x, y, z
    SPHERE = 1  # size = radius, 0, 0
    CAPSULE = 2  # size = radius, half length of the segment, 0
    CYLINDER = 3  # size = radius, half height, 0
    HULL = 4  # size unused; the part is the convex hull of `vertices`


@dataclass(frozen=True, slots=True, kw_only=True)
class ConvexPart:
    """One convex solid fixed to a link.

    Attributes:
        link: index of the link in the tree.
        kind: shape; `size`: (3,) float64 metres, meaning by kind.
        X_LP: (4, 4) float64, part frame in the link frame.
        vertices: (V, 3) float64 hull vertices in the *part* frame (only for HULL; (0, 3) otherwise).
        faces: (F, 3) int32 outward triangles of the hull (only for HULL; (0, 3) otherwise).
        colour: red, green, blue, alpha in [0, 1] for drawing, or None where the file gives none.
    """

    link: int
    kind: PartKind
    size: np.ndarray
    X_LP: np.ndarray
    vertices: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    faces: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), np.int32))
    colour: tuple[float, float, float, float] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Finger:
    """One chain from the palm to a fingertip.

    Attributes:
        name: "index", "finger_1", ...
        links: indices of its links, proximal first.
        dofs: indices into `q` of the joints that move only this finger, proximal first.
        is_thumb: True for the finger that opposes the others.
    """

    name: str
    links: tuple[int, ...]
    dofs: tuple[int, ...]
    is_thumb: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Hand:
    """A hand: kinematics, convex geometry, and the annotation that grasp synthesis needs.

    Frames: H is the base link. The palm frame P has its origin on the palm surface at the
    middle of the grasping area, z out of the palm (towards the object), x along the direction in which the
    fingers close (for a jaw: the line between the pads).

    Attributes:
        name: unique name.
        tree: kinematic tree; `q` (J,) are its independent joints.
        parts: convex solids; the only geometry used for synthesis, physics and distances.
        fingers: finger chains.
        X_HP: (4, 4) palm frame in the hand base.
        closing_rate: (J,) rad/s or m/s at unit closing speed, signed; 0 = joint not used to close.
        q_open: (J,) open posture; `preshape_lower`, `preshape_upper`: (J,) range of start postures for closing.
        preshape_groups: dofs that share one random number when a preshape is drawn.
        is_jaw: True for parallel jaws: two pads that close along one line.
        jaw_pad_H: (3,) middle between the two pads in H, metres (jaws only; else the palm origin).
        licence, provenance: where the model comes from.
    """

    name: str
    tree: KinematicTree
    parts: tuple[ConvexPart, ...]
    fingers: tuple[Finger, ...]
    X_HP: np.ndarray
    closing_rate: np.ndarray
    q_open: np.ndarray
    preshape_lower: np.ndarray
    preshape_upper: np.ndarray
    preshape_groups: tuple[tuple[int, ...], ...]
    is_jaw: bool
    jaw_pad_H: np.ndarray
    licence: str
    provenance: str
    extra: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("closing_rate", "q_open", "preshape_lower", "preshape_upper"):
            got = getattr(self, name).shape
            if got != (self.num_dofs,):
                raise RobotDescriptionError(f"hand '{self.name}': {name} has shape {got}; expected ({self.num_dofs},).")
        if not self.parts:
            raise RobotDescriptionError(
                f"hand '{self.name}' has no collision geometry; add at least one shape per link."
            )
        grouped = sorted(d for group in self.preshape_groups for d in group)
        if grouped != list(range(self.num_dofs)):
            raise RobotDescriptionError(
                f"hand '{self.name}': preshape_groups must hold each of the {self.num_dofs} joints once; got {grouped}."
            )

    def __repr__(self) -> str:
        joints = "1 joint" if self.num_dofs == 1 else f"{self.num_dofs} joints"
        fingers = "1 finger" if len(self.fingers) == 1 else f"{len(self.fingers)} fingers"
        kind = "parallel jaw" if self.is_jaw else fingers
        return f"Hand({self.name}: {joints}, {kind}, {len(self.parts)} convex parts)"

    @property
    def num_dofs(self) -> int:
        return self.tree.num_dofs

    def check_q(self, q: np.ndarray) -> None:
        """Raise `ShapeError` unless the last axis of `q` is this hand's number of joints."""
        if q.ndim == 0 or q.shape[-1] != self.num_dofs:
            columns = q.shape[-1] if q.ndim else 0
            names = ", ".join(self.tree.dof_names)
            raise ShapeError(f"q has {columns} columns but hand '{self.name}' has {self.num_dofs} joints ({names}).")
