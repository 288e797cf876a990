"""`neuralgrasps dataset`: build from grasp files or from hands and objects, describe, verify."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from neuralgrasps.cli.models import (
    SOURCES_FILE,
    open_hands,
    open_objects,
    read_sources,
    source_text,
    warn_of_damage,
    warn_of_stand_ins,
    write_sources,
)
from neuralgrasps.cli.options import Folder, Names, OptionalInt, PositionalFolder, Unit, Workers, check_seed
from neuralgrasps.cli.outputs import check_writable
from neuralgrasps.cli.terminal import Cell, Outcome, Terminal, counted
from neuralgrasps.errors import DataFormatError, InputError, UnknownNameError, unknown_name

if TYPE_CHECKING:
    from neuralgrasps.dataset.read import GraspDataset
    from neuralgrasps.grasps.grasp_set import GraspSet
    from neuralgrasps.hands.hand import Hand
    from neuralgrasps.objects.object_model import ObjectModel

MADE_HERE = "synthesised"  # folder within a dataset for grasps that its build made


@dataclass(frozen=True, slots=True, kw_only=True)
class _Given:
    """What a dataset is built from: grasp sets, and the models and sources of their hands and objects by name."""

    sets: list[GraspSet]
    hands: Mapping[str, Hand]
    objects: Mapping[str, ObjectModel]
    hand_sources: Mapping[str, str]
    object_sources: Mapping[str, str]


def build(
    terminal: Terminal,
    grasps: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[FILE|DIR ...]")] = (),
    /,
    *,
    out: Folder = Path("dataset"),
    hands: Names = (),
    objects: Names = (),
    count: OptionalInt = None,
    hold_out: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...", help_behavior_hint="(default: none)")] = (),
    clouds: Literal["none", "exact", "rendered"] = "none",
    cloud_points: int = 4096,
    unit: Unit = "auto",
    seed: int = 0,
    queries: int = 40_000,
    store_samples: bool = False,
    workers: Workers = None,
) -> Outcome:
    """Build a dataset for training: contact maps, splits, signed-distance samples and point clouds.

    From grasp files; or from --hands and --objects alone, whose grasps are made first. A build that was stopped goes
    on where it was. Samples are computed when read, unless --store-samples.

    Args:
        grasps: grasp files, or folders of them as `synthesise` writes.
        out: folder of the dataset.
        hands: hands to make grasps of, or all; with grasp files, files of hands that those do not name.
        objects: the same for objects; ycb7 are the seven of the YCB set.
        count: grasps wanted per pair where they are made here; 60 if not given.
        hold_out: hands and objects all of whose grasps are for testing.
        clouds: store point clouds of object and hand: exact surface samples, or rendered by 128 cameras.
        cloud_points: points of each cloud.
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
    config = DatasetConfig(
        seed=seed, queries_per_scene=queries, store_samples=store_samples, clouds=clouds, cloud_points=cloud_points
    )
    terminal.kept = f"Finished pairs are kept in '{out}'; the same command goes on from there."
    if grasps and count is not None:
        raise InputError("--count is how many grasps to make, but grasp files are given; leave out one of them.")
    if grasps:
        given = _from_files(terminal, grasps, hands, objects, unit)
    else:
        given = _synthesised(
            terminal, out / MADE_HERE, hands, objects, count=60 if count is None else count, seed=seed, unit=unit,
            workers=workers, hold_out=hold_out,
        )  # fmt: skip
    empty = [f"{g.hand} on {g.object}" for g in given.sets if len(g) == 0]
    sets = [g for g in given.sets if len(g)]
    start = time.perf_counter()
    with terminal.progress("building", "pairs") as bar:
        result = build_dataset(
            out, sets, hands=given.hands, objects=given.objects, config=config, hold_out=_own_names(hold_out, given),
            workers=workers or available_cpus(), progress=bar,
        )  # fmt: skip
    write_sources(out, hands=given.hand_sources, objects=given.object_sources)
    scenes = sum(len(g) for g in sets)
    terminal.say(
        f"{counted(scenes, 'grasp')} of {counted(len(sets), 'pair')} in {time.perf_counter() - start:.1f} s: {out}"
    )
    held = [*result.manifest.held_out_hands, *result.manifest.held_out_objects]
    terminal.facts([("built now", result.built), ("kept from before", result.kept), ("held out", ", ".join(held))])
    terminal.notes(empty, title="Left out, for lack of grasps:")
    figures = {"folder": str(out), "pairs": len(sets), "grasps": scenes, "built": result.built, "kept": result.kept}
    return Outcome(result={**figures, "held_out": held, "left_out": empty, "wall_s": time.perf_counter() - start})


def _from_files(
    terminal: Terminal, paths: Sequence[Path], hands: Sequence[str], objects: Sequence[str], unit: str
) -> _Given:
    sets, recorded = read_grasp_files(paths)
    used = [g for g in sets if len(g)]
    hand_specs = _specs("hand", [g.hand for g in used], recorded, open_hands(hands), hands)
    object_specs = _specs("object", [g.object for g in used], recorded, open_objects(objects, unit=unit), objects)
    with terminal.progress("reading hands and objects"):
        hand_models = open_hands(list(hand_specs.values()))
        object_models = open_objects(list(object_specs.values()), unit=unit)
    warn_of_damage(terminal, object_models.values())
    return _Given(
        sets=sets, hands=hand_models, objects=object_models, hand_sources=hand_specs, object_sources=object_specs
    )


def _synthesised(
    terminal: Terminal,
    folder: Path,
    hands: Sequence[str],
    objects: Sequence[str],
    *,
    count: int,
    seed: int,
    unit: str,
    workers: int | None,
    hold_out: Sequence[str],
) -> _Given:
    """Grasps of every hand on every object, made in `folder` or kept there from an earlier run."""
    from neuralgrasps.dataset.collect import collect_grasps
    from neuralgrasps.dataset.splits import sort_held_out
    from neuralgrasps.hands.zoo import hand_sources
    from neuralgrasps.objects.zoo import object_sources
    from neuralgrasps.synthesis.synthesise import SynthesisConfig

    if not objects:
        raise InputError(
            "nothing to build from: give grasp files or folders of them, or --objects (and --hands) to make grasps of."
        )
    config = SynthesisConfig(count=count)
    hand_specs, object_specs = hand_sources(hands), object_sources(objects)
    with terminal.progress("reading hands and objects"):
        hand_models, object_models = open_hands(hand_specs), open_objects(object_specs, unit=unit)
    given = _Given(
        sets=[],
        hands=hand_models,
        objects=object_models,
        hand_sources=dict(zip(hand_models, map(source_text, hand_specs), strict=True)),
        object_sources=dict(zip(object_models, map(source_text, object_specs), strict=True)),
    )
    sort_held_out([(h, o) for h in hand_models for o in object_models], _own_names(hold_out, given))  # before the work
    warn_of_damage(terminal, object_models.values())
    warn_of_stand_ins(terminal, given.object_sources, object_models)
    pairs = f"{counted(len(hand_models), 'hand')} on {counted(len(object_models), 'object')}"
    with terminal.progress(f"grasps of {pairs}", "pairs") as bar:
        sets, records = collect_grasps(
            folder, list(hand_models.values()), list(object_models.values()), config=config, seed=seed,
            workers=workers, progress=bar,
        )  # fmt: skip
    terminal.notes([f"{r.hand} on {r.object}: {r.reason}" for r in records if r.reason], title="Fewer than wanted:")
    return replace(given, sets=sets)


def _own_names(names: Sequence[str], given: _Given) -> list[str]:
    """Hands and objects of --hold-out as the dataset calls them, also where they are named as they were asked for.

    Raises:
        UnknownNameError: neither a hand nor an object of the dataset, nor a YCB id or file of one.
    """
    asked = {spec: name for known in (given.hand_sources, given.object_sources) for name, spec in known.items()}
    own = [asked.get(source_text(name), name) for name in names]
    for name in own:
        if name not in given.hands and name not in given.objects:
            raise UnknownNameError(f"--hold-out: {unknown_name('name', name, [*given.hands, *given.objects])}")
    return own


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
    from neuralgrasps.dataset.splits import TEST_LIMIT, TRAIN_LIMIT
    from neuralgrasps.dataset.verify import short_files

    data = read_dataset(dataset)
    damaged = short_files(data)
    record = _record(dataset, data) | {"damaged": damaged}
    _show_info(terminal, data, record)
    terminal.say(
        f"train: what a run is fitted to; test: what it must not see; spare: beyond {TRAIN_LIMIT} and {TEST_LIMIT} "
        "of a pair, used by neither."
    )
    terminal.notes(damaged, title="DAMAGED (`dataset verify` checks the content of all files):")
    return Outcome(result=record)


def _record(dataset: Path, data: GraspDataset) -> dict[str, Any]:
    """What a dataset holds, as a JSON object."""
    manifest, config = data.manifest, data.manifest.config
    splits = [(s, data.split(s.hand, s.object)) for s in manifest.shards]
    return {
        "folder": str(dataset),
        "library_version": manifest.library_version,
        "seed": config.seed,
        "queries_per_grasp": config.queries_per_scene,
        "samples_stored": config.store_samples,
        "clouds": config.clouds,
        "cloud_points": config.cloud_points if config.clouds != "none" else 0,
        "held_out_hands": manifest.held_out_hands,
        "held_out_objects": manifest.held_out_objects,
        "size_bytes": sum(f.stat().st_size for f in dataset.rglob("*") if f.is_file()),
        "hands": data.hands,
        "objects": data.objects,
        "grasps": sum(s.scenes for s in manifest.shards),
        "pairs": [
            {"hand": s.hand, "object": s.object, "grasps": s.scenes, "train": len(split.train), "test": len(split.test)}
            for s, split in splits
        ],
        "sources": read_sources(dataset) if (dataset / SOURCES_FILE).is_file() else {},
    }  # fmt: skip


def _show_info(terminal: Terminal, data: GraspDataset, record: Mapping[str, Any]) -> None:
    clouds, stored = record["clouds"], "stored" if record["samples_stored"] else "computed when read"
    facts: list[tuple[str, Cell]] = [
        ("folder", record["folder"]),
        ("made with", f"neuralgrasps {record['library_version']}, seed {record['seed']}"),
        ("grasps", record["grasps"]),
        ("samples", f"{record['queries_per_grasp']} per grasp, {stored}"),
        ("point clouds", f"{clouds}, {record['cloud_points']} points each" if clouds != "none" else "none stored"),
        ("held out", ", ".join([*record["held_out_hands"], *record["held_out_objects"]]) or "no hand, no object"),
        ("size", f"{record['size_bytes'] / 1e6:.1f} MB"),
    ]
    terminal.facts(facts)
    rows = [
        (p["object"], p["hand"], p["grasps"], p["train"], p["test"], len(data.split(p["hand"], p["object"]).spare))
        for p in record["pairs"]
    ]
    terminal.table(("object", "hand", "grasps", "train", "test", "spare"), rows)


def verify(terminal: Terminal, dataset: PositionalFolder, /, *, spot_checks: int = 200) -> Outcome:
    """Check every file of a dataset against its manifest, and some distances against geometry.

    Exit code 1 when something is damaged.

    Args:
        dataset: folder of the dataset.
        spot_checks: sample points per pair whose distance is computed again; 0: files only.
    """
    from neuralgrasps.dataset.read import read_dataset
    from neuralgrasps.dataset.verify import VerifyResult, verify_dataset

    if spot_checks < 0:
        raise InputError(f"--spot-checks is {spot_checks}; expected 0 (files only) or more.")
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
