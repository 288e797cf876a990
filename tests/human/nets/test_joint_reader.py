"""The shipped joint net on drawn frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from neuralgrasps.errors import DataFormatError, InputError
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.human.nets import joint_reader
from neuralgrasps.human.nets.joint_errors import procrustes_error, root_relative_error
from neuralgrasps.human.nets.joint_net import JointNet
from neuralgrasps.human.nets.joint_reader import JointReader, box_of_joints
from neuralgrasps.human.nets.net_files import save_weights
from neuralgrasps.human.scenes.image_noise import sense_image
from neuralgrasps.human.scenes.random_scene import SceneMix, draw_scene, random_scene
from neuralgrasps.human.scenes.surroundings import HAND
from neuralgrasps.human.seen import HandBox
from neuralgrasps.perception.frame import Frame
from tests.human.human_scenes import small_kit
from tests.human.scenes.test_image_noise import SAME

CAMERA = Intrinsics(580.0, 580.0, 319.5, 239.5, 640, 480)
MIX = SceneMix(held=1.0, near=0.0, varied=0.0, clutter=0, farthest_m=0.8, span_x=0.3, span_y=0.2)
ANY = HandBox(u_min=0.0, v_min=0.0, u_max=0.0, v_max=0.0, score=1.0, side="right", side_score=1.0)


@pytest.fixture(scope="module")
def reader() -> JointReader:
    return JointReader.load()


def _shown(seed: int) -> tuple[Frame, HandBox, np.ndarray, np.ndarray]:
    """A noisy frame, the box, the joints and the hand's pixels."""
    scene = random_scene(small_kit(), seed, MIX)
    depth, labels = draw_scene(scene, CAMERA)
    seen = np.empty_like(depth)
    sense_image(depth, CAMERA.fx, 1.0, SAME, seen)
    frame = Frame(seen, CAMERA)
    return frame, box_of_joints(frame, scene.joints_C, side=ANY), scene.joints_C, labels == HAND


def _mirror(frame: Frame, box: HandBox) -> tuple[Frame, HandBox]:
    last = frame.intrinsics.width - 1
    k = replace(frame.intrinsics, cx=last - frame.intrinsics.cx)
    side = "left" if box.side == "right" else "right"
    return Frame(frame.depth[:, ::-1], k), replace(box, u_min=last - box.u_max, u_max=last - box.u_min, side=side)


def test_hands_that_hold_something_are_read(reader):
    root, shape, overlap = [], [], []
    for seed in range(16):
        frame, box, joints_C, hand = _shown(seed)
        seen = reader.read(frame, box)
        assert seen.side == "right" and seen.points_C.shape == (21, 3) and seen.mask is not None
        root.append(root_relative_error(seen.points_C, joints_C))
        shape.append(procrustes_error(seen.points_C, joints_C))
        measured = frame.depth > 0
        overlap.append((seen.mask & hand).sum() / max((seen.mask | (hand & measured)).sum(), 1))
    assert np.median(root) < 0.016 and np.median(shape) < 0.011 and np.median(overlap) > 0.85


def test_weights_tell_good_joints_from_bad(reader):
    error, weight = [], []
    for seed in range(16):
        frame, box, joints_C, _ = _shown(seed)
        seen = reader.read(frame, box)
        error.append(np.linalg.norm(seen.points_C - joints_C, axis=1))
        weight.append(seen.weight)
    error, weight = np.concatenate(error), np.concatenate(weight)
    assert weight.min() >= 0.0 and weight.max() <= 1.0
    surer = weight > np.median(weight)
    assert error[surer].mean() < 0.8 * error[~surer].mean()


def test_a_hand_behind_something_is_read_at_its_own_depth(reader, monkeypatch):
    found = {True: [], False: []}
    for seed in range(12):
        frame, box, joints_C, hand = _shown(seed)
        rows, columns = np.nonzero(hand)
        depth = frame.depth.copy()
        middle = slice(int(np.quantile(rows, 0.25)), int(np.quantile(rows, 0.75)) + 1)
        left = int(np.quantile(columns, 0.5))
        depth[middle, left:] = np.median(frame.depth[hand]) - 0.3  # a card in the box's middle
        depth[middle, : left - 25] = depth[middle, left + 1][:, None]
        hidden = Frame(depth, frame.intrinsics)
        for tried in (True, False):
            monkeypatch.setattr(joint_reader, "_OTHER_DEPTHS_M", (-0.1, 0.1, 0.2, 0.3) if tried else ())
            found[tried].append(root_relative_error(reader.read(hidden, box).points_C, joints_C))
    assert np.max(found[True]) < 0.1 < np.max(found[False])
    assert np.mean(found[True]) < 0.6 * np.mean(found[False])


def test_a_left_hand_is_the_mirrored_right_one(reader):
    frame, box, _, _ = _shown(3)
    right, left = reader.read(frame, box), reader.read(*_mirror(frame, box))
    np.testing.assert_allclose(left.points_C * [-1.0, 1.0, 1.0], right.points_C, atol=3e-3)
    assert left.side == "left" and left.mask is not None and right.mask is not None
    both = left.mask[:, ::-1] & right.mask
    assert both.sum() > 0.97 * (left.mask[:, ::-1] | right.mask).sum()


def test_a_batch_is_a_loop(reader):
    shown = [_shown(seed)[:2] for seed in (0, 1, 2)]
    frames, boxes = [s[0] for s in shown], [s[1] for s in shown]
    boxes.append(replace(boxes[0], u_min=5000.0, u_max=5100.0))
    many = reader.read_batch([*frames, frames[0]], boxes)
    for frame, box, seen in zip(frames, boxes, many, strict=False):
        alone = reader.read(frame, box)
        np.testing.assert_allclose(seen.points_C, alone.points_C, atol=2e-3)
    assert np.isnan(many[3].points_C).all() and many[3].mask is None
    with pytest.raises(InputError, match="3 frames but 4 boxes"):
        reader.read_batch(frames, boxes)


def test_the_second_look_is_turned(monkeypatch):
    """What it says is turned back: a net that tells the same of a crop and of the turned one changes nothing."""
    frame, box, joints_C, _ = _shown(2)
    once, reader = JointReader.load(looks=1), JointReader.load()
    looked: list[bool] = []
    run = reader._run

    def noting(crops, lefts, *, turn):
        looked.append(turn)
        plain, seen = run(crops, lefts, turn=False), run(crops, lefts, turn=turn)
        assert np.linalg.norm(plain[0] - seen[0], axis=-1).mean() < 0.012
        assert (plain[2] == seen[2]).mean() > 0.97
        return seen

    monkeypatch.setattr(reader, "_run", noting)
    both = reader.read(frame, replace(box, u_min=box.u_min - 20, v_max=box.v_max + 20))
    assert looked == [False, True]
    assert np.linalg.norm(both.points_C - joints_C, axis=1).mean() < 0.02
    assert not np.allclose(both.points_C, once.read(frame, box).points_C)


def test_where_nothing_was_measured_nothing_is_said(reader):
    depth = np.zeros((480, 640))
    depth[:20] = 1.0
    frame = Frame(depth, CAMERA)
    for box in (replace(ANY, u_min=100.0, u_max=200.0, v_min=200.0, v_max=300.0), ANY):
        seen = reader.read(frame, box)
        assert np.isnan(seen.points_C).all() and not seen.weight.any() and seen.mask is None


def test_weights_are_kept(tmp_path):
    torch.manual_seed(1)
    net = JointNet()
    file = save_weights(net, tmp_path / "joints.safetensors", notes={"images": "0"})
    frame, box, _, _ = _shown(0)
    np.testing.assert_allclose(
        JointReader.load(file).read(frame, box).points_C, JointReader(net).read(frame, box).points_C, atol=5e-3
    )
    with pytest.raises(InputError, match="do not exist"):
        JointReader.load(tmp_path / "none.safetensors")
    (tmp_path / "bad.safetensors").write_bytes(b"nothing")
    with pytest.raises(DataFormatError, match="damaged"):
        JointReader.load(tmp_path / "bad.safetensors")


def test_boxes_of_joints_hold_the_hand():
    for seed in range(6):
        _, box, _, hand = _shown(seed)
        row, column = np.nonzero(hand)
        inside = (column > box.u_min) & (column < box.u_max) & (row > box.v_min) & (row < box.v_max)
        assert inside.mean() > 0.97
