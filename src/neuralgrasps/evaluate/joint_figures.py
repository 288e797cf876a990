"""Figures and tables of the benchmark of the joint net."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from neuralgrasps.evaluate.joint_bench import STAND_IN_SET, JointBench
from neuralgrasps.evaluate.joint_scenes import JointErrors
from neuralgrasps.human.nets.joint_score import VISIBLE

FIGURES = (
    "scene_joints_root_relative_mm", "scene_joints_procrustes_mm", "scene_joints_absolute_mm", "scene_joints_mask_iou",
    "scene_joints_n", "scene_joints_one_look_root_relative_mm", "scene_joints_one_look_procrustes_mm",
    "scene_joints_ms_per_look", "scene_joints_ms_per_reading",
)  # fmt: skip
_SHARES = (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)


def joint_figures(bench: JointBench) -> dict[str, float]:
    """Means over hands seen to more than VISIBLE: of all sets of solids never seen, then of every set by its name."""
    unseen = [e for name, errors in bench.scenes.items() if name != STAND_IN_SET for e in errors]
    out = {f"scene_joints_{key}": value for key, value in _means(_clear(unseen)).items()}
    every = [e for errors in bench.scenes.values() for e in errors if e.found]
    out["scene_joints_ms_per_look"] = _median_ms([e.look_s for e in every])
    out["scene_joints_ms_per_reading"] = _median_ms([e.read_s for e in every])
    for name, errors in bench.scenes.items():
        found = _means(_clear(errors))
        short = name.replace("-", "_")
        out |= {f"scene_joints_{short}_{key}": found[key] for key in ("root_relative_mm", "procrustes_mm", "n")}
    return {name: value for name, value in out.items() if np.isfinite(value)}


def joint_tables(bench: JointBench) -> dict[str, list[dict[str, Any]]]:
    """By set of solids, hands seen to more than VISIBLE; by the share of the hand that is seen, all sets."""
    sets = [
        {"set": name, "solids": bench.solids[name], "grasps": bench.grasps[name], **_means(_clear(errors))}
        for name, errors in bench.scenes.items()
    ]
    every = [e for errors in bench.scenes.values() for e in errors if e.found]
    seen = [
        {"seen": f"{low:.1f}-{high:.1f}", **_means([e for e in every if low < min(e.visible, 1.0) <= high])}
        for low, high in pairwise(_SHARES)
    ]
    return {"sets": sets, "seen": [row for row in seen if row["n"]]}


def _clear(errors: Sequence[JointErrors]) -> list[JointErrors]:
    return [e for e in errors if e.found and e.visible > VISIBLE]


def _means(errors: Sequence[JointErrors]) -> dict[str, float]:
    columns = {
        "root_relative_mm": 1e3 * _column(errors, "root"),
        "procrustes_mm": 1e3 * _column(errors, "procrustes"),
        "absolute_mm": 1e3 * _column(errors, "absolute"),
        "mask_iou": _column(errors, "iou"),
        "one_look_root_relative_mm": 1e3 * _column(errors, "first_root"),
        "one_look_procrustes_mm": 1e3 * _column(errors, "first_procrustes"),
    }
    means = {name: float(values.mean()) if len(values) else float("nan") for name, values in columns.items()}
    return {"n": float(len(errors)), **means}


def _column(errors: Sequence[JointErrors], name: str) -> np.ndarray:
    return np.array([getattr(e, name) for e in errors], dtype=np.float64)


def _median_ms(seconds: Sequence[float]) -> float:
    return 1e3 * float(np.median(seconds)) if seconds else float("nan")
