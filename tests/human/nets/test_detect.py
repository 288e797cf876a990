"""Views of frames, one box per hand, and the shipped hand detector on drawn and real frames."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from neuralgrasps.errors import DataFormatError, InputError
from neuralgrasps.geometry.camera import Intrinsics, project
from neuralgrasps.hands.surface import hand_mesh
from neuralgrasps.hands.variants import scaled_hand
from neuralgrasps.human.nets.detect import HandDetector, one_per_hand
from neuralgrasps.human.nets.detector_loss import box_overlap
from neuralgrasps.human.nets.detector_net import DetectorNet
from neuralgrasps.human.nets.detector_view import FOCAL_PX, PATCH, detector_view
from neuralgrasps.human.nets.net_files import save_weights
from neuralgrasps.human.skeleton import human_hand
from neuralgrasps.perception.camera_file import CameraNumbers
from neuralgrasps.perception.frame import Frame
from neuralgrasps.perception.frame_files import read_frames
from tests.human.conftest import CAMERA, SCALE, STILL_FROM


def _camera(width: int, height: int, focal: float) -> Intrinsics:
    return Intrinsics(focal, focal, 0.5 * (width - 1), 0.5 * (height - 1), width, height)


@pytest.mark.parametrize(("width", "height", "focal"), [(640, 480, 580.0), (320, 240, 300.0), (100, 80, 90.0)])
def test_views_have_one_focal_length(width: int, height: int, focal: float) -> None:
    """A square of 0.1 m at 0.8 m covers as many pixels in every camera's view, and its box comes back."""
    camera = _camera(width, height, focal)
    depth = np.full((height, width), 1.2)
    half = 0.05 / 0.8 * focal
    u, v = np.arange(width) - camera.cx, np.arange(height) - camera.cy
    inside = (np.abs(v) <= half)[:, None] & (np.abs(u) <= half)
    depth[inside] = 0.8
    view = detector_view(depth, camera)
    assert view.depth.shape[0] % PATCH == view.depth.shape[1] % PATCH == 0
    rows, columns = np.nonzero(np.isclose(view.depth, 0.8))
    wanted = 0.1 / 0.8 * FOCAL_PX
    assert np.ptp(columns) + 1 == pytest.approx(wanted, abs=1.6) and np.ptp(rows) + 1 == pytest.approx(wanted, abs=1.6)
    edges = [columns.min() - 0.5, rows.min() - 0.5, columns.max() + 0.5, rows.max() + 0.5]
    own_v, own_u = np.nonzero(inside)
    truth = [own_u.min() - 0.5, own_v.min() - 0.5, own_u.max() + 0.5, own_v.max() + 0.5]
    np.testing.assert_allclose(view.to_frame(np.array([edges]))[0], truth, atol=1.1 * focal / FOCAL_PX)


def test_shrinking_takes_medians_of_what_was_measured() -> None:
    depth = np.full((16, 16), 0.7)
    depth[::4, ::4] = 5.0  # one flying pixel of sixteen
    depth[8:, 8:] = 0.0
    view = detector_view(depth, _camera(16, 16, 4 * FOCAL_PX)).depth
    expected = np.zeros((16, 16), np.float32)
    expected[:4, :4] = 0.7
    expected[2:4, 2:4] = 0.0
    np.testing.assert_array_equal(view, expected)


def test_one_box_per_hand_is_kept() -> None:
    boxes = torch.tensor([[0, 0, 10, 10], [1, 0, 11, 10], [30, 30, 40, 40], [0, 2, 10, 12], [8, 0, 18, 10]])
    assert one_per_hand(boxes.float()) == [0, 2, 4]
    assert one_per_hand(torch.zeros(0, 4)) == []


def test_weights_are_kept(tmp_path) -> None:
    torch.manual_seed(1)
    net = DetectorNet().eval()
    depth = np.random.default_rng(0).uniform(0.5, 1.0, (2, 64, 64)).astype(np.float32)
    with torch.inference_mode():
        before = net(torch.from_numpy(depth))
    found = HandDetector.load(save_weights(net, tmp_path / "d.safetensors")).find_in(depth, threshold=0.0)
    best = torch.sigmoid(before.score).max(1)
    for image, hands in enumerate(found):
        assert hands.scores[0] == pytest.approx(float(best.values[image]), abs=2e-3)
        np.testing.assert_allclose(hands.boxes[0], before.boxes[image, best.indices[image]], atol=0.1)
        assert (np.diff(hands.scores) <= 0).all()


def test_files_without_weights_are_refused(tmp_path) -> None:
    with pytest.raises(InputError, match="human train"):
        HandDetector.load(tmp_path / "none.safetensors")
    (tmp_path / "half.safetensors").write_bytes(b"\x10\0\0\0\0\0\0\0{}")
    with pytest.raises(DataFormatError, match="damaged"):
        HandDetector.load(tmp_path / "half.safetensors")
    other = DetectorNet((8, 8, 8, 8))
    with pytest.raises(DataFormatError, match="no weights of this network"):
        HandDetector.load(save_weights(other, tmp_path / "other.safetensors"))


def test_thresholds_are_shares() -> None:
    frame = Frame(np.full((48, 64), 0.8), _camera(64, 48, 60.0))
    with pytest.raises(InputError, match="0 to 1"):
        HandDetector.load().find(frame, threshold=50)


def test_the_shipped_detector_finds_a_hand_that_grasps(grasp_video) -> None:
    """Boxes of the frames in which the hand keeps still, against the hand's mesh."""
    detector, hand = HandDetector.load(), scaled_hand(human_hand(), SCALE)
    overlaps, sides = [], []
    for k in range(STILL_FROM, len(grasp_video.frames), 3):
        vertices = hand_mesh(hand, grasp_video.q[k], segments=8).vertices
        uv = project(vertices @ grasp_video.X_CH[k, :3, :3].T + grasp_video.X_CH[k, :3, 3], CAMERA)
        found = detector.find(grasp_video.frames[k])
        if found:
            box = torch.tensor([found[0].u_min, found[0].v_min, found[0].u_max, found[0].v_max])
            overlaps.append(float(box_overlap(box, torch.from_numpy(np.r_[uv.min(axis=0), uv.max(axis=0)]).float())[0]))
            sides.append(found[0].side_score if found[0].side == "right" else 1.0 - found[0].side_score)
    assert len(overlaps) >= 4 and np.median(overlaps) > 0.55
    assert np.mean(sides) > 0.5


def test_real_frames_without_a_hand_have_none(assets) -> None:
    camera = CameraNumbers(fx=1066.778, fy=1067.487, cx=312.987, cy=241.311)
    detector = HandDetector.load()
    for frame in read_frames(assets / "rgbd_ycb", intrinsics=camera, depth_scale=10000):
        assert detector.find(frame, threshold=0.65) == []
