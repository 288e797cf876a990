"""The still phases of a hand in a video, and the one in which it grasps, as one fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuralgrasps.human.seen import FittedHand
from neuralgrasps.human.video.fuse import fused_fit
from neuralgrasps.human.video.grasp_moment import (
    Touch,
    first_motion,
    joint_distances,
    still_runs,
    still_threshold,
    touch,
)
from neuralgrasps.human.video.hand_video import HandVideo

_RUNS = 4  # still phases looked at


@dataclass(frozen=True, slots=True, kw_only=True)
class GraspLimits:
    """What counts as a grasp.

    Attributes:
        still_m: least and largest motion between frames of a still hand, by how noisy its fits are.
        contact_m: so near to the object counts as contact. near_m: a hand farther away grasps nothing.
        moved_m: so far from where it was the object has moved.
        fuse: frames fused into one fit, at most.
    """

    still_m: tuple[float, float] = (0.006, 0.015)
    contact_m: float = 0.010
    near_m: float = 0.030
    moved_m: float = 0.010
    fuse: int = 24


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StillGrasp:
    """A grasp found in a video.

    Attributes:
        still: the frames that are fused. moment: the one of them whose camera frame is used.
        fitted: the hand. cloud_C: (M, 3) its points. touch: how near it is to the object, None where that is not known.
    """

    still: tuple[int, ...]
    moment: int
    fitted: FittedHand
    cloud_C: np.ndarray
    touch: Touch | None


def find_still_grasp(video: HandVideo, coarse: Sequence[int], limits: GraspLimits) -> StillGrasp | str:
    """The still phase among the coarse frames in which the hand touches the object, looked at in full; or why none.

    Where the video has an object, frames in which its pose is not known say nothing of a grasp, and are left out.
    """
    distance = _distances(video, coarse)
    within = still_threshold(distance, least_m=limits.still_m[0], most_m=limits.still_m[1])
    least = 1 if len(video.frames) < 3 else min(3, len(coarse))
    runs = still_runs(distance, coarse, within_m=within, least=least)
    if not runs:
        return (
            f"the hand never keeps still in the {len(coarse)} frames looked at that show it; expected at least {least} "
            "in a row. Hold the grasp for half a second, or raise still_m if the joints are noisy."
        )
    known = {run: [n for n in run.frames if _is_placed(video, n)] for run in runs}
    gaps, best = [], None
    for run in sorted([run for run in runs if known[run]][:_RUNS], key=lambda r: r.frames[0]):
        middle = min(known[run], key=lambda n: (abs(n - run.middle), n))
        gaps.append((_gap(video, middle), middle))
        if gaps[-1][0] > limits.near_m:
            continue
        grasp = _looked_at(video, known[run], within, limits)
        if best is None or _better(grasp, best, limits):
            best = grasp
    if best is not None and (best.touch is None or best.touch.nearest_m <= limits.near_m):
        return best
    if best is not None and best.touch is not None:
        gaps.append((best.touch.nearest_m, best.moment))
    return _untouched(video, gaps, [run.frames[0] for run in runs if not known[run]])


def _untouched(video: HandVideo, gaps: Sequence[tuple[float, int]], lost: Sequence[int]) -> str:
    """Why there is no grasp: how near the still hand came in which frames, and where the object was lost."""
    if lost:
        known = f" Where it is known the still hand comes within {1e3 * min(gaps)[0]:.0f} mm of it." if gaps else ""
        return _lost(video, min(lost)) + known
    gap, number = min(gaps)
    return (
        f"the still hand never touches the object: it comes within {1e3 * gap:.0f} mm, in frame {number}. Is the "
        "object the right one, its pose right, and the grasp held for half a second?"
    )


def _is_placed(video: HandVideo, number: int) -> bool:
    """Whether a frame can show a grasp: the object's pose is known there, or there is no object to know of."""
    return video.obj is None or video.held(number) is not None


def _lost(video: HandVideo, still_from: int) -> str:
    """Why there is no grasp where the object's pose is not known in any frame in which the hand keeps still."""
    known = [n for n in range(len(video.frames)) if _is_placed(video, n)]
    before = [n for n in known if n < still_from]
    if before:
        when = f"the object was lost from frame {before[-1] + 1}, before the hand held still in frame {still_from}"
    elif known:
        when = f"the object is found only from frame {known[0]} on, after the hand held still in frame {still_from}"
    else:
        when = "the object's pose is not known in any frame"
    return (
        f"{when}; what the hand grasps there cannot be said. Hold the object where it stood for half a second before "
        "it is moved, and leave a part of it in view."
    )


def _distances(video: HandVideo, numbers: Sequence[int]) -> np.ndarray:
    """(n, n) how far the hand moved between frames that show it, relative to the object."""
    points, weight = [], []
    for n in numbers:
        fitted, seen, X = video.fit(n), video.see(n), video.to_frame(n, numbers[0])
        assert fitted is not None and seen is not None
        points.append(fitted.joints_C @ X[:3, :3].T + X[:3, 3])
        weight.append(np.maximum(np.nan_to_num(seen.weight), 0.05))
    return joint_distances(np.stack(points), np.stack(weight))


def _gap(video: HandVideo, number: int) -> float:
    """How far the hand is from the object in a frame, metres; 0 where there is no object to know of."""
    fitted, held = video.fit(number), video.held(number)
    return 0.0 if fitted is None or held is None else touch(fitted, *held).nearest_m


def _looked_at(video: HandVideo, coarse: Sequence[int], within_m: float, limits: GraspLimits) -> StillGrasp:
    """All frames of a still phase, of which some are given, up to where the object moves or is lost, as one fit."""
    first, last = coarse[0], coarse[-1]
    moves = first_motion(video.object_in_world(), range(first, last + 1), moved_m=limits.moved_m)
    if moves is not None and moves - first >= 3:
        last = moves - 1
    wanted = sorted({int(n) for n in np.linspace(first, last, limits.fuse).round()})
    shown = [n for n in wanted if video.see(n) is not None and _is_placed(video, n)]
    distance = _distances(video, shown)
    typical = np.median(distance, axis=1)
    inner = np.arange(len(shown) // 4, len(shown) - len(shown) // 4)  # its ends may belong to the motion
    middle = int(inner[np.argmin(typical[inner])])
    close = distance[middle] <= max(within_m, 1.5 * float(typical[middle]))
    still = [n for n, is_close in zip(shown, close, strict=True) if is_close]
    moment = shown[middle]
    fitted, cloud_C = fused_fit(video, still, moment)
    held = video.held(moment)
    return StillGrasp(
        still=tuple(still), moment=moment, fitted=fitted, cloud_C=cloud_C,
        touch=None if held is None else touch(fitted, *held),
    )  # fmt: skip


def _better(new: StillGrasp, old: StillGrasp, limits: GraspLimits) -> bool:
    """A grasp in contact goes before one that is not, and a much longer one before a shorter."""
    longer = len(new.still) > 1.5 * len(old.still)
    if new.touch is None or old.touch is None:
        return longer
    holds = new.touch.holds(limits.contact_m), old.touch.holds(limits.contact_m)
    return holds[0] if holds[0] != holds[1] else longer
