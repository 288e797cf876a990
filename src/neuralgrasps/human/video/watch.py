"""A video of a hand that grasps an object, as one grasp: the hand's side and size, the moment, and the hand then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.human.fit.hand_cloud import CloudConfig
from neuralgrasps.human.seen import FittedHand, HandBox, SeenJoints, Side
from neuralgrasps.human.video.fuse import seen_share
from neuralgrasps.human.video.hand_video import HandVideo, object_poses
from neuralgrasps.human.video.look import LookConfig, followed_frames, look
from neuralgrasps.human.video.side_and_size import decide_side, doubt_of_size, measure_hand
from neuralgrasps.human.video.sighting import HandFinder, JointSource
from neuralgrasps.human.video.still_grasp import GraspLimits, StillGrasp, find_still_grasp
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame, camera_poses
from neuralgrasps.perception.table import find_table

_HIDDEN = 0.35  # share of the joints that a frame shows from which on little is hidden
_UNTOUCHED = 0.6  # of the confidence is left when the hand is not seen to hold the object


@dataclass(frozen=True, slots=True, kw_only=True)
class WatchConfig:
    """Knobs of `watch_hand`.

    Attributes:
        look: which frames are looked at first, and what counts as a hand there.
        grasp: what counts as a grasp.
        scale: the hand's size, where known; None: fitted over the video.
        cloud: which pixels count as the hand's.
    """

    look: LookConfig = field(default_factory=LookConfig)
    grasp: GraspLimits = field(default_factory=GraspLimits)
    scale: float | None = None
    cloud: CloudConfig = field(default_factory=CloudConfig)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HandTrack:
    """A hand over a video of T frames, and the grasp it makes.

    Attributes:
        frames: (T,) the hand fitted to each frame that was looked at; None elsewhere and where no hand is seen.
        boxes, seen: (T,) its boxes and joints, for pictures; None likewise.
        looked: the frames that were looked at, ascending; nobody knows whether a hand is in others.
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
    looked: tuple[int, ...]
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

    def __repr__(self) -> str:
        if self.grasp is None:
            return f"HandTrack(failed at {self.stage}: {self.reason})"
        seen = f"{self.side} hand x{self.scale:.2f}: grasp in frame {self.moment} of {len(self.frames)}"
        return f"HandTrack({seen}, {100 * self.grasp.confidence:.0f} % sure)"

    @property
    def found(self) -> tuple[int, ...]:
        """The frames in which a hand was found, ascending."""
        return tuple(
            n
            for n, (box, seen) in enumerate(zip(self.boxes, self.seen, strict=True))
            if box is not None or seen is not None
        )


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
        frames: T frames of one camera, in order; at rest, or all with a camera pose.
        detector, reader: find hands and read joints; needed unless `joints` (T,) are given.
        obj, X_CO: the object and its pose in every camera frame, (T, 4, 4) with nan or None where not known, or one
            (4, 4) for all. The grasp is in a frame where it is known. Without obj or X_CO a still hand counts as a
            grasp wherever it is, less surely.
        side: of the hand; None: decided here. table: what the object stands on, the first frame's
            camera, normal up; None: looked for.
    Raises:
        InputError: no frames, joints for another number of frames, neither joints nor a detector and a reader, or a
            camera that moves and frames without its pose.
    """
    config = config or WatchConfig()
    _check_inputs(frames, detector, reader, joints)
    video = HandVideo(
        frames=frames, reader=reader, obj=None if X_CO is None else obj, X_CO=object_poses(X_CO, len(frames)),
        X_WC=camera_poses(frames), table=_table(frames, table), cloud_config=config.cloud, scale=config.scale,
    )  # fmt: skip
    reason = look(video, detector, joints, side, config.look)
    if reason:
        return _track(video, "detect", reason)
    decide_side(video, side)
    coarse = followed_frames(video, config.look)
    if not coarse:
        return _track(video, "joints", _unread(video))
    reason = measure_hand(video, coarse)
    if reason:
        return _track(video, "size", reason)
    found = find_still_grasp(video, coarse, config.grasp)
    doubt = doubt_of_size(video) if config.scale is None else ""
    if isinstance(found, str):
        return _track(video, "grasp", f"{found} Or {doubt}" if doubt else found)
    if doubt:
        video.notes.append(doubt)
    return _graded(video, found, config.grasp)


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


def _unread(video: HandVideo) -> str:
    return (
        f"a hand was found in {len(video.boxes)} frames, but its joints could not be read in any: too few of its "
        "pixels have a depth. Move the camera to 0.4 to 1 m from the hand, or give joints from elsewhere."
    )


def _graded(video: HandVideo, grasp: StillGrasp, limits: GraspLimits) -> HandTrack:
    """The track with its grasp, and how far that can be trusted."""
    visible = seen_share(video, grasp.moment, grasp.fitted)
    reasons, sure = list(grasp.fitted.reasons), grasp.fitted.confidence
    if len(grasp.still) < 3:
        reasons.append("it is not known whether the hand kept still: there are fewer than three frames of it.")
        sure *= 0.8
    if visible < _HIDDEN:
        reasons.append(f"the frame shows only {100 * visible:.0f} % of the hand's joints.")
        sure *= 0.3 + 0.7 * visible / _HIDDEN
    if grasp.touch is None:
        reasons.append("where the object is was not given: it is not known whether the hand touches it.")
        sure *= _UNTOUCHED
    elif not grasp.touch.holds(limits.contact_m):
        reasons.append(f"only {', '.join(grasp.touch.touching(limits.contact_m)) or 'nothing'} touches the object.")
        sure *= _UNTOUCHED
    fitted = replace(grasp.fitted, confidence=sure, reasons=tuple(reasons))
    contacts = () if grasp.touch is None else grasp.touch.touching(limits.contact_m)
    return replace(
        _track(video, "", ""), moment=grasp.moment, grasp=fitted, cloud_C=grasp.cloud_C, still=grasp.still,
        visible=visible, contacts=contacts, reasons=(*video.notes, *reasons),
    )  # fmt: skip


def _track(video: HandVideo, stage: str, reason: str) -> HandTrack:
    """The track without a grasp."""
    return HandTrack(
        frames=video.fits_by_frame(),
        boxes=tuple(video.boxes.get(n) for n in range(len(video.frames))),
        seen=video.seen_by_frame(),
        looked=video.looked_frames(),
        side=video.side,
        scale=float("nan") if video.scale is None else video.scale,
        moment=-1,
        grasp=None,
        cloud_C=np.zeros((0, 3)),
        still=(),
        visible=0.0,
        contacts=(),
        stage=stage,
        reason=reason,
        reasons=tuple(video.notes),
    )
