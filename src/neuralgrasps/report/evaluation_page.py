"""The evaluation page of a run: tables, distributions, retrieval and t-SNE with pictures; one file, alone."""

from __future__ import annotations

import math
import platform
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

import neuralgrasps
from neuralgrasps.evaluate.embedding import Embedding, embed_book
from neuralgrasps.evaluate.run_examples import Example, retrieval_examples
from neuralgrasps.evaluate.run_scores import ALL_OVER, INPUTS, KNOWN, ONE_VIEW, RunScores
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.model.codes import CodeBook
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.parallel import available_cpus, run_tasks
from neuralgrasps.report.content import DemoReport, Histogram, KeyFigure, LatentMap, Neighbour, RetrievalRow
from neuralgrasps.report.evaluation_tables import tables_of
from neuralgrasps.report.figures import render_grasp
from neuralgrasps.report.page import write_report
from neuralgrasps.report.sections import pretty_name

THUMB, PICTURE = (240, 180), (360, 270)

_KINDS = {"test": "unseen ones", "train": "training ones"}
_FIRST = (ONE_VIEW, ALL_OVER, *(given for given in INPUTS if given not in (ONE_VIEW, ALL_OVER, KNOWN)), KNOWN)

Progress = Callable[[int, int, str], None]
Key = tuple[int, tuple[int, int]]  # row of the code book, size

_TEXTS = {
    "numbers": "Every table says which field its figures belong to, and what was given.",
    "retrieval": "The framed grasp is unseen and its pose is known. Beside it, the training grasp of each hand whose "
    "code is nearest, and last the farthest of all. Similarity is that of the contact maps, as in the tables: 1 is the "
    "same, 0 the least alike of all pairs of an unseen and a training grasp on the object.",
}


def write_evaluation(
    path: str | Path,
    scores: RunScores,
    field: KinematicField,
    book: CodeBook,
    grasps: Mapping[tuple[str, str], GraspSet],
    *,
    command: str,
    seed: int = 0,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Path:
    """Draw the pictures and write the page; returns its path.

    Args:
        scores: of `evaluate_run` for this field, book and grasps; command: as typed, shown at the top.
        seed: of the t-SNE.
    """
    places = {name: (codec.points_O, codec.offset_O) for name, codec in field.object_codecs.items()}
    maps = embed_book(book, places, seed=seed)
    examples = retrieval_examples(book)
    wanted: dict[Key, None] = {(int(i), PICTURE): None for e in examples for i in e.rows}
    wanted |= {(int(m.rows[i]), THUMB): None for m in maps for i in m.pictured}
    pictures = _draw(list(wanted), field, book, grasps, workers=workers, progress=progress)
    thumbs = {row: image for (row, size), image in pictures.items() if size == THUMB}
    kinds = " and ".join(dict.fromkeys(_KINDS[part] for part, _ in scores.parts_and_inputs))
    report = DemoReport(
        title="How well the latent space holds grasps",
        command=command,
        subtitle=f"{scores.field}: {counted(len(book.hands), 'hand')}, {counted(len(book.objects), 'object')}, "
        f"{counted(len(book), 'grasp')} ({kinds} measured)",
        machine=f"{platform.system()} {platform.machine()}, {counted(available_cpus(), 'processor')}",
        seed=seed,
        version=neuralgrasps.__version__,
        created=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        key_figures=key_figures(scores),
        retrieval=tuple(_retrieval_row(e, book, pictures) for e in examples),
        latent_maps=tuple(latent_map(m, book, thumbs) for m in maps),
        histograms=_histograms(scores),
        tables=tables_of(scores),
        section_texts=_TEXTS,
        section_titles={"numbers": "Figures"},
    )
    return write_report(report, path)


def key_figures(scores: RunScores) -> tuple[KeyFigure, ...]:
    """What was inferred first, from least to most that was given; what holds by construction last, and named so."""
    figures: list[KeyFigure] = []
    inputs = [given for part, given in scores.parts_and_inputs if part == "test"]
    for given in sorted(inputs, key=_FIRST.index):
        s = scores.summary("test", given)
        note = f"unseen grasps, {given}"
        gap = f"{s['gap']:.4f}"
        if given == KNOWN:
            note += ": by construction, nothing is inferred"
            if math.isfinite(s.get("chamfer_over_oracle", math.nan)):
                text = f"×{s['chamfer_over_oracle']:.3f}"
                figures.append(KeyFigure(value=text, label="Chamfer over a perfect field's", note=note))
        elif "surface_median_mm" in s:
            median, mean, p95 = (f"{s[f'surface_{k}_mm']:.2f} mm" for k in ("median", "mean", "p95"))
            spread = f"mean {mean}, p95 {p95}; {note}"
            figures.append(KeyFigure(value=median, label="median hand surface error", note=spread))
        figures.append(KeyFigure(value=gap, label="retrieval gap", note=note))
    return tuple(figures)


def _histograms(scores: RunScores) -> tuple[Histogram, ...]:
    return tuple(
        Histogram(
            title=f"Hand surface error, {'unseen' if part == 'test' else 'training'} grasps, {given}",
            unit="mm, mean over the surface of one grasp",
            values=dict(scores.errors_mm[part, given]),
            meaning=f"One value per grasp, by hand ({scores.field}).",
        )
        for part, given in scores.errors_mm
        if given != KNOWN  # exact by construction
    )


def _retrieval_row(example: Example, book: CodeBook, pictures: Mapping[Key, np.ndarray]) -> RetrievalRow:
    query, *nearest, farthest = (
        Neighbour(hand=_hand(book, i), image=pictures[i, PICTURE], similarity=example.similarity[i])
        for i in example.rows
    )
    return RetrievalRow(object=example.object, query=query, nearest=tuple(nearest), farthest=farthest)


def latent_map(m: Embedding, book: CodeBook, pictures: Mapping[int, np.ndarray]) -> LatentMap:
    """A t-SNE picture of a code book's rows, with pictures (by row) of the grasps it chose."""
    several = len(set(book.object_index[m.rows].tolist())) > 1
    notes = []
    for i in m.rows:
        part = "unseen" if book.is_test[i] else "training"
        whose = f"on {pretty_name(book.objects[book.object_index[i]])}, " if several else ""
        notes.append(f"{whose}grasp {book.grasp_index[i]}, {part}")
    return LatentMap(
        title=m.title,
        points=m.points,
        hands=tuple(_hand(book, i) for i in m.rows),
        notes=tuple(notes),
        text="By where the hand touches, seen from the object's centre: the only part of a code that means the same on "
        "every object." if several else "By the part of the codes that retrieval compares.",
        unseen=tuple(int(i) for i in np.flatnonzero(book.is_test[m.rows])),
        pictures={int(i): pictures[int(m.rows[i])] for i in m.pictured},
    )  # fmt: skip


def _draw(
    wanted: Sequence[Key],
    field: KinematicField,
    book: CodeBook,
    grasps: Mapping[tuple[str, str], GraspSet],
    *,
    workers: int | None,
    progress: Progress | None,
) -> dict[Key, np.ndarray]:
    """RGBA pictures of rows of the code book, one task per hand and object."""
    groups: dict[tuple[str, str], list[Key]] = {}
    for key in wanted:
        groups.setdefault((_hand(book, key[0]), book.objects[book.object_index[key[0]]]), []).append(key)
    tasks = []
    for (hand, name), keys in groups.items():
        index = [int(book.grasp_index[row]) for row, _ in keys]
        chosen = grasps[hand, name][np.array(index)]
        sizes = [size for _, size in keys]
        tasks.append((field.hand(hand), field.object(name), np.asarray(chosen.X_OH), np.asarray(chosen.q), sizes))
    pictures: dict[Key, np.ndarray] = {}
    for task, images in run_tasks(_draw_group, tasks, workers=workers):
        pictures |= dict(zip(list(groups.values())[task], images, strict=True))
        if progress is not None:
            progress(len(pictures), len(wanted), "")
    return pictures


def _draw_group(
    hand: Hand, obj: ObjectModel, X_OH: np.ndarray, q: np.ndarray, sizes: Sequence[tuple[int, int]]
) -> list[np.ndarray]:
    return [render_grasp(hand, obj, X, joints, size=size) for X, joints, size in zip(X_OH, q, sizes, strict=True)]


def counted(count: int, noun: str) -> str:
    """ "1 hand", "3 hands"."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _hand(book: CodeBook, row: int) -> str:
    return book.hands[book.hand_index[row]]
