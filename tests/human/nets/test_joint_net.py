"""The joint net, its training and its scores."""

from __future__ import annotations

import json
import multiprocessing
from dataclasses import replace

import numpy as np
import pytest
import torch

from neuralgrasps.errors import InputError
from neuralgrasps.human.nets.crop import crop_points
from neuralgrasps.human.nets.joint_errors import procrustes_error
from neuralgrasps.human.nets.joint_images import CropMix, make_crops
from neuralgrasps.human.nets.joint_loss import aligned_distance, camera_points
from neuralgrasps.human.nets.joint_net import CELLS, JointNet
from neuralgrasps.human.nets.joint_score import score_joints
from neuralgrasps.human.nets.joint_train import (
    JointTrainConfig,
    JointTraining,
    log_to,
    train_joints,
)  # fmt: skip
from neuralgrasps.human.nets.joint_train import (
    test_crops as crops_to_test,
)
from tests.human.human_scenes import small_bank, small_kit

TINY = JointTrainConfig(images=64, batch=16, warm=16, workers=1, bf16=False, test_images=16, test_every=32)


def _inputs(count: int = 3) -> tuple[torch.Tensor, torch.Tensor]:
    batch = make_crops(small_kit(), np.arange(count, dtype=np.uint32))
    return torch.from_numpy(batch.inputs), torch.from_numpy(batch.conditions)


class _Stopped(Exception):
    """What a training is stopped by in a test."""


def _stop(figures: dict[str, float]) -> None:
    raise _Stopped


def _stop_late(figures: dict[str, float]) -> None:
    if figures["images"] >= TINY.images:
        raise _Stopped


def test_anchors_vote_with_their_weights():
    """One anchor that outweighs all says where the joint is; equal weights give the mean."""
    net, votes = JointNet(), torch.zeros(1, 5 * 21, CELLS, CELLS)
    votes[0, 7, 2, 9] = 50.0  # weight of joint 7 at row 2, column 9
    votes[0, 21 + 7, 2, 9], votes[0, 42 + 7, 2, 9], votes[0, 63 + 7, 2, 9] = 0.01, -0.02, 0.3
    out = net._tally(votes, torch.zeros(1, 96, 96))
    expected = [9.5 / CELLS - 0.5 + 0.01, 2.5 / CELLS - 0.5 - 0.02, 0.3]
    np.testing.assert_allclose(out.joints[0, 7], expected, atol=1e-6)
    np.testing.assert_allclose(out.joints[0, 3], 0.0, atol=1e-6)


def test_the_net_for_use_says_the_same():
    torch.manual_seed(0)
    inputs, conditions = _inputs()
    net = JointNet()
    for _ in range(3):
        net(inputs, conditions)  # statistics for the batch norms
    net.eval()
    with torch.no_grad():
        before = net(inputs, conditions)
        after = net.fused()(inputs, conditions)
    for one, other in zip(before, after, strict=True):
        np.testing.assert_allclose(one, other, atol=2e-4)
    assert not any(isinstance(module, torch.nn.BatchNorm2d) for module in net.modules())


def test_a_training_that_was_stopped_goes_on_as_one(tmp_path):
    whole = train_joints(small_bank(), TINY, report=log_to(tmp_path / "log"), checkpoint=tmp_path / "whole")
    with pytest.raises(_Stopped):
        train_joints(small_bank(), TINY, report=_stop, checkpoint=tmp_path / "half")  # nothing is kept yet
    with pytest.raises(_Stopped):
        train_joints(small_bank(), TINY, report=_stop_late, checkpoint=tmp_path / "half")
    assert (tmp_path / "half").is_file()
    lines: list[dict[str, float]] = []
    resumed = train_joints(small_bank(), TINY, report=lines.append, checkpoint=tmp_path / "half")
    for one, other in zip(whole.state_dict().values(), resumed.state_dict().values(), strict=True):
        torch.testing.assert_close(one, other)
    assert [line["images"] for line in lines] == [64]
    logged = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    assert [line["images"] for line in logged] == [32, 64]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log"]  # no checkpoint is left


def test_workers_end_with_the_one_that_fails():
    with pytest.raises(_Stopped):
        train_joints(small_bank(), replace(TINY, images=32, workers=2), report=_stop)
    assert multiprocessing.active_children() == []


def test_a_checkpoint_of_another_training_is_not_taken(tmp_path):
    training = JointTraining(TINY)
    training.done = 48
    training.keep(tmp_path / "kept", "this")
    other, same = JointTraining(TINY, seed=1), JointTraining(TINY, seed=1)
    other.restore(tmp_path / "kept", "that")
    assert other.done == 0 and not torch.equal(other.net.stem.weight, training.net.stem.weight)
    same.restore(tmp_path / "kept", "this")
    assert same.done == 48 and torch.equal(same.net.stem.weight, training.net.stem.weight)


def test_a_training_can_start_from_weights():
    torch.manual_seed(7)
    start = JointNet()
    training = JointTraining(TINY, start=start)
    for net in (training.net, training.averaged):
        for one, other in zip(net.state_dict().values(), start.state_dict().values(), strict=True):
            assert torch.equal(one, other)


def test_the_aligned_distance_is_the_measures():
    rng = np.random.default_rng(0)
    points, truth = rng.normal(size=(5, 21, 3)), rng.normal(size=(5, 21, 3))
    points[0] = truth[0] * [-1.0, 1.0, 1.0]  # a mirror image is no rotation
    points[1] = 2.0 * truth[1] + 0.3
    found = aligned_distance(torch.from_numpy(points), torch.from_numpy(truth)).numpy()
    exact = procrustes_error(points, truth)
    assert found[1].max() < 1e-9 and exact[0] > 0.3
    np.testing.assert_allclose(found.mean(axis=1), exact, atol=0.02)  # the part that is quadratic


def test_gradients_of_the_aligned_distance_do_not_turn_or_scale():
    """Moving along a rotation, a shift or a scale changes the squares' sum by nothing; the gradient knows that."""
    rng = np.random.default_rng(1)
    points = torch.from_numpy(rng.normal(size=(1, 21, 3))).requires_grad_()
    truth = torch.from_numpy(rng.normal(size=(1, 21, 3)))
    aligned_distance(points, truth).square().sum().backward()
    pull, middle = points.grad[0], points.detach()[0] - points.detach()[0].mean(0)
    assert pull.sum(0).abs().max() < 0.1 * pull.norm()
    assert torch.cross(middle, pull, dim=-1).sum(0).norm() < 0.1 * middle.norm() * pull.norm()


def test_it_learns_a_few_images_by_heart():
    training = JointTraining(JointTrainConfig(images=4000, batch=12, warm=200, workers=1, bf16=False))
    batch = make_crops(small_kit(), np.arange(12, dtype=np.uint32))
    losses = []
    for _ in range(30):
        losses.append(training._step(batch))
        training.done += 12
    assert losses[-1] < 0.5 * losses[0]


def test_points_are_those_of_the_reader():
    batch = make_crops(small_kit(), np.arange(4, dtype=np.uint32))
    points = camera_points(torch.from_numpy(batch.joints), torch.from_numpy(batch.conditions)).numpy()
    np.testing.assert_allclose(points, batch.joints_C, atol=1e-5)
    np.testing.assert_allclose(points, crop_points(batch.joints, batch.conditions), atol=1e-6)


def test_turned_crops_are_the_same_scenes_turned():
    seeds = np.arange(24, dtype=np.uint32)
    plain, all_turned = (make_crops(small_kit(), seeds, crop=CropMix(turned=share)) for share in (0.0, 1.0))
    np.testing.assert_array_equal(all_turned.inputs, plain.inputs[:, :, ::-1, ::-1])
    np.testing.assert_array_equal(all_turned.mask, plain.mask[:, ::-1, ::-1])
    np.testing.assert_array_equal(all_turned.joints_C, plain.joints_C * np.float32([-1, -1, 1]))
    points = camera_points(torch.from_numpy(all_turned.joints), torch.from_numpy(all_turned.conditions)).numpy()
    np.testing.assert_allclose(points, all_turned.joints_C, atol=1e-5)
    half = make_crops(small_kit(), seeds, crop=CropMix(turned=0.5))
    share = np.mean([np.array_equal(a, b) for a, b in zip(half.joints_C, plain.joints_C, strict=True)])
    assert 0.2 < share < 0.8


def test_test_images_are_not_trained_on():
    test = crops_to_test(small_kit(), 4)
    training = JointTraining(TINY)
    assert not any(np.array_equal(a, b) for a in test.joints_C for b in training._crops(small_kit()).joints_C)
    assert test.visible.min() >= 0.0 and test.visible.max() <= 1.0 and test.visible.std() > 0


def test_perfect_predictions_score_zero():
    test = crops_to_test(small_kit(), 12)
    score = score_joints(test.joints_C.astype(np.float64), test.mask > 0, test)
    assert score.root_relative_mm == pytest.approx(0.0, abs=1e-3) and score.mask_iou == 1.0
    shifted = score_joints(test.joints_C + np.float32(0.01), test.mask > 0, test)
    assert shifted.absolute_mm == pytest.approx(17.32, abs=0.01)
    assert shifted.procrustes_mm == pytest.approx(0.0, abs=1e-2)


def test_bad_numbers_are_told():
    with pytest.raises(InputError, match="batch is 0"):
        JointTrainConfig(batch=0)
