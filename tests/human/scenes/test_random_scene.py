"""Random scenes with a hand: what is in them, where, and that they repeat."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.geometry.mesh import is_closed, sphere_mesh
from neuralgrasps.hands.signed_distance import hand_signed_distance
from neuralgrasps.hands.variants import scaled_hand
from neuralgrasps.human.scenes.grasp_bank import load_bank, random_solid, save_bank, thinned
from neuralgrasps.human.scenes.random_scene import SceneMix, draw_scene, random_scene
from neuralgrasps.human.scenes.surroundings import BACKGROUND, CLUTTER, FOREARM, HAND, OBJECT, TABLE
from neuralgrasps.human.skeleton import human_hand, joint_points
from tests.human.human_scenes import small_bank, small_kit

PLAIN = SceneMix(varied=0.0)


def test_a_seed_gives_one_scene():
    first, again, other = (random_scene(small_kit(), seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first.points_C, again.points_C)
    np.testing.assert_array_equal(first.face_labels, again.face_labels)
    assert first.points_C.shape != other.points_C.shape or not np.allclose(first.points_C, other.points_C)


@pytest.mark.parametrize("seed", range(4))
def test_joints_and_skin_are_the_hand_models(seed):
    scene = random_scene(small_kit(), seed, PLAIN)
    hand = scaled_hand(human_hand(), scene.scale)
    np.testing.assert_allclose(scene.joints_C, joint_points(hand, scene.X_CH, scene.q), atol=1e-9)
    corners = np.unique(scene.faces[scene.face_labels == HAND])
    points_H = (scene.points_C[corners] - scene.X_CH[:3, 3]) @ scene.X_CH[:3, :3]
    posed = torch.eye(4, dtype=torch.float64)[None], torch.from_numpy(scene.q)[None]
    distance = hand_signed_distance(hand, *posed, torch.from_numpy(points_H)).numpy()[0]
    assert distance.max() < 1e-3  # eight corners round a finger lie 4 % outside of it
    assert np.median(distance) > -0.03


def test_builds_vary_about_the_model():
    ratios = []
    for seed in range(40):
        scene = random_scene(small_kit(), seed, SceneMix(varied=1.0))
        model = joint_points(scaled_hand(human_hand(), scene.scale), scene.X_CH, scene.q)
        bone = np.linalg.norm(scene.joints_C[10] - scene.joints_C[9])
        ratios.append(bone / np.linalg.norm(model[10] - model[9]))
    assert 0.02 < np.std(ratios) < 0.06 and abs(np.mean(ratios) - 1.0) < 0.03


def test_held_solids_touch_the_hand_and_do_not_fill_it():
    gaps = []
    for seed in range(40):
        scene = random_scene(small_kit(), seed, PLAIN._replace(held=1.0, near=0.0))
        assert scene.holds
        corners = np.unique(scene.faces[scene.face_labels == HAND])
        faces = scene.faces[scene.face_labels == OBJECT]
        middles = scene.points_C[faces].mean(axis=1)
        gaps.append(np.linalg.norm(scene.points_C[corners][:, None] - middles, axis=-1).min())
    assert np.median(gaps) < 0.02


def test_shares_are_as_asked():
    mix = SceneMix(held=0.5, near=0.2, table=0.3)
    scenes = [random_scene(small_kit(), seed, mix) for seed in range(400)]
    labels = [set(np.unique(scene.face_labels)) for scene in scenes]
    assert 0.42 < np.mean([scene.holds for scene in scenes]) < 0.58
    assert 0.62 < np.mean([OBJECT in found for found in labels]) < 0.78
    assert 0.22 < np.mean([TABLE in found for found in labels]) < 0.38
    assert all(HAND in found and FOREARM in found for found in labels)
    assert any(CLUTTER in found for found in labels)
    assert 0.66 <= min(s.scale for s in scenes) < 0.7 and 0.88 < max(s.scale for s in scenes) <= 0.92


def test_the_hand_is_drawn_where_its_joints_are():
    camera = Intrinsics(145.0, 145.0, 79.5, 59.5, 160, 120)
    mix = SceneMix(span_x=0.2, span_y=0.15, clutter=0, near=0.0, held=0.0)
    for seed in (1, 2, 4, 5, 7, 8):  # hands that are seen
        scene = random_scene(small_kit(), seed, mix)
        depth, labels = draw_scene(scene, camera)
        row, column = np.nonzero(labels == HAND)
        assert len(row) > 30
        z = depth[row, column]
        seen = np.stack([(column - camera.cx) / camera.fx * z, (row - camera.cy) / camera.fy * z, z], axis=1)
        nearest = np.linalg.norm(seen[:, None] - scene.joints_C, axis=-1).min(axis=1)
        assert nearest.max() < 0.06 and (depth[labels != BACKGROUND] > 0).all()


def test_banks_are_kept(tmp_path):
    bank = small_bank()
    save_bank(bank, tmp_path / "bank.safetensors")
    again = load_bank(tmp_path / "bank.safetensors")
    np.testing.assert_array_equal(again.X_OH, bank.X_OH)
    assert len(again) == len(bank) > 20 and again.num_solids == 2
    with pytest.raises(InputError, match="cannot be read"):
        load_bank(tmp_path / "none.safetensors")


def test_solids_are_closed_and_thinning_keeps_their_shape():
    for seed in range(30):
        solid = random_solid(np.random.default_rng(seed))
        assert is_closed(solid) and 0.02 < solid.extents.max() < 0.45
    ball = sphere_mesh(0.05, segments=64)
    thin = thinned(ball)
    assert len(thin.faces) < 0.5 * len(ball.faces)
    assert np.abs(np.linalg.norm(thin.vertices, axis=1) - 0.05).max() < 2e-3
