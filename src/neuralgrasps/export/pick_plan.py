"""A whole pick as one YAML document: what the hand and the arm do, step by step, and the grasp that it is for."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.arms.trajectory import Trajectory
from neuralgrasps.errors import DataFormatError, InputError
from neuralgrasps.export.frames import pose_of, wrist_of
from neuralgrasps.export.joint_trajectory import (
    KIND,
    joint_trajectory,
    posture_trajectory,
    trajectory_of,
    trajectory_point,
)
from neuralgrasps.export.joints import hand_joints
from neuralgrasps.export.messages import Message, Ros, check_message
from neuralgrasps.export.moveit_grasp import KIND as GRASP_KIND
from neuralgrasps.export.moveit_grasp import GraspMessageConfig, moveit_grasps
from neuralgrasps.export.plan_origin import PlanOrigin, gripper_opening
from neuralgrasps.export.yaml_files import read_yaml, write_yaml
from neuralgrasps.geometry.se3_numpy import inverse_np
from neuralgrasps.hands.hand import Hand

if TYPE_CHECKING:
    from neuralgrasps.planning.pick import PickPlan

FORMAT = "neuralgrasps.pick_plan"
VERSION = 1
STEPS = (("open_hand", "hand"), ("transfer", "arm"), ("approach", "arm"), ("close_hand", "hand"), ("lift", "arm"))
_KEYS = ("format", "version", "ros", "arm", "hand", "object", "frame_id", "wrist_link", "grasp", "plan")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanStep:
    """One step: `name` and `group` ("arm" or "hand") as in `STEPS`, `message` a `trajectory_msgs/JointTrajectory`."""

    name: str
    group: str
    message: Message

    def trajectory(self, joint_names: Sequence[str] | None = None) -> Trajectory:
        """The motion of an arm step, its joints in the order of `joint_names` where given.

        Raises:
            DataFormatError: a step of the hand, which is one posture and no motion; or as `trajectory_of`.
        """
        return trajectory_of(self.message, joint_names=joint_names, where=f"step {self.name}")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanFile:
    """A pick that was read from a file.

    Attributes:
        arm, hand, object: names. frame_id: the arm's base link, in which `grasp` is. wrist_link: whose pose it says.
        grasp: `moveit_msgs/Grasp`. steps: in order. ros: 1 or 2.
        X_BO: (4, 4) the object in `frame_id` that was planned with; None where the file does not say it.
    """

    arm: str
    hand: str
    object: str
    frame_id: str
    wrist_link: str
    grasp: Message
    steps: tuple[PlanStep, ...]
    ros: Ros
    X_BO: np.ndarray | None = None


def plan_document(
    plan: PickPlan,
    manipulator: Manipulator,
    *,
    config: GraspMessageConfig | None = None,
    origin: PlanOrigin | None = None,
) -> dict[str, Any]:
    """A pick as the dict that YAML holds.

    `grasp` is a `moveit_msgs/Grasp` in the arm's base frame; `plan` lists the steps in order, each a
    `trajectory_msgs/JointTrajectory`: the hand opens to the pre-grasp, transfer, approach, the hand closes and presses,
    lift. Steps begin when the one before has ended; a step of the hand is a posture and the time it may take.

    Postures of the hand are clamped to the joint limits (`plan.q_squeeze` may lie beyond them, see `grip_target`); the
    force is `effort` of the closing points. `gripper` says the same for a jaw that is sent an opening: `opening_m`,
    metres between the pads, before, where they touch (expected, not to be sent), and to close; `max_effort` in newtons.

    Args:
        config: times, distances, force, ROS version and the robot's joint names.
        origin: pose of the object, its confidence, the table, the seed; written where known, else null.
    Raises:
        InputError: the plan's grasp is of another hand, or its motions of other joints.
    """
    config = config or GraspMessageConfig()
    hand, ros = manipulator.hand, config.ros
    wrist, base = wrist_of(manipulator), manipulator.arm.tree.link_names[0]
    (grasp,) = moveit_grasps(
        replace(plan.grasp, q_pregrasp=plan.q_pregrasp[None], q=plan.q_grasp[None], q_squeeze=plan.q_squeeze[None]),
        hand,
        frame_id=base,
        X_frame_O=plan.X_BH @ inverse_np(plan.grasp.X_OH[0]),
        wrist=wrist,
        names=[f"grasp_{plan.index}"],
        config=config,
    )
    joints = hand_joints(hand, names=config.joint_names)

    def posture(points: Sequence[tuple[np.ndarray, float]], *, press: bool) -> Message:
        effort = config.force * joints.effort if press else None
        made = [trajectory_point(joints.targets(q), t, effort=effort, ros=ros) for q, t in points]
        return posture_trajectory(joints.names, made, ros=ros)

    def motion(name: str) -> Message:
        trajectory: Trajectory = getattr(plan, name)
        if trajectory.joint_names != manipulator.arm_names:
            raise InputError(
                f"the {name} moves {', '.join(trajectory.joint_names)}; expected the joints of '{manipulator.name}': "
                f"{', '.join(manipulator.arm_names)}."
            )
        return joint_trajectory(trajectory, ros=ros)

    closing = [(plan.q_grasp, config.close_s), (plan.q_squeeze, config.close_s + config.squeeze_s)]
    messages = {
        "open_hand": posture([(plan.q_pregrasp, config.close_s)], press=False),
        "close_hand": posture(closing, press=True),
        **{name: motion(name) for name, group in STEPS if group == "arm"},
    }
    return {
        "format": FORMAT,
        "version": VERSION,
        "ros": ros,
        "arm": manipulator.arm.name,
        "hand": hand.name,
        "object": plan.grasp.object,
        "frame_id": base,
        "wrist_link": wrist.link,
        **(origin or PlanOrigin()).fields(),
        "gripper": _gripper(plan, hand, config.force),
        "grasp": grasp,
        "plan": [{"name": n, "group": g, "kind": KIND, "message": messages[n]} for n, g in STEPS],
    }


def _gripper(plan: PickPlan, hand: Hand, force: float) -> Message | None:
    postures = {"open_hand": plan.q_pregrasp, "touch": plan.q_grasp, "close_hand": plan.q_squeeze}
    openings = {name: gripper_opening(hand, q) for name, q in postures.items()}
    if None in openings.values():
        return None
    return {"opening_m": openings, "max_effort": force * float(hand.tree.effort.max())}


def save_pick_plan(
    path: str | os.PathLike[str],
    plan: PickPlan,
    manipulator: Manipulator,
    *,
    config: GraspMessageConfig | None = None,
    origin: PlanOrigin | None = None,
) -> Path:
    """Write `plan_document(...)` as YAML; equal plans, equal bytes. Returns the path.

    Raises:
        StorageError: it cannot be written. InputError: as `plan_document`.
    """
    data = plan_document(plan, manipulator, config=config, origin=origin)
    return write_yaml(path, data, comment=f"pick '{data['object']}' with '{manipulator.name}', step by step")


def load_pick_plan(path: str | os.PathLike[str]) -> PlanFile:
    """Read a file of `save_pick_plan`, every message checked.

    Raises:
        InputError: the file cannot be read. DataFormatError: not such a file, or a field does not fit.
    """
    data = read_yaml(path)
    if not isinstance(data, dict) or data.get("format") != FORMAT or data.get("version") != VERSION:
        got = (data.get("format"), data.get("version")) if isinstance(data, dict) else type(data).__name__
        raise DataFormatError(f"'{path}' holds {got!r}; expected format {FORMAT!r}, version {VERSION}.")
    if missing := [k for k in _KEYS if k not in data]:
        raise DataFormatError(f"'{path}' lacks {', '.join(missing)}; expected {', '.join(_KEYS)}.")
    ros = data["ros"]
    if ros not in (1, 2):
        raise DataFormatError(f"'{path}': ros is {ros!r}; expected 1 or 2.")
    check_message(GRASP_KIND, data["grasp"], ros=ros, name=f"'{path}': grasp")
    return PlanFile(
        **{k: str(data[k]) for k in ("arm", "hand", "object", "frame_id", "wrist_link")},
        grasp=data["grasp"],
        steps=tuple(_steps(data["plan"], ros, path)),
        ros=ros,
        X_BO=_object_pose(data.get("object_pose"), ros, path),
    )


def _object_pose(fields: Any, ros: Ros, path: str | os.PathLike[str]) -> np.ndarray | None:
    if fields is None:
        return None
    check_message("geometry_msgs/Pose", fields, ros=ros, name=f"'{path}': object_pose")
    try:
        return pose_of(fields)
    except InputError as error:
        raise DataFormatError(f"'{path}': object_pose: {error}") from error


def _steps(listed: Any, ros: Ros, path: str | os.PathLike[str]) -> list[PlanStep]:
    wanted = [n for n, _ in STEPS]
    found = [s.get("name") if isinstance(s, dict) else None for s in listed] if isinstance(listed, list) else []
    if found != wanted:
        raise DataFormatError(f"'{path}': plan has the steps {found}; expected {wanted}.")
    steps = []
    for (name, group), step in zip(STEPS, listed, strict=True):
        where = f"'{path}': step {name}"
        if step.get("group") != group or step.get("kind") != KIND:
            raise DataFormatError(
                f"{where} is {step.get('kind')!r} of {step.get('group')!r}; expected {KIND} of {group!r}."
            )
        check_message(KIND, step.get("message"), ros=ros, name=where)
        steps.append(PlanStep(name=name, group=group, message=step["message"]))
    return steps
