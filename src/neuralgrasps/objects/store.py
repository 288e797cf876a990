"""Meshes kept in the home folder: one folder per name with `mesh.ply` and `object.json`."""

from __future__ import annotations

import json
import re
from pathlib import Path

from neuralgrasps.errors import InputError
from neuralgrasps.objects.cache import home_folder

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


def objects_folder() -> Path:
    """Where imported and downloaded objects are kept; it need not exist."""
    return home_folder() / "objects"


def check_object_name(name: str) -> str:
    """`name` itself, if it can be used as an object's name (and so as a folder's).

    Raises:
        InputError: it has other characters than letters, digits, _ and -, or more than 64.
    """
    if not _NAME.fullmatch(name):
        raise InputError(
            f"object name '{name}' cannot be used; expected 1 to 64 letters, digits, _ or -, starting with a letter or "
            "digit."
        )
    return name


def imported_names() -> tuple[str, ...]:
    """Names of the objects in the home folder, sorted; empty when there is no such folder."""
    try:
        folders = sorted(objects_folder().iterdir())
    except OSError:
        return ()
    return tuple(f.name for f in folders if _NAME.fullmatch(f.name) and (f / "mesh.ply").is_file())


def stored_mesh_file(name: str) -> Path | None:
    """The mesh file kept under `name`; None when there is none."""
    if not _NAME.fullmatch(name):
        return None
    path = objects_folder() / name / "mesh.ply"
    return path if path.is_file() else None


def stored_notes(name: str) -> dict[str, str]:
    """Provenance recorded with a kept mesh; says so when the record is missing or damaged."""
    try:
        notes = json.loads((objects_folder() / name / "object.json").read_text(encoding="utf-8"))
        return {str(k): str(v) for k, v in notes.items()}
    except (OSError, ValueError, AttributeError):
        return {"source": f"imported as '{name}'; its record is missing or damaged", "licence": "unknown"}
