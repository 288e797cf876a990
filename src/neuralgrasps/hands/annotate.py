"""Automatic annotation of a hand from its kinematics and geometry: no notes by hand needed.

Everything is measured by moving the model: fingers are the branches of the tree; a finger's flexion joints are those
parallel to its last one; they close towards the end of their range where the fingertip is nearer to the palm and to the
other tips; the palm faces where closing fingertips go; the thumb is the finger that closes against the others. Equal
fingers around an axis are recognised first and treated alike (see `radial`). Doubts are said, never hidden.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from neuralgrasps.errors import RobotDescriptionError
from neuralgrasps.hands.chains import find_fingers
from neuralgrasps.hands.closing import (
    MovableHand,
    closing_shares,
    movable_hand,
    open_and_closed,
    share_to_nearest_tips,
    sliding_joints,
    unit,
)
from neuralgrasps.hands.contact import SelfContact, doubts
from neuralgrasps.hands.efforts import limit_efforts
from neuralgrasps.hands.followers import branch_doubts, counted_fingers
from neuralgrasps.hands.hand import ConvexPart
from neuralgrasps.hands.jaws import has_jaw_motion, jaw_pad
from neuralgrasps.hands.notes import FingerNotes, HandNotes, JointNotes
from neuralgrasps.hands.opening import lean_outwards
from neuralgrasps.hands.radial import RadialHand, radial_hand
from neuralgrasps.hands.thumb import (
    PRESHAPE_SHARE,
    find_thumb,
    given_thumb,
    lateral_motion,
    named_thumb,
    oppose_thumb,
    own_dofs,
)
from neuralgrasps.kinematics.notes_table import frame_from_axes
from neuralgrasps.kinematics.tree import KinematicTree

HALF_CLOSED = 0.5
WIDE_SPREAD = 1.5  # rad: a sideways joint with more range than this is a spread to choose freely
FREE_RANGE, QUARTER_TURN = 4.5, np.pi / 2  # rad: a wider joint has no real limits; it is used this far either way
SIDEWAYS_MARGIN = 0.2  # rad: how far joints across the closing direction stray in a preshape of equal fingers
UNCLEAR_SIDE = 0.1
BEFORE_MEETING = 0.7  # share of the way to where links meet that a preshape takes at most: room for an object


def complete_notes(
    name: str, tree: KinematicTree, parts: Sequence[ConvexPart], given: HandNotes
) -> tuple[HandNotes, tuple[str, ...]]:
    """Fill every gap of `given`.

    Args:
        name: the robot's name.
        tree: kinematic tree; parts: its solids.
        given: what is known already; it is never overruled.
    Returns:
        notes with palm, fingers and all joints, and one sentence per guess.
    Raises:
        RobotDescriptionError: no joints, or no fingers to be found and none given.
    """
    if tree.num_dofs == 0:
        raise RobotDescriptionError(f"hand '{name}' has no movable joints; expected at least one.")
    if given.fingers is not None:
        _check_jaw(name, given, [f.name for f in given.fingers])
    if _is_complete(tree, given):
        return given, ()
    model = movable_hand(name, _working_ranges(tree), parts, given)
    if given.fingers is None:
        _check_jaw(name, given, [tree.link_names[f[0]] for f in model.fingers])
    contact = SelfContact(model, parts)
    radial = None
    if not (has_jaw_motion(model) if given.is_jaw is None else given.is_jaw):
        radial = radial_hand(model, contact, normal_H=None if given.X_HP is None else given.X_HP[:3, 2])
    if radial is None:
        notes, guessed = _from_motion(
            model, contact, given, has_free_joints=not np.array_equal(model.tree.upper, tree.upper)
        )
    else:
        notes, guessed = _from_symmetry(model, radial, given)
    warning = _warning(model, contact, notes, 1.0 if radial is None else radial.certainty)
    notes, efforts = limit_efforts(model, notes)
    branches = () if given.fingers is not None else branch_doubts(model, find_fingers(tree, parts)[1])
    return notes, _sentences(tree, given, notes, guessed) + branches + efforts + warning


def _check_jaw(name: str, given: HandNotes, fingers: Sequence[str]) -> None:
    if given.is_jaw and len(fingers) != 2:
        raise RobotDescriptionError(
            f"hand '{name}': hand.toml says is_jaw = true, but {counted_fingers(len(fingers))} begin at "
            f"{', '.join(fingers)}; a parallel jaw has 2. Name these two in [[fingers]] tables of hand.toml, or say "
            "is_jaw = false."
        )


def _working_ranges(tree: KinematicTree) -> KinematicTree:
    """The tree with turning joints of no real limits (a full turn) held to a quarter turn either way."""
    is_free = (tree.upper - tree.lower > FREE_RANGE) & ~sliding_joints(tree)
    gear = np.maximum(np.abs(tree.coupling).max(axis=0), 1e-9)
    reach = QUARTER_TURN / np.maximum(gear, 1.0)
    middle = np.clip(0.0, tree.lower + reach, tree.upper - reach)
    lower = np.where(is_free, middle - reach, tree.lower)
    return replace(tree, lower=lower, upper=np.where(is_free, middle + reach, tree.upper))


def _from_motion(
    model: MovableHand, contact: SelfContact, given: HandNotes, *, has_free_joints: bool
) -> tuple[HandNotes, dict[str, JointNotes]]:
    """Notes from how the fingers move; also what was guessed per joint."""
    closing = closing_shares(model)
    q_open, q_closed = open_and_closed(model, closing)
    if has_free_joints:  # they have no ends, but the fingers meet somewhere
        q_closed = contact.last_free(q_open, q_closed)
    normal = _palm_normal(model, q_open, q_closed) if given.X_HP is None else given.X_HP[:3, 2]
    is_jaw = has_jaw_motion(model) if given.is_jaw is None else given.is_jaw
    thumb = find_thumb(model, q_open, q_closed, normal) if given.fingers is None and not is_jaw else given_thumb(given)
    if not is_jaw:
        q_open = lean_outwards(model, contact, closing, q_open, q_closed, normal)
    if not is_jaw and thumb is not None:
        q_open, q_closed = oppose_thumb(model, closing, thumb, q_open, q_closed)
    pad = (
        jaw_pad(model, q_open + HALF_CLOSED * (q_closed - q_open), normal)
        if is_jaw and given.jaw_pad_H is None
        else given.jaw_pad_H
    )
    X_HP = given.X_HP if given.X_HP is not None else _palm(model, q_open, q_closed, normal, pad)
    meeting = min(contact.share_before_fingers_meet(q_open, q_closed), share_to_nearest_tips(model, q_open, q_closed))
    share = 0.0 if is_jaw else min(PRESHAPE_SHARE, BEFORE_MEETING * meeting)
    q_narrow = q_open + share * (q_closed - q_open)
    guessed = _joint_notes(model, closing, q_open, q_narrow, normal, thumb)
    notes = replace(given, is_jaw=is_jaw, jaw_pad_H=pad, X_HP=X_HP)
    return _filled(model, notes, guessed, thumb), guessed


def _from_symmetry(model: MovableHand, radial: RadialHand, given: HandNotes) -> tuple[HandNotes, dict[str, JointNotes]]:
    """Notes of a hand with equal fingers around an axis, none of them a thumb unless it is called so."""
    tree = model.tree
    thumb = named_thumb(model) if given.fingers is None else given_thumb(given)
    X_HP = given.X_HP
    if X_HP is None:
        middle = (
            radial.centre_H + ((model.palm_centre(radial.q_open) - radial.centre_H) @ radial.axis_H) * radial.axis_H
        )
        X_HP = frame_from_axes(
            _on_palm(model, radial.q_open, middle, radial.axis_H), -radial.radial_H[0], radial.axis_H
        )
    guessed = {}
    for j, name in enumerate(tree.dof_names):
        start, end = radial.q_open[j], radial.q_open[j] + PRESHAPE_SHARE * (radial.q_closed - radial.q_open)[j]
        if radial.closing[j] == 0 and not model.moved[list(model.palm_links), j].any():
            margin = min(0.1 * (tree.upper[j] - tree.lower[j]), SIDEWAYS_MARGIN)
            start, end = max(tree.lower[j], start - margin), min(tree.upper[j], start + margin)
        guessed[name] = JointNotes(
            close=float(radial.closing[j]),
            open=float(radial.q_open[j]),
            preshape=(float(min(start, end)), float(max(start, end))),
            group="curl" if radial.closing[j] != 0 else name,
        )
    notes = replace(given, is_jaw=bool(given.is_jaw), X_HP=X_HP)
    return _filled(model, notes, guessed, thumb), guessed


def _filled(model: MovableHand, notes: HandNotes, guessed: dict[str, JointNotes], thumb: int | None) -> HandNotes:
    joints = {n: _merge(notes.joints.get(n, JointNotes()), guessed[n]) for n in model.tree.dof_names}
    return replace(notes, fingers=notes.fingers or _finger_notes(model.tree, model.fingers, thumb), joints=joints)


def _warning(model: MovableHand, contact: SelfContact, notes: HandNotes, certainty: float) -> tuple[str, ...]:
    """One sentence if the hand does not close sensibly as annotated."""
    joints = [notes.joints[n] for n in model.tree.dof_names]
    q_open, closing = np.array([j.open for j in joints], float), np.array([j.close for j in joints], float)
    q_closed = np.where(closing > 0, model.tree.upper, np.where(closing < 0, model.tree.lower, q_open))
    found = doubts(model, contact, closing, q_open, q_closed)
    if certainty < UNCLEAR_SIDE:
        found = (*found, "nothing in the file tells on which side of the base the palm is")
    if not found:
        return ()
    return (f"the annotation looks wrong: {'; '.join(found)}; override it with hand.toml.",)


def _is_complete(tree: KinematicTree, given: HandNotes) -> bool:
    def stated(joint: JointNotes | None) -> bool:
        return joint is not None and None not in (joint.close, joint.open, joint.preshape)

    top = (given.X_HP, given.fingers, given.is_jaw)
    has_pad = given.jaw_pad_H is not None or given.is_jaw is False
    return all(v is not None for v in top) and has_pad and all(stated(given.joints.get(n)) for n in tree.dof_names)


def _merge(given: JointNotes, guessed: JointNotes) -> JointNotes:
    preshape, opened = given.preshape or guessed.preshape, given.open
    if opened is None and guessed.open is not None and given.preshape is not None:
        opened = float(np.clip(guessed.open, given.preshape[0], given.preshape[1]))
    return JointNotes(
        close=guessed.close if given.close is None else given.close,
        open=guessed.open if opened is None else opened,
        preshape=preshape,
        group=given.group or guessed.group,
        effort=given.effort,
    )


# -- palm, jaw, thumb ----------------------------------------------------------


def _palm_normal(model: MovableHand, q_open: np.ndarray, q_closed: np.ndarray) -> np.ndarray:
    """Axis of the palm link that best points to where the fingertips go when the hand half closes."""
    q_half = q_open + HALF_CLOSED * share_to_nearest_tips(model, q_open, q_closed) * (q_closed - q_open)
    before, after = model.tips(q_open), model.tips(q_half)
    centre = model.palm_centre(q_half)
    outwards = unit(after.mean(axis=0) - centre)
    motion = after - before
    inwards = motion.mean(axis=0) / max(float(np.linalg.norm(motion, axis=1).mean()), 1e-9)
    R = model.poses(q_half)[model.palm, :3, :3]
    candidates = np.concatenate([R.T, -R.T])
    return candidates[int(np.argmax(candidates @ (outwards + inwards)))].copy()


def _palm(
    model: MovableHand, q_open: np.ndarray, q_closed: np.ndarray, normal: np.ndarray, pad: np.ndarray | None
) -> np.ndarray:
    """X_HP: on the palm's surface under the pads (jaws) or at the palm's middle; x is the closing direction."""
    origin = _on_palm(model, q_open, model.palm_centre(q_open) if pad is None else pad, normal)
    motion = lateral_motion(model, q_open, q_closed, normal)
    _, _, axes = np.linalg.svd(motion)
    along = axes[0] - (axes[0] @ normal) * normal
    if float(np.linalg.norm(motion)) < 1e-6 or float(np.linalg.norm(along)) < 1e-3:
        along = np.eye(3)[int(np.argmin(np.abs(normal)))]
    if motion.sum(axis=0) @ along < 0:
        along = -along
    return frame_from_axes(origin, along, normal)


def _on_palm(model: MovableHand, q: np.ndarray, point_H: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """The point moved along the normal onto the palm's surface beside it."""
    points, _ = model.cloud_H(model.palm_links, q)
    offset = points - point_H
    beside = np.linalg.norm(offset - np.outer(offset @ normal, normal), axis=1) < 0.025
    height = (offset[beside] if beside.any() else offset) @ normal
    return point_H + height.max() * normal if len(height) else point_H


# -- notes -----------------------------------------------------------------------


def _finger_notes(tree: KinematicTree, fingers: Sequence[Sequence[int]], thumb: int | None) -> tuple[FingerNotes, ...]:
    notes = []
    for f, links in enumerate(fingers):
        named = any("thumb" in tree.link_names[i].lower() for i in links)
        name = "thumb" if f == thumb and (named or len(fingers) > 3) else f"finger_{f + 1}"
        notes.append(FingerNotes(name=name, links=tuple(tree.link_names[i] for i in links), thumb=f == thumb))
    return tuple(notes)


def _joint_notes(
    model: MovableHand,
    closing: np.ndarray,
    q_open: np.ndarray,
    q_narrow: np.ndarray,
    normal: np.ndarray,
    thumb: int | None,
) -> dict[str, JointNotes]:
    """Use of every joint; closing ones start between `q_open` and `q_narrow`."""
    tree = model.tree
    thumb_dofs = set() if thumb is None else set(own_dofs(model, thumb))
    notes = {}
    for j, name in enumerate(tree.dof_names):
        if closing[j] != 0:
            start, end = q_open[j], q_narrow[j]
            group = "thumb_curl" if j in thumb_dofs else "curl"
        else:
            start, end = _sideways_range(model, j, q_open, normal, j in thumb_dofs)
            group = name
        preshape = (float(min(start, end)), float(max(start, end)))
        notes[name] = JointNotes(close=float(closing[j]), open=float(q_open[j]), preshape=preshape, group=group)
    return notes


def _sideways_range(
    model: MovableHand, j: int, q_open: np.ndarray, normal: np.ndarray, of_thumb: bool
) -> tuple[float, float]:
    """Start values of a joint that does not close: wide spreads are free, others stay near the open posture."""
    tree = model.tree
    if model.moved[list(model.palm_links), j].any():  # a wrist
        return q_open[j], q_open[j]
    span = tree.upper[j] - tree.lower[j]
    links = np.flatnonzero(tree.coupling[:, j])
    axis = model.poses(q_open)[links[0], :3, :3] @ tree.axes[links[0]]
    if not of_thumb and span > WIDE_SPREAD and abs(axis @ normal) > 0.8:
        return tree.lower[j], tree.upper[j]
    margin = (0.15 if of_thumb else 0.1) * span
    return max(tree.lower[j], q_open[j] - margin), min(tree.upper[j], q_open[j] + margin)


def _sentences(
    tree: KinematicTree, given: HandNotes, notes: HandNotes, guessed: dict[str, JointNotes]
) -> tuple[str, ...]:
    said = []
    assert notes.X_HP is not None and notes.fingers is not None
    if given.X_HP is None:
        z = ", ".join(f"{v:.2f}" for v in notes.X_HP[:3, 2])
        said.append(f"palm faces ({z}) in the base frame.")
    if given.fingers is None:
        said.append(f"{counted_fingers(len(notes.fingers))}: {', '.join(f.name for f in notes.fingers)}.")
    if given.is_jaw is None:
        said.append(
            "treated as a parallel jaw." if notes.is_jaw else "treated as a dexterous hand, not a parallel jaw."
        )
    unstated = [n for n in tree.dof_names if given.joints.get(n, JointNotes()).close is None]
    moving = [f"{n} {guessed[n].close:+.2f}" for n in unstated if guessed[n].close]
    if moving:
        said.append(f"closing rates: {', '.join(moving)}.")
    return tuple(said)
