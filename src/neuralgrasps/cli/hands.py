"""`neuralgrasps hands`: list, show, and check any robot file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from neuralgrasps.cli.options import NamePath, OptionalFile, OptionalText
from neuralgrasps.cli.outputs import check_writable
from neuralgrasps.cli.terminal import Cell, Outcome, Terminal, counted

if TYPE_CHECKING:
    import numpy as np

    from neuralgrasps.hands.hand import Hand


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
        picture: PNG file to draw the hand into, as it closes.
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
    link: OptionalText = None,
    picture: OptionalFile = None,
    report: OptionalFile = None,
    missing_meshes: Literal["error", "skip"] = "error",
) -> Outcome:
    """Read any URDF or MJCF file as a hand: what was mended, what was derived, and, if asked for, pictures.

    In the file of a whole robot the hand is found. A `hand.toml` or `<file>.toml` beside the file overrides whatever
    was derived; the report holds one to start from.

    Args:
        path: a URDF or MJCF file, or a folder with one.
        link: the link of a whole robot to take as the hand's base, with all that hangs on it.
        picture: PNG file for the palm frame and the hand as it closes.
        report: HTML page with the pictures, everything derived, and a hand.toml to edit.
        missing_meshes: skip leaves out link shapes whose mesh files are missing.
    """
    from neuralgrasps.hands.zoo import load_hand

    for file in (picture, report):
        if file is not None:
            check_writable(file)
    hand = load_hand(Path(path) if Path(path).exists() else path, link=link, missing_meshes=missing_meshes)
    outcome = _described(terminal, hand, picture)
    repairs, derived = lines_of(hand, "repairs"), lines_of(hand, "annotated")
    terminal.notes(repairs, title="\nMended:")
    terminal.notes(derived, title="\nDerived:")
    if report is not None:
        _write_page(hand, report, repairs, derived, path)
        terminal.say(f"\nReport: {report}")
    elif picture is None:
        terminal.say("\nSee how it closes: add --picture hand.png or --report hand.html")
    if missing_meshes == "skip" and any("left out" in line for line in repairs):
        terminal.say(f"\n'{hand.name}' lacks the shapes left out above; put their meshes there before you use it.")
    else:
        terminal.say(f"\n'{hand.name}' can be used: neuralgrasps synthesise --hand {path} --object mustard_bottle")
    files = {"report": str(report)} if report else {}
    return Outcome(result={**outcome.result, "repairs": repairs, "derived": derived, **files})


def _write_page(hand: Hand, report: Path, repairs: list[str], derived: list[str], path: str) -> None:
    from neuralgrasps.cli.hand_page import write_hand_page
    from neuralgrasps.report.hand_sequence import hand_sequence

    command = f"neuralgrasps hands check {path} --report {report}"
    write_hand_page(report, hand, hand_sequence(hand), repairs=repairs, derived=derived, command=command)


def _described(terminal: Terminal, hand: Hand, picture: Path | None) -> Outcome:
    kind = "parallel jaw" if hand.is_jaw else counted(len(hand.fingers), "finger")
    facts: list[tuple[str, Cell]] = [
        ("joints", hand.num_dofs),
        ("kind", kind),
        ("convex parts", len(hand.parts)),
        ("licence", hand.licence),
    ]
    terminal.say(hand.name)
    terminal.facts([*facts, ("source", " ".join(hand.provenance.split()))])
    terminal.table(("joint", "unit", "lower", "upper", "open", "closes", "effort", "finger"), _joint_rows(hand))
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
            "closing_rate": float(hand.closing_rate[d]),
            f"preshape_{'m' if prismatic[d] else 'rad'}": [
                float(hand.preshape_lower[d]),
                float(hand.preshape_upper[d]),
            ],
            f"effort_{'n' if prismatic[d] else 'nm'}": float(hand.tree.effort[d]),
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
        effort = f"{hand.tree.effort[d]:.3g} {'N' if prismatic else 'N m'}"
        rows.append((hand.tree.dof_names[d], unit, *numbers, closes, effort, finger_of.get(d, "several")))
    return rows


def lines_of(hand: Hand, key: str) -> list[str]:
    """The sentences that loading left in `hand.extra`."""
    return [line for line in hand.extra.get(key, "").splitlines() if line.strip()]


def save_hand_picture(hand: Hand, path: Path) -> None:
    """Draw the palm frame, the closing sequence and the contact surface side by side."""
    from neuralgrasps.cli.outputs import make_parent
    from neuralgrasps.report.figures import save_picture
    from neuralgrasps.report.hand_sequence import hand_sequence, sequence_strip

    make_parent(path)
    save_picture(path, sequence_strip(hand_sequence(hand)))
