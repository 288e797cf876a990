"""Trying grasps in physics: the verdict that synthesis and evaluation trust.

One trial: the hand starts at the pre-grasp around the floating object, ramps its position servos to the grasp and on to
the squeeze, and then the object is pulled along each of its own axes, both ways. It fails the moment the object has
moved or turned too far from where it started.

A trial is a pure function of (hand, object, one grasp, protocol): every trial starts from `mj_resetData`, and runs
in one thread, so the verdict of a grasp has the same bits whatever is tried before it or beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import StrEnum

import mujoco
import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.se3_numpy import inverse_np
from neuralgrasps.grasps.grasp_set import GraspSet, Verdict
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.sim.build import (
    CONTACT_DIMENSIONS,
    OBJECT_BODY,
    OBJECT_JOINT,
    contact_friction,
    grasp_model,
    joint_name,
    leaders,
    object_mass,
)
from neuralgrasps.sim.protocols import Protocol, get_protocol

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_DIRECTIONS_O = np.concatenate([np.eye(3), -np.eye(3)])[[0, 3, 1, 4, 2, 5]]  # +x, -x, +y, -y, +z, -z
_FIRST_ROUND_S = 0.2
_SETTLED_CHECKS = 8
_DIVERGED = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
    mujoco.mjtWarning.mjWARN_BADCTRL,  # the engine replaces a target that is not finite by 0 and goes on
)


class Phase(StrEnum):
    """What the trial is doing."""

    START = "start"
    GRASP = "grasp"
    SQUEEZE = "squeeze"
    HOLD = "hold"


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialOutcome:
    """How one trial ended.

    Attributes:
        success: the object was held throughout.
        displacement_m, rotation_rad: largest motion of the object's centre of mass and orientation seen since the start
            (until the failing check, when it failed); nan when the grasp was rejected at its start or diverged.
        start_penetration_m: deepest overlap of hand and object at the pre-grasp, 0 when they are apart.
        held: number of forces withstood before the first failure; 6 when all were.
    """

    success: bool
    displacement_m: float
    rotation_rad: float
    start_penetration_m: float
    held: int


Observer = Callable[[Phase, int, mujoco.MjData], None]


class GraspTrial:
    """The compiled model of one hand and one object, ready to try any number of grasps.

    Not thread-safe: it owns one simulation state. Use one per process.
    """

    def __init__(self, hand: Hand, obj: ObjectModel, protocol: str | Protocol) -> None:
        self.hand = hand
        self.obj = obj
        self.protocol = get_protocol(protocol)
        self.model = grasp_model(hand, obj, self.protocol)
        self.data = mujoco.MjData(self.model)
        tree = hand.tree
        self._links = np.array([i for i in range(1, tree.num_links) if tree.joint_types[i]], np.int64)
        self._joint_qpos = np.array([self.model.joint(joint_name(i)).qposadr[0] for i in self._links], np.int64)
        links, self._gain, self._offset = leaders(hand)
        self._leader_qpos = np.array([self.model.joint(joint_name(i)).qposadr[0] for i in links], np.int64)
        self._object_qpos = int(self.model.joint(OBJECT_JOINT).qposadr[0])
        self._body = int(self.model.body(OBJECT_BODY).id)
        self._squeezed = np.zeros(mujoco.mj_stateSize(self.model, _STATE))
        self._start_centre = np.zeros(3)
        self._start_rotation = np.eye(3)
        self._worst = np.zeros(2)

    def run(
        self,
        X_OH: np.ndarray,
        q_pregrasp: np.ndarray,
        q: np.ndarray,
        q_squeeze: np.ndarray,
        *,
        observe: Observer | None = None,
    ) -> TrialOutcome:
        """Try one grasp.

        Args:
            X_OH: (4, 4) hand base in the object frame. q_pregrasp, q, q_squeeze: (J,) rad or metres; `q_squeeze`
                is a servo target, so it may lie inside the object or beyond the joint limits.
            observe: called at the start and at every check with the phase, the index of the force (-1 before
                the first) and the state.
        """
        with _silent_engine():
            penetration = self._reset(X_OH, q_pregrasp)
            if observe:
                observe(Phase.START, -1, self.data)
            rejected = not penetration <= self.protocol.max_start_penetration_m
            closed = (
                not rejected
                and self._drive(q_pregrasp, q, Phase.GRASP, observe)
                and self._drive(q, q_squeeze, Phase.SQUEEZE, observe)
            )
            held = self._hold_all(observe) if closed else 0
        diverged = any(self.data.warning[kind].number for kind in _DIVERGED)
        displacement, rotation = (np.nan, np.nan) if rejected or diverged else self._worst
        return TrialOutcome(
            success=held == len(_DIRECTIONS_O) and not diverged,
            displacement_m=float(displacement),
            rotation_rad=float(rotation),
            start_penetration_m=penetration,
            held=held,
        )

    def joint_values(self, data: mujoco.MjData) -> np.ndarray:
        """Independent joint positions q (J,) in this state, rad or metres."""
        return (data.qpos[self._leader_qpos] - self._offset) / self._gain

    def object_pose(self, data: mujoco.MjData) -> np.ndarray:
        """X_HO (4, 4) in this state."""
        X_HO = np.eye(4)
        at = self._object_qpos
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, data.qpos[at + 3 : at + 7])
        X_HO[:3, :3] = rotation.reshape(3, 3)
        X_HO[:3, 3] = data.qpos[at : at + 3]
        return X_HO

    def _reset(self, X_OH: np.ndarray, q: np.ndarray) -> float:
        """Put hand and object at the pre-grasp; returns their deepest overlap, metres."""
        model, data = self.model, self.data
        mujoco.mj_resetData(model, data)
        X_HO = inverse_np(np.asarray(X_OH, np.float64))
        at = self._object_qpos
        data.qpos[at : at + 3] = X_HO[:3, 3]
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(X_HO[:3, :3]).ravel())
        data.qpos[at + 3 : at + 7] = quaternion
        data.qpos[self._joint_qpos] = self.hand.tree.joint_positions(np.asarray(q, np.float64))[self._links]
        mujoco.mj_forward(model, data)
        self._start_centre = data.xipos[self._body].copy()
        self._start_rotation = data.xmat[self._body].reshape(3, 3).copy()
        self._worst[:] = 0.0
        return max(0.0, -float(data.contact.dist.min())) if data.ncon else 0.0

    def _control(self, q: np.ndarray) -> np.ndarray:
        """Servo targets: the actuators measure q + offset / gain."""
        return np.asarray(q, np.float64) + self._offset / self._gain

    def _drive(self, q_from: np.ndarray, q_to: np.ndarray, phase: Phase, observe: Observer | None) -> bool:
        """Ramp the targets in equal steps, one per check; False as soon as the object is lost."""
        start, end = self._control(q_from), self._control(q_to)
        checks = self._checks(self.protocol.drive_s)
        for i in range(checks):
            self.data.ctrl[:] = start + (i + 1) / checks * (end - start)
            if not self._advance(phase, -1, observe):
                return False
        return True

    def _hold_all(self, observe: Observer | None) -> int:
        """Pull along the object's six directions; returns how many were withstood before the first failure."""
        checks = self._checks(self.protocol.hold_s)
        if observe or not self.protocol.from_reset:
            return self._hold_in_turn(checks, observe)
        return self._hold_in_rounds(checks)

    def _hold_in_turn(self, checks: int, observe: Observer | None) -> int:
        """One force after the other, each for its whole time."""
        mujoco.mj_getState(self.model, self.data, self._squeezed, _STATE)
        for direction in range(len(_DIRECTIONS_O)):
            if direction and self.protocol.from_reset:
                mujoco.mj_setState(self.model, self.data, self._squeezed, _STATE)
            if self._hold(direction, checks, 0, observe) is None:
                return direction
        return len(_DIRECTIONS_O)

    def _hold_in_rounds(self, checks: int) -> int:
        """The same forces, all six for a short time first, then each to its end.

        Each force starts from the squeezed state and all must be withstood, so the verdict is that of `_hold_in_turn`;
        but most failures fail early, in some direction, and this finds them at a fraction of the cost.
        """
        model, data = self.model, self.data
        mujoco.mj_getState(model, data, self._squeezed, _STATE)
        states = np.tile(self._squeezed, (len(_DIRECTIONS_O), 1))
        still = [0] * len(_DIRECTIONS_O)
        first = min(checks, self._checks(_FIRST_ROUND_S))
        for length in (first, checks - first):
            for direction, state in enumerate(states):
                mujoco.mj_setState(model, data, state, _STATE)
                count = self._hold(direction, length, still[direction], None)
                if count is None:
                    return direction
                still[direction] = count
                mujoco.mj_getState(model, data, state, _STATE)
        return len(_DIRECTIONS_O)

    def _hold(self, direction: int, checks: int, still: int, observe: Observer | None) -> int | None:
        """Apply force `direction` until it has been checked `checks` times, or nothing moves any more.

        The force is constant in the world, like gravity, along an axis the object had at the start.

        Args:
            still: for how many checks in a row everything has been slower than `protocol.settled_speed`.
        Returns:
            `still` at the end; None when the object was lost.
        """
        force = self.protocol.force_per_mass * object_mass(self.obj, self.protocol)
        self.data.xfrc_applied[self._body, :3] = force * (self._start_rotation @ _DIRECTIONS_O[direction])
        for _ in range(checks):
            if still >= _SETTLED_CHECKS:
                break
            if not self._advance(Phase.HOLD, direction, observe):
                return None
            still = still + 1 if np.abs(self.data.qvel).max() < self.protocol.settled_speed else 0
        return still

    def _checks(self, seconds: float) -> int:
        return max(1, round(seconds / (self.protocol.timestep_s * self.protocol.check_every)))

    def _advance(self, phase: Phase, direction: int, observe: Observer | None) -> bool:
        """Step to the next check; True while the object is where it should be."""
        mujoco.mj_step(self.model, self.data, nstep=self.protocol.check_every)
        if observe:
            observe(phase, direction, self.data)
        moved = self.data.xipos[self._body] - self._start_centre
        trace = float(np.vdot(self._start_rotation, self.data.xmat[self._body]))
        displacement = float(np.sqrt(moved @ moved))
        rotation = float(np.arccos(min(1.0, max(-1.0, (trace - 1.0) / 2.0))))
        self._worst[0] = max(self._worst[0], displacement)
        self._worst[1] = max(self._worst[1], rotation)
        # written so that a diverged (nan) state is lost, not held
        return displacement <= self.protocol.max_displacement_m and rotation <= self.protocol.max_rotation_rad


@contextmanager
def _silent_engine() -> Iterator[None]:
    """Keep the engine from printing, and from writing a log file to the working directory, when a trial diverges."""
    before, silent = mujoco.MjLogConfig.get(), mujoco.MjLogConfig.get()
    silent.logto_console = False
    silent.logto_file = False
    mujoco.MjLogConfig.set(silent)
    try:
        yield
    finally:
        mujoco.MjLogConfig.set(before)


def validate_grasps(
    hand: Hand,
    obj: ObjectModel,
    grasps: GraspSet,
    protocol: str | Protocol = "dexgraspbench",
    *,
    stop_after: int | None = None,
) -> Verdict:
    """Try grasps in physics, in order.

    Args:
        hand, obj: what `grasps` was made for.
        grasps: N grasps; uses `X_OH`, `q_pregrasp`, `q`, `q_squeeze`.
        protocol: preset name or protocol.
        stop_after: stop after this many successes. The verdict then has one row per grasp *tried*: it belongs to
            `grasps[:len(verdict.success)]`.
    Returns:
        The verdict; its parameters are `verdict_parameters`: mass, friction, forces, limits, every protocol number.
    Raises:
        InputError: `grasps` is of another hand or object. ShapeError: wrong number of joints.
        UnknownNameError: no such preset.
    """
    protocol = get_protocol(protocol)
    check_pair(hand, obj, grasps)
    outcomes: list[TrialOutcome] = []
    trial = GraspTrial(hand, obj, protocol)
    wins = 0
    for i in range(len(grasps)):
        if stop_after is not None and wins >= stop_after:
            break
        outcome = trial.run(grasps.X_OH[i], grasps.q_pregrasp[i], grasps.q[i], grasps.q_squeeze[i])
        wins += outcome.success
        outcomes.append(outcome)
    return Verdict(
        success=np.array([o.success for o in outcomes], bool),
        displacement_m=np.array([o.displacement_m for o in outcomes], np.float64),
        rotation_rad=np.array([o.rotation_rad for o in outcomes], np.float64),
        parameters=verdict_parameters(hand, obj, protocol),
    )


def prescreen(
    hand: Hand,
    obj: ObjectModel,
    grasps: GraspSet,
    protocol: str | Protocol = "dexgraspbench",
    *,
    hold_s: float = 0.2,
) -> np.ndarray:
    """Which grasps are worth a full trial: the same trial with each force held for `hold_s` only.

    Drop what it rejects; never accept what it passes. It runs the first part of the full trial, step for step, so with
    `from_reset` protocols nothing it drops can pass: its recall is 1 by construction.

    Returns:
        (N,) bool, True = keep.
    """
    protocol = get_protocol(protocol)
    if not protocol.from_reset:
        raise InputError(
            f"protocol '{protocol.name}' does not restart each force from the squeeze; it has no pre-screen."
        )
    return validate_grasps(hand, obj, grasps, replace(protocol, hold_s=min(hold_s, protocol.hold_s))).success


def verdict_parameters(hand: Hand, obj: ObjectModel, protocol: str | Protocol) -> dict[str, float]:
    """Every number a success rate must be quoted with: the hand's, the object's and all of the protocol.

    SI units, named in the key, except for pure numbers; `settled_speed` is both m/s and rad/s. Mass and frictions are
    those used in the trial, after `object_mass_kg`, `friction` and `friction_scale`. Switches are 1 or 0.
    """
    protocol = get_protocol(protocol)
    mass = object_mass(obj, protocol)
    sliding, torsional, rolling = contact_friction(obj, protocol)
    effort = hand.tree.effort
    return {
        "mass_kg": mass,
        "friction": sliding,
        "friction_scale": protocol.friction_scale,
        "torsional_friction_m": torsional,
        "rolling_friction_m": rolling,
        "force_n": mass * protocol.force_per_mass,
        "force_per_mass_m_s2": protocol.force_per_mass,
        "min_joint_effort": float(effort.min()),
        "max_joint_effort": float(effort.max()),
        "drive_s": protocol.drive_s,
        "hold_s": protocol.hold_s,
        "from_reset": float(protocol.from_reset),
        "max_displacement_m": protocol.max_displacement_m,
        "max_rotation_rad": protocol.max_rotation_rad,
        "max_start_penetration_m": protocol.max_start_penetration_m,
        "check_every_steps": float(protocol.check_every),
        "settled_speed": protocol.settled_speed,
        "revolute_kp_n_m_per_rad": protocol.revolute.kp,
        "revolute_kv_n_m_s_per_rad": protocol.revolute.kv,
        "revolute_armature_kg_m2": protocol.revolute.armature,
        "prismatic_kp_n_per_m": protocol.prismatic.kp,
        "prismatic_kv_n_s_per_m": protocol.prismatic.kv,
        "prismatic_armature_kg": protocol.prismatic.armature,
        "timestep_s": protocol.timestep_s,
        "noslip_iterations": float(protocol.noslip_iterations),
        "solref_time_constant_s": protocol.solref[0],
        "solref_damping_ratio": protocol.solref[1],
        "solimp_lowest_impedance": protocol.solimp[0],
        "solimp_highest_impedance": protocol.solimp[1],
        "solimp_width_m": protocol.solimp[2],
        "impratio": protocol.impratio,
        "solver_iterations": float(protocol.solver_iterations),
        "condim": float(CONTACT_DIMENSIONS),
        "multiccd": float(protocol.multiccd),
    }


def check_pair(hand: Hand, obj: ObjectModel, grasps: GraspSet) -> None:
    """Raise `InputError` unless `grasps` are of this hand and object, with as many joints as the hand."""
    if grasps.hand != hand.name or grasps.object != obj.name:
        raise InputError(
            f"these grasps are of hand '{grasps.hand}' on object '{grasps.object}'; "
            f"got hand '{hand.name}' and object '{obj.name}'. Load the pair that the grasps were made for."
        )
    for name in ("q", "q_pregrasp", "q_squeeze"):
        hand.check_q(getattr(grasps, name))
