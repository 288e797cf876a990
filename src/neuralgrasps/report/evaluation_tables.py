"""Tables of the evaluation page: ours beside the paper's figures and a perfect field's."""

from __future__ import annotations

import math
from collections.abc import Sequence

from neuralgrasps.evaluate.run_scores import INPUTS, KNOWN, HandRow, ObjectRow, RunScores, SimilarityRow
from neuralgrasps.report.content import Table
from neuralgrasps.report.sections import pretty_name

_WHOSE = {"test": "Unseen grasps", "train": "Training grasps"}
_PERFECT = "a perfect field"
_SURFACES = ("mean", "median", "p95")
LEAST = 5e-4  # below it, lengths in mm and errors of contact maps are rounding


def tables_of(scores: RunScores) -> tuple[Table, ...]:
    """All tables, part by part and input by input; the measured field and the input are in every title."""
    tables = []
    for part, given in scores.parts_and_inputs:
        tables += [
            chamfer_table(scores, part, given),
            surface_table(scores, part, given),
            surface_matrix(scores, part, given),
            similarity_table(scores, part, given),
        ]
    return (summary_table(scores), *(t for t in tables if t.rows), times_table(scores))


def summary_table(scores: RunScores) -> Table:
    """One row for each kind of input."""
    rows = []
    for part, given in scores.parts_and_inputs:
        s = scores.summary(part, given)
        names = ("surface_mean_mm", "surface_median_mm", "surface_p95_mm", "f_1mm", "f_2mm", "chamfer_over_oracle")
        numbers = [s.get(name) for name in names]
        wrong = None if "wrong_basins" not in s else f"{100 * s['wrong_basins']:.1f} %"
        gaps = (f"{s['gap']:.4f}", f"{s['gap_reranked']:.4f}", f"{s['recall_at_1']:.2f}")
        rows.append((f"{_WHOSE[part]}, {given}", *map(small, numbers), wrong, *gaps))
    inputs = dict.fromkeys(given for _, given in scores.parts_and_inputs)
    return Table(
        title=f"All objects and hands together ({scores.field})",
        columns=(
            "input", "surface mean, mm", "median", "p95", "F at 1 mm", "at 2 mm", "Chamfer / perfect", "wrong by 10 mm",
            "gap", "re-ranked", "recall at 1",
        ),
        rows=tuple(rows),
        meaning="Surface: distances between decoded and true hand, both ways, over all surface points. Chamfer / "
        f"perfect: the published measure over what {_PERFECT} scores. Wrong: share of grasps with a mean surface error "
        "above 10 mm. Gap: contact similarity of the best grasp there is, less that of the one found by code; "
        "re-ranked: after the first 20 by code were put in order by contact map. Recall at 1: share of queries whose "
        "code finds the best. Kinds of input are never mixed: "
        + " ".join(f"{given.capitalize()}: {INPUTS[given]}." for given in inputs),
        how=" ".join(f"{name.capitalize()}: {text}." for name, text in scores.conditions.items()),
    )  # fmt: skip


def chamfer_table(scores: RunScores, part: str, given: str) -> Table:
    """The published measure, object by object and hand by hand: ours, the paper's, and a perfect field's."""
    own = [r for r in scores.hands if (r.part, r.input) == (part, given)]
    hands = list(dict.fromkeys(r.hand for r in own))
    body = []
    for shape in scores.objects_of(part, given):
        cells: list[HandRow | ObjectRow | None] = [shape]
        cells += [next((r for r in own if (r.object, r.hand) == (shape.object, hand)), None) for hand in hands]
        body.append((pretty_name(shape.object), *map(_chamfer_text, cells)))
    return Table(
        title=f"Published Chamfer × 10⁻³: {_WHOSE[part].lower()}, {given} ({scores.field})",
        columns=("object", "object itself", *hands),
        rows=tuple(body),
        meaning=f"Each cell: ours, its ratio to what {_PERFECT} scores on the same queries, and the paper's figure in "
        f"brackets. The measure compares a filled shape with a surface, so even {_PERFECT} scores well above zero, and "
        f"a hollow shape below that: its score is no bound. {beside_paper(scores, part, given)} "
        f"{scores.chamfer_note(part, given)}".rstrip(),
        how="The paper's figures are for its own hands, grasps and samples of the objects: the comparison is one of "
        "protocol, not of data. Means over the grasps of a hand and object. A dash: of so few queries none fell inside "
        "the hand.",
    )


def beside_paper(scores: RunScores, part: str, given: str, *, names: bool = False) -> str:
    """How many Chamfer scores are at or below the paper's, in a sentence; empty where it has none of them.

    Args:
        names: say which are above.
    """
    sides = scores.against_paper(part, given)
    met, above, both = sides["at_or_below"], sides["above"], sides["above_as_a_perfect_field"]
    if not (met or above or both):
        return ""
    words = [f"at or below it in {len(met)}"]
    if above:
        words.append(f"above it in {len(above)}" + (f" ({_grouped(above)})" if names else ""))
    if both:
        listed = f" ({_grouped(both)})" if names else ""
        words.append(f"above it in {len(both)}{listed} where {_PERFECT} is above it too")
    count = len(met) + len(above) + len(both)
    return f"Of the paper's Chamfer figures, {count} can be compared: ours is {'; '.join(words)}."


def _grouped(columns: Sequence[str]) -> str:
    """Columns "object: hand" with each object named once."""
    hands: dict[str, list[str]] = {}
    for column in columns:
        name, _, hand = column.partition(": ")
        hands.setdefault(name, []).append(hand)
    return "; ".join(f"{name}: {', '.join(own)}" for name, own in hands.items())


def _chamfer_text(row: HandRow | ObjectRow | None) -> str | None:
    if row is None:
        return None
    paper = "" if row.paper_e3 is None else f" ({row.paper_e3:.2f})"
    if not math.isfinite(row.chamfer_e3):  # so few queries that none fell inside
        return f"–{paper}"
    return f"{row.chamfer_e3:.2f} ×{row.over_oracle:.3f}{paper}"


def surface_table(scores: RunScores, part: str, given: str) -> Table:
    """Honest millimetres by hand, over all objects; no rows for known grasps, whose errors are rounding."""
    rows = [r for r in scores.hands if (r.part, r.input) == (part, given) and given != KNOWN]
    body = []
    for hand in dict.fromkeys(r.hand for r in rows):
        own = [r for r in rows if r.hand == hand]
        infer = [r.infer_ms for r in own if r.infer_ms is not None]
        body.append(
            (
                hand, sum(r.grasps for r in own), *(_fixed(_mean(own, f"surface_{k}_mm"), 3) for k in _SURFACES),
                *(f"{_mean(own, k):.3f}" for k in ("f_1mm", "f_2mm")),
                *(_fixed(_mean(own, f"contact_error_{k}"), 4) for k in ("mean", "p95")),
                f"{sum(r.wrong for r in own)}", sum(infer) / len(infer) if infer else None,
            )
        )  # fmt: skip
    return Table(
        title=f"Hand surfaces: {_WHOSE[part].lower()}, {given} ({scores.field})",
        columns=(
            "hand", "grasps", "mean, mm", "median", "p95", "F at 1 mm", "at 2 mm", "contact error", "its p95",
            "wrong by 10 mm", "infer, CPU ms",
        ),
        rows=tuple(body),
        meaning="Distance between decoded and true hand, from points of each surface to the other, exact. F-score: "
        "harmonic mean of the shares of either surface within 1 or 2 mm of the other. Contact error: |difference| of "
        "the contact maps of decoded and true hand, over the object's contact points.",
        how="Means over the objects of what is measured on each: mean, median and 95th percentile over the surface "
        "points of its grasps.",
    )  # fmt: skip


def surface_matrix(scores: RunScores, part: str, given: str) -> Table:
    """Mean surface error and its 95th percentile of every object and hand; no rows for known grasps."""
    rows = [r for r in scores.hands if (r.part, r.input) == (part, given) and given != KNOWN]
    hands = list(dict.fromkeys(r.hand for r in rows))
    cells = {(r.object, r.hand): f"{r.surface_mean_mm:.2f} / {r.surface_p95_mm:.2f}" for r in rows}
    return Table(
        title=f"Hand surfaces by object, mm: {_WHOSE[part].lower()}, {given} ({scores.field})",
        columns=("object", *hands),
        rows=tuple(
            (pretty_name(name), *(cells.get((name, hand)) for hand in hands))
            for name in dict.fromkeys(r.object for r in rows)
        ),
        meaning="Mean / 95th percentile over the surface points.",
    )


def _mean(rows: Sequence[HandRow], name: str) -> float:
    return sum(getattr(r, name) for r in rows) / len(rows)


def similarity_table(scores: RunScores, part: str, given: str) -> Table:
    """Retrieval, the paper's figures in brackets."""
    rows = [r for r in scores.similarities if (r.part, r.input) == (part, given)]
    return Table(
        title=f"Retrieval: {_WHOSE[part].lower()}, {given} ({scores.field})",
        columns=(
            "object", "queries", "Near Z", "Near GT", "Far Z", "Far GT", "gap", "re-ranked", "recall at 1", "at 5",
            "at 10",
        ),
        rows=tuple(_similarity_cells(r) for r in rows),
        meaning="Contact similarity of the nearest and farthest training grasp, found by code (Z) and by the contact "
        "maps "
        "themselves (GT: the best and worst there are); the paper's figures in brackets. Recall at k: the nearest "
        "grasp by contact map is among the k nearest by code. Re-ranked: the gap after the first 20 by code were put "
        "in order by contact map.",
        how="L1 between contact maps over the largest of the object's; similarity is one minus that.",
    )  # fmt: skip


def _similarity_cells(r: SimilarityRow) -> tuple[str | int | None, ...]:
    pairs: Sequence[tuple[float, float | None]] = (
        (r.near_z, r.paper_near_z), (r.near_gt, r.paper_near_gt), (r.far_z, r.paper_far_z), (r.far_gt, r.paper_far_gt),
    )  # fmt: skip
    beside = [f"{own:.2f}" + ("" if paper is None else f" ({paper:.2f})") for own, paper in pairs]
    recall = (f"{r.recall_at_1:.2f}", f"{r.recall_at_5:.2f}", f"{r.recall_at_10:.2f}")
    return (pretty_name(r.object), r.queries, *beside, f"{r.gap:.4f}", f"{r.gap_reranked:.4f}", *recall)


def times_table(scores: RunScores) -> Table:
    """Milliseconds for one grasp."""
    return Table(
        title="Times of one grasp",
        columns=("what", "ms"),
        rows=tuple((name, value) for name, value in scores.times_ms.items()),
        meaning="Encode: the code of a known grasp, with its contact map. Retrieve: its nearest grasps on the object, "
        "re-ranked. Infer: pose, joints and code from observed points.",
        how="Medians; encode and retrieve in wall-clock time on one thread, infer in processor time.",
    )


def small(value: float | None) -> float | str | None:
    """A length in mm or an error of contact maps; what is exact but for rounding reads "< 0.001"."""
    return "< 0.001" if value is not None and 0 < value < LEAST else value  # nan stays what it is


def _fixed(value: float, digits: int) -> str:
    kept = small(value)
    return kept if isinstance(kept, str) else f"{value:.{digits}f}"
