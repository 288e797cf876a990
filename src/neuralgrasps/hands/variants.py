"""A hand made larger or smaller, and its mirror image: people's hands differ in size, and each has a left one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.hands.hand import ConvexPart, Hand
from neuralgrasps.kinematics.tree import PRISMATIC, KinematicTree

_FLIP_Z = np.diag([1.0, 1.0, -1.0, 1.0])  # every kind of part but a hull is its own image under it


def scaled_hand(hand: Hand, scale: float, *, name: str | None = None) -> Hand:
    """The same hand with all lengths times `scale`; angles, limits of turning joints and efforts stay.

    Args:
        scale: > 0; the human hand is 252 mm from wrist to middle fingertip at 1, people's are 0.68 to 0.9.
        name: of the new hand; default the old name and the scale, "human_x0.800", with six decimals where three do
            not hold it: names tell hands apart.
    Raises:
        InputError: the scale is not positive and finite.
    """
    if not (np.isfinite(scale) and scale > 0):
        raise InputError(f"scale of hand '{hand.name}' is {scale}; expected a number above 0, such as 0.8.")
    tree, unit = hand.tree, _dof_units(hand.tree, scale)
    link_unit = np.where(tree.joint_types == PRISMATIC, scale, 1.0)
    return replace(
        hand,
        name=name or f"{hand.name}_x{scale:.{3 if round(scale, 3) == scale else 6}f}",
        tree=replace(
            tree,
            X_parent_joint=_scaled(tree.X_parent_joint, scale),
            coupling=tree.coupling * link_unit[:, None] / unit,
            offset=tree.offset * link_unit,
            lower=tree.lower * unit,
            upper=tree.upper * unit,
        ),
        parts=tuple(
            replace(part, size=part.size * scale, X_LP=_scaled(part.X_LP, scale), vertices=part.vertices * scale)
            for part in hand.parts
        ),
        X_HP=_scaled(hand.X_HP, scale),
        closing_rate=hand.closing_rate * unit,
        q_open=hand.q_open * unit,
        preshape_lower=hand.preshape_lower * unit,
        preshape_upper=hand.preshape_upper * unit,
        jaw_pad_H=hand.jaw_pad_H * scale,
    )


def mirrored_hand(hand: Hand, *, name: str | None = None) -> Hand:
    """The mirror image of a hand: a left hand of a right one. The same `q` gives the mirrored posture.

    Reflected is about the plane through the base's origin that the palm's x and z axes span: a link at X_HL comes to
    S X_HL S, with S = `mirror_matrix(hand)`.

    Args:
        name: of the new hand; default the old name and "_left".
    """
    tree, S = hand.tree, mirror_matrix(hand)
    turning = np.where(tree.joint_types == PRISMATIC, 1.0, -1.0)  # S R(a, angle) S = R(-S a, angle)
    D = np.diag([1.0, -1.0, 1.0, 1.0])  # the palm frame's own y goes the other way, so that it stays right-handed
    return replace(
        hand,
        name=name or f"{hand.name}_left",
        tree=replace(
            tree,
            X_parent_joint=S @ tree.X_parent_joint @ S,
            axes=(tree.axes @ S[:3, :3].T) * turning[:, None],
        ),
        parts=tuple(_mirrored_part(part, S) for part in hand.parts),
        X_HP=S @ hand.X_HP @ D,
        jaw_pad_H=S[:3, :3] @ hand.jaw_pad_H,
    )


def mirror_matrix(hand: Hand) -> np.ndarray:
    """(4, 4) the reflection of the base frame that `mirrored_hand` uses; its own inverse."""
    normal = hand.X_HP[:3, 1]
    S = np.eye(4)
    S[:3, :3] -= 2.0 * np.outer(normal, normal)
    return S


def _mirrored_part(part: ConvexPart, S: np.ndarray) -> ConvexPart:
    return replace(
        part,
        X_LP=S @ part.X_LP @ _FLIP_Z,
        vertices=part.vertices * [1.0, 1.0, -1.0],
        faces=np.ascontiguousarray(part.faces[:, ::-1]),
    )


def _dof_units(tree: KinematicTree, scale: float) -> np.ndarray:
    """(J,) `scale` for joints that slide, 1 for those that turn; a joint is what the link of its own name does."""
    unit = np.ones(tree.num_dofs)
    for dof, name in enumerate(tree.dof_names):
        own = [i for i, joint in enumerate(tree.joint_names) if joint == name]
        moved = own or np.flatnonzero(tree.coupling[:, dof]).tolist()
        if moved and tree.joint_types[moved[0]] == PRISMATIC:
            unit[dof] = scale
    return unit


def _scaled(X: np.ndarray, scale: float) -> np.ndarray:
    out = np.array(X, np.float64)
    out[..., :3, 3] *= scale
    return out
