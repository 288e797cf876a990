"""Confidence, alternatives and covariance of a pose: honest where the view cannot decide, or shows something else."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neuralgrasps.evaluate.pose import pose_errors
from neuralgrasps.geometry.camera import look_at
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.perception.pose import PoseConfig, estimate_pose, observe
from neuralgrasps.perception.pose_confidence import physical_share, pose_covariance
from neuralgrasps.perception.pose_model import pose_model
from neuralgrasps.perception.track import track_pose
from neuralgrasps.sim.camera import DepthNoise

FRONT = look_at(np.array([0.6, 0.0, 0.03]), np.array([0.0, 0.0, 0.03]))
FACING = 0.345  # yaw at which the camera of `look` sees an upright box's face head on


def _scene(obj, *, points_C=None, depth=None, intrinsics=None, mask=None, table=None):
    """The observation that `estimate_pose` makes of the same arguments."""
    reach_m = pose_model(obj).diameter
    return observe(points_C, depth=depth, intrinsics=intrinsics, mask=mask, table=table, reach_m=reach_m, seed=0)


def _fit_covariance(obj, X_CO, **seen):
    """(6, 6) of the fit alone: without what a sensor may be off everywhere."""
    return pose_covariance(pose_model(obj), _scene(obj, **seen), X_CO, PoseConfig())[0]


def _at(x, y, z, yaw_rad=0.0):
    X = np.eye(4)
    X[:3, :3] = Rotation.from_euler("z", yaw_rad).as_matrix()
    X[:3, 3] = [x, y, z]
    return X


@pytest.fixture(scope="module")
def cube(make_object):
    """Nearly a cube: two sides of 5 cm, one of 6 cm."""
    return make_object("cube", box_mesh([0.025, 0.025, 0.030]), symmetry=True)


@pytest.fixture(scope="module")
def bar(make_object):
    """20 cm long, 4 cm thick."""
    return make_object("bar", box_mesh([0.10, 0.02, 0.02]), symmetry=True)


@pytest.mark.parametrize("how", ["points", "image and table"])
@pytest.mark.parametrize(
    ("asked", "shown"), [("ball", "box"), ("ball", "corner"), ("can", "wedge"), ("can", "ball"),
                         ("rimmed", "corner"), ("box", "ball"), ("wedge", "ball"), ("corner", "ball")],
)  # fmt: skip
def test_another_object_gives_low_confidence(things, look, standing, asked, shown, how):
    seen = look(things[shown].mesh, standing(things[shown], yaw_rad=1.0))
    found = estimate_pose(things[asked], **seen.asked(how))
    assert found.confidence < 0.5 and not found.converged
    assert found.score < 0.85
    own = estimate_pose(things[shown], **seen.asked(how))
    assert own.score > found.score + 0.1 and own.explained > found.explained and own.converged


@pytest.mark.parametrize(
    ("asked", "shown", "how"),
    [("can", "box", "image and table"), ("corner", "box", "image and table"), ("corner", "wedge", "image and table"),
     ("wedge", "corner", "points"), ("box", "can", "points"), ("box", "corner", "points"),
     ("wedge", "box", "points"), ("box", "wedge", "points")],
)  # fmt: skip
def test_another_object_of_the_same_size_gives_low_confidence(things, look, standing, asked, shown, how):
    seen = look(things[shown].mesh, standing(things[shown], yaw_rad=1.0))
    assert estimate_pose(things[asked], **seen.asked(how)).confidence < 0.5


def _piece_of_table(look, rows, columns):
    seen = look(box_mesh([0.001] * 3), _at(0.0, 0.0, -0.1))
    mask = np.zeros(seen.mask.shape, bool)
    mask[rows, columns] = True
    return {"depth": seen.depth, "intrinsics": seen.intrinsics, "mask": mask}, seen.table


@pytest.mark.parametrize("name", ["ball", "can", "wedge", "corner", "rimmed"])
def test_a_piece_of_table_is_no_object(things, look, name):
    patch, seen_table = _piece_of_table(look, slice(70, 110), slice(80, 130))
    for table in (None, seen_table):
        found = estimate_pose(things[name], table=table, **patch)
        assert found.confidence < 0.5 and not found.converged
        assert np.isfinite(found.X_CO).all()


@pytest.mark.parametrize("name", ["can", "wedge", "box", "bevelled"])
def test_a_piece_of_table_is_no_object_that_is_sunk_into_it(things, look, name):
    for rows, columns in ((slice(70, 110), slice(80, 130)), (slice(80, 100), slice(90, 120))):
        patch, table = _piece_of_table(look, rows, columns)
        assert estimate_pose(things[name], table=table, **patch).confidence < 0.5


def test_noise_is_no_object(things):
    cloud = np.random.default_rng(0).uniform(-0.06, 0.06, (800, 3)) + np.array([0.0, 0.0, 0.7])
    for obj in things.values():
        found = estimate_pose(obj, cloud)
        assert found.confidence < 0.3 and found.score < 0.5


def _assert_consistent(found):
    np.testing.assert_array_equal(found.alternatives_X_CO[0], found.X_CO)
    assert found.alternatives_X_CO.shape == (len(found.alternatives_probability), 4, 4)
    assert found.alternatives_probability.sum() == pytest.approx(1.0)
    assert (found.alternatives_probability > 0.0).all()
    np.testing.assert_allclose(found.covariance, found.covariance.T, atol=1e-15)
    assert np.linalg.eigvalsh(found.covariance).min() > 0.0
    assert found.converged == (found.confidence >= 0.5)
    R = found.alternatives_X_CO[:, :3, :3]
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (len(R), 1, 1)), atol=1e-9)


def test_a_result_is_consistent(things, look, standing):
    for name, shown in (("box", "box"), ("wedge", "ball"), ("can", "can"), ("bevelled", "box"), ("rimmed", "can")):
        seen = look(things[shown].mesh, standing(things[shown], yaw_rad=1.0))
        for how in ("points", "image and table"):
            found = estimate_pose(things[name], **seen.asked(how))
            _assert_consistent(found)
            # alternatives differ by more than the object's symmetry
            for k, X in enumerate(found.alternatives_X_CO):
                for other in found.alternatives_X_CO[:k]:
                    assert pose_errors(things[name], X, other).mssd_m > 5e-3


@pytest.mark.parametrize("name", ["can", "box", "ball"])
def test_what_symmetry_makes_equal_is_one_pose(things, look, standing, name):
    seen = look(things[name].mesh, standing(things[name], yaw_rad=1.0))
    assert len(estimate_pose(things[name], **seen.image).alternatives_X_CO) == 1


def _through_a_slit(cube, look, degrees):
    """One side of the cube, 5 cm wide; whether it is 5 or 6 cm high two screens hide."""
    X_WO = _at(0.0, 0.0, 0.03)
    X_WO[:3, :3] = Rotation.from_euler("y", degrees, degrees=True).as_matrix()
    screens = [(box_mesh([0.002, 0.3, 0.1]), _at(0.08, 0.0, 0.03 + s * 0.115)) for s in (-1, 1)]
    wall = (box_mesh([0.01, 2.0, 2.0]), _at(-0.3, 0.0, 0.0))
    seen = look(cube.mesh, X_WO, X_WC=FRONT, table=False, others=[wall, *screens])
    assert 300 < seen.mask.sum() < 500
    return seen, estimate_pose(cube, **seen.image)


def test_where_the_view_cannot_decide_the_truth_is_among_the_alternatives(look, cube):
    for degrees in (0.0, 90.0):
        seen, found = _through_a_slit(cube, look, degrees)
        _assert_consistent(found)
        assert len(found.alternatives_X_CO) > 1
        errors = [pose_errors(cube, X, seen.X_CO) for X in found.alternatives_X_CO]
        assert min(e.rotation_rad for e in errors) < np.deg2rad(5.0) < max(e.rotation_rad for e in errors)


def test_where_the_view_cannot_decide_confidence_is_low(look, cube):
    for degrees in (0.0, 90.0):
        assert _through_a_slit(cube, look, degrees)[1].confidence < 0.7


def test_a_hidden_bevel_leaves_several_poses(things, look):
    # of a box with one cut edge the opposite edge is seen, close by: the cut may be any of the three that are not
    obj = things["bevelled"]
    seen = look(obj.mesh, _at(0.0, 0.0, 0.06, FACING + np.pi), table=False)
    found = estimate_pose(obj, **seen.image)
    _assert_consistent(found)
    assert len(found.alternatives_X_CO) > 1
    best = min(pose_errors(obj, X, seen.X_CO).mssd_m for X in found.alternatives_X_CO)
    assert best < 4e-3


def test_the_covariance_is_long_where_the_view_leaves_the_object_free(look, bar):
    seen = look(bar.mesh, _at(0.0, 0.0, 0.02, 1.0))
    along = (seen.points_C - seen.X_CO[:3, 3]) @ seen.X_CO[:3, 0]
    strip, whole = (estimate_pose(bar, p) for p in (seen.points_C[np.abs(along) < 0.03], seen.points_C))
    for found in (strip, whole):
        _assert_consistent(found)
    fits = [
        (f.X_CO[:3, :3], _fit_covariance(bar, f.X_CO, points_C=p))
        for f, p in ((strip, seen.points_C[np.abs(along) < 0.03]), (whole, seen.points_C))
    ]
    of_strip, of_whole = (np.sqrt(np.diag(R.T @ covariance[:3, :3] @ R)) for R, covariance in fits)
    assert of_strip[0] > 4.0 * of_strip[1:].max()
    assert of_strip[0] > 3.0 * of_whole[0]
    # a turn about its long axis is known the less the thinner the bar
    R, covariance = fits[1]
    turns = np.sqrt(np.diag(R.T @ covariance[3:, 3:] @ R))
    assert turns[0] > 2.0 * turns[1:].max()


@pytest.mark.xfail(
    strict=True, reason="the hint of unmeasured space outweighs exact points: it tilts the bar to make it look shorter"
)
def test_the_middle_of_a_bar_fixes_all_but_its_place_along(look, bar):
    seen = look(bar.mesh, _at(0.0, 0.0, 0.02, 1.0))
    along = (seen.points_C - seen.X_CO[:3, 3]) @ seen.X_CO[:3, 0]
    found = estimate_pose(bar, seen.points_C[np.abs(along) < 0.03])
    errors = pose_errors(bar, found.X_CO, seen.X_CO)
    assert np.rad2deg(errors.rotation_rad) < 1.0 and found.residual_m < 2e-4


def test_the_covariance_grows_with_the_noise(things, look, standing):
    obj = things["wedge"]
    views = [
        look(obj.mesh, standing(obj, yaw_rad=1.0), noise=noise).image for noise in (None, DepthNoise(axial_m=0.03))
    ]
    clean, noisy = (_fit_covariance(obj, estimate_pose(obj, **view).X_CO, **view) for view in views)
    assert np.trace(noisy[:3, :3]) > 3.0 * np.trace(clean[:3, :3])


@pytest.mark.parametrize("how", ["points", "image and table"])
def test_the_covariance_holds_what_a_sensor_is_off_everywhere(things, look, standing, how):
    obj = things["wedge"]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0))
    found = estimate_pose(obj, **seen.asked(how))
    shared = found.covariance - _fit_covariance(obj, found.X_CO, **seen.asked(how))
    model = pose_model(obj)
    middle = found.X_CO[:3, :3] @ model.centre + found.X_CO[:3, 3]
    away = np.linalg.norm(middle)
    ray = middle / away
    # 2 mm across the ray, along it 0.3 % of the distance more; 2 mm at the object's rim
    expected = np.zeros((6, 6))
    expected[:3, :3] = 0.002**2 * np.eye(3) + (0.003 * away) ** 2 * np.outer(ray, ray)
    expected[3:, 3:] = (0.002 / model.radius) ** 2 * np.eye(3)
    np.testing.assert_allclose(shared, expected, atol=1e-12)
    assert np.linalg.eigvalsh(found.covariance[:3, :3]).min() >= 0.002**2


def test_a_pose_inside_the_table_is_none_to_be_sure_of(things, look, standing):
    # the view shows the object 4 cm lower than the table allows, and nothing of a table
    obj = things["wedge"]
    X_WO = standing(obj, yaw_rad=1.0)
    X_WO[2, 3] -= 0.04
    seen = look(obj.mesh, X_WO, table=False)
    free, sunk = (
        track_pose(obj, seen.depth, seen.intrinsics, seen.X_CO, mask=seen.mask, table=table)
        for table in (None, seen.table)
    )
    for found in (free, sunk):
        assert pose_errors(obj, found.X_CO, seen.X_CO).mssd_m < 3e-3
    assert free.confidence > 0.5 and sunk.confidence < 0.1


def test_physics_leaves_nothing_of_a_pose_inside_the_table(things, look, standing):
    obj = things["wedge"]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0))
    model, scene = pose_model(obj), _scene(obj, **seen.asked("image and table"))
    shares = []
    for sunk_m in (0.0, 0.04):
        X_CO = seen.X_CO.copy()
        X_CO[:3, 3] -= sunk_m * seen.table.normal
        shares.append(physical_share(model, scene, X_CO, 1e-6 * np.eye(6)))
    assert shares[0] > 0.99 and shares[1] < 0.1


def test_a_flat_cloud_leaves_an_object_free_along_it(things, cube):
    u, v = np.meshgrid(np.linspace(-0.02, 0.02, 30), np.linspace(-0.02, 0.02, 30))
    flat = np.column_stack([u.ravel(), v.ravel(), np.full(u.size, 0.6)])
    for obj in (*things.values(), cube):
        found = estimate_pose(obj, flat)
        _assert_consistent(found)
        if obj.name != "ball":  # all others have a face as large
            assert found.explained > 0.9
            x, y, z = np.sqrt(np.diag(_fit_covariance(obj, found.X_CO, points_C=flat))[:3])
            assert min(x, y) > 2.0 * z
    assert estimate_pose(things["ball"], flat).confidence < 0.5
