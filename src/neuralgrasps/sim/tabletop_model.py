"""The MuJoCo model of a robot arm with a hand at a table with objects on it; the world frame is the robot's base B."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol as Structure

import mujoco
import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.errors import InputError
from neuralgrasps.kinematics.tree import PRISMATIC, KinematicTree
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.sim.build import contact_friction, object_mass
from neuralgrasps.sim.protocols import PROTOCOLS, Actuation, Protocol
from neuralgrasps.sim.robot_bodies import (
    Surface,
    add_links,
    add_object,
    add_servos,
    joint_name,
    position_quaternion,
    set_solver,
    set_surface,
    tree_leaders,
)
from neuralgrasps.sim.self_contact import exclude_joined, held_tree

FLOOR = "floor"
_FLOOR_BELOW_TABLE_M = 0.6


class SolidBox(Structure):
    """Any box with a name, a centre frame X_BX (4, 4) and half extents (3,), metres: the planner's `BoxObstacle`."""

    @property
    def name(self) -> str: ...
    @property
    def X_BX(self) -> np.ndarray: ...
    @property
    def half(self) -> np.ndarray: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class TableTopConfig:
    """Every number that decides what happens at the table.

    Attributes:
        grasp: hand servos, weight and friction of objects, softness of contacts: those that grasps are tried with, the
            objects' own weights and frictions ("shake").
        timestep_s: half the trials': the arm's servos are stiffer than a hand's.
        table_friction: sliding (1), torsional (m), rolling (m) of whatever stands on the table, floor or a box. 0.4:
            cardboard and smooth plastic on wood are given as 0.3 to 0.5; less lets an object be pushed away sooner.
            Torsion and rolling are small: a base has several contacts, and a can must be able to roll.
        robot_friction: of links that touch anything but an object: painted metal and plastic.
        arm_stiff, arm_middle, arm_weak: N m/rad of turning joints with an effort of at least `strong_effort`, at least
            `weak_effort`, and less. slide_kp: N/m of a lift. Damping makes each joint's ratio `damping_ratio` for its
            inertia at home.
        arm_armature, slide_armature: reflected inertia of motor and gear: 0.1 kg m^2 is usual for 1:100 gears.
        arm_weight: of the arm's links, as a share of what they would weigh filled with plastic: 0.6 gives arms of 15 kg
            for the Fetch and of 13 kg for the Panda.
        noslip_iterations, solver_iterations, impratio, multiccd: MuJoCo settings.
        gravity: m/s^2 along B's z. Gravity on the robot's own links is compensated, as arm controllers do.
        floor_z_m: height of the floor in B; None: B's origin, or 0.6 m below the table's upper face if that is lower.
    """

    grasp: Protocol = field(default_factory=lambda: PROTOCOLS["shake"])
    timestep_s: float = 0.002
    table_friction: tuple[float, float, float] = (0.4, 0.005, 1e-4)
    robot_friction: tuple[float, float, float] = (0.3, 0.005, 1e-4)
    strong_effort: float = 30.0
    weak_effort: float = 20.0
    arm_stiff: float = 2000.0
    arm_middle: float = 1000.0
    arm_weak: float = 500.0
    slide_kp: float = 40000.0
    damping_ratio: float = 1.0
    arm_armature: float = 0.1
    slide_armature: float = 1.0
    arm_weight: float = 0.6
    noslip_iterations: int = 2
    solver_iterations: int = 30
    impratio: float = 10.0
    multiccd: bool = True
    gravity: float = -9.81
    floor_z_m: float | None = None

    def __post_init__(self) -> None:
        for name in (
            "timestep_s",
            "arm_stiff",
            "arm_middle",
            "arm_weak",
            "slide_kp",
            "damping_ratio",
            "impratio",
            "arm_weight",
        ):
            if not getattr(self, name) > 0:
                raise InputError(f"table top: {name} is {getattr(self, name)}; expected a positive number.")


def tabletop_model(
    manipulator: Manipulator,
    objects: Sequence[ObjectModel],
    boxes: Sequence[SolidBox],
    config: TableTopConfig,
) -> mujoco.MjModel:
    """Compile the model; boxes[0] is the table.

    Names: bodies `link_i`, joints `joint_i` (indices of `manipulator.tree`), actuators `dof_j` in the order of
    `held_tree`, bodies and free joints `object_k`, geoms `box_k` and "floor". Links of the robot touch each other,
    except `joined_links`. The control of an actuator of the arm is its target plus kv / kp times the target's speed.

    Raises:
        InputError: no box. RobotDescriptionError: a joint has no usable effort limit, or none follows it alone.
    """
    if not boxes:
        raise InputError("a table-top simulation needs a table: got no box.")
    tree = held_tree(manipulator)
    spec = mujoco.MjSpec()
    spec.modelname = f"{manipulator.name} at a table"
    set_solver(
        spec,
        timestep_s=config.timestep_s,
        impratio=config.impratio,
        solver_iterations=config.solver_iterations,
        noslip_iterations=config.noslip_iterations,
        multiccd=config.multiccd,
    )
    spec.option.gravity = [0.0, 0.0, config.gravity]
    actuation = _actuations(manipulator, tree, config)
    robot_surface = _surface(config, config.robot_friction, priority=0)
    bodies = add_links(spec, tree, manipulator.parts, actuation, robot_surface, unlimited=_endless(manipulator, tree))
    for link, body in enumerate(bodies):
        body.gravcomp = 1.0
        if link < manipulator.hand_link:
            body.mass, body.inertia = body.mass * config.arm_weight, body.inertia * config.arm_weight
    add_servos(spec, tree, actuation, owner=f"robot '{manipulator.name}'", coupling_time_s=2 * config.grasp.timestep_s)
    exclude_joined(spec, manipulator)
    _add_surroundings(spec, boxes, config)
    for k, obj in enumerate(objects):
        surface = _surface(config, contact_friction(obj, config.grasp), priority=1)
        add_object(spec, obj, f"object_{k}", mass_kg=object_mass(obj, config.grasp), surface=surface)
    model = spec.compile()
    _damp_arm(model, manipulator, tree, config)
    return model


def floor_height(table: SolidBox, config: TableTopConfig) -> float:
    """z of the floor in B, metres."""
    if config.floor_z_m is not None:
        return config.floor_z_m
    return min(0.0, float(table.X_BX[2, 3] + table.half[2]) - _FLOOR_BELOW_TABLE_M)


def _actuations(manipulator: Manipulator, tree: KinematicTree, config: TableTopConfig):  # type: ignore[no-untyped-def]
    """Servo constants by link: those of the hand damp the joint, those of the arm are damped by their motors."""

    def actuation(link: int) -> Actuation:
        slides = tree.joint_types[link] == PRISMATIC
        if link >= manipulator.hand_link:
            return config.grasp.prismatic if slides else config.grasp.revolute
        if slides:
            return Actuation(kp=config.slide_kp, kv=0.0, armature=config.slide_armature)
        effort = float(tree.effort[np.flatnonzero(tree.coupling[link])].max())
        weak = config.arm_middle if effort >= config.weak_effort else config.arm_weak
        kp = config.arm_stiff if effort >= config.strong_effort else weak
        return Actuation(kp=kp, kv=0.0, armature=config.arm_armature)

    return actuation


def _endless(manipulator: Manipulator, tree: KinematicTree) -> frozenset[int]:
    """Links whose joint turns without end."""
    dofs = np.flatnonzero(manipulator.continuous)
    return frozenset(int(link) for link in np.flatnonzero((tree.coupling[:, dofs] != 0).any(axis=1)))


def _surface(config: TableTopConfig, friction: tuple[float, float, float], *, priority: int) -> Surface:
    return Surface(friction=friction, solref=config.grasp.solref, solimp=config.grasp.solimp, priority=priority)


def _add_surroundings(spec: mujoco.MjSpec, boxes: Sequence[SolidBox], config: TableTopConfig) -> None:
    surface = _surface(config, config.table_friction, priority=2)
    floor = spec.worldbody.add_geom(name=FLOOR, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5.0, 5.0, 0.1])
    floor.pos = [0.0, 0.0, floor_height(boxes[0], config)]
    set_surface(floor, surface)
    for k, box in enumerate(boxes):
        geom = spec.worldbody.add_geom(name=f"box_{k}", type=mujoco.mjtGeom.mjGEOM_BOX, size=box.half)
        geom.pos, geom.quat = position_quaternion(np.asarray(box.X_BX))
        set_surface(geom, surface)


def _damp_arm(model: mujoco.MjModel, manipulator: Manipulator, tree: KinematicTree, config: TableTopConfig) -> None:
    """Set the speed gains of the arm's motors: kv = 2 ratio sqrt(kp I), I the joint's inertia at home."""
    data = mujoco.MjData(model)
    q_home = manipulator.q_home[np.concatenate([manipulator.arm_dofs, manipulator.hand_dofs])]
    positions = tree.joint_positions(q_home)
    for link in np.flatnonzero(tree.joint_types):
        data.qpos[model.joint(joint_name(int(link))).qposadr[0]] = positions[link]
    for compute in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_makeM):  # without contacts: all objects are at 0
        compute(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    links, gain, _ = tree_leaders(tree, manipulator.name)
    for j in range(len(manipulator.arm_dofs)):
        v = int(model.joint(joint_name(int(links[j]))).dofadr[0])
        kp = float(model.actuator_gainprm[j, 0])
        model.actuator_biasprm[j, 2] = -2.0 * config.damping_ratio * np.sqrt(kp * inertia[v, v] * gain[j] ** 2)
