"""From a list of links and joints, as a file gives them, to a checked `KinematicTree`."""

from __future__ import annotations

import difflib
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from neuralgrasps.errors import RobotDescriptionError
from neuralgrasps.kinematics.forward_kernels import joint_motion
from neuralgrasps.kinematics.tree import FIXED, PRISMATIC, REVOLUTE, KinematicTree

DEFAULT_TORQUE = 1.0  # N m, where a file gives none; between an Allegro (0.7) and a human finger (1.5)
DEFAULT_FORCE = 20.0  # N, the Franka hand's
MAX_ANGLE = 4 * math.pi  # a hand or arm joint beyond two turns is a unit error or "no limit"
MAX_TRAVEL = 5.0  # m
MIN_SHARE = 0.1  # a mimic joint's limits may shrink its leader's range to this share, not further

Value = tuple[str | None, float, float]  # (leader or None, multiplier, constant)
Values = dict[str, Value]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mimic:
    """This joint's value is `multiplier * value(joint) + offset`."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointSpec:
    """One joint as a file gives it; None where the file says nothing.

    The child's pose in the parent is `X_PJ @ motion(axis, value - zero)`.
    """

    name: str
    parent: str
    child: str
    joint_type: int
    X_PJ: np.ndarray
    axis: np.ndarray
    lower: float | None = None
    upper: float | None = None
    effort: float | None = None
    mimic: Mimic | None = None
    zero: float = 0.0


def build_tree(source: str, links: Sequence[str], joints: Sequence[JointSpec], notes: list[str]) -> KinematicTree:
    """A tree in depth-first order of the file, mimic chains resolved, limits and efforts mended.

    Args:
        source: what is being read, for messages ("URDF 'x.urdf'").
        links: link names.
        joints: joints between them.
        notes: receives one sentence for each thing that was mended.
    Raises:
        RobotDescriptionError: not one tree, or joint data that cannot be mended.
    """
    _check_names(source, links, joints)
    order = _depth_first(source, links, joints)
    by_child = {j.child: _mend_joint(source, j, notes) for j in joints}
    moving = {j.name: j for child in order if (j := by_child.get(child)) and j.joint_type != FIXED}
    values = {j.name: _joint_value(source, j, {j.name: j for j in by_child.values()}) for j in moving.values()}
    dofs = [name for name in moving if values[name][0] == name]
    limits = {name: _dof_limits(moving[name], moving, values, notes) for name in dofs}
    column = {name: k for k, name in enumerate(dofs)}

    count = len(order)
    coupling, offset = np.zeros((count, len(dofs))), np.zeros(count)
    X_parent_joint, axes = np.tile(np.eye(4), (count, 1, 1)), np.zeros((count, 3))
    joint_types, parents = np.zeros(count, np.int8), np.full(count, -1, np.int32)
    index = {name: i for i, name in enumerate(order)}
    for i, child in enumerate(order):
        joint = by_child.get(child)
        if joint is None:
            continue
        parents[i], joint_types[i], X_parent_joint[i] = index[joint.parent], joint.joint_type, joint.X_PJ
        if joint.joint_type == FIXED:
            continue
        axes[i] = joint.axis
        leader, multiplier, constant = values[joint.name]
        offset[i] = constant - joint.zero
        if leader is not None:
            coupling[i, column[leader]] = multiplier
    return KinematicTree(
        link_names=tuple(order),
        parents=parents,
        joint_names=tuple(by_child[c].name if c in by_child else "" for c in order),
        joint_types=joint_types,
        X_parent_joint=X_parent_joint,
        axes=axes,
        coupling=coupling,
        offset=offset,
        dof_names=tuple(dofs),
        lower=np.array([limits[n][0] for n in dofs], float),
        upper=np.array([limits[n][1] for n in dofs], float),
        effort=_efforts([moving[n] for n in dofs], moving, values, notes),
    )


def _check_names(source: str, links: Sequence[str], joints: Sequence[JointSpec]) -> None:
    if not links:
        raise RobotDescriptionError(f"{source} has no links; expected at least one.")
    for what, names in (("link", links), ("joint", [j.name for j in joints])):
        twice = [n for n, k in Counter(names).items() if k > 1]
        if twice:
            raise RobotDescriptionError(
                f"{source}: {what} name '{twice[0]}' is used more than once; rename one of them."
            )
    known = set(links)
    for joint in joints:
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in known:
                hint = _hint(link, links)
                raise RobotDescriptionError(
                    f"{source}: joint '{joint.name}' has the {role} link '{link}', which is not defined.{hint}"
                )
    several = [c for c, k in Counter(j.child for j in joints).items() if k > 1]
    if several:
        who = ", ".join(f"'{j.name}'" for j in joints if j.child == several[0])
        raise RobotDescriptionError(
            f"{source}: link '{several[0]}' is the child of several joints ({who}); closed loops are not supported, "
            "remove all but one."
        )


def _hint(name: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(name, known, n=1)
    return f" Did you mean '{near[0]}'?" if near else ""


def _depth_first(source: str, links: Sequence[str], joints: Sequence[JointSpec]) -> list[str]:
    children: dict[str, list[str]] = {name: [] for name in links}
    for joint in joints:
        children[joint.parent].append(joint.child)
    moved = {j.child for j in joints}
    roots = [name for name in links if name not in moved]
    if len(roots) > 1:
        listed = ", ".join(f"'{r}'" for r in roots[:6])
        raise RobotDescriptionError(
            f"{source} has {len(roots)} root links ({listed}); expected one. Join the parts with fixed joints."
        )
    order: list[str] = []
    stack = list(roots)
    while stack:
        name = stack.pop()
        order.append(name)
        stack.extend(reversed(children[name]))
    if len(order) < len(links):
        loop = sorted(set(links) - set(order))
        raise RobotDescriptionError(
            f"{source}: links {loop[:6]} form a cycle and hang on no root; each link needs one parent, the root none."
        )
    return order


def _mend_joint(source: str, joint: JointSpec, notes: list[str]) -> JointSpec:
    """The joint with finite limits, lower < upper; a joint whose limits coincide becomes a fixed one."""
    if joint.joint_type == FIXED:
        return joint
    where = f"joint '{joint.name}'"
    lower, upper = joint.lower, joint.upper
    absent = lower is None or upper is None or math.isinf(lower) or math.isinf(upper)
    if joint.joint_type == PRISMATIC:
        if absent and joint.mimic is None:
            raise RobotDescriptionError(
                f"{source}: prismatic {where} has no lower and upper limit; state its travel in metres."
            )
        lower, upper = (-MAX_TRAVEL, MAX_TRAVEL) if absent else (lower, upper)
    elif absent:
        if joint.mimic is None:
            notes.append(f"{where} has no lower and upper limit: -pi..pi assumed.")
        lower, upper = -math.pi, math.pi
    assert lower is not None and upper is not None
    if lower > upper:
        notes.append(f"{where}: limits {lower:g}..{upper:g} are reversed: swapped.")
        lower, upper = upper, lower
    lower, upper = _mend_range(joint, lower, upper, notes)
    if lower == upper and joint.mimic is None:
        notes.append(f"{where}: lower and upper limit are both {lower:g}: treated as fixed there.")
        X_PJ = joint.X_PJ @ joint_motion(joint.joint_type, joint.axis, lower - joint.zero)
        return replace(joint, joint_type=FIXED, X_PJ=X_PJ, lower=lower, upper=upper)
    return replace(joint, lower=lower, upper=upper)


def _mend_range(joint: JointSpec, lower: float, upper: float, notes: list[str]) -> tuple[float, float]:
    where, size = f"joint '{joint.name}'", max(abs(lower), abs(upper))
    if joint.joint_type == PRISMATIC:
        if size > MAX_TRAVEL:
            notes.append(f"{where}: limits {lower:g}..{upper:g} m look like another unit; kept as metres.")
        return lower, upper
    if size <= MAX_ANGLE:
        return lower, upper
    if size <= 360.0:
        notes.append(f"{where}: limits {lower:g}..{upper:g} rad are beyond two turns: read as degrees.")
        return math.radians(lower), math.radians(upper)
    notes.append(f"{where}: limits {lower:g}..{upper:g} rad mean no limit: -pi..pi assumed.")
    return -math.pi, math.pi


def _joint_value(source: str, joint: JointSpec, by_name: dict[str, JointSpec]) -> Value:
    """(leader, multiplier, constant) with value = multiplier * leader's value + constant, chains followed."""
    multiplier, constant, seen = 1.0, 0.0, [joint.name]
    while joint.mimic is not None:
        target = by_name.get(joint.mimic.joint)
        if target is None:
            raise RobotDescriptionError(
                f"{source}: joint '{joint.name}' mimics '{joint.mimic.joint}', which is not defined."
                f"{_hint(joint.mimic.joint, list(by_name))}"
            )
        constant += multiplier * joint.mimic.offset
        multiplier *= joint.mimic.multiplier
        if target.name in seen:
            chain = " -> ".join([*seen, target.name])
            raise RobotDescriptionError(f"{source}: joints mimic each other in a circle ({chain}); one must be free.")
        seen.append(target.name)
        joint = target
    if joint.joint_type == FIXED:
        return None, 0.0, constant + multiplier * (joint.lower or 0.0)
    return joint.name, multiplier, constant


def _followers(name: str, moving: dict[str, JointSpec], values: Values) -> list[tuple[JointSpec, float, float]]:
    """Joints coupled to the free joint `name`: (joint, multiplier, constant), multiplier not zero."""
    found = ((moving[n], m, c) for n, (leader, m, c) in values.items() if leader == name and n != name)
    return [(joint, m, c) for joint, m, c in found if m]


def _dof_limits(
    joint: JointSpec, moving: dict[str, JointSpec], values: Values, notes: list[str]
) -> tuple[float, float]:
    """Limits of a free joint, narrowed so that the joints that follow it stay within theirs."""
    lower, upper = joint.lower, joint.upper
    assert lower is not None and upper is not None
    for follower, multiplier, constant in _followers(joint.name, moving, values):
        assert follower.lower is not None and follower.upper is not None
        ends = sorted(((follower.lower - constant) / multiplier, (follower.upper - constant) / multiplier))
        low, high = max(lower, ends[0]), min(upper, ends[1])
        if high - low < MIN_SHARE * (upper - lower):
            notes.append(
                f"joint '{follower.name}': its limits {follower.lower:g}..{follower.upper:g} hardly meet those of "
                f"'{joint.name}', which it follows: ignored."
            )
        elif low > lower + 1e-3 or high < upper - 1e-3:
            notes.append(
                f"joint '{joint.name}': limits narrowed to {low:.4g}..{high:.4g}: '{follower.name}' follows it."
            )
            lower, upper = low, high
    return lower, upper


def _efforts(
    dofs: list[JointSpec],
    moving: dict[str, JointSpec],
    values: Values,
    notes: list[str],
) -> np.ndarray:
    """Largest torque or force of the free joints: their own, else that of a follower, else a default."""
    efforts, assumed = np.zeros(len(dofs)), []
    for k, joint in enumerate(dofs):
        given = [abs(m) * (f.effort or 0.0) for f, m, _ in _followers(joint.name, moving, values) if _usable(f.effort)]
        if _usable(joint.effort):
            efforts[k] = joint.effort or 0.0
        elif given:
            efforts[k] = given[0]
        else:
            efforts[k] = DEFAULT_TORQUE if joint.joint_type == REVOLUTE else DEFAULT_FORCE
            assumed.append(joint.name)
    negative = [name for name in assumed if (moving[name].effort or 0.0) < 0]
    for words, names in (
        ("negative", negative),
        ("missing, 0 or not finite", [n for n in assumed if n not in negative]),
    ):
        if names:
            notes.append(
                f"effort is {words} for {', '.join(names)}: {DEFAULT_TORQUE:g} N m (revolute) or "
                f"{DEFAULT_FORCE:g} N (prismatic) assumed."
            )
    return efforts


def _usable(effort: float | None) -> bool:
    return effort is not None and math.isfinite(effort) and effort > 0.0
