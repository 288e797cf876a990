"""The page of `synthesise --all --report`: what every hand can do with every object, in a table and contact sheets."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from neuralgrasps.cli.grasp_page import about_this_run, set_text, trial_table
from neuralgrasps.cli.progress import ProgressBar
from neuralgrasps.cli.terminal import counted
from neuralgrasps.parallel import run_tasks
from neuralgrasps.report.contact_sheet import SHOWN, SheetPair, contact_sheets
from neuralgrasps.report.content import (
    DemoReport,
    FeasibilityFigure,
    Histogram,
    KeyFigure,
    SynthesisRow,
)
from neuralgrasps.report.feasibility import PairSummary, feasibility_cell
from neuralgrasps.report.figures import SIZE, render_hand, render_object
from neuralgrasps.report.page import write_report

MAX_BYTES = 15_000_000
_MANY, _SMALLER = 480, (400, 300)  # over so many pictures, each is drawn smaller


def write_feasibility_page(
    path: Path,
    drawn: Sequence[SheetPair],
    pairs: Sequence[PairSummary],
    *,
    seed: int,
    protocol: str,
    command: str,
    workers: int | None,
    progress: ProgressBar,
) -> Path:
    """Write the page; `drawn` holds hand, object and grasps of each of `pairs`."""
    size = SIZE if SHOWN * len(pairs) <= _MANY else _SMALLER
    sheets = contact_sheets(drawn, size=size, workers=workers, progress=progress)
    hands = {pair.grasps.hand: pair.hand for pair in drawn}
    objects = {pair.grasps.object: pair.obj.mesh for pair in drawn}
    tasks = [*((render_hand, hand) for hand in hands.values()), *((render_object, mesh) for mesh in objects.values())]
    found = dict(run_tasks(_call, tasks, workers=workers))
    images = [found[i] for i in range(len(tasks))]
    texts = {(p.hand, p.object): set_text(p) for p in pairs}
    parameters = next((d.grasps.verdicts[protocol].parameters for d in drawn if protocol in d.grasps.verdicts), {})
    report = DemoReport(
        title=f"{counted(len(hands), 'hand')} on {counted(len(objects), 'object')}",
        subtitle=f"{counted(sum(p.validated for p in pairs), 'diverse grasp')}, each held by the physics protocol "
        f"'{protocol}'.",
        **about_this_run(command, seed),
        key_figures=_key_figures(pairs, drawn),
        feasibility=FeasibilityFigure(
            hands=dict(zip(hands, images, strict=False)),
            objects=dict(zip(objects, images[len(hands) :], strict=True)),
            cells=tuple(feasibility_cell(p) for p in pairs),
        ),
        sheets=tuple(s.with_text(texts[s.hand, s.object]) for s in sheets),
        synthesis=tuple(_row(p) for p in pairs),
        tables=(trial_table(protocol, parameters),) if parameters else (),
        histograms=_histograms(drawn),
    )
    return write_report(report, path, max_bytes=MAX_BYTES)


def _call(function, subject):  # type: ignore[no-untyped-def]
    return function(subject)


def _key_figures(pairs: Sequence[PairSummary], drawn: Sequence[SheetPair]) -> tuple[KeyFigure, ...]:
    tried = sum(p.tried_in_physics for p in pairs)
    held = sum(round(p.physics_success_share * p.tried_in_physics) for p in pairs if p.tried_in_physics)
    full = sum(p.validated >= p.wanted for p in pairs)
    depth = np.concatenate([d.depth_m for d in drawn] or [np.zeros(0)])
    figures = [
        KeyFigure(
            value=str(sum(p.validated for p in pairs)), label="grasps held in physics",
            note=f"{sum(p.wanted for p in pairs)} wanted",
        ),
        KeyFigure(value=f"{full} of {len(pairs)}", label="pairs have as many as wanted"),
    ]  # fmt: skip
    if tried:
        figures.append(
            KeyFigure(value=f"{100 * held / tried:.0f} %", label="of those tried held", note=f"{tried} tried")
        )
    if len(depth):
        figures.append(
            KeyFigure(
                value=f"{1e3 * np.percentile(depth, 95):.2f} mm", label="overlap, 95th percentile",
                note=f"of hand and true mesh; deepest {1e3 * depth.max():.2f} mm",
            )
        )  # fmt: skip
    figures.append(KeyFigure(value=f"{sum(p.cpu_s for p in pairs):.0f} s", label="CPU time of all pairs"))
    return tuple(figures)


def _row(pair: PairSummary) -> SynthesisRow:
    return SynthesisRow(
        hand=pair.hand,
        object=pair.object,
        candidates=pair.candidates,
        valid=pair.valid_candidates,
        tried=pair.tried_in_physics,
        validated=pair.validated,
        success_share=pair.physics_success_share if pair.tried_in_physics else None,
        penetration_p95_mm=pair.penetration_p95_mm if pair.validated else None,
        epsilon_median=pair.epsilon_median if pair.validated else None,
        cpu_s=pair.cpu_s,
    )


def _histograms(drawn: Sequence[SheetPair]) -> tuple[Histogram, ...]:
    epsilon: dict[str, list[np.ndarray]] = {}
    overlap: dict[str, list[np.ndarray]] = {}
    for pair in drawn:
        if len(pair.grasps):
            epsilon.setdefault(pair.grasps.hand, []).append(pair.grasps.epsilon)
            overlap.setdefault(pair.grasps.hand, []).append(pair.depth_m * 1e3)
    if not epsilon:
        return ()
    return (
        Histogram(title="Largest disturbance resisted", unit="epsilon", values=_joined(epsilon)),
        Histogram(title="Overlap", unit="mm", values=_joined(overlap), limit=1.0),
    )


def _joined(values: dict[str, list[np.ndarray]]) -> dict[str, np.ndarray]:
    return {name: np.concatenate(parts) for name, parts in values.items()}
