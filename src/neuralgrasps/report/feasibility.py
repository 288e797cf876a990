"""What every hand can do with every object: the numbers of each pair, their files, and the cells of the table."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from neuralgrasps.dataset.collect import PairRecord
from neuralgrasps.files import write_whole
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.report.content import FeasibilityCell
from neuralgrasps.synthesis.feasibility import shortfall_kind

JSON_FILE, CSV_FILE = "feasibility.json", "feasibility.csv"


@dataclass(frozen=True, slots=True, kw_only=True)
class PairSummary:
    """How many, how good, and why not more. Numbers of grasps that do not exist are nan.

    Attributes:
        hand, object: names. wanted, validated: grasps asked for, and found.
        candidates: start poses; valid_candidates: closed hands that passed all geometric tests.
        tried_in_physics: grasps tried; physics_success_share: of them, those that held, before any was dropped.
        epsilon_median: Ferrari-Canny quality. force_residual_median: net wrench of the best unit squeeze.
        penetration_p95_mm, penetration_max_mm: overlap of hand and object, as `measured_penetration` finds it.
        precision, power: grasps of either kind.
        also_held: share of the grasps that hold another protocol too, by its name.
        cpu_s: CPU-seconds. reason: why fewer than wanted; shortfall: the same in a word or three, "" when none.
    """

    hand: str
    object: str
    wanted: int
    validated: int
    candidates: int
    valid_candidates: int
    tried_in_physics: int
    physics_success_share: float
    epsilon_median: float
    force_residual_median: float
    penetration_p95_mm: float
    penetration_max_mm: float
    precision: int
    power: int
    also_held: Mapping[str, float]
    cpu_s: float
    shortfall: str
    reason: str

    @property
    def held_text(self) -> str:
        """ "97 % held", "" when none was tried."""
        return f"{100 * self.physics_success_share:.0f} % held" if self.tried_in_physics else ""


def summarise_pair(grasps: GraspSet, record: PairRecord, depth_m: np.ndarray) -> PairSummary:
    """The numbers of one pair; `depth_m` (N,) is what `measured_penetration` found."""
    residual = grasps.force_residual[np.isfinite(grasps.force_residual)]
    labelled = grasps.finger_count >= 0
    return PairSummary(
        hand=record.hand,
        object=record.object,
        wanted=record.wanted,
        validated=len(grasps),
        candidates=record.proposals,
        valid_candidates=record.valid,
        tried_in_physics=record.tried,
        physics_success_share=record.physics_success,
        epsilon_median=_percentile(grasps.epsilon, 50),
        force_residual_median=_percentile(residual, 50),
        penetration_p95_mm=_percentile(depth_m, 95) * 1e3,
        penetration_max_mm=_percentile(depth_m, 100) * 1e3,
        precision=int((grasps.precision & labelled).sum()),
        power=int((~grasps.precision & labelled).sum()),
        also_held={n: float(v.success.mean()) for n, v in grasps.verdicts.items() if n != grasps.protocol and len(v)},
        cpu_s=record.cpu_s,
        shortfall=shortfall_kind(record.reason) or ("fewer than wanted" if record.reason else ""),
        reason=record.reason,
    )


def write_feasibility(folder: Path, pairs: Sequence[PairSummary], about: Mapping[str, Any]) -> tuple[Path, Path]:
    """Write `feasibility.json` and `feasibility.csv` and return their paths; numbers that do not exist are left out.

    Args:
        about: what else the JSON object holds: seed, protocol, ...
    Raises:
        StorageError: the folder cannot be written.
    """
    rows = [{k: None if isinstance(v, float) and math.isnan(v) else v for k, v in asdict(p).items()} for p in pairs]
    others = {f"held_{name}": name for p in pairs for name in p.also_held}
    flat = [
        row | {key: p.also_held.get(name) for key, name in others.items()} for row, p in zip(rows, pairs, strict=True)
    ]
    columns = [f.name for f in fields(PairSummary) if f.name != "also_held"] + list(others)
    text = json.dumps({**about, "pairs": rows}, indent=1, allow_nan=False) + "\n"
    table = io.StringIO()
    writer = csv.DictWriter(table, columns, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(flat)
    paths = folder / JSON_FILE, folder / CSV_FILE
    write_whole(paths[0], text)
    write_whole(paths[1], table.getvalue())
    return paths


def feasibility_cell(pair: PairSummary) -> FeasibilityCell:
    """The cell of a pair on the page."""
    if pair.validated == 0:
        notes = (pair.reason.partition(": ")[2], "")
    else:
        both = pair.precision and pair.power
        notes = (pair.held_text, f"{pair.precision} precision, {pair.power} power" if both else "")
    return FeasibilityCell(
        hand=pair.hand,
        object=pair.object,
        value=f"{pair.validated} of {pair.wanted}",
        notes=tuple(note for note in notes if note),
        problem=pair.shortfall if pair.validated == 0 else "",
        reason=pair.reason,
    )


def feasibility_matrix(pairs: Sequence[PairSummary]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Columns and rows of text, objects down and hands across: "60/60 97 %", or in a word why there are none."""
    hands = tuple(dict.fromkeys(p.hand for p in pairs))
    cells = {(p.hand, p.object): _matrix_text(p) for p in pairs}
    objects = dict.fromkeys(p.object for p in pairs)
    return ("object", *hands), [(name, *(cells.get((hand, name), "-") for hand in hands)) for name in objects]


def _matrix_text(pair: PairSummary) -> str:
    if pair.validated == 0:
        return pair.shortfall or "none"
    return f"{pair.validated}/{pair.wanted} {100 * pair.physics_success_share:.0f} %"


def _percentile(values: np.ndarray, share: float) -> float:
    return float(np.percentile(values, share)) if len(values) else math.nan
