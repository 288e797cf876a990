"""From a mesh to an `ObjectModel`: distances, surface points, convex parts, symmetry; cached by content."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import InputError, MeshError
from neuralgrasps.geometry.mesh import Mesh, closest_points, is_closed, mass_properties
from neuralgrasps.geometry.sampling import farthest_points, sample_surface
from neuralgrasps.geometry.sdf_grid import SdfGrid, build_sdf_grid
from neuralgrasps.objects.cache import cache_key, read_cache, write_cache
from neuralgrasps.objects.convex_parts import ConvexParts, make_convex_parts
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.symmetry import SymmetryGroup, find_symmetry

_NUM_POINTS = 2048
_MAX_CELLS = 128
_FINEST_SPACING_M = 0.001  # finer cells than this cost seconds and change distances by less than 0.1 mm
_PADDING_M = 0.02
_DENSITY_KG_M3 = 500.0
_SMALLEST_M, _LARGEST_M = 0.005, 3.0
_MASS_RANGE_KG = (0.05, 1.5)


def object_from_mesh(
    name: str,
    mesh: Mesh,
    *,
    mass_kg: float | None = None,
    friction: float = 0.6,
    provenance: Mapping[str, str] | None = None,
) -> ObjectModel:
    """Everything the library needs to know about a mesh; what is slow comes from the cache when it is there.

    Args:
        name: name of the object.
        mesh: its surface in the object frame, metres; closed or nearly so.
        mass_kg: default volume x 500 kg/m^3, kept within 0.05..1.5 kg (said in `provenance`).
        friction: Coulomb coefficient against a finger pad, > 0.
        provenance: source, licence, ...; this function adds what it measured and guessed.
    Raises:
        MeshError: the mesh encloses no volume, or is far too small or large for a hand (5 mm to 3 m is meant).
        InputError: mass or friction is not a positive number.
    """
    _check_positive("mass_kg", mass_kg)
    _check_positive("friction", friction)
    check_size(name, mesh)
    mass = mass_properties(mesh)
    if not mass.volume > 0:
        raise MeshError(
            f"object '{name}' encloses {mass.volume * 1e6:.3g} cm3; expected a solid. Close the surface and turn its "
            "faces outward."
        )
    notes = dict(provenance or {})
    if mass_kg is None:
        mass_kg = float(np.clip(_DENSITY_KG_M3 * mass.volume, *_MASS_RANGE_KG))
        notes["mass"] = (
            f"guessed: volume {mass.volume * 1e6:.0f} cm3 x {_DENSITY_KG_M3:.0f} kg/m3, kept within "
            f"{_MASS_RANGE_KG[0]}..{_MASS_RANGE_KG[1]} kg"
        )
    content = mesh.content_hash()
    derived, cache_note = _derived(mesh, content)
    notes.update(derived.notes)
    notes["symmetry"] = _symmetry_note(derived.symmetry)
    if cache_note:
        notes["cache"] = cache_note
    return ObjectModel(
        name=name,
        mesh=mesh,
        sdf=derived.sdf,
        points_O=derived.points_O,
        normals_O=derived.normals_O,
        convex_parts=derived.convex_parts,
        mass_kg=float(mass_kg),
        com_O=mass.centre,
        friction=float(friction),
        symmetry=derived.symmetry,
        content_hash=content,
        provenance=notes,
    )


def check_size(name: str, mesh: Mesh) -> None:
    """Raise `MeshError` for a mesh whose length unit must be wrong, before its distances are put on a grid."""
    longest = float(mesh.extents.max())
    if not _SMALLEST_M <= longest <= _LARGEST_M:
        size = f"{longest * 1e3:.3g} mm" if longest < 1.0 else f"{longest:.4g} m"
        raise MeshError(
            f"object '{name}' measures {size}; expected {_SMALLEST_M * 1e3:g} mm to {_LARGEST_M:g} m. Give the file's "
            "length unit (m, mm, cm or inch; --unit on the command line, unit= in Python)."
        )


def _check_positive(name: str, value: float | None) -> None:
    if value is not None and not (np.isfinite(value) and value > 0):
        raise InputError(f"{name} is {value}; expected a positive number.")


@dataclass(frozen=True, slots=True)
class _Derived:
    """What is computed from the mesh alone."""

    sdf: SdfGrid
    points_O: np.ndarray
    normals_O: np.ndarray
    convex_parts: tuple[np.ndarray, ...]
    symmetry: SymmetryGroup
    notes: dict[str, str]


def _derived(mesh: Mesh, content: str) -> tuple[_Derived, str | None]:
    """Cached or computed; and why the result could not be stored, if so."""
    options = {"points": _NUM_POINTS, "cells": _MAX_CELLS, "spacing": _FINEST_SPACING_M, "padding": _PADDING_M}
    key = cache_key(content, options)
    stored = read_cache(key)
    if stored is not None:
        try:
            return _unpack(*stored), None
        except (KeyError, ValueError, IndexError):
            pass  # written by something else under our name: compute again
    computed = _compute(mesh)
    arrays, notes = _pack(computed)
    return computed, write_cache(key, arrays, notes)


def _compute(mesh: Mesh) -> _Derived:
    longest = float(mesh.extents.max())
    cells = int(np.clip(np.ceil(longest / _FINEST_SPACING_M), 32, _MAX_CELLS))
    sdf = build_sdf_grid(mesh, cells=cells, padding=_PADDING_M)
    points, normals = surface_points(mesh, _NUM_POINTS)
    parts = make_convex_parts(mesh, sdf)
    symmetry = find_symmetry(points, sdf)
    notes = _part_notes(parts)
    if not is_closed(mesh):
        notes["surface"] = "open: inside is decided by the winding number, the volume is approximate"
    return _Derived(sdf, points, normals, parts.vertices, symmetry, notes)


def surface_points(mesh: Mesh, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Evenly spread surface points and outward unit normals: (count, 3) each, float64; deterministic."""
    pool, _, _ = sample_surface(mesh, 10 * count, 0)
    chosen = farthest_points(pool, count)
    points = pool[chosen]
    _, face, _ = closest_points(mesh, points)
    corners = mesh.triangles[face]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _part_notes(parts: ConvexParts) -> dict[str, str]:
    return {
        "convex_parts": f"{len(parts.vertices)} by {parts.method}",
        "convex_protrusion_p95_mm": f"{parts.protrusion_p95_m * 1e3:.2f}",
        "convex_protrusion_max_mm": f"{parts.protrusion_max_m * 1e3:.2f}",
        "convex_gap_p95_mm": f"{parts.gap_p95_m * 1e3:.2f}",
        "convex_gap_max_mm": f"{parts.gap_max_m * 1e3:.2f}",
    }


def _symmetry_note(group: SymmetryGroup) -> str:
    if len(group) == 1 and group.continuous_axis is None:
        return f"none found (tolerance {group.tolerance_m * 1e3:.2f} mm)"
    kind = "continuous about an axis, " if group.continuous_axis is not None else ""
    return (
        f"{kind}{len(group)} rotations within {group.tolerance_m * 1e3:.2f} mm "
        f"(measured {group.deviation_m * 1e3:.2f} mm)"
    )


def _pack(d: _Derived) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    axis = d.symmetry.continuous_axis
    arrays: dict[str, np.ndarray] = {
        "sdf_values": d.sdf.values,
        "sdf_origin": d.sdf.origin,
        "sdf_spacing": np.array([d.sdf.spacing]),
        "points_O": d.points_O,
        "normals_O": d.normals_O,
        "part_vertices": np.concatenate(d.convex_parts),
        "part_sizes": np.array([len(p) for p in d.convex_parts], dtype=np.int64),
        "symmetry_rotations": d.symmetry.rotations,
        "symmetry_axis": np.zeros((0, 3)) if axis is None else axis[None],
        "symmetry_centre": d.symmetry.centre,
        "symmetry_numbers": np.array([d.symmetry.tolerance_m, d.symmetry.deviation_m]),
    }
    return arrays, d.notes


def _unpack(arrays: Mapping[str, np.ndarray], notes: Mapping[str, str]) -> _Derived:
    axis = arrays["symmetry_axis"]
    tolerance, deviation = arrays["symmetry_numbers"]
    symmetry = SymmetryGroup(
        rotations=arrays["symmetry_rotations"],
        continuous_axis=axis[0] if len(axis) else None,
        centre=arrays["symmetry_centre"],
        tolerance_m=float(tolerance),
        deviation_m=float(deviation),
    )
    parts = np.split(arrays["part_vertices"], np.cumsum(arrays["part_sizes"])[:-1])
    sdf = SdfGrid(arrays["sdf_values"], arrays["sdf_origin"], float(arrays["sdf_spacing"][0]))
    return _Derived(sdf, arrays["points_O"], arrays["normals_O"], tuple(parts), symmetry, dict(notes))
