"""Meshes kept in the home folder: one folder per name with `mesh.ply` and `object.json`."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from neuralgrasps.errors import InputError, StorageError
from neuralgrasps.files import write_whole
from neuralgrasps.geometry.mesh import Mesh
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


def store_mesh(name: str, mesh: Mesh, notes: Mapping[str, str]) -> None:
    """Keep a mesh and its provenance under `name`; an older one is replaced.

    Raises:
        InputError: the name cannot be used.
        StorageError: the home folder cannot be written.
    """
    folder = objects_folder() / check_object_name(name)
    try:
        # the mesh last: a folder without it does not count
        write_whole(folder / "object.json", json.dumps(dict(notes), indent=1, sort_keys=True))
        write_whole(folder / "mesh.ply", ply_bytes(mesh))
    except StorageError as error:
        raise StorageError(f"{error} The home folder can be moved: set NEURALGRASPS_HOME.") from error.__cause__


def ply_bytes(mesh: Mesh) -> bytes:
    """Binary PLY with float64 vertices: reading it back gives the same mesh and hash."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(mesh.vertices)}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    return header.encode("ascii") + mesh.vertices.astype("<f8").tobytes() + faces.tobytes()
