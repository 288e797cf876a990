"""Where hands are mounted: the flange link of a robot file, and the face on it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neuralgrasps.errors import RobotDescriptionError
from neuralgrasps.hands.hand import ConvexPart
from neuralgrasps.hands.parts import part_mesh
from neuralgrasps.hands.whole_robot import hand_links
from neuralgrasps.kinematics.notes_table import frame_from_axes
from neuralgrasps.kinematics.subtree import RobotOutline
from neuralgrasps.kinematics.tree import FIXED, KinematicTree

FLANGE_NAMES = ("tool0", "flange", "ee_link", "tool_link", "end_effector_link")  # in order of trust
MIN_JOINTS = 4  # fewer cannot point a hand: not an arm


def find_flange(name: str, outline: RobotOutline) -> str:
    """The link that carries the hand: one with a usual name, else what a whole robot's hand hangs on, else the tip.

    Raises:
        RobotDescriptionError: none, or several; the message lists them.
    """
    tree = outline.tree
    found = _candidates(outline)
    if not found:
        most = max(_joints_before(tree, i) for i in range(tree.num_links))
        raise RobotDescriptionError(
            f"robot '{name}' has no arm: no link is moved by {MIN_JOINTS} joints or more (the most is {most})."
        )
    return _only(name, found)


def further_flange(outline: RobotOutline, flange: str) -> str:
    """A sentence when the chain goes on from `flange` to a link that more joints move; "" when it does not."""
    tree = outline.tree
    if flange not in tree.link_names:
        return ""
    at = tree.link_names.index(flange)
    here = _joints_before(tree, at)
    beyond = [n for n in _candidates(outline) if at in _links_before(tree, tree.link_names.index(n))]
    there = _joints_before(tree, tree.link_names.index(beyond[0])) if len(beyond) == 1 else 0
    if there <= here:
        return ""
    return f"the flange '{flange}' is moved by {here} joints; the arm goes on to '{beyond[0]}' with {there}: cut off."


def _candidates(outline: RobotOutline) -> list[str]:
    tree = outline.tree
    joints = [_joints_before(tree, i) for i in range(tree.num_links)]
    for usual in FLANGE_NAMES:
        found = [n for n, k in zip(tree.link_names, joints, strict=True) if n.endswith(usual) and k >= MIN_JOINTS]
        if found:
            return found
    hands = [tree.link_names.index(n) for n in hand_links(outline)]
    if hands:
        return [tree.link_names[tree.parents[i]] for i in hands if i]
    parents = set(tree.parents.tolist())
    return [n for i, n in enumerate(tree.link_names) if i not in parents and joints[i] >= MIN_JOINTS]


def _links_before(tree: KinematicTree, link: int) -> list[int]:
    before = []
    while link > 0:
        link = int(tree.parents[link])
        before.append(link)
    return before


def _only(name: str, links: Sequence[str]) -> str:
    if len(links) == 1:
        return links[0]
    listed = ", ".join(f"'{n}'" for n in links)
    raise RobotDescriptionError(
        f"robot '{name}' may carry a hand on {len(links)} links ({listed}); choose one: --flange {links[0]}, or "
        f"flange='{links[0]}' in Python."
    )


def _joints_before(tree: KinematicTree, link: int) -> int:
    count = 0
    while link > 0:
        count += tree.joint_types[link] != FIXED
        link = int(tree.parents[link])
    return int(count)


def find_face(tree: KinematicTree, parts: Sequence[ConvexPart], flange: int) -> np.ndarray:
    """X_FM (4, 4): on the end of the flange link's shapes along the last joint's axis, z outwards."""
    X, link = np.eye(4), flange  # X: flange in the link
    while link > 0 and tree.joint_types[link] == FIXED:
        X = tree.X_parent_joint[link] @ X
        link = int(tree.parents[link])
    axis = X[:3, :3].T @ tree.axes[link] if link else np.array([0.0, 0.0, 1.0])
    before = np.linalg.inv(tree.X_parent_joint[link] @ X)[:3, 3] if link else np.zeros(3)
    if axis @ -before < -1e-6:
        axis = -axis
    side = np.eye(3)[int(np.argmax(np.abs(axis) < 0.5))]
    ends = [_extent(p, axis) for p in parts if p.link == flange]
    return frame_from_axes(max([0.0, *ends]) * axis, side, axis)


def _extent(part: ConvexPart, axis: np.ndarray) -> float:
    mesh = part_mesh(part)
    return float((mesh.vertices @ axis).max())
