"""One limb of a robot: the links below a chosen one, cut out before anything else in the file is looked at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from neuralgrasps.errors import RobotDescriptionError, unknown_name
from neuralgrasps.kinematics.assemble import JointSpec
from neuralgrasps.kinematics.tree import KinematicTree


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobotOutline:
    """A robot file without its shapes: the tree, and which links (L,) have some."""

    tree: KinematicTree
    has_shape: np.ndarray


def cut_limb(
    source: str, links: Sequence[str], joints: Sequence[JointSpec], root: str, notes: list[str]
) -> tuple[list[str], list[JointSpec]]:
    """The links from `root` outwards and the joints between them, in the order given.

    A joint that mimics one outside moves by itself. Remarks in `notes` on joints outside are taken back.

    Raises:
        RobotDescriptionError: no link of this name.
    """
    if root not in links:
        raise RobotDescriptionError(f"{source}: {unknown_name('link', root, links)}")
    kept = {root}
    grows = True
    while grows:
        more = {j.child for j in joints if j.parent in kept} - kept
        kept |= more
        grows = bool(more)
    inside = [j for j in joints if j.parent in kept and j.child in kept and j.child != root]
    names = {j.name for j in inside}
    outside = [f"joint '{j.name}'" for j in joints if j.name not in names]
    notes[:] = [n for n in notes if not any(o in n for o in outside)]
    for k, joint in enumerate(inside):
        if joint.mimic is not None and joint.mimic.joint not in names:
            notes.append(
                f"joint '{joint.name}' follows '{joint.mimic.joint}', which was cut off: it moves by itself now."
            )
            inside[k] = replace(joint, mimic=None)
    if len(kept) < len(links):
        notes.append(f"only the {len(kept)} links from '{root}' outwards were read, of {len(links)}.")
    return [n for n in links if n in kept], inside


def without_links_beyond(tree: KinematicTree, link: int) -> tuple[KinematicTree, np.ndarray]:
    """The tree less everything that hangs on `link`, and the indices (K,) of the links that stay.

    Joints of what was cut off go; a coupled one that stays keeps its leader.
    """
    beyond = np.zeros(tree.num_links, bool)
    for i in range(link + 1, tree.num_links):
        beyond[i] = tree.parents[i] == link or beyond[tree.parents[i]]
    kept = np.flatnonzero(~beyond)
    new_index = np.cumsum(~beyond) - 1
    dofs = np.flatnonzero((tree.coupling[kept] != 0).any(axis=0))
    parents = tree.parents[kept]
    cut = KinematicTree(
        link_names=tuple(tree.link_names[i] for i in kept),
        parents=np.where(parents < 0, -1, new_index[parents]).astype(np.int32),
        joint_names=tuple(tree.joint_names[i] for i in kept),
        joint_types=tree.joint_types[kept],
        X_parent_joint=tree.X_parent_joint[kept],
        axes=tree.axes[kept],
        coupling=tree.coupling[np.ix_(kept, dofs)],
        offset=tree.offset[kept],
        dof_names=tuple(tree.dof_names[d] for d in dofs),
        lower=tree.lower[dofs],
        upper=tree.upper[dofs],
        effort=tree.effort[dofs],
    )
    return cut, kept
