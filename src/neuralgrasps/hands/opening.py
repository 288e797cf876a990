"""How wide a hand of upright fingers opens: as far outwards as helps to get around an object."""

from __future__ import annotations

import numpy as np

from neuralgrasps.hands.closing import MovableHand, sliding_joints
from neuralgrasps.hands.contact import ALLOWED_DEPTH, SelfContact
from neuralgrasps.hands.radial import OPEN_TILT

UPRIGHT = np.radians(45.0)  # fingers that lean further from the palm's normal lie beside it and are open at zero
_STEPS = 12


def lean_outwards(
    model: MovableHand, contact: SelfContact, closing: np.ndarray, q_open: np.ndarray, q_closed: np.ndarray,
    normal: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """The open posture with fingers that stand upright on the palm leaned outwards by up to `OPEN_TILT`.

    Only the innermost closing joint of a finger opens, within its limits and as long as no links collide. Fingers that
    lie in the palm's plane, and sliding ones, stay.

    Args:
        closing: (J,) signed closing shares; q_open, q_closed: (J,) postures. normal: (3,) of the palm, unit.
    """
    tree = model.tree
    moves = _lateral(model.tips(q_open + 0.3 * (q_closed - q_open)) - model.tips(q_open), normal)
    ends = np.where(closing > 0, tree.lower, tree.upper)
    q = q_open.copy()
    for f, finger in enumerate(model.fingers):
        joint = _innermost(model, closing, finger)
        speed = float(np.linalg.norm(moves[f]))
        if joint is None or sliding_joints(tree)[joint] or speed < 1e-4:
            continue
        inward = moves[f] / speed
        if not all(_lean(model, g, q_open, normal, inward) < UPRIGHT for g in _moved_by(model, joint)):
            continue
        for share in np.linspace(1.0, 0.0, _STEPS, endpoint=False):
            trial = q.copy()
            trial[joint] = q[joint] + share * (ends[joint] - q[joint])
            if _lean(model, f, trial, normal, inward) <= OPEN_TILT and contact.depth(trial) <= ALLOWED_DEPTH:
                q = trial
                break
    return q


def _lateral(vectors: np.ndarray, normal: np.ndarray) -> np.ndarray:
    return vectors - np.outer(vectors @ normal, normal)


def _innermost(model: MovableHand, closing: np.ndarray, finger: tuple[int, ...]) -> int | None:
    found = [int(j) for i in finger for j in np.flatnonzero(model.tree.coupling[i]) if closing[j] != 0]
    return found[0] if found else None


def _moved_by(model: MovableHand, joint: int) -> list[int]:
    return [f for f, finger in enumerate(model.fingers) if model.moved[list(finger), joint].any()]


def _lean(model: MovableHand, finger: int, q: np.ndarray, normal: np.ndarray, inward: np.ndarray) -> float:
    """Outward lean of a finger from its root to its tip, radians; more than a right angle if it hangs down."""
    reach = model.tips(q)[finger] - model.poses(q)[model.fingers[finger][0], :3, 3]
    sideways = reach - (reach @ normal) * normal
    outward = -float(sideways @ inward)
    across = float(np.linalg.norm(sideways + outward * inward))
    return float(np.arctan2(max(outward, 0.0) + across, reach @ normal))
