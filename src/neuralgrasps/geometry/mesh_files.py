"""Reading mesh files of any origin into a repaired `Mesh` in metres."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import trimesh
from numpy.typing import NDArray

from neuralgrasps.errors import InputError, MeshError
from neuralgrasps.geometry import mesh_repair
from neuralgrasps.geometry.mesh_topology import Mesh, face_bodies, is_closed, open_edge_count

LengthUnit = Literal["auto", "m", "mm", "cm", "inch"]
_METRES: Mapping[str, float] = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "inch": 0.0254}
# No object for a hand measures 3 m, so a larger number is taken for millimetres.
_LARGEST_PLAUSIBLE_M = 3.0
_READABLE = ("obj", "ply", "stl", "off", "glb", "gltf", "dae", "3mf")


@dataclass(frozen=True, slots=True)
class LoadedMesh:
    """A mesh from a file and what had to be done or should be known about it.

    Attributes:
        mesh: the repaired mesh, metres, in the file's own frame.
        repairs: sentences for the user; empty if the file was fine and in metres.
        bodies: number of separate bodies.
        closed: whether every edge is paired; if not, signs come from the winding number.
    """

    mesh: Mesh
    repairs: tuple[str, ...]
    bodies: int
    closed: bool


def load_mesh(path: str | Path, *, unit: LengthUnit = "auto") -> LoadedMesh:
    """Read and repair a mesh file (OBJ, PLY, STL, OFF, GLB, GLTF, DAE, 3MF); scenes become one mesh.

    Args:
        path: the file.
        unit: length unit of the file. "auto" means metres, unless the largest extent is over 3, then millimetres
            (said in `repairs`).
    Raises:
        MeshError: the file is missing, unreadable, without triangles, or flat.
        InputError: `unit` is not one of those named.
    """
    path = Path(path)
    if unit not in get_args(LengthUnit):
        raise InputError(f"unit '{unit}' is not known; expected one of {', '.join(get_args(LengthUnit))}.")
    vertices, faces = _read_triangles(path)
    return repair_mesh(vertices, faces, unit=unit, source=f"mesh file '{path}'")


def repair_mesh(
    vertices: NDArray[Any], faces: NDArray[Any], *, unit: LengthUnit = "m", source: str = "mesh"
) -> LoadedMesh:
    """Repair raw arrays (V, 3), (F, 3): units, bad vertices, seams, faces, winding; `source` names it in errors."""
    repairs: list[str] = []
    v, f = np.array(vertices, dtype=np.float64), np.array(faces, dtype=np.int64)
    if not len(v) or not len(f):
        raise MeshError(f"{source} holds {len(v)} vertices and {len(f)} faces; expected a surface of triangles.")
    v, f = mesh_repair.drop_bad_vertices(v, f, repairs)
    v, f = mesh_repair.compact(v, f)
    if not len(f):
        raise MeshError(f"{source} has no face with finite vertices; export it again.")
    v = v * _scale(v, unit, repairs)
    v, f = mesh_repair.merge_equal_vertices(v, f, repairs)
    f = mesh_repair.drop_useless_faces(f, repairs)
    if not len(f):
        raise MeshError(f"{source} has only faces without area; expected a surface that encloses a volume.")
    v, f = mesh_repair.weld_seams(v, f, repairs)
    f = mesh_repair.drop_useless_faces(f, repairs)
    if mesh_repair.is_flat(v[f].reshape(-1, 3)):
        raise MeshError(f"{source} is flat: all its faces lie in one plane; expected a surface that encloses a volume.")
    f = mesh_repair.fix_winding(v, f, repairs)
    v, f = mesh_repair.compact(v, f)
    mesh = Mesh(v, f.astype(np.int32))
    bodies, _ = face_bodies(mesh.faces, len(mesh.vertices))
    closed = is_closed(mesh)
    if bodies > 1:
        repairs.append(f"kept {bodies} separate bodies as one object")
    if not closed:
        repairs.append(f"still open at {open_edge_count(mesh.faces)} edges: inside is decided by the winding number")
    return LoadedMesh(mesh, tuple(repairs), bodies, closed)


def _scale(vertices: NDArray[np.float64], unit: LengthUnit, repairs: list[str]) -> float:
    if unit != "auto":
        return _METRES[unit]
    extent = float(np.ptp(vertices, axis=0).max())
    if extent <= _LARGEST_PLAUSIBLE_M:
        return 1.0
    repairs.append(f"took the file's unit for mm, since its largest extent is {extent:.4g}; give the unit if it is not")
    return _METRES["mm"]


def _read_triangles(path: Path) -> tuple[NDArray[Any], NDArray[Any]]:
    if not path.is_file():
        raise MeshError(f"mesh file '{path}' does not exist.")
    if path.stat().st_size == 0:
        raise MeshError(f"mesh file '{path}' is empty (0 bytes); export it again.")
    kind = path.suffix.lower().lstrip(".")
    if kind not in _READABLE:
        raise MeshError(f"mesh file '{path}' is of kind '.{kind}'; expected one of {', '.join(_READABLE)}.")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about textures, which are not read
            loaded: Any = trimesh.load(path, process=False, maintain_order=True, skip_materials=True)
            if isinstance(loaded, trimesh.Scene):
                loaded = loaded.to_geometry() if loaded.geometry else None
    except ImportError as error:  # the reader took it for text of another encoding, or of an unusual dialect
        raise MeshError(f"mesh file '{path}' is not a {kind.upper()} file, or is damaged; export it again.") from error
    except Exception as error:  # readers of ten formats raise whatever their parser raises
        raise MeshError(f"mesh file '{path}' cannot be read as {kind.upper()}: {_first_line(error)}") from error
    faces = getattr(loaded, "faces", None)
    vertices = getattr(loaded, "vertices", None)
    if vertices is None or len(vertices) == 0:
        raise MeshError(f"mesh file '{path}' holds no vertices; is it truncated or of another format?")
    if faces is None or len(faces) == 0:
        raise MeshError(
            f"mesh file '{path}' holds {len(vertices)} points but no faces (a point cloud?); expected a triangle mesh. "
            "Reconstruct a surface first."
        )
    return np.asarray(vertices), np.asarray(faces)


def _first_line(error: Exception) -> str:
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[0][:200]}" if lines else type(error).__name__
