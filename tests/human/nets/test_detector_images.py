"""Images that the hand detector learns from, a step of its training, and its figures."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from neuralgrasps.human.nets.detect import FoundHands
from neuralgrasps.human.nets.detector_figures import detector_figures
from neuralgrasps.human.nets.detector_images import DetectorImages, ImageMaker, with_mirrored
from neuralgrasps.human.nets.detector_net import DetectorNet
from neuralgrasps.human.nets.detector_train import DetectorTrainConfig, train_detector, train_step
from neuralgrasps.human.scenes.grasp_bank import GraspBank
from tests.human.human_scenes import small_bank

_FIELDS = ("depth", "boxes", "right", "known", "ignored", "visible", "distance_m")


@pytest.fixture(scope="module")
def bank() -> GraspBank:
    return small_bank()


@pytest.fixture(scope="module")
def images(bank: GraspBank) -> DetectorImages:
    return ImageMaker(bank).draw(3, 0, 60)


def test_images_depend_on_their_number_alone(bank: GraspBank, images: DetectorImages) -> None:
    again = ImageMaker(bank).draw(3, 20, 5)
    for name in _FIELDS:
        np.testing.assert_array_equal(getattr(again, name), getattr(images, name)[20:25])
    assert not np.array_equal(ImageMaker(bank).draw(4, 20, 1).depth, again.depth[:1])


def test_hands_are_where_the_boxes_say(images: DetectorImages) -> None:
    known = images.known
    assert 0.4 < known.sum() / len(known) < 1.3
    assert 0.25 < images.right[known].mean() < 0.75
    size = images.boxes[..., 2:] - images.boxes[..., :2]
    metres = size[known].max(-1) * images.distance_m[known] / 145.0
    assert (metres > 0.05).all() and (metres < 0.4).all()
    near = []
    for image, hand in zip(*np.nonzero(known & (images.visible > 0.5)), strict=True):
        u0, v0, u1, v1 = np.clip(images.boxes[image, hand].astype(int), 0, [159, 127, 159, 127])
        inside = images.depth[image, v0 : v1 + 1, u0 : u1 + 1]
        near.append((np.abs(inside - images.distance_m[image, hand]) < 0.2).mean())
    assert np.median(near) > 0.3  # what is in the box is about as far as the hand


def test_empty_images_have_no_hand(images: DetectorImages) -> None:
    empty = images.distance_m.max(axis=1) == 0
    assert 0.05 < empty.mean() < 0.4
    assert not (images.known | images.ignored)[empty].any()


def test_mirror_images_have_the_other_hand(images: DetectorImages) -> None:
    both = with_mirrored(images)
    n = len(images.depth)
    twice = with_mirrored(DetectorImages(**{name: getattr(both, name)[n:] for name in _FIELDS}))
    for name in ("depth", "right"):
        np.testing.assert_array_equal(getattr(twice, name)[n:], getattr(images, name))
    np.testing.assert_allclose(twice.boxes[n:], images.boxes, atol=1e-4)
    assert (both.right[n:] != images.right).all()
    assert (both.boxes[n:, :, 0] <= both.boxes[n:, :, 2]).all()


class _Oracle:
    """Finds the true hands, moved to the right by a share of their width, and a false one per `every` images."""

    def __init__(self, images: DetectorImages, *, shift: float = 0.0, every: int = 10**6) -> None:
        self._images, self._shift, self._every, self._next = images, shift, every, 0

    def find_in(self, depth: np.ndarray, *, threshold: float) -> list[FoundHands]:
        return [self._find() for _ in depth]

    def _find(self) -> FoundHands:
        row, self._next = self._next, self._next + 1
        boxes = self._images.boxes[row][self._images.known[row]].astype(float)
        boxes[:, [0, 2]] += self._shift * (boxes[:, 2:3] - boxes[:, :1])
        scores, right = np.full(len(boxes), 0.9), self._images.right[row][self._images.known[row]].astype(float)
        if row % self._every == self._every - 1:
            boxes = np.concatenate([boxes, [[300.0, 300.0, 330.0, 330.0]]])
            scores, right = np.append(scores, 0.95), np.append(right, 1.0)
        return FoundHands(boxes=boxes, scores=scores, right=right)


def test_figures_by_hand(images: DetectorImages) -> None:
    perfect = detector_figures(_Oracle(images), images)
    assert (perfect.ap50, perfect.recall, perfect.recall_clear, perfect.recall_sure) == (1.0, 1.0, 1.0, 1.0)
    assert perfect.side_accuracy == 1.0 and perfect.false_sure == 0.0
    assert perfect.centre_error < 1e-6 and perfect.size_error < 1e-6 and perfect.overlap == pytest.approx(1.0)
    shifted = detector_figures(_Oracle(images, shift=0.2), images)
    assert shifted.overlap == pytest.approx(0.8 / 1.2, abs=1e-4) and shifted.size_error < 1e-5
    assert 0.1 < shifted.centre_error <= 0.2001
    assert detector_figures(_Oracle(images, shift=0.5), images).ap50 == 0.0
    noisy = detector_figures(_Oracle(images, every=2), images)
    assert noisy.recall == 0.0 and noisy.recall_sure == 1.0  # false boxes are surer than true ones
    assert noisy.ap50 < 0.8 and noisy.false_sure > 0.2


def test_training_learns(images: DetectorImages) -> None:
    torch.manual_seed(0)
    net = DetectorNet()
    optimiser = torch.optim.AdamW(net.parameters(), lr=2e-3)
    batch = images[slice(0, 8)]
    losses = [train_step(net, optimiser, batch) for _ in range(25)]
    assert np.mean(losses[-3:]) < 0.7 * losses[0]


def test_training_goes_on_to_the_same_weights(bank: GraspBank, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("neuralgrasps.human.nets.detector_train.CHECKPOINT_S", 0.0)
    config = DetectorTrainConfig(images=16, batch=4)
    whole = train_detector(bank, config=config)

    def stop(done: int, total: int, loss: float) -> None:
        if done == 2:
            raise KeyboardInterrupt

    state = tmp_path / "detector.training"
    with pytest.raises(KeyboardInterrupt):
        train_detector(bank, config=config, state=state, progress=stop)
    seen: list[int] = []
    resumed = train_detector(bank, config=config, state=state, progress=lambda done, total, loss: seen.append(done))
    assert seen == [3, 4] and not state.exists()
    for name, value in whole.state_dict().items():
        torch.testing.assert_close(resumed.state_dict()[name], value, atol=1e-6, rtol=1e-5)
