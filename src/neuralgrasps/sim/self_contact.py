"""The robot of a table-top simulation: its moving joints, and which links may overlap because they are joined."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.hands.chains import rigid_bodies
from neuralgrasps.kinematics.forward_kernels import joint_motion
from neuralgrasps.kinematics.tree import FIXED, KinematicTree
from neuralgrasps.seeds import child_rng
from neuralgrasps.sim.protocols import Actuation
from neuralgrasps.sim.robot_bodies import Surface, add_links, body_name, joint_name

_SAMPLES = 256  # random postures
_ALWAYS = 0.5  # links that overlap in more than this share of them do so by construction
_STILL = Actuation(kp=0.0, kv=0.0, armature=0.0)
GEOMETRY_ONLY = Surface(friction=(0.0, 0.0, 0.0), solref=(0.02, 1.0), solimp=(0.9, 0.95, 1e-3))
"""Contact settings of models in which nothing is simulated."""


def held_tree(manipulator: Manipulator) -> KinematicTree:
    """The tree in which only planned joints and those of the hand move, in this order: q = (q_arm, q_hand).

    The others (a head, wheels) become fixed joints at home; links keep their indices.
    """
    tree, kept = manipulator.tree, np.concatenate([manipulator.arm_dofs, manipulator.hand_dofs])
    held = np.setdiff1d(np.arange(tree.num_dofs), kept)
    coupling = tree.coupling[:, kept]
    offset = tree.offset + tree.coupling[:, held] @ manipulator.q_home[held]
    joint_types, X_parent_joint = tree.joint_types.copy(), tree.X_parent_joint.copy()
    for link in range(tree.num_links):
        if joint_types[link] != FIXED and not coupling[link].any():
            motion = joint_motion(int(joint_types[link]), tree.axes[link], float(offset[link]))
            X_parent_joint[link] = X_parent_joint[link] @ motion
            joint_types[link], offset[link] = FIXED, 0.0
    return replace(
        tree,
        joint_types=joint_types,
        X_parent_joint=X_parent_joint,
        coupling=coupling,
        offset=offset,
        dof_names=tuple(tree.dof_names[j] for j in kept),
        lower=tree.lower[kept],
        upper=tree.upper[kept],
        effort=tree.effort[kept],
    )


def add_still_links(spec: mujoco.MjSpec, manipulator: Manipulator, tree: KinematicTree) -> list[mujoco.MjsBody]:
    """The robot's bodies without servos, for geometry only."""
    unlimited = frozenset(range(tree.num_links))
    return add_links(spec, tree, manipulator.parts, lambda _: _STILL, GEOMETRY_ONLY, unlimited=unlimited)


def joined_links(manipulator: Manipulator) -> tuple[tuple[int, int], ...]:
    """Pairs (a < b) of links with parts whose contact is not looked at.

    Links of one rigid body, of neighbouring rigid bodies (those without parts between them do not count), those that
    overlap at home, and those that overlap in more than half of random postures.
    """
    tree = held_tree(manipulator)
    body = rigid_bodies(tree)
    solid = sorted({p.link for p in manipulator.parts})
    above = _solid_ancestor(tree, body, {int(body[i]) for i in solid})
    overlapping = _overlapping_bodies(manipulator, tree, body)
    return tuple(
        (a, b)
        for i, a in enumerate(solid)
        for b in solid[i + 1 :]
        if body[a] == body[b]
        or above.get(int(body[a])) == body[b]
        or above.get(int(body[b])) == body[a]
        or (min(body[a], body[b]), max(body[a], body[b])) in overlapping
    )


def exclude_joined(spec: mujoco.MjSpec, manipulator: Manipulator) -> None:
    """Leave the contacts of `joined_links` out of a model that `add_links` built."""
    for a, b in joined_links(manipulator):
        spec.add_exclude(name=f"joined_{a}_{b}", bodyname1=body_name(a), bodyname2=body_name(b))


def _solid_ancestor(tree: KinematicTree, body: np.ndarray, solid: set[int]) -> dict[int, int]:
    """Per rigid body (its first link) the nearest one towards the base that has parts."""
    nearest: dict[int, int] = {}
    for link in sorted({int(b) for b in body}):
        parent = int(tree.parents[link])
        if parent < 0:
            continue
        up = int(body[parent])
        if up in solid:
            nearest[link] = up
        elif up in nearest:
            nearest[link] = nearest[up]
    return nearest


def _overlapping_bodies(manipulator: Manipulator, tree: KinematicTree, body: np.ndarray) -> set[tuple[int, int]]:
    """Pairs of rigid bodies, first links ascending, that overlap at home or almost always."""
    spec = mujoco.MjSpec()
    spec.compiler.inertiafromgeom, spec.compiler.degree = 0, False
    add_still_links(spec, manipulator, tree)
    model = spec.compile()
    data = mujoco.MjData(model)
    links, qpos = moving_joints(model, tree)
    owner = body[geom_links(model, tree.num_links)]
    home = manipulator.q_home[np.concatenate([manipulator.arm_dofs, manipulator.hand_dofs])]
    postures = child_rng(0, "self contact").uniform(tree.lower, tree.upper, (_SAMPLES, tree.num_dofs))
    counts: dict[tuple[int, int], int] = {}
    for row, q in enumerate([home, *postures]):
        data.qpos[qpos] = tree.joint_positions(q)[links]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        touching = np.sort(owner[data.contact.geom[data.contact.dist < 0.0]], axis=1)
        for a, b in {(int(a), int(b)) for a, b in touching}:
            counts[a, b] = counts.get((a, b), 0) + (_SAMPLES if row == 0 else 1)
    return {pair for pair, count in counts.items() if count > _ALWAYS * _SAMPLES}


def moving_joints(model: mujoco.MjModel, tree: KinematicTree) -> tuple[np.ndarray, np.ndarray]:
    """Links whose joint moves (n,), ascending, and the address of each joint in `qpos`."""
    links = np.flatnonzero(tree.joint_types != FIXED)
    return links, np.array([int(model.joint(joint_name(int(link))).qposadr[0]) for link in links], np.int64)


def geom_links(model: mujoco.MjModel, num_links: int) -> np.ndarray:
    """(G,) link of every geom; -1: none of the robot's. The engine orders bodies and geoms in its own way."""
    link_of_body = np.full(model.nbody, -1, np.int64)
    for link in range(num_links):
        link_of_body[model.body(body_name(link)).id] = link
    return link_of_body[model.geom_bodyid]
