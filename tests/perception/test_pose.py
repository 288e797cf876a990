"""Pose from one depth view: exact without noise, modulo symmetry, and honest where the view cannot decide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.evaluate.pose import pose_errors
from neuralgrasps.geometry.camera import look_at
from neuralgrasps.geometry.mesh import merge_meshes
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.primitives import box_mesh, cylinder_mesh
from neuralgrasps.objects.zoo import load_object
from neuralgrasps.perception.pose import PoseConfig, estimate_pose
from neuralgrasps.sim.camera import DepthNoise

FRONT = look_at(np.array([0.6, 0.0, 0.03]), np.array([0.0, 0.0, 0.03]))
FACING = 0.345  # yaw at which the camera of `look` sees an upright box's face head on
TOWARDS = np.array([np.cos(FACING), np.sin(FACING)])


def _at(x, y, z, yaw_rad=0.0):
    X = np.eye(4)
    X[:3, :3] = Rotation.from_euler("z", yaw_rad).as_matrix()
    X[:3, 3] = [x, y, z]
    return X


def _assert_near(obj, X_CO, truth, *, metres, degrees):
    errors = pose_errors(obj, X_CO, truth)
    assert errors.translation_m < metres
    assert np.rad2deg(errors.rotation_rad) < degrees
    assert errors.add_s_m < metres


def _lowest(obj, X_CO, table):
    return float(table.height(obj.mesh.vertices @ X_CO[:3, :3].T + X_CO[:3, 3]).min())


@pytest.fixture(scope="module")
def cube(make_object):
    """Nearly a cube: two sides of 5 cm, one of 6 cm."""
    return make_object("cube", box_mesh([0.025, 0.025, 0.030]), symmetry=True)


# ---- a known pose


@pytest.mark.parametrize("how", ["points", "points and table", "image", "image and table"])
@pytest.mark.parametrize("name", ["box", "ball", "can", "wedge", "corner", "bevelled", "rimmed"])
def test_a_known_pose_is_recovered_to_half_a_millimetre(things, look, standing, name, how):
    obj = things[name]
    for rest, yaw in ((0, 1.0), (1, 2.6)):
        seen = look(obj.mesh, standing(obj, rest, yaw_rad=yaw))
        found = estimate_pose(obj, **seen.asked(how))
        _assert_near(obj, found.X_CO, seen.X_CO, metres=5e-4, degrees=0.5)
        assert found.converged and found.confidence > 0.9
        assert found.explained > 0.95 and found.residual_m < 2e-4 and found.score > 0.9


def test_any_pose_in_the_air_is_recovered(things, look):
    for seed, name in enumerate(("wedge", "corner", "box", "rimmed")):
        X_WO = _at(0.02, -0.03, 0.06)
        X_WO[:3, :3] = Rotation.random(random_state=seed).as_matrix()
        seen = look(things[name].mesh, X_WO, table=False)
        for how in ("points", "image"):
            found = estimate_pose(things[name], **seen.asked(how))
            _assert_near(things[name], found.X_CO, seen.X_CO, metres=1e-3, degrees=1.0)


def test_an_outline_places_what_faces_do_not(things, look):
    # two faces of the box are seen; how far it reaches along both only its outline tells, to a pixel of 2.3 mm
    seen = look(things["box"].mesh, _at(0.0, 0.0, 0.06, FACING))
    for how in ("points", "image"):
        found = estimate_pose(things["box"], **seen.asked(how))
        _assert_near(things["box"], found.X_CO, seen.X_CO, metres=2.3e-3, degrees=0.3)


@pytest.mark.parametrize("name", ["bevelled", "rimmed"])
@pytest.mark.parametrize("how", ["points", "image and table"])
def test_of_turns_that_look_alike_the_true_one_is_chosen(things, look, standing, name, how):
    obj = things[name]
    for yaw in (0.4, 1.2, -0.4):  # the cut edge is in view
        for upside_down in (False, True):
            X_WO = _at(0.0, 0.0, 0.06 if name == "bevelled" else 0.0, yaw)
            if upside_down:
                X_WO = X_WO @ np.diag([1.0, -1.0, -1.0, 1.0])
                X_WO[2, 3] += 0.096 if name == "rimmed" else 0.0
                X_WO = X_WO if name == "rimmed" else X_WO @ _at(0.0, 0.0, 0.0, 0.5)
            seen = look(obj.mesh, X_WO)
            found = estimate_pose(obj, **seen.asked(how))
            assert pose_errors(obj, found.X_CO, seen.X_CO).mssd_m < 1e-3
            assert found.alternatives_probability[0] > 0.4


@pytest.fixture(scope="module")
def mug(make_object):
    """A can with a handle so small that all but 5 % of its surface is a can's."""
    handle = box_mesh([0.012, 0.004, 0.020]).transformed(_at(0.05, 0.0, 0.05))
    body = cylinder_mesh(0.04, 0.05, segments=64).transformed(_at(0.0, 0.0, 0.05))
    return make_object("mug", merge_meshes([body, handle]), symmetry=True)


def test_a_handle_gives_a_can_a_heading(look, mug):
    for yaw in (-1.2, -0.6, 0.0, 0.6, 1.2, 1.8):
        seen = look(mug.mesh, _at(0.0, 0.0, 0.0, yaw))
        for how in ("image", "image and table"):
            assert pose_errors(mug, estimate_pose(mug, **seen.asked(how)).X_CO, seen.X_CO).mssd_m < 1e-3


def test_a_handle_that_is_partly_hidden_gives_a_can_a_heading(look, mug):
    seen = look(mug.mesh, _at(0.0, 0.0, 0.0, 2.8))
    found = estimate_pose(mug, **seen.asked("image and table"))
    assert pose_errors(mug, found.X_CO, seen.X_CO).mssd_m < 5e-3


@pytest.mark.parametrize("name", ["box", "ball", "wedge", "corner", "can"])
def test_with_sensor_noise_the_pose_is_good_to_three_millimetres(things, look, standing, name):
    obj = things[name]
    for seed, yaw in enumerate((0.8, 2.4)):
        seen = look(obj.mesh, standing(obj, yaw_rad=yaw), noise=DepthNoise(), seed=seed)
        found = estimate_pose(obj, **seen.asked("image and table"))
        _assert_near(obj, found.X_CO, seen.X_CO, metres=3e-3, degrees=3.0)
        assert found.converged


@pytest.mark.parametrize("scan", ["004_sugar_box", "021_bleach_cleanser", "051_large_clamp"])
def test_scans_are_found_from_any_side(assets, look, standing, scan):
    obj = load_object(assets / "ycb" / f"{scan}.ply")
    for rest, yaw in ((0, 0.9), (0, 4.0), (1, 2.2)):
        seen = look(obj.mesh, standing(obj, rest, yaw_rad=yaw))
        for how in ("points", "image and table"):
            found = estimate_pose(obj, **seen.asked(how))
            assert pose_errors(obj, found.X_CO, seen.X_CO).mssd_m < 2e-3
            assert found.confidence > 0.9


# ---- what must not matter


def test_moving_the_points_moves_the_pose(things, look, standing):
    obj = things["corner"]
    points = look(obj.mesh, standing(obj, yaw_rad=1.0)).points_C
    turn = _at(0.0, 0.0, 0.0, 0.7)  # of the camera about its axis
    first, second = estimate_pose(obj, points), estimate_pose(obj, points @ turn[:3, :3].T)
    assert pose_errors(obj, second.X_CO, turn @ first.X_CO).mssd_m < 1e-3


def test_stray_points_do_not_spoil_the_pose(things, look, standing):
    obj = things["corner"]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0))
    stray = np.random.default_rng(0).uniform(-0.08, 0.08, (len(seen.points_C) // 8, 3)) + seen.points_C.mean(axis=0)
    found = estimate_pose(obj, np.concatenate([seen.points_C, stray]))
    _assert_near(obj, found.X_CO, seen.X_CO, metres=2e-3, degrees=1.0)
    # a mask that spills over onto the table
    mask = seen.mask.copy()
    for _ in range(2):
        mask[1:] |= mask[:-1].copy()
        mask[:, 1:] |= mask[:, :-1].copy()
    assert mask.sum() > 1.1 * seen.mask.sum()
    spilled = estimate_pose(obj, depth=seen.depth, intrinsics=seen.intrinsics, mask=mask, table=seen.table)
    _assert_near(obj, spilled.X_CO, seen.X_CO, metres=3e-3, degrees=1.5)


def test_one_point_far_aside_does_not_spoil_the_pose(things, look, standing):
    obj = things["wedge"]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0))
    found = estimate_pose(obj, np.concatenate([seen.points_C, [[5.0, 3.0, 0.7]]]))
    _assert_near(obj, found.X_CO, seen.X_CO, metres=1e-3, degrees=0.5)
    assert found.converged


def test_depth_of_half_precision_is_taken(things, look, standing):
    obj = things["box"]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0))
    found = estimate_pose(obj, depth=seen.depth.astype(np.float16), intrinsics=seen.intrinsics, mask=seen.mask)
    _assert_near(obj, found.X_CO, seen.X_CO, metres=2e-3, degrees=1.0)


def test_points_that_are_not_finite_are_ignored(things, look, standing):
    obj = things["box"]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0))
    dirty = np.concatenate([seen.points_C, [[np.nan, 0, 0], [np.inf, 0, 1], [0, -np.inf, 1]]])
    _assert_near(obj, estimate_pose(obj, dirty).X_CO, seen.X_CO, metres=5e-4, degrees=0.5)


def test_few_points_are_enough(things, look, standing):
    obj = things["box"]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0))
    found = estimate_pose(obj, seen.points_C[:: len(seen.points_C) // 60])
    assert pose_errors(obj, found.X_CO, seen.X_CO).add_s_m < 3e-3


@pytest.mark.parametrize("share", [0.6, 0.75])
@pytest.mark.parametrize("name", ["box", "wedge"])
def test_half_an_object_at_the_images_border_is_recovered(things, look, standing, name, share):
    obj = things[name]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0))
    columns = np.flatnonzero(seen.mask.any(axis=0))
    width = int(columns[0] + share * (columns[-1] - columns[0]))
    k = replace(seen.intrinsics, width=width)
    found = estimate_pose(obj, depth=seen.depth[:, :width], intrinsics=k, mask=seen.mask[:, :width])
    _assert_near(obj, found.X_CO, seen.X_CO, metres=1.5e-3, degrees=0.5)


def test_a_border_of_nothing_around_the_image_changes_nothing(things, look, standing):
    obj = things["wedge"]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0))
    k = seen.intrinsics
    larger = replace(k, cx=k.cx + 64, cy=k.cy + 32, width=k.width + 128, height=k.height + 64)
    depth, mask = (np.pad(a, ((32, 32), (64, 64))) for a in (seen.depth, seen.mask))
    first = estimate_pose(obj, **seen.image)
    second = estimate_pose(obj, depth=depth, intrinsics=larger, mask=mask)
    np.testing.assert_allclose(first.X_CO, second.X_CO, atol=2e-4)


def test_points_with_an_image_are_as_good_as_its_mask(things, look, standing):
    obj = things["wedge"]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0))
    by_mask = estimate_pose(obj, **seen.image)
    by_points = estimate_pose(obj, seen.points_C, depth=seen.depth, intrinsics=seen.intrinsics)
    np.testing.assert_allclose(by_points.X_CO, by_mask.X_CO, atol=1e-9)


def test_one_seed_one_pose(things, look, standing):
    obj = things["corner"]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0))
    first = estimate_pose(obj, seed=4, **seen.image)
    estimate_pose(things["box"], seen.points_C, seed=1)  # what was estimated before does not matter
    second = estimate_pose(obj, seed=4, **seen.image)
    for name in (
        "X_CO", "confidence", "score", "residual_m", "explained", "covariance", "alternatives_X_CO",
        "alternatives_probability",
    ):  # fmt: skip
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert first.seed == 4
    for seed in range(3):
        _assert_near(obj, estimate_pose(obj, seed=seed, **seen.image).X_CO, seen.X_CO, metres=5e-4, degrees=0.5)


def test_the_arguments_are_left_as_they_are(things, look, standing):
    obj = things["box"]
    seen = look(obj.mesh, standing(obj))
    depth, mask, points = seen.depth.copy(), seen.mask.copy(), seen.points_C.copy()
    estimate_pose(obj, table=seen.table, **seen.image)
    estimate_pose(obj, seen.points_C)
    np.testing.assert_array_equal(seen.depth, depth)
    np.testing.assert_array_equal(seen.mask, mask)
    np.testing.assert_array_equal(seen.points_C, points)


# ---- free space and what hides


def test_the_background_decides_between_poses_of_equal_fit(things, look, cube):
    # the square face of 5 cm is seen head on: a side of 6 cm would fit its points, were it not for what is beside it
    X_WO = np.eye(4)
    X_WO[:3, :3] = Rotation.from_euler("y", 90.0, degrees=True).as_matrix()
    X_WO[2, 3] = 0.03
    wall = (box_mesh([0.01, 2.0, 2.0]), _at(-0.3, 0.0, 0.0))
    seen = look(cube.mesh, X_WO, X_WC=FRONT, table=False, others=[wall])
    found = estimate_pose(cube, **seen.image)
    assert pose_errors(cube, found.X_CO, seen.X_CO).mssd_m < 3e-3


_HALF_TURN = pytest.mark.xfail(strict=False, reason="332 pixels: the true pose is better but not among those followed")


@pytest.mark.parametrize("name", ["wedge", pytest.param("corner", marks=_HALF_TURN), "rimmed"])
def test_an_object_behind_a_post_is_recovered(things, look, standing, name):
    obj = things[name]
    aside = np.array([-TOWARDS[1], TOWARDS[0]])
    post = (box_mesh([0.01, 0.02, 0.15]), _at(*(0.12 * TOWARDS + 0.01 * aside), 0.15, FACING))
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0), others=[post])
    share = seen.mask.sum() / look(obj.mesh, standing(obj, yaw_rad=1.0)).mask.sum()
    assert 0.25 < share < 0.8
    found = estimate_pose(obj, **seen.asked("image and table"))
    _assert_near(obj, found.X_CO, seen.X_CO, metres=3e-3, degrees=0.7)


# ---- the table


def _behind_a_wall(things, look, name, height=0.065):
    """The upper part of an upright object."""
    wall = (box_mesh([0.005, 0.15, height]), _at(*(0.10 * TOWARDS), height, FACING))
    X_WO = _at(0.0, 0.0, 0.06 if name in ("box", "bevelled") else 0.0, FACING if name == "box" else 1.0)
    seen = look(things[name].mesh, X_WO, others=[wall])
    share = seen.mask.sum() / look(things[name].mesh, X_WO).mask.sum()
    return seen, share


@pytest.mark.parametrize("name", ["box", "bevelled", "rimmed"])
def test_with_a_table_what_is_hidden_below_stands_on_it(things, look, name):
    seen, share = _behind_a_wall(things, look, name)
    assert 0.2 < share < 0.7
    found = estimate_pose(things[name], **seen.asked("image and table"))
    assert abs(_lowest(things[name], found.X_CO, seen.table)) < 1e-3
    assert pose_errors(things[name], found.X_CO, seen.X_CO).mssd_m < 4e-3


def test_the_table_is_what_makes_it_stand(things, look):
    # the box is 12 cm high or 9 cm or 6 cm: only the table tells how far it goes on behind the wall
    seen, _ = _behind_a_wall(things, look, "box", height=0.075)
    heights = [
        _lowest(things["box"], estimate_pose(things["box"], **seen.asked(how)).X_CO, seen.table)
        for how in ("image", "image and table")
    ]
    assert abs(heights[1]) < 1e-3 and abs(heights[1]) < abs(heights[0])


@pytest.mark.parametrize("offset_m", [-0.5, -0.2, 0.2, 0.5])
@pytest.mark.parametrize("name", ["box", "wedge", "corner", "rimmed"])
def test_a_table_that_is_elsewhere_does_not_ruin_the_pose(things, look, standing, name, offset_m):
    obj = things[name]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0))
    wrong = Plane(seen.table.normal, seen.table.offset_m + offset_m)
    found = estimate_pose(obj, table=wrong, **seen.image)
    _assert_near(obj, found.X_CO, seen.X_CO, metres=1e-3, degrees=0.5)


def test_a_table_is_a_prior_not_a_condition(things, look):
    # held 6 cm above the table, leaning
    X_WO = _at(0.0, 0.0, 0.06, 1.0)
    X_WO[:3, :3] = X_WO[:3, :3] @ Rotation.from_euler("x", 0.5).as_matrix()
    seen = look(things["wedge"].mesh, X_WO)
    found = estimate_pose(things["wedge"], **seen.asked("image and table"))
    _assert_near(things["wedge"], found.X_CO, seen.X_CO, metres=2e-3, degrees=1.0)


# ---- bad input


def test_bad_input_is_named(things, look, standing):
    box = things["box"]
    seen = look(box.mesh, standing(box))
    points, k = seen.points_C, seen.intrinsics
    cases = [
        ({}, "nothing to look at: give `points_C`"),
        ({"mask": seen.mask}, "nothing to look at"),
        ({"points_C": points, "mask": seen.mask}, "nothing to look at"),
        ({"points_C": points, "depth": seen.depth}, "both `depth` and `intrinsics`"),
        ({"points_C": points, "intrinsics": k}, "both `depth` and `intrinsics`"),
        ({"depth": seen.depth, "intrinsics": k}, "Give `mask` or `points_C`"),
        ({"depth": seen.depth, "intrinsics": k, "mask": seen.mask[1:]}, "mask has shape"),
        ({"depth": seen.depth[:, 1:], "intrinsics": k, "mask": seen.mask}, "depth has shape"),
        ({"depth": seen.depth, "intrinsics": k, "mask": 0 * seen.mask}, "mask is empty"),
        ({"depth": np.full_like(seen.depth, np.nan), "intrinsics": k, "mask": seen.mask}, "0 finite points"),
        ({"depth": 1e3 * seen.depth, "intrinsics": k, "mask": seen.mask}, "metres"),
        ({"points_C": 1e3 * points}, "millimetres"),
        ({"points_C": points[:19]}, "19 finite points"),
        ({"points_C": np.zeros((0, 3))}, "0 finite points"),
        ({"points_C": np.full((100, 3), np.nan)}, "0 finite points"),
        ({"points_C": points * [1.0, -1.0, -1.0]}, "z forward"),  # upside down
        ({"points_C": np.tile(points[:1], (100, 1))}, "one spot"),
    ]
    for arguments, message in cases:
        with pytest.raises(InputError, match=message):
            estimate_pose(box, **arguments)
    for bad in (points[:, :2], points.ravel()):
        with pytest.raises(ShapeError, match="points_C has shape"):
            estimate_pose(box, bad)


def test_a_search_that_is_smaller_is_still_right_on_easy_views(things, look, standing):
    obj = things["box"]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0))
    found = estimate_pose(obj, config=PoseConfig(slid=60, coarse_kept=12, middle_kept=6, finalists=2), **seen.image)
    _assert_near(obj, found.X_CO, seen.X_CO, metres=5e-4, degrees=0.5)
