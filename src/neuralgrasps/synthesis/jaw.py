"""The geometry of parallel jaws: apertures, widths, and where the pads' middle is at each of them."""

from __future__ import annotations

import numpy as np

from neuralgrasps.hands.hand import Hand
from neuralgrasps.kinematics.forward_kernels import forward_fast

WIDTH_SHARE = 0.97  # of a jaw's aperture: in a wider grip an error of pose of 2 mm already meets a finger
_CLOSURES = 33  # at which a jaw's pads are looked at; odd, so that one is half way


def _closed(hand: Hand) -> np.ndarray:
    """(J,) the open posture with every closing joint at its limit."""
    end = np.where(hand.closing_rate > 0, hand.tree.upper, hand.tree.lower)
    return np.where(hand.closing_rate != 0, end, hand.q_open)


def jaw_aperture(hand: Hand) -> float:
    """Largest object width, metres, that fits between the open pads of a parallel jaw whose closed pads meet."""
    opened_H, closed_H = forward_fast(hand.tree, np.stack([hand.q_open, _closed(hand)]))
    advance = (closed_H - opened_H)[:, :3, 3] @ hand.X_HP[:3, 0]
    return float(advance.max() - advance.min())


def _closures(hand: Hand) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """A jaw on its way to: joints (S, J), how far its pads are apart (S,), and the middle between them (S, 3) in H.

    `hand.jaw_pad_H` is the middle half closed; the two fingertips' points there are followed. None without two tips.
    """
    tips = [finger.links[-1] for finger in hand.fingers if finger.links]
    if len(tips) != 2:
        return None
    share = np.linspace(0.0, 1.0, _CLOSURES)
    q = hand.q_open + share[:, None] * (_closed(hand) - hand.q_open)
    X_HL = forward_fast(hand.tree, q)[:, tips]
    half = X_HL[_CLOSURES // 2]
    pad_L = np.einsum("tji,tj->ti", half[:, :3, :3], hand.jaw_pad_H - half[:, :3, 3])
    points = np.einsum("stij,tj->sti", X_HL[..., :3, :3], pad_L) + X_HL[..., :3, 3]
    apart = np.abs((points[:, 1] - points[:, 0] - (points[-1, 1] - points[-1, 0])) @ hand.X_HP[:3, 0])
    return q, apart, points.mean(axis=1)


def pad_middles(hand: Hand, widths: np.ndarray) -> np.ndarray:
    """(N, 3) middle between a jaw's pads, in H, when they are `widths` (N,) metres apart.

    Pads that a linkage swings move along the approach while they close. For pads that slide it is the same for all.
    """
    found = _closures(hand)
    if found is None:
        return np.repeat(hand.jaw_pad_H[None], len(widths), axis=0)
    _, apart, middle = found
    return np.stack([np.interp(widths, apart[::-1], column[::-1]) for column in middle.T], axis=1)


def jaw_postures(hand: Hand, widths: np.ndarray) -> np.ndarray:
    """(N, J) joints of a parallel jaw whose pads are `widths` (N,) metres apart."""
    found = _closures(hand)
    if found is None:
        share = 1.0 - np.clip(widths / jaw_aperture(hand), 0.0, 1.0)
        return hand.q_open + share[:, None] * (_closed(hand) - hand.q_open)
    q, apart, _ = found
    return np.stack([np.interp(widths, apart[::-1], column[::-1]) for column in q.T], axis=1)


def jaw_widths(hand: Hand, q: np.ndarray) -> np.ndarray:
    """(N,) distance between the pads of a parallel jaw at joints q (N, J), metres."""
    X_HL = forward_fast(hand.tree, np.concatenate([_closed(hand)[None], q]))
    apart = (X_HL[1:] - X_HL[:1])[:, :, :3, 3] @ hand.X_HP[:3, 0]
    return apart.max(axis=1) - apart.min(axis=1)


def widest_grip(hand: Hand) -> float:
    """Width, metres, beyond which a jaw cannot be put over an object whose pose is not known exactly."""
    aperture = jaw_aperture(hand)
    return min(aperture - 2.0e-3, WIDTH_SHARE * aperture)


def leaves_room(hand: Hand, q: np.ndarray) -> np.ndarray:
    """(N,) bool: a jaw at joints q (N, J) closes on at most `WIDTH_SHARE` of its aperture; True for other hands."""
    if not hand.is_jaw or len(q) == 0:
        return np.ones(len(q), bool)
    return jaw_widths(hand, q) <= WIDTH_SHARE * jaw_aperture(hand)
