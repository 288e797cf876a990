"""The small page of `synthesise --report`: the grasps of one pair in pictures and numbers."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import neuralgrasps
from neuralgrasps.cli.progress import ProgressBar
from neuralgrasps.parallel import available_cpus
from neuralgrasps.report.content import (
    ContactFigure,
    DemoReport,
    GraspFigure,
    HandFigure,
    Histogram,
    KeyFigure,
    SynthesisRow,
)
from neuralgrasps.report.figures import render_contact_map, render_grasp, render_hand
from neuralgrasps.report.page import write_report

if TYPE_CHECKING:
    from neuralgrasps.grasps.grasp_set import GraspSet
    from neuralgrasps.hands.hand import Hand
    from neuralgrasps.objects.object_model import ObjectModel

SHOWN = 12
CONTACTS_SHOWN = 4


def write_grasp_page(
    path: Path,
    hand: Hand,
    obj: ObjectModel,
    grasps: GraspSet,
    figures: Mapping[str, Any],
    *,
    command: str,
    progress: ProgressBar,
) -> Path:
    """Write the page of one pair. `figures` as `pair_figures` makes them; the first, most diverse grasps are drawn."""
    shown, maps = min(SHOWN, len(grasps)), min(CONTACTS_SHOWN, len(grasps))
    total = shown + maps + 1
    verdict = grasps.verdicts[grasps.protocol]
    cards = []
    for i in range(shown):
        image = render_grasp(hand, obj, grasps.X_OH[i], grasps.q[i])
        cards.append(
            GraspFigure(
                hand=hand.name,
                object=obj.name,
                image=image,
                epsilon=float(grasps.epsilon[i]),
                penetration_mm=float(grasps.penetration_m[i] * 1e3),
                success=bool(verdict.success[i]),
                displacement_mm=float(verdict.displacement_m[i] * 1e3),
                note=f"grasp {i} of the file",
            )
        )
        progress(i + 1, total)
    contacts = _contact_figures(hand, obj, grasps[:maps], progress, shown, total)
    report = DemoReport(
        title=f"{hand.name} on {obj.name}",
        command=command,
        subtitle=f"{len(grasps)} diverse grasps, each held by the physics protocol '{grasps.protocol}'.",
        machine=f"{platform.system()} {platform.machine()}, {available_cpus()} cores",
        seed=grasps.seed,
        version=neuralgrasps.__version__,
        created=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        key_figures=_key_figures(figures),
        hands=(HandFigure(hand=hand.name, image=render_hand(hand), text=f"{hand.num_dofs} joints, {hand.licence}"),),
        grasps=tuple(cards),
        contacts=contacts,
        synthesis=(_synthesis_row(figures),),
        histograms=(
            Histogram(
                title="Largest disturbance resisted", unit="epsilon", values={hand.name: np.array(grasps.epsilon)}
            ),
            Histogram(title="Overlap", unit="mm", values={hand.name: grasps.penetration_m * 1e3}, limit=1.0),
        ),
        notes=tuple(_notes(hand, obj)),
    )
    return write_report(report, path)


def _contact_figures(
    hand: Hand, obj: ObjectModel, grasps: GraspSet, progress: ProgressBar, done: int, total: int
) -> tuple[ContactFigure, ...]:
    from neuralgrasps.grasps.contact_map import contact_map_packed
    from neuralgrasps.hands.packed import pack_hand

    radius = 0.05 * float(np.linalg.norm(obj.points_O - obj.points_O.mean(axis=0), axis=1).max())
    values = contact_map_packed(
        obj.points_O, pack_hand(hand, spacing=0.009), np.array(grasps.X_OH), np.array(grasps.q), radius=radius
    )
    figures = []
    for i, row in enumerate(values):
        figures.append(
            ContactFigure(
                hand=hand.name,
                object=obj.name,
                image=render_contact_map(obj, row),
                area_share=float((row > 0.5).mean()),
                note=f"grasp {i}, decay length {1e3 * radius:.1f} mm",
            )
        )
        progress(done + i + 1, total)
    return tuple(figures)


def _key_figures(figures: Mapping[str, Any]) -> tuple[KeyFigure, ...]:
    success = figures["physics_success_share"]
    return (
        KeyFigure(value=str(figures["validated"]), label="grasps held in physics", note=f"{figures['wanted']} wanted"),
        KeyFigure(
            value=f"{100 * success:.0f} %", label="of those tried held", note=f"{figures['tried_in_physics']} tried"
        ),
        KeyFigure(
            value=f"{figures['penetration_p95_mm']:.2f} mm",
            label="overlap, 95th percentile",
            note="against the true mesh",
        ),
        KeyFigure(
            value=f"{figures['grasps_per_minute']:.0f}",
            label="grasps per minute",
            note=f"{figures['cpu_s']:.1f} CPU seconds in all",
        ),
    )


def _synthesis_row(figures: Mapping[str, Any]) -> SynthesisRow:
    return SynthesisRow(
        hand=figures["hand"],
        object=figures["object"],
        candidates=figures["candidates"],
        valid=figures["valid_candidates"],
        validated=figures["validated"],
        success_share=figures["physics_success_share"],
        penetration_p95_mm=figures["penetration_p95_mm"],
        epsilon_median=figures["epsilon_median"],
        cpu_s=figures["cpu_s"],
    )


def _notes(hand: Hand, obj: ObjectModel) -> list[str]:
    """What was mended and guessed on the way in."""
    notes = [
        f"Hand: {line}" for key in ("repairs", "annotated") for line in hand.extra.get(key, "").splitlines() if line
    ]
    return notes + [
        f"Object, {k}: {v}" for k, v in obj.provenance.items() if k in ("unit", "repairs", "mass", "surface")
    ]
