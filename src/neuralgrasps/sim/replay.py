"""The motion of one trial, for pictures and videos."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.sim.grasp_trial import GraspTrial, Phase, TrialOutcome, silent_engine
from neuralgrasps.sim.protocols import Protocol
from neuralgrasps.sim.validate import check_pair


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialTrajectory:
    """States of one trial at its start and at every check, seen from the hand base H.

    Attributes:
        time_s: (T,) float64 seconds since the start, running on over the six forces.
        X_HO: (T, 4, 4) float64 object in the hand base, metres.
        q: (T, J) float64 independent joints, rad or metres.
        phases: T names: "start", "grasp", "squeeze", "hold".
        force_direction: (T,) int32, index of the force in +x, -x, +y, -y, +z, -z of the object at the start; -1: none.
        outcome: how the trial ended; the last state is the failing one when it failed.
    """

    time_s: np.ndarray
    X_HO: np.ndarray
    q: np.ndarray
    phases: tuple[Phase, ...]
    force_direction: np.ndarray
    outcome: TrialOutcome

    def __len__(self) -> int:
        return len(self.time_s)


def trial_trajectory(
    hand: Hand, obj: ObjectModel, grasp: GraspSet, protocol: str | Protocol = "dexgraspbench"
) -> TrialTrajectory:
    """Try one grasp as `validate_grasps` does and record it.

    Args:
        grasp: one grasp of `obj` by `hand` (`grasps[i]`).
    Raises:
        InputError: `grasp` holds another number of grasps than one, or is of another hand or object.
    """
    check_pair(hand, obj, grasp)
    if len(grasp) != 1:
        raise InputError(f"trial_trajectory got {len(grasp)} grasps; expected one: pass grasps[i].")
    trial = GraspTrial(hand, obj, protocol)
    poses: list[np.ndarray] = []
    joints: list[np.ndarray] = []
    phases: list[Phase] = []
    directions: list[int] = []

    def record(phase: Phase, direction: int, data: mujoco.MjData) -> None:
        poses.append(trial.object_pose(data))
        joints.append(trial.joint_values(data))
        phases.append(phase)
        directions.append(direction)

    with silent_engine():
        outcome = trial.run(grasp.X_OH[0], grasp.q_pregrasp[0], grasp.q[0], grasp.q_squeeze[0], observe=record)
    return TrialTrajectory(
        time_s=np.arange(len(poses)) * trial.protocol.timestep_s * trial.protocol.check_every,
        X_HO=np.stack(poses),
        q=np.stack(joints),
        phases=tuple(phases),
        force_direction=np.array(directions, np.int32),
        outcome=outcome,
    )
