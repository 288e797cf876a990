"""One synthetic demonstration, from its frames to the object in a robot's hand, and how far each stage was off."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from neuralgrasps.apply.demonstrate import DemonstrateConfig, Demonstration, demonstrate, load_hand_eyes
from neuralgrasps.apply.retrieve import rotated_maps
from neuralgrasps.apply.table_scenes import work_area
from neuralgrasps.apply.transfer_query import query_from_grasp
from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.arms.mount import mount
from neuralgrasps.arms.zoo import load_arm
from neuralgrasps.evaluate.demonstrate_execute import execute_demonstration, executed_place
from neuralgrasps.evaluate.execute import ExecuteConfig
from neuralgrasps.evaluate.hand_surface import posed_surface, surface_rms
from neuralgrasps.evaluate.pose import pose_errors
from neuralgrasps.evaluate.pose_bench_methods import Library, open_library, open_library_run
from neuralgrasps.grasps.contact_map import contact_map
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.variants import scaled_hand
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.human.nets.joint_errors import procrustes_error, root_relative_error
from neuralgrasps.human.skeleton import human_hand
from neuralgrasps.human.synthetic.demonstration import DemonstrationConfig, DemonstrationTruth, record_demonstration
from neuralgrasps.human.video.hand_video import HandVideo
from neuralgrasps.human.video.sighting import HandFinder, JointSource
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame
from neuralgrasps.seeds import child_rng, child_seed

POSE_RIGHT_M = 0.01  # ADD-S below which the object was seen where it is
LEAST_VISIBLE = 0.4  # of the hand, in frames that joints are measured in
_EVERY = 2  # of the frames in which the object is held
_CONFIG = DemonstrateConfig()
_JITTER = 0.35  # of half the work area: how far from its middle the object is put before the robot


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameErrors:
    """One frame in which the object is held and more than `LEAST_VISIBLE` of the hand is seen; metres.

    Attributes:
        found: the detector saw a hand there; the errors are nan otherwise.
        net_root, net_procrustes: of the joint net alone, in the detector's box.
        fit_root, fit_surface: of the hand model fitted to this frame alone, its size measured over the video.
        seconds: of detector, joints, cloud and fit together.
    """

    found: bool
    visible: float
    net_root: float = float("nan")
    net_procrustes: float = float("nan")
    fit_root: float = float("nan")
    fit_surface: float = float("nan")
    seconds: float = float("nan")


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoRecord:
    """What came of one demonstration; lengths in metres, times in seconds.

    Attributes:
        object, index, side, scale, kind: what was recorded. visible: share of the hand that is seen at the grasp.
        stage: where it failed: of `Demonstration`, "plan", "execute", or ""; reason: why.
        side_right, scale_found: of the hand. moment_off: frames between the moment chosen and the still phase.
        object_add_s, object_mssd: errors of the object's pose at the moment.
        grasp_root, grasp_surface: of the fused grasp. map_difference: mean |difference| of its contact map and the true
            one.
        contact_similarity: the same as a similarity, on the scale of the transfer.
        similarity, oracle: of the first transferred grasp, and of the best known one, to the grasp seen.
        similarity_true: of the first transferred grasp to the grasp that was made.
        place: in the order of transfer, of the grasp that was carried out; -1 without a plan.
        lifted: the robot holds the object at the end of its first attempt; lifted_retry: of the second at the latest.
            The object is put before it as it was seen (`demonstrated_scene`), so that a pose seen wrong costs nothing.
        seconds: by stage. frames: errors by frame.
    """

    object: str
    index: int
    side: str
    scale: float
    kind: str
    length: int
    stage: str
    reason: str
    visible: float = float("nan")
    side_right: bool = False
    scale_found: float = float("nan")
    moment_off: int = -1
    object_add_s: float = float("nan")
    object_mssd: float = float("nan")
    grasp_root: float = float("nan")
    grasp_surface: float = float("nan")
    confidence: float = float("nan")
    map_difference: float = float("nan")
    contact_similarity: float = float("nan")
    similarity: float = float("nan")
    oracle: float = float("nan")
    similarity_true: float = float("nan")
    transferred: int = 0
    place: int = -1
    lifted: bool = False
    lifted_retry: bool = False
    cause: str = ""
    seconds: dict[str, float] = field(default_factory=dict)
    frames: tuple[FrameErrors, ...] = ()

    @property
    def lifted_right(self) -> bool:
        """Lifted, and the object was seen where it is at the moment of the grasp: ADD-S below `POSE_RIGHT_M`."""
        return self.lifted and self.object_add_s < POSE_RIGHT_M


@dataclass(frozen=True, slots=True, kw_only=True)
class VideoTask:
    """Demonstration number `index` of the object number `target` of a library; `hand` on `arm` repeats it.

    Attributes:
        share: of the hand that is seen at the grasp, see `DemonstrationConfig`; None: most of it.
    """

    library: Library
    target: int
    index: int
    hand: str
    arm: str
    seed: int
    share: tuple[float, float] | None = None


def measure_video(task: VideoTask) -> VideoRecord:
    """Record a demonstration, watch it, transfer it and carry it out."""
    obj = open_library(task.library)[task.target]
    begun = time.perf_counter()
    kind = "demonstration bench" if task.share is None else "hidden demonstration bench"
    recorded = record_demonstration(
        obj, seed=child_seed(task.seed, kind, obj.name, task.index), config=DemonstrationConfig(share=task.share)
    )
    truth, frames = recorded.truth, [replace(frame, X_WC=None) for frame in recorded.frames]
    seconds = {"record": time.perf_counter() - begun}
    robot, known = _robot(task.hand, task.arm), _known(task.library, task.hand, obj.name)
    detector, reader = _eyes()
    found = demonstrate(
        frames, obj, robot.hand, detector=detector, reader=reader, known=known, config=_CONFIG, seed=task.seed
    )
    seconds |= found.seconds
    record = VideoRecord(
        object=obj.name, index=task.index, side=truth.side, scale=truth.scale, kind=truth.kind, length=len(frames),
        stage=found.stage, reason=found.reason, visible=float(truth.visible[truth.grasp_frame]), seconds=seconds,
    )  # fmt: skip
    record = replace(record, **_seen_errors(found, obj, truth), **_transfer_errors(found, obj, truth))
    record = replace(record, frames=_frame_errors(frames, found, obj, truth))
    if not found.stage:
        record = _carried_out(record, found, obj, robot, task)
    return record


def _seen_errors(found: Demonstration, obj: ObjectModel, truth: DemonstrationTruth) -> dict[str, Any]:
    """Of the object and the hand at the moment chosen."""
    track, followed = found.track, found.followed
    if track is None or followed is None:
        return {}
    out: dict[str, Any] = {"side_right": track.side == truth.side, "scale_found": track.scale}
    if track.grasp is None:
        return out
    n = track.moment
    off = pose_errors(obj, followed.X_CO[n], truth.X_CO[n])
    points_C = posed_surface(truth.side, truth.scale, truth.X_CH[n], truth.q[n])
    return out | {
        "moment_off": max(truth.still[0] - n, n - (truth.still[1] - 1), 0),
        "object_add_s": off.add_s_m,
        "object_mssd": off.mssd_m,
        "grasp_root": float(root_relative_error(track.grasp.joints_C, truth.joints_C[n])),
        "grasp_surface": surface_rms(track.grasp, points_C),
        "confidence": track.grasp.confidence,
    }


def _transfer_errors(found: Demonstration, obj: ObjectModel, truth: DemonstrationTruth) -> dict[str, Any]:
    """Of the contact map, and of what was transferred."""
    if found.query is None or found.transfer is None:
        return {}
    human = scaled_hand(human_hand(truth.side), truth.scale)
    made = query_from_grasp(human, obj, truth.X_OH, truth.q[truth.grasp_frame])
    result = found.transfer
    off = _least_difference(found.query.contact_map, made.contact_map, obj)
    out = {"map_difference": off, "contact_similarity": 1.0 - off / result.scale}
    if not len(result.grasps):
        return out
    best = contact_map(
        obj.points_O, load_hand(found.hand), result.grasps.X_OH[:1], result.grasps.q[:1], radius=made.radius_m
    )
    return out | {
        "transferred": len(result.grasps),
        "similarity": float(result.similarity[0]),
        "oracle": result.oracle,
        "similarity_true": 1.0 - _least_difference(best[0], made.contact_map, obj) / result.scale,
    }


def _least_difference(found: np.ndarray, true: np.ndarray, obj: ObjectModel) -> float:
    """Mean absolute difference of two contact maps (P,), in the best of the object's orientations."""
    turned = rotated_maps(np.asarray(found)[None], obj.points_O, obj.symmetry)[0]
    return float(np.abs(turned - true).mean(axis=1).min())


def _frame_errors(
    frames: Sequence[Frame], found: Demonstration, obj: ObjectModel, truth: DemonstrationTruth
) -> tuple[FrameErrors, ...]:
    """Every other frame in which the object is held, each on its own, whatever came of the video.

    Size and side are those found over the video; where none were, the detector's side, and a size fitted per frame.
    """
    track, followed = found.track, found.followed
    assert followed is not None
    scale = track.scale if track is not None and np.isfinite(track.scale) else None
    detector, reader = _eyes()
    out = []
    for n in range(truth.still[0], len(frames), _EVERY):
        if truth.visible[n] <= LEAST_VISIBLE:
            continue
        begun = time.perf_counter()
        boxes = detector.find(frames[n])
        if not boxes:
            out.append(FrameErrors(found=False, visible=float(truth.visible[n])))
            continue
        video = HandVideo(
            frames=[frames[n]], reader=reader, obj=obj, X_CO=followed.X_CO[n][None], X_WC=np.eye(4)[None],
            table=None if followed.table is None else followed.table.plane, cloud_config=_CONFIG.watch.cloud,
            side=boxes[0].side if track is None else track.side, scale=scale, boxes={0: boxes[0]},
        )  # fmt: skip
        fitted, seen = video.fit(0), video.see(0)
        seconds = time.perf_counter() - begun
        if fitted is None or seen is None:
            out.append(FrameErrors(found=False, visible=float(truth.visible[n]), seconds=seconds))
            continue
        true = truth.joints_C[n]
        points_C = posed_surface(truth.side, truth.scale, truth.X_CH[n], truth.q[n])
        out.append(
            FrameErrors(
                found=True,
                visible=float(truth.visible[n]),
                net_root=float(root_relative_error(seen.points_C, true)),
                net_procrustes=float(procrustes_error(seen.points_C, true)),
                fit_root=float(root_relative_error(fitted.joints_C, true)),
                fit_surface=surface_rms(fitted, points_C),
                seconds=seconds,
            )
        )
    return tuple(out)


def _carried_out(
    record: VideoRecord, found: Demonstration, obj: ObjectModel, robot: Manipulator, task: VideoTask
) -> VideoRecord:
    """The robot's attempt, the object at a random place of its work area."""
    begun = time.perf_counter()
    area, rng = work_area(robot.arm), child_rng(task.seed, "demonstration place", obj.name, task.index)
    half = np.array([(area.far_m - area.near_m) / 2, area.side_m])
    x, y = np.array([area.near_m + half[0], 0.0]) + _JITTER * half * rng.uniform(-1.0, 1.0, 2)
    trial = execute_demonstration(
        found, obj, robot, config=ExecuteConfig(retries=1), at=(float(x), float(y)),
        seed=child_seed(task.seed, "demonstration trial", obj.name, task.index),
    )  # fmt: skip
    place = executed_place(trial, found)
    return replace(
        record, stage="" if trial.success_retry else ("plan" if trial.cause == "no plan" else "execute"),
        reason=trial.detail, place=-1 if place is None else place, lifted=trial.success,
        lifted_retry=trial.success_retry, cause=trial.cause,
        seconds={**record.seconds, "execute": time.perf_counter() - begun},
    )  # fmt: skip


@lru_cache(maxsize=2)
def _robot(hand: str, arm: str) -> Manipulator:
    return mount(load_arm(arm), load_hand(hand))


@lru_cache(maxsize=1)
def _eyes() -> tuple[HandFinder, JointSource]:
    import torch  # noqa: PLC0415 - only where the nets run

    torch.set_num_threads(1)
    return load_hand_eyes()


def _known(library: Library, hand: str, obj: str) -> GraspSet | None:
    """The stored grasps of the library's run; None where it has none."""
    if library.run is None:
        return None
    return open_library_run(library).grasps.get((hand, obj))
