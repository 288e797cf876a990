"""One look at a table: the pose of what is asked for, the robot itself left out, and plain reasons."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.apply.sight import Sighting, TableView, locate, view_table, without_robot
from neuralgrasps.apply.simulated_robot import SimulatedRobot
from neuralgrasps.apply.table_scenes import TableScene
from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.pose import pose_errors
from neuralgrasps.geometry.primitives import box_mesh, cylinder_mesh
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.geometry.se3_numpy import inverse_np, rpy_matrix, transform_points_np
from neuralgrasps.hands.parts import part_distances
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame
from neuralgrasps.planning.world import PlacedObject

Place = tuple[ObjectModel, float, float, tuple[float, float, float]]


@pytest.fixture(scope="module")
def can(make_object) -> ObjectModel:
    return make_object("can", cylinder_mesh(0.033, 0.05, segments=48), symmetry=True)


@pytest.fixture(scope="module")
def brick(make_object) -> ObjectModel:
    return make_object("brick", box_mesh([0.03, 0.045, 0.06]), symmetry=True)


def scene_of(pick_scene, *places: Place) -> TableScene:
    """Objects at (x, y), turned by roll, pitch and yaw, let down onto the table."""
    placed = []
    for obj, x, y, rpy in places:
        X = np.eye(4)
        X[:3, :3] = rpy_matrix(list(rpy))[:3, :3]
        low = (obj.mesh.vertices @ X[:3, :3].T)[:, 2].min()
        X[:3, 3] = [x, y, pick_scene.robot.arm.table_height_m - low]
        placed.append(PlacedObject(obj=obj, X_BO=X))
    return TableScene(table=pick_scene.scene.table, objects=tuple(placed), seed=0)


def looked(pick_scene, *places: Place, seed: int = 0, robot: Manipulator | None = None) -> tuple[TableView, TableScene]:
    manipulator, scene = robot or pick_scene.robot, scene_of(pick_scene, *places)
    simulated = SimulatedRobot(manipulator, scene, seed=seed)
    return view_table(simulated.look(), manipulator, simulated.table_top.q), scene


def check_pose(sighting: Sighting, truth: PlacedObject, *, mm: float = 2.0, degrees: float = 2.0) -> None:
    assert sighting.X_BO is not None, sighting.reason
    errors = pose_errors(truth.obj, sighting.X_BO, truth.X_BO)
    assert 1e3 * errors.translation_m < mm and np.rad2deg(errors.rotation_rad) < degrees, errors


# ------------------------------------------------------------------ poses


@pytest.mark.parametrize(
    ("place", "seed"),
    [
        ((0.7, 0.1, (0.0, 0.0, 0.4)), 0),
        ((0.85, -0.15, (np.pi / 2, 0.0, 1.0)), 1),
        ((0.65, 0.0, (0, np.pi / 2, 2.0)), 2),
    ],
)
def test_a_single_object_is_found(pick_scene, place, seed: int) -> None:
    """Standing on each of its three pairs of faces."""
    view, scene = looked(pick_scene, (pick_scene.obj, *place), seed=seed)
    sighting = locate(view, pick_scene.obj)
    check_pose(sighting, scene.objects[0])
    assert sighting.others == () and sighting.mask is not None and len(sighting.unknown_B) < 50
    seen_B = transform_points_np(view.frame.X_WC, view.frame.points[sighting.mask & (view.frame.depth > 0)])
    gaps = query_grid_numpy(pick_scene.obj.sdf, transform_points_np(inverse_np(scene.objects[0].X_BO), seen_B))
    assert np.quantile(np.abs(gaps), 0.9) < 0.005


def test_the_target_among_others(pick_scene, can, brick) -> None:
    places = ((pick_scene.obj, 0.7, 0.15, (0, 0, 0.4)), (can, 0.75, -0.15, (0, 0, 0)), (brick, 0.85, 0.02, (0, 0, 0.8)))
    view, scene = looked(pick_scene, *places)
    for k, placed in enumerate(scene.objects):
        rest = [p.obj for i, p in enumerate(scene.objects) if i != k]
        sighting = locate(view, placed.obj, others=rest)
        check_pose(sighting, placed)
        assert sorted(p.obj.name for p in sighting.others) == sorted(o.name for o in rest)
        truth = {p.obj.name: p for p in scene.objects}
        for other in sighting.others:
            check_pose(Sighting(X_BO=other.X_BO, reason=""), truth[other.obj.name], mm=4.0, degrees=4.0)


def test_what_is_not_known_becomes_points(pick_scene, can, brick) -> None:
    places = ((pick_scene.obj, 0.7, 0.15, (0, 0, 0.4)), (brick, 0.75, -0.15, (0, 0, 0)))
    view, scene = looked(pick_scene, *places)
    for sighting in (locate(view, pick_scene.obj), locate(view, pick_scene.obj, others=[can])):
        check_pose(sighting, scene.objects[0])
        assert not any(np.linalg.norm(p.X_BO[:3, 3] - scene.objects[1].X_BO[:3, 3]) > 0.1 for p in sighting.others)
        if sighting.others:  # the brick was taken for the can; then it is there as the can
            continue
        gaps = query_grid_numpy(brick.sdf, transform_points_np(inverse_np(scene.objects[1].X_BO), sighting.unknown_B))
        assert len(gaps) > 300 and np.quantile(np.abs(gaps), 0.95) < 0.01
        assert (sighting.unknown_B[:, 2] > pick_scene.robot.arm.table_height_m + 0.005).all()


def test_nothing_on_the_table_is_said(pick_scene) -> None:
    view, _ = looked(pick_scene)
    for others in ([], [pick_scene.obj]):
        sighting = locate(view, pick_scene.obj, others=others)
        assert sighting.X_BO is None and sighting.pose is None
        assert sighting.reason == "nothing stands on the table."


def test_an_absent_object_is_not_made_up_among_others(pick_scene, can) -> None:
    """Only a can stands there, and it is known."""
    view, _ = looked(pick_scene, (can, 0.75, -0.1, (0, 0, 0)))
    sighting = locate(view, pick_scene.obj, others=[can])
    assert sighting.X_BO is None and sighting.reason == "'gelatin_box' was not found on the table; seen: can."


def test_the_same_seed_gives_the_same_sighting(pick_scene) -> None:
    place = (pick_scene.obj, 0.7, 0.1, (0.0, 0.0, 0.4))
    first, again = (locate(looked(pick_scene, place, seed=3)[0], pick_scene.obj, seed=1) for _ in range(2))
    np.testing.assert_array_equal(first.X_BO, again.X_BO)


# ------------------------------------------------------------------ the table, the robot


def test_the_table_is_where_it_is_and_goes_on_beyond_what_is_seen(pick_scene) -> None:
    view, scene = looked(pick_scene, (pick_scene.obj, 0.7, 0.1, (0.0, 0.0, 0.4)))
    top = pick_scene.robot.arm.table_height_m
    at = scene.table.X_BX[:2, 3] + scene.table.half[:2] * np.array([[0, 0], [1, 1], [1, -1], [-0.5, 1], [-0.5, -1]])
    corners = np.column_stack([at, np.full(len(at), top)])
    assert np.abs(view.plane_B.height(corners)).max() < 0.005 and view.plane_B.normal[2] > 0.9999
    local = (corners - view.box.X_BX[:3, 3]) @ view.box.X_BX[:3, :3]
    np.testing.assert_allclose(local[:, 2], view.box.half[2], atol=0.005)
    assert (np.abs(local[:, :2]) <= view.box.half[:2]).all()


@pytest.fixture(scope="module")
def reaching(pick_scene) -> Manipulator:
    """The robot whose home is at the standoff, the hand and forearm before the camera."""
    robot, plan = pick_scene.robot, pick_scene.plan
    return replace(robot, q_home=robot.full_q(plan.approach.q[0], plan.q_pregrasp))


def near_robot(robot: Manipulator, q: np.ndarray, frame: Frame, gap_m: float) -> int:
    """Measured points, one in 24, nearer than a gap to the robot's solids."""
    points_B = transform_points_np(frame.X_WC, frame.points[frame.depth > 0][::24])
    points_B = points_B[np.linalg.norm(points_B[:, :2], axis=1) < 1.1]
    X_BL = forward_numpy(robot.tree, q)
    near = np.zeros(len(points_B), bool)
    for part in robot.parts:
        near |= part_distances(part, transform_points_np(inverse_np(X_BL[part.link]), points_B)) < gap_m
    return int(near.sum())


def test_the_robot_is_taken_out_of_the_picture(pick_scene, reaching) -> None:
    simulated = SimulatedRobot(reaching, pick_scene.scene, seed=1)
    frame, q = simulated.look(), simulated.table_top.q
    left = without_robot(frame, reaching, q)
    assert near_robot(reaching, q, frame, 0.01) > 150
    assert near_robot(reaching, q, left, 0.01) < 0.02 * near_robot(reaching, q, frame, 0.01)
    kept = left.depth > 0
    np.testing.assert_array_equal(left.depth[kept], frame.depth[kept])
    lost = (frame.depth > 0) & ~kept
    assert lost.sum() < 24 * 1.6 * near_robot(reaching, q, frame, 0.02)
    alone = without_robot(frame, reaching, reaching.full_q(pick_scene.q_start, reaching.hand.q_open))
    assert near_robot(reaching, q, alone, 0.01) > 100  # the joints matter: another posture removes other pixels


def test_the_object_is_found_with_the_arm_before_the_camera(pick_scene, reaching) -> None:
    simulated = SimulatedRobot(reaching, pick_scene.scene, seed=1)
    view = view_table(simulated.look(), reaching, simulated.table_top.q)
    sighting = locate(view, pick_scene.obj)
    check_pose(sighting, pick_scene.scene.objects[0], mm=5.0, degrees=5.0)
    X_BL, far = forward_numpy(reaching.tree, simulated.table_top.q), np.ones(len(sighting.unknown_B), bool)
    for part in reaching.parts:
        far &= part_distances(part, transform_points_np(inverse_np(X_BL[part.link]), sighting.unknown_B)) > 0.01
    assert far.all(), "the robot is taken for a thing on the table"


def test_no_table_is_said(pick_scene) -> None:
    frame = SimulatedRobot(pick_scene.robot, pick_scene.scene).look()
    q = pick_scene.robot.full_q(pick_scene.q_start)
    with pytest.raises(InputError, match="level"):  # a wall right before the camera
        view_table(replace(frame, depth=np.full_like(frame.depth, 1.2)), pick_scene.robot, q)
    with pytest.raises(InputError, match="no camera pose"):
        view_table(replace(frame, X_WC=None), pick_scene.robot, q)
