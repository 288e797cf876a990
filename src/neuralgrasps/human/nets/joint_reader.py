"""Read the 21 joints and the mask of a hand in a depth frame, within the box that a detector or the last frame gave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from neuralgrasps.errors import InputError
from neuralgrasps.human.nets.crop import (
    BOX_MARGIN,
    DEPTH_UNIT_M,
    Crop,
    crop_points,
    full_mask,
    mirrored,
    take_crop,
    turned,
)
from neuralgrasps.human.nets.joint_net import JointNet, JointVotes
from neuralgrasps.human.nets.net_files import ASSETS, has_bf16, read_weights
from neuralgrasps.human.seen import HandBox, SeenJoints
from neuralgrasps.human.skeleton import NUM_JOINTS
from neuralgrasps.perception.frame import Frame

WEIGHTS = ASSETS / "joints.safetensors"

_SOURCE = "depth net"
_TRUST_M = 0.01  # an expected error that halves a joint's weight
_SKIN_M = 0.013  # of skin round the joints, for boxes
_NEAR_M, _FAR_M = 0.035, 0.035  # a hand's surface is not farther from its joints' depths
_SMALLEST_PX = 12.0  # narrower boxes show nothing
_DOUBTFUL = 0.25  # mean weight of the joints below which the crop's reference depth may be that of what hides the hand
_OTHER_DEPTHS_M = (-0.1, 0.1, 0.2, 0.3)  # from it, that are tried then
_SAME_PLACE, _SAME_SIZE, _SAME_M = 0.03, 0.05, 0.015  # what second crops of the training images are off by


class JointReader:
    """A trained net; see `load`. It looks twice and takes the mean of both.

    The second crop is round the joints found, and turned by 180 degrees: the errors of a turned look are others.
    """

    def __init__(self, net: JointNet, *, looks: int = 2) -> None:
        """Take a net; it is changed for use (`JointNet.fused`).

        Args:
            looks: most crops per reading. One is enough where a box is right to a few per cent, as one that comes from
                the joints of the frame before; then no second is taken.
        """
        self._half = has_bf16()
        net = net.fused()
        self._net = net.bfloat16() if self._half else net
        self._looks = looks

    @staticmethod
    def load(path: str | Path | None = None, *, looks: int = 2) -> JointReader:
        """Read weights that `human train joints` wrote; None for those that come with the package.

        Raises:
            InputError: no such file.
            DataFormatError: it is damaged or of another net.
        """
        net = JointNet()
        read_weights(net, WEIGHTS if path is None else path)
        return JointReader(net, looks=looks)

    def read(self, frame: Frame, box: HandBox) -> SeenJoints:
        """Joints and mask of the hand in a box, of the side that the box says.

        Where nothing was measured in the box, all joints are nan with weight 0 and there is no mask.
        """
        return self.read_batch([frame], [box])[0]

    def read_batch(self, frames: Sequence[Frame], boxes: Sequence[HandBox]) -> list[SeenJoints]:
        """`read` for pairs of frame and box, all at once.

        Raises:
            InputError: not as many boxes as frames.
        """
        if len(frames) != len(boxes):
            raise InputError(f"{len(frames)} frames but {len(boxes)} boxes; expected one box per frame.")
        crops = [_first_crop(frame, box) for frame, box in zip(frames, boxes, strict=True)]
        out, found = [_nothing_seen(box) for box in boxes], [_Found() for _ in boxes]
        for look in range(self._looks):
            rows = [row for row, crop in enumerate(crops) if crop is not None]
            taken = [crop for crop in crops if crop is not None]
            if not taken:
                break
            lefts = [boxes[row].side == "left" for row in rows]
            points_C, widths, masks = self._run(taken, lefts, turn=look % 2 == 1)
            if look == 0:
                self._try_other_depths([frames[row] for row in rows], taken, lefts, points_C, widths, masks)
            for k, row in enumerate(rows):
                found[row].add(points_C[k], widths[k])
                crops[row] = _crop_round(frames[row], points_C[k], taken[k]) if look + 1 < self._looks else None
                if crops[row] is None:
                    out[row] = _seen(frames[row], boxes[row], taken[k], found[row], masks[k])
        return out

    def _try_other_depths(
        self, frames: Sequence[Frame], crops: list[Crop], lefts: list[bool], points_C: np.ndarray, widths: np.ndarray,
        masks: np.ndarray,
    ) -> None:  # fmt: skip
        """Read doubtful crops at other reference depths, and put the surest reading in place; changes its arguments.

        Where something stands before the hand, most of the crop's middle is that.
        """
        doubtful = [k for k in range(len(crops)) if _weights(widths[k]).mean() < _DOUBTFUL]
        moved = ((k, _at_depth(frames[k], crops[k], off)) for k in doubtful for off in _OTHER_DEPTHS_M)
        tries = [(k, crop) for k, crop in moved if crop is not None]
        if not tries:
            return
        found = self._run([crop for _, crop in tries], [lefts[k] for k, _ in tries], turn=False)
        for (k, crop), points, width, mask in zip(tries, *found, strict=True):
            if _weights(width).mean() > _weights(widths[k]).mean():
                crops[k], points_C[k], widths[k], masks[k] = crop, points, width, mask

    def _run(self, crops: list[Crop], lefts: list[bool], *, turn: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Joints (N, 21, 3) in the camera frame, expected errors (N, 21), metres, and masks (N, 96, 96) of crops."""
        looked = [mirrored(crop) if left else crop for crop, left in zip(crops, lefts, strict=True)]
        if turn:
            looked = [turned(crop) for crop in looked]
        conditions = np.stack([crop.conditions for crop in looked])
        votes = self._votes(np.stack([crop.inputs for crop in looked]), conditions)
        points_C, masks = crop_points(votes.joints.double().numpy(), conditions), votes.mask.numpy() > 0
        if turn:
            points_C[..., :2] *= -1.0
            masks = masks[:, ::-1, ::-1].copy()
        for k, left in enumerate(lefts):
            if left:
                points_C[k, :, 0] *= -1.0
                masks[k] = masks[k, :, ::-1].copy()
        return points_C, DEPTH_UNIT_M * np.exp(votes.log_width.double().numpy()), masks

    def _votes(self, inputs: np.ndarray, conditions: np.ndarray) -> JointVotes:
        kind = torch.bfloat16 if self._half else torch.float32
        images = torch.from_numpy(inputs).to(kind).contiguous(memory_format=torch.channels_last)
        with torch.inference_mode():
            return self._net(images, torch.from_numpy(conditions).to(kind))


class _Found:
    """What the looks at one hand said: the mean joints, weighted by how sure each look was."""

    def __init__(self) -> None:
        self.widths = np.zeros(NUM_JOINTS)  # expected errors of the last look, metres
        self._sum, self._weight = np.zeros((NUM_JOINTS, 3)), np.zeros(NUM_JOINTS)

    def add(self, points_C: np.ndarray, widths: np.ndarray) -> None:
        """One more look: joints (21, 3) and their expected errors (21,), metres."""
        self.widths = widths
        self._sum += points_C / widths[:, None] ** 2
        self._weight += 1.0 / widths**2

    @property
    def points_C(self) -> np.ndarray:
        """(21, 3) metres."""
        return self._sum / self._weight[:, None]


def box_of_joints(frame: Frame, points_C: np.ndarray, *, side: HandBox) -> HandBox:
    """The box of a hand with these joints (21, 3), camera frame, for the next frame; the rest is as in `side`."""
    u0, v0, u1, v1 = _edges(frame, points_C)
    return replace(side, u_min=u0, v_min=v0, u_max=u1, v_max=v1)


def _edges(frame: Frame, points_C: np.ndarray) -> tuple[float, float, float, float]:
    """Edges of the hand's box in the image: its joints and the skin round them."""
    k, z = frame.intrinsics, np.maximum(points_C[:, 2], 0.05)
    u, v = k.fx * points_C[:, 0] / z + k.cx, k.fy * points_C[:, 1] / z + k.cy
    skin_u, skin_v = k.fx * _SKIN_M / z, k.fy * _SKIN_M / z
    return float((u - skin_u).min()), float((v - skin_v).min()), float((u + skin_u).max()), float((v + skin_v).max())


def _first_crop(frame: Frame, box: HandBox) -> Crop | None:
    width, height = box.u_max - box.u_min, box.v_max - box.v_min
    side = BOX_MARGIN * max(width, height)
    if not side >= _SMALLEST_PX:
        return None
    u, v = 0.5 * (box.u_min + box.u_max), 0.5 * (box.v_min + box.v_max)
    return take_crop(frame.depth, frame.intrinsics, u=u, v=v, side=side)


def _at_depth(frame: Frame, crop: Crop, off: float) -> Crop | None:
    """A crop with another reference depth, metres away; None where that is before the camera."""
    depth_m = crop.depth_m + off
    if depth_m <= 0.0:
        return None
    return take_crop(frame.depth, frame.intrinsics, u=crop.u, v=crop.v, side=crop.side, depth_m=depth_m)


def _weights(widths: np.ndarray) -> np.ndarray:
    """How far joints can be trusted, 0 to 1, by their expected errors, metres."""
    return _TRUST_M**2 / (_TRUST_M**2 + widths**2)


def _crop_round(frame: Frame, points_C: np.ndarray, before: Crop) -> Crop | None:
    """The crop round joints; None where it is hardly another than the one before, or nothing was measured in it."""
    u0, v0, u1, v1 = _edges(frame, points_C)
    u, v, depth_m = 0.5 * (u0 + u1), 0.5 * (v0 + v1), float(points_C[:, 2].mean())
    side = max(BOX_MARGIN * max(u1 - u0, v1 - v0), _SMALLEST_PX)
    moved = max(abs(u - before.u), abs(v - before.v)) / side
    if moved < _SAME_PLACE and abs(np.log(side / before.side)) < _SAME_SIZE and abs(depth_m - before.depth_m) < _SAME_M:
        return None
    crop = take_crop(frame.depth, frame.intrinsics, u=u, v=v, side=side, depth_m=depth_m)
    return crop if crop is not None and crop.inputs[1].any() else None


def _seen(frame: Frame, box: HandBox, crop: Crop, found: _Found, mask: np.ndarray) -> SeenJoints:
    points_C = found.points_C
    whole = full_mask(crop, mask, frame.depth.shape)
    near, far = points_C[:, 2].min() - _NEAR_M, points_C[:, 2].max() + _FAR_M
    whole &= (frame.depth > near) & (frame.depth < far)
    return SeenJoints(points_C=points_C, weight=_weights(found.widths), mask=whole, side=box.side, source=_SOURCE)


def _nothing_seen(box: HandBox) -> SeenJoints:
    return SeenJoints(
        points_C=np.full((NUM_JOINTS, 3), np.nan), weight=np.zeros(NUM_JOINTS), mask=None, side=box.side,
        source=_SOURCE,
    )  # fmt: skip
