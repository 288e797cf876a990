"""What the demo works on, what its stages hand on, and its figures."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from neuralgrasps.dataset.collect import PairRecord
from neuralgrasps.dataset.read import GraspDataset
from neuralgrasps.demo.demonstration import ShownByHand
from neuralgrasps.demo.execution import Lift
from neuralgrasps.demo.latent import LatentMeasures
from neuralgrasps.demo.measure import GraspMeasures, PoseTrial
from neuralgrasps.demo.meter import Stage
from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.published import PUBLISHED_RETRIEVAL, plain_name
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.zoo import hand_names
from neuralgrasps.model.train import TrainResult
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.parallel import available_cpus


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoConfig:
    """What `run_demo` works on.

    Attributes:
        objects: names of built-in or imported objects, paths of mesh files, or folders of mesh files.
        hands: names or paths; the five built-in hands by default.
        count: validated grasps per hand and object.
        seed: root of every random number.
        workers: processes; all processors when None. No result depends on it.
        out: folder for the page, the grasps, the data set and the fitted field.
        pose_views: depth views per object.
        demonstration: a person's grasp is shown to a robot, too.
        command: what was typed, for the page.
    """

    objects: tuple[str, ...] = ("cracker_box", "tomato_soup_can", "mustard_bottle")
    hands: tuple[str, ...] = field(default_factory=hand_names)
    count: int = 24
    seed: int = 0
    workers: int | None = None
    out: Path = Path("out")
    pose_views: int = 10
    demonstration: bool = True
    command: str = "neuralgrasps demo"

    def __post_init__(self) -> None:
        if self.count < 6:
            raise InputError(
                f"count is {self.count}; expected at least 6 grasps per pair, to train on some and test on one."
            )
        if self.workers is not None and self.workers < 1:
            raise InputError(f"workers is {self.workers}; expected at least 1.")


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoResult:
    """Everything the demo made and measured.

    Attributes:
        report_path: the page. figures: the numbers of `neuralgrasps bench demo`. summary: lines for the terminal.
    """

    report_path: Path
    figures: Mapping[str, float]
    summary: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoData:
    """What the stages hand to the page."""

    config: DemoConfig
    hands: Mapping[str, Hand]
    objects: Mapping[str, ObjectModel]
    grasp_sets: Sequence[GraspSet]
    records: Sequence[PairRecord]
    grasps: GraspMeasures
    dataset: GraspDataset
    trained: TrainResult
    latent: LatentMeasures
    poses: Sequence[PoseTrial]
    lifts: Sequence[Lift] = ()
    shown: ShownByHand | None = None

    @property
    def lifted(self) -> int:
        """Objects that the arm lifted at the first attempt."""
        return sum(bool(lift.record["success"]) for lift in self.lifts)

    @property
    def are_scans(self) -> bool:
        """Whether the objects are meshes from files, which the published figures may be set beside."""
        return not any(obj.provenance.get("source", "").startswith("stand-in") for obj in self.objects.values())

    @property
    def published_gap(self) -> float | None:
        """Mean published Near GT - Near Z over these objects, when all of them are scans of the paper's."""
        names = [plain_name(name) for name in self.objects]
        if not self.are_scans or not set(names) <= set(PUBLISHED_RETRIEVAL):
            return None
        return float(np.mean([PUBLISHED_RETRIEVAL[n][1] - PUBLISHED_RETRIEVAL[n][0] for n in names]))

    def set_of(self, hand: str, object_name: str) -> GraspSet:
        """The grasps of a pair."""
        return next(g for g in self.grasp_sets if g.hand == hand and g.object == object_name)


def demo_figures(data: DemoData, stages: Sequence[Stage]) -> dict[str, float]:
    """The measured numbers, units in the keys."""
    errors = [trial.errors for trial in data.poses]
    return {
        "demo_wall_s": sum(s.wall_s for s in stages),
        "demo_cpu_s": sum(s.cpu_s for s in stages),
        "peak_rss_gb": max(s.peak_rss_bytes for s in stages) / 1e9,
        "grasps_min_per_pair": float(min(r.validated for r in data.records)),
        "grasps_total": float(sum(len(g) for g in data.grasp_sets)),
        "physics_success_before_filter": sum(r.validated for r in data.records) / sum(r.tried for r in data.records),
        "penetration_p95_mm": float(np.percentile(data.grasps.coarse_m, 95) * 1e3),
        "penetration_2mm_p95_mm": float(np.percentile(data.grasps.fine_m, 95) * 1e3),
        "penetration_2mm_max_mm": float(data.grasps.fine_m.max() * 1e3),
        "retrieval_gap": data.latent.gap("one_view"),
        "retrieval_gap_complete": data.latent.gap("complete"),
        "retrieval_gap_encoded": data.latent.gap("known"),
        "hand_surface_mean_mm": data.latent.mean_error_m("known") * 1e3,
        "hand_surface_complete_mean_mm": data.latent.mean_error_m("complete") * 1e3,
        "hand_surface_one_view_mean_mm": data.latent.mean_error_m("one_view") * 1e3,
        "pose_add_s_median_mm": float(np.median([e.add_s_m for e in errors]) * 1e3),
        "pose_rotation_median_deg": float(np.rad2deg(np.median([e.rotation_rad for e in errors]))),
        "pose_wall_median_s": float(np.median([t.wall_s for t in data.poses])),
        "lift_trials": float(len(data.lifts)),
        "lifted": float(data.lifted),
        **_shown_figures(data.shown),
    }


def _shown_figures(shown: ShownByHand | None) -> dict[str, float]:
    """What was measured of the demonstration."""
    measured = {} if shown is None else {"similarity": shown.similarity, "lifted": shown.lifted}
    return {f"demonstration_{name}": float(value) for name, value in measured.items() if value is not None}


def _shown_line(shown: ShownByHand) -> str:
    if not shown.object:
        return f"no demonstration was recorded: {shown.reason}"
    begin = f"a person's grasp of {shown.object} in a depth video, simulated"
    if shown.stage:
        return f"{begin}: stopped at {shown.stage.lower()}: {shown.reason}"
    end = "" if shown.lifted is None else ", and lifts it"
    return f"{begin}: {shown.hand} touches it alike (contact similarity {shown.similarity:.2f}){end}"


def summary_lines(data: DemoData, figures: Mapping[str, float]) -> tuple[str, ...]:
    """A few lines for the terminal."""
    short = [r for r in data.records if r.reason]
    lines = [
        f"{figures['grasps_total']:.0f} grasps of {len(data.hands)} hands on {len(data.objects)} objects, "
        f"at least {figures['grasps_min_per_pair']:.0f} per pair, each held in physics",
        f"overlap of hand and object, 95th percentile: {figures['penetration_2mm_p95_mm']:.2f} mm "
        "(points every 2 mm on both, true mesh)",
        f"retrieval of held-out grasps seen in one depth view: {figures['retrieval_gap']:.4f} below the best possible",
        f"object pose from one depth view, nothing in front: surface {figures['pose_add_s_median_mm']:.2f} mm (ADD-S), "
        f"rotation {figures['pose_rotation_median_deg']:.2f} degrees off (medians of {len(data.poses)})",
        *(
            [
                f"{data.lifts[0].robot} arm in simulation, camera to lift, one trial each: "
                f"{data.lifted} of {len(data.lifts)} objects lifted"
            ]
            if data.lifts
            else []
        ),
        *([_shown_line(data.shown)] if data.shown is not None else []),
        f"{figures['demo_wall_s']:.0f} s on {data.config.workers or available_cpus()} processes, "
        f"{figures['peak_rss_gb']:.1f} GB, on {platform.machine()}",
    ]
    return (*lines, *(f"{r.hand} on {r.object}: {r.validated} of {r.wanted} grasps: {r.reason}" for r in short))
