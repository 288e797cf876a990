"""Figures and tables of the benchmark of demonstrations."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from neuralgrasps.evaluate.demonstrate_bench import DemonstrateBench
from neuralgrasps.evaluate.demonstrate_trials import POSE_RIGHT_M, FrameErrors, VideoRecord
from neuralgrasps.evaluate.shares import wilson_interval

FIGURES = (
    "joints_root_relative_mm", "joints_procrustes_mm", "joints_found", "fitted_root_relative_mm", "fitted_surface_mm",
    "fit_rms_mm", "fps", "video_fps", "grasp_root_relative_mm", "grasp_surface_mm", "grasps_found", "side_right",
    "moment_right", "object_pose_right", "contact_similarity", "contact_map_difference",
    "demonstrate_similarity_minus_oracle", "demonstrate_success", "demonstrate_success_right",
    "demonstrate_success_retry",
)  # fmt: skip
HIDDEN = "hidden_"
"""Before the names of the figures of badly seen demonstrations."""
_FITS = ("fit_rms_mm",)  # of no video
_VISIBLE = (0.4, 0.6, 0.8, 1.01)
_SHARES = {"40_60": (0.4, 0.6), "60_80": (0.6, 0.8)}  # of the hand, by which the figures of badly seen ones are parted
_BY_SHARE = (
    "joints_root_relative_mm", "joints_procrustes_mm", "joints_found", "fitted_root_relative_mm", "fitted_surface_mm",
)  # fmt: skip
_SUCCESS = ("demonstrate_success", "demonstrate_success_right")


def figure_names(*, hidden: bool) -> tuple[str, ...]:
    """Names of the headline numbers, perhaps those of badly seen demonstrations too."""
    badly = [HIDDEN + name for name in FIGURES if name not in _FITS]
    badly += [f"{HIDDEN}{name}_{part}" for part in _SHARES for name in (*_BY_SHARE, *_SUCCESS)]
    return (*FIGURES, *badly) if hidden else FIGURES


def demonstrate_figures(bench: DemonstrateBench) -> dict[str, float]:
    """The headline numbers; what could not be measured is left out."""
    out = {**_figures(bench.videos), **bench.fit}
    out |= {HIDDEN + name: value for name, value in _figures(bench.hidden).items()}
    frames = [f for video in bench.hidden for f in video.frames]
    for part, (low, high) in _SHARES.items():
        parted = _frame_figures([f for f in frames if low < f.visible <= high])
        out |= {f"{HIDDEN}{name}_{part}": parted[name] for name in _BY_SHARE}
        ended = _figures([v for v in bench.hidden if low < v.visible <= high])
        out |= {f"{HIDDEN}{name}_{part}": ended[name] for name in _SUCCESS}
    return {name: value for name, value in out.items() if np.isfinite(value)}


def _frame_figures(frames: Sequence[FrameErrors]) -> dict[str, float]:
    """Of frames, each on its own."""
    seen = [f for f in frames if f.found]
    return {
        "joints_root_relative_mm": _mm(f.net_root for f in seen),
        "joints_procrustes_mm": _mm(f.net_procrustes for f in seen),
        "joints_root_relative_median_mm": _mm((f.net_root for f in seen), np.median),
        "joints_found": _share(f.found for f in frames),
        "fitted_root_relative_mm": _mm(f.fit_root for f in seen),
        "fitted_surface_mm": _mm(f.fit_surface for f in seen),
        "fitted_surface_median_mm": _mm((f.fit_surface for f in seen), np.median),
        "fps": 1.0 / float(np.mean([f.seconds for f in seen])) if seen else float("nan"),
    }


def _figures(videos: Sequence[VideoRecord]) -> dict[str, float]:
    """Of videos, nan where nothing was measured."""
    grasped = [v for v in videos if np.isfinite(v.grasp_root)]
    return {
        **_frame_figures([f for video in videos for f in video.frames]),
        "grasp_root_relative_mm": _mm(v.grasp_root for v in grasped),
        "grasp_surface_mm": _mm(v.grasp_surface for v in grasped),
        "grasps_found": _share(np.isfinite(v.grasp_root) for v in videos),
        "side_right": _share(v.side_right for v in videos),
        "moment_right": _share(v.moment_off == 0 for v in videos),
        "object_pose_right": _share(v.object_add_s < POSE_RIGHT_M for v in videos),
        "contact_map_difference": _mean(v.map_difference for v in videos),
        "contact_similarity": _mean(v.contact_similarity for v in videos),
        "video_fps": _video_fps(videos),
        "demonstrate_similarity_minus_oracle": _mean(v.similarity - v.oracle for v in videos),
        "demonstrate_success": _share(v.lifted for v in videos),
        "demonstrate_success_right": _share(v.lifted_right for v in videos),
        "demonstrate_success_retry": _share(v.lifted_retry for v in videos),
    }


def demonstrate_tables(bench: DemonstrateBench) -> dict[str, list[dict[str, Any]]]:
    """By object, by visible share of the hand, by stage of failure, and seconds by stage; of badly seen ones too."""
    badly = _tables(bench.hidden) if bench.hidden else {}
    return {**_tables(bench.videos), **{HIDDEN + name: rows for name, rows in badly.items()}}


def _tables(videos: Sequence[VideoRecord]) -> dict[str, list[dict[str, Any]]]:
    names = list(dict.fromkeys(v.object for v in videos))
    objects = [_object_row(name, [v for v in videos if v.object == name]) for name in names]
    if len(names) > 1:
        objects.append(_object_row("all", videos))
    visible = [_visible_row(low, high, videos) for low, high in pairwise(_VISIBLE)]
    ends = Counter((v.stage or "none", v.reason if v.stage else "") for v in videos)
    stages = [
        {"stage": stage, "reason": reason, "count": count} for (stage, reason), count in sorted(ends.items(), key=str)
    ]
    kinds = list(dict.fromkeys(k for v in videos for k in v.seconds))
    seconds = [{"stage": k, "median_s": _median(v.seconds.get(k) for v in videos)} for k in kinds]
    return {"objects": objects, "visible": visible, "stages": stages, "seconds": seconds}


def _object_row(name: str, videos: Sequence[VideoRecord]) -> dict[str, Any]:
    seen = [f for v in videos for f in v.frames if f.found]
    lifted = sum(v.lifted for v in videos)
    low, high = wilson_interval(lifted, len(videos))
    return {
        "object": name,
        "videos": len(videos),
        "frames": len(seen),
        "net_root_mm": _mm(f.net_root for f in seen),
        "net_procrustes_mm": _mm(f.net_procrustes for f in seen),
        "fit_root_mm": _mm(f.fit_root for f in seen),
        "fit_surface_mm": _mm(f.fit_surface for f in seen),
        "grasp_root_mm": _mm(v.grasp_root for v in videos),
        "grasp_surface_mm": _mm(v.grasp_surface for v in videos),
        "similarity": _mean(v.similarity for v in videos),
        "oracle": _mean(v.oracle for v in videos),
        "similarity_true": _mean(v.similarity_true for v in videos),
        "lifted": lifted / len(videos),
        "low": low,
        "high": high,
        "lifted_right": _share(v.lifted_right for v in videos),
        "with_retry": _share(v.lifted_retry for v in videos),
    }


def _visible_row(low: float, high: float, videos: Sequence[VideoRecord]) -> dict[str, Any]:
    """Frames by what each shows, and videos by what the grasp's frame shows."""
    frames = [f for v in videos for f in v.frames if low < f.visible <= high]
    seen, grasped = [f for f in frames if f.found], [v for v in videos if low < v.visible <= high]
    return {
        "visible": f"{low:.1f}-{min(high, 1.0):.1f}",
        "frames": len(frames),
        "found": _share(f.found for f in frames),
        "net_root_mm": _mm(f.net_root for f in seen),
        "net_procrustes_mm": _mm(f.net_procrustes for f in seen),
        "fit_root_mm": _mm(f.fit_root for f in seen),
        "fit_surface_mm": _mm(f.fit_surface for f in seen),
        "videos": len(grasped),
        "grasp_root_mm": _mm(v.grasp_root for v in grasped),
        "grasp_surface_mm": _mm(v.grasp_surface for v in grasped),
        "lifted": _share(v.lifted for v in grasped),
        "lifted_right": _share(v.lifted_right for v in grasped),
    }


def _video_fps(videos: Sequence[VideoRecord]) -> float:
    """Frames of all videos over the time that finding the object and watching the hand took."""
    watched = [v for v in videos if "hand" in v.seconds]
    spent = sum(v.seconds["object"] + v.seconds["hand"] for v in watched)
    return sum(v.length for v in watched) / spent if spent else float("nan")


def _finite(values: Iterable[float | None]) -> np.ndarray:
    array = np.array([np.nan if v is None else float(v) for v in values])
    return array[np.isfinite(array)]


def _mean(values: Iterable[float]) -> float:
    known = _finite(values)
    return float(known.mean()) if len(known) else float("nan")


def _median(values: Iterable[float | None]) -> float:
    known = _finite(values)
    return float(np.median(known)) if len(known) else float("nan")


def _mm(values: Iterable[float], of: Any = np.mean) -> float:
    known = _finite(values)
    return 1e3 * float(of(known)) if len(known) else float("nan")


def _share(values: Iterable[Any]) -> float:
    known = [bool(v) for v in values]
    return float(np.mean(known)) if known else float("nan")
