"""Pieces of MuJoCo models: the links, servos and couplings of a robot, and free objects.

What is written here once serves the hand that tries grasps and the arm at a table.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from neuralgrasps.errors import RobotDescriptionError
from neuralgrasps.hands.hand import ConvexPart, PartKind
from neuralgrasps.kinematics.tree import FIXED, PRISMATIC, KinematicTree
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.sim.inertia import part_bounds, part_volume, solid_inertia
from neuralgrasps.sim.protocols import Actuation

CONTACT_DIMENSIONS = 4  # normal force, two of sliding friction, torsion: MuJoCo's condim

_LINK_DENSITY = 1000.0  # kg/m^3; without gravity on links, and with motors' armature on top, it hardly matters
_MIN_LINK_MASS = 1e-3
_MIN_LINK_INERTIA = 1e-7
_GEOM_TYPES = {
    PartKind.BOX: mujoco.mjtGeom.mjGEOM_BOX,
    PartKind.SPHERE: mujoco.mjtGeom.mjGEOM_SPHERE,
    PartKind.CAPSULE: mujoco.mjtGeom.mjGEOM_CAPSULE,
    PartKind.CYLINDER: mujoco.mjtGeom.mjGEOM_CYLINDER,
    PartKind.HULL: mujoco.mjtGeom.mjGEOM_MESH,
}

ActuationOf = Callable[[int], Actuation]
"""Servo constants of the joint that moves a link of this index."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """How a geom meets others.

    Attributes:
        friction: sliding (1), torsional (m), rolling (m); the larger value of two geoms of equal priority counts.
        solref, solimp: MuJoCo's contact softness.
        contype, conaffinity: which geoms it meets: bit masks, as in MuJoCo.
        priority: of two geoms, the one with the higher priority decides friction and softness.
        dimensions: MuJoCo's condim.
    """

    friction: tuple[float, float, float]
    solref: tuple[float, float]
    solimp: tuple[float, float, float]
    contype: int = 1
    conaffinity: int = 1
    priority: int = 0
    dimensions: int = CONTACT_DIMENSIONS


def joint_name(link: int) -> str:
    """Name in the MuJoCo model of the joint that moves `link`."""
    return f"joint_{link}"


def body_name(link: int) -> str:
    """Name in the MuJoCo model of the body of `link`."""
    return f"link_{link}"


def set_solver(
    spec: mujoco.MjSpec,
    *,
    timestep_s: float,
    impratio: float,
    solver_iterations: int,
    noslip_iterations: int,
    multiccd: bool,
) -> None:
    """Elliptic cones and a dense Newton solver; no gravity yet; a diverged state stays diverged."""
    option = spec.option
    option.timestep = timestep_s
    option.gravity = np.zeros(3)
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = impratio
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    # MuJoCo 4.0.0 factors the sparse Newton Hessian wrongly (fixed in 4.0.1); these models are small and dense anyway.
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    option.iterations = solver_iterations
    option.noslip_iterations = noslip_iterations
    # A diverged state must stay diverged: auto-reset would put the object back and could pass as a success.
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    if not multiccd:
        option.disableflags |= mujoco.mjtDisableBit.mjDSBL_MULTICCD
    spec.compiler.inertiafromgeom = 0
    spec.compiler.degree = False


def tree_leaders(tree: KinematicTree, owner: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The joint that each independent joint drives directly, and how.

    Args:
        owner: named in messages, e.g. "hand 'fetch'".
    Returns:
        links (J,) int64, gain (J,), offset (J,): joint `links[j]` stands at `gain[j] * q[j] + offset[j]`.
    Raises:
        RobotDescriptionError: no joint follows one of them alone.
    """
    links = np.zeros(tree.num_dofs, np.int64)
    for dof in range(tree.num_dofs):
        alone = [
            link
            for link in range(1, tree.num_links)
            if tree.joint_types[link] != FIXED
            and tree.coupling[link, dof] != 0
            and np.count_nonzero(tree.coupling[link]) == 1
        ]
        if not alone:
            raise RobotDescriptionError(
                f"{owner}: no joint follows '{tree.dof_names[dof]}' alone; "
                "choose independent joints that each move at least one link on their own."
            )
        # the joint that equals q (the motor's own), else the first
        links[dof] = min(alone, key=lambda link: abs(tree.coupling[link, dof] - 1.0) + abs(tree.offset[link]))
    gain = tree.coupling[links, np.arange(tree.num_dofs)]
    return links, gain, tree.offset[links]


def add_links(
    spec: mujoco.MjSpec,
    tree: KinematicTree,
    parts: Sequence[ConvexPart],
    actuation: ActuationOf,
    surface: Surface,
    *,
    unlimited: frozenset[int] = frozenset(),
) -> list[mujoco.MjsBody]:
    """Bodies `link_i` with joints `joint_i` and geoms `part_k`, base at the world's origin.

    `kv` of `actuation` damps the joint itself. `unlimited`: links whose joint turns without end.
    """
    bodies: list[mujoco.MjsBody] = []
    for link in range(tree.num_links):
        parent = spec.worldbody if link == 0 else bodies[tree.parents[link]]
        body = parent.add_body(name=body_name(link))
        if link:
            body.pos, body.quat = position_quaternion(tree.X_parent_joint[link])
        _set_link_inertia(body, [p for p in parts if p.link == link])
        if link and tree.joint_types[link] != FIXED:
            _add_joint(body, tree, link, actuation(link), limited=link not in unlimited)
        bodies.append(body)
    for index, part in enumerate(parts):
        _add_part(spec, bodies[part.link], part, f"part_{index}", surface)
    return bodies


def add_servos(
    spec: mujoco.MjSpec, tree: KinematicTree, actuation: ActuationOf, *, owner: str, coupling_time_s: float
) -> None:
    """Position servos `dof_j` on the independent joints, and equalities that make coupled joints follow.

    Control j is the target of `q[j]`, plus offset / gain of its leader (`tree_leaders`). `coupling_time_s`: time
    constant of the equalities.
    """
    links, gain, _ = tree_leaders(tree, owner)
    for dof in range(tree.num_dofs):
        _add_servo(spec, tree, dof, int(links[dof]), float(gain[dof]), actuation(int(links[dof])).kp, owner)
    _add_couplings(spec, tree, owner, coupling_time_s)


def add_object(spec: mujoco.MjSpec, obj: ObjectModel, name: str, *, mass_kg: float, surface: Surface) -> None:
    """A free body and joint `name` with geoms `name_i`: own centre of mass and the true shape's inertia."""
    body = spec.worldbody.add_body(name=name, mass=mass_kg, ipos=obj.com_O, explicitinertial=True)
    unit = solid_inertia(np.asarray(obj.mesh.vertices), np.asarray(obj.mesh.faces), np.asarray(obj.com_O))
    inertia = mass_kg * unit
    body.fullinertia = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_FREE)
    add_hulls(spec, body, obj.convex_parts, name, surface)


def add_hulls(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, hulls: Sequence[np.ndarray], name: str, surface: Surface
) -> None:
    """Geoms `name_i`, the convex hulls of vertices (V, 3) in the body's frame."""
    for index, vertices in enumerate(hulls):
        geom = body.add_geom(name=f"{name}_{index}", type=mujoco.mjtGeom.mjGEOM_MESH)
        geom.meshname = _add_hull(spec, f"{name}_{index}", vertices)
        set_surface(geom, surface)


def set_surface(geom: mujoco.MjsGeom, surface: Surface) -> None:
    """Give a geom its contact settings."""
    geom.contype, geom.conaffinity = surface.contype, surface.conaffinity
    geom.priority = surface.priority
    geom.condim = surface.dimensions
    geom.friction = surface.friction
    geom.solref = surface.solref
    geom.solimp = [*surface.solimp, 0.5, 2.0]


def position_quaternion(X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) and wxyz quaternion (4,) of a transform (4, 4)."""
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(X[:3, :3], np.float64).ravel())
    return np.array(X[:3, 3], np.float64), quaternion


def free_pose(qpos: np.ndarray) -> np.ndarray:
    """(4, 4) pose of a free joint with position and quaternion `qpos` (7,)."""
    X, rotation = np.eye(4), np.zeros(9)
    mujoco.mju_quat2Mat(rotation, qpos[3:7])
    X[:3, :3] = rotation.reshape(3, 3)
    X[:3, 3] = qpos[:3]
    return X


def _add_joint(body: mujoco.MjsBody, tree: KinematicTree, link: int, actuation: Actuation, *, limited: bool) -> None:
    slides = tree.joint_types[link] == PRISMATIC
    joint = body.add_joint(
        name=joint_name(link),
        type=mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE,
        axis=tree.axes[link],
        armature=actuation.armature,
        damping=[actuation.kv, 0, 0],
    )
    # only the joints that q drives directly are limited; the coupled ones follow them
    ends = tree.coupling[link] * np.stack([tree.lower, tree.upper]) + 0.0
    if limited and np.count_nonzero(tree.coupling[link]) == 1:
        low, high = np.sort(ends.sum(axis=1) + tree.offset[link])
        joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        joint.range = [low, high]


def _add_servo(
    spec: mujoco.MjSpec, tree: KinematicTree, dof: int, link: int, gain: float, kp: float, owner: str
) -> None:
    effort = float(tree.effort[dof])
    if not (np.isfinite(effort) and effort > 0):
        raise RobotDescriptionError(
            f"{owner}: joint '{tree.dof_names[dof]}' has effort {effort}; expected a positive torque (N m) or force "
            "(N). Set it in hand.toml, or in the arm's file."
        )
    actuator = spec.add_actuator(
        name=f"dof_{dof}",
        target=joint_name(link),
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        gaintype=mujoco.mjtGain.mjGAIN_FIXED,
        biastype=mujoco.mjtBias.mjBIAS_AFFINE,
        forcelimited=mujoco.mjtLimited.mjLIMITED_TRUE,
        forcerange=[-effort, effort],
    )
    # transmission length = joint position / gain = q (+ offset / gain); virtual work gives the torque on q
    actuator.gear[0] = 1.0 / gain
    actuator.gainprm[0] = kp
    actuator.biasprm[:3] = [0.0, -kp, 0.0]


def _add_couplings(spec: mujoco.MjSpec, tree: KinematicTree, owner: str, time_s: float) -> None:
    links, gain, offset = tree_leaders(tree, owner)
    for link in range(1, tree.num_links):
        row = tree.coupling[link]
        if tree.joint_types[link] == FIXED or link in links:
            continue
        dofs = np.flatnonzero(row)
        ratio = row[dofs] / gain[dofs]  # d joint / d leader
        rest = float(tree.offset[link] - ratio @ offset[dofs])
        equality = spec.add_equality(name=f"coupling_{link}", solref=[time_s, 1.0], solimp=[0.9, 0.99, 1e-3, 0.5, 2])
        if len(dofs) == 1:
            equality.type = mujoco.mjtEq.mjEQ_JOINT
            equality.objtype = mujoco.mjtObj.mjOBJ_JOINT
            equality.name1, equality.name2 = joint_name(link), joint_name(int(links[dofs[0]]))
            equality.data[:5] = [rest, ratio[0], 0.0, 0.0, 0.0]
            continue
        tendon = spec.add_tendon(name=f"coupling_{link}")
        tendon.wrap_joint(joint_name(link), 1.0)
        for dof, slope in zip(dofs, ratio, strict=True):
            tendon.wrap_joint(joint_name(int(links[dof])), -float(slope))
        equality.type = mujoco.mjtEq.mjEQ_TENDON
        equality.objtype = mujoco.mjtObj.mjOBJ_TENDON
        equality.name1 = tendon.name
        equality.data[:5] = [rest, 0.0, 0.0, 0.0, 0.0]


def _add_part(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, part: ConvexPart, name: str, surface: Surface
) -> mujoco.MjsGeom:
    geom = body.add_geom(name=name, type=_GEOM_TYPES[part.kind])
    geom.pos, geom.quat = position_quaternion(part.X_LP)
    if part.kind == PartKind.HULL:
        geom.meshname = _add_hull(spec, name, part.vertices)
    else:
        geom.size = part.size
    set_surface(geom, surface)
    return geom


def _add_hull(spec: mujoco.MjSpec, name: str, vertices: np.ndarray) -> str:
    mesh = spec.add_mesh(name=name)
    mesh.uservert = np.ascontiguousarray(vertices, np.float32).ravel()
    # inertias are explicit; the shell variant also accepts hulls too flat to have a volume
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    return name


def _set_link_inertia(body: mujoco.MjsBody, parts: list[ConvexPart]) -> None:
    """Mass of the parts at plastic's density, spread over their bounding box: never zero, never absurd."""
    body.explicitinertial = True
    body.mass, body.inertia = _MIN_LINK_MASS, [10 * _MIN_LINK_INERTIA] * 3
    if not parts:
        return
    low, high = part_bounds(parts)
    mass = max(_LINK_DENSITY * sum(part_volume(p) for p in parts), _MIN_LINK_MASS)
    squares = (high - low) ** 2
    body.mass = mass
    body.ipos = (low + high) / 2
    body.inertia = np.maximum(mass / 12 * (squares.sum() - squares), _MIN_LINK_INERTIA)
