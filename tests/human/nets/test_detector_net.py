"""The detector's cells, targets and loss."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from neuralgrasps.human.nets.detector_loss import HandLabels, box_overlap, detector_loss, owners
from neuralgrasps.human.nets.detector_net import Cells, DetectorNet, cell_centres, depth_channels, fuse


def _labels(boxes, right=None, known=None, ignored=None) -> HandLabels:
    boxes = torch.tensor(boxes, dtype=torch.float32)
    shape = boxes.shape[:2]
    return HandLabels(
        boxes=boxes,
        right=torch.ones(shape, dtype=torch.bool) if right is None else torch.tensor(right),
        known=torch.ones(shape, dtype=torch.bool) if known is None else torch.tensor(known),
        ignored=torch.zeros(shape, dtype=torch.bool) if ignored is None else torch.tensor(ignored),
    )


def _cells(images: int = 1, *, box=(0.0, 0.0, 1.0, 1.0), score: float = 0.0, right: float = 0.0) -> Cells:
    """Cells of a 128 x 160 image that all say the same."""
    centres = torch.cat([cell_centres(16, 20, 8, torch.device("cpu")), cell_centres(8, 10, 16, torch.device("cpu"))])
    strides = torch.cat([torch.full((320,), 8.0), torch.full((80,), 16.0)])
    flat = torch.zeros(images, 400)
    boxes = torch.tensor(box).expand(images, 400, 4)
    return Cells(score=flat + score, right=flat + right, boxes=boxes, centres=centres, strides=strides)


def test_cells_of_an_image() -> None:
    net = DetectorNet().eval()
    with torch.inference_mode():
        cells = net(torch.full((2, 128, 160), 0.7))
    assert cells.score.shape == cells.right.shape == (2, 400)
    inside = (cells.boxes[..., :2] < cells.centres) & (cells.boxes[..., 2:] > cells.centres)
    assert inside.all()
    assert (torch.sigmoid(cells.score) < 0.2).all()  # at first hardly any cell claims a hand


def test_centres_are_middles_of_cells() -> None:
    centres = cell_centres(2, 3, 8, torch.device("cpu"))
    assert centres.tolist() == [[3.5, 3.5], [11.5, 3.5], [19.5, 3.5], [3.5, 11.5], [11.5, 11.5], [19.5, 11.5]]


def test_fused_network_says_the_same() -> None:
    torch.manual_seed(0)
    net, depth = DetectorNet(), torch.rand(8, 64, 96) + 0.3
    with torch.no_grad():
        for _ in range(3):  # statistics that are not those of the start
            net(depth)
    net.eval()
    with torch.inference_mode():
        before = net(depth)
        fuse(net)
        after = net(depth)
    np.testing.assert_allclose(after.score, before.score, atol=1e-3)
    np.testing.assert_allclose(after.boxes, before.boxes, atol=1e-2)


def test_depth_channels_know_the_mean_around() -> None:
    depth = torch.full((1, 64, 64), 0.8)
    depth[:, :, 40:] = 0.0
    channels = depth_channels(depth)[0]
    assert channels[0, :, :40].abs().max() < 1e-6  # 0.8 m is the middle
    assert channels[1].abs().max() < 1e-4  # pixels without a depth do not pull the mean
    assert channels[2].sum() == 64 * 40
    depth[:, 30:32, 10:12] = 0.7
    assert depth_channels(depth)[0, 1, 30, 10] == pytest.approx(-2.0, abs=0.1)  # 10 cm nearer, in 5 cm


@pytest.mark.parametrize(
    ("box", "other", "iou", "giou"),
    [
        ((0, 0, 2, 2), (0, 0, 2, 2), 1.0, 1.0),
        ((0, 0, 2, 2), (1, 0, 3, 2), 1 / 3, 1 / 3),
        ((0, 0, 1, 1), (2, 0, 3, 1), 0.0, -1 / 3),
        ((0, 0, 2, 2), (1, 1, 3, 3), 1 / 7, 1 / 7 - 2 / 9),
    ],
)
def test_overlap_by_hand(box, other, iou, giou) -> None:
    got = box_overlap(torch.tensor(box, dtype=torch.float32), torch.tensor(other, dtype=torch.float32))
    np.testing.assert_allclose([float(got[0]), float(got[1])], [iou, giou], atol=1e-6)


def test_cells_near_the_middle_own_a_hand() -> None:
    cells = _cells()
    hand = owners(cells, _labels([[[20.0, 20, 44, 44], [80, 40, 140, 110]]]))[0]
    small, large = (hand == 0).nonzero()[:, 0], (hand == 1).nonzero()[:, 0]
    assert (cells.strides[small] == 8).all() and (cells.strides[large] == 16).all()
    assert len(small) and (cells.centres[small] - 32.0).abs().max() <= 12.0
    assert len(large) and (cells.centres[large] - torch.tensor([110.0, 75.0])).abs().max() <= 24.0


def test_the_smaller_of_two_hands_wins() -> None:
    cells = _cells()
    hand = owners(cells, _labels([[[10.0, 10, 58, 58], [20, 20, 48, 48]]]))[0]
    middle = ((cells.centres - 34.0).abs().amax(-1) < 8) & (cells.strides == 8)
    assert (hand[middle] == 1).all()


def test_unknown_hands_own_nothing() -> None:
    hand = owners(_cells(), _labels([[[20.0, 20, 44, 44]]], known=[[False]]))
    assert (hand == -1).all()


def test_right_answers_cost_nothing() -> None:
    labels = _labels([[[20.0, 20, 44, 44]]])
    cells = _cells(box=(20.0, 20.0, 44.0, 44.0), right=20.0)
    has = owners(cells, labels) >= 0
    perfect = Cells(
        score=torch.where(has, 20.0, -20.0), right=cells.right, boxes=cells.boxes, centres=cells.centres,
        strides=cells.strides,
    )  # fmt: skip
    assert float(detector_loss(perfect, labels).total) < 1e-4
    wrong_side = detector_loss(perfect, _labels([[[20.0, 20, 44, 44]]], right=[[False]]))
    assert float(wrong_side.side) > 10.0 and float(wrong_side.score) < 1e-4


def test_ignored_hands_are_left_alone() -> None:
    sure = _cells(box=(20.0, 20.0, 44.0, 44.0), score=-20.0)
    inside = ((sure.centres >= 20) & (sure.centres <= 44)).all(-1)
    sure = Cells(
        score=torch.where(inside, 8.0, -20.0)[None], right=sure.right, boxes=sure.boxes, centres=sure.centres,
        strides=sure.strides,
    )  # fmt: skip
    box = [[[20.0, 20, 44, 44]]]
    assert float(detector_loss(sure, _labels(box, known=[[False]])).score) > 10.0
    assert float(detector_loss(sure, _labels(box, known=[[False]], ignored=[[True]])).score) < 1e-4


def test_loss_of_no_hand_has_a_gradient() -> None:
    net = DetectorNet()
    loss = detector_loss(net(torch.rand(2, 64, 64) + 0.3), _labels(np.zeros((2, 1, 4)), known=[[False], [False]]))
    loss.total.backward()
    assert torch.isfinite(loss.total) and all(
        torch.isfinite(p.grad).all() for p in net.parameters() if p.grad is not None
    )
