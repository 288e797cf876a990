"""The joint net, its training and its scores."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch

from neuralgrasps.errors import InputError
from neuralgrasps.human.nets.crop import crop_points
from neuralgrasps.human.nets.joint_images import make_crops
from neuralgrasps.human.nets.joint_net import CELLS, JointNet
from neuralgrasps.human.nets.joint_score import score_joints
from neuralgrasps.human.nets.joint_train import (
    JointTrainConfig,
    JointTraining,
    camera_points,
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


def test_training_goes_on_as_if_never_stopped(tmp_path):
    whole = train_joints(small_bank(), TINY, report=log_to(tmp_path / "log"), checkpoint=tmp_path / "whole.pt")
    stopped = JointTraining(TINY)
    for _ in range(2):
        stopped._step(stopped._crops(small_kit()))
        stopped.done += TINY.batch
    stopped.save(tmp_path / "half.pt")
    resumed = train_joints(small_bank(), TINY, checkpoint=tmp_path / "half.pt")
    for one, other in zip(whole.parameters(), resumed.parameters(), strict=True):
        torch.testing.assert_close(one, other)
    lines = [json.loads(line) for line in (tmp_path / "log").read_text().splitlines()]
    assert [line["images"] for line in lines] == [32, 64]


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
