"""Even points on a hand's surface, and its triangle meshes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from neuralgrasps.errors import InputError, check_shape
from neuralgrasps.geometry.mesh import Mesh, merge_meshes
from neuralgrasps.geometry.sampling import cover
from neuralgrasps.hands.chains import rigid_bodies
from neuralgrasps.hands.hand import ConvexPart, Hand
from neuralgrasps.hands.parts import part_distances, part_mesh, sample_part
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.kinematics.tree import FIXED, KinematicTree

if TYPE_CHECKING:
    from torch import Tensor

_POOL_PER_CELL = 16  # candidate points per spacing^2 of area
_COVER = 0.88  # covering radius / spacing that makes the mean nearest-neighbour distance equal the spacing
_SKIN = 1e-5  # metres; a point whose outside is another part, this far out, is covered by it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HandSurface:
    """Points on the outside of a hand, sorted by link.

    Attributes:
        points_L: (K, 3) float64 metres, each in the frame of its link.
        normals_L: (K, 3) float64 outward unit normals, same frames.
        links: (K,) int32 link of each point, ascending.
    """

    points_L: np.ndarray
    normals_L: np.ndarray
    links: np.ndarray


def sample_hand_surface(hand: Hand, *, spacing: float) -> HandSurface:
    """Points spread evenly over the hand's exact surface; deterministic.

    Points that lie inside another part of the same rigid body are left out, so none is hidden for good.

    Args:
        hand: the hand.
        spacing: mean distance between neighbours, metres, > 0; no surface point is farther than about it from one.
    Raises:
        InputError: spacing is not positive, or so small that the points would not fit in memory.
    """
    if not (spacing > 0 and math.isfinite(spacing)):
        raise InputError(f"spacing is {spacing}; expected a positive length in metres, e.g. 0.004.")
    if spacing < 2e-4:
        raise InputError(f"spacing is {spacing} m; expected at least 0.0002 m.")
    bodies = rigid_bodies(hand.tree)
    X_BL = _poses_in_body(hand.tree)
    points, normals, links = [], [], []
    for body in np.unique(bodies):
        own = [p for p in hand.parts if bodies[p.link] == body]
        if own:
            p, n, link = _body_surface(own, X_BL, spacing)
            points.append(p)
            normals.append(n)
            links.append(link)
    link = np.concatenate(links)
    order = np.argsort(link, kind="stable")
    return HandSurface(
        points_L=np.concatenate(points)[order],
        normals_L=np.concatenate(normals)[order],
        links=link[order].astype(np.int32),
    )


def _poses_in_body(tree: KinematicTree) -> np.ndarray:
    """(L, 4, 4) pose of each link in the first link of its rigid body."""
    X = np.tile(np.eye(4), (tree.num_links, 1, 1))
    for i, parent in enumerate(tree.parents):
        if parent >= 0 and tree.joint_types[i] == FIXED:
            X[i] = X[parent] @ tree.X_parent_joint[i]
    return X


def _body_surface(
    parts: list[ConvexPart], X_BL: np.ndarray, spacing: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Even points of one rigid body: (K, 3), (K, 3) in link frames and (K,) links."""
    pool_B, points, normals, links = [], [], [], []
    for part in parts:
        p, n = sample_part(part, _POOL_PER_CELL / spacing**2)
        X = X_BL[part.link]
        p_B = p @ X[:3, :3].T + X[:3, 3]
        outside_B = p_B + _SKIN * (n @ X[:3, :3].T)
        hidden = np.zeros(len(p), bool)
        for other in parts:
            if other is not part:
                Y = X_BL[other.link]
                hidden |= part_distances(other, (outside_B - Y[:3, 3]) @ Y[:3, :3]) < 0.0
        pool_B.append(p_B[~hidden])
        points.append(p[~hidden])
        normals.append(n[~hidden])
        links.append(np.full(int((~hidden).sum()), part.link))
    chosen = cover(np.concatenate(pool_B), _COVER * spacing)
    return np.concatenate(points)[chosen], np.concatenate(normals)[chosen], np.concatenate(links)[chosen]


def pose_surface(hand: Hand, surface: HandSurface, X_OH: Tensor, q: Tensor) -> Tensor:
    """Surface points of posed hands in the object frame; differentiable in `X_OH` and `q`.

    Args:
        hand: the hand; `surface` is its surface.
        X_OH: (N, 4, 4) hand base in the object; q: (N, J) joints, same dtype and device.
    Returns:
        (N, K, 3) metres.
    Raises:
        ShapeError: wrong shapes.
    """
    import torch

    from neuralgrasps.kinematics.forward import forward_kinematics

    check_shape("X_OH", tuple(X_OH.shape), (4, 4))
    X_OL = X_OH.unsqueeze(-3) @ forward_kinematics(hand.tree, q)
    links = torch.as_tensor(surface.links, dtype=torch.int64, device=q.device)
    points = torch.as_tensor(surface.points_L, dtype=q.dtype, device=q.device)
    X = X_OL.index_select(-3, links)
    return (X[..., :3, :3] @ points.unsqueeze(-1)).squeeze(-1) + X[..., :3, 3]


def hand_link_meshes(hand: Hand, *, segments: int = 32) -> tuple[Mesh | None, ...]:
    """One mesh per link in its own frame, the link's parts laid together; None for links without parts."""
    meshes: list[Mesh | None] = []
    for link in range(hand.tree.num_links):
        own = [part_mesh(p, segments=segments) for p in hand.parts if p.link == link]
        meshes.append(merge_meshes(own) if own else None)
    return tuple(meshes)


def hand_mesh(hand: Hand, q: np.ndarray, *, segments: int = 32) -> Mesh:
    """The hand at joints q (J,) as one mesh in H, for drawing: parts overlap, nothing is cut.

    Raises:
        ShapeError: `q` does not have J values.
    """
    return merge_meshes(hand_part_meshes(hand, q, segments=segments))


def hand_part_meshes(hand: Hand, q: np.ndarray, *, segments: int = 32) -> tuple[Mesh, ...]:
    """The hand at joints q (J,) as one mesh in H per part of `hand.parts`, whose colours apply."""
    q = np.asarray(q, float)
    hand.check_q(q)
    X_HL = forward_numpy(hand.tree, q)
    return tuple(part_mesh(p, segments=segments).transformed(X_HL[p.link]) for p in hand.parts)
