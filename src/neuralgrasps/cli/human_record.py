"""`neuralgrasps human record`: synthetic RGB-D videos of a person's hand that grasps an object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from neuralgrasps.cli.options import Folder, OptionalFloat, Unit, check_seed
from neuralgrasps.cli.outputs import check_writable
from neuralgrasps.cli.terminal import Outcome, Terminal, counted
from neuralgrasps.errors import InputError

if TYPE_CHECKING:
    from neuralgrasps.human.synthetic.demonstration import DemonstrationConfig, RecordedDemonstration
    from neuralgrasps.objects.object_model import ObjectModel

Share = Annotated[
    tuple[float, float] | None, tyro.conf.arg(metavar="LEAST MOST", help_behavior_hint="(default: 0.45 or more)")
]
Either = Annotated[Literal["either", "right", "left"], tyro.conf.arg(metavar="SIDE")]


def human_record(
    terminal: Terminal,
    /,
    *,
    object_name: Annotated[str, tyro.conf.arg(name="object", metavar="NAME|FILE")],
    out: Folder,
    count: int = 1,
    seed: int = 0,
    side: Either = "either",
    scale: OptionalFloat = None,
    kind: Literal["any", "power", "precision"] = "any",
    share: Share = None,
    clutter: int = 0,
    noise: bool = True,
    unit: Unit = "auto",
) -> Outcome:
    """Record synthetic demonstrations: a person's hand comes to an object on a table, grasps it and perhaps lifts it.

    Every grasp held the object in a physics simulation. A folder holds depth, rgb and pose of each frame, camera.json,
    truth.json and truth.safetensors (hand, joints, object, mask, what is visible) and strip.png to look at. The first
    recording of an object takes some seconds longer, while its grasps are made. Exit code 1 when none was recorded.

    Args:
        object_name: name of an object, or a mesh file.
        out: folder for the recording, without one yet; of several, one folder each in it: 000, 001, ...
        count: recordings wanted; each has the seed of the one before plus 1.
        seed: the same seed gives the same recording.
        side: of the hand.
        scale: size of the hand, 0.66 to 0.92 (166 to 232 mm from wrist to middle fingertip); default drawn.
        kind: of the grasp.
        share: of the hand that is seen at the grasp, such as 0.4 0.75 for one that is badly seen: from the object's far
            side, from low down, or past a thing that stands before it. Looked for, not promised: a miss is said.
        clutter: other things on the table.
        noise: the depth has the errors of a structured-light camera, unless --no-noise is given: then it is exact.
        unit: length unit of a mesh file; auto takes over 3 units for mm.
    """
    from neuralgrasps.human.synthetic.demonstration import DemonstrationConfig
    from neuralgrasps.objects.zoo import load_object
    from neuralgrasps.sim.camera import STRUCTURED_LIGHT

    check_seed(seed)
    if count < 1:
        raise InputError(f"--count is {count}; expected at least 1.")
    check_writable(out, folder=True)
    _check_empty(out, count)
    config = DemonstrationConfig(
        side=None if side == "either" else side, scale=scale, kind=kind, share=share,
        clutter=clutter, noise=STRUCTURED_LIGHT if noise else None,
    )  # fmt: skip
    with terminal.progress("reading the object"):
        obj = load_object(object_name, unit=unit)
    rows, records, failures = [], [], []
    with terminal.progress("recording", "videos") as bar:
        for i in range(count):
            folder = _folder(out, i, count)
            made = _recorded(obj, folder, seed + i, config)
            if isinstance(made, str):
                failures.append(made)
            else:
                rows.append(_row(folder, made, share))
                records.append(_record(folder, made))
            bar(i + 1, count)
    if rows:
        asked = () if share is None else ("asked",)
        terminal.table(
            ("folder", "seed", "hand", "scale", "grasp", "frames", "grasp at", "visible there", *asked), rows
        )
    if missed := _missed(records, share):
        terminal.complain(missed)
    terminal.notes(failures, title=f"{counted(len(failures), 'recording')} could not be made:")
    return Outcome(result={"object": obj.name, "recordings": records, "failures": failures}, exit_code=not rows)


def _folder(out: Path, index: int, count: int) -> Path:
    return out if count == 1 else out / f"{index:03d}"


def _check_empty(out: Path, count: int) -> None:
    """Refuse folders that hold a recording: frames of two of them in one folder are none."""
    for folder in (_folder(out, i, count) for i in range(count)):
        if (folder / "truth.json").exists():
            raise InputError(f"--out: '{folder}' holds a recording already; give another folder, or remove it.")


def _missed(records: Sequence[Mapping[str, Any]], share: tuple[float, float] | None) -> str:
    """That recordings show another share of the hand than was asked for, or ""."""
    if share is None:
        return ""
    least, most = share
    off = [r for r in records if not least <= r["visible_at_grasp"] <= most]
    if not off:
        return ""
    seen = ", ".join(f"{100 * r['visible_at_grasp']:.0f} % with seed {r['seed']}" for r in off)
    return (
        f"warning: {len(off)} of {counted(len(records), 'recording')} could not be made with {_percents(share)} of the "
        f"hand visible at the grasp, as asked: {seen}. Try another seed, kind, or range."
    )


def _percents(share: tuple[float, float]) -> str:
    return f"{100 * share[0]:.0f} to {100 * share[1]:.0f} %"


def _recorded(obj: ObjectModel, folder: Path, seed: int, config: DemonstrationConfig) -> RecordedDemonstration | str:
    """The recording, written; or why there is none."""
    from neuralgrasps.human.synthetic.demonstration import NoPersonGraspError, record_demonstration
    from neuralgrasps.human.synthetic.files import write_demonstration

    try:
        recorded = record_demonstration(obj, seed=seed, config=config)
    except NoPersonGraspError as error:
        return str(error)
    write_demonstration(folder, recorded)
    return recorded


def _row(folder: Path, recorded: RecordedDemonstration, share: tuple[float, float] | None) -> tuple[Any, ...]:
    truth = recorded.truth
    visible = f"{100 * truth.visible[truth.grasp_frame]:.0f} %"
    return (
        str(folder), recorded.seed, truth.side, truth.scale, truth.kind, len(recorded), truth.grasp_frame, visible,
        *([] if share is None else [_percents(share)]),
    )  # fmt: skip


def _record(folder: Path, recorded: RecordedDemonstration) -> dict[str, Any]:
    truth = recorded.truth
    return {
        "folder": str(folder), "seed": recorded.seed, "side": truth.side, "scale": truth.scale, "kind": truth.kind,
        "frames": len(recorded), "still": list(truth.still), "grasp_frame": truth.grasp_frame,
        "visible_at_grasp": float(truth.visible[truth.grasp_frame]), "notes": list(truth.notes),
    }  # fmt: skip
