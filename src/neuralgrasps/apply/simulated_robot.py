"""The simulator as a `Robot`: what runs here runs on a real one that offers the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from neuralgrasps.apply.robot import RobotState, check_start
from neuralgrasps.apply.table_scenes import TableScene, camera_beside, scene_world, table_plane
from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.arms.trajectory import Trajectory
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix, make_transform_np
from neuralgrasps.perception.frame import Frame
from neuralgrasps.planning.world import PlanningWorld
from neuralgrasps.seeds import child_rng, child_seed
from neuralgrasps.sim.camera import STRUCTURED_LIGHT, DepthNoise
from neuralgrasps.sim.contact_log import Thing
from neuralgrasps.sim.tabletop import Recording, TableTop
from neuralgrasps.sim.tabletop_model import TableTopConfig

_SETTLED_M = 0.001
_OFF = 0.3  # rad or metres: an arm that presses against something lags behind; more is another start


class SimulatedRobot:
    """A robot at a table with objects, and what only a simulator knows: true poses and contacts.

    Args:
        manipulator: the robot; an arm without a camera gets one beside the table.
        scene: table and objects. config: of the physics. record_every_s: states kept for pictures; None: none.
        camera_off_m, camera_off_rad: how far the camera is from where the robot believes it to be, in a direction and
            about an axis that the seed draws once: an error of calibration.
        sensor: the camera's noise. seed: of it; every look draws anew.
    """

    def __init__(
        self,
        manipulator: Manipulator,
        scene: TableScene,
        *,
        config: TableTopConfig | None = None,
        record_every_s: float | None = None,
        camera_off_m: float = 0.0,
        camera_off_rad: float = 0.0,
        sensor: DepthNoise = STRUCTURED_LIGHT,
        seed: int = 0,
    ) -> None:
        if manipulator.arm.camera is None:
            manipulator = replace(manipulator, arm=replace(manipulator.arm, camera=camera_beside(manipulator.arm)))
        self._manipulator = manipulator
        self._sensor = sensor
        self._X_CC = _camera_error(camera_off_m, camera_off_rad, seed)
        self.scene, self.seed = scene, seed
        self.table_top = TableTop(manipulator, [(p.obj, p.X_BO) for p in scene.objects], scene.table, config=config)
        self._looks = 0
        self._record_every_s = record_every_s
        self._gone: set[int] = set()

    @property
    def manipulator(self) -> Manipulator:
        return self._manipulator

    def state(self) -> RobotState:
        return RobotState(q_arm=self.table_top.q_arm, q_hand=self.table_top.q_hand, time_s=self.table_top.time_s)

    def look(self) -> Frame:
        view = self.table_top.depth_view(self._sensor, child_seed(self.seed, "look", self._looks))
        self._looks += 1
        return Frame(
            depth=view.depth, intrinsics=view.intrinsics, X_WC=view.X_WC @ self._X_CC, name=f"look {self._looks}"
        )

    def execute(self, trajectory: Trajectory) -> None:
        check_start(self._manipulator, trajectory, self.table_top.q_arm, slack=_OFF)
        self.table_top.run(trajectory, settle_s=0.0)

    def move_hand(self, q_hand: np.ndarray, *, duration_s: float, force: float = 1.0) -> None:
        self.table_top.move_hand(q_hand, duration_s, force=force)

    def wait(self, duration_s: float) -> None:
        self.table_top.wait(duration_s)

    def settle(self) -> bool:
        """Let everything come to rest and begin to record; whether nothing moved by more than 1 mm."""
        moved = self.table_top.settle().moved(_SETTLED_M)
        if self._record_every_s is not None:
            self.table_top.record(self._record_every_s)
        return not moved

    @property
    def diverged(self) -> bool:
        """Whether the simulation broke down; nothing can be done with it any more."""
        return self.table_top.diverged

    def phase(self, name: str) -> None:
        """Name what follows, for the recording; `hits` are those since then."""
        self.table_top.log.clear()
        self.table_top.begin(name)

    def recording(self) -> Recording | None:
        return None if self._record_every_s is None else self.table_top.recording()

    def object_pose(self, index: int) -> np.ndarray:
        """The true X_BO (4, 4)."""
        return self.table_top.object_pose(index)

    def true_world(self, target: int | None = None) -> PlanningWorld:
        """What is around, as it truly is now; objects that were taken away are not."""
        present = [k for k in range(len(self.scene.objects)) if k not in self._gone]
        scene = TableScene(
            table=self.scene.table, objects=tuple(self.scene.objects[k] for k in present), seed=self.scene.seed
        )
        return scene_world(
            scene, None if target is None else present.index(target), [self.object_pose(k) for k in present]
        )

    @property
    def table_plane(self) -> Plane:
        """The table's top in B."""
        return table_plane(self.scene)

    def is_on_table(self, index: int) -> bool:
        """Whether an object was not taken away."""
        return index not in self._gone

    def take_away(self, index: int) -> None:
        """Put an object out of the scene."""
        self._gone.add(index)
        self.table_top.take_away(index)

    def hand_touches(self, index: int) -> bool:
        """Whether the hand touches an object now."""
        return any(
            t.a.kind is Thing.HAND and t.b.kind is Thing.OBJECT and t.b.index == index
            for t in self.table_top.touching()
        )

    def hits(self, target: int, *, least_n: float) -> tuple[str, ...]:
        """What was touched since the phase began that should not have been, with at least so much force.

        The robot may touch the target with its hand, and its own fingers; the target may touch the table.
        """
        return tuple(
            str(t)
            for t in self.table_top.hits(target)
            if t.max_force_n >= least_n and not (t.a.kind is Thing.HAND and t.b.kind is Thing.HAND)
        )


def _camera_error(off_m: float, off_rad: float, seed: int) -> np.ndarray:
    """(4, 4) motion of the camera by a length along, and an angle about, random directions."""
    direction, axis = child_rng(seed, "camera error").standard_normal((2, 3))
    X = make_transform_np(axis_angle_matrix(axis / np.linalg.norm(axis), off_rad))
    X[:3, 3] = off_m * direction / np.linalg.norm(direction)
    return X
