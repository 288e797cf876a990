"""The `ObjectModel` noun: one rigid object."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.sdf_grid import SdfGrid
from neuralgrasps.objects.symmetry import SymmetryGroup


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectModel:
    """One rigid object in its own frame O (the mesh file's frame, metres).

    Attributes:
        name: unique name.
        mesh: the true surface.
        sdf: signed distances on a grid, negative inside.
        points_O, normals_O: (2048, 3) float64 evenly spread surface points and outward unit normals.
        convex_parts: (V, 3) hull vertices per part; together they fill the object (physics only).
        mass_kg, com_O: mass and (3,) centre of mass.
        friction: Coulomb coefficient against a finger pad.
        symmetry: rotations that leave the shape unchanged within a tolerance.
        content_hash: sha256 of the mesh arrays; the key of every cache.
        provenance: source and licence.
    """

    name: str
    mesh: Mesh
    sdf: SdfGrid
    points_O: np.ndarray
    normals_O: np.ndarray
    convex_parts: tuple[np.ndarray, ...]
    mass_kg: float
    com_O: np.ndarray
    friction: float
    symmetry: SymmetryGroup
    content_hash: str
    provenance: Mapping[str, str]

    def __repr__(self) -> str:
        size = " x ".join(f"{1e3 * side:.0f}" for side in self.mesh.extents)
        return f"ObjectModel({self.name}: {size} mm, {1e3 * self.mass_kg:.0f} g, {len(self.convex_parts)} convex parts)"
