"""What a robot file says, after mending: a kinematic tree, link geometry and masses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from neuralgrasps.errors import RobotDescriptionError
from neuralgrasps.kinematics.tree import KinematicTree

if TYPE_CHECKING:
    from neuralgrasps.geometry.mesh import Mesh

GeometryKind = Literal["box", "sphere", "capsule", "cylinder", "mesh"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinkGeometry:
    """One shape fixed to a link.

    Attributes:
        link: index of the link in the tree.
        kind: shape. Sizes follow MuJoCo: half lengths, z is the long axis.
        size: (3,) float64 metres: box half extents; sphere (radius, 0, 0); capsule (radius, half
            length of the segment, 0); cylinder (radius, half height, 0); mesh zeros.
        X_LG: (4, 4) float64, shape frame in the link frame.
        mesh: vertices in the shape frame G, metres, scale applied (only for "mesh").
        is_visual: True for shapes that are only drawn, False for collision shapes.
        colour: red, green, blue, alpha in [0, 1], or None when the file gives none.
    """

    link: int
    kind: GeometryKind
    size: np.ndarray
    X_LG: np.ndarray
    mesh: Mesh | None = None
    is_visual: bool = False
    colour: tuple[float, float, float, float] | None = None

    def __post_init__(self) -> None:
        if self.kind not in get_args(GeometryKind):
            raise RobotDescriptionError(f"geometry kind is '{self.kind}'; expected one of {get_args(GeometryKind)}.")
        if (self.kind == "mesh") != (self.mesh is not None):
            raise RobotDescriptionError(f"geometry of kind '{self.kind}': exactly the kind 'mesh' carries a mesh.")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinkInertial:
    """Mass of a link, kg (> 0), and its centre of mass (3,) in the link frame, metres."""

    mass: float
    com_L: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True)
class JointDrive:
    """What a file says on a joint that a hand does not need and an arm does; None where it says nothing.

    Attributes:
        lower, upper: limits as they are written, rad or metres; unlike the tree's, not mended.
        velocity: largest speed, rad/s or m/s; effort: largest torque or force, N m or N.
        continuous: the joint turns without end.
    """

    lower: float | None = None
    upper: float | None = None
    velocity: float | None = None
    effort: float | None = None
    continuous: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobotDescription:
    """A robot file reduced to what the library uses.

    Attributes:
        name: the robot's name in the file.
        tree: kinematic tree; link 0 is the root link of the file, at the identity.
        geometries: shapes of all links, collision and visual.
        inertials: one per link; None where the file gives no usable mass.
        repairs: plain sentences on everything that was mended, dropped or assumed while reading.
        source: the file.
        drives: by name of joint.
    """

    name: str
    tree: KinematicTree
    geometries: tuple[LinkGeometry, ...]
    inertials: tuple[LinkInertial | None, ...]
    repairs: tuple[str, ...]
    source: Path
    drives: Mapping[str, JointDrive] = field(default_factory=dict)

    def __post_init__(self) -> None:
        links = self.tree.num_links
        if len(self.inertials) != links:
            raise RobotDescriptionError(f"robot '{self.name}': {len(self.inertials)} inertials for {links} links.")
        wrong = sorted({g.link for g in self.geometries if not 0 <= g.link < links})
        if wrong:
            raise RobotDescriptionError(f"robot '{self.name}': geometry on links {wrong}, but there are {links} links.")

    def collision_of(self, link: int) -> tuple[LinkGeometry, ...]:
        """Collision shapes of one link."""
        return tuple(g for g in self.geometries if g.link == link and not g.is_visual)

    def visual_of(self, link: int) -> tuple[LinkGeometry, ...]:
        """Visual shapes of one link."""
        return tuple(g for g in self.geometries if g.link == link and g.is_visual)
