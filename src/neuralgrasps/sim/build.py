"""The MuJoCo model of one hand holding one object.

The hand base is welded to the world at the origin and the object is a free body, so that the world frame is H and a
grasp is only a start pose of the object, X_HO = inverse(X_OH): one compiled model serves every grasp of the pair.
"""

from __future__ import annotations

import mujoco
import numpy as np

from neuralgrasps.errors import RobotDescriptionError
from neuralgrasps.hands.hand import ConvexPart, Hand, PartKind
from neuralgrasps.kinematics.tree import FIXED, PRISMATIC
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.sim.inertia import part_bounds, part_volume, solid_inertia
from neuralgrasps.sim.protocols import Actuation, Protocol

OBJECT_BODY = "object"
OBJECT_JOINT = "object"
CONTACT_DIMENSIONS = 4  # normal force, two of sliding friction, torsion: MuJoCo's condim

_HAND_BIT, _OBJECT_BIT = 1, 2
_LINK_DENSITY = 1000.0  # kg/m^3; with gravity off and motors' armature on top it hardly matters
_MIN_LINK_MASS = 1e-3
_MIN_LINK_INERTIA = 1e-7
_GEOM_TYPES = {
    PartKind.BOX: mujoco.mjtGeom.mjGEOM_BOX,
    PartKind.SPHERE: mujoco.mjtGeom.mjGEOM_SPHERE,
    PartKind.CAPSULE: mujoco.mjtGeom.mjGEOM_CAPSULE,
    PartKind.CYLINDER: mujoco.mjtGeom.mjGEOM_CYLINDER,
    PartKind.HULL: mujoco.mjtGeom.mjGEOM_MESH,
}


def joint_name(link: int) -> str:
    """Name in the MuJoCo model of the joint that moves `link`."""
    return f"joint_{link}"


def grasp_model(hand: Hand, obj: ObjectModel, protocol: Protocol) -> mujoco.MjModel:
    """Compile the model in which every grasp of `obj` by `hand` is tried.

    Actuator j is a position servo on independent joint j; its control is the target of `q[j]` (see `leaders`).
    Hand parts never touch each other (synthesis checks self-collision, at points 4 mm apart); coupled joints follow by
    equality constraints. Forces on the object are the caller's, through `xfrc_applied`.

    Raises:
        RobotDescriptionError: a joint has no usable effort limit, or no joint follows it alone.
    """
    spec = mujoco.MjSpec()
    spec.modelname = f"{hand.name} holding {obj.name}"
    _set_options(spec, protocol)
    _add_hand(spec, hand, protocol)
    _add_object(spec, obj, protocol)
    return spec.compile()


def leaders(hand: Hand) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The joint that each independent joint drives directly, and how.

    Returns:
        links (J,) int64, gain (J,), offset (J,): joint `links[j]` stands at `gain[j] * q[j] + offset[j]`.
    """
    tree = hand.tree
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
                f"hand '{hand.name}': no joint follows '{tree.dof_names[dof]}' alone; "
                "choose independent joints that each move at least one link on their own."
            )
        # the joint that equals q (the motor's own), else the first
        links[dof] = min(alone, key=lambda link: abs(tree.coupling[link, dof] - 1.0) + abs(tree.offset[link]))
    gain = tree.coupling[links, np.arange(tree.num_dofs)]
    return links, gain, tree.offset[links]


def object_mass(obj: ObjectModel, protocol: Protocol) -> float:
    """Mass in the trial, kg."""
    return float(obj.mass_kg if protocol.object_mass_kg is None else protocol.object_mass_kg)


def contact_friction(obj: ObjectModel, protocol: Protocol) -> tuple[float, float, float]:
    """Sliding (1), torsional (m) and rolling (m) friction of every hand-object contact in the trial."""
    sliding = obj.friction if protocol.friction is None else protocol.friction
    scale = protocol.friction_scale
    return float(sliding * scale), protocol.torsional_friction * scale, protocol.rolling_friction * scale


def _set_options(spec: mujoco.MjSpec, protocol: Protocol) -> None:
    option = spec.option
    option.timestep = protocol.timestep_s
    option.gravity = np.zeros(3)
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = protocol.impratio
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    # MuJoCo 4.0.0 factors the sparse Newton Hessian wrongly (fixed in 4.0.1); these models are small and dense anyway.
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    option.iterations = protocol.solver_iterations
    option.noslip_iterations = protocol.noslip_iterations
    # A diverged state must stay diverged: auto-reset would put the object back and could pass as a success.
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    if not protocol.multiccd:
        option.disableflags |= mujoco.mjtDisableBit.mjDSBL_MULTICCD
    spec.compiler.inertiafromgeom = 0
    spec.compiler.degree = False


def _add_hand(spec: mujoco.MjSpec, hand: Hand, protocol: Protocol) -> None:
    tree = hand.tree
    bodies: list[mujoco.MjsBody] = []
    for link in range(tree.num_links):
        parent = spec.worldbody if link == 0 else bodies[tree.parents[link]]
        body = parent.add_body(name=f"link_{link}")
        if link:
            body.pos, body.quat = _position_quaternion(tree.X_parent_joint[link])
        _set_link_inertia(body, [p for p in hand.parts if p.link == link])
        if link and tree.joint_types[link] != FIXED:
            _add_joint(body, hand, link, protocol)
        bodies.append(body)
    for index, part in enumerate(hand.parts):
        _add_part(spec, bodies[part.link], part, f"part_{index}", protocol)
    links, gain, _ = leaders(hand)
    for dof in range(tree.num_dofs):
        _add_servo(spec, hand, dof, int(links[dof]), float(gain[dof]), protocol)
    _add_couplings(spec, hand, protocol)


def _actuation(hand: Hand, link: int, protocol: Protocol) -> Actuation:
    return protocol.prismatic if hand.tree.joint_types[link] == PRISMATIC else protocol.revolute


def _add_joint(body: mujoco.MjsBody, hand: Hand, link: int, protocol: Protocol) -> None:
    tree = hand.tree
    actuation = _actuation(hand, link, protocol)
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
    if np.count_nonzero(tree.coupling[link]) == 1:
        low, high = np.sort(ends.sum(axis=1) + tree.offset[link])
        joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        joint.range = [low, high]


def _add_servo(spec: mujoco.MjSpec, hand: Hand, dof: int, link: int, gain: float, protocol: Protocol) -> None:
    effort = float(hand.tree.effort[dof])
    if not (np.isfinite(effort) and effort > 0):
        raise RobotDescriptionError(
            f"hand '{hand.name}': joint '{hand.tree.dof_names[dof]}' has effort {effort}; "
            "expected a positive torque (N m) or force (N). Set it in hand.toml."
        )
    kp = _actuation(hand, link, protocol).kp
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


def _add_couplings(spec: mujoco.MjSpec, hand: Hand, protocol: Protocol) -> None:
    tree = hand.tree
    links, gain, offset = leaders(hand)
    for link in range(1, tree.num_links):
        row = tree.coupling[link]
        if tree.joint_types[link] == FIXED or link in links:
            continue
        dofs = np.flatnonzero(row)
        ratio = row[dofs] / gain[dofs]  # d joint / d leader
        rest = float(tree.offset[link] - ratio @ offset[dofs])
        equality = spec.add_equality(
            name=f"coupling_{link}", solref=[2 * protocol.timestep_s, 1.0], solimp=[0.9, 0.99, 1e-3, 0.5, 2]
        )
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
    spec: mujoco.MjSpec, body: mujoco.MjsBody, part: ConvexPart, name: str, protocol: Protocol
) -> mujoco.MjsGeom:
    geom = body.add_geom(name=name, type=_GEOM_TYPES[part.kind])
    geom.pos, geom.quat = _position_quaternion(part.X_LP)
    if part.kind == PartKind.HULL:
        geom.meshname = _add_hull(spec, name, part.vertices)
    else:
        geom.size = part.size
    geom.contype, geom.conaffinity = _HAND_BIT, _OBJECT_BIT
    _set_contact(geom, protocol, (0.0, 0.0, 0.0))  # the object's friction is the larger one, and decides
    return geom


def _add_object(spec: mujoco.MjSpec, obj: ObjectModel, protocol: Protocol) -> None:
    mass = object_mass(obj, protocol)
    body = spec.worldbody.add_body(name=OBJECT_BODY, mass=mass, ipos=obj.com_O, explicitinertial=True)
    unit = solid_inertia(np.asarray(obj.mesh.vertices), np.asarray(obj.mesh.faces), np.asarray(obj.com_O))
    inertia = mass * unit
    body.fullinertia = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
    body.add_joint(name=OBJECT_JOINT, type=mujoco.mjtJoint.mjJNT_FREE)
    friction = contact_friction(obj, protocol)
    for index, vertices in enumerate(obj.convex_parts):
        geom = body.add_geom(name=f"object_{index}", type=mujoco.mjtGeom.mjGEOM_MESH)
        geom.meshname = _add_hull(spec, f"object_{index}", vertices)
        geom.contype, geom.conaffinity = _OBJECT_BIT, _HAND_BIT
        _set_contact(geom, protocol, friction)


def _add_hull(spec: mujoco.MjSpec, name: str, vertices: np.ndarray) -> str:
    mesh = spec.add_mesh(name=name)
    mesh.uservert = np.ascontiguousarray(vertices, np.float32).ravel()
    # inertias are explicit; the shell variant also accepts hulls too flat to have a volume
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    return name


def _set_contact(geom: mujoco.MjsGeom, protocol: Protocol, friction: tuple[float, float, float]) -> None:
    geom.condim = CONTACT_DIMENSIONS
    geom.friction = friction
    geom.solref = protocol.solref
    geom.solimp = [*protocol.solimp, 0.5, 2.0]


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


def _position_quaternion(X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(X[:3, :3], np.float64).ravel())
    return np.array(X[:3, 3], np.float64), quaternion
