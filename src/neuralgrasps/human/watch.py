"""A video of a hand that grasps an object, as one grasp: the hand's side and size, the moment, and the hand then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.human.focal import FocalCheck, hand_focal, object_focal, out_of_sizes
from neuralgrasps.human.fuse import fused_fit, seen_share
from neuralgrasps.human.grasp_moment import (
    StillRun,
    Touch,
    first_motion,
    joint_distances,
    still_runs,
    still_threshold,
    touch,
)
from neuralgrasps.human.hand_cloud import CloudConfig
from neuralgrasps.human.hand_fit import fit_hand, fit_size
from neuralgrasps.human.hand_misfit import misfit
from neuralgrasps.human.hand_video import HandVideo, object_poses
from neuralgrasps.human.look import LookConfig, look
from neuralgrasps.human.seen import FittedHand, HandBox, SeenJoints, Side
from neuralgrasps.human.sighting import HandFinder, JointSource, side_vote
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame
from neuralgrasps.perception.table import find_table

_SURE_SIDE = 0.2  # mean vote of the frames, -0.5 to 0.5
_OTHER: dict[Side, Side] = {"right": "left", "left": "right"}
_SIZE_FRAMES = 8
_RUNS = 4  # still phases looked at
_MISFIT_M = 0.009  # median `misfit` of the best frames that speaks against the camera or the joints


@dataclass(frozen=True, slots=True, kw_only=True)
class WatchConfig:
    """Knobs of `watch_hand`.

    Attributes:
        look: which frames are looked at first, and what counts as a hand there.
        still_m: least and largest motion between frames of a still hand, by how noisy the joints are.
        contact_m: so near to the object counts as contact. near_m: farther away is no grasp.
        moved_m: so far from where it was the object has moved.
        fuse: frames fused into one fit, at most.
        scale: the hand's size, where known; None: fitted over the video.
        cloud: which pixels count as the hand's.
    """

    look: LookConfig = field(default_factory=LookConfig)
    still_m: tuple[float, float] = (0.006, 0.015)
    contact_m: float = 0.010
    near_m: float = 0.030
    moved_m: float = 0.010
    fuse: int = 24
    scale: float | None = None
    cloud: CloudConfig = field(default_factory=CloudConfig)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HandTrack:
    """A hand over a video of T frames, and the grasp it makes.

    Attributes:
        frames: (T,) the hand fitted to each frame that was looked at; None elsewhere and where no hand is seen.
        boxes, seen: (T,) its boxes and joints, for pictures; None likewise.
        side, scale: of the hand, one for the video; scale is nan where it was not reached.
        moment: the frame of the grasp; -1 where none was found.
        grasp: the hand there, fitted to all still frames at once, in that frame's camera; None where there is no grasp.
        cloud_C: (M, 3) the merged points it was fitted to, same frame, metres.
        still: the frames that were fused. visible: share of the hand's joints that the moment's frame shows.
        contacts: parts of the hand in contact with the object ("palm", "thumb", ...); empty where it is not known.
        stage: where it failed: "detect", "joints", "size", "grasp"; "" when fine. reason: why and what to do, or "".
        reasons: what speaks against the outcome, in words.
    """

    frames: tuple[FittedHand | None, ...]
    boxes: tuple[HandBox | None, ...]
    seen: tuple[SeenJoints | None, ...]
    side: Side
    scale: float
    moment: int
    grasp: FittedHand | None
    cloud_C: np.ndarray
    still: tuple[int, ...]
    visible: float
    contacts: tuple[str, ...]
    stage: str
    reason: str
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Grasp:
    """A grasp found: the still frames, the one it is described in, the fit and its points."""

    still: tuple[int, ...]
    moment: int
    fitted: FittedHand
    cloud_C: np.ndarray
    touch: Touch | None


def watch_hand(
    frames: Sequence[Frame],
    *,
    detector: HandFinder | None = None,
    reader: JointSource | None = None,
    joints: Sequence[SeenJoints | None] | None = None,
    obj: ObjectModel | None = None,
    X_CO: np.ndarray | Sequence[np.ndarray | None] | None = None,
    side: Side | None = None,
    table: Plane | None = None,
    config: WatchConfig | None = None,
) -> HandTrack:
    """Find the grasp that a hand makes in a video.

    Some frames are looked at first; those of the still phase then all, as one. What cannot be done is said in the
    track's `stage` and `reason`.

    Args:
        frames: T frames of one camera at rest, in order.
        detector, reader: find hands and read joints; needed unless `joints` (T,) are given.
        obj, X_CO: the object and its pose in every camera frame, (T, 4, 4) with nan or None where not known, or one
            (4, 4) for all. Without them a still hand counts as a grasp wherever it is.
        side: of the hand; None: decided here. table: what the object stands on, camera frame; None: looked for.
    Raises:
        InputError: no frames, joints for another number of frames, or neither joints nor a detector and a reader.
    """
    config = config or WatchConfig()
    _check_inputs(frames, detector, reader, joints)
    video = HandVideo(
        frames=frames, reader=reader, obj=obj, X_CO=object_poses(X_CO, len(frames)),
        table=_table(frames, table), cloud_config=config.cloud, scale=config.scale,
    )  # fmt: skip
    reason = look(video, detector, joints, side, config.look)
    if reason:
        return _track(video, "detect", reason)
    _decide_side(video, side)
    coarse = [n for n in sorted(video.boxes) if video.see(n) is not None]
    if not coarse:
        return _track(video, "joints", _unread(video))
    reason = _measure(video, coarse)
    if reason:
        return _track(video, "size", reason)
    return _find_grasp(video, coarse, config)


def _check_inputs(
    frames: Sequence[Frame],
    detector: HandFinder | None,
    reader: JointSource | None,
    joints: Sequence[SeenJoints | None] | None,
) -> None:
    if not frames:
        raise InputError("there are no frames to watch; expected at least one.")
    if joints is None and (detector is None or reader is None):
        raise InputError("nothing finds the hand: give `joints`, or a `detector` and a `reader`.")
    if joints is not None and len(joints) != len(frames):
        raise InputError(
            f"joints are given for {len(joints)} frames, but there are {len(frames)}; give None for a gap."
        )


def _table(frames: Sequence[Frame], table: Plane | None) -> Plane | None:
    if table is not None:
        return table
    try:
        return find_table(frames[0]).plane
    except InputError:  # the hand's points are chosen without one then
        return None


def _decide_side(video: HandVideo, side: Side | None) -> None:
    """By what the frames say; when they are unsure, and for joints from elsewhere, the side whose hand fits better."""
    if side is not None:
        video.side = side
        return
    if video.reader is not None:
        vote = side_vote(list(video.boxes.values()))
        video.side = "right" if vote >= 0 else "left"
        if abs(vote) >= _SURE_SIDE:
            return
    said, other = video.side, _OTHER[video.side]
    numbers = sorted(video.boxes, key=lambda n: (-video.boxes[n].score, n))[:: max(1, len(video.boxes) // 6)][:6]
    apart = {one: _misfit_of_side(video, numbers, one) for one in (said, other)}
    if apart[other] < 0.9 * apart[said]:
        video.side = other
        video.notes.append(f"taken for a {said} hand at first, but a {other} one fits better.")


def _misfit_of_side(video: HandVideo, numbers: Sequence[int], side: Side) -> float:
    """Median misfit over some frames of hands of one side, metres."""
    apart = []
    for n in numbers:
        seen = video.see(n, side=side)
        if seen is not None:
            fitted = fit_hand(seen, video.cloud(n, side=side), side=side, scale=video.scale)
            apart.append(misfit(fitted, video.cloud(n, side=side)) / max(float(np.mean(seen.weight)), 0.05))
    return float(np.median(apart)) if apart else np.inf


def _measure(video: HandVideo, coarse: Sequence[int]) -> str:
    """Decide the hand's size from its best frames; why that cannot be done, or ""."""
    best = _best_frames(video, coarse)
    seen, clouds = [video.see(n) for n in best], [video.cloud(n) for n in best]
    shown = [s for s in seen if s is not None]
    if video.scale is None:
        video.scale = fit_size(shown, clouds, side=video.side, objs=[video.held(n) for n in best])
    apart = float(np.median([misfit(f, video.cloud(n)) for n in best if (f := video.fit(n)) is not None]))
    if not out_of_sizes(video.scale) and apart < _MISFIT_M:
        return ""
    thing = _object_focal(video)
    fits = thing is not None and abs(np.log(thing.factor)) < 0.08  # its size is known: no need to ask the hand
    check = thing if fits or (thing is not None and thing.factor != 1.0) else hand_focal(shown, clouds, side=video.side)
    if check is not None and abs(np.log(check.factor)) > 0.12:
        return _wrong_camera(video, check, thing)
    if out_of_sizes(video.scale):
        video.notes.append(f"the hand's size, {video.scale:.2f} of the model, is at the edge of what people have.")
    if apart >= _MISFIT_M:
        video.notes.append(f"the hand model fits its points and joints only to {1e3 * apart:.0f} mm.")
    return ""


def _best_frames(video: HandVideo, coarse: Sequence[int]) -> list[int]:
    """The frames that show most of the hand, ascending."""

    def worth(n: int) -> float:
        seen = video.see(n)
        return 0.0 if seen is None else float(np.nansum(seen.weight)) * min(len(video.cloud(n)), 300)

    return sorted(sorted(coarse, key=lambda n: (-worth(n), n))[:_SIZE_FRAMES])


def _object_focal(video: HandVideo) -> FocalCheck | None:
    """Of the first frame in which the object's pose is known and no hand is near."""
    known = np.flatnonzero(np.isfinite(video.X_CO).all(axis=(1, 2)))
    if video.obj is None or not len(known):
        return None
    free = [int(n) for n in known if n not in video.boxes]
    number = free[0] if free else int(known[0])
    return object_focal(video.frames[number], video.obj, video.X_CO[number])


def _wrong_camera(video: HandVideo, check: FocalCheck, thing: FocalCheck | None) -> str:
    k = video.frames[0].intrinsics
    what = "the object" if check is thing else "a hand of any person's size"
    return (
        f"the intrinsics do not fit: with fx = {k.fx:.0f} {what} fits to {1e3 * check.residual_m:.1f} mm, with about "
        f"{k.fx * check.factor:.0f} to {1e3 * check.best_m:.1f} mm. Give the focal lengths of the depth images, at "
        "their size (were they of another resolution, or of the colour camera?)."
    )


def _unread(video: HandVideo) -> str:
    return (
        f"a hand was found in {len(video.boxes)} frames, but its joints could not be read in any: too few of its "
        "pixels have a depth. Move the camera to 0.4 to 1 m from the hand, or give joints from elsewhere."
    )


def _find_grasp(video: HandVideo, coarse: Sequence[int], config: WatchConfig) -> HandTrack:
    """Look at the still phases, the longest first, for one in which the hand touches the object."""
    runs, within = _still(video, coarse, config)
    nearest, best = np.inf, None
    for run in sorted(runs[:_RUNS], key=lambda r: r.frames[0]):
        gap = _gap(video, run.middle)
        nearest = min(nearest, gap)
        if gap > config.near_m:
            continue
        grasp = _grasp_of(video, run, within, config)
        if grasp is not None and (best is None or _better(grasp, best, config)):
            best = grasp
    if best is None:
        return _track(video, "grasp", _no_grasp(video, runs, nearest, coarse))
    return _graded(video, best, config)


def _still(video: HandVideo, numbers: Sequence[int], config: WatchConfig) -> tuple[list[StillRun], float]:
    """Still phases among the frames looked at, and how far their joints may be apart."""
    fits = [video.fit(n) for n in numbers]
    points = np.stack([_in_object(video, n, f.joints_C) for n, f in zip(numbers, fits, strict=True) if f is not None])
    weight = np.stack([s.weight for n in numbers if (s := video.see(n)) is not None])
    distance = joint_distances(points, np.maximum(weight, 0.05))
    within = still_threshold(distance, least_m=config.still_m[0], most_m=config.still_m[1])
    least = 1 if len(video.frames) < 3 else min(3, len(numbers))
    return still_runs(distance, numbers, within_m=within, least=least), within


def _in_object(video: HandVideo, number: int, points_C: np.ndarray) -> np.ndarray:
    """Points in the first frame's camera, as if the object had stood still."""
    known = np.flatnonzero(np.isfinite(video.X_CO).all(axis=(1, 2)))
    X = video.to_frame(number, int(known[0]) if len(known) else number)
    return points_C @ X[:3, :3].T + X[:3, 3]


def _gap(video: HandVideo, number: int) -> float:
    """How far the hand is from the object in a frame, metres; 0 where the object is not known there."""
    fitted, held = video.fit(number), video.held(number)
    return 0.0 if fitted is None or held is None else touch(fitted, *held).nearest_m


def _grasp_of(video: HandVideo, run: StillRun, within_m: float, config: WatchConfig) -> _Grasp | None:
    """One fit to all frames of a still phase."""
    numbers = range(run.frames[0], run.frames[-1] + 1)
    moves = None if video.obj is None else first_motion(video.X_CO, numbers, moved_m=config.moved_m)
    if moves is not None and moves - run.frames[0] >= 3:
        numbers = range(run.frames[0], moves)
    chosen = sorted({int(n) for n in np.linspace(numbers[0], numbers[-1], config.fuse).round()})
    reference = video.see(run.middle)
    assert reference is not None
    points = [_in_object(video, n, s.points_C) for n in chosen if (s := video.see(n)) is not None]
    weight = [s.weight for n in chosen if (s := video.see(n)) is not None]
    chosen = [n for n in chosen if video.see(n) is not None]
    distance = joint_distances(np.stack(points), np.maximum(np.stack(weight), 0.05))
    middle = int(np.argmin(np.median(distance, axis=1)))
    still = [n for n, d in zip(chosen, distance[middle], strict=True) if d <= 2.0 * within_m]
    fused = fused_fit(video, still, chosen[middle])
    if fused is None:
        return None
    held = video.held(chosen[middle])
    return _Grasp(
        still=tuple(still), moment=chosen[middle], fitted=fused[0], cloud_C=fused[1],
        touch=None if held is None else touch(fused[0], *held),
    )  # fmt: skip


def _better(new: _Grasp, old: _Grasp, config: WatchConfig) -> bool:
    """A grasp in contact goes before one that is not, and the longer before the shorter."""
    if new.touch is None or old.touch is None:
        return len(new.still) > len(old.still)
    holds = new.touch.holds(config.contact_m), old.touch.holds(config.contact_m)
    return holds[0] if holds[0] != holds[1] else len(new.still) > 1.5 * len(old.still)


def _graded(video: HandVideo, grasp: _Grasp, config: WatchConfig) -> HandTrack:
    """The track with its grasp: how far it can be trusted, and whether it is one."""
    visible = seen_share(video, grasp.moment, grasp.fitted)
    reasons, sure = list(grasp.fitted.reasons), grasp.fitted.confidence
    if len(grasp.still) < 3:
        reasons.append("it is not known whether the hand kept still: there are fewer than three frames of it.")
        sure *= 0.8
    if visible < 0.4:
        reasons.append(f"the frame shows only {100 * visible:.0f} % of the hand's joints.")
        sure *= 0.3 + 1.75 * visible
    if grasp.touch is None:
        video.notes.append("where the object is in this frame is not known, nor whether the hand touches it.")
    elif grasp.touch.nearest_m > config.near_m:
        return _track(video, "grasp", _too_far(grasp.touch.nearest_m, grasp.moment))
    elif not grasp.touch.holds(config.contact_m):
        reasons.append(f"only {', '.join(grasp.touch.touching(config.contact_m)) or 'nothing'} touches the object.")
        sure *= 0.6
    return _track(
        video,
        "",
        "",
        replace(grasp, fitted=replace(grasp.fitted, confidence=sure, reasons=tuple(reasons))),
        visible,
        config.contact_m,
    )


def _no_grasp(video: HandVideo, runs: Sequence[StillRun], nearest_m: float, coarse: Sequence[int]) -> str:
    if not runs:
        return (
            f"the hand never keeps still in the {len(coarse)} frames looked at that show it; expected at least three "
            "in a row. Hold the grasp for half a second, or raise still_m if the joints are noisy."
        )
    return _too_far(nearest_m, min(runs, key=lambda r: _gap(video, r.middle)).middle)


def _too_far(gap_m: float, number: int) -> str:
    return (
        f"the still hand never touches the object: it comes within {1e3 * gap_m:.0f} mm, in frame {number}. Is the "
        "object the right one, its pose right, and the grasp held for half a second?"
    )


def _track(
    video: HandVideo, stage: str, reason: str, grasp: _Grasp | None = None, visible: float = 0.0, contact_m: float = 0.0
) -> HandTrack:
    return HandTrack(
        frames=video.fits_by_frame(),
        boxes=tuple(video.boxes.get(n) for n in range(len(video.frames))),
        seen=video.seen_by_frame(),
        side=video.side,
        scale=float("nan") if video.scale is None else video.scale,
        moment=-1 if grasp is None else grasp.moment,
        grasp=None if grasp is None else grasp.fitted,
        cloud_C=np.zeros((0, 3)) if grasp is None else grasp.cloud_C,
        still=() if grasp is None else grasp.still,
        visible=visible,
        contacts=() if grasp is None or grasp.touch is None else grasp.touch.touching(contact_m),
        stage=stage,
        reason=reason,
        reasons=tuple(video.notes) + (() if grasp is None else grasp.fitted.reasons),
    )
