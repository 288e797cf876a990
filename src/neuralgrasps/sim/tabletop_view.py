"""What a camera sees of a table-top scene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.arms.meshes import link_meshes
from neuralgrasps.errors import ShapeError
from neuralgrasps.geometry.mesh import Mesh, box_mesh
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.sim.camera import DepthNoise, DepthView, render_depth_view
from neuralgrasps.sim.tabletop_model import SolidBox

_FLOOR_HALF_M = (4.0, 4.0, 0.05)


class SceneMeshes:
    """Meshes of a scene, in the order objects, boxes, floor, links of the robot that have parts."""

    def __init__(
        self, manipulator: Manipulator, objects: Sequence[ObjectModel], boxes: Sequence[SolidBox], floor_z_m: float
    ) -> None:
        self._manipulator = manipulator
        X_floor = np.eye(4)
        X_floor[2, 3] = floor_z_m - _FLOOR_HALF_M[2]
        self._X_still = np.array([*(np.asarray(b.X_BX) for b in boxes), X_floor])
        robot = link_meshes(manipulator)
        self._links = [link for link, _ in robot]
        self.meshes: tuple[Mesh, ...] = (
            *(o.mesh for o in objects),
            *(box_mesh(b.half) for b in boxes),
            box_mesh(np.array(_FLOOR_HALF_M)),
            *(mesh for _, mesh in robot),
        )

    def poses(self, q: np.ndarray, X_BO: np.ndarray) -> np.ndarray:
        """(M, 4, 4) pose in B of every mesh for all joints (Q,) and object poses (K, 4, 4)."""
        X_BL = forward_fast(self._manipulator.tree, q)
        return np.concatenate([X_BO, self._X_still, X_BL[self._links]])

    def view(
        self,
        q: np.ndarray,
        X_BO: np.ndarray,
        *,
        noise: DepthNoise | None = None,
        seed: int = 0,
        X_BC: np.ndarray | None = None,
    ) -> DepthView:
        """The arm's camera's image; `X_BC` (4, 4) puts the camera elsewhere.

        Raises:
            ShapeError: the arm has no camera.
        """
        camera = self._manipulator.arm.camera
        if camera is None:
            raise ShapeError(f"arm '{self._manipulator.arm.name}' has no camera; state one in its arm.toml.")
        if X_BC is None:
            X_BC = self._manipulator.camera_pose(q[self._manipulator.arm_dofs])
        return render_depth_view(
            self.meshes, self.poses(q, X_BO), X_WC=X_BC, intrinsics=camera.intrinsics, noise=noise, seed=seed
        )
