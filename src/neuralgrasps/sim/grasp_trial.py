"""Trying grasps in physics: the verdict that synthesis and evaluation trust.

One trial: the hand starts at the pre-grasp around the floating object, ramps its position servos to the grasp and on to
the squeeze, and then the object is pulled along each of its own axes, both ways. It fails the moment the object has
moved or turned too far from where it started.

A trial is a pure function of (hand, object, one grasp, protocol): every trial starts from `mj_resetData`, and runs
in one thread, so the verdict of a grasp has the same bits whatever is tried before it or beside it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum

import mujoco
import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.se3_numpy import inverse_np
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.sim.build import (
    OBJECT_BODY,
    OBJECT_JOINT,
    grasp_model,
    joint_name,
    leaders,
    object_mass,
)
from neuralgrasps.sim.protocols import Protocol, get_protocol
from neuralgrasps.sim.robot_bodies import free_pose

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_DIRECTIONS_O = np.concatenate([np.eye(3), -np.eye(3)])[[0, 3, 1, 4, 2, 5]]  # +x, -x, +y, -y, +z, -z
_FIRST_ROUND_S = 0.2
_SETTLED_CHECKS = 8
DIVERGED = (
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
        held: index of the force that the grasp failed under, in the order +x, -x, +y, -y, +z, -z; 6 when it failed
            under none. Without an observer, forces before it may have been withstood for their first 0.2 s only.
    """

    success: bool
    displacement_m: float
    rotation_rad: float
    start_penetration_m: float
    held: int


Observer = Callable[[Phase, int, mujoco.MjData], None]


@contextmanager
def silent_engine() -> Iterator[None]:
    """Keep the engine from printing, and from writing a log file to the working directory, when a trial diverges.

    The setting is the engine's, not a thread's: enter it around all threads.
    """
    before, silent = mujoco.MjLogConfig.get(), mujoco.MjLogConfig.get()
    silent.logto_console = False
    silent.logto_file = False
    mujoco.MjLogConfig.set(silent)
    try:
        yield
    finally:
        mujoco.MjLogConfig.set(before)


@njit(cache=True, error_model="numpy")
def _motion(start_centre, start_rotation, centre, rotation, worst):  # type: ignore[no-untyped-def]
    """How far (m) and by what angle (rad) the object is from its start; `worst` keeps the largest of both."""
    squared = trace = 0.0
    for i in range(3):
        squared += (centre[i] - start_centre[i]) ** 2
    for i in range(9):
        trace += start_rotation[i] * rotation[i]
    displacement = math.sqrt(squared)
    angle = math.acos(min(1.0, max(-1.0, 0.5 * (trace - 1.0))))
    # written so that nan is kept: a diverged state is lost, not held
    worst[0] = displacement if not displacement <= worst[0] else worst[0]
    worst[1] = angle if not angle <= worst[1] else worst[1]
    return displacement, angle


class GraspTrial:
    """The compiled model of one hand and one object, ready to try any number of grasps.

    Not thread-safe: it owns one simulation state. Use one per thread (`another` shares the compiled model).
    """

    def __init__(
        self, hand: Hand, obj: ObjectModel, protocol: str | Protocol, *, model: mujoco.MjModel | None = None
    ) -> None:
        self.hand = hand
        self.obj = obj
        self.protocol = get_protocol(protocol)
        self.model = model or grasp_model(hand, obj, self.protocol)
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
        # views of the engine's own arrays
        self._centre = self.data.xipos[self._body]
        self._rotation = self.data.xmat[self._body]

    def another(self) -> GraspTrial:
        """A second trial of the same pair, with a state of its own."""
        return GraspTrial(self.hand, self.obj, self.protocol, model=self.model)

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
        diverged = any(self.data.warning[kind].number for kind in DIVERGED)
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
        return free_pose(data.qpos[self._object_qpos : self._object_qpos + 7])

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
        """Pull along the object's six directions; returns `TrialOutcome.held`."""
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
            if self.protocol.settled_speed > 0.0:
                still = still + 1 if np.abs(self.data.qvel).max() < self.protocol.settled_speed else 0
        return still

    def _checks(self, seconds: float) -> int:
        return max(1, round(seconds / (self.protocol.timestep_s * self.protocol.check_every)))

    def _advance(self, phase: Phase, direction: int, observe: Observer | None) -> bool:
        """Step to the next check; True while the object is where it should be."""
        mujoco.mj_step(self.model, self.data, nstep=self.protocol.check_every)
        if observe:
            observe(phase, direction, self.data)
        displacement, angle = _motion(
            self._start_centre, self._start_rotation.ravel(), self._centre, self._rotation, self._worst
        )
        # written so that a diverged (nan) state is lost, not held
        return displacement <= self.protocol.max_displacement_m and angle <= self.protocol.max_rotation_rad
