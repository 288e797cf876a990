"""From RGB-D frames of a person who grasps an object to a robot hand's grasps of it, best first.

Stages: the object is found before the hand hides it, and followed; the hand is found, its joints are read, and the hand
model is fitted to them and to the depth; at the moment of the grasp it is a grasp in the object's frame like any other,
and is transferred. Each stage can be replaced; each says why it failed.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from scipy import ndimage

from neuralgrasps.apply.demonstrate_checks import camera_trouble, check_given, depth_trouble
from neuralgrasps.apply.demonstrate_rules import TableRules, table_support, transfer_under
from neuralgrasps.apply.transfer import Constraint, TransferConfig, TransferResult
from neuralgrasps.apply.transfer_query import TransferQuery, query_from_grasp
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.se3_numpy import inverse_np
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.human.seen import FittedHand, HandBox, SeenJoints, Side
from neuralgrasps.human.skeleton import JOINT_NAMES, WRIST
from neuralgrasps.human.video.sighting import HandFinder, JointSource, joints_box
from neuralgrasps.human.video.watch import HandTrack, WatchConfig, watch_hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame, camera_poses
from neuralgrasps.perception.object_video import FollowedObject, Hidden, follow_object
from neuralgrasps.planning.resting_plane import nearest_resting_plane
from neuralgrasps.synthesis.support import Support

_GLANCES, _GLANCE_EVERY = 24, 5  # frames looked at for a hand before the object is; no farther apart in long videos
_KNUCKLE = JOINT_NAMES.index("middle_mcp")
_MASK_RIM = 4  # pixels round a hand's mask that are its, too
_ARM_M = (0.02, 0.5, 0.05)  # where a forearm is: so far into the hand, so far behind the wrist, so wide there
_ARM_SPREAD = 0.5  # wider by so much per metre, for a wrist that bends
_BOX_ROOM = 0.25  # of a hand's box is left out around it too


@dataclass(frozen=True, slots=True, kw_only=True)
class DemonstrateConfig:
    """How a demonstration is read.

    Attributes:
        watch: how the hand is watched. transfer: how grasps are transferred.
        on_table: grasps must clear the table that the object stands on.
        least_confidence: of the fitted hand; with less nothing is transferred.
    """

    watch: WatchConfig = field(default_factory=WatchConfig)
    transfer: TransferConfig = field(default_factory=lambda: TransferConfig(count=40, trials=60, apart_m=0.015))
    on_table: bool = True
    least_confidence: float = 0.2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Demonstration:
    """What came of a demonstration.

    Attributes:
        object, hand: names. seed: as run.
        stage: the stage that failed: "object", "detect", "joints", "size", "grasp" (see `HandTrack`) or "transfer"; ""
            when none did. reason: why, in words.
        followed: the object over the frames. track: the hand over the frames; None when it was not looked for.
        human: the person's hand: model, of its size and side. X_OH (4, 4), q (20,): its grasp. None before that.
        table_O: the table in the object's frame, normal up.
        query: the grasp as asked for; transfer: the robot's grasps.
        seconds: wall time of each stage.
    """

    object: str
    hand: str
    seed: int
    stage: str
    reason: str
    followed: FollowedObject | None = None
    track: HandTrack | None = None
    human: Hand | None = None
    X_OH: np.ndarray | None = None
    q: np.ndarray | None = None
    table_O: Plane | None = None
    query: TransferQuery | None = None
    transfer: TransferResult | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        if self.stage:
            return f"Demonstration(failed at {self.stage}: {self.reason})"
        seen = "no hand" if self.track is None else f"{self.track.side} hand x{self.track.scale:.2f}"
        found = self.transfer
        count = 0 if found is None else len(found.grasps)
        best = f", similarity {found.similarity[0]:.2f}" if found is not None and count else ""
        return f"Demonstration({seen} on {self.object}: {count} grasps by {self.hand}{best})"

    @property
    def grasps(self) -> GraspSet | None:
        """The robot's grasps, best first."""
        return None if self.transfer is None else self.transfer.grasps


class _Clock:
    """Wall time by stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def __call__(self, stage: str) -> None:
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._last
        self._last = now


def demonstrate(
    frames: Sequence[Frame],
    obj: ObjectModel,
    hand: Hand,
    *,
    detector: HandFinder | None = None,
    reader: JointSource | None = None,
    joints: Sequence[SeenJoints | None] | None = None,
    side: Side | None = None,
    known: GraspSet | None = None,
    constraints: Constraint | TableRules | None = None,
    config: DemonstrateConfig | None = None,
    seed: int = 0,
) -> Demonstration:
    """Watch a person grasp an object, and find grasps of `hand` that touch it alike.

    Args:
        frames: of one camera at rest, or with camera poses; in order of time. One frame will do.
        hand: the robot's.
        detector, reader: of hands and joints; None: those that come with the library.
        side: of the person's hand; None: decided from the frames.
        joints: (T,) joints from elsewhere in place of detector and reader; None in frames without.
        known: proven grasps of `obj` by `hand`; None: made on the spot, and kept.
        constraints: what further rules grasps out, see `transfer`; or a function that makes it from the table in the
            object's frame (normal up; None: none was found), for what depends on how the object stands.
        seed: of all searches.
    Raises:
        InputError: no frames, or some without the pose of a camera that moves. What cannot be seen is no error: the
            result says at which stage it failed, and why.
    """
    config = config or DemonstrateConfig()
    check_given(frames, obj, hand)
    _check(frames, joints)
    if joints is None and detector is None:
        detector, reader = load_hand_eyes(reader)
    eyes, clock = _Eyes(detector=detector, reader=reader, joints=joints, side=side), _Clock()
    begun = Demonstration(object=obj.name, hand=hand.name, seed=seed, stage="", reason="", seconds=clock.seconds)
    shown = _watched(begun, frames, obj, eyes, config.watch, clock)
    if shown.stage:
        return shown
    return _carried_over(shown, obj, hand, known, constraints, config, clock)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Eyes:
    """What sees the hand; see `demonstrate`."""

    detector: HandFinder | None
    reader: JointSource | None
    joints: Sequence[SeenJoints | None] | None
    side: Side | None


def _check(frames: Sequence[Frame], joints: Sequence[SeenJoints | None] | None) -> None:
    if not frames:
        raise InputError("there are no frames to watch; expected at least one.")
    if joints is not None and len(joints) != len(frames):
        raise InputError(
            f"joints are given for {len(joints)} frames, but there are {len(frames)}; give None for a gap."
        )
    camera_poses(frames)  # refused at once when the camera moves and some frames do not say where


def _watched(
    so_far: Demonstration, frames: Sequence[Frame], obj: ObjectModel, eyes: _Eyes, watch: WatchConfig, clock: _Clock
) -> Demonstration:
    """The object and the hand over the frames."""
    hidden = _hidden(frames, eyes.detector, eyes.reader, eyes.joints)
    followed = follow_object(frames, obj, hidden=hidden, seed=so_far.seed)
    camera = camera_trouble(frames, obj, followed, hidden, seed=so_far.seed)
    clock("object")
    so_far = replace(so_far, followed=followed, table_O=followed.table_O)
    if camera or followed.reason:
        return replace(so_far, stage="object", reason=camera or followed.reason + depth_trouble(frames))
    track = watch_hand(
        frames, detector=eyes.detector, reader=eyes.reader, joints=eyes.joints, side=eyes.side, obj=obj,
        X_CO=followed.X_CO, table=_first_table(frames, followed), config=watch,
    )  # fmt: skip
    clock("hand")
    if followed.note:
        track = replace(track, reasons=(*track.reasons, followed.note))
    return replace(so_far, track=track, stage=track.stage, reason=track.reason)


def _carried_over(
    so_far: Demonstration, obj: ObjectModel, hand: Hand, known: GraspSet | None,
    constraints: Constraint | TableRules | None, config: DemonstrateConfig, clock: _Clock,
) -> Demonstration:  # fmt: skip
    """The grasp that was seen as grasps of the robot's hand."""
    track, followed = so_far.track, so_far.followed
    assert track is not None and track.grasp is not None and followed is not None
    if track.grasp.confidence < config.least_confidence:
        return replace(so_far, stage="grasp", reason=_doubtful(track.grasp))
    human, X_OH = grasp_in_object(track.grasp, followed.X_CO[track.moment])
    query = query_from_grasp(human, obj, X_OH, track.grasp.q)
    so_far = replace(so_far, human=human, X_OH=X_OH, q=track.grasp.q, query=query)
    try:
        rules = constraints(so_far.table_O) if callable(constraints) else constraints
    except InputError as error:  # no hand can meet them on an object that stands like this
        return replace(so_far, stage="transfer", reason=str(error))
    found = transfer_under(
        query, hand, obj, known=known, config=config.transfer, constraints=rules, seed=so_far.seed,
        support=demonstration_support(obj, so_far.table_O) if config.on_table else None,
    )  # fmt: skip
    clock("transfer")
    so_far = replace(so_far, transfer=found)
    return so_far if len(found.grasps) else replace(so_far, stage="transfer", reason=found.reason)


def _doubtful(fitted: FittedHand) -> str:
    why = "".join(f" {reason[:1].upper()}{reason[1:].rstrip('.')}." for reason in fitted.reasons)
    return f"what was taken for the hand is one with a confidence of {fitted.confidence:.2f} only.{why}"


def _first_table(frames: Sequence[Frame], followed: FollowedObject) -> Plane | None:
    """The table in the first frame's camera."""
    if followed.table is None:
        return None
    X_WC = camera_poses(frames)
    return followed.table.plane.moved(inverse_np(X_WC[0]) @ X_WC[followed.found_in])


def load_hand_eyes(reader: JointSource | None = None) -> tuple[HandFinder, JointSource]:
    """The detector and the joint net that come with the library; `reader` in place of the latter."""
    from neuralgrasps.human.nets.detect import HandDetector  # noqa: PLC0415 - imports torch
    from neuralgrasps.human.nets.joint_reader import JointReader  # noqa: PLC0415

    return HandDetector.load(), reader or JointReader.load()


def grasp_in_object(fitted: FittedHand, X_CO: np.ndarray) -> tuple[Hand, np.ndarray]:
    """The person's hand model, and X_OH (4, 4) of its base."""
    return fitted.hand, np.asarray(inverse_np(X_CO) @ fitted.X_CH)


def _hidden(
    frames: Sequence[Frame],
    detector: HandFinder | None,
    reader: JointSource | None,
    joints: Sequence[SeenJoints | None] | None,
) -> Hidden:
    """Pixels that may show the person, by frame: hand and forearm there, or in the nearest frame looked at."""
    last = len(frames) - 1
    count = max(_GLANCES, 1 + -(-last // _GLANCE_EVERY))
    numbers = sorted({int(n) for n in np.linspace(0, last, count).round()})
    boxes: dict[int, list[HandBox]] = {}
    for n in numbers:
        if joints is not None:
            box = None if joints[n] is None else joints_box(joints[n], frames[n].intrinsics)  # type: ignore[arg-type]
            boxes[n] = [] if box is None else [box]
        elif detector is not None:
            boxes[n] = list(detector.find(frames[n]))

    @cache
    def person(near: int) -> np.ndarray:
        mask = np.zeros(frames[near].depth.shape, bool)
        for box in boxes[near]:
            seen = joints[near] if joints is not None else reader.read(frames[near], box) if reader else None
            mask |= box_mask([box], mask.shape) if seen is None else person_mask(frames[near], box, seen)
        return mask

    def hidden(frame: int) -> np.ndarray | None:
        near = min(numbers, key=lambda n: (abs(n - frame), n))
        return person(near) if boxes[near] else None

    return hidden


def person_mask(frame: Frame, box: HandBox, seen: SeenJoints) -> np.ndarray:
    """(h, w) bool: the hand's pixels with some around them, and what lies along the forearm; the box without a mask."""
    wrist, knuckle = seen.points_C[WRIST], seen.points_C[_KNUCKLE]
    if seen.mask is None or not np.isfinite([wrist, knuckle]).all():
        return box_mask([box], frame.depth.shape)
    back = (wrist - knuckle) / max(float(np.linalg.norm(wrist - knuckle)), 1e-9)
    off = frame.points - wrist
    along = off @ back
    across = np.linalg.norm(off - along[..., None] * back, axis=-1)
    forearm = (along > -_ARM_M[0]) & (along < _ARM_M[1]) & (across < _ARM_M[2] + _ARM_SPREAD * np.maximum(along, 0.0))
    return np.asarray(ndimage.binary_dilation(seen.mask, iterations=_MASK_RIM) | forearm)


def box_mask(boxes: Sequence[HandBox], shape: tuple[int, ...]) -> np.ndarray:
    """(h, w) bool: boxes of hands, with a quarter of their size around."""
    mask = np.zeros(shape, bool)
    for box in boxes:
        du, dv = _BOX_ROOM * (box.u_max - box.u_min), _BOX_ROOM * (box.v_max - box.v_min)
        rows = slice(max(int(box.v_min - dv), 0), max(int(np.ceil(box.v_max + dv)), 0))
        mask[rows, max(int(box.u_min - du), 0) : max(int(np.ceil(box.u_max + du)), 0)] = True
    return mask


def demonstration_support(obj: ObjectModel, table_O: Plane | None) -> Support | None:
    """The table that grasps must clear: of the nearest resting pose where there is one, else as it was seen."""
    if table_O is None:
        return None
    return table_support(nearest_resting_plane(obj, table_O) or table_O)
