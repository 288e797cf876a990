"""Objects by name or file: built-in stand-ins, imported and downloaded meshes, any mesh file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from neuralgrasps.errors import InputError, unknown_name
from neuralgrasps.geometry.mesh import LengthUnit, load_mesh
from neuralgrasps.objects.build import object_from_mesh
from neuralgrasps.objects.builtin import STAND_INS, StandIn, find_stand_in
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.store import imported_names, stored_mesh_file, stored_notes
from neuralgrasps.objects.ycb_facts import YCB_MASSES_KG

OBJECT_GROUPS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"ycb7": tuple(stand_in.ycb_id for stand_in in STAND_INS.values())}  # the objects of Khargonkar et al. 2022
)
"""Names that stand for several objects wherever objects are listed."""
_MESH_SUFFIXES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf", ".dae", ".3mf")


def object_names() -> tuple[str, ...]:
    """Names that `load_object` knows: the seven stand-ins, then whatever was imported or downloaded."""
    return (*STAND_INS, *(n for n in imported_names() if n not in STAND_INS))


def object_sources(given: Sequence[str]) -> tuple[str, ...]:
    """Names or paths of objects to load; a group's name stands for its objects, a folder for its mesh files, sorted.

    Raises:
        InputError: a mesh file is missing, a folder holds no mesh, or no object is given.
    """
    sources: list[str] = []
    for text in given:
        if text in OBJECT_GROUPS:
            sources += OBJECT_GROUPS[text]
            continue
        folder = Path(text)
        if folder.suffix.lower() in _MESH_SUFFIXES and not folder.exists():
            raise InputError(f"mesh file '{folder}' does not exist; check the path.")
        if not folder.is_dir():
            sources.append(text)
            continue
        found = sorted(p for p in folder.iterdir() if p.suffix.lower() in _MESH_SUFFIXES)
        if not found:
            raise InputError(f"folder '{folder}' holds no mesh; expected files ending in {', '.join(_MESH_SUFFIXES)}.")
        sources += map(str, found)
    if not sources:
        raise InputError(
            f"no object was given; expected names, groups ({', '.join(OBJECT_GROUPS)}), mesh files or folders of them."
        )
    return tuple(sources)


def load_object(
    name_or_path: str | Path, *, unit: LengthUnit = "auto", mass_kg: float | None = None, friction: float = 0.6
) -> ObjectModel:
    """An object by name, or from a mesh file.

    A short name ("cracker_box") is the built-in stand-in. A YCB id ("003_cracker_box") is the downloaded or
    imported mesh of that name when there is one, else the stand-in; `provenance["source"]` says which.

    Args:
        name_or_path: a name from `object_names()`, a YCB id, or the path of a mesh file (its frame is kept).
        unit: length unit of a mesh file; ignored for names.
        mass_kg: default the published mass for YCB names, else guessed from the volume (see `provenance["mass"]`).
        friction: Coulomb coefficient against a finger pad.
    Raises:
        UnknownNameError: no such name and no such file.
        MeshError: the file cannot be read or encloses no volume.
        InputError: `unit`, `mass_kg` or `friction` cannot be used.
    """
    text = str(name_or_path)
    if isinstance(name_or_path, Path) or _looks_like_path(text):
        return _from_file(Path(name_or_path), unit=unit, mass_kg=mass_kg, friction=friction)
    stand_in = STAND_INS.get(text)
    if stand_in is None and (stored := stored_mesh_file(text)) is not None:
        return _from_store(text, stored, mass_kg=mass_kg, friction=friction)
    stand_in = stand_in or find_stand_in(text)
    if stand_in is None:
        raise unknown_name("object", text, (*object_names(), *OBJECT_GROUPS["ycb7"]))
    return _from_stand_in(stand_in, mass_kg=mass_kg, friction=friction)


def _looks_like_path(text: str) -> bool:
    return "/" in text or "\\" in text or text.lower().endswith(_MESH_SUFFIXES)


def _from_stand_in(stand_in: StandIn, *, mass_kg: float | None, friction: float) -> ObjectModel:
    notes = {
        "source": f"stand-in for YCB {stand_in.ycb_id}, generated from its published size",
        "licence": "MIT (part of this library)",
        "unit": "m",
    }
    if mass_kg is None:
        mass_kg = stand_in.mass_kg
        notes["mass"] = "published (Calli et al. 2015)"
    mesh = stand_in.build(stand_in.size_m)
    return object_from_mesh(stand_in.name, mesh, mass_kg=mass_kg, friction=friction, provenance=notes)


def _from_file(path: Path, *, unit: LengthUnit, mass_kg: float | None, friction: float) -> ObjectModel:
    loaded = load_mesh(path, unit=unit)
    notes = {"source": str(path), "licence": "unknown: the user's file"}
    notes["unit"] = _unit_note(unit, loaded.repairs)
    if loaded.repairs:
        notes["repairs"] = "; ".join(loaded.repairs)
    mass_kg = _published_mass(path.stem, mass_kg, notes)
    return object_from_mesh(path.stem, loaded.mesh, mass_kg=mass_kg, friction=friction, provenance=notes)


def _from_store(name: str, path: Path, *, mass_kg: float | None, friction: float) -> ObjectModel:
    loaded = load_mesh(path, unit="m")
    notes = dict(stored_notes(name))
    file_unit = notes.pop("file_unit", "m")
    notes["unit"] = "m" if file_unit == "m" else f"m; the imported file was in {file_unit}"
    mass_kg = _published_mass(name, mass_kg, notes)
    return object_from_mesh(name, loaded.mesh, mass_kg=mass_kg, friction=friction, provenance=notes)


def _published_mass(name: str, mass_kg: float | None, notes: dict[str, str]) -> float | None:
    if mass_kg is None and name in YCB_MASSES_KG:
        notes["mass"] = "published (Calli et al. 2015)"
        return YCB_MASSES_KG[name]
    return mass_kg


def _unit_note(unit: str, repairs: tuple[str, ...]) -> str:
    if unit != "auto":
        return f"{unit}, as given"
    guess = next((r for r in repairs if "unit" in r), None)
    return f"guessed: {guess}" if guess else "guessed: m, since no extent is over 3"
