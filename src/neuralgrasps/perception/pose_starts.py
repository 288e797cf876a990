"""Start poses of the search: rotations of a grid, and stable poses on the table, placed so that outlines meet."""

from __future__ import annotations

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.perception.observation import Observation
from neuralgrasps.perception.pose_model import PoseModel

_OUTLINE = (1.0, 99.0)  # percentiles of the observed points that count as their outline
_OUTLINE_POINTS, _HULL_POINTS = 600, 48
_SURE = 0.05  # weight of the centroid where both sides of the outline are hidden


def start_poses(model: PoseModel, scene: Observation, *, yaw_steps: int) -> np.ndarray:
    """X_CO (N, 4, 4): every rotation of the model's grid, and with a table every stable pose turned `yaw_steps` ways.

    Rotations of the grid are relative to the ray through the observed points, so that what is visible of each does not
    depend on where in the image the object is. Each is placed twice where something hides a part of the outline: its
    outline on the free sides of the observed one, and its visible centroid on the observed one.
    """
    ray = scene.centroid / np.linalg.norm(scene.centroid)
    R = _towards(ray) @ model.rotations
    if scene.table.any():
        R = np.concatenate([R, resting_rotations(model, scene.table[:3], yaw_steps)])
    visible = _visible_centroids(model, R, ray)
    by_outline = _placed(R, visible + _outline_shift(model, scene, R, visible))
    if scene.free.min() > 0.9:
        return by_outline
    return np.concatenate([by_outline, _placed(R, visible + scene.centroid)])


def resting_rotations(model: PoseModel, normal: np.ndarray, yaw_steps: int) -> np.ndarray:
    """(N, 3, 3) rotations with every distinct resting direction against the table's normal, and turns about it."""
    basis = _towards(normal)
    angles = 2.0 * np.pi * np.arange(yaw_steps) / yaw_steps
    turns = np.zeros((yaw_steps, 3, 3))
    turns[:, 0, 0] = turns[:, 1, 1] = np.cos(angles)
    turns[:, 1, 0] = np.sin(angles)
    turns[:, 0, 1] = -turns[:, 1, 0]
    turns[:, 2, 2] = 1.0
    found = []
    for down in model.rest_starts:
        upright = basis @ turns @ _towards(-down).T
        is_round = model.axis.any() and abs(float(model.axis @ down)) > 0.999
        found.append(upright[:1] if is_round else upright)
    return np.concatenate(found)


def _towards(direction: np.ndarray) -> np.ndarray:
    """(3, 3) a rotation that turns z to the unit vector `direction`."""
    side = np.eye(3)[np.argmin(np.abs(direction))]
    x = np.cross(side, direction)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(direction, x), direction], axis=1)


def _visible_centroids(model: PoseModel, R: np.ndarray, ray: np.ndarray) -> np.ndarray:
    """(N, 3) minus the centroid of the visible side of every rotated model, camera axes."""
    nearest = (ray @ R @ model.views.T).argmax(axis=1)
    return -(R @ model.visible[nearest][..., None])[..., 0]


def _outline_shift(model: PoseModel, scene: Observation, R: np.ndarray, visible: np.ndarray) -> np.ndarray:
    """(N, 3) where to put the visible centroid so that the outline meets the free sides of the observed one."""
    mean_z = float(scene.centroid[2])
    few = scene.points[:_OUTLINE_POINTS]
    low, high = np.percentile(few[:, :2] / few[:, 2:] * mean_z, _OUTLINE, axis=0)
    extent = np.empty((len(R), 2, 2))
    _extents(R, visible, model.hull[:_HULL_POINTS], scene.centroid[0], scene.centroid[1], mean_z, extent)
    to_low, to_high = low - extent[:, 0], high - extent[:, 1]
    weight_low, weight_high = scene.free[[0, 2]] ** 2, scene.free[[1, 3]] ** 2
    shift = np.empty((len(R), 3))
    shift[:, :2] = (weight_low * to_low + weight_high * to_high + _SURE * scene.centroid[:2]) / (
        weight_low + weight_high + _SURE
    )
    shift[:, 2] = mean_z
    return shift


@njit(cache=True, error_model="numpy")
def _extents(R, visible, hull, x0, y0, z0, out):  # type: ignore[no-untyped-def]
    """out (N, 2, 2): least and largest x and y of every rotated hull around (x0, y0, z0), as seen at the depth z0."""
    for n in range(R.shape[0]):
        out[n, 0] = 1.0e9
        out[n, 1] = -1.0e9
        for k in range(hull.shape[0]):
            a, b, c = hull[k, 0], hull[k, 1], hull[k, 2]
            z = R[n, 2, 0] * a + R[n, 2, 1] * b + R[n, 2, 2] * c + visible[n, 2]
            scale = z0 / max(z0 + z, 0.2 * z0)
            x = (R[n, 0, 0] * a + R[n, 0, 1] * b + R[n, 0, 2] * c + visible[n, 0] + x0) * scale - x0
            y = (R[n, 1, 0] * a + R[n, 1, 1] * b + R[n, 1, 2] * c + visible[n, 1] + y0) * scale - y0
            out[n, 0, 0], out[n, 1, 0] = min(out[n, 0, 0], x), max(out[n, 1, 0], x)
            out[n, 0, 1], out[n, 1, 1] = min(out[n, 0, 1], y), max(out[n, 1, 1], y)


def _placed(R: np.ndarray, position: np.ndarray) -> np.ndarray:
    X = np.zeros((len(R), 4, 4))
    X[:, :3, :3], X[:, :3, 3], X[:, 3, 3] = R, position, 1.0
    return X
