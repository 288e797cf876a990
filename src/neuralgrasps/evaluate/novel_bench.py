"""How many sampled codes become grasps that hold, over many hands and objects."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from neuralgrasps.apply.novel import NovelResult, decode_novel, judge_novel
from neuralgrasps.apply.novel_trial import DecodedCodes, NovelConfig, Trials, try_decoded
from neuralgrasps.errors import InputError
from neuralgrasps.hands.hand import Hand
from neuralgrasps.model.codes import CodeBook
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.parallel import run_tasks


@dataclass(frozen=True, slots=True, kw_only=True)
class NovelRow:
    """Sampled codes of one hand on one object, or of all pairs ("all").

    Attributes:
        codes: how many. held_share, force_closure_share: of them.
        contact_change, palm_shift_mm, palm_turn_deg, novelty_mm: medians over codes in force closure (`NovelResult`).
        trial_cpu_s: CPU-seconds of closing and physics.
    """

    hand: str
    object: str
    codes: int
    held_share: float
    force_closure_share: float
    contact_change: float
    palm_shift_mm: float
    palm_turn_deg: float
    novelty_mm: float
    trial_cpu_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class NovelMeasure:
    """One row per pair, one per hand ("all" objects), and the total; results by pair; config and seed."""

    rows: tuple[NovelRow, ...]
    per_hand: tuple[NovelRow, ...]
    total: NovelRow
    results: tuple[NovelResult, ...]
    config: NovelConfig
    seed: int


def measure_novel(
    field: KinematicField,
    codebook: CodeBook,
    *,
    config: NovelConfig | None = None,
    kind: str | None = None,
    spread: float | None = None,
    per_pair: int | None = None,
    search: int | None = None,
    hands: Sequence[str] | None = None,
    objects: Sequence[str] | None = None,
    seed: int = 0,
    workers: int | None = 1,
    progress: Callable[[int, int], None] | None = None,
) -> NovelMeasure:
    """Sample `per_pair` codes of every pair that has training codes, and try each once in physics.

    Args:
        config: of the sampling, `NovelConfig(search=0)` when None: codes closed as decoded; `kind`, `spread`,
            `per_pair` (its count) and `search` replace its entries.
        hands, objects: only these; all of the code book when None.
        workers: processes, all processors when None; the result does not depend on it.
        progress: called with (pairs done, pairs).
    Raises:
        InputError: no pair has training codes. Others as for `novel_grasps`.
    """
    given = {"kind": kind, "spread": spread, "count": per_pair, "search": search}
    chosen = replace(config or NovelConfig(search=0), **{k: v for k, v in given.items() if v is not None})  # type: ignore[arg-type]
    pairs = [
        (h, o)
        for h in (codebook.hands if hands is None else hands)
        for o in (codebook.objects if objects is None else objects)
        if codebook.where(hand=h, object_name=o, is_test=False).any()
    ]
    if not pairs:
        raise InputError("the code book holds no training grasps of these hands and objects; nothing to sample from.")
    decoded = [decode_novel(field, codebook, hand=h, object_name=o, config=chosen, seed=seed) for h, o in pairs]
    tasks = [(field.hand(h), field.object(o), d, chosen) for (h, o), d in zip(pairs, decoded, strict=True)]
    tried: dict[int, tuple[Trials, float]] = {}
    for index, answer in run_tasks(_try_pair, tasks, workers=workers):
        tried[index] = answer
        if progress is not None:
            progress(len(tried), len(pairs))
    results = tuple(judge_novel(field, d, tried[i][0], config=chosen, seed=seed) for i, d in enumerate(decoded))
    cpu_s = [tried[i][1] for i in range(len(pairs))]
    rows = tuple(_row(h, o, [r], t) for (h, o), r, t in zip(pairs, results, cpu_s, strict=True))
    per_hand = tuple(
        _row(h, "all", [r for r, p in zip(results, pairs, strict=True) if p[0] == h],
             sum(t for t, p in zip(cpu_s, pairs, strict=True) if p[0] == h))
        for h in dict.fromkeys(p[0] for p in pairs)
    )  # fmt: skip
    return NovelMeasure(
        rows=rows, per_hand=per_hand, total=_row("all", "all", results, sum(cpu_s)), results=results, config=chosen,
        seed=seed,
    )  # fmt: skip


def _try_pair(hand: Hand, obj: ObjectModel, decoded: DecodedCodes, config: NovelConfig) -> tuple[Trials, float]:
    start = time.process_time()
    trials = try_decoded(hand, obj, decoded, config=config)
    return trials, time.process_time() - start


def _row(hand: str, object_name: str, results: Sequence[NovelResult], cpu_s: float) -> NovelRow:
    codes = np.array([len(r.outcome) for r in results])

    def share(values: Sequence[float]) -> float:
        return float(np.average(values, weights=codes))

    def median(name: str, scale: float = 1.0) -> float:
        values = np.concatenate([getattr(r, name) for r in results])
        values = values[np.isfinite(values)]
        return float(np.median(values) * scale) if len(values) else float("nan")

    return NovelRow(
        hand=hand,
        object=object_name,
        codes=int(codes.sum()),
        held_share=share([r.held_share for r in results]),
        force_closure_share=share([r.force_closure_share for r in results]),
        contact_change=median("contact_change"),
        palm_shift_mm=median("palm_shift_m", 1e3),
        palm_turn_deg=median("palm_turn_rad", 180.0 / np.pi),
        novelty_mm=median("novelty_m", 1e3),
        trial_cpu_s=cpu_s,
    )
