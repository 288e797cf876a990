"""Checking a planned joint path again, with the physics engine's collision instead of the planner's.

It shares nothing with the planner but the robot's parts and the objects' convex parts, so that an error there does not
hide here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol as Structure

import mujoco
import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.errors import InputError, check_shape
from neuralgrasps.hands.parts import bounding_sphere
from neuralgrasps.kinematics.tree import FIXED, PRISMATIC, KinematicTree
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.sim.robot_bodies import add_hulls, body_name, position_quaternion, set_surface
from neuralgrasps.sim.self_contact import (
    GEOMETRY_ONLY,
    add_still_links,
    exclude_joined,
    geom_links,
    held_tree,
    moving_joints,
)
from neuralgrasps.sim.tabletop_model import SolidBox

_EXACT_M = 1e-5  # the engine's distances between convex shapes are exact to about 1e-6 m
_SLACK_M = 1e-4  # an object that is lifted may overlap what it stood on by so much more than at the start


class Placed(Structure):
    """Any object at a pose X_BO (4, 4): the planner's `PlacedObject`."""

    @property
    def obj(self) -> ObjectModel: ...
    @property
    def X_BO(self) -> np.ndarray: ...


class Surroundings(Structure):
    """Boxes, the object to be grasped, and other objects: the planner's `PlanningWorld`. Points are not looked at."""

    @property
    def boxes(self) -> Sequence[SolidBox]: ...
    @property
    def target(self) -> Placed | None: ...
    @property
    def objects(self) -> Sequence[Placed]: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class PathCheck:
    """What a path touches.

    Attributes:
        free: nothing.
        first_contact: "a and b overlap by 1.2 mm at 34 % of the path", or "".
        depth_m: deepest overlap on the whole path, 0 when free.
        samples: postures that were looked at; between two of them no point of the robot moves farther than asked.
    """

    free: bool
    first_contact: str
    depth_m: float
    samples: int


def recheck_path(
    manipulator: Manipulator,
    world: Surroundings,
    q_path: np.ndarray,
    *,
    q_hand: np.ndarray,
    max_move_m: float = 0.001,
    ignore_target: bool = False,
    carried: np.ndarray | None = None,
) -> PathCheck:
    """Look for overlap along a path, straight between its rows in joint space.

    Every pair of a link that moves, or of what it carries, with another link (but `joined_links`), a box or an object
    counts; those that stand still on the robot's base are compared with boxes and objects once.

    Args:
        manipulator: the robot. world: what is around.
        q_path: (T, D) planned joints. q_hand: (J,) posture of the hand.
        max_move_m: bound on the way of any point of the robot between samples.
        ignore_target: the hand may touch the target.
        carried: X_HO (4, 4), the target in the hand: it moves along, may touch the hand, and may go on touching what
            it touched at the start, no deeper.
    Raises:
        ShapeError: wrong shapes. InputError: `carried` without a target.
    """
    q_path = np.asarray(q_path, np.float64)
    check_shape("q_path", q_path.shape, (None, len(manipulator.arm_dofs)))
    if carried is not None and world.target is None:
        raise InputError("carried is given, but the world has no target that could be carried.")
    if not max_move_m > 0 or not np.isfinite(q_path).all() or len(q_path) == 0:
        raise InputError("recheck needs a path of finite joint values, and max_move_m above 0.")
    tree = held_tree(manipulator)
    model, names = _model(manipulator, tree, world, ignore_target, carried)
    hand = np.broadcast_to(np.asarray(q_hand, np.float64), (len(q_path), manipulator.hand.num_dofs))
    q, share = _samples(tree, np.hstack([q_path, hand]), _reach(manipulator, tree, world, carried), max_move_m)
    data = mujoco.MjData(model)
    links, qpos = moving_joints(model, tree)
    positions = tree.joint_positions(q)[:, links]
    first, deepest, allowed = _still_overlap(model, data, tree, names), 0.0, {}
    for k, row in enumerate(positions):
        data.qpos[qpos] = row
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        if not data.ncon:
            continue
        for (a, b), depth in _overlaps(data, names).items():
            if carried is not None and k == 0 and _CARRIED in (a, b):
                allowed[a, b] = depth + _SLACK_M
            if depth <= allowed.get((a, b), _EXACT_M):
                continue
            deepest = max(deepest, depth)
            first = first or f"{a} and {b} overlap by {1e3 * depth:.2f} mm at {share[k]:.0%} of the path"
    return PathCheck(free=not first, first_contact=first, depth_m=deepest, samples=len(q))


_CARRIED = "the carried object"


def _model(
    manipulator: Manipulator, tree: KinematicTree, world: Surroundings, ignore_target: bool, carried: np.ndarray | None
) -> tuple[mujoco.MjModel, list[str]]:
    """The geometry, and the name of what each geom belongs to."""
    spec = mujoco.MjSpec()
    spec.compiler.inertiafromgeom, spec.compiler.degree = 0, False
    bodies = add_still_links(spec, manipulator, tree)
    exclude_joined(spec, manipulator)
    hand = [body_name(i) for i in range(manipulator.hand_link, tree.num_links)]
    names = {body_name(i): name for i, name in enumerate(tree.link_names)}
    for k, box in enumerate(world.boxes):
        geom = spec.worldbody.add_geom(name=f"box_{k}", type=mujoco.mjtGeom.mjGEOM_BOX, size=box.half)
        geom.pos, geom.quat = position_quaternion(np.asarray(box.X_BX))
        set_surface(geom, GEOMETRY_ONLY)
    for k, placed in enumerate(world.objects):
        _add_placed(spec.worldbody, spec, placed.obj, placed.X_BO, f"object_{k}")
        names[f"object_{k}"] = placed.obj.name
    if world.target is not None:
        parent = spec.worldbody if carried is None else bodies[manipulator.hand_link]
        _add_placed(parent, spec, world.target.obj, world.target.X_BO if carried is None else carried, "target")
        names["target"] = world.target.obj.name if carried is None else _CARRIED
        if ignore_target or carried is not None:
            for name in hand:
                spec.add_exclude(name=f"held_{name}", bodyname1=name, bodyname2="target")
    model = spec.compile()
    owner = [names.get(model.body(int(b)).name, "") for b in model.geom_bodyid]
    for k, box in enumerate(world.boxes):
        owner[model.geom(f"box_{k}").id] = box.name
    return model, owner


def _add_placed(parent: mujoco.MjsBody, spec: mujoco.MjSpec, obj: ObjectModel, X: np.ndarray, name: str) -> None:
    body = parent.add_body(name=name)
    body.pos, body.quat = position_quaternion(np.asarray(X))
    body.explicitinertial, body.mass, body.inertia = True, 1.0, [1.0, 1.0, 1.0]
    add_hulls(spec, body, obj.convex_parts, name, GEOMETRY_ONLY)


def _overlaps(data: mujoco.MjData, names: Sequence[str]) -> dict[tuple[str, str], float]:
    """Overlap in metres of the pairs that overlap in a state."""
    found: dict[tuple[str, str], float] = {}
    contact = data.contact
    for (a, b), distance in zip(contact.geom, contact.dist, strict=True):
        if distance < 0.0:
            pair = names[int(a)], names[int(b)]
            found[pair] = max(found.get(pair, 0.0), -float(distance))
    return found


def _still_overlap(model: mujoco.MjModel, data: mujoco.MjData, tree: KinematicTree, names: Sequence[str]) -> str:
    """The first overlap of what never moves on the robot with what never moves around it: the engine skips those."""
    mujoco.mj_kinematics(model, data)
    still = model.body_weldid[model.geom_bodyid] == 0
    link = geom_links(model, tree.num_links)
    for a in map(int, np.flatnonzero(still & (link >= 0))):
        for b in map(int, np.flatnonzero(still & (link < 0))):
            distance = mujoco.mj_geomDistance(model, data, a, b, 0.01, None)
            if distance < -_EXACT_M:
                return f"{names[a]} and {names[b]} overlap by {-1e3 * distance:.2f} mm, and neither moves"
    return ""


def _reach(
    manipulator: Manipulator, tree: KinematicTree, world: Surroundings, carried: np.ndarray | None
) -> np.ndarray:
    """(L,) how far any point beyond a link can be from the link's origin, in any posture, metres."""
    reach = np.zeros(tree.num_links)
    for part in manipulator.parts:
        centre, radius = bounding_sphere(part)
        reach[part.link] = max(reach[part.link], float(np.linalg.norm(centre)) + radius)
    if carried is not None and world.target is not None:
        points = np.concatenate(world.target.obj.convex_parts) @ carried[:3, :3].T + carried[:3, 3]
        hand = manipulator.hand_link
        reach[hand] = max(reach[hand], float(np.linalg.norm(points, axis=1).max()))
    ends = np.abs(tree.coupling) @ np.maximum(np.abs(tree.lower), np.abs(tree.upper)) + np.abs(tree.offset)
    for link in range(tree.num_links - 1, 0, -1):
        travel = float(ends[link]) if tree.joint_types[link] == PRISMATIC else 0.0
        step = float(np.linalg.norm(tree.X_parent_joint[link][:3, 3])) + travel
        reach[tree.parents[link]] = max(reach[tree.parents[link]], step + reach[link])
    return reach


def _samples(tree: KinematicTree, q: np.ndarray, reach: np.ndarray, max_move_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Postures (S, D + J) along rows `q`, and where on the path each is, from 0 to 1.

    A point moves by no more than the sum over its joints of the joint's turn times its reach (the joint's way, when it
    slides); the sum over all joints bounds it for all points. Samples are even in that sum.
    """
    way = np.abs(np.diff(q, axis=0) @ tree.coupling.T)  # (T - 1, L)
    lever = np.where(tree.joint_types == PRISMATIC, 1.0, np.where(tree.joint_types == FIXED, 0.0, reach))
    along = np.concatenate([[0.0], np.cumsum(way @ lever)])
    total = float(along[-1])
    if total == 0.0:
        return q[:1], np.zeros(1)
    at = np.linspace(0.0, total, int(np.ceil(total / max_move_m)) + 1)
    return np.stack([np.interp(at, along, column) for column in q.T], axis=1), at / total
