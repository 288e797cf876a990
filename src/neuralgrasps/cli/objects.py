"""`neuralgrasps objects`: list, show, import and download."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from neuralgrasps.cli.models import warn_of_damage
from neuralgrasps.cli.options import NamePath, OptionalFile, OptionalFloat, OptionalText, Unit
from neuralgrasps.cli.outputs import check_writable, make_parent
from neuralgrasps.cli.terminal import Outcome, Terminal

if TYPE_CHECKING:
    from neuralgrasps.objects.object_model import ObjectModel


def list_objects(terminal: Terminal, /) -> Outcome:
    """List the built-in objects, and those imported or downloaded."""
    from neuralgrasps.objects.builtin import STAND_INS
    from neuralgrasps.objects.cache import home_folder
    from neuralgrasps.objects.store import imported_names, stored_notes

    rows: list[tuple[Any, ...]] = []
    for item in STAND_INS.values():
        size = " x ".join(f"{1e3 * s:.0f}" for s in item.size_m)
        rows.append((item.name, size, f"{1e3 * item.mass_kg:.0f}", f"built-in ({item.ycb_id})"))
    rows += [(name, None, None, stored_notes(name).get("source", "imported")) for name in imported_names()]
    terminal.table(("object", "size mm", "mass g", "source"), rows)
    terminal.say(f"Imported and downloaded objects are kept in {home_folder()}")
    return Outcome(result={"objects": [{"name": r[0], "source": r[3]} for r in rows], "home": str(home_folder())})


def show_object(
    terminal: Terminal,
    name: NamePath,
    /,
    *,
    unit: Unit = "auto",
    mass_kg: OptionalFloat = None,
    picture: OptionalFile = None,
) -> Outcome:
    """Show size, mass, symmetry and provenance of an object.

    Args:
        name: name of an object, or a mesh file.
        unit: length unit of a mesh file; auto takes over 3 units for mm.
        mass_kg: mass; default the published one, or guessed from the volume.
        picture: PNG file to draw the object into.
    """
    from neuralgrasps.objects.zoo import load_object

    if picture is not None:
        check_writable(picture)
    with terminal.progress("reading the object"):
        obj = load_object(name, unit=unit, mass_kg=mass_kg)
    warn_of_damage(terminal, [obj])
    terminal.say(obj.name)
    terminal.facts(_facts(obj))
    if picture is not None:
        from neuralgrasps.report.figures import render_object, save_picture

        make_parent(picture)
        save_picture(picture, render_object(obj, size=(640, 560)), background="#ffffff")
        terminal.say(f"Picture: {picture}")
    return Outcome(result={**object_record(obj), **({"picture": str(picture)} if picture else {})})


def import_mesh(
    terminal: Terminal,
    path: NamePath,
    /,
    *,
    name: OptionalText = None,
    unit: Unit = "auto",
    licence: str = "unknown: the user's file",
    replace: bool = False,
) -> Outcome:
    """Keep a mesh file, repaired and in metres, so that every verb finds it by name.

    Args:
        path: OBJ, PLY, STL, OFF, GLB, GLTF, DAE or 3MF file; its frame is kept.
        name: its name; default the file's.
        unit: length unit of the file; auto takes over 3 units for mm.
        licence: recorded with it.
        replace: replace an object of the same name.
    """
    from neuralgrasps.objects.ycb import import_object
    from neuralgrasps.objects.zoo import load_object

    with terminal.progress("reading the mesh"):
        known = import_object(path, name, unit, licence=licence, replace=replace)
        obj = load_object(known)
    warn_of_damage(terminal, [obj])
    terminal.say(f"imported as '{known}'")
    terminal.facts(_facts(obj))
    return Outcome(result=object_record(obj))


def download(
    terminal: Terminal,
    collection: Annotated[Literal["ycb"], tyro.conf.Positional],
    names: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[NAME ...]")] = (),
    /,
) -> Outcome:
    """Download scanned objects from their publisher.

    Args:
        collection: ycb, the YCB object and model set (CC BY 4.0).
        names: ids such as 006_mustard_bottle; default the originals of the seven built-in objects.
    """
    from neuralgrasps.objects.ycb import download_ycb

    terminal.kept = "What was received is kept; the same command goes on from there."
    with terminal.progress("downloading", "kB") as bar:
        found = download_ycb(
            names or None, progress=lambda name, done, total: bar(done // 1000, (total or 0) // 1000, name)
        )
    terminal.notes(found, title=f"{len(found)} objects are ready:")
    return Outcome(result={"collection": collection, "objects": found})


def _facts(obj: ObjectModel) -> list[tuple[str, str | float | int]]:
    size = " x ".join(f"{1e3 * s:.1f}" for s in obj.mesh.extents)
    facts: list[tuple[str, str | float | int]] = [
        ("size", f"{size} mm"),
        ("mass", f"{1e3 * obj.mass_kg:.0f} g"),
        ("friction", f"{obj.friction:g}"),
        ("mesh", f"{len(obj.mesh.vertices)} vertices, {len(obj.mesh.faces)} faces"),
    ]
    skipped = ("convex_protrusion_p95_mm", "convex_protrusion_max_mm", "convex_gap_p95_mm", "convex_gap_max_mm")
    facts += [(key.replace("_", " "), text) for key, text in obj.provenance.items() if key not in (*skipped, "mass")]
    if "mass" in obj.provenance:
        facts.insert(2, ("mass from", obj.provenance["mass"]))
    return facts


def object_record(obj: ObjectModel) -> dict[str, Any]:
    """An object as JSON."""
    return {
        "name": obj.name,
        "size_mm": obj.mesh.extents * 1e3,
        "mass_kg": obj.mass_kg,
        "com_m": obj.com_O,
        "friction": obj.friction,
        "vertices": len(obj.mesh.vertices),
        "faces": len(obj.mesh.faces),
        "convex_parts": len(obj.convex_parts),
        "symmetry_rotations": len(obj.symmetry.rotations),
        "content_sha256": obj.content_hash,
        "provenance": dict(obj.provenance),
    }
