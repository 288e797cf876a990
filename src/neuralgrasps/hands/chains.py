"""Which links form the palm and the fingers of a kinematic tree."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neuralgrasps.hands.hand import ConvexPart
from neuralgrasps.kinematics.tree import FIXED, KinematicTree


def moved_links(tree: KinematicTree) -> np.ndarray:
    """(L, J) bool: does link i move when independent joint j moves?"""
    moved = tree.coupling != 0
    for i, parent in enumerate(tree.parents):
        if parent >= 0:
            moved[i] |= moved[parent]
    return moved


def rigid_bodies(tree: KinematicTree) -> np.ndarray:
    """(L,) the first link of the rigid body that each link belongs to; fixed joints join links."""
    body = np.arange(tree.num_links)
    for i, parent in enumerate(tree.parents):
        if parent >= 0 and tree.joint_types[i] == FIXED:
            body[i] = body[parent]
    return body


def find_fingers(tree: KinematicTree, parts: Sequence[ConvexPart]) -> tuple[int, tuple[tuple[int, ...], ...]]:
    """The palm and the fingers, from where the tree branches.

    The palm is the last rigid body from which all tips (bodies with geometry and none further out) descend. A finger
    is the path from it to the farthest tip of one branch.

    Returns:
        first link of the palm's rigid body; per finger its links, proximal first, links of tips' rigid bodies included.
    """
    body = rigid_bodies(tree)
    solid = {int(body[p.link]) for p in parts}
    above = {int(b): int(body[tree.parents[b]]) for b in np.unique(body) if tree.parents[b] >= 0}
    paths = {b: _path(b, above) for b in solid}
    inner = {a for path in paths.values() for a in path[:-1]}
    tips = sorted(b for b in solid if b not in inner)
    if len(tips) < 2:
        palm = 0
    else:
        shared = [a for a in paths[tips[0]] if all(a in paths[t] for t in tips)]
        palm = shared[-1]
    branches: dict[int, list[int]] = {}
    for tip in tips:
        path = paths[tip]
        if tip != palm:
            outer = path[path.index(palm) + 1 :]
            if len(outer) > len(branches.get(outer[0], ())):
                branches[outer[0]] = outer
    fingers = tuple(
        tuple(i for b in branch for i in range(tree.num_links) if body[i] == b) for branch in branches.values()
    )
    return palm, fingers


def _path(body: int, above: dict[int, int]) -> list[int]:
    path = [body]
    while path[0] in above:
        path.insert(0, above[path[0]])
    return path
