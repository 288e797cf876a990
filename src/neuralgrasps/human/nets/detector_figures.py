"""How well a hand detector does on drawn images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from neuralgrasps.human.nets.detect import SURE, FoundHands, HandDetector
from neuralgrasps.human.nets.detector_images import DetectorImages

_LEAST = 0.02  # boxes of a lower score are not counted
_BATCH = 32
_FALSE_SHARE = 0.01  # false boxes per image at which recall is told
_FOUND = 0.5  # overlap from which a hand counts as found
_ON_IGNORED = 0.2  # overlap with a hand that does not count, from which a box does not either
_CLEAR = 0.4  # share of a hand that must be in view to count for `recall_clear`


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectorFigures:
    """Figures of a detector; hands almost out of sight count neither way.

    Attributes:
        images, hands: how many.
        ap50: average precision at an overlap of 0.5 (area under the precision-recall curve).
        recall: share of the hands found, and `recall_clear` of those more than 40 % in view, at 1 false box per 100
            images; `score_there`: the score from which that is so.
        recall_sure, false_sure: share found, and false boxes per image without a hand, at the default score.
        overlap: mean intersection over union of the hands found at the default score.
        centre_error, size_error: means of how far their boxes' middle is off, and of how far the longer side is off
            (either way), as shares of the true longer side; `centre_p90`, `size_p90`: 90th percentiles.
        size_bias: mean of the longer side over the true one, less 1.
        side_accuracy: share of them whose side is right.
    """

    images: int
    hands: int
    ap50: float
    recall: float
    recall_clear: float
    score_there: float
    recall_sure: float
    false_sure: float
    overlap: float
    centre_error: float
    centre_p90: float
    size_error: float
    size_p90: float
    size_bias: float
    side_accuracy: float


class _Matches(NamedTuple):
    """Boxes of all images, surest first: score, image, which of its hands (-1: none), box, how sure it is right."""

    score: np.ndarray
    image: np.ndarray
    hand: np.ndarray
    box: np.ndarray
    right: np.ndarray


def detector_figures(detector: HandDetector, images: DetectorImages) -> DetectorFigures:
    """Run a detector over images and compare."""
    found: list[FoundHands] = []
    for first in range(0, len(images.depth), _BATCH):
        found += detector.find_in(images.depth[first : first + _BATCH], threshold=_LEAST)
    boxes = _matched(found, images)
    hands = int(images.known.sum())
    clear = images.known & (images.visible > _CLEAR)
    hits, sure = boxes.hand >= 0, boxes.score >= SURE
    cut = _score_at(boxes.score, ~hits, _FALSE_SHARE * len(images.depth))
    at_cut = hits & (boxes.score >= cut)
    chosen = hits & sure
    truth = images.boxes[boxes.image[chosen], boxes.hand[chosen]]
    overlap, centre, size = _box_errors(boxes.box[chosen], truth)
    side = (boxes.right[chosen] >= 0.5) == images.right[boxes.image[chosen], boxes.hand[chosen]]
    empty = ~(images.known | images.ignored).any(axis=1)
    return DetectorFigures(
        images=len(images.depth),
        hands=hands,
        ap50=_average_precision(hits, hands),
        recall=float(at_cut.sum() / max(hands, 1)),
        recall_clear=float(clear[boxes.image[at_cut], boxes.hand[at_cut]].sum() / max(clear.sum(), 1)),
        score_there=float(cut),
        recall_sure=float(chosen.sum() / max(hands, 1)),
        false_sure=float((empty[boxes.image] & sure).sum() / max(empty.sum(), 1)),
        overlap=_mean(overlap),
        centre_error=_mean(centre),
        centre_p90=_p90(centre),
        size_error=_mean(np.abs(size)),
        size_p90=_p90(np.abs(size)),
        size_bias=_mean(size),
        side_accuracy=_mean(side),
    )


def _matched(found: list[FoundHands], images: DetectorImages) -> _Matches:
    """Each box with the hand it covers best and that no surer box covers; boxes on hands that do not count are left
    out."""
    rows: list[tuple[float, int, int, np.ndarray, float]] = []
    for image, own in enumerate(found):
        free = images.known[image].copy()
        for box, score, right in zip(own.boxes, own.scores, own.right, strict=True):
            truth = images.boxes[image]
            overlap = _box_errors(np.broadcast_to(box, truth.shape), truth)[0]
            best = int(np.argmax(np.where(free, overlap, -1.0)))
            is_hand = bool(free[best] and overlap[best] >= _FOUND)
            if not is_hand and (images.ignored[image] & (overlap > _ON_IGNORED)).any():
                continue
            free[best] &= not is_hand
            rows.append((score, image, best if is_hand else -1, box, right))
    rows.sort(key=lambda row: -row[0])
    return _Matches(
        score=np.array([r[0] for r in rows], float), image=np.array([r[1] for r in rows], int),
        hand=np.array([r[2] for r in rows], int), box=np.array([r[3] for r in rows], float).reshape(-1, 4),
        right=np.array([r[4] for r in rows], float),
    )  # fmt: skip


def _box_errors(boxes: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Overlap, distance of the middles and error of the longer side over the true longer side, of boxes (N, 4)."""
    inner = np.maximum(np.minimum(boxes[:, 2:], truth[:, 2:]) - np.maximum(boxes[:, :2], truth[:, :2]), 0.0).prod(1)
    size, true_size = boxes[:, 2:] - boxes[:, :2], np.maximum(truth[:, 2:] - truth[:, :2], 1e-9)
    middle, true_middle = 0.5 * (boxes[:, :2] + boxes[:, 2:]), 0.5 * (truth[:, :2] + truth[:, 2:])
    longer = true_size.max(axis=1)
    off = np.linalg.norm(middle - true_middle, axis=1) / longer
    return inner / (size.prod(1) + true_size.prod(1) - inner), off, size.max(axis=1) / longer - 1.0


def _average_precision(true: np.ndarray, hands: int) -> float:
    """Area under precision over recall; precision is made to fall only. `true`: the boxes, the surest first."""
    precision = np.cumsum(true) / np.arange(1, len(true) + 1)
    precision = np.maximum.accumulate(precision[::-1])[::-1]
    return float(precision[true].sum() / max(hands, 1))


def _score_at(score: np.ndarray, false: np.ndarray, most: float) -> float:
    """Lowest score (of those sorted downwards) from which at most `most` boxes are false."""
    over = np.nonzero(np.cumsum(false) > most)[0]
    return float(np.nextafter(score[over[0]], 2.0)) if len(over) else 0.0


def _mean(values: np.ndarray) -> float:
    return float(np.mean(values)) if len(values) else float("nan")


def _p90(values: np.ndarray) -> float:
    return float(np.percentile(values, 90)) if len(values) else float("nan")
