"""Parallel jaws: whether a hand is one, two sliders made one joint, and where the pads are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from neuralgrasps.hands.closing import MovableHand, closing_shares, movable_hand, open_and_closed, sliding_joints, unit
from neuralgrasps.hands.hand import ConvexPart
from neuralgrasps.hands.linkages import tips_stay_parallel
from neuralgrasps.hands.notes import HandNotes
from neuralgrasps.kinematics.tree import KinematicTree

PAD_LENGTH = 0.02  # metres of a jaw's finger taken as its pad


def finger_dofs(model: MovableHand) -> list[int]:
    """Joints that move fingers but not the palm."""
    return [j for j in range(model.tree.num_dofs) if not model.moved[list(model.palm_links), j].any()]


def has_jaw_motion(model: MovableHand) -> bool:
    """Two fingers on one joint whose tips slide, or are swung without turning, straight towards each other."""
    tree = model.tree
    if len(model.fingers) != 2 or len(finger_dofs(model)) != 1:
        return False
    closing = closing_shares(model)
    q_open, q_closed = open_and_closed(model, closing)
    if not closing.any() or not tips_stay_parallel(tree, model.tip_link, q_open, q_closed):
        return False
    first, second = model.tips(q_closed) - model.tips(q_open)
    across = unit(model.tips(q_open)[1] - model.tips(q_open)[0])
    along = unit(first + second)
    first, second = (m - (m @ along) * along for m in (first, second))  # swung tips also move out of the palm
    return bool(unit(first) @ unit(second) < -0.95 and abs(unit(first) @ across) > 0.9)


def jaw_pad(model: MovableHand, q: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Middle between the inner faces of two fingers, over the outer `PAD_LENGTH` of the fingers, in H."""
    tips = model.tips(q)
    across = unit(tips[1] - tips[0])
    faces = []
    for f, finger in enumerate(model.fingers):
        points, normals = model.cloud_H(finger, q)
        inner = normals @ across * (1.0 if f == 0 else -1.0) > 0.9
        points = points[inner] if inner.any() else tips[f : f + 1]
        height = points @ normal
        end = points[height > height.max() - PAD_LENGTH]
        middle = (end.min(axis=0) + end.max(axis=0)) / 2
        faces.append(middle + (height.max() - PAD_LENGTH / 2 - middle @ normal) * normal)
    return (faces[0] + faces[1]) / 2


def couple_jaw(
    name: str, tree: KinematicTree, parts: Sequence[ConvexPart], given: HandNotes
) -> tuple[KinematicTree, tuple[str, ...]]:
    """One joint for a jaw whose two fingers slide independently in the file, as many grippers are described.

    The first joint remains; the second follows it millimetre by millimetre, closed where the first is closed. Joints of
    a wrist stay. Notes on the second joint mean that the two are to stay independent.

    Returns:
        the tree (changed or not), and one sentence if it was changed.
    """
    if tree.num_dofs < 2 or np.count_nonzero(sliding_joints(tree)) < 2 or given.is_jaw is False:
        return tree, ()
    model = movable_hand(name, tree, parts, given)
    dofs = finger_dofs(model)
    closing = closing_shares(model)
    if len(model.fingers) != 2 or len(dofs) != 2 or not (sliding_joints(tree) & (closing != 0))[dofs].all():
        return tree, ()
    a, b = dofs
    first, second = tree.dof_names[a], tree.dof_names[b]
    if second in given.joints:
        return tree, ()
    opening = -np.sign(closing)
    closed = np.where(opening > 0, tree.lower, tree.upper)
    slope = float(opening[a] * opening[b])
    constant = float(closed[b] - slope * closed[a])  # second = slope * first + constant
    travel = float((tree.upper - tree.lower)[dofs].min())
    lower, upper, coupling = tree.lower.copy(), tree.upper.copy(), tree.coupling.copy()
    lower[a], upper[a] = sorted((float(closed[a]), float(closed[a] + opening[a] * travel)))
    coupling[:, a] += slope * coupling[:, b]
    kept = np.arange(tree.num_dofs) != b
    coupled = replace(
        tree,
        coupling=coupling[:, kept],
        offset=tree.offset + constant * tree.coupling[:, b],
        dof_names=tuple(n for n in tree.dof_names if n != second),
        lower=lower[kept],
        upper=upper[kept],
        effort=tree.effort[kept],
    )
    return coupled, (f"joints '{first}' and '{second}' were coupled: both fingers of a jaw move together.",)
