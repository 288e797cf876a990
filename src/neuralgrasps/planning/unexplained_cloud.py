"""Observed points that nothing known explains: what is left to avoid blindly."""

from __future__ import annotations

import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.errors import check_shape
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.hands.parts import bounding_sphere, part_distances
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.planning.world import BoxObstacle, PlacedObject, PlanningWorld


def unexplained_cloud(
    points_B: np.ndarray,
    world: PlanningWorld,
    *,
    manipulator: Manipulator | None = None,
    q: np.ndarray | None = None,
    margin_m: float = 0.01,
    robot_margin_m: float = 0.02,
) -> np.ndarray:
    """The points that are not near the table, a placed object or the robot; for `PlanningWorld.cloud_B`.

    Args:
        points_B: (M, 3) observed points, metres; those that are not finite are dropped.
        world: its boxes, target and objects explain points; its own cloud is not looked at.
        manipulator: the robot in view, at all its joints q (Q,), as `Manipulator.full_q` gives them; None for none.
        margin_m: points nearer than this to a box or an object, or inside it, are explained. What stands on a table
            loses its lowest `margin_m`.
        robot_margin_m: the same for the robot.
    Returns:
        (K, 3) points, in their order.
    Raises:
        ShapeError: points_B is not (M, 3), or q not (Q,).
    """
    points = np.asarray(points_B, float)
    check_shape("points_B", points.shape, (None, 3))
    points = points[np.isfinite(points).all(axis=1)]
    for box in world.boxes:
        points = points[~_in_box(points, box, margin_m)]
    for placed in (*world.objects, *([world.target] if world.target else [])):
        points = points[~_near_object(points, placed, margin_m)]
    if manipulator is not None:
        pose = manipulator.q_home if q is None else np.asarray(q, float)
        points = points[~_near_robot(points, manipulator, pose, robot_margin_m)]
    return np.ascontiguousarray(points)


def _in_box(points: np.ndarray, box: BoxObstacle, margin: float) -> np.ndarray:
    local = (points - box.X_BX[:3, 3]) @ box.X_BX[:3, :3]
    beyond = np.maximum(np.abs(local) - box.half, 0.0)
    return np.asarray(np.linalg.norm(beyond, axis=1) < margin)


def _near_object(points: np.ndarray, placed: PlacedObject, margin: float) -> np.ndarray:
    local = (points - placed.X_BO[:3, 3]) @ placed.X_BO[:3, :3]
    low, high = placed.obj.mesh.bounds
    near = ((local > low - margin) & (local < high + margin)).all(axis=1)
    near[near] = query_grid_numpy(placed.obj.sdf, local[near]) < margin
    return np.asarray(near)


def _near_robot(points: np.ndarray, manipulator: Manipulator, q: np.ndarray, margin: float) -> np.ndarray:
    X_BL = forward_fast(manipulator.tree, q)
    near = np.zeros(len(points), bool)
    for part in manipulator.parts:
        X, (centre, radius) = X_BL[part.link], bounding_sphere(part)
        local = (points - X[:3, 3]) @ X[:3, :3]
        asked = ~near & (((local - centre) ** 2).sum(axis=1) < (radius + margin) ** 2)
        near[asked] = part_distances(part, local[asked]) < margin
    return near
