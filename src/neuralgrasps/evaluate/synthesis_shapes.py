"""Round things and boxes: success rates are told apart by the kind of object, because flat sides are harder."""

from __future__ import annotations

from typing import Literal

import numpy as np

from neuralgrasps.evaluate.published import plain_name
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.primitives import convex_hull

ShapeKind = Literal["round", "boxes", "other"]

_KINDS: tuple[tuple[str, ShapeKind], ...] = (
    ("can", "round"),
    ("bottle", "round"),
    ("cleanser", "round"),
    ("box", "boxes"),
    ("carton", "boxes"),
    ("block", "boxes"),
    ("brick", "boxes"),
)
BOX_SHARE = 0.65  # scanned boxes have 0.80-0.90, a potted meat can 0.50-0.58, cans and bottles at most 0.40
MIN_SOLIDITY = 0.8  # volume over that of the convex hull: scanned cans and bottles have 0.82-0.92, a clamp 0.24
NEAR_SHARE = 0.1
ALIGNED = np.cos(np.deg2rad(15.0))


def shape_kind(name: str, mesh: Mesh) -> ShapeKind:
    """ "round" (cans and bottles), "boxes", or "other".

    The name decides where it holds a word that does: the last of can, bottle, cleanser / box, carton, block, brick.
    So a potted meat can is round, although it has flat sides. Otherwise the shape: boxes have `BOX_SHARE` of their
    surface on six planes at right angles (see `box_share`); what else fills most of its convex hull is round.
    """
    for word in reversed(plain_name(name).lower().replace("-", "_").split("_")):
        for known, kind in _KINDS:
            if word == known:
                return kind
    if box_share(mesh) >= BOX_SHARE:
        return "boxes"
    return "round" if _solidity(mesh) >= MIN_SOLIDITY else "other"


def box_share(mesh: Mesh) -> float:
    """Share of the surface that lies on the six faces of the box that fits a mesh best, in [0, 1].

    The box is aligned to the direction most area faces, and to that most area at right angles to it faces. Each
    triangle belongs to the axis nearest its normal; it lies on the box when its normal is within 15 degrees of the axis
    and its middle within 10 % of the box's width of the face. The result is the least of the three axes' shares of
    area, so that two large flat ends do not make a box of a can.
    """
    corners = mesh.vertices[mesh.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    some = area > 1e-12 * area.max()
    middle, area, normals = corners[some].mean(axis=1), area[some], cross[some] / area[some, None]
    first = _most_faced(normals, area)
    side = np.abs(normals @ first) < np.sqrt(1.0 - ALIGNED**2)
    if not side.any():
        return 0.0
    second = _most_faced(normals[side], area[side])
    second = second - (second @ first) * first
    second /= np.linalg.norm(second)
    axes = np.stack([first, second, np.cross(first, second)])
    facing = normals @ axes.T
    nearest = np.abs(facing).argmax(axis=1)
    shares = []
    for k, axis in enumerate(axes):
        along = mesh.vertices @ axis
        low, high = along.min(), along.max()
        place, near = middle @ axis, NEAR_SHARE * (high - low)
        on_face = np.where(facing[:, k] > 0, place > high - near, place < low + near)
        own = nearest == k
        on_face &= own & (np.abs(facing[:, k]) > ALIGNED)
        shares.append(area[on_face].sum() / max(area[own].sum(), 1e-300))
    return float(min(shares))


def _most_faced(normals: np.ndarray, area: np.ndarray) -> np.ndarray:
    """(3,) mean normal of the bundle, up to sign and within 15 degrees, that holds the most area."""
    largest = np.argsort(-area, kind="stable")[:400]
    # scans have thousands of small triangles: try an even choice of them as well
    tried = np.unique(np.concatenate([largest, np.linspace(0, len(area) - 1, 400).astype(int)]))
    facing = normals @ normals[tried].T
    best = int(((np.abs(facing) > ALIGNED) * area[:, None]).sum(axis=0).argmax())
    bundle = np.abs(facing[:, best]) > ALIGNED
    mean = (normals[bundle] * (np.sign(facing[bundle, best]) * area[bundle])[:, None]).sum(axis=0)
    return mean / np.linalg.norm(mean)


def _solidity(mesh: Mesh) -> float:
    vertices, faces = convex_hull(mesh.vertices)
    return abs(_volume(mesh.vertices, mesh.faces)) / abs(_volume(vertices, faces))


def _volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)
