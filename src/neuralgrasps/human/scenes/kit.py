"""What random scenes are made of, as flat arrays: a hand's skin that can change its build, and a bank of grasps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from neuralgrasps.geometry.mesh import Mesh, box_mesh, capsule_mesh, sphere_mesh
from neuralgrasps.hands.hand import ConvexPart, PartKind
from neuralgrasps.human.scenes.grasp_bank import GraspBank
from neuralgrasps.human.skeleton import human_hand, skeleton

_AROUND = 8  # corners round a finger
_SWELL = 1.04  # so that the eight-sided finger is as thick on average as the round one


class SceneKit(NamedTuple):
    """Arrays of the right hand at scale 1 and of a `GraspBank`; link frames, metres.

    Attributes:
        parents, joint_types, X_parent_joint, axes, coupling, offset, lower, upper, q_open: the hand's tree.
        skin_core (V, 3), skin_offset (V, 3): a corner of the skin is its place on the bone plus its offset from it;
            skin_link (V,); skin_faces (F, 3).
        joint_link (21,), joint_L (21, 3): the named joints.
        solid_points, solid_faces, point_start, face_start, held_solid, held_X, held_q: see `GraspBank`.
        max_points, max_faces: of the largest solid.
    """

    parents: np.ndarray
    joint_types: np.ndarray
    X_parent_joint: np.ndarray
    axes: np.ndarray
    coupling: np.ndarray
    offset: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    q_open: np.ndarray
    skin_core: np.ndarray
    skin_offset: np.ndarray
    skin_link: np.ndarray
    skin_faces: np.ndarray
    joint_link: np.ndarray
    joint_L: np.ndarray
    solid_points: np.ndarray
    solid_faces: np.ndarray
    point_start: np.ndarray
    face_start: np.ndarray
    held_solid: np.ndarray
    held_X: np.ndarray
    held_q: np.ndarray
    max_points: int
    max_faces: int


def scene_kit(bank: GraspBank) -> SceneKit:
    """Arrays for `random_scene`, made once."""
    hand = human_hand()
    tree, bones = hand.tree, skeleton(hand)
    core, offset, links, faces, count = [], [], [], [], 0
    for part in hand.parts:
        mesh, on_bone = _part_skin(part)
        R, t = part.X_LP[:3, :3], part.X_LP[:3, 3]
        core.append(on_bone @ R.T + t)
        offset.append((mesh.vertices - on_bone) @ R.T)
        links.append(np.full(len(mesh.vertices), part.link, np.int32))
        faces.append(mesh.faces.astype(np.int32) + count)
        count += len(mesh.vertices)
    return SceneKit(
        parents=tree.parents, joint_types=tree.joint_types, X_parent_joint=tree.X_parent_joint, axes=tree.axes,
        coupling=tree.coupling, offset=tree.offset, lower=tree.lower, upper=tree.upper, q_open=hand.q_open,
        skin_core=np.concatenate(core), skin_offset=np.concatenate(offset), skin_link=np.concatenate(links),
        skin_faces=np.concatenate(faces), joint_link=bones.links, joint_L=bones.points_L,
        solid_points=bank.points_O, solid_faces=bank.faces, point_start=bank.point_start, face_start=bank.face_start,
        held_solid=bank.solid, held_X=bank.X_OH, held_q=bank.q,
        max_points=int(np.diff(bank.point_start).max()), max_faces=int(np.diff(bank.face_start).max()),
    )  # fmt: skip


def _part_skin(part: ConvexPart) -> tuple[Mesh, np.ndarray]:
    """A part's surface in its own frame, and for each corner its place on the bone (V, 3)."""
    if part.kind == PartKind.BOX:
        mesh = box_mesh(part.size)
        return mesh, mesh.vertices
    if part.kind == PartKind.SPHERE:
        mesh = sphere_mesh(part.size[0] * _SWELL, segments=_AROUND)
        return mesh, np.zeros_like(mesh.vertices)
    mesh = capsule_mesh(part.size[0] * _SWELL, part.size[1], segments=_AROUND)
    on_bone = np.zeros_like(mesh.vertices)
    on_bone[:, 2] = np.where(mesh.vertices[:, 2] > 0, part.size[1], -part.size[1])
    return mesh, on_bone
