"""`neuralgrasps hands`: list, show, and check any robot file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from neuralgrasps.cli.options import NamePath, OptionalFile
from neuralgrasps.cli.outputs import check_writable
from neuralgrasps.cli.terminal import Cell, Outcome, Terminal

if TYPE_CHECKING:
    import numpy as np

    from neuralgrasps.hands.hand import Hand

_CLOSED_SHARE = 0.6  # of the way to the limits: all the way, most hands would run through themselves


def list_hands(terminal: Terminal, /) -> Outcome:
    """List the hands that come with the library."""
    from neuralgrasps.hands.zoo import hand_names, load_hand

    hands = [load_hand(name) for name in hand_names()]
    rows = [(h.name, h.num_dofs, len(h.fingers), "jaw" if h.is_jaw else "fingers", h.licence) for h in hands]
    terminal.table(("hand", "joints", "fingers", "kind", "licence"), rows)
    terminal.say("Any URDF or MJCF file works too: neuralgrasps hands check my_hand.urdf")
    return Outcome(result={"hands": [hand_record(h) for h in hands]})


def show_hand(terminal: Terminal, name: NamePath, /, *, picture: OptionalFile = None) -> Outcome:
    """Show joints, fingers and provenance of a hand.

    Args:
        name: built-in name, or a URDF or MJCF file.
        picture: PNG file to draw the hand into, open and half closed.
    """
    from neuralgrasps.hands.zoo import load_hand

    if picture is not None:
        check_writable(picture)
    hand = load_hand(name)
    return _described(terminal, hand, picture)


def check_hand(
    terminal: Terminal,
    path: NamePath,
    /,
    *,
    picture: OptionalFile = None,
    missing_meshes: Literal["error", "skip"] = "error",
) -> Outcome:
    """Read any URDF or MJCF file as a hand: what was mended, what was derived, and, if asked for, a picture.

    A `hand.toml` or `<file>.toml` beside the file overrides whatever was derived.

    Args:
        path: a URDF or MJCF file, or a folder with one.
        picture: PNG file for the hand, open on the left and half closed on the right.
        missing_meshes: skip leaves out link shapes whose mesh files are missing.
    """
    from neuralgrasps.hands.zoo import load_hand

    if picture is not None:
        check_writable(picture)
    hand = load_hand(Path(path) if Path(path).exists() else path, missing_meshes=missing_meshes)
    outcome = _described(terminal, hand, picture)
    repairs, derived = lines_of(hand, "repairs"), lines_of(hand, "annotated")
    terminal.notes(repairs, title="\nMended:")
    terminal.notes(derived, title="\nDerived:")
    if picture is None:
        terminal.say("\nSee it open and half closed: add --picture hand.png")
    if missing_meshes == "skip" and any("left out" in line for line in repairs):
        terminal.say(f"\n'{hand.name}' lacks the shapes left out above; put their meshes there before you use it.")
    else:
        terminal.say(f"\n'{hand.name}' can be used: neuralgrasps synthesise --hand {path} --object mustard_bottle")
    return Outcome(result={**outcome.result, "repairs": repairs, "derived": derived})


def _described(terminal: Terminal, hand: Hand, picture: Path | None) -> Outcome:
    kind = "parallel jaw" if hand.is_jaw else f"{len(hand.fingers)} fingers"
    facts: list[tuple[str, Cell]] = [
        ("joints", hand.num_dofs),
        ("kind", kind),
        ("convex parts", len(hand.parts)),
        ("licence", hand.licence),
    ]
    terminal.say(hand.name)
    terminal.facts([*facts, ("source", " ".join(hand.provenance.split()))])
    terminal.table(("joint", "unit", "lower", "upper", "open", "closes", "finger"), _joint_rows(hand))
    terminal.notes(followers(hand), title="Joints that follow another:")
    if picture is not None:
        save_hand_picture(hand, picture)
        terminal.say(f"Picture: {picture}")
    return Outcome(result={**hand_record(hand), **({"picture": str(picture)} if picture else {})})


def hand_record(hand: Hand) -> dict[str, Any]:
    """A hand as JSON: angles in rad, lengths in m."""
    from neuralgrasps.kinematics.tree import PRISMATIC

    prismatic = _dof_types(hand) == PRISMATIC
    joints = [
        {
            "name": name,
            "type": "prismatic" if prismatic[d] else "revolute",
            f"lower_{'m' if prismatic[d] else 'rad'}": float(hand.tree.lower[d]),
            f"upper_{'m' if prismatic[d] else 'rad'}": float(hand.tree.upper[d]),
            "closing_sign": int(math.copysign(1, hand.closing_rate[d])) if hand.closing_rate[d] else 0,
        }
        for d, name in enumerate(hand.tree.dof_names)
    ]
    return {
        "name": hand.name,
        "joints": joints,
        "following_joints": followers(hand),
        "fingers": [
            {"name": f.name, "links": [hand.tree.link_names[i] for i in f.links], "is_thumb": f.is_thumb}
            for f in hand.fingers
        ],
        "is_jaw": hand.is_jaw,
        "convex_parts": len(hand.parts),
        "X_HP_m": hand.X_HP,
        "licence": hand.licence,
        "provenance": hand.provenance,
    }


def _dof_types(hand: Hand) -> np.ndarray:
    """(J,) joint type of each independent joint: that of the first link it moves."""
    import numpy as np

    tree = hand.tree
    return np.array([tree.joint_types[int(np.flatnonzero(tree.coupling[:, d])[0])] for d in range(tree.num_dofs)])


def followers(hand: Hand) -> list[str]:
    """One line for each joint that has no value of its own: "right = left"."""
    import numpy as np

    from neuralgrasps.kinematics.tree import FIXED

    tree = hand.tree
    lines = []
    for link, name in enumerate(tree.joint_names):
        if tree.joint_types[link] == FIXED or name in tree.dof_names:
            continue
        moving = [(float(tree.coupling[link, d]), tree.dof_names[d]) for d in np.flatnonzero(tree.coupling[link])]
        terms = [driver if factor == 1 else f"{factor:.4g} x {driver}" for factor, driver in moving]
        terms += [f"{tree.offset[link]:.4g}"] if tree.offset[link] else []
        lines.append(f"{name} = {' + '.join(terms) or 'fixed at 0'}")
    return lines


def _joint_rows(hand: Hand) -> list[tuple[Any, ...]]:
    from neuralgrasps.kinematics.tree import PRISMATIC

    rows = []
    finger_of = {d: f.name for f in hand.fingers for d in f.dofs}
    for d, joint_type in enumerate(_dof_types(hand)):
        prismatic = joint_type == PRISMATIC
        scale, unit = (1e3, "mm") if prismatic else (180 / math.pi, "deg")
        rate = hand.closing_rate[d]
        closes = "stays" if rate == 0 else ("up" if rate > 0 else "down")
        numbers = [f"{float(v[d]) * scale:.1f}" for v in (hand.tree.lower, hand.tree.upper, hand.q_open)]
        rows.append((hand.tree.dof_names[d], unit, *numbers, closes, finger_of.get(d, "several")))
    return rows


def lines_of(hand: Hand, key: str) -> list[str]:
    """The sentences that loading left in `hand.extra`."""
    return [line for line in hand.extra.get(key, "").splitlines() if line.strip()]


def save_hand_picture(hand: Hand, path: Path) -> None:
    """Draw the hand open and half closed, side by side; closed is where its links first meet, or its limits."""
    import numpy as np

    from neuralgrasps.cli.outputs import make_parent
    from neuralgrasps.report.figures import render_hand, save_picture

    make_parent(path)
    half = hand.q_open + _CLOSED_SHARE * _closing_room(hand) * (_closed_posture(hand) - hand.q_open)
    pictures = [render_hand(hand, q, size=(560, 560)) for q in (hand.q_open, half)]
    save_picture(path, np.concatenate(pictures, axis=1), background="#ffffff")


def _closed_posture(hand: Hand) -> np.ndarray:
    """(J,) every closing joint at its limit."""
    import numpy as np

    limit = np.where(hand.closing_rate > 0, hand.tree.upper, hand.tree.lower)
    return np.where(hand.closing_rate == 0, hand.q_open, limit)


def _closing_room(hand: Hand) -> float:
    """Share of the way from open to closed after which links overlap by more than 1 mm."""
    import numpy as np

    from neuralgrasps.grasps.penetration import self_penetration
    from neuralgrasps.hands.packed import pack_hand
    from neuralgrasps.kinematics.forward_kernels import forward_fast

    packed, closed = pack_hand(hand, spacing=0.004), _closed_posture(hand)
    shares = np.linspace(0.05, 1.0, 20)
    poses = forward_fast(hand.tree, hand.q_open + shares[:, None] * (closed - hand.q_open))
    meets = [share for share, X_HL in zip(shares, poses, strict=True) if self_penetration(packed, X_HL) > 1e-3]
    return float(min(meets, default=1.0))
