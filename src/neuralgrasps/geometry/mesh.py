"""Triangle meshes: the `Mesh` noun, files, exact distances, mass and simple solids. The names to import from."""

from __future__ import annotations

from neuralgrasps.geometry.mesh_distance import closest_points, contains, signed_distance, unsigned_distance
from neuralgrasps.geometry.mesh_files import LengthUnit, LoadedMesh, load_mesh, repair_mesh
from neuralgrasps.geometry.mesh_topology import (
    MassProperties,
    Mesh,
    face_areas_normals,
    is_closed,
    is_manifold,
    mass_properties,
    merge_meshes,
    vertex_normals,
)
from neuralgrasps.geometry.primitives import (
    box_mesh,
    capsule_mesh,
    convex_hull,
    cylinder_mesh,
    hull_planes,
    sphere_mesh,
)

__all__ = [
    "LengthUnit",
    "LoadedMesh",
    "MassProperties",
    "Mesh",
    "box_mesh",
    "capsule_mesh",
    "closest_points",
    "contains",
    "convex_hull",
    "cylinder_mesh",
    "face_areas_normals",
    "hull_planes",
    "is_closed",
    "is_manifold",
    "load_mesh",
    "mass_properties",
    "merge_meshes",
    "repair_mesh",
    "signed_distance",
    "sphere_mesh",
    "unsigned_distance",
    "vertex_normals",
]
