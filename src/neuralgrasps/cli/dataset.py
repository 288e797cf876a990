"""`neuralgrasps dataset`: build from grasp files, describe, verify."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from neuralgrasps.cli.models import (
    SOURCES_FILE,
    open_hands,
    open_objects,
    read_sources,
    source_text,
    warn_of_damage,
    write_sources,
)
from neuralgrasps.cli.options import Folder, Names, PositionalFolder, Unit, Workers, check_seed
from neuralgrasps.cli.outputs import check_writable
from neuralgrasps.cli.terminal import Cell, Outcome, Terminal, counted
from neuralgrasps.errors import DataFormatError, InputError

if TYPE_CHECKING:
    from neuralgrasps.grasps.grasp_set import GraspSet


def build(
    terminal: Terminal,
    grasps: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FILE|DIR ...")],
    /,
    *,
    out: Folder = Path("dataset"),
    hands: Names = (),
    objects: Names = (),
    unit: Unit = "auto",
    seed: int = 0,
    queries: int = 40_000,
    store_samples: bool = False,
    workers: Workers = None,
) -> Outcome:
    """Build a dataset for training: contact maps, splits, and signed-distance samples.

    A build that was stopped goes on where it was. Samples are computed when read, unless --store-samples.

    Args:
        grasps: grasp files, or folders of them as `synthesise` writes.
        out: folder of the dataset.
        hands: files of hands that are not built in and that the grasp files do not name.
        objects: the same for objects.
        unit: length unit of mesh files.
        seed: root of every random number.
        queries: sample points per grasp.
        store_samples: write the samples, 40,000 points a grasp, instead of computing them when read.
        workers: processes.
    """
    from neuralgrasps.dataset.build import build_dataset
    from neuralgrasps.dataset.schema import DatasetConfig
    from neuralgrasps.parallel import available_cpus

    check_writable(out, folder=True)
    check_seed(seed)
    config = DatasetConfig(seed=seed, queries_per_scene=queries, store_samples=store_samples)
    sets, recorded = read_grasp_files(grasps)
    empty = [f"{g.hand} on {g.object}" for g in sets if len(g) == 0]
    sets = [g for g in sets if len(g)]
    hand_specs = _specs("hand", [g.hand for g in sets], recorded, open_hands(hands), hands)
    object_specs = _specs("object", [g.object for g in sets], recorded, open_objects(objects, unit=unit), objects)
    with terminal.progress("reading hands and objects"):
        hand_models = open_hands(list(hand_specs.values()))
        object_models = open_objects(list(object_specs.values()), unit=unit)
    warn_of_damage(terminal, object_models.values())
    terminal.kept = f"Finished pairs are kept in '{out}'; the same command goes on from there."
    start = time.perf_counter()
    with terminal.progress("building", "pairs") as bar:
        result = build_dataset(
            out, sets, hands=hand_models, objects=object_models, config=config,
            workers=workers or available_cpus(), progress=bar,
        )  # fmt: skip
    write_sources(out, hands=hand_specs, objects=object_specs)
    scenes = sum(len(g) for g in sets)
    terminal.say(
        f"{counted(scenes, 'grasp')} of {counted(len(sets), 'pair')} in {time.perf_counter() - start:.1f} s: {out}"
    )
    terminal.facts([("built now", result.built), ("kept from before", result.kept)])
    terminal.notes(empty, title="Left out, for lack of grasps:")
    figures = {"folder": str(out), "pairs": len(sets), "grasps": scenes, "built": result.built, "kept": result.kept}
    return Outcome(result={**figures, "left_out": empty, "wall_s": time.perf_counter() - start})


def read_grasp_files(paths: Sequence[Path]) -> tuple[list[GraspSet], dict[str, dict[str, str]]]:
    """Grasp sets of files and folders, several files of one pair joined; and where their hands and objects were read.

    Raises:
        InputError: a folder without grasp files; DataFormatError: a file that is not one.
    """
    from neuralgrasps.grasps.grasp_io import load_grasps
    from neuralgrasps.grasps.grasp_set import concatenate

    recorded: dict[str, dict[str, str]] = {"hands": {}, "objects": {}}
    by_pair: dict[tuple[str, str], list[GraspSet]] = {}
    for path in paths:
        files = sorted(path.rglob("*.safetensors")) if path.is_dir() else [path]
        if not files:
            raise InputError(f"folder '{path}' holds no grasp files (*.safetensors); make some with synthesise.")
        if path.is_dir():
            for kind, known in read_sources(path).items():
                if kind in recorded and isinstance(known, dict):
                    recorded[kind] |= known
        for file in files:
            grasps = load_grasps(file)
            for kind, name in (("hand", grasps.hand), ("object", grasps.object)):
                if f"{kind}_source" in grasps.config:
                    recorded[f"{kind}s"][name] = grasps.config[f"{kind}_source"]
            by_pair.setdefault((grasps.hand, grasps.object), []).append(grasps)
    if not by_pair:
        raise InputError("no grasp files given; expected files or folders that synthesise wrote.")
    return [concatenate(sets) for sets in by_pair.values()], recorded


def _specs(
    kind: str,
    names: Sequence[str],
    recorded: dict[str, dict[str, str]],
    given: Mapping[str, object],
    given_specs: Sequence[str],
) -> dict[str, str]:
    """Where each named hand or object is to be read from."""
    own = dict(zip(given, map(source_text, given_specs), strict=True))
    known = {**recorded[f"{kind}s"], **own}
    return {name: known.get(name, name) for name in dict.fromkeys(names)}


def info(terminal: Terminal, dataset: PositionalFolder, /) -> Outcome:
    """Show what a dataset holds.

    Args:
        dataset: folder of the dataset.
    """
    from neuralgrasps.dataset.read import read_dataset

    data = read_dataset(dataset)
    config = data.manifest.config
    size = sum(f.stat().st_size for f in dataset.rglob("*") if f.is_file())
    shards = data.manifest.shards
    samples = f"{config.queries_per_scene} per grasp, " + ("stored" if config.store_samples else "computed when read")
    facts: list[tuple[str, Cell]] = [
        ("folder", str(dataset)),
        ("made with", f"neuralgrasps {data.manifest.library_version}, seed {config.seed}"),
        ("grasps", sum(s.scenes for s in shards)),
        ("samples", samples),
        ("size", f"{size / 1e6:.1f} MB"),
    ]
    terminal.facts(facts)
    terminal.table(
        ("object", "hand", "grasps", "train", "test", "spare"),
        [(s.object, s.hand, s.scenes, len(s.split.train), len(s.split.test), len(s.split.spare)) for s in shards],
    )
    result = {
        "folder": str(dataset),
        "library_version": data.manifest.library_version,
        "seed": config.seed,
        "queries_per_grasp": config.queries_per_scene,
        "samples_stored": config.store_samples,
        "size_bytes": size,
        "hands": data.hands,
        "objects": data.objects,
        "grasps": sum(s.scenes for s in shards),
        "pairs": [
            {
                "hand": s.hand,
                "object": s.object,
                "grasps": s.scenes,
                "train": len(s.split.train),
                "test": len(s.split.test),
            }
            for s in shards
        ],
        "sources": read_sources(dataset) if (dataset / SOURCES_FILE).is_file() else {},
    }
    return Outcome(result=result)


def verify(terminal: Terminal, dataset: PositionalFolder, /, *, spot_checks: int = 200) -> Outcome:
    """Check every file of a dataset against its manifest, and some distances against geometry.

    Exit code 1 when something is damaged.

    Args:
        dataset: folder of the dataset.
        spot_checks: sample points per pair whose distance is computed again.
    """
    from neuralgrasps.dataset.read import read_dataset
    from neuralgrasps.dataset.verify import VerifyResult, verify_dataset

    data = read_dataset(dataset)
    try:
        with terminal.progress("verifying"):
            found = verify_dataset(data, spot_checks=spot_checks)
    except DataFormatError as error:  # so damaged that the check could not go on
        found = VerifyResult(problems=(str(error),), files=0, scenes=0, max_error_m=float("nan"))
    terminal.say(f"{dataset}: {'sound' if found.ok else 'DAMAGED'}")
    terminal.facts([("files", found.files or None), ("grasps", found.scenes or None)])
    terminal.notes(found.problems)
    if not found.ok:
        terminal.say("Build it again: only what is damaged is made anew.")
    result = {"ok": found.ok, "problems": found.problems, "files": found.files, "grasps": found.scenes}
    return Outcome(result={**result, "max_error_mm": found.max_error_m * 1e3}, exit_code=0 if found.ok else 1)
