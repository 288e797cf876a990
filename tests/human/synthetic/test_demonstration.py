"""Recorded demonstrations: the truth is what the images show, the motion is possible, files give back all of it."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.errors import DataFormatError, InputError
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.geometry.mesh import box_mesh, signed_distance
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.raster import rasterise
from neuralgrasps.hands.extent import lowest_height
from neuralgrasps.hands.surface import hand_mesh, sample_hand_surface
from neuralgrasps.hands.variants import scaled_hand
from neuralgrasps.human.skeleton import human_hand, joint_points
from neuralgrasps.human.synthetic.demonstration import DemonstrationConfig, NoPersonGraspError, record_demonstration
from neuralgrasps.human.synthetic.files import read_demonstration, read_truth, write_demonstration
from neuralgrasps.human.synthetic.person_grasps import person_grasps
from neuralgrasps.human.synthetic.recording import UNITS_PER_METRE
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.perception.frame_files import read_frames
from neuralgrasps.planning.resting_plane import resting_planes

SMALL = {"width": 320, "height": 240}
EXACT = DemonstrationConfig(side="left", scale=0.8, noise=None, lift=True, wall=True, clutter=2, **SMALL)


@pytest.fixture(scope="module")
def brick(make_object):
    return make_object("brick", box_mesh([0.022, 0.035, 0.05]))


@pytest.fixture(scope="module")
def exact(brick):
    return record_demonstration(brick, seed=1, config=EXACT)


@pytest.fixture(scope="module")
def hand():
    return scaled_hand(human_hand("left"), 0.8)


def test_depth_and_mask_are_those_of_the_hand_and_the_object_where_the_truth_says(exact, brick, hand):
    truth = exact.truth
    assert truth.side == "left" and truth.scale == 0.8
    for t in (0, truth.grasp_frame, len(exact) - 1):
        depth, mask = exact.depth_units[t] / UNITS_PER_METRE, truth.hand_mask[t]
        meshes = [hand_mesh(hand, truth.q[t]), brick.mesh]
        image = rasterise(meshes, np.stack([truth.X_CH[t], truth.X_CO[t]]), exact.intrinsics)
        assert not (mask & (image.mesh_index != 0)).sum() > 0.02 * mask.sum()
        assert np.median(np.abs(depth - image.depth)[mask]) < 3e-4 if mask.any() else t == 0
        on_object = (image.mesh_index == 1) & (np.abs(depth - image.depth) < 1e-3)
        assert on_object.sum() > (0.9 if t == 0 else 0.1) * (image.mesh_index == 1).sum()
        hit = image.mesh_index >= 0
        assert (depth[hit] < image.depth[hit] + 2e-3).mean() > 0.98  # nothing else but the arm is before them


def test_joints_are_those_of_the_posed_hand_and_lie_in_its_mask(exact, hand):
    truth = exact.truth
    np.testing.assert_allclose(truth.joints_C, joint_points(hand, truth.X_CH, truth.q), atol=1e-12)
    k, tip = exact.intrinsics, truth.joints_C[truth.grasp_frame, 9]
    u, v = round(k.fx * tip[0] / tip[2] + k.cx), round(k.fy * tip[1] / tip[2] + k.cy)
    assert truth.hand_mask[truth.grasp_frame, v - 12 : v + 13, u - 12 : u + 13].any()


def test_the_closed_hand_keeps_still_and_then_carries_the_object(exact):
    truth, (first, end) = exact.truth, exact.truth.still
    assert first <= truth.grasp_frame < end and 8 <= end - first <= 15
    assert (truth.X_CH[first:end] == truth.X_CH[first]).all() and (truth.q[first:] == truth.q[first]).all()
    assert (truth.X_CO[:end] == truth.X_CO[0]).all()
    X_OH = np.linalg.inv(truth.X_CO[first:]) @ truth.X_CH[first:]
    assert np.abs(X_OH - truth.X_OH).max() < 1e-12
    risen = exact.X_WC[2, :3] @ (truth.X_CO[-1, :3, 3] - truth.X_CO[0, :3, 3])
    assert 0.07 < risen < 0.2


def test_the_hand_goes_through_neither_the_table_nor_the_object_and_never_jumps(exact, brick, hand):
    truth = exact.truth
    X_WH = exact.X_WC @ truth.X_CH
    assert (lowest_height(hand, X_WH, truth.q, Plane(np.array([0.0, 0.0, 1.0]), 0.0)) > 0.0).all()
    surface = sample_hand_surface(hand, spacing=0.006)
    for t in range(len(exact)):
        X_OL = (np.linalg.inv(truth.X_CO[t]) @ truth.X_CH[t] @ forward_numpy(hand.tree, truth.q[t]))[surface.links]
        points_O = np.einsum("kij,kj->ki", X_OL[:, :3, :3], surface.points_L) + X_OL[:, :3, 3]
        assert signed_distance(brick.mesh, points_O).min() > -1.6e-3
    step = np.linalg.norm(np.diff(X_WH[:, :3, 3], axis=0), axis=1)
    assert step.max() < 0.09 and np.abs(np.diff(step)).max() < 0.035
    assert np.abs(np.diff(truth.q, axis=0)).max() < 0.6
    opening = np.abs(truth.q[0] - truth.q[-1]).max()
    assert opening > 0.15  # it came in open


def test_the_grasp_is_one_that_held(exact, brick):
    truth, up_O = exact.truth, (exact.X_WC @ exact.truth.X_CO[0])[2, :3]
    plane_O = max(resting_planes(brick), key=lambda plane: plane.normal @ up_O)
    grasps = person_grasps(brick, scale=0.8, side="left", plane_O=plane_O).grasps  # kept from the recording
    same = np.abs(grasps.X_OH - truth.X_OH).max(axis=(1, 2)) < 1e-9
    same &= np.abs(grasps.q - truth.q[truth.grasp_frame]).max(axis=1) < 1e-9
    assert same.sum() == 1 and grasps.validated[same].all()
    assert truth.kind == ("precision" if grasps.precision[same][0] else "power")


def test_the_visible_share_says_what_is_hidden_and_outside(exact):
    truth = exact.truth
    assert truth.visible[truth.grasp_frame] >= EXACT.least_share
    assert ((truth.visible == 0) == ~truth.hand_mask.any(axis=(1, 2))).all()
    k, hand = exact.intrinsics, scaled_hand(human_hand("left"), 0.8)
    wide = Intrinsics(k.fx, k.fy, k.cx + k.width, k.cy + k.height, 3 * k.width, 3 * k.height)
    partly = np.flatnonzero((truth.visible > 0.05) & (truth.visible < 0.98))
    assert len(partly) >= 2
    for t in (*partly, truth.grasp_frame):
        alone = rasterise([hand_mesh(hand, truth.q[t])], truth.X_CH[t][None], wide).mesh_index >= 0
        assert truth.visible[t] == pytest.approx(truth.hand_mask[t].sum() / alone.sum(), abs=0.02)


def test_the_camera_stands_before_the_table_and_looks_at_the_object(exact):
    X_WO = exact.X_WC @ exact.truth.X_CO[0]
    assert np.linalg.norm(exact.X_WC[:3, 3] - X_WO[:3, 3]) == pytest.approx(0.75, abs=0.3)
    assert exact.X_WC[2, 3] > 0.15 and abs(X_WO[:2, 3]).max() < 1e-9


def test_the_seed_decides_everything(brick):
    config = DemonstrationConfig(side="left", scale=0.8, lift=False, width=160, height=120)
    one, two, other = (record_demonstration(brick, seed=s, config=config) for s in (5, 5, 6))
    for name in ("depth_units", "colour", "X_WC"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    np.testing.assert_array_equal(one.truth.X_CH, two.truth.X_CH)
    assert one.X_WC.tolist() != other.X_WC.tolist()
    measured = one.depth_units > 0
    assert 0.5 < measured[0].mean() < 1.0  # with the sensor's holes


def test_files_give_back_the_recording_and_its_frames(exact, tmp_path):
    write_demonstration(tmp_path / "one", exact)
    back = read_demonstration(tmp_path / "one")
    for name in ("depth_units", "colour", "X_WC"):
        np.testing.assert_array_equal(getattr(back, name), getattr(exact, name))
    assert back.intrinsics == exact.intrinsics
    for name in ("X_CO", "X_CH", "q", "joints_C", "hand_mask", "visible", "X_OH"):
        np.testing.assert_array_equal(getattr(back.truth, name), getattr(exact.truth, name))
        np.testing.assert_array_equal(getattr(read_truth(tmp_path / "one"), name), getattr(exact.truth, name))
    assert (back.truth.still, back.truth.grasp_frame) == (exact.truth.still, exact.truth.grasp_frame)
    frames = read_frames(tmp_path / "one")
    assert len(frames) == len(exact)
    np.testing.assert_array_equal(frames[3].depth, exact.frame(3).depth)
    np.testing.assert_array_equal(frames[3].colour, exact.colour[3])
    np.testing.assert_allclose(frames[3].X_WC, exact.X_WC, atol=1e-12)


def test_damaged_truth_is_refused(exact, tmp_path):
    write_demonstration(tmp_path / "one", exact)
    (tmp_path / "one" / "truth.safetensors").write_bytes(b"no")
    with pytest.raises(DataFormatError, match=r"truth\.safetensors"):
        read_truth(tmp_path / "one")
    with pytest.raises(DataFormatError, match="no recorded demonstration"):
        read_truth(tmp_path)


def test_an_object_that_no_hand_can_grasp_says_why(make_object):
    block = make_object("block", box_mesh([0.15, 0.15, 0.15]))
    with pytest.raises(NoPersonGraspError, match="too wide"):
        record_demonstration(block, seed=0, config=DemonstrationConfig(side="right", scale=0.8))


def test_settings_that_cannot_be_are_refused():
    for wrong in ({"side": "both"}, {"kind": "firm"}, {"still_frames": (5, 2)}, {"rate_hz": 0.0}):
        with pytest.raises(InputError):
            DemonstrationConfig(**wrong)
