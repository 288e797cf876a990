"""The MuJoCo model of one hand holding one object.

The hand base is welded to the world at the origin and the object is a free body, so that the world frame is H and a
grasp is only a start pose of the object, X_HO = inverse(X_OH): one compiled model serves every grasp of the pair.
"""

from __future__ import annotations

import mujoco
import numpy as np

from neuralgrasps.hands.hand import Hand
from neuralgrasps.kinematics.tree import PRISMATIC
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.sim.protocols import Actuation, Protocol
from neuralgrasps.sim.robot_bodies import (
    CONTACT_DIMENSIONS,
    Surface,
    add_links,
    add_object,
    add_servos,
    joint_name,
    set_solver,
    tree_leaders,
)

__all__ = [
    "CONTACT_DIMENSIONS",
    "OBJECT_BODY",
    "OBJECT_JOINT",
    "contact_friction",
    "grasp_model",
    "joint_name",
    "leaders",
    "object_mass",
]

OBJECT_BODY = "object"
OBJECT_JOINT = "object"

_HAND_BIT, _OBJECT_BIT = 1, 2


def grasp_model(hand: Hand, obj: ObjectModel, protocol: Protocol) -> mujoco.MjModel:
    """Compile the model in which every grasp of `obj` by `hand` is tried.

    Actuator j is a position servo on independent joint j; its control is the target of `q[j]` (see `leaders`).
    Hand parts never touch each other (synthesis checks self-collision, at points 4 mm apart); coupled joints follow by
    equality constraints. Forces on the object are the caller's, through `xfrc_applied`.

    Raises:
        RobotDescriptionError: a joint has no usable effort limit, or no joint follows it alone.
    """

    def actuation(link: int) -> Actuation:
        return protocol.prismatic if hand.tree.joint_types[link] == PRISMATIC else protocol.revolute

    spec = mujoco.MjSpec()
    spec.modelname = f"{hand.name} holding {obj.name}"
    set_solver(
        spec,
        timestep_s=protocol.timestep_s,
        impratio=protocol.impratio,
        solver_iterations=protocol.solver_iterations,
        noslip_iterations=protocol.noslip_iterations,
        multiccd=protocol.multiccd,
    )
    # the object's friction is the larger one, and decides
    add_links(spec, hand.tree, hand.parts, actuation, _surface(protocol, (0.0, 0.0, 0.0), _HAND_BIT, _OBJECT_BIT))
    add_servos(spec, hand.tree, actuation, owner=f"hand '{hand.name}'", coupling_time_s=2 * protocol.timestep_s)
    surface = _surface(protocol, contact_friction(obj, protocol), _OBJECT_BIT, _HAND_BIT)
    add_object(spec, obj, OBJECT_BODY, mass_kg=object_mass(obj, protocol), surface=surface)
    return spec.compile()


def leaders(hand: Hand) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The joint that each independent joint of a hand drives directly, and how: `tree_leaders` of its tree."""
    return tree_leaders(hand.tree, f"hand '{hand.name}'")


def object_mass(obj: ObjectModel, protocol: Protocol) -> float:
    """Mass in the trial, kg."""
    return float(obj.mass_kg if protocol.object_mass_kg is None else protocol.object_mass_kg)


def contact_friction(obj: ObjectModel, protocol: Protocol) -> tuple[float, float, float]:
    """Sliding (1), torsional (m) and rolling (m) friction of every hand-object contact in the trial."""
    sliding = obj.friction if protocol.friction is None else protocol.friction
    scale = protocol.friction_scale
    return float(sliding * scale), protocol.torsional_friction * scale, protocol.rolling_friction * scale


def _surface(protocol: Protocol, friction: tuple[float, float, float], contype: int, conaffinity: int) -> Surface:
    return Surface(
        friction=friction,
        solref=protocol.solref,
        solimp=protocol.solimp,
        contype=contype,
        conaffinity=conaffinity,
    )
