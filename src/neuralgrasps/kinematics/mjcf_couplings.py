"""Joints of an MJCF that are tied to others: joint equalities, and equalities of fixed tendons."""

from __future__ import annotations

import math
from collections.abc import Callable

import mujoco
import numpy as np

from neuralgrasps.errors import RobotDescriptionError
from neuralgrasps.kinematics.assemble import Mimic

JOINT, TENDON = int(mujoco.mjtEq.mjEQ_JOINT), int(mujoco.mjtEq.mjEQ_TENDON)
WRAPS_JOINT = int(mujoco.mjtWrap.mjWRAP_JOINT)
Coupled = dict[int, Mimic | float]


def joint_couplings(model: mujoco.MjModel, source: str, joint_name: Callable[[int], str], notes: list[str]) -> Coupled:
    """What each dependent joint follows, as a line, or the constant at which it is held.

    Curved equalities become the nearest line, and what cannot be read is left out; `notes` says so.

    Raises:
        RobotDescriptionError: two equalities set the same joint.
    """
    found: Coupled = {}
    for e in range(model.neq):
        kind = int(model.eq_type[e])
        if kind not in (JOINT, TENDON):
            name = mujoco.mjtEq(kind).name.removeprefix("mjEQ_").lower()
            notes.append(f"a '{name}' equality was ignored; only those of joints and fixed tendons are read.")
        elif not model.eq_active0[e]:
            what = f"joint '{joint_name(model.eq_obj1id[e])}'" if kind == JOINT else "a tendon"
            notes.append(f"the inactive equality of {what} was ignored.")
        elif kind == JOINT:
            first = int(model.eq_obj1id[e])
            if first in found:
                raise RobotDescriptionError(
                    f"{source}: joint '{joint_name(first)}' is set by two equalities; keep one."
                )
            found[first] = _joint_equality(model, e, joint_name, notes)
        else:
            _tendon_equality(model, e, joint_name, notes, found)
    return found


def _joint_equality(model: mujoco.MjModel, e: int, joint_name: Callable[[int], str], notes: list[str]) -> Mimic | float:
    """q1 - ref1 = a0 + a1 (q2 - ref2) + ..., or q1 - ref1 = a0."""
    first, second, a = int(model.eq_obj1id[e]), int(model.eq_obj2id[e]), model.eq_data[e, :5]
    ref1 = _zero(model, first)
    if second < 0:
        return ref1 + float(a[0])
    ref2 = _zero(model, second)
    constant, slope = float(a[0]), float(a[1])
    if np.any(a[2:]):
        lower, upper = model.jnt_range[second] if model.jnt_limited[second] else (-math.pi, math.pi)
        x = np.linspace(lower, upper, 101) - ref2
        y = np.polynomial.polynomial.polyval(x, a)
        constant, slope = (float(v) for v in np.polynomial.polynomial.polyfit(x, y, 1))
        worst = float(np.max(np.abs(constant + slope * x - y)))
        notes.append(
            f"the equality of joint '{joint_name(first)}' is curved: replaced by a line, off by up to {worst:.3g}."
        )
    return Mimic(joint=joint_name(second), multiplier=slope, offset=ref1 + constant - slope * ref2)


def _tendon_equality(
    model: mujoco.MjModel, e: int, joint_name: Callable[[int], str], notes: list[str], found: Coupled
) -> None:
    """L1 - L1_0 = a0 + a1 (L2 - L2_0): a line between two joints if the fixed tendons run over no more than two."""
    first, second, a = int(model.eq_obj1id[e]), int(model.eq_obj2id[e]), model.eq_data[e, :5]
    arms = _arms(model, first)
    constant = float(model.tendon_length0[first] + a[0])
    if second >= 0 and not np.any(a[2:]):
        other = _arms(model, second)
        arms = None if arms is None or other is None else arms - float(a[1]) * other
        constant -= float(a[1]) * float(model.tendon_length0[second])
    joints = [] if arms is None else [int(j) for j in np.flatnonzero(np.abs(arms) > 1e-12)]
    free = [j for j in joints if j not in found]
    if arms is None or len(joints) not in (1, 2) or not free or (second >= 0 and np.any(a[2:])):
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TENDON, first) or f"tendon_{first}"
        notes.append(f"the equality of tendon '{name}' was ignored: it does not tie one joint to another by a line.")
        return
    follower = max(free)  # the outer one
    leader = next((j for j in joints if j != follower), None)
    offset = constant / float(arms[follower])
    if leader is None:
        found[follower] = offset
    else:
        ratio = -float(arms[leader] / arms[follower])
        found[follower] = Mimic(joint=joint_name(leader), multiplier=ratio, offset=offset)


def _arms(model: mujoco.MjModel, tendon: int) -> np.ndarray | None:
    """(joints,) coefficients of a fixed tendon; None for a tendon that runs through sites."""
    start, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
    if not np.all(model.wrap_type[start : start + count] == WRAPS_JOINT):
        return None
    arms = np.zeros(model.njnt)
    for w in range(start, start + count):
        arms[model.wrap_objid[w]] += model.wrap_prm[w]
    return arms


def _zero(model: mujoco.MjModel, joint: int) -> float:
    return float(model.qpos0[model.jnt_qposadr[joint]])
