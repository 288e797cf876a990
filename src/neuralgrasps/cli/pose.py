"""`neuralgrasps pose`: where known objects are, in depth images or point clouds."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from neuralgrasps.cli.compiling import BEGINS, compile_clock
from neuralgrasps.cli.models import open_readable, warn_of_damage, warn_of_stand_ins
from neuralgrasps.cli.options import Unit, check_seed
from neuralgrasps.cli.outputs import check_writable
from neuralgrasps.cli.pose_files import PoseFiles
from neuralgrasps.cli.pose_find import Finding, find_in
from neuralgrasps.cli.pose_hints import LONE_NOTE
from neuralgrasps.cli.pose_input import Pending, PoseSource, SourceOptions, list_sources
from neuralgrasps.cli.pose_show import frame_record, show_finding
from neuralgrasps.cli.terminal import Outcome, Terminal, counted
from neuralgrasps.errors import InputError

if TYPE_CHECKING:
    from neuralgrasps.cli.compiling import CompileClock
    from neuralgrasps.objects.object_model import ObjectModel

ObjectNames = Annotated[
    tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="NAME|FILE|DIR ...", help_behavior_hint="(required)")
]
_NOTHING_GIVEN = PoseSource()
OptionalOut = Annotated[Path | None, tyro.conf.arg(metavar="FILE.png|DIR", help_behavior_hint="(optional)")]


def pose(
    terminal: Terminal,
    objects: ObjectNames,
    /,
    *,
    source: SourceOptions = _NOTHING_GIVEN,
    track: bool = False,
    unit: Unit = "auto",
    out: OptionalOut = None,
    seed: int = 0,
) -> Outcome:
    """Find objects in depth images, or in a cloud of one object's points.

    Prints X_CO, the object in the camera frame (x right, y down, z forward, metres), with a confidence, its spread
    and the other poses that fit. Confidence is the probability that it is this object in this pose; at 50 % and more
    the object counts as found. Depth only, colour is just drawn over. A mask helps where a cluster is missed. Several
    objects with a mask or cloud: says which one it is. Exit code 1 when nothing is found.

    Example: neuralgrasps pose ycb7 --depth depth.png --colour color.png --depth-scale 10000 --fx 1066.8 --fy 1067.5
    --cx 313.0 --cy 241.3 --out found

    Args:
        objects: names of objects, groups such as ycb7, mesh files or folders of them.
        source: what to look at.
        track: the frames are a sequence: start each from the poses in the one before.
        unit: length unit of mesh files.
        out: picture of the poses over the image, or a folder for pictures, poses.json and index.html.
        seed: of the search.
    """
    check_seed(seed)
    sources = list_sources(source)
    _check_options(source, out, track=track)
    with compile_clock(lambda: terminal.complain(BEGINS)) as clock:
        models = _load(terminal, objects, unit)
        files = None if out is None else PoseFiles(out, [obj.name for obj in models], frames=len(sources))
        findings = _find_all(terminal, models, sources, source, seed=seed, track=track, files=files, clock=clock)
    in_scene = source.cloud is None and source.mask is None
    alone = len(models) == 1 and not in_scene
    for finding, record in findings:
        show_finding(terminal, finding, record, title=f"[{finding.name}]" if len(sources) > 1 else "", alone=alone)
    if len(models) == 1 and in_scene:
        terminal.say(f"note: {LONE_NOTE}")
    found = sum(len(finding.found) for finding, _ in findings)
    if len(sources) > 1:
        terminal.say(f"{counted(found, 'object')} found in {counted(len(sources), 'frame')}.")
    records = [record for _, record in findings]
    result: dict[str, Any] = {"frames": records, "found": found, "seed": seed, "compile_s": clock.seconds}
    if alone:
        result |= (records[0]["objects"] or records[0]["rejected"])[0] | {"wall_s": findings[0][0].wall_s}
    if files is not None:
        result |= files.finish(terminal, result)
    return Outcome(result=result, exit_code=0 if found else 1)


def _check_options(source: PoseSource, out: Path | None, *, track: bool) -> None:
    """Refuse what cannot be written, and options without a use here."""
    if track and source.frames is None:
        raise InputError("--track follows objects through the frames of a sequence; it goes with --frames FOLDER.")
    if out is None:
        return
    if source.cloud is not None:
        raise InputError("--out draws over a depth image; give --depth FILE instead of --cloud.")
    is_picture = out.suffix.lower() == ".png"
    if out.suffix and not is_picture and not out.is_dir():
        raise InputError(f"--out is '{out}'; expected a file ending in .png, or a folder.")
    if is_picture and source.frames is not None:
        raise InputError(f"--out is one picture, '{out}', but --frames may hold several frames; give a folder.")
    check_writable(out, folder=not is_picture)


def _load(terminal: Terminal, objects: Sequence[str], unit: Unit) -> list[ObjectModel]:
    from neuralgrasps.objects.zoo import object_sources
    from neuralgrasps.perception.pose_model import pose_model

    specs = object_sources(objects)
    with terminal.progress("reading the objects" if len(specs) > 1 else "reading the object"):
        models, files, skipped = open_readable(specs, named=tuple(objects), unit=unit)
        for obj in models.values():
            pose_model(obj)  # kept in memory: no part of the time per frame
    warn_of_damage(terminal, models.values())
    warn_of_stand_ins(terminal, files, models)
    for file, reason in skipped.items():
        terminal.complain(f"warning: '{file}' is left out: {reason}")
    return list(models.values())


def _find_all(
    terminal: Terminal,
    models: Sequence[ObjectModel],
    sources: Sequence[Pending],
    source: PoseSource,
    *,
    seed: int,
    track: bool,
    files: PoseFiles | None,
    clock: CompileClock,
) -> list[tuple[Finding, dict[str, Any]]]:
    """Findings and their records, frame by frame; of several frames one may fail.

    Raises:
        InputError: no frame can be used.
    """
    out: list[tuple[Finding, dict[str, Any]]] = []
    before: Finding | None = None
    failed: list[InputError] = []
    with terminal.progress("searching", "frames") as bar:
        for number, pending in enumerate(sources):
            try:
                seen = pending.read()
                start = time.perf_counter() - clock.seconds
                finding = find_in(models, seen, source, seed=seed, before=before)
                finding = replace(finding, wall_s=time.perf_counter() - clock.seconds - start)
                before = finding if track else None
            except InputError as error:
                failed.append(error)
                if len(failed) == len(sources):
                    raise failed[0] from None
                finding = Finding(name=pending.name, problem=str(error), missing=tuple(obj.name for obj in models))
            record = frame_record(finding)
            if files is not None:
                files.add(finding, record)
            out.append((replace(finding, frame=None), record))  # pictures are let go
            bar(number + 1, len(sources), pending.name)
    return out
