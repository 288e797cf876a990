"""Where the hand is in the file of a whole robot."""

from __future__ import annotations

import numpy as np

from neuralgrasps.errors import RobotDescriptionError
from neuralgrasps.hands.chains import rigid_bodies
from neuralgrasps.kinematics.subtree import RobotOutline
from neuralgrasps.kinematics.tree import KinematicTree

HAND_REACH = 0.35  # metres along the links from a palm to the last joint; limbs of robots are longer
WRIST_JOINTS = 3  # more joints before the palm are an arm


def find_hand(name: str, outline: RobotOutline) -> str | None:
    """The link from which the only hand of a whole robot hangs; None where the file describes just a hand.

    A hand is the outermost place where two or more movable branches of the size of a hand begin.

    Args:
        name: of the robot, for the message.
    Raises:
        RobotDescriptionError: the robot has several hands.
    """
    links = hand_links(outline)
    if len(links) > 1:
        listed = ", ".join(f"'{n}'" for n in links)
        raise RobotDescriptionError(
            f"robot '{name}' has {len(links)} hands, on the links {listed}; choose one: 'hands check --link "
            f"{links[0]}', or link='{links[0]}' in Python."
        )
    return links[0] if links else None


def hand_links(outline: RobotOutline) -> list[str]:
    """The links from which the hands of a whole robot hang; none where the file describes just a hand."""
    tree, body = outline.tree, rigid_bodies(outline.tree)
    branches = _branches(outline, body)
    reach = _reach(tree, outline.has_shape)
    forks = [b for b, starts in branches.items() if len(starts) > 1]
    above = {b: sum(b != c and _descends(tree, b, c) for c in forks) for b in forks}
    top = [b for b in forks if above[b] == 0]
    if len(top) == 1 and reach[top[0]] <= HAND_REACH and _joints_before(tree, body, top[0]) <= WRIST_JOINTS:
        return []
    hands = [b for b in forks if reach[b] <= HAND_REACH]
    hands = [b for b in hands if not any(b != c and _descends(tree, b, c) for c in hands)]
    return [tree.link_names[_lowest_link(outline, body, b, branches[b])] for b in hands]


def _branches(outline: RobotOutline, body: np.ndarray) -> dict[int, list[int]]:
    """Per rigid body the links that move on it and carry shapes, themselves or further out."""
    tree, solid = outline.tree, outline.has_shape.copy()
    for i in range(tree.num_links - 1, 0, -1):
        solid[tree.parents[i]] |= solid[i]
    found: dict[int, list[int]] = {}
    for i in range(1, tree.num_links):
        if body[i] == i and solid[i]:
            found.setdefault(int(body[tree.parents[i]]), []).append(i)
    return found


def _reach(tree: KinematicTree, has_shape: np.ndarray) -> np.ndarray:
    """(L,) longest way along the joints' origins from each link outwards to one with shape, metres."""
    reach = np.where(has_shape, 0.0, -np.inf)
    step = np.linalg.norm(tree.X_parent_joint[:, :3, 3], axis=1)
    for i in range(tree.num_links - 1, 0, -1):
        parent = tree.parents[i]
        reach[parent] = max(reach[parent], reach[i] + step[i])
    return reach


def _descends(tree: KinematicTree, link: int, ancestor: int) -> bool:
    while link > ancestor:
        link = int(tree.parents[link])
    return link == ancestor


def _joints_before(tree: KinematicTree, body: np.ndarray, link: int) -> int:
    count = 0
    while link > 0:
        count += bool(body[link] == link)
        link = int(tree.parents[link])
    return count


def _lowest_link(outline: RobotOutline, body: np.ndarray, fork: int, starts: list[int]) -> int:
    """The link of the body `fork` that carries all its branches and, with what is fixed to it, some shape."""
    tree, own = outline.tree, [int(i) for i in np.flatnonzero(body == fork)]
    carries_all = [i for i in own if all(_descends(tree, s, i) for s in starts)]
    shaped = [i for i in carries_all if any(outline.has_shape[k] and _descends(tree, k, i) for k in own)]
    return max(shaped or carries_all)
