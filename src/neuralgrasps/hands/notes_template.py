"""A `hand.toml` that says what was derived of a hand, to be edited and put beside its file."""

from __future__ import annotations

import numpy as np

from neuralgrasps.hands.hand import Hand

_HEAD = """# Annotation of '{name}'. Put this file beside the robot's file, as hand.toml or under the same name
# with the ending .toml; delete what may be derived, change what is wrong. SI units and radians.
"""
_PALM = """
[palm]  # in the frame of '{base}': on the palm's surface, x where the fingers close, z out of the palm
"""
_JOINTS = """
[joints]
# close: rate of closing, signed, 0 = not used to close; open: open posture; preshape: lowest and highest start value;
# group: joints that share one random number in a preshape; effort: largest torque (N m) or force (N)
"""


def hand_toml(hand: Hand) -> str:
    """Text of a `hand.toml` from which `load_hand` makes the same annotation, with nothing left to derive."""
    lines = [_HEAD.format(name=hand.name), f"name = {_text(hand.name)}"]
    if hand.licence not in ("", "not stated"):
        lines.append(f"licence = {_text(hand.licence)}")
    lines.append(f"is_jaw = {str(hand.is_jaw).lower()}")
    if hand.is_jaw:
        lines.append(f"jaw_pad = {_vector(hand.jaw_pad_H)}  # middle between the pads")
    lines.append(_PALM.format(base=hand.tree.link_names[0]).rstrip())
    for key, column in (("position", 3), ("x_axis", 0), ("z_axis", 2)):
        lines.append(f"{key} = {_vector(hand.X_HP[:3, column])}")
    lines += [_JOINTS.rstrip(), *_joint_lines(hand)]
    for finger in hand.fingers:
        links = ", ".join(_text(hand.tree.link_names[i]) for i in finger.links)
        lines += ["", "[[fingers]]", f"name = {_text(finger.name)}", f"links = [{links}]"]
        lines += ["thumb = true"] if finger.is_thumb else []
    return "\n".join(lines) + "\n"


def _joint_lines(hand: Hand) -> list[str]:
    lines = []
    group_of = {d: g for g, dofs in enumerate(hand.preshape_groups) if len(dofs) > 1 for d in dofs}
    for d, name in enumerate(hand.tree.dof_names):
        entries = [
            f"close = {_number(hand.closing_rate[d])}",
            f"open = {_number(hand.q_open[d])}",
            f"preshape = {_vector(np.array([hand.preshape_lower[d], hand.preshape_upper[d]]))}",
            f"effort = {_number(hand.tree.effort[d])}",
        ]
        entries += [f'group = "group_{group_of[d] + 1}"'] if d in group_of else []
        lines.append(f"{_text(name)} = {{ {', '.join(entries)} }}")
    return lines


def _text(value: str) -> str:
    escaped = value.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in escaped) + '"'


def _number(value: float) -> str:
    rounded = round(float(value), 6) + 0.0
    return repr(rounded)


def _vector(values: np.ndarray) -> str:
    return "[" + ", ".join(_number(v) for v in values) + "]"
