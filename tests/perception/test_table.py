"""The table in a depth image: exact in simulation, and not the floor, a wall or a box."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import Intrinsics, look_at
from neuralgrasps.geometry.plane import Plane, horizontal_plane
from neuralgrasps.geometry.primitives import box_mesh, cylinder_mesh
from neuralgrasps.perception.clusters import find_clusters
from neuralgrasps.perception.frame import Frame
from neuralgrasps.perception.frame_files import CameraNumbers, read_frames
from neuralgrasps.perception.table import find_table, table_extent
from neuralgrasps.sim.camera import DepthNoise, render_depth_view

CAMERA = Intrinsics.from_fov(np.deg2rad(45.0), 320, 240)
X_WC = look_at(np.array([0.75, 0.3, 0.6]), np.array([0.0, 0.0, 0.02]))


def _slab(half, top, centre=(0.0, 0.0)):
    """A level slab with its top at a height, as a mesh and its pose."""
    X = np.eye(4)
    X[:3, 3] = [*centre, top - 0.01]
    return box_mesh([*half, 0.01]), X


def _box(half, centre):
    X = np.eye(4)
    X[:3, 3] = centre
    return box_mesh(half), X


def _can(radius, half, centre):
    X = np.eye(4)
    X[:3, 3] = centre
    return cylinder_mesh(radius, half), X


TABLE = _slab([0.35, 0.3], 0.0)
FLOOR = _slab([3.0, 3.0], -0.72)
WALL = _box([0.01, 3.0, 3.0], [-0.6, 0.0, 0.5])
WALL_PLANE = Plane(np.array([1.0, 0.0, 0.0]), 0.59)
THINGS = [
    _box([0.03, 0.04, 0.06], [0.0, -0.12, 0.06]),
    _can(0.034, 0.05, [0.05, 0.1, 0.05]),
    _box([0.08, 0.1, 0.03], [-0.15, 0.08, 0.03]),
]


def _frame(scene, *, X_WC=X_WC, known_pose=False, noise=None, seed=0):
    meshes, poses = zip(*scene, strict=True)
    view = render_depth_view(meshes, np.stack(poses), X_WC=X_WC, intrinsics=CAMERA, noise=noise, seed=seed)
    return Frame(view.depth, CAMERA, X_WC=X_WC if known_pose else None)


def _off(plane, X_WC=X_WC, top=0.0):
    """Angle, degrees, and largest height error over the table, metres, from the true plane."""
    true = horizontal_plane(top, X_WC)
    corners_W = np.array([[x, y, top] for x in (-0.3, 0.3) for y in (-0.3, 0.3)])
    corners_C = (corners_W - X_WC[:3, 3]) @ X_WC[:3, :3]
    angle = np.rad2deg(np.arccos(np.clip(plane.normal @ true.normal, -1.0, 1.0)))
    return angle, np.abs(plane.height(corners_C)).max()


@pytest.mark.parametrize("eye", [[0.75, 0.3, 0.6], [0.4, -0.5, 0.9], [0.9, 0.0, 0.35], [0.1, 0.1, 0.9]])
@pytest.mark.parametrize("noise", [None, DepthNoise()])
def test_the_plane_is_good_to_half_a_millimetre_and_a_tenth_of_a_degree(eye, noise):
    pose = look_at(np.array(eye), np.array([0.0, 0.0, 0.02]))
    fit = find_table(_frame([TABLE, *THINGS], X_WC=pose, noise=noise), seed=3)
    angle, height = _off(fit.plane, pose)
    assert (angle < 0.1 and height < 5e-4) if noise else (angle < 1e-5 and height < 1e-7)
    assert fit.rms_m < (5e-4 if noise is None else 3e-3)


def test_the_mask_is_the_table_and_only_it():
    frame = _frame([TABLE, FLOOR, *THINGS])
    fit = find_table(frame)
    meshes, poses = zip(TABLE, FLOOR, *THINGS, strict=True)
    truth = render_depth_view(meshes, np.stack(poses), X_WC=X_WC, intrinsics=CAMERA).mesh_index == 0
    truth &= frame.height(horizontal_plane(0.0, X_WC)) > -1e-4  # not its sides
    assert (fit.mask & truth).sum() > 0.97 * truth.sum()
    assert (fit.mask & ~truth).sum() < 0.02 * truth.sum()
    assert fit.inlier_share == pytest.approx(fit.mask.sum() / (frame.depth > 0).sum())


@pytest.mark.parametrize("known_pose", [False, True])
@pytest.mark.parametrize("things", [THINGS, THINGS[:1]])
def test_the_floor_below_a_small_table_is_not_it(known_pose, things):
    eye = look_at(np.array([0.9, 0.2, 0.8]), np.array([-0.1, 0.1, -0.1]))
    small = _slab([0.2, 0.2], 0.0)
    for noise in (None, DepthNoise()):
        frame = _frame([small, FLOOR, *things], X_WC=eye, known_pose=known_pose, noise=noise)
        near_floor = np.abs(frame.height(horizontal_plane(-0.72, eye))) < 0.02
        near_table = np.abs(frame.height(horizontal_plane(0.0, eye))) < 0.02
        assert near_floor.sum() > 2 * near_table.sum()  # the floor is by far the larger plane
        angle, height = _off(find_table(frame).plane, eye)
        assert angle < 0.2 and height < 2e-3


def test_a_floor_on_which_more_stands_is_not_the_table():
    eye = look_at(np.array([0.9, 0.2, 0.8]), np.array([-0.1, 0.1, -0.1]))
    cartons = [_box([0.2, 0.2, 0.15], [-1.0, -0.3, -0.57]), _box([0.2, 0.3, 0.1], [-0.9, 0.8, -0.62])]
    frame = _frame([_slab([0.2, 0.2], 0.0), FLOOR, *cartons, _can(0.034, 0.03, [0.0, 0.0, 0.03])], X_WC=eye)
    angle, height = _off(find_table(frame).plane, eye)
    assert angle < 0.1 and height < 5e-4


@pytest.mark.parametrize("known_pose", [False, True])
def test_a_wall_is_not_the_table(known_pose):
    eye = look_at(np.array([0.9, 0.0, 0.3]), np.array([-0.3, 0.0, 0.15]))
    frame = _frame([TABLE, WALL, *THINGS], X_WC=eye, known_pose=known_pose)
    assert (np.abs(frame.height(WALL_PLANE.moved(np.linalg.inv(eye)))) < 0.01).mean() > 0.4
    angle, height = _off(find_table(frame).plane, eye)
    assert angle < 0.1 and height < 5e-4


def test_the_top_of_a_box_on_the_table_is_not_it():
    carton = _box([0.12, 0.15, 0.05], [0.0, 0.0, 0.05])
    angle, height = _off(find_table(_frame([TABLE, carton])).plane)
    assert angle < 0.1 and height < 5e-4


def test_with_a_pose_only_level_planes_count():
    board = _box([0.01, 0.5, 0.5], [0.0, 0.0, 0.0])
    eye = look_at(np.array([0.9, 0.1, 0.2]), np.zeros(3))
    assert find_table(_frame([board], X_WC=eye)).inlier_share > 0.9
    with pytest.raises(InputError, match=r"no plane in 'frame' is level.*as a wall"):
        find_table(_frame([board], X_WC=eye, known_pose=True))


def test_an_upside_down_pose_is_named():
    frame = _frame([TABLE, *THINGS])
    down = np.diag([1.0, -1.0, -1.0, 1.0]) @ X_WC
    with pytest.raises(InputError, match="X_WC is upside down"):
        find_table(Frame(frame.depth, CAMERA, X_WC=down))
    # an image turned by half a turn about its middle, its pose not known, is fine
    angle, height = _off(find_table(Frame(frame.depth[::-1, ::-1], CAMERA)).plane, X_WC @ np.diag([-1.0, -1, 1, 1]))
    assert angle < 0.1 and height < 5e-4


@pytest.mark.filterwarnings("error")
def test_pixels_without_a_measurement_are_no_hindrance():
    depth = _frame([TABLE, *THINGS]).depth
    depth[np.random.default_rng(0).random(depth.shape) < 0.3] = np.nan
    depth[:, ::40] = 0.0
    angle, height = _off(find_table(Frame(depth, CAMERA)).plane)
    assert angle < 0.1 and height < 5e-4


@pytest.mark.filterwarnings("error")
def test_what_holds_no_plane_is_refused():
    noise = np.random.default_rng(0).uniform(0.5, 2.0, (240, 320))
    with pytest.raises(InputError, match="no table was found in 'frame': no flat part covers"):
        find_table(Frame(noise, CAMERA))
    speck = np.zeros((240, 320))
    speck[100:110, 100:110] = 0.8
    with pytest.raises(InputError, match="no table was found"):
        find_table(Frame(speck, CAMERA))
    with pytest.raises(InputError, match=r"within 0\.3 m"):
        find_table(_frame([TABLE]), max_depth_m=0.3)
    with pytest.raises(InputError, match="max_depth_m is -1"):
        find_table(_frame([TABLE]), max_depth_m=-1.0)


def test_farther_planes_are_left_out():
    eye = look_at(np.array([0.9, 0.2, 0.8]), np.array([-0.1, 0.1, -0.1]))
    bare = _slab([0.12, 0.12], 0.0, (0.2, 0.0))
    frame = _frame([bare, FLOOR], X_WC=eye)
    assert _off(find_table(frame).plane, eye, top=-0.72)[0] < 0.1
    assert find_table(frame).plane.offset_m == pytest.approx(1.52, abs=1e-3)
    assert find_table(frame, max_depth_m=1.3).plane.offset_m == pytest.approx(0.8, abs=1e-3)


def test_one_seed_one_table():
    frame = _frame([TABLE, *THINGS], noise=DepthNoise())
    first, second, other = find_table(frame, seed=1), find_table(frame, seed=1), find_table(frame, seed=2)
    np.testing.assert_array_equal(first.plane.normal, second.plane.normal)
    np.testing.assert_array_equal(first.mask, second.mask)
    assert np.abs(first.plane.normal - other.plane.normal).max() < 1e-4


def test_the_outline_ends_where_the_table_does():
    extent = table_extent(_frame([TABLE]), horizontal_plane(0.0, X_WC))
    assert extent.area_m2 == pytest.approx(0.7 * 0.6, rel=0.1)
    for x, y, outside in ((0.0, 0.0, -0.3), (0.6, 0.0, 0.25), (0.0, -0.5, 0.2)):
        for z in (0.0, 0.3):  # heights do not matter
            point_C = (np.array([x, y, z]) - X_WC[:3, 3]) @ X_WC[:3, :3]
            assert extent.outside_m(point_C[None])[0] == pytest.approx(outside, abs=0.02)
    assert table_extent(_frame([TABLE]), horizontal_plane(0.5, X_WC)) is None


def test_real_tables_are_found_and_not_the_floor(assets):
    camera = CameraNumbers(fx=1066.778, fy=1067.487, cx=312.987, cy=241.311)
    heights = [0.491, 0.537, 0.655, 0.713, 0.627]  # of the camera above the table; over the floor 1.2 m and more
    for frame, height in zip(
        read_frames(assets / "rgbd_ycb", intrinsics=camera, depth_scale=10000), heights, strict=True
    ):
        fit = find_table(frame)
        assert fit.plane.offset_m == pytest.approx(height, abs=0.01)
        assert fit.rms_m < 0.003
        assert find_clusters(frame, fit.plane, extent=fit.extent)
