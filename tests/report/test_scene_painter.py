"""Frames of a robot at a table: things are where they are, hidden by what is in front, and lit by the lamp."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.arms.mount import mount
from neuralgrasps.arms.zoo import load_arm
from neuralgrasps.geometry.camera import Intrinsics, look_at, project
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.geometry.raster import rasterise
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.world import table_box
from neuralgrasps.report.scene import Scene, make_scene, posed_points
from neuralgrasps.report.scene_kernels import fill_faces
from neuralgrasps.report.scene_painter import ScenePainter, View
from neuralgrasps.report.scene_views import close_view, lit_zone, main_view

MakeObject = Callable[..., ObjectModel]
TABLE = table_box(0.70, centre=(0.62, 0.0), size=(0.60, 0.90))
HALF = np.array([0.03, 0.05, 0.08])
LAMP = np.array([0.0, 0.6, 0.8])  # in the yz plane, 53 degrees high
CAMERA = Intrinsics.from_fov(math.radians(40), 320, 240)


@pytest.fixture(scope="module")
def robot() -> Manipulator:
    return mount(load_arm("fetch"), load_hand("fetch"))


@pytest.fixture(scope="module")
def scene(robot: Manipulator, make_object: MakeObject) -> Scene:
    box = make_object("box", box_mesh(HALF), cells=16, points=64)
    return make_scene(robot, [box, box], TABLE, target=0)


@pytest.fixture(scope="module")
def painter(scene: Scene) -> ScenePainter:
    centre, radius = lit_zone(scene)
    return ScenePainter(scene, lamp=LAMP, centre=centre, radius=radius)


def standing(x: float, y: float, *, z: float = 0.70) -> np.ndarray:
    X = np.eye(4)
    X[:3, 3] = [x, y, z + HALF[2]]
    return X


def poses(first: np.ndarray) -> np.ndarray:
    return np.stack([first, standing(0.45, 0.35)])


def view_from(eye: tuple[float, float, float]) -> View:
    return View(X_BC=look_at(np.array(eye), np.array([0.62, -0.1, 0.75])), intrinsics=CAMERA)


def amber(picture: np.ndarray) -> np.ndarray:
    """(h, w) pixels of the target's colour, in light or shadow."""
    red, blue = picture[..., 0].astype(float), picture[..., 2].astype(float)
    return red > 1.8 * blue + 10


def mask_of(mesh, X_BO: np.ndarray, view: View) -> np.ndarray:  # type: ignore[no-untyped-def]
    return np.isfinite(rasterise([mesh], (np.linalg.inv(view.X_BC) @ X_BO)[None], view.intrinsics).depth)


@pytest.mark.parametrize("place", [(0.70, -0.25), (0.55, 0.10)])
@pytest.mark.parametrize("eye", [(1.6, 0.9, 1.5), (1.4, -1.3, 1.3)])
def test_the_object_is_drawn_where_projection_puts_it(scene: Scene, painter: ScenePainter, place, eye):
    X_BO, view = poses(standing(*place)), view_from(eye)
    q = scene.manipulator.q_home
    drawn = amber(painter.paint(painter.light(q, X_BO), view))
    wanted = mask_of(scene.objects[0].mesh, X_BO[0], view)
    assert wanted.sum() > 200
    assert (drawn & wanted).sum() / (drawn | wanted).sum() > 0.9
    middle = project((np.linalg.inv(view.X_BC) @ X_BO[0])[:3, 3], CAMERA)
    rows, columns = np.nonzero(drawn)
    assert np.hypot(columns.mean() - middle[0], rows.mean() - middle[1]) < 3.0


def test_what_stands_in_front_hides_it(scene: Scene, painter: ScenePainter):
    view, q = view_from((1.6, -0.1, 0.78)), scene.manipulator.q_home
    behind, before = standing(0.50, -0.1), standing(0.80, -0.1)
    hidden = amber(painter.paint(painter.light(q, np.stack([behind, before])), view))
    free = amber(painter.paint(painter.light(q, np.stack([behind, standing(0.8, 0.3)])), view))
    assert hidden.sum() < 0.1 * free.sum()


def test_what_is_below_the_table_is_not_seen_from_above(scene: Scene, painter: ScenePainter):
    view, q = view_from((0.9, -0.1, 2.0)), scene.manipulator.q_home
    assert not amber(painter.paint(painter.light(q, poses(standing(0.62, -0.1, z=0.3))), view)).any()


def test_visible_faces_are_those_of_the_exact_raster(scene: Scene):
    X_BO, view = poses(standing(0.6, -0.1)), view_from((1.5, 0.8, 1.4))
    meshes = scene.meshes
    X_CB = np.linalg.inv(view.X_BC)
    points_B = posed_points(meshes.points, meshes.point_body, scene.poses(scene.manipulator.q_home, X_BO))
    points_C = points_B @ X_CB[:3, :3].T + X_CB[:3, 3]
    face = np.full((1, CAMERA.height, CAMERA.width), -1, np.int32)
    inverse = np.zeros(face.shape, np.float32)
    camera = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy])
    fill_faces(points_C, meshes.faces, meshes.two_sided, camera, np.zeros((1, 2)), face, inverse)
    exact = rasterise([Mesh(points_B, meshes.faces)], X_CB[None], CAMERA).depth
    seen = face[0] >= 0
    assert (seen != np.isfinite(exact)).mean() < 1e-3
    both = seen & np.isfinite(exact)
    assert np.percentile(np.abs(1 / inverse[0][both] - exact[both]), 99.9) < 1.5e-3  # half a millimetre decides ties


def test_a_shadow_falls_away_from_the_lamp(scene: Scene, painter: ScenePainter):
    q, at = scene.manipulator.q_home, np.array([0.75, -0.20])
    moment = painter.light(q, poses(standing(*at)))
    bare = painter.light(q, poses(standing(5.0, 5.0)))  # with the arm's shadow alone
    low, size = (TABLE.X_BX[:3, 3] - TABLE.half)[:2], 2 * TABLE.half[:2]

    def lost(x: float, y: float) -> float:
        cell = tuple(((np.array([x, y]) + at - low) / size * moment.top_lamp.shape).astype(int))
        return float(bare.top_lamp[cell] - moment.top_lamp[cell])

    edge, length = -HALF[1], 2 * HALF[2] * LAMP[1] / LAMP[2]
    assert lost(0.0, edge - 0.5 * length) > 0.95
    assert abs(lost(0.0, edge - 1.4 * length)) < 0.05
    assert abs(lost(0.0, HALF[1] + 0.03)) < 0.05  # towards the lamp
    assert abs(lost(HALF[0] + 0.04, edge - 0.5 * length)) < 0.05  # beside it
    cell = tuple(((at - low) / size * moment.top_sky.shape).astype(int))
    assert moment.top_sky[cell] < 0.5 < 0.8 * bare.top_sky[cell]  # under the box


def test_frames_do_not_depend_on_those_before(scene: Scene, painter: ScenePainter):
    view, q = view_from((1.6, 0.9, 1.5)), scene.manipulator.q_home
    X_BO = poses(standing(0.62, -0.05))
    first = painter.paint(painter.light(q, X_BO), view)
    painter.paint(painter.light(q, poses(standing(0.75, 0.2))), view)
    again = painter.paint(painter.light(q, X_BO), view, keep=False)
    assert (first == again).all()


def test_the_main_view_holds_the_table_the_objects_and_the_arm(scene: Scene):
    robot = scene.manipulator
    X_BO = poses(standing(0.62, -0.05))
    view = main_view(scene, [(robot.q_home, X_BO)])
    meshes = scene.meshes
    points = posed_points(meshes.caster_points, meshes.caster_body, scene.poses(robot.q_home, X_BO))
    corners = np.array([[x, y, 1.0] for x in (-1, 1) for y in (-1, 1)]) * TABLE.half + TABLE.X_BX[:3, 3]
    for group in (points[points[:, 2] > 0.7], corners):
        pixels = project(group @ np.linalg.inv(view.X_BC)[:3, :3].T + np.linalg.inv(view.X_BC)[:3, 3], view.intrinsics)
        assert (pixels > 0).all() and (pixels < [view.intrinsics.width, view.intrinsics.height]).all()


def test_the_close_view_follows_the_object(scene: Scene):
    low, high = (close_view(scene, poses(standing(0.62, 0.1, z=z)), np.array([1.0, 0.0, 0.3])) for z in (0.7, 0.9))
    np.testing.assert_allclose(high.X_BC[:3, 3] - low.X_BC[:3, 3], [0, 0, 0.2], atol=1e-12)
    pixels = project((np.linalg.inv(low.X_BC) @ standing(0.62, 0.1))[:3, 3], low.intrinsics)
    assert np.abs(pixels - 104).max() < 40
