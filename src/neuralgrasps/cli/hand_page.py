"""The page of `hands check --report`: what was read, mended and derived of a hand, in pictures and tables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

import neuralgrasps
from neuralgrasps.cli.terminal import counted
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.notes_template import hand_toml
from neuralgrasps.hands.packed import pack_hand
from neuralgrasps.kinematics.tree import PRISMATIC
from neuralgrasps.report.content import DemoReport, HandFigure, KeyFigure, Listing, Table
from neuralgrasps.report.hand_sequence import HandFrame
from neuralgrasps.report.page import write_report
from neuralgrasps.report.sections import pretty_name

_PAIR_SPACING = 0.009
_PER_ROW = 6  # names of links in one line of a table


def write_hand_page(
    path: Path, hand: Hand, frames: Sequence[HandFrame], *, repairs: Sequence[str], derived: Sequence[str], command: str
) -> Path:
    """Write the page; `frames` as `hand_sequence` draws them, `repairs` and `derived` one sentence each."""
    report = DemoReport(
        title=pretty_name(hand.name),
        command=command,
        subtitle="What was read from the file, what was mended in it, and what was derived for grasping.",
        version=neuralgrasps.__version__,
        created=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        key_figures=(
            KeyFigure(value=str(len(hand.fingers)), label="fingers of a parallel jaw" if hand.is_jaw else "fingers"),
            KeyFigure(value=str(hand.num_dofs), label="independent joints", note=counted(_moving(hand), "moving link")),
            KeyFigure(value=str(len(hand.parts)), label="convex solids"),
            KeyFigure(value=str(len(repairs)), label="repairs"),
        ),
        hands=tuple(HandFigure(hand=hand.name, image=f.image, text=f.title) for f in frames),
        tables=(finger_table(hand), joint_table(hand), palm_table(hand), pair_table(hand)),
        listings=(
            Listing(
                title="hand.toml",
                text=hand_toml(hand),
                meaning="Put it beside the robot's file: it gives what is shown here. Edit it to change any of it.",
            ),
        ),
        notes=(*(f"Mended: {line}" for line in repairs), *(f"Derived: {line}" for line in derived)),
        section_titles={
            "hands": "How it closes",
            "numbers": "What was derived",
            "notes": "What was mended and derived",
        },
        section_texts={
            "hands": "Seen from one place, the palm facing up. Each finger has its own colour, a thumb is rose, "
            "everything else graphite. The palm frame: red x, where the fingers close; green y; blue z, out of the "
            "palm. The last picture shows the points of the surface with which the hand can touch.",
            "numbers": "",
        },
    )
    return write_report(report, path)


def _moving(hand: Hand) -> int:
    return int((hand.tree.coupling != 0).any(axis=1).sum())


def finger_table(hand: Hand) -> Table:
    """Fingers with their links and joints."""
    names, dofs = hand.tree.link_names, hand.tree.dof_names
    rows = tuple(
        (
            f.name + (" (thumb)" if f.is_thumb and f.name != "thumb" else ""),
            " → ".join(names[i] for i in f.links),
            ", ".join(dofs[d] for d in f.dofs) or "moved together with others",
        )
        for f in hand.fingers
    )
    return Table(title="Fingers", columns=("finger", "links, from the palm outwards", "own joints"), rows=rows)


def joint_table(hand: Hand) -> Table:
    """Limits, closing rates, start ranges and largest torques, in degrees and millimetres."""
    tree, rows = hand.tree, []
    group = {d: g + 1 for g, dofs in enumerate(hand.preshape_groups) for d in dofs}
    for d, name in enumerate(tree.dof_names):
        slides = tree.joint_types[int(np.flatnonzero(tree.coupling[:, d])[0])] == PRISMATIC
        scale, unit = (1e3, "mm") if slides else (180 / math.pi, "°")
        values = (tree.lower[d], tree.upper[d], hand.q_open[d], hand.preshape_lower[d], hand.preshape_upper[d])
        low, high, opened, start, end = (f"{float(v) * scale:.1f}" for v in values)
        rate = f"{hand.closing_rate[d]:+.2f}" if hand.closing_rate[d] else "stays"
        effort = f"{tree.effort[d]:.3g} {'N' if slides else 'N m'}"
        rows.append((name, f"{low} … {high} {unit}", opened, rate, f"{start} … {end}", group[d], effort))
    return Table(
        title="Joints",
        columns=("joint", "limits", "open", "closing rate", "preshapes", "group", "largest effort"),
        rows=tuple(rows),
        meaning="Closing rates are relative to the fastest joint. A preshape is a posture from which the hand closes; "
        "the joints of a group share one random number when it is drawn.",
    )


def palm_table(hand: Hand) -> Table:
    """The palm frame in the base frame."""
    vectors = (("origin, mm", 1e3 * hand.X_HP[:3, 3]), ("x, where the fingers close", hand.X_HP[:3, 0]),
               ("z, out of the palm", hand.X_HP[:3, 2]))  # fmt: skip
    rows = [(what, *(f"{v:.3f}" for v in vector)) for what, vector in vectors]
    if hand.is_jaw:
        rows.append(("middle between the pads, mm", *(f"{1e3 * v:.3f}" for v in hand.jaw_pad_H)))
    return Table(title=f"Palm in the frame of {hand.tree.link_names[0]}", columns=("", "x", "y", "z"), rows=tuple(rows))


def pair_table(hand: Hand) -> Table:
    """Links that may run into each other, by link."""
    pairs = self_collision_pairs(hand)
    others: dict[str, list[str]] = {}
    for first, second in pairs:
        others.setdefault(first, []).append(second)
    return Table(
        title="Pairs of links checked for self-collision",
        columns=("link", "against"),
        rows=tuple(
            (link if k == 0 else "", ", ".join(found[k : k + _PER_ROW]))
            for link, found in others.items()
            for k in range(0, len(found), _PER_ROW)
        ),
        meaning=f"{counted(len(pairs), 'pair')}; neighbours, and links that always touch, are left out.",
    )


def self_collision_pairs(hand: Hand) -> list[tuple[str, str]]:
    """Names of the links of each pair that is checked for collision."""
    names = hand.tree.link_names
    return [(names[a], names[b]) for a, b in pack_hand(hand, spacing=_PAIR_SPACING).self_pairs.tolist()]
