"""Which finger is the thumb of a hand without notes, and how it turns to meet the others."""

from __future__ import annotations

import numpy as np

from neuralgrasps.hands.closing import MovableHand, unit
from neuralgrasps.hands.notes import HandNotes
from neuralgrasps.hands.radial import alike

PRESHAPE_SHARE = 0.45  # of the way from open to closed
LATE_MEETING, SAME_WAY = 0.05, 0.03  # metres of gap that a last-moment, or an unopposed, meeting is worth
HELD_WIDTH = 0.035  # metres: tips that pass each other no farther apart hold an object of everyday size between them
_GRID = 7


def lateral_motion(model: MovableHand, q_open: np.ndarray, q_closed: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(F, 3) movement of each tip along the palm while the hand closes by 70 %."""
    motion = model.tips(q_open + 0.7 * (q_closed - q_open)) - model.tips(q_open)
    return motion - np.outer(motion @ normal, normal)


def find_thumb(model: MovableHand, q_open: np.ndarray, q_closed: np.ndarray, normal: np.ndarray) -> int | None:
    """The finger called thumb, or of three or more the one that closes most against the others."""
    named = named_thumb(model)
    if named is not None or len(model.fingers) < 3:
        return named
    motion = lateral_motion(model, q_open, q_closed, normal)
    agreement = [unit(m) @ unit(np.delete(motion, f, axis=0).sum(axis=0)) for f, m in enumerate(motion)]
    f = int(np.argmin(agreement))
    return f if agreement[f] < 0.5 else None


def named_thumb(model: MovableHand) -> int | None:
    tree = model.tree
    for f, finger in enumerate(model.fingers):
        names = [tree.link_names[i].lower() for i in finger] + [tree.joint_names[i].lower() for i in finger]
        if any("thumb" in n for n in names):
            return f
    return None


def given_thumb(given: HandNotes) -> int | None:
    return next((f for f, finger in enumerate(given.fingers or ()) if finger.thumb), None)


def own_dofs(model: MovableHand, finger: int) -> list[int]:
    """Joints that move this finger alone, proximal first."""
    links = list(model.fingers[finger])
    others = np.setdiff1d(np.arange(model.tree.num_links), links)
    own = model.moved[links].any(axis=0) & ~model.moved[others].any(axis=0)
    return [int(j) for j in np.flatnonzero(own)]


def oppose_thumb(
    model: MovableHand, closing: np.ndarray, thumb: int, q_open: np.ndarray, q_closed: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Turn the thumb to where its tip meets the other fingertips best while all close together.

    Searched: its joints that do not close, and closing ones whose zero is far from their open end.
    """
    tree, own = model.tree, own_dofs(model, thumb)
    slack = np.abs(q_open - np.where(closing > 0, tree.lower, tree.upper)) / (tree.upper - tree.lower)
    is_like_others = all(alike(model, thumb, f) for f in range(len(model.fingers)))
    turned = [j for j in own if closing[j] == 0 or (slack[j] > 0.3 and not is_like_others)][:3]
    if not turned or len(model.fingers) < 2:
        return q_open, q_closed
    fixed = [k for k, j in enumerate(turned) if closing[j] == 0]
    axes = [np.linspace(tree.lower[j], tree.upper[j], _GRID) for j in turned]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(turned))
    share = _closing_shares_over_time(tree.num_dofs, own)
    costs = np.empty(len(grid))
    for k, values in enumerate(grid):
        start, end = q_open.copy(), q_closed.copy()
        start[turned] = values
        end[[turned[f] for f in fixed]] = values[fixed]
        tips = model.tips(start + share * (end - start))  # (starts, times, F, 3)
        costs[k] = _meeting_cost(tips, thumb).min(axis=1).mean()
    best = grid[int(np.argmin(costs))]
    q_open, q_closed = q_open.copy(), q_closed.copy()
    q_open[turned] = best
    q_closed[[turned[f] for f in fixed]] = best[fixed]
    return q_open, q_closed


def _meeting_cost(tips: np.ndarray, thumb: int) -> np.ndarray:
    """(starts, times - 1) metres: how badly the thumb of closing hands meets the two nearest tips at each time.

    The gap, more for a late meeting (little room for an object) and for tips that move the same way (no pinch).
    """
    own, others = tips[:, :, thumb : thumb + 1], np.delete(tips, thumb, axis=2)
    gaps = np.sort(np.linalg.norm(others - own, axis=3), axis=2)[:, 1:, :2].mean(axis=2)
    gaps = np.maximum(gaps - HELD_WIDTH, 0.0)
    u, v = np.diff(own, axis=1)[:, :, 0], np.diff(others, axis=1).mean(axis=2)
    speeds = np.linalg.norm(u, axis=2) * np.linalg.norm(v, axis=2)
    agreement = (u * v).sum(axis=2) / np.maximum(speeds, 1e-12)
    return gaps + LATE_MEETING * np.linspace(0, 1, gaps.shape[1]) + SAME_WAY * agreement


def _closing_shares_over_time(num_dofs: int, thumb_dofs: list[int]) -> np.ndarray:
    """(9 starts, 9 times, J) how far each joint is from open to closed, from nine preshapes of fingers and thumb."""
    starts = PRESHAPE_SHARE * np.array([0.0, 0.5, 1.0])
    fingers, own = (v.ravel()[:, None, None] for v in np.meshgrid(starts, starts, indexing="ij"))
    is_thumb = np.isin(np.arange(num_dofs), thumb_dofs)
    return np.clip(np.where(is_thumb, own, fingers) + np.linspace(0.0, 1.0, 9)[:, None], 0.0, 1.0)
