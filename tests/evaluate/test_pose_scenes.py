"""Pose scenes: repeatable, consistent with their truth, and as hidden as they claim."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial.transform import Rotation

from neuralgrasps.errors import InputError, UnknownNameError
from neuralgrasps.evaluate.pose_occluders import Placed, body_of, hide, own_depth
from neuralgrasps.evaluate.pose_room import CAMERA
from neuralgrasps.evaluate.pose_scenes import (
    CONDITIONS,
    PATCHES,
    UNKNOWN_KINDS,
    VISIBLE,
    background_scene,
    held_scene,
    pose_scene,
)
from neuralgrasps.evaluate.pose_views import SPILL_M
from neuralgrasps.evaluate.unknown_shapes import SHAPES, unknown_shape
from neuralgrasps.geometry.camera import back_project, look_at, pixel_rays
from neuralgrasps.geometry.mesh import merge_meshes
from neuralgrasps.geometry.primitives import box_mesh, cylinder_mesh, sphere_mesh
from neuralgrasps.geometry.raster import depth_images
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.geometry.se3_numpy import make_transform_np, transform_points_np

ARRAYS = ("depth", "mask", "true_mask", "X_WC", "X_CO_true")


@pytest.fixture(scope="module")
def objects(make_object):
    corner = merge_meshes([box_mesh([0.05, 0.02, 0.02]), box_mesh([0.02, 0.02, 0.06])])
    return {
        "corner": make_object("corner", corner),
        "can": make_object("can", cylinder_mesh(0.035, 0.05)),
        "ball": make_object("ball", sphere_mesh(0.04)),
    }


def _from_surface(scene, obj, mask) -> np.ndarray:
    """Signed distances of a scene's measured points to the object in its true pose."""
    points_C = back_project(scene.depth, scene.intrinsics, mask=mask)
    return query_grid_numpy(obj.sdf, transform_points_np(np.linalg.inv(scene.X_CO_true), points_C))


@pytest.mark.parametrize("condition", CONDITIONS)
def test_one_seed_one_scene(objects, condition):
    others = list(objects.values())
    first, same, other = (pose_scene(objects["corner"], condition, seed=s, distractors=others) for s in (3, 3, 4))
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(first, name), getattr(same, name))
    assert first.visible_share == same.visible_share
    assert (first.X_CO_true != other.X_CO_true).any() and (first.depth != other.depth).any()


@pytest.mark.parametrize("name", ["corner", "can"])
def test_measured_points_lie_on_the_object_and_the_object_on_the_table(objects, name):
    obj = objects[name]
    for seed in range(4):
        scene = pose_scene(obj, "easy", seed=seed)
        inside = ndimage.binary_erosion(scene.true_mask, iterations=3)
        distance = _from_surface(scene, obj, inside)
        assert abs(np.median(distance)) < 5e-4
        assert np.percentile(np.abs(distance), 90) < 0.006
        lowest = scene.table.height(transform_points_np(scene.X_CO_true, obj.mesh.vertices)).min()
        assert lowest == pytest.approx(0.0, abs=1e-6)
        height = scene.table.height(pixel_rays(CAMERA) * scene.depth[..., None].astype(float))
        assert (np.abs(height[scene.depth > 0]) < 0.01).mean() > 0.2  # the table is in view
        assert np.percentile(scene.depth[scene.depth > 0], 99) < 5.0  # and what is behind it is measured
        np.testing.assert_array_equal(scene.frame.depth, scene.depth)


def test_views_are_where_they_should_be(objects):
    scenes = [pose_scene(objects["can"], "easy", seed=seed) for seed in range(12)]
    eyes = np.array([s.X_WC[:3, 3] - (s.X_WC @ s.X_CO_true)[:3, 3] for s in scenes])
    distance = np.linalg.norm(eyes, axis=1)
    elevation = np.rad2deg(np.arcsin(eyes[:, 2] / distance))
    assert distance.min() > 0.5 - 1e-9 and distance.max() < 1.2 + 1e-9 and np.ptp(distance) > 0.3
    assert elevation.min() > 25 - 1e-6 and elevation.max() < 65 + 1e-6 and np.ptp(elevation) > 15
    centres = np.array([s.X_CO_true[:2, 3] / s.X_CO_true[2, 3] for s in scenes])
    assert 0.01 < np.abs(centres).max() < 0.2  # near the middle of the image, not in it


def test_easy_scenes_have_the_exact_mask(objects):
    scene = pose_scene(objects["corner"], "easy", seed=1)
    np.testing.assert_array_equal(scene.mask, scene.true_mask & (scene.depth > 0))
    alone = np.isfinite(depth_images(objects["corner"].mesh, scene.X_CO_true[None], CAMERA)[0])
    np.testing.assert_array_equal(scene.true_mask, alone)
    assert scene.visible_share > 0.9


def test_occluded_scenes_are_hidden_as_much_as_they_say_and_evenly(objects):
    obj, shares = objects["corner"], []
    for seed in range(16):
        scene = pose_scene(obj, "occluded", seed=seed, distractors=list(objects.values()) if seed % 2 else ())
        alone = np.isfinite(depth_images(obj.mesh, scene.X_CO_true[None], CAMERA)[0])
        assert not (scene.true_mask & ~alone).any()
        assert scene.visible_share <= scene.true_mask.sum() / alone.sum() < VISIBLE[1] + 0.05
        hidden = alone & ~scene.true_mask
        seen = hidden & (scene.depth > 0)
        in_front = scene.depth < depth_images(obj.mesh, scene.X_CO_true[None], CAMERA)[0]
        assert in_front[seen].mean() > 0.9
        assert scene.mask.sum() >= 100 and (scene.depth[scene.mask] > 0).all()
        shares.append(scene.visible_share)
    assert VISIBLE[0] <= min(shares) < 0.4 and 0.65 < max(shares) <= VISIBLE[1]
    assert np.std(shares) == pytest.approx((VISIBLE[1] - VISIBLE[0]) / 12**0.5, rel=0.4)


def test_things_in_front_stand_clear_of_each_other_and_leave_the_asked_share(objects):
    X_WB = make_transform_np(None, [0.0, 0.0, 0.05])
    target = Placed(body=body_of(objects["can"]), X_WB=X_WB)
    X_WC = look_at(np.array([0.6, 0.1, 0.5]), np.array([0.0, 0.0, 0.05]))
    for share in (0.3, 0.7):
        for seed, distractors in ((0, ()), (1, [objects["ball"], objects["corner"]])):
            rng = np.random.default_rng(seed)
            things = hide(target, share=share, X_WC=X_WC, intrinsics=CAMERA, rng=rng, distractors=distractors)
            assert things is not None and 1 <= len(things) <= 3
            own = own_depth(target, X_WC, CAMERA)
            nearest = np.min([own_depth(t, X_WC, CAMERA) for t in things], axis=0)
            assert (own <= nearest)[np.isfinite(own)].mean() == pytest.approx(share, abs=0.02)
            everything = (target, *things)
            for i, a in enumerate(everything):
                assert a.lowest_m > -0.004
                for b in everything[:i]:
                    points_B = transform_points_np(np.linalg.inv(b.X_WB) @ a.X_WB, a.body.points)
                    assert b.body.distance(points_B).min() > 0.0
            if distractors:
                assert {id(t.body.mesh) for t in things} <= {id(d.mesh) for d in distractors}


def test_hard_scenes_are_the_occluded_ones_with_a_worse_sensor_and_mask(objects):
    obj = objects["corner"]
    scales, spreads = [], []
    for seed in range(6):
        occluded, hard = (pose_scene(obj, c, seed=seed) for c in ("occluded", "hard"))
        np.testing.assert_array_equal(occluded.true_mask, hard.true_mask)
        np.testing.assert_array_equal(occluded.X_CO_true, hard.X_CO_true)
        assert (hard.mask & ~hard.true_mask).any()
        assert hard.mask[hard.true_mask & (hard.depth > 0)].all()
        spill = ndimage.distance_transform_edt(~hard.true_mask)[hard.mask].max()
        pixel_m = hard.X_CO_true[2, 3] / CAMERA.fx
        assert SPILL_M - 1.5 * pixel_m < spill * pixel_m < SPILL_M + 0.5 * pixel_m
        both = (hard.depth > 0) & (occluded.depth > 0)
        scales.append(np.median(hard.depth[both] / occluded.depth[both]))
        inside = ndimage.binary_erosion(hard.true_mask, iterations=2)
        spreads.append([np.std(_from_surface(s, obj, inside)) for s in (occluded, hard)])
    assert np.mean(scales) == pytest.approx(1.003, abs=0.002)
    assert np.mean(spreads, axis=0)[1] > 1.3 * np.mean(spreads, axis=0)[0]


def test_an_unknown_condition_and_kind_are_named(objects):
    with pytest.raises(UnknownNameError, match="condition 'harder'"):
        pose_scene(objects["can"], "harder", seed=0)
    with pytest.raises(UnknownNameError, match="kind 'teapot'"):
        background_scene(0, kind="teapot")


def test_an_object_too_small_to_be_seen_gives_a_clear_message(make_object):
    with pytest.raises(InputError, match="gave no easy scene"):
        pose_scene(make_object("grain", box_mesh([0.002, 0.002, 0.002]), cells=8), "easy", seed=0)


@pytest.mark.parametrize("kind", UNKNOWN_KINDS)
def test_unknown_things_are_on_the_table_and_have_no_pose(objects, kind):
    scene = background_scene(5, kind=kind, distractors=list(objects.values()))
    assert scene.object == "" and np.isnan(scene.X_CO_true).all()
    assert scene.mask.sum() >= 100 and (scene.depth[scene.mask] > 0).all()
    np.testing.assert_array_equal(scene.depth, background_scene(5, kind=kind, distractors=list(objects.values())).depth)
    height = scene.table.height(back_project(scene.depth, CAMERA, mask=scene.mask))
    if kind in PATCHES:
        assert np.percentile(height, 10) < -0.05  # reaches below the table's top
    else:
        assert np.percentile(height, 5) > -0.01 and np.percentile(height, 95) > 0.005


def test_half_of_the_unknown_things_are_occluded_and_all_kinds_come_up():
    scenes = [background_scene(seed) for seed in range(40)]
    assert 0.25 < np.mean([s.condition == "occluded" for s in scenes]) < 0.65
    for scene in scenes:
        assert VISIBLE[0] <= scene.visible_share <= (VISIBLE[1] if scene.condition == "occluded" else 1.0)


def test_unknown_things_are_no_boxes_or_cans_of_household_size():
    for seed in range(20):
        sides = unknown_shape("book", np.random.default_rng(seed)).extents
        assert sides.max() > 0.25 or sides.max() < 0.03
    for kind in SHAPES:
        mesh = unknown_shape(kind, np.random.default_rng(1))
        other = unknown_shape(kind, np.random.default_rng(2))
        assert 0.01 < mesh.extents.max() < 0.6
        assert mesh.content_hash() != other.content_hash()


@pytest.fixture(scope="module")
def held(small_world):
    """A ball in a gripper, with four contacts per grasp: hand, object, grasps."""
    grasps = next(g for g in small_world.grasp_sets if (g.hand, g.object) == ("fetch", "ball"))
    obj = small_world.objects["ball"]
    chosen = np.arange(4 * len(grasps)).reshape(len(grasps), 4)
    links = np.zeros((len(grasps), 5), np.int32)
    links[:, 4] = -1
    points, normals = (np.full((len(grasps), 5, 3), np.nan) for _ in range(2))
    points[:, :4], normals[:, :4] = obj.points_O[chosen], obj.normals_O[chosen]
    grasps = replace(grasps, contact_points_O=points, contact_normals_O=normals, contact_links=links)
    return small_world.hands["fetch"], obj, grasps


def test_a_held_object_is_partly_hidden_by_the_hand_it_is_in(held):
    hand, obj, grasps = held
    scene, same = (held_scene(obj, hand, grasps, 2, seed=7) for _ in range(2))
    for name in (*ARRAYS, "X_CH", "contact_points_C"):
        np.testing.assert_array_equal(getattr(scene, name), getattr(same, name))
    np.testing.assert_allclose(np.linalg.inv(scene.X_CO_true) @ scene.X_CH_true, grasps.X_OH[2], atol=1e-9)
    np.testing.assert_array_equal(scene.q, grasps.q[2])
    inside = ndimage.binary_erosion(scene.true_mask, iterations=2)
    assert abs(np.median(_from_surface(scene, obj, inside))) < 0.012  # the smooth error of the sensor
    alone = np.isfinite(depth_images(obj.mesh, scene.X_CO_true[None], CAMERA)[0])
    assert scene.true_mask.sum() < alone.sum()
    assert (scene.mask & ~scene.true_mask).any()
    assert scene.frame.X_WC is not None


def test_held_views_are_hidden_within_bounds_where_that_can_be(held):
    hand, obj, grasps = held
    shares = [held_scene(obj, hand, grasps, i, seed=i).visible_share for i in range(8)]
    assert all(0.1 < share <= 0.87 for share in shares)


def test_what_the_robot_believes_is_off_by_the_stated_calibration(held):
    hand, obj, grasps = held
    small = replace(CAMERA, fx=CAMERA.fx / 4, fy=CAMERA.fy / 4, cx=79.5, cy=59.5, width=160, height=120)
    shift, turn, extra = [], [], []
    for seed in range(40):
        scene = held_scene(obj, hand, grasps, 1, seed=seed, intrinsics=small)
        off = np.linalg.inv(scene.X_CH_true) @ scene.X_CH
        shift.append(np.linalg.norm(off[:3, 3]))
        turn.append(np.rad2deg(Rotation.from_matrix(off[:3, :3]).magnitude()))
        X_CO_believed = scene.X_CH @ np.linalg.inv(grasps.X_OH[1])
        expected = transform_points_np(X_CO_believed, grasps.contact_points_O[1, :4])
        assert scene.contact_points_C.shape == (4, 3)
        extra.append(np.linalg.norm(scene.contact_points_C - expected, axis=1))
        normals = grasps.contact_normals_O[1, :4] @ X_CO_believed[:3, :3].T
        np.testing.assert_allclose(scene.contact_normals_C, normals, atol=1e-9)
    for measured, stated in ((shift, 0.002), (turn, 1.0), (extra, 0.001)):
        assert np.sqrt(np.mean(np.square(measured))) == pytest.approx(stated, rel=0.25)


def test_grasps_of_another_object_or_a_missing_index_are_refused(held, objects):
    hand, obj, grasps = held
    with pytest.raises(InputError, match="expected the same names"):
        held_scene(objects["can"], hand, grasps, 0, seed=0)
    with pytest.raises(InputError, match="an index in the set"):
        held_scene(obj, hand, grasps, len(grasps), seed=0)
