"""Find the hand in a video: the first pass over some of its frames, and why there is none to follow."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from neuralgrasps.human.seen import HandBox, SeenJoints, Side
from neuralgrasps.human.video.hand_video import HandVideo
from neuralgrasps.human.video.sighting import BoxPath, HandFinder, box_depth, joints_box, linked_paths, side_vote
from neuralgrasps.perception.frame import Frame

_LEAST_MEASURED = 0.2  # share of the pixels in the middle of the hand's boxes that must have a depth
_TOGETHER = 0.3  # share of a hand's frames that show another one too, from which there are two
_SECOND = 0.4  # score of a second hand over the first one's
_AS_CLEAR = 0.6  # weight of the joints over the usual one, from which on a hand that was not detected is there
_LEAP_M = 0.08
_HOLDING_M = 0.15  # a box's middle this near to the object's surface may hold it
_JUMP_M, _SPEED_M, _FARTHEST_JUMP_M = 0.15, 0.05, 0.6  # a lost hand comes back so near, plus so much per frame; at most
_RESIZED = 3.0  # boxes of a hand differ by less in size
_SURE_VOTE = 0.2  # of the side, see `side_vote`
_RESTING, _RESTING_M = 3, 0.03  # a hand whose boxes in so many frames looked at stay within this keeps still
_USUAL_M = 0.6  # distance of a hand where it is not measured


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
        video.scanned.update(range(len(joints)))
        return _take_joints(video, joints, side, config)
    assert detector is not None
    found = {n: detector.find(video.frames[n]) for n in coarse_frames(len(video.frames), config)}
    video.scanned.update(found)
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
    video.boxes.update(_joined(video, first, rest))
    return _other_in_turn(video, rest) or _depth_trouble(video, config)


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
        near = _object_distance(video, path.boxes)
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
    one, two = (_object_distance(video, path.boxes) < _HOLDING_M for path in (first, rival))
    return one == two


def _joined(video: HandVideo, first: BoxPath, rest: Sequence[BoxPath]) -> dict[int, HandBox]:
    """The boxes of a path, and of others at other times that may be the same hand, lost for a while."""
    boxes = dict(first.boxes)
    for path in rest:
        if not set(path.boxes) & set(boxes) and _same_hand(video, boxes, path.boxes):
            boxes.update(path.boxes)
    return dict(sorted(boxes.items()))


def _same_hand(video: HandVideo, one: dict[int, HandBox], two: dict[int, HandBox]) -> bool:
    """Whether boxes of different frames can be one hand: by side where that is sure, by size, and by place and time."""
    votes = side_vote(list(one.values())), side_vote(list(two.values()))
    if min(votes) < -_SURE_VOTE and max(votes) > _SURE_VOTE:
        return False
    sizes = [np.median([_size(video, n, box) for n, box in boxes.items()]) for boxes in (one, two)]
    if max(sizes) > _RESIZED * min(sizes):
        return False
    numbers = sorted({*one, *two})
    for n, m in itertools.pairwise(numbers):
        if (n in one) == (m in one):
            continue
        a, b = (_place_in_world(video, k, one.get(k) or two[k]) for k in (n, m))
        if np.linalg.norm(a - b) > min(_JUMP_M + _SPEED_M * (m - n), _FARTHEST_JUMP_M):
            return False
    return True


def _other_in_turn(video: HandVideo, rest: Sequence[BoxPath]) -> str:
    """Why the hand that was chosen may not be the grasping one: another is seen before it or after it; or ""."""
    for path in rest:
        if len(path.boxes) < 2 or set(path.boxes) & set(video.boxes):
            continue
        frames = f"frames {min(path.boxes)} to {max(path.boxes)}"
        if _rests_at_object(video, video.boxes) and _rests_at_object(video, path.boxes):
            return (
                f"two hands are seen one after the other, the other one in {frames}, and both keep still at the "
                "object: show one hand, leave out the frames of the other, or say which `side`."
            )
        video.notes.append(f"another hand is seen in {frames}; the one that is nearer to the object, or seen more "
                           "clearly, was followed.")  # fmt: skip
    return ""


def _rests_at_object(video: HandVideo, boxes: dict[int, HandBox]) -> bool:
    """Whether a hand keeps still near the object for some of its frames."""
    numbers = sorted(boxes)
    places = np.array([_place_in_world(video, n, boxes[n]) for n in numbers])
    for k in range(len(numbers) - _RESTING + 1):
        few = slice(k, k + _RESTING)
        still = np.linalg.norm(places[few] - places[few].mean(axis=0), axis=1).max() < _RESTING_M
        if still and _object_distance(video, {n: boxes[n] for n in numbers[few]}) < _HOLDING_M:
            return True
    return False


def _object_distance(video: HandVideo, boxes: dict[int, HandBox]) -> float:
    """Least distance of the middle of boxes to the object's surface, about, metres; inf where not known."""
    least = np.inf
    for n, box in boxes.items():
        held = video.held(n)
        if held is None or not (box_depth(video.frames[n], box) > 0).any():
            continue
        obj, X_CO = held
        radius = 0.5 * float(np.linalg.norm(obj.mesh.extents))
        centre = X_CO[:3, :3] @ obj.mesh.bounds.mean(axis=0) + X_CO[:3, 3]
        least = min(least, float(np.linalg.norm(_place(video, n, box) - centre)) - radius)
    return least


def _place(video: HandVideo, number: int, box: HandBox) -> np.ndarray:
    """(3,) the middle of a box in its camera, metres; at a usual distance where no depth was measured."""
    k, z = video.frames[number].intrinsics, _distance(video, number, box)
    u, v = (box.u_min + box.u_max) / 2, (box.v_min + box.v_max) / 2
    return np.array([(u - k.cx) / k.fx * z, (v - k.cy) / k.fy * z, z])


def _place_in_world(video: HandVideo, number: int, box: HandBox) -> np.ndarray:
    X = video.X_WC[number]
    return np.asarray(X[:3, :3] @ _place(video, number, box) + X[:3, 3])


def _size(video: HandVideo, number: int, box: HandBox) -> float:
    """The mean side of a box, about, metres."""
    k = video.frames[number].intrinsics
    area = (box.u_max - box.u_min) / k.fx * (box.v_max - box.v_min) / k.fy
    return _distance(video, number, box) * float(np.sqrt(max(area, 1e-9)))


def _distance(video: HandVideo, number: int, box: HandBox) -> float:
    z = box_depth(video.frames[number], box)
    return float(np.median(z[z > 0])) if (z > 0).any() else _USUAL_M


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
