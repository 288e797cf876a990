"""Find the hand in a video: the first pass over some of its frames, and why there is none to follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.human.hand_video import HandVideo
from neuralgrasps.human.seen import HandBox, SeenJoints, Side
from neuralgrasps.human.sighting import BoxPath, HandFinder, box_depth, joints_box, linked_paths
from neuralgrasps.perception.frame import Frame

_LEAST_MEASURED = 0.2  # share of the pixels in the middle of the hand's boxes that must have a depth
_TOGETHER = 0.3  # share of a hand's frames that show another one too, from which there are two
_SECOND = 0.4  # score of a second hand over the first one's
_AS_CLEAR = 0.6  # weight of the joints over the usual one, from which on a hand that was not detected is there
_LEAP_M = 0.08
_HOLDING_M = 0.15  # a box's middle this near to the object's surface may hold it


@dataclass(frozen=True, slots=True, kw_only=True)
class LookConfig:
    """Knobs of the first pass.

    Attributes:
        frames: about so many frames are looked at. step: they are at most so many frames apart.
        score: least score of a hand's box. nearest_m, farthest_m: depths that a hand is looked for at.
    """

    frames: int = 20
    step: int = 6
    score: float = 0.4
    nearest_m: float = 0.2
    farthest_m: float = 1.5


def coarse_frames(count: int, config: LookConfig) -> list[int]:
    """The frames of the first pass over a video of `count` frames."""
    step = int(np.clip(count // config.frames, 1, config.step))
    return list(range(0, count, step))


def look(
    video: HandVideo,
    detector: HandFinder | None,
    joints: Sequence[SeenJoints | None] | None,
    side: Side | None,
    config: LookConfig,
) -> str:
    """Put the hand's boxes (and joints, where given) into the video; why there is no hand to follow, or ""."""
    if joints is not None:
        return _take_joints(video, joints, side, config)
    assert detector is not None
    found = {n: detector.find(video.frames[n]) for n in coarse_frames(len(video.frames), config)}
    paths = linked_paths(found, least_score=config.score)
    if not paths:
        return _no_hand([video.frames[n] for n in found], config)
    first, rest = _chosen_path(video, paths, side)
    rival = _rival(first, rest)
    if rival is not None and _both_hold(video, first, rival):
        return (
            f"two hands are seen in {len(set(first.boxes) & set(rival.boxes))} of the {len(found)} frames looked at, "
            "and both may be the grasping one: show one hand, or say which `side`."
        )
    if rival is not None:
        video.notes.append("a second hand is seen; the one nearer to the object was followed.")
    video.boxes.update(_joined(first, rest))
    return _depth_trouble(video, config)


def followed_frames(video: HandVideo, config: LookConfig) -> list[int]:
    """The frames of the first pass in which joints are seen, ascending.

    Where the detector found nothing, the box follows from the nearest frame's joints; the hand must be about as
    clear there and not far from where it was.
    """
    coarse = coarse_frames(len(video.frames), config)
    found = [n for n in sorted(video.boxes) if video.see(n) is not None]
    if video.reader is None or not found:
        return found
    usual = float(np.median([np.mean(s.weight) for n in found if (s := video.see(n)) is not None]))
    first = found[0]
    for n in coarse:
        if n < first or n in found:
            continue
        before = max(k for k in found if k < n)
        old, new = video.see(before), video.see(n)
        if old is None or new is None:
            continue
        leap = float(np.nanmedian(np.linalg.norm(old.points_C - new.points_C, axis=1)))
        if np.mean(new.weight) >= _AS_CLEAR * usual and leap < _LEAP_M:
            found = sorted([*found, n])
        else:
            video.forget(n)
    return found


def _take_joints(video: HandVideo, joints: Sequence[SeenJoints | None], side: Side | None, config: LookConfig) -> str:
    given = {n: s for n, s in enumerate(joints) if s is not None and np.isfinite(s.points_C).all(axis=1).sum() >= 6}
    if not given:
        return "the joints given show no hand: no frame has six known joints."
    right = sum(s.side == "right" for s in given.values())
    video.side = side or ("right" if 2 * right >= len(given) else "left")
    coarse = set(coarse_frames(len(joints), config))
    for n, seen in given.items():
        box = joints_box(seen, video.frames[n].intrinsics)
        if box is None:
            continue
        video.give(n, replace(seen, side=video.side))
        if n in coarse or len(given) < 3 * config.frames:
            video.boxes[n] = box
    if not video.boxes:
        return "the joints given lie outside of the images: are they of another resolution, or in other units?"
    if 0 < right < len(given):
        video.notes.append(f"the joints are of a right hand in {right} of {len(given)} frames, else of a left one.")
    return _depth_trouble(video, config)


def _chosen_path(video: HandVideo, paths: list[BoxPath], side: Side | None) -> tuple[BoxPath, list[BoxPath]]:
    """The path to follow and the others: of the wished side, and the nearest to the object where it is known."""

    def rank(path: BoxPath) -> tuple[float, float]:
        other = sum(b.side != side and b.side_score > 0.7 for b in path.boxes.values()) if side else 0
        worth = path.score * (0.1 if 2 * other > len(path.boxes) else 1.0)
        near = _object_distance(video, path)
        return worth * (1.0 if near < _HOLDING_M else 0.3), worth

    ordered = sorted(paths, key=rank, reverse=True)
    rest = ordered[1:]
    if side is not None:
        rest = [p for p in rest if 2 * sum(b.side != side for b in p.boxes.values()) <= len(p.boxes)]
    return ordered[0], rest


def _rival(first: BoxPath, rest: Sequence[BoxPath]) -> BoxPath | None:
    """Another hand that is there at the same time for long, and about as surely."""
    for path in rest:
        common = set(first.boxes) & set(path.boxes)
        if len(common) < max(1, _TOGETHER * len(first.boxes)):
            continue
        if sum(path.boxes[n].score for n in common) > _SECOND * sum(first.boxes[n].score for n in common):
            return path
    return None


def _both_hold(video: HandVideo, first: BoxPath, rival: BoxPath) -> bool:
    """Whether it cannot be told by the object which of two hands is meant."""
    return (_object_distance(video, first) < _HOLDING_M) == (_object_distance(video, rival) < _HOLDING_M)


def _joined(first: BoxPath, rest: Sequence[BoxPath]) -> dict[int, HandBox]:
    """The boxes of a path, and of others that are of no frame of it: the same hand, lost for a while."""
    boxes = dict(first.boxes)
    for path in rest:
        if not set(path.boxes) & set(boxes):
            boxes.update(path.boxes)
    return dict(sorted(boxes.items()))


def _object_distance(video: HandVideo, path: BoxPath) -> float:
    """Least distance of the middle of a path's boxes to the object's surface, about, metres; inf where not known."""
    least = np.inf
    for n, box in path.boxes.items():
        held, z = video.held(n), box_depth(video.frames[n], box)
        if held is None or not (z > 0).any():
            continue
        middle = _box_middle(video.frames[n].intrinsics, box, float(np.median(z[z > 0])))
        obj, X_CO = held
        radius = 0.5 * float(np.linalg.norm(obj.mesh.extents))
        centre = X_CO[:3, :3] @ obj.mesh.bounds.mean(axis=0) + X_CO[:3, 3]
        least = min(least, float(np.linalg.norm(middle - centre)) - radius)
    return least


def _box_middle(k: Intrinsics, box: HandBox, z: float) -> np.ndarray:
    u, v = (box.u_min + box.u_max) / 2, (box.v_min + box.v_max) / 2
    return np.array([(u - k.cx) / k.fx * z, (v - k.cy) / k.fy * z, z])


def _depth_trouble(video: HandVideo, config: LookConfig) -> str:
    """Why the depth of the hand cannot be used, or ""."""
    depths = [box_depth(video.frames[n], box) for n, box in video.boxes.items()]
    measured = float(np.median([(z > 0).mean() for z in depths]))
    if measured < _LEAST_MEASURED:
        return (
            f"a hand is seen, but only {100 * measured:.0f} % of its pixels have a depth: it is nearer than the camera "
            "can measure, in sunlight, or behind something shiny. Move the camera to 0.4 to 1 m from the hand."
        )
    z = float(np.median([np.median(one[one > 0]) for one in depths if (one > 0).any()]))
    if not config.nearest_m <= z <= config.farthest_m:
        return (
            f"the hand is {z:.2f} m from the camera; expected {config.nearest_m:g} to {config.farthest_m:g} m. Move "
            "the camera, or check the depth scale."
        )
    return ""


def _no_hand(frames: Sequence[Frame], config: LookConfig) -> str:
    measured = float(np.median([(f.depth > 0).mean() for f in frames]))
    near = [(f.depth > config.nearest_m) & (f.depth < config.farthest_m) for f in frames]
    if max(float(m.mean()) for m in near) < 0.01:
        z = float(np.median([np.median(f.depth[f.depth > 0]) for f in frames]))
        return (
            f"no hand was found in {len(frames)} frames: hardly anything lies {config.nearest_m:g} to "
            f"{config.farthest_m:g} m from the camera (the median depth is {z:.2f} m). Move the camera nearer, or "
            "check the depth scale."
        )
    lost = f" Only {100 * measured:.0f} % of the pixels have a depth." if measured < 0.5 else ""
    return (
        f"no hand was found in {len(frames)} frames.{lost} Does the whole hand come into view, 0.4 to 1 m away, and do "
        "the intrinsics belong to these images? Or give joints from elsewhere."
    )
