"""Pose from one depth view: recovered to a millimetre without noise, modulo symmetry."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.evaluate.pose import pose_errors
from neuralgrasps.geometry.camera import Intrinsics, back_project, look_at
from neuralgrasps.geometry.mesh import merge_meshes
from neuralgrasps.geometry.primitives import box_mesh, sphere_mesh
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.perception.pose import PoseConfig, estimate_pose, free_space_violation
from neuralgrasps.sim.camera import DepthNoise, render_depth_view

CAMERA = Intrinsics.from_fov(np.deg2rad(35.0), 200, 150)
X_WC = look_at(np.array([0.55, 0.2, 0.4]), np.array([0.0, 0.0, 0.03]))


def _moved(mesh, shift):
    X = np.eye(4)
    X[:3, 3] = shift
    return mesh.transformed(X)


@pytest.fixture(scope="module")
def objects(make_object):
    corner = merge_meshes(
        [box_mesh([0.05, 0.02, 0.015]), _moved(box_mesh([0.012, 0.02, 0.04]), [0.038, 0.0, 0.025]),
         _moved(box_mesh([0.015, 0.03, 0.01]), [-0.03, 0.03, 0.004])]
    )  # fmt: skip
    return {
        "box": make_object("box", box_mesh([0.03, 0.045, 0.06]), symmetry=True),
        "ball": make_object("ball", sphere_mesh(0.04, segments=64), symmetry=True),
        "corner": make_object("corner", corner, symmetry=True),
    }


def _look(obj, rotvec, *, noise=None, seed=0):
    X_WO = np.eye(4)
    X_WO[:3, :3] = Rotation.from_rotvec(rotvec).as_matrix()
    X_WO[:3, 3] = [0.01, -0.02, 0.05]
    floor = np.eye(4)
    floor[2, 3] = -0.06
    view = render_depth_view(
        [obj.mesh, box_mesh([0.5, 0.5, 0.01])], np.stack([X_WO, floor]), X_WC=X_WC, intrinsics=CAMERA, noise=noise,
        seed=seed,
    )  # fmt: skip
    return view, back_project(view.depth, CAMERA, mask=view.mesh_index == 0), np.linalg.inv(X_WC) @ X_WO


TURNS = ([0.4, 0.9, -0.3], [-1.2, 0.5, 2.0])


@pytest.mark.parametrize("name", ["box", "ball", "corner"])
@pytest.mark.parametrize("turn", TURNS)
def test_pose_without_noise_is_good_to_a_millimetre_and_a_degree(objects, name, turn):
    obj = objects[name]
    view, points_C, truth = _look(obj, turn)
    result = estimate_pose(obj, points_C, depth=view.depth, intrinsics=CAMERA)
    errors = pose_errors(obj, result.X_CO, truth)
    assert errors.translation_m < 1e-3
    assert np.rad2deg(errors.rotation_rad) < 1.0
    assert result.converged and result.residual < 5e-4
    np.testing.assert_array_equal(result.alternatives_X_CO[0], result.X_CO)
    assert (np.diff(result.alternatives_score_m) >= 0).all()


@pytest.mark.parametrize("name", ["box", "ball", "corner"])
def test_pose_with_sensor_noise_is_good_to_three_millimetres(objects, name):
    obj = objects[name]
    for seed, turn in enumerate(TURNS):
        view, points_C, truth = _look(obj, turn, noise=DepthNoise(), seed=seed)
        errors = pose_errors(obj, estimate_pose(obj, points_C, depth=view.depth, intrinsics=CAMERA).X_CO, truth)
        assert errors.add_s_m < 3e-3 and errors.translation_m < 3e-3
        assert np.rad2deg(errors.rotation_rad) < 4.0


def test_moving_the_points_moves_the_pose(objects):
    obj = objects["corner"]
    _, points_C, _ = _look(obj, TURNS[0])
    shift = np.array([0.03, -0.02, 0.15])
    first, second = estimate_pose(obj, points_C), estimate_pose(obj, points_C + shift)
    errors = pose_errors(obj, second.X_CO, np.block([[np.eye(3), shift[:, None]], [np.zeros(3), 1.0]]) @ first.X_CO)
    assert errors.mssd_m < 1e-3


def test_stray_points_do_not_spoil_the_pose(objects):
    obj = objects["corner"]
    view, points_C, truth = _look(obj, TURNS[0])
    stray = np.random.default_rng(0).uniform(-0.08, 0.08, (len(points_C) // 8, 3)) + points_C.mean(axis=0)
    result = estimate_pose(obj, np.concatenate([points_C, stray]), depth=view.depth, intrinsics=CAMERA)
    errors = pose_errors(obj, result.X_CO, truth)
    assert errors.translation_m < 2e-3 and np.rad2deg(errors.rotation_rad) < 1.5


def test_points_that_are_not_finite_are_ignored(objects):
    obj = objects["box"]
    _, points_C, truth = _look(obj, TURNS[0])
    dirty = np.concatenate([points_C, [[np.nan, 0, 0], [np.inf, 0, 1]]])
    assert pose_errors(obj, estimate_pose(obj, dirty).X_CO, truth).add_s_m < 1e-3


def test_one_seed_one_pose(objects):
    _, points_C, _ = _look(objects["corner"], TURNS[0])
    first, second = (estimate_pose(objects["corner"], points_C, seed=4) for _ in range(2))
    np.testing.assert_array_equal(first.X_CO, second.X_CO)
    np.testing.assert_array_equal(first.alternatives_score_m, second.alternatives_score_m)
    assert first.seed == 4


def test_free_space_tells_apart_what_the_visible_points_cannot(objects):
    # only the top face of the box is observed: the box may as well stick out to the left or the right of it
    obj = objects["box"]
    view, points_C, truth = _look(obj, [0.0, 0.0, 0.0])
    aside = np.eye(4)
    aside[0, 3] = -0.03
    top = view.mesh_index == 0
    wrong = truth @ aside
    right_m, wrong_m = free_space_violation(obj, np.stack([truth, wrong]), view.depth, CAMERA)
    assert right_m < 1e-5
    assert wrong_m > 2e-3
    assert top.any() and len(points_C) > 100


def test_free_space_is_silent_where_nothing_was_measured_or_something_is_in_front(objects):
    obj = objects["box"]
    view, _, truth = _look(obj, TURNS[0])
    for depth in (np.zeros_like(view.depth), np.full_like(view.depth, np.nan), np.full_like(view.depth, np.inf),
                  np.full_like(view.depth, 0.1)):  # fmt: skip
        assert free_space_violation(obj, truth[None], depth, CAMERA)[0] == 0.0
    far = np.full_like(view.depth, 5.0)  # the camera saw through everything: all counts, clipped
    assert free_space_violation(obj, truth[None], far, CAMERA, clip_m=0.02)[0] == pytest.approx(0.02)
    behind = np.diag([1.0, 1.0, 1.0, 1.0])
    behind[2, 3] = -1.0
    assert free_space_violation(obj, behind[None], far, CAMERA)[0] == 0.0


def test_the_free_space_term_decides_between_poses_of_equal_fit(make_object):
    # of a bar only a strip of the middle is used, so it may slide along itself; the camera saw past its true ends
    bar = make_object("bar", box_mesh([0.08, 0.02, 0.02]))
    view, points_C, truth = _look(bar, [0.0, 0.0, 0.5])
    along = (points_C - truth[:3, 3]) @ truth[:3, 0]
    strip = points_C[np.abs(along - 0.05) < 0.015]
    slid = truth.copy()
    slid[:3, 3] += 0.06 * truth[:3, 0]
    for pose in (truth, slid):
        fit = query_grid_numpy(bar.sdf, (strip - pose[:3, 3]) @ pose[:3, :3])
        assert np.abs(fit).max() < 5e-4
    right_m, wrong_m = free_space_violation(bar, np.stack([truth, slid]), view.depth, CAMERA)
    assert right_m < 1e-4 and wrong_m > 3e-3
    seeing = estimate_pose(bar, strip, depth=view.depth, intrinsics=CAMERA)
    assert free_space_violation(bar, seeing.X_CO[None], view.depth, CAMERA)[0] < 1e-3


def test_a_wrong_object_does_not_converge(objects):
    view, points_C, _ = _look(objects["box"], TURNS[0])
    result = estimate_pose(objects["ball"], points_C, depth=view.depth, intrinsics=CAMERA)
    assert not result.converged and result.score_m > 0.003


def test_bad_input_is_named(objects):
    box, points = objects["box"], np.random.default_rng(0).uniform(0.5, 1.0, (30, 3))
    with pytest.raises(InputError, match="19 finite points"):
        estimate_pose(box, np.concatenate([points[:19], np.full((5, 3), np.nan)]))
    with pytest.raises(ShapeError, match="points_C has shape"):
        estimate_pose(box, points[:, :2])
    with pytest.raises(InputError, match="both `depth` and `intrinsics`"):
        estimate_pose(box, points, depth=np.zeros((150, 200)))
    with pytest.raises(InputError, match="150 x 200"):
        estimate_pose(box, points, depth=np.zeros((10, 20)), intrinsics=CAMERA)


def test_more_points_than_needed_or_fewer_are_fine(objects):
    obj = objects["box"]
    _, points_C, truth = _look(obj, TURNS[0])
    few = estimate_pose(obj, points_C[:: len(points_C) // 40], config=PoseConfig(rotations=500))
    assert pose_errors(obj, few.X_CO, truth).add_s_m < 5e-3
