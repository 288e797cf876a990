"""A robot at a table with objects, driven by position control: what a plan meets before it meets a real robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.arms.trajectory import Trajectory
from neuralgrasps.errors import InputError, ShapeError, check_shape
from neuralgrasps.geometry.se3_numpy import make_transform_np
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.sim.camera import DepthNoise, DepthView
from neuralgrasps.sim.contact_log import ContactLog, Touch, scene_things
from neuralgrasps.sim.grasp_trial import DIVERGED, silent_engine
from neuralgrasps.sim.robot_bodies import free_pose, position_quaternion, tree_leaders
from neuralgrasps.sim.self_contact import held_tree, moving_joints
from neuralgrasps.sim.tabletop_model import SolidBox, TableTopConfig, floor_height, tabletop_model
from neuralgrasps.sim.tabletop_view import SceneMeshes

_STILL_SPEED = 0.01  # m/s and rad/s: slower objects have settled
_STILL_STEPS = 25
_FAR_M = 10.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """States of a trial at equal times.

    Attributes:
        t: (T,) float64 seconds.
        q: (T, Q) float64 all joints of the manipulator, rad or metres.
        X_BO: (T, K, 4, 4) float64 poses of the objects in B.
        phases: T names.
    """

    t: np.ndarray
    q: np.ndarray
    X_BO: np.ndarray
    phases: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.t)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """How a motion went.

    Attributes:
        tracking_error: (D,) largest |q - q_desired| of the planned joints while it ran, rad or metres.
        end_error: (D,) the same when it had ended.
        diverged: the simulation broke down; the trial is lost.
    """

    tracking_error: np.ndarray
    end_error: np.ndarray
    diverged: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Settling:
    """How objects came to rest.

    Attributes:
        moved_m, turned_rad: (K,) motion of each object's centre of mass and orientation since it was placed.
        still: all had stopped. duration_s: how long it took.
    """

    moved_m: np.ndarray
    turned_rad: np.ndarray
    still: bool
    duration_s: float

    def moved(self, limit_m: float = 0.001) -> bool:
        """Did anything move by more than `limit_m`, or not come to rest?"""
        return not (self.still and bool((self.moved_m <= limit_m).all()))


class TableTop:
    """One scene, simulated.

    Deterministic: the same calls after `reset` give the same bits. One thread. A simulation that breaks down sets
    `diverged`; from then on nothing moves and object poses are nan, so that no check on them passes.

    Args:
        manipulator: the robot; starts at home with an open hand.
        objects: models and poses X_BO (4, 4); index k everywhere is the place in this list.
        table: the table top. boxes: further boxes.
    Raises:
        ShapeError, InputError, RobotDescriptionError: what is wrong with the arguments.
    """

    def __init__(
        self,
        manipulator: Manipulator,
        objects: Sequence[tuple[ObjectModel, np.ndarray]],
        table: SolidBox,
        *,
        boxes: Sequence[SolidBox] = (),
        config: TableTopConfig | None = None,
    ) -> None:
        self.manipulator = manipulator
        self.config = config or TableTopConfig()
        self.objects = tuple(obj for obj, _ in objects)
        for _, X_BO in objects:
            check_shape("X_BO", np.shape(X_BO), (4, 4))
        self._start = [np.asarray(X_BO, np.float64).copy() for _, X_BO in objects]
        self.boxes = (table, *boxes)
        self.tree = held_tree(manipulator)
        self.model = tabletop_model(manipulator, self.objects, self.boxes, self.config)
        self.data = mujoco.MjData(self.model)
        self._links, self._qpos = moving_joints(self.model, self.tree)
        links, self._gain, self._offset = tree_leaders(self.tree, manipulator.name)
        self._leader = self._qpos[np.searchsorted(self._links, links)]
        self._object_qpos = [int(self.model.joint(f"object_{k}").qposadr[0]) for k in range(len(self.objects))]
        self._object_qvel = [int(self.model.joint(f"object_{k}").dofadr[0]) for k in range(len(self.objects))]
        self._lead = -self.model.actuator_biasprm[:, 2] / self.model.actuator_gainprm[:, 0]  # kv / kp
        self._lead[len(manipulator.arm_dofs) :] = 0.0
        self._effort = self.model.actuator_forcerange.copy()
        self.log = ContactLog(*scene_things(self.model, manipulator, self.objects, self.boxes))
        self._meshes = SceneMeshes(manipulator, self.objects, self.boxes, floor_height(table, self.config))
        self.reset()

    def reset(self) -> None:
        """Back to the start: robot at home, objects where they were placed, clock, log and recording empty."""
        model, data = self.model, self.data
        mujoco.mj_resetData(model, data)
        model.actuator_forcerange[:] = self._effort
        for k in range(len(self.objects)):
            self._set_present(k, present=True)
        q = self._moving_q(self.manipulator.q_home)
        data.qpos[self._qpos] = self.tree.joint_positions(q)[self._links]
        for k, X_BO in enumerate(self._start):
            self._set_pose(k, X_BO)
        self._target = q.copy()
        self._every = 0
        self._steps = 0
        self._states: list[tuple[float, np.ndarray, np.ndarray, str]] = []
        self.diverged = False
        self.log.clear()
        self.begin("start")
        mujoco.mj_forward(model, data)

    def begin(self, phase: str) -> None:
        """Name what follows, in the contact log and in the recording."""
        self.phase = phase
        self.log.begin(phase)

    @property
    def time_s(self) -> float:
        return float(self.data.time)

    @property
    def q_arm(self) -> np.ndarray:
        """(D,) planned joints."""
        return self._q()[: len(self.manipulator.arm_dofs)]

    @property
    def q_hand(self) -> np.ndarray:
        """(J,) joints of the hand."""
        return self._q()[len(self.manipulator.arm_dofs) :]

    @property
    def q(self) -> np.ndarray:
        """(Q,) all joints of the manipulator."""
        return self.manipulator.full_q(self.q_arm, self.q_hand)

    def object_pose(self, index: int) -> np.ndarray:
        """X_BO (4, 4) of object `index`; nan when the simulation broke down."""
        at = self._object_qpos[index]
        return np.full((4, 4), np.nan) if self.diverged else free_pose(self.data.qpos[at : at + 7])

    def object_poses(self) -> np.ndarray:
        """X_BO (K, 4, 4) of all objects."""
        poses = [self.object_pose(k) for k in range(len(self.objects))]
        return np.stack(poses) if poses else np.zeros((0, 4, 4))

    def place(self, index: int, X_BO: np.ndarray) -> None:
        """Put object `index` to a pose (4, 4), at rest; one that was taken away is back."""
        check_shape("X_BO", np.shape(X_BO), (4, 4))
        self._set_present(index, present=True)
        self._set_pose(index, np.asarray(X_BO, np.float64))
        mujoco.mj_forward(self.model, self.data)

    def take_away(self, index: int) -> None:
        """Put object `index` far off, where it floats and touches nothing until it is placed or all is reset."""
        self._set_present(index, present=False)
        self._set_pose(index, make_transform_np(translation=[0.0, _FAR_M * (index + 1), -_FAR_M]))
        mujoco.mj_forward(self.model, self.data)

    def settle(self, max_s: float = 3.0) -> Settling:
        """Stand still until all objects do, at most `max_s`."""
        before, start = self._object_frames(), self.time_s
        still = 0
        while still < _STILL_STEPS and self.time_s - start < max_s and not self.diverged:
            self._drive(self._target[None], None)
            slow = all(np.abs(self.data.qvel[v : v + 6]).max() < _STILL_SPEED for v in self._object_qvel)
            still = still + 1 if slow else 0
        after = self._object_frames()
        moved = np.array([np.linalg.norm(b[:3, 3] - a[:3, 3]) for a, b in zip(before, after, strict=True)])
        turned = np.array([_angle(a[:3, :3].T @ b[:3, :3]) for a, b in zip(before, after, strict=True)])
        return Settling(moved_m=moved, turned_rad=turned, still=still >= _STILL_STEPS, duration_s=self.time_s - start)

    def run(self, trajectory: Trajectory, q_hand: np.ndarray | None = None, *, settle_s: float = 0.3) -> Motion:
        """Follow a trajectory, then stand for `settle_s`.

        Args:
            trajectory: of the planned joints, by name; it should start where the arm is.
            q_hand: (J,) hand target from the start on; None keeps the target, and so the force, that the hand has.
        Raises:
            InputError: other joints than the planned ones.
        """
        names, D = self.manipulator.arm_names, len(self.manipulator.arm_dofs)
        if set(trajectory.joint_names) != set(names) or len(trajectory.joint_names) != D:
            raise InputError(f"trajectory moves joints {trajectory.joint_names}; expected {names}.")
        column = [trajectory.joint_names.index(n) for n in names]
        count = max(1, int(np.ceil(trajectory.duration_s / self.config.timestep_s)))
        q, qd = trajectory.sample(np.arange(1, count + 1) * self.config.timestep_s)
        q, qd = q[:, column], qd[:, column]
        qd[-1] = 0.0
        targets = np.tile(self._target, (count, 1))
        targets[:, :D] = q
        if q_hand is not None:
            targets[:, D:] = self._hand_target(q_hand)
        ahead = np.zeros_like(targets)
        ahead[:, :D] = qd
        worst = self._drive(targets, ahead)
        self.wait(settle_s)
        return Motion(tracking_error=worst, end_error=np.abs(self.q_arm - self._target[:D]), diverged=self.diverged)

    def move_hand(
        self, q_to: np.ndarray, duration_s: float, *, q_from: np.ndarray | None = None, force: float = 1.0
    ) -> Motion:
        """Move the hand's targets evenly from where they are to `q_to` (J,).

        Args:
            q_to: servo targets: they may lie inside an object, or beyond the joints' limits.
            q_from: where to start; default the present targets.
            force: share in (0, 1] of the joints' effort limits that they may use from now on.
        """
        if not 0.0 < force <= 1.0:
            raise InputError(f"force is {force}; expected a share of the effort limits above 0, at most 1.")
        D = len(self.manipulator.arm_dofs)
        self.model.actuator_forcerange[D:] = force * self._effort[D:]
        start = self._target[D:] if q_from is None else self._hand_target(q_from)
        count = max(1, round(duration_s / self.config.timestep_s))
        share = (np.arange(1, count + 1) / count)[:, None]
        targets = np.tile(self._target, (count, 1))
        targets[:, D:] = start + share * (self._hand_target(q_to) - start)
        return self._stand(targets)

    def wait(self, duration_s: float) -> Motion:
        """Keep all targets for a time."""
        return self._stand(np.tile(self._target, (round(duration_s / self.config.timestep_s), 1)))

    def touching(self) -> tuple[Touch, ...]:
        """What touches what now."""
        return self.log.now(self.data, self.phase)

    def touches(self, phases: Sequence[str] | None = None) -> tuple[Touch, ...]:
        """What touched what since the start, phase by phase."""
        return self.log.touches(phases)

    def hits(self, target: int, phases: Sequence[str] | None = None) -> tuple[Touch, ...]:
        """Contacts that should not have been: the robot with anything but object `target` in its hand; the target
        with other objects or boxes. The target's contact with the table is none."""
        return tuple(t for t in self.touches(phases) if t.unwanted(target))

    def record(self, every_s: float = 0.02) -> None:
        """Keep states from now on, every `every_s` seconds (rounded to steps)."""
        self._every, self._steps = max(1, round(every_s / self.config.timestep_s)), 0
        self._keep()

    def recording(self) -> Recording:
        """What was kept since the first `record`."""
        count, dofs = len(self.objects), self.manipulator.tree.num_dofs
        return Recording(
            t=np.array([s[0] for s in self._states]),
            q=np.array([s[1] for s in self._states]).reshape(-1, dofs),
            X_BO=np.array([s[2] for s in self._states]).reshape(-1, count, 4, 4),
            phases=tuple(s[3] for s in self._states),
        )

    def depth_view(
        self, noise: DepthNoise | None = None, seed: int = 0, *, X_BC: np.ndarray | None = None
    ) -> DepthView:
        """What the arm's camera sees now: true meshes of the objects, table, floor, robot.

        `mesh_index` is the object's index; surroundings and the robot come after the objects. `X_WC` is X_BC at the
        simulated joints, or as given (a camera beside the robot, with the intrinsics of the arm's).
        """
        if self.diverged:
            raise InputError("the simulation broke down; there is nothing to look at.")
        return self._meshes.view(self.q, self.object_poses(), noise=noise, seed=seed, X_BC=X_BC)

    def _stand(self, targets: np.ndarray) -> Motion:
        worst = self._drive(targets, None)
        error = np.abs(self.q_arm - self._target[: len(self.manipulator.arm_dofs)])
        return Motion(tracking_error=worst, end_error=error, diverged=self.diverged)

    def _drive(self, targets: np.ndarray, speeds: np.ndarray | None) -> np.ndarray:
        """One step per row of targets (N, D + J); returns the arm's largest deviation (D,) from them."""
        D = len(self.manipulator.arm_dofs)
        shift = self._offset / self._gain
        control = targets + shift if speeds is None else targets + shift + self._lead * speeds
        leader, gain, shift_D = self._leader[:D], self._gain[:D], self._offset[:D]
        worst, data, model = np.zeros(D), self.data, self.model
        with silent_engine():
            for row, wanted in zip(control, targets[:, :D], strict=True):
                if self.diverged:
                    break
                data.ctrl[:] = row
                mujoco.mj_step(model, data)
                self.log.add(data)
                np.maximum(worst, np.abs((data.qpos[leader] - shift_D) / gain - wanted), out=worst)
                self.diverged = any(data.warning[kind].number for kind in DIVERGED)
                if self._every:
                    self._steps += 1
                    if self._steps % self._every == 0:
                        self._keep()
        if len(targets):
            self._target = targets[-1].copy()
        return worst

    def _set_pose(self, index: int, X_BO: np.ndarray) -> None:
        at, v = self._object_qpos[index], self._object_qvel[index]
        self.data.qpos[at : at + 3], self.data.qpos[at + 3 : at + 7] = position_quaternion(X_BO)
        self.data.qvel[v : v + 6] = 0.0

    def _set_present(self, index: int, *, present: bool) -> None:
        """Whether an object has weight and touches."""
        body = self.model.body(f"object_{index}").id
        geoms = self.model.geom_bodyid == body
        self.model.geom_contype[geoms] = self.model.geom_conaffinity[geoms] = int(present)
        self.model.body_gravcomp[body] = 0.0 if present else 1.0

    def _keep(self) -> None:
        self._states.append((self.time_s, self.q, self.object_poses(), self.phase))

    def _q(self) -> np.ndarray:
        """(D + J,) planned joints and those of the hand."""
        return (self.data.qpos[self._leader] - self._offset) / self._gain

    def _moving_q(self, q: np.ndarray) -> np.ndarray:
        return np.asarray(q, np.float64)[np.concatenate([self.manipulator.arm_dofs, self.manipulator.hand_dofs])]

    def _hand_target(self, q_hand: np.ndarray) -> np.ndarray:
        q_hand = np.asarray(q_hand, np.float64)
        self.manipulator.hand.check_q(q_hand)
        if q_hand.ndim != 1 or not np.isfinite(q_hand).all():
            raise ShapeError(f"hand target has shape {q_hand.shape}; expected one row of finite numbers.")
        return q_hand

    def _object_frames(self) -> list[np.ndarray]:
        """Poses of the objects' centres of mass, axes of O."""
        frames = []
        for k, obj in enumerate(self.objects):
            X = self.object_pose(k)
            X[:3, 3] += X[:3, :3] @ np.asarray(obj.com_O)
            frames.append(X)
        return frames


def _angle(R: np.ndarray) -> float:
    return float(np.arccos(np.clip((np.trace(R) - 1.0) / 2.0, -1.0, 1.0)))
