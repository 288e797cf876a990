"""Precision or power: which parts of the hand a grasp touches the object with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.hands.hand import Hand


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactKinds:
    """What touches in N grasps.

    Attributes:
        palm_contact: (N,) bool, a link that belongs to no finger touches.
        finger_count: (N,) int32, fingers that touch with any link.
        precision: (N,) bool, contacts lie on fingertips only; all others are power grasps.
    Source:
        The two classes of Napier 1956: between the tips, or against the palm and the inner phalanges.
    """

    palm_contact: np.ndarray
    finger_count: np.ndarray
    precision: np.ndarray


def contact_kinds(hand: Hand, contact_links: np.ndarray) -> ContactKinds:
    """Label N grasps by the links that touch.

    A fingertip is the outermost link of a finger that has a surface, with whatever is fixed to it.

    Args:
        hand: names the fingers.
        contact_links: (N, C) link of each contact, -1 for none.
    """
    owner, tip = finger_of_link(hand), _is_fingertip(hand)
    touched = contact_links >= 0
    links = np.where(touched, contact_links, 0)
    finger = np.where(touched, owner[links], -2)
    fingers = np.zeros(len(links), np.int32)
    for i in range(len(hand.fingers)):
        fingers += (finger == i).any(axis=1)
    on_tips = np.logical_or(tip[links], ~touched)
    return ContactKinds(
        palm_contact=(finger == -1).any(axis=1),
        finger_count=fingers,
        precision=np.logical_and(touched.any(axis=1), on_tips.all(axis=1)),
    )


def finger_of_link(hand: Hand) -> np.ndarray:
    """(L,) index of the finger that a link belongs to, -1 for the palm."""
    owner = np.full(hand.tree.num_links, -1)
    for index, finger in enumerate(hand.fingers):
        owner[list(finger.links)] = index
    return owner


def _is_fingertip(hand: Hand) -> np.ndarray:
    """(L,) bool: the outermost link with a surface of each finger, and links that move with it as one body."""
    solid = {part.link for part in hand.parts}
    tip = np.zeros(hand.tree.num_links, bool)
    for finger in hand.fingers:
        own = [link for link in finger.links if link in solid]
        if own:
            body = _body(hand, own[-1])
            tip[[link for link in finger.links if _body(hand, link) == body]] = True
    return tip


def _body(hand: Hand, link: int) -> int:
    """The innermost link that `link` is rigidly fixed to."""
    while link > 0 and not hand.tree.coupling[link].any():
        link = int(hand.tree.parents[link])
    return link
