"""The objects of a benchmark, and the shipped run that knows them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from neuralgrasps.cli.models import open_objects, source_text, warn_of_damage, warn_of_stand_ins
from neuralgrasps.cli.terminal import Terminal

if TYPE_CHECKING:
    from neuralgrasps.evaluate.pose_bench_methods import Library
    from neuralgrasps.objects.object_model import ObjectModel


def open_library(terminal: Terminal, sources: Sequence[str]) -> tuple[Library, dict[str, ObjectModel]]:
    """The objects of some sources, and the library of them."""
    models = read_objects(terminal, sources)
    return library_of(sources, models), models


def read_objects(terminal: Terminal, sources: Sequence[str]) -> dict[str, ObjectModel]:
    """The objects of some sources by name, with warnings for what is wrong with them."""
    with terminal.progress("reading objects"):
        models = open_objects(sources)
    warn_of_damage(terminal, models.values())
    warn_of_stand_ins(terminal, dict(zip(models, sources, strict=True)), models)
    return models


def library_of(sources: Sequence[str], models: Mapping[str, ObjectModel]) -> Library:
    """The objects with the shipped run that has grasps of some of them; without a run when none has."""
    from neuralgrasps.evaluate.pose_bench_methods import Library
    from neuralgrasps.model.run_notes import read_notes, run_folder, shipped_runs

    by_name = dict(zip(models, sources, strict=True))
    for run in shipped_runs():
        names = read_notes(run_folder(run)).objects
        if set(names) & set(by_name):
            return Library(sources=tuple(sources), run=run, run_sources=tuple(by_name.get(n, n) for n in names))
    return Library(sources=tuple(sources))


def paper_objects(given: Sequence[str]) -> tuple[str, ...]:
    """Sources of the objects: as given, of a folder that holds the paper's seven just these; else scans or built-in."""
    from neuralgrasps.objects.builtin import STAND_INS
    from neuralgrasps.objects.store import imported_names
    from neuralgrasps.objects.zoo import OBJECT_GROUPS, object_sources

    seven = OBJECT_GROUPS["ycb7"]
    if not given:
        return tuple(seven) if set(seven) <= set(imported_names()) else tuple(STAND_INS)
    sources = tuple(source_text(source) for source in object_sources(given))
    paper = tuple(s for s in sources if any(name in s for name in seven))
    return paper if len(paper) == len(seven) else sources
