"""Find the hands in a depth frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from neuralgrasps.errors import InputError
from neuralgrasps.human.nets.crop import BOX_MARGIN, Crop, take_crop
from neuralgrasps.human.nets.detector_loss import box_overlap
from neuralgrasps.human.nets.detector_net import Cells, DetectorNet, fuse
from neuralgrasps.human.nets.detector_view import detector_view
from neuralgrasps.human.nets.net_files import ASSETS, has_bf16, read_weights
from neuralgrasps.human.nets.side_net import SideNet
from neuralgrasps.human.seen import HandBox
from neuralgrasps.perception.frame import Frame

WEIGHTS, SIDE_WEIGHTS = ASSETS / "detector.safetensors", ASSETS / "side.safetensors"

SURE = 0.5
"""Default score from which a box is called a hand."""

_SAME = 0.45  # boxes that overlap more are one hand
_MOST = 100  # boxes looked at


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundHands:
    """Hands in one of the network's images, the surest first.

    Attributes:
        boxes: (K, 4) u_min, v_min, u_max, v_max; scores: (K,) 0 to 1; right: (K,) how sure it is a right hand, 0 to 1.
    """

    boxes: np.ndarray
    scores: np.ndarray
    right: np.ndarray


class HandDetector:
    """Trained networks; see `load`."""

    def __init__(self, net: DetectorNet, *, side: SideNet | None = None) -> None:
        """Take networks; they are changed for use (`detector_net.fuse`).

        Args:
            side: looks again at each box to tell right from left; without it the detector's own guess is told.
        """
        fuse(net)
        self._net = net
        self._half = has_bf16()
        self._side = None if side is None else side.eval().requires_grad_(False)

    @staticmethod
    def load(path: str | Path | None = None, *, side: str | Path | None = None) -> HandDetector:
        """Read weights that `human train` wrote; None for those that come with the package.

        Raises:
            InputError: no such file.
            DataFormatError: it is damaged or of another network.
        """
        net, side_net = DetectorNet(), SideNet()
        read_weights(net, WEIGHTS if path is None else path)
        read_weights(side_net, SIDE_WEIGHTS if side is None else side)
        return HandDetector(net, side=side_net)

    def find(self, frame: Frame, *, threshold: float = SURE) -> list[HandBox]:
        """Hands in a frame, the surest first.

        Boxes hold the whole hand from the wrist on, hidden parts too; those of a hand at the image's edge reach
        beyond it. Hands are known by their depth and metric size: one outside of 0.35 to 1.5 m, one without measured
        depth, or one seen with a wrong focal length is not found.

        Args:
            threshold: least score, 0 to 1.
        Raises:
            InputError: a threshold outside of that.
        """
        if not 0.0 <= threshold <= 1.0:
            raise InputError(f"threshold is {threshold}; expected 0 to 1.")
        view = detector_view(frame.depth, frame.intrinsics)
        found = self.find_in(view.depth[None], threshold=threshold)[0]
        boxes = view.to_frame(found.boxes)
        right = found.right if self._side is None else self._looked_again(frame, boxes)
        return [_hand_box(*row) for row in zip(boxes, found.scores, right, strict=True)]

    def find_in(self, depth: np.ndarray, *, threshold: float) -> list[FoundHands]:
        """Hands in images (N, h, w) as `detector_view` makes them, metres; boxes in their pixels."""
        with torch.inference_mode():
            cells = self._net(torch.from_numpy(depth))
            return [_surest(cells, image, threshold) for image in range(len(depth))]

    def _looked_again(self, frame: Frame, boxes: np.ndarray) -> np.ndarray:
        """(K,) how sure the side network is that the hands in boxes (K, 4) of a frame are right ones; 0.5 where no
        depth is."""
        right = np.full(len(boxes), 0.5)
        crops = [side_crop(frame, box) for box in boxes]
        rows = [row for row, crop in enumerate(crops) if crop is not None]
        if rows and self._side is not None:
            inputs = np.stack([crop.inputs for crop in crops if crop is not None])
            conditions = np.stack([crop.conditions for crop in crops if crop is not None])
            with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16, enabled=self._half):
                right[rows] = torch.sigmoid(self._side(torch.from_numpy(inputs), torch.from_numpy(conditions))).numpy()
        return right


def side_crop(frame: Frame, box: np.ndarray) -> Crop | None:
    """The crop of a box (4,) that the side network sees; None where nothing was measured."""
    u, v = 0.5 * (box[:2] + box[2:])
    longer = max(box[2] - box[0], (box[3] - box[1]) * frame.intrinsics.fx / frame.intrinsics.fy)
    return take_crop(frame.depth, frame.intrinsics, u=float(u), v=float(v), side=BOX_MARGIN * float(longer))


def _surest(cells: Cells, image: int, threshold: float) -> FoundHands:
    score, chosen = torch.sigmoid(cells.score[image]).topk(min(_MOST, cells.score.shape[1]))
    chosen, score = chosen[score >= threshold], score[score >= threshold]
    boxes = cells.boxes[image, chosen]
    kept = one_per_hand(boxes)
    right = torch.sigmoid(cells.right[image, chosen[kept]])
    return FoundHands(boxes=boxes[kept].numpy(), scores=score[kept].numpy(), right=right.numpy())


def one_per_hand(boxes: torch.Tensor, *, same: float = _SAME) -> list[int]:
    """Rows of boxes (N, 4), the surest first, that do not overlap an earlier kept one by `same` (non-maximum
    suppression)."""
    overlap, _ = box_overlap(boxes[:, None], boxes[None])
    kept: list[int] = []
    for row, others in enumerate(overlap.tolist()):
        if all(others[k] <= same for k in kept):
            kept.append(row)
    return kept


def _hand_box(box: np.ndarray, score: float, right: float) -> HandBox:
    u_min, v_min, u_max, v_max = map(float, box)
    return HandBox(
        u_min=u_min, v_min=v_min, u_max=u_max, v_max=v_max, score=float(score),
        side="right" if right >= 0.5 else "left", side_score=float(max(right, 1.0 - right)),
    )  # fmt: skip
