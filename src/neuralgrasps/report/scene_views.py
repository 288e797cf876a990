"""Where to look from at a robot that picks something up: one view of all of it, and one close to the hand."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from neuralgrasps.geometry.camera import Intrinsics, look_at
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.raster import rasterise
from neuralgrasps.report.scene import Scene, posed_points
from neuralgrasps.report.scene_painter import View
from neuralgrasps.report.views import frame_camera, view_direction

MAIN_SIZE, CLOSE_SIZE = (640, 480), (208, 208)
_ELEVATION_DEG = 24.0
_AZIMUTHS_DEG = (52.0, -52.0)  # three-quarter, from beside the table, the robot's front in sight
_BELOW_TABLE_M = 0.10  # of the robot that is shown
_CLOSE_FOV_RAD, _CLOSE_WIDTH_M = math.radians(24.0), 0.30
_CLOSE_DIRECTIONS = tuple((azimuth, elevation) for elevation in (16.0, 34.0) for azimuth in range(0, 360, 30))

Moment = tuple[np.ndarray, np.ndarray]  # q (Q,) and X_BO (K, 4, 4)


def main_view(scene: Scene, moments: Sequence[Moment], *, size: tuple[int, int] = MAIN_SIZE) -> View:
    """A fixed camera that sees the table and the robot above it at all `moments`, from the side that shows more.

    Args:
        moments: of the motion, the decisive one (the grasp) last.
        size: width and height, pixels.
    """
    points = np.concatenate([_shown_points(scene, *moment) for moment in moments])
    views = []
    for azimuth in _AZIMUTHS_DEG:
        X_BC, intrinsics = frame_camera(points, view_direction(azimuth, _ELEVATION_DEG), size, margin=0.03)
        views.append(View(X_BC=X_BC, intrinsics=intrinsics))
    seen = [_seen_pixels(scene, moments[-1], view) for view in views]
    return views[int(np.argmax(seen))]


def lamp_direction(view: View) -> np.ndarray:
    """(3,) unit vector towards a lamp to the left of a view, high enough for short shadows."""
    back = -view.X_BC[:3, 2]
    azimuth = math.degrees(math.atan2(back[1], back[0])) - 75.0
    return view_direction(azimuth, 50.0)


def lit_zone(scene: Scene) -> tuple[np.ndarray, float]:
    """Middle and radius of the ball that gets shadows: the table and the space that the arm works in above it."""
    half = scene.table.half
    middle = scene.table.X_BX[:3, 3] + [-0.25 * half[0], 0.0, 0.18]
    return middle, float(np.linalg.norm([1.15 * half[0], half[1], 0.30]))


def close_direction(scene: Scene, moment: Moment) -> np.ndarray:
    """(3,) direction from the object towards a camera that sees most of it and of the fingers at a moment."""
    best, best_score = view_direction(60.0, 20.0), -1.0
    for azimuth, elevation in _CLOSE_DIRECTIONS:
        view = close_view(scene, moment[1], view_direction(azimuth, elevation), size=(56, 56))
        score = _seen_pixels(scene, moment, view)
        if score > best_score * 1.0001:
            best, best_score = view_direction(azimuth, elevation), score
    return best


def close_view(scene: Scene, X_BO: np.ndarray, direction: np.ndarray, *, size: tuple[int, int] = CLOSE_SIZE) -> View:
    """A camera near the object to be lifted, which follows it as it rises; `X_BO` (K, 4, 4) are all objects."""
    obj, X = scene.objects[scene.target], X_BO[scene.target]
    middle = X[:3, :3] @ (0.5 * (obj.mesh.vertices.min(axis=0) + obj.mesh.vertices.max(axis=0))) + X[:3, 3]
    width = max(_CLOSE_WIDTH_M, 1.35 * float(np.linalg.norm(np.ptp(obj.mesh.vertices, axis=0))))
    middle[2] += 0.12 * width
    distance = 0.5 * width / math.tan(0.5 * _CLOSE_FOV_RAD)
    X_BC = look_at(middle + distance * np.asarray(direction), middle)
    return View(X_BC=X_BC, intrinsics=Intrinsics.from_fov(_CLOSE_FOV_RAD, *size))


def _shown_points(scene: Scene, q: np.ndarray, X_BO: np.ndarray) -> np.ndarray:
    """Corners of the table, the objects, and the robot from a little below the table on; (M, 3) in B."""
    meshes = scene.meshes
    points = posed_points(meshes.caster_points, meshes.caster_body, scene.poses(q, X_BO))
    table = scene.table
    corners = np.array([[x, y, 1.0] for x in (-1, 1) for y in (-1, 1)]) * table.half
    corners = corners @ table.X_BX[:3, :3].T + table.X_BX[:3, 3]
    return np.concatenate([points[points[:, 2] > corners[0, 2] - _BELOW_TABLE_M], corners])


def _seen_pixels(scene: Scene, moment: Moment, view: View) -> float:
    """How much of the object and of the fingers a view shows, as a number to compare views by."""
    X_B = scene.poses(*moment)
    meshes = scene.meshes
    points = posed_points(meshes.caster_points, meshes.caster_body, X_B)
    body = scene.manipulator.tree.num_links + scene.target
    shift = scene.manipulator.hand_link
    fingers = {link + shift for finger in scene.manipulator.hand.fingers for link in finger.links}
    k = view.intrinsics
    small = Intrinsics.from_fov(2 * math.atan(0.5 * k.height / k.fy), 96 * k.width // k.height, 96)
    image = rasterise([Mesh(points, meshes.caster_faces)], np.linalg.inv(view.X_BC)[None], small)
    seen = meshes.caster_body[meshes.caster_faces[image.face_index[image.face_index >= 0], 0]]
    return math.sqrt((seen == body).sum()) + math.sqrt(np.isin(seen, list(fingers)).sum())
