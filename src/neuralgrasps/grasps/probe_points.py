"""Points that probe an object or a hand for overlap: spread over the surface, with rows along its sharp edges."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.mesh_topology import directed_edges, face_areas_normals
from neuralgrasps.geometry.sampling import even_surface_points
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import PackedHand, pack_shapes
from neuralgrasps.hands.parts import part_mesh, sample_part

SHARP_RAD = math.radians(20.0)  # faces that meet at a larger angle make an edge that is probed
_MOST_POINTS = 60_000  # a larger surface is sampled more coarsely
_SEGMENTS = 64  # around the rims of a hand's cylinders
_CELLS = 8  # side of a group's cell in spacings


class ProbePoints(NamedTuple):
    """Points in groups, each within a ball.

    Attributes:
        points (P, 3): metres, those of one group after each other.
        start (G + 1,): points of group g are start[g]:start[g + 1].
        centre (G, 3), radius (G,): a ball around each group, metres.
    """

    points: np.ndarray
    start: np.ndarray
    centre: np.ndarray
    radius: np.ndarray


def probe_surface(mesh: Mesh, *, spacing: float, seed: int = 0) -> ProbePoints:
    """Points about `spacing` apart on a surface and along its sharp edges, where it cuts into something flat first.

    A surface so large that this would be more than 60,000 points is sampled more coarsely.
    """
    area = float(face_areas_normals(mesh)[0].sum())
    spacing = max(spacing, math.sqrt(area / _MOST_POINTS))
    faces, edges = even_surface_points(mesh, spacing, seed)[0], sharp_edge_points(mesh, spacing=spacing)
    return group_points(np.concatenate([faces, edges]), size=_CELLS * spacing)


def sharp_edge_points(mesh: Mesh, *, spacing: float) -> np.ndarray:
    """(K, 3) points along the edges between faces that meet at more than 20 degrees, at most `spacing` apart; their
    ends included."""
    _, normals = face_areas_normals(mesh)
    edges = np.sort(directed_edges(mesh.faces), axis=1)
    face = np.tile(np.arange(len(mesh.faces)), 3)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    edges, face = edges[order], face[order]
    pair = np.flatnonzero((edges[1:] == edges[:-1]).all(axis=1))
    cosine = np.einsum("ij,ij->i", normals[face[pair]], normals[face[pair + 1]])
    ends = mesh.vertices[edges[pair[cosine < math.cos(SHARP_RAD)]]]
    pieces = np.maximum(np.ceil(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / spacing), 1).astype(np.int64)
    owner = np.repeat(np.arange(len(ends)), pieces + 1)
    step = np.arange(len(owner)) - np.repeat(np.cumsum(pieces + 1) - pieces - 1, pieces + 1)
    share = (step / pieces[owner])[:, None]
    points = (1.0 - share) * ends[owner, 0] + share * ends[owner, 1]
    return np.unique(points, axis=0) if len(points) else points.reshape(0, 3)


def group_points(points: np.ndarray, *, size: float | None = None) -> ProbePoints:
    """The same points in groups by cells of `size` metres; by default about 30 points in each."""
    points = np.asarray(points, np.float64).reshape(-1, 3)
    if not len(points):
        return ProbePoints(points, np.zeros(1, np.int64), np.zeros((0, 3)), np.zeros(0))
    low = points.min(axis=0)
    if size is None:
        size = float(np.ptp(points, axis=0).max()) * math.sqrt(10.0 / len(points))
    cells = np.floor((points - low) / max(size, 1e-6)).astype(np.int64)
    _, label = np.unique(cells, axis=0, return_inverse=True)
    order = np.argsort(label.ravel(), kind="stable")
    points, counts = np.ascontiguousarray(points[order]), np.bincount(label.ravel())
    start = np.concatenate([[0], np.cumsum(counts)])
    high, low = np.maximum.reduceat(points, start[:-1]), np.minimum.reduceat(points, start[:-1])
    centre = (high + low) / 2
    reach = np.linalg.norm(points - np.repeat(centre, counts, axis=0), axis=1)
    return ProbePoints(points, start, centre, np.maximum.reduceat(reach, start[:-1]))


def probe_hand(hand: Hand, *, spacing: float) -> PackedHand:
    """The packed hand with points about `spacing` apart over each of its parts and along their sharp edges.

    Points inside other parts are kept: they are quick to make, and right to measure depths in an object with, but
    not the hand's overlap with itself. Normals are left out.
    """
    points, links = [], []
    for part in sorted(hand.parts, key=lambda p: p.link):
        edges = sharp_edge_points(part_mesh(part, segments=_SEGMENTS), spacing=spacing)
        points += [sample_part(part, 1.0 / spacing**2)[0], edges]
        links.append(np.full(len(points[-2]) + len(edges), part.link, np.int32))
    point_L, link = np.ascontiguousarray(np.concatenate(points)), np.concatenate(links)
    start = np.searchsorted(link, np.arange(hand.tree.num_links + 1)).astype(np.int64)
    shapes = pack_shapes(hand)
    centre, radius = np.zeros_like(shapes.link_centre), np.zeros_like(shapes.link_radius)
    for i in np.unique(link):
        own = point_L[start[i] : start[i + 1]]
        centre[i] = (own.min(axis=0) + own.max(axis=0)) / 2
        radius[i] = np.linalg.norm(own - centre[i], axis=1).max()
    return shapes._replace(
        point_L=point_L, point_link=link, link_point_start=start, link_centre=centre, link_radius=radius
    )
