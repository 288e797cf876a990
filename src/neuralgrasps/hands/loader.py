"""From a robot file's contents and notes on it to a `Hand`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from neuralgrasps.errors import MeshError, RobotDescriptionError, unknown_name
from neuralgrasps.geometry.mesh import Mesh, convex_hull
from neuralgrasps.geometry.sampling import farthest_points
from neuralgrasps.hands.annotate import complete_notes
from neuralgrasps.hands.chains import moved_links
from neuralgrasps.hands.hand import ConvexPart, Finger, Hand, PartKind
from neuralgrasps.hands.jaws import couple_jaw
from neuralgrasps.hands.notes import HandNotes, JointNotes
from neuralgrasps.kinematics.description import LinkGeometry, RobotDescription
from neuralgrasps.kinematics.tree import KinematicTree

MAX_HULL_VERTICES = 56  # MuJoCo's contact finder and ours stay fast; the lost volume is below 1 % on finger meshes
_KINDS = {
    "box": PartKind.BOX,
    "sphere": PartKind.SPHERE,
    "capsule": PartKind.CAPSULE,
    "cylinder": PartKind.CYLINDER,
}


def hand_from_description(description: RobotDescription, notes: HandNotes | None = None) -> Hand:
    """Build a hand; whatever `notes` leaves open is annotated automatically (see `annotate`).

    Args:
        description: contents of a URDF or MJCF file.
        notes: contents of a `hand.toml`, or None.
    Returns:
        the hand; `extra["repairs"]` and `extra["annotated"]` say what was mended and guessed, one sentence a line.
    Raises:
        RobotDescriptionError: no geometry, no joints, or notes that name links or joints the robot does not have.
    """
    given = notes or HandNotes()
    _check_names(description.tree, given)
    parts, repairs = convex_parts(description)
    if not parts:
        raise RobotDescriptionError(
            f"hand '{description.name}' has no geometry; add a collision or visual shape to its links."
        )
    if description.tree.num_dofs == 0:
        fixed = [line for line in description.repairs if "treated as fixed" in line]
        raise RobotDescriptionError(
            " ".join((f"hand '{description.name}' has no movable joints; expected at least one.", *fixed))
        )
    tree, coupled = couple_jaw(description.name, description.tree, parts, given)
    complete, guesses = complete_notes(description.name, tree, parts, given)
    tree = _with_efforts(tree, complete)
    joints = [complete.joints[name] for name in tree.dof_names]
    X_HP, fingers = complete.X_HP, complete.fingers
    assert X_HP is not None and fingers is not None
    preshape = np.array([j.preshape for j in joints], float).reshape(-1, 2)
    hand = Hand(
        name=complete.name or description.name,
        tree=tree,
        parts=parts,
        fingers=tuple(_finger(tree, f.name, f.links, f.thumb) for f in fingers),
        X_HP=X_HP,
        closing_rate=np.array([j.close for j in joints], float),
        q_open=np.array([j.open for j in joints], float),
        preshape_lower=preshape[:, 0].copy(),
        preshape_upper=preshape[:, 1].copy(),
        preshape_groups=_groups(joints),
        is_jaw=bool(complete.is_jaw),
        jaw_pad_H=X_HP[:3, 3].copy() if complete.jaw_pad_H is None else complete.jaw_pad_H,
        licence=complete.licence or "not stated",
        provenance=complete.provenance or f"{description.source.name}",
        extra={"repairs": "\n".join((*description.repairs, *repairs)), "annotated": "\n".join((*coupled, *guesses))},
    )
    _check_limits(hand)
    return hand


def convex_parts(description: RobotDescription) -> tuple[tuple[ConvexPart, ...], tuple[str, ...]]:
    """Convex solids of all links, by link; collision shapes, or the visual ones of a link that has no others.

    Meshes become their convex hull, reduced to `MAX_HULL_VERTICES`.

    Returns:
        the parts, and one sentence for each shape that was replaced or dropped.
    """
    parts: list[ConvexPart] = []
    repairs: list[str] = []
    for link, name in enumerate(description.tree.link_names):
        shapes = description.collision_of(link)
        if not shapes and (shapes := description.visual_of(link)):
            repairs.append(f"link '{name}' has no collision shape: its visual one is used.")
        for shape in shapes:
            part = _convex_part(shape, name, repairs)
            if part is not None:
                parts.append(part)
    return tuple(parts), tuple(repairs)


def _convex_part(shape: LinkGeometry, link_name: str, repairs: list[str]) -> ConvexPart | None:
    if shape.mesh is None:
        return ConvexPart(
            link=shape.link,
            kind=_KINDS[shape.kind],
            size=np.array(shape.size, float),
            X_LP=np.array(shape.X_LG, float),
            colour=shape.colour,
        )
    try:
        vertices, faces = _reduced_hull(shape.mesh)
    except MeshError as error:
        repairs.append(f"a mesh of link '{link_name}' was left out: {error}")
        return None
    return ConvexPart(
        link=shape.link,
        kind=PartKind.HULL,
        size=np.zeros(3),
        X_LP=np.array(shape.X_LG, float),
        vertices=vertices,
        faces=faces,
        colour=shape.colour,
    )


def _reduced_hull(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = convex_hull(mesh.vertices)
    if len(vertices) <= MAX_HULL_VERTICES:
        return vertices, faces
    start = int(np.argmax(np.linalg.norm(vertices - vertices.mean(axis=0), axis=1)))
    return convex_hull(vertices[farthest_points(vertices, MAX_HULL_VERTICES, start=start)])


def _check_names(tree: KinematicTree, notes: HandNotes) -> None:
    for name in notes.joints:
        if name not in tree.dof_names:
            raise RobotDescriptionError(str(unknown_name("joint", name, tree.dof_names)))
    for finger in notes.fingers or ():
        for link in finger.links:
            if link not in tree.link_names:
                raise RobotDescriptionError(str(unknown_name("link", link, tree.link_names)))


def _with_efforts(tree: KinematicTree, notes: HandNotes) -> KinematicTree:
    given = [notes.joints[name].effort for name in tree.dof_names]
    if not any(given):
        return tree
    effort = [own if note is None else note for own, note in zip(tree.effort, given, strict=True)]
    return replace(tree, effort=np.array(effort, float))


def _groups(joints: Sequence[JointNotes]) -> tuple[tuple[int, ...], ...]:
    """Indices of joints by group, in order of first appearance; a joint without a group stands alone."""
    groups: dict[object, list[int]] = {}
    for j, joint in enumerate(joints):
        groups.setdefault(j if joint.group is None else joint.group, []).append(j)
    return tuple(tuple(g) for g in groups.values())


def _finger(tree: KinematicTree, name: str, link_names: Iterable[str], thumb: bool) -> Finger:
    links = tuple(tree.link_names.index(n) for n in link_names)
    moved = moved_links(tree)
    dofs = tuple(j for j in range(tree.num_dofs) if moved[:, j].any() and not np.delete(moved[:, j], links).any())
    return Finger(name=name, links=links, dofs=dofs, is_thumb=thumb)


def _check_limits(hand: Hand) -> None:
    lower, upper = hand.tree.lower - 1e-4, hand.tree.upper + 1e-4
    for what, q in (("open", hand.q_open), ("preshape", hand.preshape_lower), ("preshape", hand.preshape_upper)):
        for j in np.flatnonzero((q < lower) | (q > upper)):
            raise RobotDescriptionError(
                f"hand '{hand.name}': {what} value {q[j]:g} of joint '{hand.tree.dof_names[j]}' is outside its limits "
                f"{hand.tree.lower[j]:g}..{hand.tree.upper[j]:g}."
            )
