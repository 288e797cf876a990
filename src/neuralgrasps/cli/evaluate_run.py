"""`neuralgrasps evaluate RUN`: the published tables on a run's own grasps, beside the paper and a perfect field."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from neuralgrasps.cli.options import check_seed
from neuralgrasps.cli.outputs import check_writable, make_parent
from neuralgrasps.cli.terminal import Cell, Outcome, Terminal
from neuralgrasps.errors import InputError

if TYPE_CHECKING:
    from neuralgrasps.evaluate.run_scores import RunScores
    from neuralgrasps.grasps.grasp_set import GraspSet
    from neuralgrasps.model.checkpoint import Run

NOT_ITS_DATA = (
    "The paper's figures (in brackets) are for its own hands, grasps and samples of the objects: the comparison is one "
    "of protocol, not of data."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOptions:
    """Options of `evaluate` that belong to runs; see there."""

    part: str = "test"
    queries: int = 100_000
    observed: bool = True
    report: Path | None = None
    seed: int = 0
    workers: int | None = None


def evaluate_run(
    terminal: Terminal, folder: Path, options: RunOptions, *, hands: tuple[str, ...], objects: tuple[str, ...]
) -> Outcome:
    """Measure a run, show its tables, and write its page when asked to."""
    from neuralgrasps.cli.evaluate import open_run
    from neuralgrasps.evaluate.run_evaluate import evaluate_run as measure
    from neuralgrasps.evaluate.run_pairs import MeasureConfig
    from neuralgrasps.model.mlp_run import run_kind

    check_seed(options.seed)
    if options.queries < 1000:
        raise InputError(f"--queries is {options.queries}; expected at least 1000, so that some lie inside the hands.")
    if options.report is not None:
        check_writable(options.report)
    if run_kind(folder) == "mlp":
        return _finish(terminal, folder, _measure_mlp(terminal, folder, options, hands, objects))
    with terminal.progress("reading the run"):
        run = open_run(folder, hands, objects)
        grasps = grasps_of(run, folder)
    config = MeasureConfig(queries=options.queries, observed=options.observed, seed=options.seed)
    with terminal.progress("measuring") as bar:
        scores = measure(
            run.field, run.codebook, grasps, part=options.part, config=config, workers=options.workers,
            progress=bar.stage,
        )  # fmt: skip
    outcome = _finish(terminal, folder, scores)
    if options.report is None:
        return outcome
    from neuralgrasps.report.evaluation_page import write_evaluation

    make_parent(options.report)
    with terminal.progress("pictures", "pictures") as bar:
        page = write_evaluation(
            options.report, scores, run.field, run.codebook, grasps, command=terminal.command, seed=options.seed,
            workers=options.workers, progress=bar,
        )  # fmt: skip
    terminal.say(f"page: {page}")
    return Outcome(result={**outcome.result, "report": str(page)})


def _finish(terminal: Terminal, folder: Path, scores: RunScores) -> Outcome:
    """Show every table; the rows as the result."""
    for part, given in scores.parts_and_inputs:
        show(terminal, scores, part, given)
    terminal.say(NOT_ITS_DATA)
    return Outcome(result={"folder": str(folder), **scores.record(), "comparison": NOT_ITS_DATA})


def _measure_mlp(
    terminal: Terminal, folder: Path, options: RunOptions, hands: tuple[str, ...], objects: tuple[str, ...]
) -> RunScores:
    """Tables of a published field: one object, its own codes."""
    from neuralgrasps.cli.models import hands_of, run_objects
    from neuralgrasps.evaluate.run_mlp import evaluate_mlp_run
    from neuralgrasps.evaluate.run_pairs import MeasureConfig
    from neuralgrasps.hands.packed import pack_hand
    from neuralgrasps.model.kinematic_field import POINT_SPACING_M
    from neuralgrasps.model.mlp_run import load_mlp_run

    if options.report is not None:
        raise InputError("--report is of runs of the default field; for a run of the published one, use --json.")
    with terminal.progress("reading the run"):
        run = load_mlp_run(folder)
        name = run.field.object_name
        models, obj = hands_of(run.codebook.hands, folder, hands), run_objects(folder, [name], objects)[name]
    packed = {hand: pack_hand(model, spacing=POINT_SPACING_M) for hand, model in models.items()}
    config = MeasureConfig(queries=options.queries, per_pair=1, seed=options.seed)
    with terminal.progress("measuring") as bar:
        return evaluate_mlp_run(run, packed, obj, part=options.part, config=config, progress=bar.stage)


def grasps_of(run: Run, folder: Path) -> Mapping[tuple[str, str], GraspSet]:
    """The grasps that a run was fitted to and those held out, from the run, else from its dataset.

    Raises:
        InputError: neither has them.
    """
    own = getattr(run, "grasps", None)
    if own:
        return own
    from neuralgrasps.cli.models import read_sources
    from neuralgrasps.dataset.read import read_dataset

    home = str(read_sources(folder).get("dataset", ""))
    if not home or not (Path(home) / "manifest.json").is_file():
        raise InputError(f"'{folder}' holds no grasps and its dataset '{home}' is gone; train again.")
    dataset = read_dataset(home)
    return {pair: dataset.grasps(*pair) for pair in dataset.pairs}


def show(terminal: Terminal, scores: RunScores, part: str, given: str) -> None:
    """Tables of one part and kind of input."""
    from neuralgrasps.evaluate.run_scores import INPUTS
    from neuralgrasps.report.evaluation_tables import beside_paper

    whose = "Unseen grasps" if part == "test" else "Training grasps"
    terminal.say()
    terminal.say(f"{whose}, {given} ({scores.field}): {INPUTS[given]}.")
    _show_chamfer(terminal, scores, part, given)
    _show_surfaces(terminal, scores, part, given)
    _show_similarities(terminal, scores, part, given)
    if sentence := beside_paper(scores, part, given, names=True):
        terminal.say(sentence)
    if note := scores.chamfer_note(part, given):
        terminal.say(note)


def _show_chamfer(terminal: Terminal, scores: RunScores, part: str, given: str) -> None:
    rows = [r for r in scores.hands if (r.part, r.input) == (part, given)]
    hands = list(dict.fromkeys(r.hand for r in rows))
    body: list[list[Cell]] = []
    for shape in scores.objects_of(part, given):
        cells: list[Cell] = [shape.object, _beside(shape.chamfer_e3, shape.paper_e3)]
        worst = shape.over_oracle
        for hand in hands:
            row = next((r for r in rows if (r.object, r.hand) == (shape.object, hand)), None)
            cells.append(None if row is None else _beside(row.chamfer_e3, row.paper_e3))
            worst = max(worst, row.over_oracle if row else 0.0)
        body.append([*cells, f"{worst:.3f}"])
    terminal.say("Chamfer x 1e-3 (paper), and the worst of the row over a perfect field's score (no bound):")
    terminal.table(("object", "object itself", *hands, "over perfect"), body)


def _show_surfaces(terminal: Terminal, scores: RunScores, part: str, given: str) -> None:
    from neuralgrasps.report.evaluation_tables import small

    rows = [r for r in scores.hands if (r.part, r.input) == (part, given)]
    columns = ("hand", "n", "mean mm", "median mm", "p95 mm", "F 1 mm", "F 2 mm", "contact error", "wrong", "infer ms")
    body: list[list[Cell]] = []
    for hand in dict.fromkeys(r.hand for r in rows):
        own = [r for r in rows if r.hand == hand]
        mean = lambda name: sum(getattr(r, name) for r in own) / len(own)  # noqa: B023, E731
        body.append(
            [
                hand, sum(r.grasps for r in own), *(small(mean(f"surface_{k}_mm")) for k in ("mean", "median", "p95")),
                f"{mean('f_1mm'):.3f}", f"{mean('f_2mm'):.3f}", small(mean("contact_error_mean")),
                sum(r.wrong for r in own), None if own[0].infer_ms is None else f"{mean('infer_ms'):.0f}",
            ]
        )  # fmt: skip
    terminal.say(
        "Hand surface to true surface, both ways; F-scores; mean |difference| of contact maps; wrong by over 10 mm:"
    )
    terminal.table(columns, body)


def _show_similarities(terminal: Terminal, scores: RunScores, part: str, given: str) -> None:
    rows = [r for r in scores.similarities if (r.part, r.input) == (part, given)]
    body: list[list[Cell]] = [
        [
            r.object, r.queries, _beside(r.near_z, r.paper_near_z), _beside(r.near_gt, r.paper_near_gt),
            _beside(r.far_z, r.paper_far_z), _beside(r.far_gt, r.paper_far_gt), f"{r.gap:.4f}",
            f"{r.gap_reranked:.4f}", f"{r.recall_at_1:.2f}", f"{r.recall_at_5:.2f}", f"{r.recall_at_10:.2f}",
        ]
        for r in rows
    ]  # fmt: skip
    columns = ("object", "n", "Near Z", "Near GT", "Far Z", "Far GT", "gap", "re-ranked", "R@1", "R@5", "R@10")
    terminal.say(
        "Contact similarity of what the codes find (paper); gap to the best there is; re-ranked: the gap after the "
        "first 20 by code were put in order by contact map; recall of the nearest grasp by contact map:"
    )
    terminal.table(columns, body)


def _beside(value: float, paper: float | None) -> str:
    own = f"{value:.2f}" if math.isfinite(value) else "-"
    return own if paper is None else f"{own} ({paper:.2f})"
