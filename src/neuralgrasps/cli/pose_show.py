"""Found poses as JSON records, as text for people, and as figures of the page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from neuralgrasps.cli.pose_hints import table_distance_m
from neuralgrasps.cli.terminal import Terminal, counted

if TYPE_CHECKING:
    from neuralgrasps.cli.pose_find import Finding, Placed
    from neuralgrasps.objects.object_model import ObjectModel
    from neuralgrasps.report.content import FrameFigure

_LEAST_PROBABILITY = 0.01  # less likely poses are in the JSON object only, as are those as good as the same:
_SAME_DEG, _SAME_MM = 5.0, 5.0
_SPREAD = "(spread of the fit and an assumed sensor error)"
_OF_WHAT = "(of the chance that one of these is right)"
_BALL = 100  # so many rotations about no single axis are those of a ball, which has no orientation


def pose_record(placed: Placed) -> dict[str, Any]:
    """A pose as JSON: matrix in metres, quaternion w x y z, uncertainty, and the other poses that fit."""
    obj, pose = placed.obj, placed.pose
    position_sigma_mm, rotation_sigma_deg = sigmas(obj, pose.X_CO, pose.covariance)
    return {
        "object": obj.name,
        "converged": placed.is_found,
        "confidence": placed.confidence,
        "pose_confidence": pose.confidence,
        "identity_probability": placed.identity,
        "X_CO_m": pose.X_CO,
        "position_m": pose.X_CO[:3, 3],
        "quaternion_wxyz": quaternion_of(pose.X_CO),
        "residual_median_mm": pose.residual_m * 1e3,
        "explained_share": pose.explained,
        "score": pose.score,
        "position_sigma_mm": position_sigma_mm,
        "rotation_sigma_deg": rotation_sigma_deg,
        "covariance_m_rad": pose.covariance,
        "alternatives": _alternatives(placed),
        "points": placed.points,
        "symmetry_rotations": len(obj.symmetry.rotations),
    }


def frame_record(finding: Finding) -> dict[str, Any]:
    """What was found in one frame, as JSON."""
    record: dict[str, Any] = {
        "frame": finding.name,
        "objects": [pose_record(p) for p in finding.found],
        "rejected": [pose_record(p) for p in finding.rejected],
        "not_found": list(finding.missing),
        "wall_s": finding.wall_s,
    }
    if finding.units_per_metre is not None:
        record["depth_units_per_metre"] = finding.units_per_metre
    if finding.unexplained is not None:
        record["unexplained_clusters"] = finding.unexplained
    if finding.table is not None and finding.frame is not None:
        fit = finding.table
        record["table"] = {
            "distance_m": table_distance_m(finding.frame, fit),
            "normal_C": fit.plane.normal,
            "offset_m": fit.plane.offset_m,
            "inlier_share": fit.inlier_share,
            "rms_mm": fit.rms_m * 1e3,
        }
    if finding.identity:
        record["identity_probability"] = dict(finding.identity)
    if finding.problem:
        record["problem"] = finding.problem
    return record


def quaternion_of(X_CO: np.ndarray) -> np.ndarray:
    """(4,) w x y z of a pose."""
    import torch

    from neuralgrasps.geometry.rotation import quaternion_from_matrix

    return quaternion_from_matrix(torch.as_tensor(np.array(X_CO[:3, :3]))).numpy()


def sigmas(obj: ObjectModel, X_CO: np.ndarray, covariance: np.ndarray) -> tuple[float, float | None]:
    """One standard deviation of position, mm, and of rotation, degrees, in their least certain directions.

    Turns about an axis of continuous symmetry do not count; None for a ball, which has no orientation.

    Args:
        covariance: (6, 6) of the twist [v, w] about the object's centre, camera axes, metres and radians.
    """
    position = math.sqrt(max(float(np.linalg.eigvalsh(covariance[:3, :3])[-1]), 0.0))
    axis = obj.symmetry.continuous_axis
    if axis is None and len(obj.symmetry) > _BALL:
        return 1e3 * position, None
    turns = covariance[3:, 3:]
    if axis is not None:
        across = np.eye(3) - np.outer(X_CO[:3, :3] @ axis, X_CO[:3, :3] @ axis)
        turns = across @ turns @ across
    rotation = math.sqrt(max(float(np.linalg.eigvalsh(turns)[-1]), 0.0))
    return 1e3 * position, min(math.degrees(rotation), 180.0)


def _alternatives(placed: Placed) -> list[dict[str, Any]]:
    """The other poses that fit, and how far they are from the best one, up to symmetry."""
    from neuralgrasps.evaluate.pose import pose_errors

    pose = placed.pose
    out = []
    for X_CO, probability in zip(pose.alternatives_X_CO[1:], pose.alternatives_probability[1:], strict=True):
        apart = pose_errors(placed.obj, X_CO, pose.X_CO)
        out.append(
            {
                "X_CO_m": X_CO,
                "probability": float(probability),
                "rotation_deg": math.degrees(apart.rotation_rad),
                "translation_mm": 1e3 * apart.translation_m,
            }
        )
    return out


def others_text(alternatives: Sequence[dict[str, Any]]) -> str:
    """The other poses in words, "12 % turned 180°, moved 3 mm; 4 % ..."; empty when there are none."""
    likely = [
        a
        for a in alternatives
        if a["probability"] >= _LEAST_PROBABILITY and (a["rotation_deg"] > _SAME_DEG or a["translation_mm"] > _SAME_MM)
    ]
    if not likely:
        return ""
    shown = "; ".join(
        f"{a['probability']:.0%} turned {a['rotation_deg']:.0f}°, moved {a['translation_mm']:.0f} mm"
        for a in likely[:3]
    ).replace("%", " %")
    more = f"; {len(likely) - 3} more" if len(likely) > 3 else ""
    return shown + more


def show_finding(terminal: Terminal, finding: Finding, record: dict[str, Any], *, title: str, alone: bool) -> None:
    """Print what was found; `alone`: one pose was asked for, so its matrix is printed too."""
    if title:
        terminal.say(title)
    if finding.problem:
        terminal.say(f"  nothing could be looked for: {finding.problem}")
    for placed in (*record["objects"], *record["rejected"]):
        _show_pose(terminal, placed, alone)
    likely = [(name, p) for name, p in sorted(finding.identity.items(), key=lambda item: -item[1]) if p >= 0.01]
    if likely:
        terminal.say("which one: " + ", ".join(f"{name} {_percent(p)}" for name, p in likely))
    if finding.missing and not alone:
        terminal.say("not found: " + ", ".join(finding.missing))
    if finding.unexplained:
        terminal.say(unexplained_text(finding.unexplained))
    if view := _view_text(record):
        terminal.say(view)
    for note in finding.notes:
        terminal.say(f"note: {note}")
    if not finding.problem:
        terminal.say(f"time: {finding.wall_s:.2f} s")


def unexplained_text(count: int) -> str:
    """How many clusters remain, as a sentence."""
    return f"{counted(count, 'cluster')} on the table that no accepted object explains."


def _view_text(record: dict[str, Any]) -> str:
    """Table and scale of a frame, "table: 0.92 m away, 1.4 mm rough; depth scale: 1000 units per metre"."""
    parts = []
    if "table" in record:
        parts.append(f"table: {record['table']['distance_m']:.2f} m away, {record['table']['rms_mm']:.1f} mm rough")
    if "depth_units_per_metre" in record:
        parts.append(f"depth scale: {record['depth_units_per_metre']:g} units per metre")
    return "; ".join(parts)


def _show_pose(terminal: Terminal, record: dict[str, Any], alone: bool) -> None:
    sure = _percent(record["confidence"])
    terminal.say(
        f"{record['object']}: found, {sure} sure"
        if record["converged"]
        else f"{record['object']}: NOT found: the best pose is {sure} sure"
    )
    position, quaternion = (", ".join(f"{v:+.4f}" for v in record[k]) for k in ("position_m", "quaternion_wxyz"))
    turn = record["rotation_sigma_deg"]
    others = others_text(record["alternatives"])
    terminal.facts(
        [
            ("position", f"{position} m, ± {record['position_sigma_mm']:.1f} mm {_SPREAD}"),
            ("quaternion", f"{quaternion} (w x y z)" + ("" if turn is None else f", ± {turn:.1f}°")),
            (
                "fit",
                f"{counted(record['points'], 'point')}, median {record['residual_median_mm']:.2f} mm off the model, "
                f"{_percent(record['explained_share'])} explained",
            ),
            ("other poses", f"{others} {_OF_WHAT}" if others else "none that fits"),
        ]
    )
    if alone:
        terminal.say("X_CO =")
        for row in record["X_CO_m"]:
            terminal.say("  " + " ".join(f"{v:+9.5f}" for v in row))


def _percent(share: float) -> str:
    from neuralgrasps.report.pose_page import percent_text

    return percent_text(share)


def frame_figure(finding: Finding, record: dict[str, Any], overlay: np.ndarray, colours: dict[str, str]) -> FrameFigure:
    """The card of a frame on the page."""
    from neuralgrasps.report.content import FoundObject, FrameFigure
    from neuralgrasps.report.pose_overlay import render_relief

    assert finding.frame is not None
    rows = [
        FoundObject(
            object=r["object"],
            colour=colours[r["object"]],
            confidence=r["confidence"],
            position_m=tuple(r["position_m"].tolist()),
            quaternion_wxyz=tuple(r["quaternion_wxyz"].tolist()),
            residual_mm=r["residual_median_mm"],
            explained_share=r["explained_share"],
            position_sigma_mm=r["position_sigma_mm"],
            rotation_sigma_deg=r["rotation_sigma_deg"],
            others=others_text(r["alternatives"]),
        )
        for r in (*record["objects"], *record["rejected"])
    ]
    fit = finding.table
    table = (
        f"The table takes {fit.inlier_share:.0%} of the measured pixels, {1e3 * fit.rms_m:.1f} mm rms, "
        f"{table_distance_m(finding.frame, fit):.2f} m away."
        if fit is not None
        else ""
    )
    rest = unexplained_text(finding.unexplained) if finding.unexplained else ""
    notes = " ".join(note[:1].upper() + note[1:] for note in finding.notes)
    return FrameFigure(
        name=finding.name,
        overlay=overlay,
        observed=render_relief(finding.frame.depth, finding.frame.intrinsics),
        found=tuple(rows),
        missing=finding.missing,
        note=" ".join(text for text in (finding.problem, notes, rest, table.replace("%", " %")) if text),
        wall_s=finding.wall_s,
    )
