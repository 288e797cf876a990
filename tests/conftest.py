"""Fixtures shared by all tests."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from neuralgrasps.geometry.mesh import Mesh, mass_properties
from neuralgrasps.geometry.primitives import convex_hull
from neuralgrasps.geometry.sdf_grid import build_sdf_grid
from neuralgrasps.objects.build import surface_points
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.symmetry import find_symmetry, trivial_symmetry

ASSETS = Path(__file__).resolve().parents[1].parent / "shared" / "assets"


@pytest.fixture(scope="session")
def assets() -> Path:
    """The folder of real meshes, URDFs and scans; tests that need it are skipped without it."""
    if not ASSETS.is_dir():
        pytest.skip(f"real data not found at {ASSETS}")
    return ASSETS


def _make_object(name: str, mesh: Mesh, *, cells: int = 64, points: int = 1024, symmetry: bool = False) -> ObjectModel:
    """An object without the disk cache; its only convex part is its hull."""
    points_O, normals_O = surface_points(mesh, points)
    sdf = build_sdf_grid(mesh, cells=cells, padding=0.02)
    return ObjectModel(
        name=name,
        mesh=mesh,
        sdf=sdf,
        points_O=points_O,
        normals_O=normals_O,
        convex_parts=(convex_hull(mesh.vertices)[0],),
        mass_kg=0.1,
        com_O=np.asarray(mass_properties(mesh).centre),
        friction=0.6,
        symmetry=find_symmetry(points_O, sdf) if symmetry else trivial_symmetry(np.zeros(3), 0.001),
        content_hash=mesh.content_hash(),
        provenance={"source": "tests"},
    )


@pytest.fixture(scope="session")
def make_object() -> Callable[..., ObjectModel]:
    """`make_object(name, mesh, cells=64, points=1024, symmetry=False)`: an object made in a moment, nothing cached."""
    return _make_object
