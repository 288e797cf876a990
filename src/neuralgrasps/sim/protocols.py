"""Physics protocols: what is simulated before a grasp is called successful, with every number that decides it.

A success rate means nothing without the mass, the friction and the torque limits beside it, so each of them
is a field here and is copied into `Verdict.parameters`. This file needs no simulator.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from neuralgrasps.errors import InputError, unknown_name


@dataclass(frozen=True, slots=True, kw_only=True)
class Actuation:
    """Position servo of one kind of joint: torque = kp (target - q) clipped to the joint's effort, minus damping.

    Units are N m/rad, N m s/rad and kg m^2 for revolute joints; N/m, N s/m and kg for prismatic ones.
    `kv` near 2 sqrt(kp armature) damps the free joint critically, so the ramps do not overshoot.
    """

    kp: float
    kv: float
    armature: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Protocol:
    """How one grasp is tried: pre-grasp, grasp, squeeze, then forces on the object along its own +-x, +-y, +-z.

    The hand base is fixed and gravity is off, so the object floats until the hand holds it.

    Attributes:
        name: name of the preset, or any.
        object_mass_kg: mass given to every object; None takes the object's own.
        friction: Coulomb coefficient of hand against object; None takes the object's own.
        friction_scale: multiplies the Coulomb, torsional and rolling friction.
        torsional_friction, rolling_friction: metres (torque per normal force). Torsion stands for the size of a soft
            pad's contact patch; two-finger grasps live on it, so state it with the result.
        force_per_mass: force on the object divided by its mass, m/s^2.
        drive_s: time of each of the two ramps (pre-grasp to grasp, grasp to squeeze).
        hold_s: time each of the six forces acts.
        from_reset: each force starts from the squeezed state; False goes on from where the last one ended.
        max_displacement_m, max_rotation_rad: largest motion of the object's centre of mass and orientation since the
            start; exceeding either at any check fails the grasp at once.
        max_start_penetration_m: deepest overlap of hand and object allowed at the pre-grasp.
        check_every: steps between checks.
        settled_speed: a force counts as withstood once every joint and the object have been slower than this (m/s and
            rad/s) at 8 checks in a row; 0 holds for the whole `hold_s`, as the benchmark asks.
        revolute, prismatic: servos.
        timestep_s, noslip_iterations, solref, solimp, impratio, solver_iterations, multiccd: MuJoCo settings.
    """

    name: str
    object_mass_kg: float | None = 0.1
    friction: float | None = 0.6
    friction_scale: float = 1.0
    torsional_friction: float = 0.02
    rolling_friction: float = 1e-4
    force_per_mass: float = 10.0
    drive_s: float = 0.4
    hold_s: float = 2.0
    from_reset: bool = True
    max_displacement_m: float = 0.05
    max_rotation_rad: float = math.radians(15.0)
    max_start_penetration_m: float = 0.01
    check_every: int = 10
    settled_speed: float = 0.0
    revolute: Actuation = field(default_factory=lambda: Actuation(kp=20.0, kv=0.4, armature=0.002))
    prismatic: Actuation = field(default_factory=lambda: Actuation(kp=3000.0, kv=50.0, armature=0.2))
    timestep_s: float = 0.004
    noslip_iterations: int = 2
    solref: tuple[float, float] = (0.005, 1.0)
    solimp: tuple[float, float, float] = (0.5, 0.99, 1e-4)
    impratio: float = 10.0
    solver_iterations: int = 20
    multiccd: bool = True

    def __post_init__(self) -> None:
        positive = (
            "timestep_s",
            "drive_s",
            "hold_s",
            "max_displacement_m",
            "max_rotation_rad",
            "check_every",
            "impratio",
        )
        for name in positive:
            if not getattr(self, name) > 0:
                raise InputError(
                    f"protocol '{self.name}': {name} is {getattr(self, name)}; expected a positive number."
                )
        for name in (
            "friction",
            "friction_scale",
            "torsional_friction",
            "rolling_friction",
            "force_per_mass",
            "settled_speed",
        ):
            value = getattr(self, name)
            if value is not None and not value >= 0:
                raise InputError(f"protocol '{self.name}': {name} is {value}; expected 0 or more.")
        if self.object_mass_kg is not None and not self.object_mass_kg > 0:
            raise InputError(f"protocol '{self.name}': object_mass_kg is {self.object_mass_kg}; expected more than 0.")


# DexGraspBench's trial. Where this differs from its code: servos are alike for all hands (its Allegro: kp 5, damping
# 0.1), so a squeeze target made for one is not a squeeze for the other; the hand's links do not touch each other (there
# they do, and 10 mm of self-overlap rejects); `solref` and `solimp` hold for both geoms of a contact (there for the
# hand's); displacement is that of the centre of mass (there of the body's frame).
_DEXGRASPBENCH = Protocol(name="dexgraspbench")

PROTOCOLS: Mapping[str, Protocol] = MappingProxyType(
    {
        # The accepted benchmark: 0.1 kg, friction 0.6, 1 g in six directions for 2 s.
        "dexgraspbench": _DEXGRASPBENCH,
        "dexgraspbench-hard": replace(_DEXGRASPBENCH, name="dexgraspbench-hard", friction_scale=0.5),
        # The same, each force ended once nothing moves: 2 to 5 times cheaper; of 1542 grasps it passes, 2 fail in full.
        "dexgraspbench-quick": replace(_DEXGRASPBENCH, name="dexgraspbench-quick", settled_speed=0.01),
        # The object's own weight and friction, six directions of 1 s without letting go in between, 2 cm.
        "shake": replace(
            _DEXGRASPBENCH,
            name="shake",
            object_mass_kg=None,
            friction=None,
            force_per_mass=9.81,
            hold_s=1.0,
            from_reset=False,
            max_displacement_m=0.02,
        ),
    }
)


def get_protocol(protocol: str | Protocol) -> Protocol:
    """The preset of this name, or the protocol itself.

    Raises:
        UnknownNameError: no preset has this name.
    """
    if isinstance(protocol, Protocol):
        return protocol
    if protocol not in PROTOCOLS:
        raise unknown_name("protocol", protocol, PROTOCOLS)
    return PROTOCOLS[protocol]
