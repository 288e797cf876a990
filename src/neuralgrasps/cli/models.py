"""Hands and objects by name or file, and where those of a dataset or run come from."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuralgrasps.errors import DataFormatError, InputError, NeuralGraspsError
from neuralgrasps.files import write_whole

if TYPE_CHECKING:
    from neuralgrasps.cli.terminal import Terminal
    from neuralgrasps.dataset.read import GraspDataset
    from neuralgrasps.hands.hand import Hand
    from neuralgrasps.objects.object_model import ObjectModel

SOURCES_FILE = "sources.json"


def source_text(spec: str) -> str:
    """A name as it is, a path made absolute, so that it can be found from another folder."""
    return str(Path(spec).resolve()) if Path(spec).exists() else spec


def open_hands(specs: Sequence[str]) -> dict[str, Hand]:
    """Hands by their own names, in the order given.

    Raises:
        InputError: two of them have the same name.
    """
    from neuralgrasps.hands.zoo import load_hand

    return _by_name("hand", specs, [load_hand(spec) for spec in specs])


def open_objects(specs: Sequence[str], *, unit: str = "auto", mass_kg: float | None = None) -> dict[str, ObjectModel]:
    """Objects by their own names, in the order given; `unit` is of mesh files, `mass_kg` of each (None: its own).

    Raises:
        InputError: two of them have the same name.
    """
    from neuralgrasps.objects.zoo import load_object

    return _by_name("object", specs, [load_object(spec, unit=unit, mass_kg=mass_kg) for spec in specs])  # type: ignore[arg-type]


def warn_of_damage(terminal: Terminal, objects: Iterable[ObjectModel]) -> None:
    """A line on stderr for each object whose file had vertices or faces that had to be dropped."""
    for obj in objects:
        repairs = obj.provenance.get("repairs", "").split("; ")
        damage = [line for line in repairs if "finite" in line]
        if damage:
            terminal.complain(
                f"warning: '{obj.name}': {'; '.join(damage)}. Its surface may have holes; export it again."
            )
        if any(line.startswith("took the file's unit for mm") for line in repairs):
            extent = 1e3 * float(obj.mesh.extents.max())
            terminal.complain(
                f"note: '{obj.name}': the file's numbers are taken as millimetres; it is {extent:.0f} mm long."
            )


def warn_of_stand_ins(terminal: Terminal, specs: Mapping[str, str], objects: Mapping[str, ObjectModel]) -> None:
    """A line on stderr when scans asked for by their YCB ids (`specs` by object name) are not there."""
    replaced = [
        spec
        for name, spec in specs.items()
        if spec != name and objects[name].provenance.get("source", "").startswith("stand-in for YCB")
    ]
    if replaced:
        terminal.complain(
            f"note: {', '.join(replaced)}: no scan is here; built-in shapes of the published size stand in. "
            "Get the scans with: neuralgrasps objects download ycb"
        )


def warn_of_guesses(terminal: Terminal, hands: Iterable[Hand], *, power_share: float | None) -> None:
    """Lines on stderr: what is doubtful about hands read without notes, and options that jaws make no use of."""
    for hand in hands:
        for line in hand.extra.get("annotated", "").splitlines():
            if "looks wrong" in line or "state 'fingers'" in line:
                terminal.complain(f"warning: '{hand.name}': {line}")
        if power_share is not None and hand.is_jaw:
            terminal.complain(f"warning: --power-share is ignored: '{hand.name}' is a parallel jaw.")


def open_readable(
    specs: Sequence[str], *, named: Sequence[str], unit: str = "auto", mass_kg: float | None = None
) -> tuple[dict[str, ObjectModel], dict[str, str], dict[str, str]]:
    """`open_objects`, but a file that no one named (it was in a folder) and that cannot be used is left out.

    Returns:
        objects by name; their names or files, by name; and why others were left out, by file.
    Raises:
        NeuralGraspsError: one of `named` cannot be used, or none at all.
    """
    from neuralgrasps.objects.zoo import load_object

    kept: list[str] = []
    models: list[ObjectModel] = []
    skipped: dict[str, str] = {}
    for spec in specs:
        try:
            models.append(load_object(spec, unit=unit, mass_kg=mass_kg))  # type: ignore[arg-type]
            kept.append(spec)
        except NeuralGraspsError as error:
            if spec in named or len(specs) == 1:
                raise
            skipped[spec] = str(error)
    if not models:
        raise InputError(f"none of {len(specs)} mesh files can be used; the first: {next(iter(skipped.values()))}")
    found = _by_name("object", kept, models)
    return found, dict(zip(found, kept, strict=True)), skipped


def _by_name(kind: str, specs: Sequence[str], models: Sequence[Any]) -> dict[str, Any]:
    named: dict[str, Any] = {}
    for spec, model in zip(specs, models, strict=True):
        if model.name in named:
            raise InputError(f"'{spec}' is the second {kind} named '{model.name}'; give each {kind} once.")
        named[model.name] = model
    return named


def write_sources(folder: Path, *, hands: Mapping[str, str], objects: Mapping[str, str], dataset: str = "") -> None:
    """Remember beside a dataset or run which files its hands and objects were read from."""
    record = {"hands": dict(hands), "objects": dict(objects)} | ({"dataset": dataset} if dataset else {})
    write_whole(folder / SOURCES_FILE, json.dumps(record, indent=1, sort_keys=True) + "\n")


def read_sources(folder: Path) -> dict[str, dict[str, str] | str]:
    """What `write_sources` wrote; nothing when it is missing or damaged (names are then looked up as they are)."""
    try:
        record = json.loads((folder / SOURCES_FILE).read_text(encoding="utf-8"))
        return record if isinstance(record, dict) else {}
    except (OSError, ValueError):
        return {}


def hands_of(names: Sequence[str], folder: Path, given: Sequence[str]) -> dict[str, Hand]:
    """The named hands: from `given` names or files, else from where they were read when `folder` was made.

    Raises:
        InputError: one cannot be found; the message says how to give it.
    """
    from neuralgrasps.hands.zoo import load_hand

    known = open_hands(given)
    recorded = read_sources(folder).get("hands", {})
    for name in names:
        if name in known:
            continue
        spec = recorded.get(name, name) if isinstance(recorded, dict) else name
        try:
            hand = load_hand(spec)
        except NeuralGraspsError as error:
            raise InputError(f"hand '{name}' of '{folder}' is needed: {error} Give its file with --hands.") from error
        known[name] = hand
    return {name: known[name] for name in names}


def dataset_hands(dataset: GraspDataset, given: Sequence[str]) -> dict[str, Hand]:
    """The hands of a dataset, checked to be the models that it was built with."""
    from neuralgrasps.dataset.build import HAND_POINT_SPACING_M
    from neuralgrasps.dataset.shards import fingerprint_of
    from neuralgrasps.hands.packed import pack_hand

    hands = hands_of(dataset.hands, dataset.folder, given)
    for name, hand in hands.items():
        if fingerprint_of(pack_hand(hand, spacing=HAND_POINT_SPACING_M)) != dataset.manifest.hands[name].fingerprint:
            raise InputError(
                f"hand '{name}' is not the model that '{dataset.folder}' was built with; give that one with --hands, "
                "or build the dataset again."
            )
    return hands


def dataset_objects(dataset: GraspDataset) -> dict[str, ObjectModel]:
    """The objects of a dataset, from the surfaces stored in it."""
    from neuralgrasps.objects.build import object_from_mesh

    notes = {"source": f"dataset {dataset.folder}"}
    return {name: object_from_mesh(name, dataset.object(name).mesh, provenance=notes) for name in dataset.objects}


def run_objects(folder: Path, names: Sequence[str], given: Sequence[str]) -> dict[str, ObjectModel]:
    """The objects of a fitted run: `given` ones, else those of its dataset, else by name.

    Of a given folder, only files with the names of the run's objects are read.

    Raises:
        InputError: one cannot be found; the message says how to give it.
    """
    from neuralgrasps.dataset.read import read_dataset
    from neuralgrasps.objects.zoo import load_object, object_sources

    sources = object_sources(given) if given else ()
    wanted = [text for text in sources if text in given or Path(text).stem in names]
    found = open_objects(wanted)
    home = read_sources(folder).get("dataset", "")
    if home and not set(names) <= set(found):
        try:
            stored = dataset_objects(read_dataset(str(home)))
            found = {**stored, **found}
        except (DataFormatError, OSError):
            pass  # moved or deleted: look the names up
    for name in names:
        if name not in found:
            try:
                found[name] = load_object(name)
            except NeuralGraspsError as error:
                raise InputError(
                    f"object '{name}' of '{folder}' is needed: {error} Give its file with --objects."
                ) from error
    return {name: found[name] for name in names}
