"""The figures and tables of the pose benchmark, from its trials."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.stats import binomtest

from neuralgrasps.evaluate.pose import PoseErrors, score_by_visibility, score_poses
from neuralgrasps.evaluate.pose_bench import PoseBench
from neuralgrasps.evaluate.pose_bench_methods import METHODS, OURS, MethodTrial
from neuralgrasps.evaluate.pose_bench_trials import ContactTrial, IdentityTrial
from neuralgrasps.evaluate.pose_scenes import CONDITIONS

SURE = 0.9
LOW_VISIBLE = "25-45"
_EDGES = (0.0, 0.5, 0.7, 0.9, 0.97, 1.0)  # of the reliability table; the upper end belongs to a bin
_WORSE_M = 1e-3
_OF_METHOD = (
    "pose_ms", *(f"{c}_adds_auc" for c in CONDITIONS), *(f"{c}_mssd_01d" for c in CONDITIONS),
    "occluded_rot_median_deg", "occluded_trans_median_mm",
)  # fmt: skip
_CALIBRATION = ("calibration_at_90", "calibration_at_90_mssd", "calibration_at_90_count")
_IDENTITY = ("identity_occluded", "identity_hard", "background_refused", "left_out_refused", "identify_ms")
_CONTACT = (
    "contact_right_without", "contact_right_with", "contact_mssd_gain", "contact_made_better", "contact_made_worse",
    "contact_sign_p", "contact_count",
)  # fmt: skip
_TRACKING = ("track_ms", "track_kept", "track_trans_median_mm", "track_rot_median_deg")


def suffix(method: str) -> str:
    """What the figures of a method end with; ours with nothing."""
    return "" if method == OURS else f"_{method}"


def figure_names(subject: str) -> tuple[str, ...]:
    """Figures of a method, or of "identity", "contact term" or "tracking"."""
    others = {"identity": _IDENTITY, "contact term": _CONTACT, "tracking": _TRACKING}
    if subject in others:
        return others[subject]
    ours = ("low_visible_mssd_01d", "table_ms", *_CALIBRATION) if subject == OURS else ()
    return (*(name + suffix(subject) for name in _OF_METHOD), *ours)


def expected_figures() -> tuple[str, ...]:
    """Every figure that a whole benchmark gives."""
    return tuple(
        name for subject in (*METHODS, "identity", "contact term", "tracking") for name in figure_names(subject)
    )


def pose_figures(bench: PoseBench) -> dict[str, float]:
    """Figures by name, units in the names; one that nothing was measured for is left out."""
    figures: dict[str, float] = {}
    for method in METHODS:
        trials = [t for t in bench.methods if t.method == method]
        if trials:
            figures |= {name + suffix(method): value for name, value in _method_figures(trials, bench).items()}
    ours = [t for t in bench.methods if t.method == OURS]
    low = [t for t in ours if t.condition != "easy"]
    if bands := _by_visibility(low, bench):
        figures |= {"low_visible_mssd_01d": bands[LOW_VISIBLE]["mssd_01d"]} if LOW_VISIBLE in bands else {}
    figures |= _calibration(ours, bench)
    if bench.tables:
        figures["table_ms"] = 1e3 * float(np.median([t.cpu_s for t in bench.tables]))
        figures["table_missed"] = float(np.mean([np.isnan(t.angle_rad) for t in bench.tables]))
    figures |= _identity_figures(bench.identity)
    figures |= _contact_figures(bench)
    figures |= _tracking_figures(bench)
    return figures


def _method_figures(trials: Sequence[MethodTrial], bench: PoseBench) -> dict[str, float]:
    figures = {"pose_ms": 1e3 * float(np.median([t.cpu_s for t in trials]))}
    for condition in CONDITIONS:
        if scores := _scores([t for t in trials if t.condition == condition], bench):
            figures[f"{condition}_adds_auc"] = scores["add_s_auc"]
            figures[f"{condition}_mssd_01d"] = scores["mssd_01d"]
            if condition == "occluded":
                figures["occluded_rot_median_deg"] = scores["rotation_median_deg"]
                figures["occluded_trans_median_mm"] = scores["translation_median_mm"]
    return figures


def _scores(trials: Sequence[MethodTrial], bench: PoseBench) -> dict[str, float]:
    if not trials:
        return {}
    return score_poses([t.errors for t in trials], [bench.diameters_m[t.object] for t in trials])


def _by_visibility(trials: Sequence[MethodTrial], bench: PoseBench) -> dict[str, dict[str, float]]:
    if not trials:
        return {}
    return score_by_visibility(
        [t.errors for t in trials], [bench.diameters_m[t.object] for t in trials], [t.visible_share for t in trials]
    )


def is_right(errors: PoseErrors, diameter_m: float) -> bool:
    """What a confidence speaks of: surface within 1 cm on average, no point off by a tenth of the diameter."""
    return errors.add_s_m < 0.01 and errors.mssd_m < 0.1 * diameter_m


def _calibration(trials: Sequence[MethodTrial], bench: PoseBench) -> dict[str, float]:
    sure = [t for t in trials if t.confidence >= SURE]
    figures = {"calibration_at_90_count": float(len(sure))} if trials else {}
    if sure:
        figures["calibration_at_90"] = float(np.mean([t.errors.add_s_m < 0.01 for t in sure]))
        figures["calibration_at_90_mssd"] = float(
            np.mean([t.errors.mssd_m < 0.1 * bench.diameters_m[t.object] for t in sure])
        )
    return figures


def _identity_figures(trials: Sequence[IdentityTrial]) -> dict[str, float]:
    figures: dict[str, float] = {}
    for name, kind in zip(_IDENTITY[:4], ("occluded", "hard", "background", "left out"), strict=True):
        if some := [t for t in trials if t.kind == kind]:
            figures[name] = float(np.mean([t.right for t in some]))
    if trials:
        figures["identify_ms"] = 1e3 * float(np.median([t.cpu_s for t in trials]))
    return figures


def _contact_figures(bench: PoseBench) -> dict[str, float]:
    if not bench.contact:
        return {}
    whole = contact_scores(bench.contact, bench.diameters_m)
    figures = {f"contact_{name}": value for name, value in whole.items()}
    for name, chosen in _CONTACT_PARTS.items():
        if some := [t for t in bench.contact if chosen(t)]:
            figures[f"contact_mssd_gain_{name}"] = contact_scores(some, bench.diameters_m)["mssd_gain"]
    return figures


_CONTACT_PARTS: Mapping[str, Callable[[ContactTrial], bool]] = {
    "seen": lambda t: t.seen_share >= 0.5, "unseen": lambda t: t.seen_share < 0.5,
}  # fmt: skip


def contact_scores(trials: Sequence[ContactTrial], diameters_m: Mapping[str, float]) -> dict[str, float]:
    """What contact does to pairs of estimates of the same view.

    Returns:
        right_without, right_with: share right (`is_right`); mssd_gain: share with MSSD < 0.1 diameters, with minus
        without. made_better, made_worse: share that became right, and wrong. nearer, further_off: share whose MSSD fell
        and grew by more than 1 mm. sign_p, nearer_p: two-sided sign tests of these pairs; 1 when neither occurs.
    """
    diameter = np.array([diameters_m[t.object] for t in trials])
    before, after = (
        np.array([is_right(getattr(t, k), d) for t, d in zip(trials, diameter, strict=True)]) for k in _BOTH
    )
    mssd_before, mssd_after = (np.array([getattr(t, k).mssd_m for t in trials]) for k in _BOTH)
    better, worse = int((after & ~before).sum()), int((before & ~after).sum())
    nearer, further = (int((sign * (mssd_before - mssd_after) > _WORSE_M).sum()) for sign in (1.0, -1.0))
    return {
        "right_without": float(before.mean()),
        "right_with": float(after.mean()),
        "mssd_gain": float((mssd_after < 0.1 * diameter).mean() - (mssd_before < 0.1 * diameter).mean()),
        "made_better": better / len(trials),
        "made_worse": worse / len(trials),
        "sign_p": _sign_test(better, worse),
        "nearer": nearer / len(trials),
        "further_off": further / len(trials),
        "nearer_p": _sign_test(nearer, further),
        "mssd_median_without_mm": 1e3 * float(np.median(mssd_before)),
        "mssd_median_with_mm": 1e3 * float(np.median(mssd_after)),
        "count": float(len(trials)),
    }


_BOTH = ("before", "after")


def _sign_test(more: int, less: int) -> float:
    return float(binomtest(more, more + less).pvalue) if more + less else 1.0


def _tracking_figures(bench: PoseBench) -> dict[str, float]:
    frames = [(t.object, e, s) for t in bench.tracking for e, s in zip(t.errors, t.cpu_s, strict=True)]
    if not frames:
        return {}
    kept = [is_right(e, bench.diameters_m[name]) for name, e, _ in frames]
    ended = [is_right(t.errors[-1], bench.diameters_m[t.object]) for t in bench.tracking]
    return {
        "track_ms": 1e3 * float(np.median([s for *_, s in frames])),
        "track_kept": float(np.mean(kept)),
        "track_kept_to_end": float(np.mean(ended)),
        "track_trans_median_mm": 1e3 * float(np.median([e.translation_m for _, e, _ in frames])),
        "track_rot_median_deg": float(np.rad2deg(np.median([e.rotation_rad for _, e, _ in frames]))),
    }


def pose_table(bench: PoseBench) -> dict[str, Any]:
    """Everything by method and set, by visibility, and by object; identity, contact and tracking in parts."""
    return {
        "methods": [
            _row(some, bench, method=method, set=condition)
            for method, condition, some in _groups(bench.methods)
        ],
        "visibility": [
            {"method": method, "set": condition, "visible": band, **scores}
            for method, condition, some in _groups(bench.methods)
            for band, scores in _by_visibility(some, bench).items()
        ],
        "objects": [
            _row([t for t in some if t.object == name], bench, method=method, set=condition, object=name)
            for method, condition, some in _groups(bench.methods)
            for name in bench.diameters_m
            if any(t.object == name for t in some)
        ],
        "reliability": _reliability([t for t in bench.methods if t.method == OURS], bench),
        "table_plane": _table_plane(bench),
        "identity": _identity_table(bench.identity),
        "contact": _contact_table(bench),
        "tracking": [
            {
                "object": t.object,
                "frames": len(t.errors),
                "kept": float(np.mean([is_right(e, bench.diameters_m[t.object]) for e in t.errors])),
                "mssd_median_mm": 1e3 * float(np.median([e.mssd_m for e in t.errors])),
                "cpu_ms": 1e3 * float(np.median(t.cpu_s)),
            }
            for t in bench.tracking
        ],
    }  # fmt: skip


def _groups(trials: Sequence[MethodTrial]) -> list[tuple[str, str, list[MethodTrial]]]:
    """(method, condition, trials) of all that have some."""
    groups = [(m, c, [t for t in trials if (t.method, t.condition) == (m, c)]) for m in METHODS for c in CONDITIONS]
    return [group for group in groups if group[2]]


def _row(trials: Sequence[MethodTrial], bench: PoseBench, **names: str) -> dict[str, Any]:
    """Scores with the time and how many gave no pose."""
    return {
        **names,
        **_scores(trials, bench),
        "cpu_ms_median": 1e3 * float(np.median([t.cpu_s for t in trials])),
        "cpu_ms_p95": 1e3 * float(np.percentile([t.cpu_s for t in trials], 95)),
        "no_pose": sum(bool(t.reason) for t in trials),
    }


def _reliability(trials: Sequence[MethodTrial], bench: PoseBench) -> list[dict[str, float]]:
    """Of estimates whose confidence lies in a bin: how many are within 1 cm, within 0.1 diameters, and both."""
    rows = []
    for low, high in pairwise(_EDGES):
        some = [t for t in trials if (low < t.confidence or low == 0.0) and t.confidence <= high]
        if not some:
            continue
        diameters = [bench.diameters_m[t.object] for t in some]
        rows.append(
            {
                "above": low, "to": high, "count": float(len(some)),
                "said": float(np.mean([t.confidence for t in some])),
                "within_1cm": float(np.mean([t.errors.add_s_m < 0.01 for t in some])),
                "mssd_01d": float(np.mean([t.errors.mssd_m < 0.1 * d for t, d in zip(some, diameters, strict=True)])),
                "right": float(np.mean([is_right(t.errors, d) for t, d in zip(some, diameters, strict=True)])),
            }
        )  # fmt: skip
    return rows


def _table_plane(bench: PoseBench) -> dict[str, float]:
    found = [t for t in bench.tables if not np.isnan(t.angle_rad)]
    if not found:
        return {"count": float(len(bench.tables)), "found": 0.0}
    return {
        "count": float(len(bench.tables)),
        "found": len(found) / len(bench.tables),
        "angle_median_deg": float(np.rad2deg(np.median([t.angle_rad for t in found]))),
        "angle_p95_deg": float(np.rad2deg(np.percentile([t.angle_rad for t in found], 95))),
        "height_median_mm": 1e3 * float(np.median([t.height_m for t in found])),
        "height_p95_mm": 1e3 * float(np.percentile([t.height_m for t in found], 95)),
    }


def _identity_table(trials: Sequence[IdentityTrial]) -> list[dict[str, Any]]:
    """By kind and object: how many were right, and what the others were taken for."""
    rows = []
    for kind, name in dict.fromkeys((t.kind, t.object) for t in trials):
        some = [t for t in trials if (t.kind, t.object) == (kind, name)]
        wrong = [t.named or "none" for t in some if not t.right]
        rows.append(
            {
                "kind": kind, "object": name, "count": len(some), "right": float(np.mean([t.right for t in some])),
                "taken_for": {other: wrong.count(other) for other in dict.fromkeys(wrong)},
            }
        )  # fmt: skip
    return rows


def _contact_table(bench: PoseBench) -> list[dict[str, Any]]:
    groups = {"all": bench.contact}
    groups |= {part: [t for t in bench.contact if chosen(t)] for part, chosen in _CONTACT_PARTS.items()}
    for key in ("hand", "object"):
        for name in dict.fromkeys(getattr(t, key) for t in bench.contact):
            groups[name] = [t for t in bench.contact if getattr(t, key) == name]
    return [{"part": part, **contact_scores(some, bench.diameters_m)} for part, some in groups.items() if some]
