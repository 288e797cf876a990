"""Torque limits that make sense at the fingertips: files often state a motor's peak, or a placeholder."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from neuralgrasps.hands.closing import MovableHand, sliding_joints
from neuralgrasps.hands.notes import HandNotes

STRONG_TIP_N = 20.0  # more throws a can out of the fingers; robot fingers press with 5 to 15 N
WEAK_TIP_N = 0.5
MARGIN = 1.25  # nobody minds a quarter more
MIN_LEVER = 0.015  # metres
BENT = 0.4  # of the way to closed: joints that turn a straight finger about itself have their lever there


def limit_efforts(model: MovableHand, notes: HandNotes) -> tuple[HandNotes, tuple[str, ...]]:
    """Notes in which no turning joint of a finger presses with more than `STRONG_TIP_N` at the fingertips it moves.

    Jaws, sliding joints, wrists and efforts stated in the notes stay.

    Returns:
        the notes, and a sentence on what was lowered or is doubtful.
    """
    tree, joints = model.tree, dict(notes.joints)
    if notes.is_jaw:
        return notes, ()
    q_open = np.array([joints[n].open for n in tree.dof_names], float)
    closing = np.array([joints[n].close for n in tree.dof_names], float)
    end = np.where(closing > 0, tree.upper, np.where(closing < 0, tree.lower, q_open))
    q_bent = q_open + BENT * (end - q_open)
    slides, lowered, weak = sliding_joints(tree), [], []
    for j, name in enumerate(tree.dof_names):
        if slides[j] or joints[name].effort is not None or model.moved[list(model.palm_links), j].any():
            continue
        levers = np.maximum(_levers(model, j, q_open), _levers(model, j, q_bent))
        most = STRONG_TIP_N * float(levers.sum())
        if tree.effort[j] > MARGIN * most:
            joints[name] = replace(joints[name], effort=most)
            lowered.append(f"{name} {tree.effort[j]:.3g} to {most:.2g}")
        elif joints[name].close and len(levers) and tree.effort[j] < WEAK_TIP_N * float(levers.sum()):
            weak.append(name)
    said = []
    if lowered:
        said.append(
            f"torques lowered to what presses with {STRONG_TIP_N:g} N at a fingertip, N m: {', '.join(lowered)}; state "
            "'effort' in hand.toml for others."
        )
    if weak:
        said.append(f"less than {WEAK_TIP_N:g} N at a fingertip from {', '.join(weak)}: is the effort in N m?")
    return replace(notes, joints=joints), tuple(said)


def _levers(model: MovableHand, dof: int, q: np.ndarray) -> np.ndarray:
    """(n,) metres: for each finger that a joint moves, how far its tip is from the axis nearest to the palm."""
    tree, X, tips = model.tree, model.poses(q), model.tips(q)
    levers = []
    for f, finger in enumerate(model.fingers):
        moving = [i for i in finger if tree.coupling[i, dof] != 0]
        if moving:
            i = moving[0]
            arm, axis = tips[f] - X[i, :3, 3], X[i, :3, :3] @ tree.axes[i]
            lever = float(np.linalg.norm(arm - (arm @ axis) * axis)) / abs(float(tree.coupling[i, dof]))
            levers.append(max(lever, MIN_LEVER))
    return np.array(levers)
