"""Joints seen in a picture, lifted to metres with the depth image and the lengths of a hand's bones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from neuralgrasps.errors import InputError, check_shape
from neuralgrasps.human.fit.hand_cloud import PALM, hand_cloud
from neuralgrasps.human.fit.hand_fit import fit_hand
from neuralgrasps.human.fit.hand_misfit import misfit
from neuralgrasps.human.seen import SeenJoints, Side
from neuralgrasps.human.skeleton import BONES, NUM_JOINTS, SMALLEST, human_hand, joint_points
from neuralgrasps.perception.frame import Frame

_ROUNDS = 30
_FLESH_M = np.array([0.017, *[0.016, 0.013, 0.012, 0.006], *[0.013, 0.0117, 0.0105, 0.005] * 4])
"""(21,) how far a joint of the model of size 1 lies under the skin that the camera sees; of a tip, less than that."""

_WINDOW_M = 0.004  # half width of the window in which a joint's depth is looked up
_NEAR_SHARE = 25.0  # percentile of the depths there that is taken: the finger's rather than what is behind
_SKIN_SD_M = 0.006
_WIDTHS_M = (0.015, 0.03)  # Cauchy's, of a joint behind what is seen at its pixel (hidden), and before it (beside)
_BONE_SD_M = 0.003
_RELATIVE_SD_M = 0.02  # of depths that were guessed from the picture
_SIZE, _SIZE_SD = 0.79, 0.08  # people's hands as scales of the model; log standard deviation
_VOTES = 8  # frames that are asked for the side of a video's hand
_REACH_M = 0.2  # of a hand in depth: joints are looked for so far before and behind the palm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PictureJoints:
    """The 21 joints as seen in a picture.

    Attributes:
        pixels: (21, 2) u, v of the full image; nan where not known.
        relative: (21,) depths relative to each other, in pixels (the scale of u and v); positive is farther. None: not
            known.
        score: (21,) trust, 0 to 1.
        side: of the hand; side_known: whether that was said, and not just taken.
        source: what they come from, for messages.
    """

    pixels: np.ndarray
    relative: np.ndarray | None
    score: np.ndarray
    side: Side
    side_known: bool
    source: str


def lift_joints(
    joints: PictureJoints, frame: Frame, *, scale: float | None = None, mask: np.ndarray | None = None
) -> SeenJoints | None:
    """Joints in metres that lie on the rays of their pixels, under the measured skin, at a hand's bone lengths apart.

    A joint that something hides is placed by the bones alone, and by its relative depth; it gets a small weight. Where
    relative depths are not known, those of the hand posture that fits best are taken, and of the side that does.

    Args:
        scale: size of the hand; None: estimated, near the usual one.
        mask: (h, w) bool, the hand's pixels: others say nothing about the hand's depth.
    Returns:
        None where fewer than six joints are in the image, or none has a measured depth.
    Raises:
        ShapeError: not 21 joints. InputError: a scale that is not positive.
    """
    check_shape("pixels of joints", np.shape(joints.pixels), (NUM_JOINTS, 2))
    if scale is not None and not (np.isfinite(scale) and scale > 0):
        raise InputError(f"scale is {scale}; expected a size above 0, such as 0.8, or None.")
    skin = _skin_depths(joints.pixels, frame, mask)
    known = np.isfinite(joints.pixels).all(axis=1)
    if known.sum() < 6 or not np.isfinite(skin).any():
        return None
    lifted = _lifted(joints, frame, skin, scale, mask)
    if joints.relative is not None:
        return lifted
    sides: tuple[Side, ...] = (joints.side,) if joints.side_known else ("right", "left")
    tried = [_with_posture(replace(joints, side=side), lifted, frame, skin, scale) for side in sides]
    return min(tried, key=lambda pair: pair[0])[1]


def lift_video(
    joints: Sequence[PictureJoints | None], frames: Sequence[Frame], *, scale: float | None = None
) -> list[SeenJoints | None]:
    """`lift_joints` of the frames of a video that shows one hand.

    Where its side is not said, the one is taken whose hand explains joints and measured points of some frames better.
    """
    pairs = list(zip(joints, frames, strict=True))
    some = [(j, f) for j, f in pairs if j is not None and not j.side_known and j.relative is None]
    some = some[:: max(1, len(some) // _VOTES)]
    sides: tuple[Side, ...] = ("right", "left")
    apart = {side: [_side_misfit(replace(j, side=side, side_known=True), f, scale) for j, f in some] for side in sides}
    side = min(sides, key=lambda one: float(np.sum(apart[one])))
    known = [j if j is None or j.side_known else replace(j, side=side, side_known=True) for j in joints]
    return [None if j is None else lift_joints(j, f, scale=scale) for j, f in zip(known, frames, strict=True)]


def _side_misfit(joints: PictureJoints, frame: Frame, scale: float | None) -> float:
    """How badly a hand of the joints' side explains them and the points near them, metres."""
    seen = lift_joints(joints, frame, scale=scale)
    if seen is None:
        return 0.0
    cloud = hand_cloud(frame, seen)
    return misfit(fit_hand(seen, cloud, side=joints.side, scale=scale or _SIZE), cloud)


def _with_posture(
    joints: PictureJoints, lifted: SeenJoints, frame: Frame, skin: np.ndarray, scale: float | None
) -> tuple[float, SeenJoints]:
    """Joints lifted by the depths of the hand fitted to them, and that hand's misfit in metres."""
    k, misfit = frame.intrinsics, np.inf
    for _ in range(2):
        fitted = fit_hand(lifted, None, side=joints.side, scale=scale or _SIZE)
        misfit, z = fitted.joint_rms_m, fitted.joints_C[:, 2]
        relative = (z - z[0]) / np.median(z) * 0.5 * (k.fx + k.fy)
        lifted = _lifted(replace(joints, relative=relative), frame, skin, scale, lifted.mask)
    return misfit, lifted


def _lifted(
    joints: PictureJoints, frame: Frame, skin: np.ndarray, scale: float | None, mask: np.ndarray | None
) -> SeenJoints:
    k, known = frame.intrinsics, np.isfinite(joints.pixels).all(axis=1)
    rays = np.ones((NUM_JOINTS, 3))
    rays[:, :2] = (np.where(known[:, None], joints.pixels, 0.0) - [k.cx, k.cy]) / [k.fx, k.fy]
    relative = None if joints.relative is None else np.where(known, joints.relative, np.nan) / (0.5 * (k.fx + k.fy))
    z, trust = _depths(rays, skin, known, relative, scale)
    return SeenJoints(
        points_C=np.where(known[:, None], rays * z[:, None], np.nan),
        weight=np.where(known, joints.score * (0.15 + 0.85 * trust), 0.0),
        mask=mask,
        side=joints.side,
        source=joints.source,
    )


def _skin_depths(pixels: np.ndarray, frame: Frame, mask: np.ndarray | None) -> np.ndarray:
    """(21,) depth of the surface seen at each joint's pixel; nan where none is measured."""
    out, k = np.full(NUM_JOINTS, np.nan), frame.intrinsics
    usual = frame.depth[frame.depth > 0]
    middle = _at(frame.depth, pixels)
    z = float(np.median(middle)) if len(middle) else float(np.median(usual))
    half = int(np.clip(round(0.5 * (k.fx + k.fy) * _WINDOW_M / z), 1, 12))
    for joint, (u, v) in enumerate(pixels):
        if not (np.isfinite(u) and -0.5 <= u < k.width - 0.5 and -0.5 <= v < k.height - 0.5):
            continue
        rows = slice(max(round(v) - half, 0), round(v) + half + 1)
        columns = slice(max(round(u) - half, 0), round(u) + half + 1)
        near = frame.depth[rows, columns]
        near = near[near > 0] if mask is None else near[(near > 0) & mask[rows, columns]]
        if len(near):
            out[joint] = np.percentile(near, _NEAR_SHARE)
    return out


def _at(depth: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """(M,) the measured depths at the pixels that lie in the image."""
    known = np.isfinite(pixels).all(axis=1)
    u, v = np.round(pixels[known]).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < depth.shape[1]) & (v < depth.shape[0])
    z = depth[v[inside], u[inside]]
    return z[z > 0]


def _depths(
    rays: np.ndarray, skin: np.ndarray, known: np.ndarray, relative: np.ndarray | None, scale: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """(21,) depths of the joints, and (21,) 0 to 1 how well the skin seen there agrees.

    Reweighted Gauss-Newton over the depths and the log of the size.
    """
    first, second, length = _lengths()
    use = known[first] & known[second]
    first, second, length = first[use], second[use], length[use]
    size = np.log(_SIZE if scale is None else scale)
    size_weight = 1e12 if scale is not None else _SIZE_SD**-2
    usual, z = size, _first_depths(skin, known, float(np.exp(size)), relative)
    near = float(np.median(z[known]))
    slope = near
    trust = np.zeros(NUM_JOINTS)
    for _ in range(_ROUNDS):
        H, b = np.zeros((NUM_JOINTS + 1, NUM_JOINTS + 1)), np.zeros(NUM_JOINTS + 1)
        np.fill_diagonal(H, 1e-2 * _SKIN_SD_M**-2)  # hidden ends of chains stay where they are
        H[-1, -1] = size_weight
        b[-1] = size_weight * (usual - size)
        trust = _skin_rows(H, b, z, skin, np.exp(size))
        _bone_rows(H, b, rays, z, (first, second, length * np.exp(size)))
        if relative is not None:
            slope = _relative_rows(H, b, z, relative, trust, slope)
        step = np.linalg.solve(H, b)
        z = np.clip(z + np.clip(step[:-1], -0.05, 0.05), near - _REACH_M, near + _REACH_M)
        size = float(np.clip(size + step[-1], np.log(0.8 * SMALLEST), 0.2))
        if np.abs(step[:-1][known]).max() < 1e-5:
            break
    return z, trust


def _first_depths(skin: np.ndarray, known: np.ndarray, size: float, relative: np.ndarray | None) -> np.ndarray:
    """Depths to start at: under the skin seen, or the palm's where that is far off; then by the relative depths."""
    z = skin + size * _FLESH_M
    palm = z[list(PALM)]
    near = float(np.nanmedian(palm)) if np.isfinite(palm).sum() >= 3 else float(np.nanmedian(z))
    off = ~(np.abs(z - near) < 0.12)  # nan too
    z = np.where(off, near, z)
    if relative is None:
        return z
    usable = np.isfinite(relative)
    guessed = np.where(usable, near * (relative - np.nanmedian(relative[list(PALM)])) + near, z)
    return np.where(off | (np.abs(z - guessed) > 0.05), guessed, z)


def _skin_rows(H: np.ndarray, b: np.ndarray, z: np.ndarray, skin: np.ndarray, size: float) -> np.ndarray:
    """Add that joints lie under the skin seen at their pixels; (21,) how far each does."""
    off = skin + size * _FLESH_M - z
    width = np.where(off < 0, *_WIDTHS_M)
    trust = np.where(np.isfinite(off), 1.0 / (1.0 + (np.nan_to_num(off) / width) ** 2), 0.0)
    weight = trust**2 * _SKIN_SD_M**-2
    H[np.arange(NUM_JOINTS), np.arange(NUM_JOINTS)] += weight
    b[:-1] += weight * np.nan_to_num(off)
    return trust


def _bone_rows(
    H: np.ndarray, b: np.ndarray, rays: np.ndarray, z: np.ndarray, bones: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> None:
    """Add that joints are so far apart as the bones between them are long."""
    first, second, length = bones
    apart = rays[second] * z[second, None] - rays[first] * z[first, None]
    seen = np.maximum(np.linalg.norm(apart, axis=1), 1e-6)
    J = np.zeros((len(first), NUM_JOINTS + 1))
    row = np.arange(len(first))
    J[row, second] = (apart * rays[second]).sum(axis=1) / seen
    J[row, first] = -(apart * rays[first]).sum(axis=1) / seen
    J[:, -1] = -length
    off = length - seen
    weight = 1.0 / (_BONE_SD_M**2 * (1.0 + (off / 0.02) ** 2))
    H += J.T @ (weight[:, None] * J)
    b += J.T @ (weight * off)


def _relative_rows(
    H: np.ndarray, b: np.ndarray, z: np.ndarray, relative: np.ndarray, trust: np.ndarray, slope: float
) -> float:
    """Add that depths differ as guessed from the picture, times the hand's distance; that, kept within a factor 2."""
    usable = np.isfinite(relative)
    weight = np.where(usable, 0.05 + trust, 0.0)
    guess = np.nan_to_num(relative)
    mean_z, mean_r = np.average(z, weights=weight), np.average(guess, weights=weight)
    spread = float((weight * (guess - mean_r) ** 2).sum())
    if spread > 1e-12:
        found = float((weight * (guess - mean_r) * (z - mean_z)).sum()) / spread
        slope = float(np.clip(found, 0.5 * mean_z, 2.0 * mean_z))
    off = mean_z + slope * (guess - mean_r) - z
    rows = np.where(usable, _RELATIVE_SD_M**-2, 0.0)
    H[np.arange(NUM_JOINTS), np.arange(NUM_JOINTS)] += rows
    b[:-1] += rows * off
    return slope


@cache
def _lengths() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of joints that keep their distance, first and second, and that distance at size 1, metres."""
    hand = human_hand()
    points = joint_points(hand, np.eye(4), 0.5 * (hand.tree.lower + hand.tree.upper))
    inside = [(a, b) for k, a in enumerate(PALM) for b in PALM[k + 1 :]]
    pairs = np.array(sorted({*inside, *((a, b) for a, b in BONES)}))
    return pairs[:, 0], pairs[:, 1], np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
