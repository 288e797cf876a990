"""A hand as flat arrays for compiled kernels, and exact hand distances on them. Torch-free."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.pose_kernels import moved_point
from neuralgrasps.geometry.se3_numpy import inverse_np
from neuralgrasps.hands.chains import rigid_bodies
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.parts import bounding_sphere, hull_planes, part_distance
from neuralgrasps.hands.surface import HandSurface, sample_hand_surface
from neuralgrasps.kinematics.forward_kernels import forward_fast, link_poses

_PAIR_SPACING = 0.005  # sampling that decides which links may touch
_PAIR_POSTURES = 48
_PAIR_DEPTH = 5e-4


class PackedHand(NamedTuple):
    """Contiguous float64 / int64 arrays; L links, J joints, K points, Np parts. Frames and units as in `Hand`.

    Attributes:
        parents (L,) int32, joint_types (L,) int8, X_parent_joint (L, 4, 4), axes (L, 3), coupling (L, J), offset (L,),
        lower, upper, closing_rate, effort (J,): the tree and its use.
        point_L, point_normal_L (K, 3): surface points, sorted by link; point_link (K,) int32.
        link_point_start (L + 1,): points of link i are link_point_start[i]:link_point_start[i + 1].
        link_centre (L, 3), link_radius (L,): sphere around each link's points, link frame; radius 0 without points.
        part_kind (Np,), part_link (Np,), part_size (Np, 3), part_X_PL (Np, 4, 4): parts sorted by link; X_PL maps link
            coordinates to part coordinates.
        hull_plane_start (Np + 1,), hull_planes (total, 4): n . p + d <= 0 inside, part frame.
        hull_tri_start (Np + 1,), hull_triangles (total, 3, 3): outward triangles, part frame.
        part_centre (Np, 3), part_radius (Np,): sphere around each part, link frame.
        self_pairs (S, 2): pairs of links that are neither neighbours nor always in touch; to check for collision.
    """

    parents: np.ndarray
    joint_types: np.ndarray
    X_parent_joint: np.ndarray
    axes: np.ndarray
    coupling: np.ndarray
    offset: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    closing_rate: np.ndarray
    effort: np.ndarray
    point_L: np.ndarray
    point_normal_L: np.ndarray
    point_link: np.ndarray
    link_point_start: np.ndarray
    link_centre: np.ndarray
    link_radius: np.ndarray
    part_kind: np.ndarray
    part_link: np.ndarray
    part_X_PL: np.ndarray
    part_size: np.ndarray
    hull_plane_start: np.ndarray
    hull_planes: np.ndarray
    hull_tri_start: np.ndarray
    hull_triangles: np.ndarray
    part_centre: np.ndarray
    part_radius: np.ndarray
    self_pairs: np.ndarray


def pack_hand(hand: Hand, *, spacing: float) -> PackedHand:
    """Flat arrays of a hand, with surface points `spacing` metres apart.

    Raises:
        InputError: spacing is not positive.
    """
    packed = _pack(hand, sample_hand_surface(hand, spacing=spacing))
    probe = _pack(hand, sample_hand_surface(hand, spacing=_PAIR_SPACING))
    return packed._replace(self_pairs=_self_pairs(hand, probe))


def pack_shapes(hand: Hand) -> PackedHand:
    """`pack_hand` without surface points and self pairs: what distances need, in a millisecond."""
    nothing = np.zeros((0, 3))
    return _pack(hand, HandSurface(points_L=nothing, normals_L=nothing, links=np.zeros(0, np.int32)))


def _pack(hand: Hand, surface: HandSurface) -> PackedHand:
    tree = hand.tree
    parts = sorted(hand.parts, key=lambda p: p.link)
    spheres = [bounding_sphere(p) for p in parts]
    hulls = [hull_planes(p) for p in parts]
    start = np.searchsorted(surface.links, np.arange(tree.num_links + 1)).astype(np.int64)
    centre, radius = _link_spheres(surface.points_L, start)
    return PackedHand(
        parents=_as(tree.parents, np.int32),
        joint_types=_as(tree.joint_types, np.int8),
        X_parent_joint=_as(tree.X_parent_joint),
        axes=_as(tree.axes),
        coupling=_as(tree.coupling),
        offset=_as(tree.offset),
        lower=_as(tree.lower),
        upper=_as(tree.upper),
        closing_rate=_as(hand.closing_rate),
        effort=_as(tree.effort),
        point_L=_as(surface.points_L),
        point_normal_L=_as(surface.normals_L),
        point_link=_as(surface.links, np.int32),
        link_point_start=start,
        link_centre=centre,
        link_radius=radius,
        part_kind=np.array([int(p.kind) for p in parts], np.int64),
        part_link=np.array([p.link for p in parts], np.int64),
        part_X_PL=_as([inverse_np(p.X_LP) for p in parts]),
        part_size=_as([p.size for p in parts]),
        hull_plane_start=np.cumsum([0] + [len(h[0]) for h in hulls]),
        hull_planes=_as(np.concatenate([h[0] for h in hulls]).reshape(-1, 4)),
        hull_tri_start=np.cumsum([0] + [len(h[1]) for h in hulls]),
        hull_triangles=_as(np.concatenate([h[1] for h in hulls]).reshape(-1, 3, 3)),
        part_centre=_as([s[0] for s in spheres]),
        part_radius=_as([s[1] for s in spheres]),
        self_pairs=np.zeros((0, 2), np.int64),
    )


def _as(values: ArrayLike, dtype: DTypeLike = np.float64) -> np.ndarray:
    return np.array(values, dtype=dtype, order="C")


def _link_spheres(points_L: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    links = len(start) - 1
    centre, radius = np.zeros((links, 3)), np.zeros(links)
    for i in range(links):
        own = points_L[start[i] : start[i + 1]]
        if len(own):
            centre[i] = (own.min(axis=0) + own.max(axis=0)) / 2
            radius[i] = np.linalg.norm(own - centre[i], axis=1).max()
    return centre, radius


def _self_pairs(hand: Hand, packed: PackedHand) -> np.ndarray:
    """(S, 2) link pairs of different, not adjacent rigid bodies that are apart when open and in most postures."""
    body = rigid_bodies(hand.tree)
    above = {int(b): int(body[hand.tree.parents[b]]) for b in np.unique(body) if hand.tree.parents[b] >= 0}
    links = np.unique(packed.part_link)
    rng = np.random.default_rng(0)
    q = rng.uniform(hand.tree.lower, hand.tree.upper, size=(_PAIR_POSTURES, hand.num_dofs))
    X_HL = forward_fast(hand.tree, np.concatenate([hand.q_open[None], q]))
    kept = []
    for k, a in enumerate(links):
        for b in links[k + 1 :]:
            A, B = int(body[a]), int(body[b])
            if A == B or above.get(A) == B or above.get(B) == A:
                continue
            overlaps = np.array([_overlap(packed, X, a, b) for X in X_HL]) > _PAIR_DEPTH
            if not overlaps[0] and overlaps[1:].mean() <= 0.5:
                kept.append((a, b))
    return np.array(kept, np.int64).reshape(-1, 2)


@njit(cache=True, error_model="numpy")
def pose_links(packed, q, out):  # type: ignore[no-untyped-def]
    """X_HL of every link at the joints q (J,) into `out` (L, 4, 4)."""
    link_poses(
        packed.parents, packed.joint_types, packed.X_parent_joint, packed.axes, packed.coupling, packed.offset, q, out
    )


@njit(cache=True, error_model="numpy")
def _overlap(packed, X_HL, a, b):  # type: ignore[no-untyped-def]
    """Largest depth of one link's surface points in the parts of the other, metres, >= 0."""
    depth = 0.0
    for turn in range(2):
        link, other = (a, b) if turn == 0 else (b, a)
        X, m = X_HL[link], packed.link_centre[link]
        mx, my, mz = moved_point(X, m[0], m[1], m[2])
        for part in range(packed.part_link.shape[0]):
            if packed.part_link[part] != other:
                continue
            c, radius = packed.part_centre[part], packed.part_radius[part]
            cx, cy, cz = moved_point(X_HL[other], c[0], c[1], c[2])
            if (mx - cx) ** 2 + (my - cy) ** 2 + (mz - cz) ** 2 >= (radius + packed.link_radius[link]) ** 2:
                continue
            for k in range(packed.link_point_start[link], packed.link_point_start[link + 1]):
                p = packed.point_L[k]
                x, y, z = moved_point(X, p[0], p[1], p[2])
                if (x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2 < radius * radius:
                    depth = max(depth, -part_distance_H(packed, X_HL, part, x, y, z))
    return depth


@njit(cache=True, error_model="numpy")
def part_distance_H(packed, X_HL, part, x, y, z):  # type: ignore[no-untyped-def]
    """Exact signed distance from (x, y, z), in H, metres, to one part of the hand posed as `X_HL` (L, 4, 4)."""
    X = X_HL[packed.part_link[part]]
    dx, dy, dz = x - X[0, 3], y - X[1, 3], z - X[2, 3]
    lx = X[0, 0] * dx + X[1, 0] * dy + X[2, 0] * dz
    ly = X[0, 1] * dx + X[1, 1] * dy + X[2, 1] * dz
    lz = X[0, 2] * dx + X[1, 2] * dy + X[2, 2] * dz
    return _distance_in_part(packed, packed.part_X_PL, part, lx, ly, lz)


@njit(cache=True, error_model="numpy")
def nearest_part(packed, X_HL, x, y, z):  # type: ignore[no-untyped-def]
    """(signed distance, part): the part of the posed hand that is nearest to (x, y, z), in H, metres."""
    best, found = math.inf, -1
    for part in range(packed.part_link.shape[0]):
        X, c = X_HL[packed.part_link[part]], packed.part_centre[part]
        cx, cy, cz = moved_point(X, c[0], c[1], c[2])
        dx, dy, dz = x - cx, y - cy, z - cz
        reach = best + packed.part_radius[part]  # the part is no nearer than its sphere
        if reach <= 0.0 or dx * dx + dy * dy + dz * dz > reach * reach:
            continue
        d = part_distance_H(packed, X_HL, part, x, y, z)
        if d < best:
            best, found = d, part
    return best, found


@njit(cache=True, error_model="numpy")
def hand_distance(packed, X_HL, x, y, z):  # type: ignore[no-untyped-def]
    """Signed distance from (x, y, z), in H, metres, to the posed hand: the least over its parts.

    Exact outside; inside overlapping parts it is the depth in the deepest one, a lower bound on the union's depth.
    """
    return nearest_part(packed, X_HL, x, y, z)[0]


@njit(cache=True, error_model="numpy")
def hand_distance_many(packed, X_OH, q, points_O, out):  # type: ignore[no-untyped-def]
    """Signed distances of points (M, 3) in the object frame to one hand at X_OH (4, 4), q (J,), into `out` (M,)."""
    X_HL = np.empty((packed.parents.shape[0], 4, 4))
    pose_links(packed, q, X_HL)
    X_PO, centre_O = _part_poses(packed, X_OH, X_HL)
    gap = np.empty(packed.part_link.shape[0])  # to each part's sphere
    for i in range(points_O.shape[0]):
        x, y, z = points_O[i, 0], points_O[i, 1], points_O[i, 2]
        first = 0
        for part in range(gap.shape[0]):
            dx, dy, dz = x - centre_O[part, 0], y - centre_O[part, 1], z - centre_O[part, 2]
            gap[part] = math.sqrt(dx * dx + dy * dy + dz * dz) - packed.part_radius[part]
            if gap[part] < gap[first]:
                first = part
        best = _distance_in_part(packed, X_PO, first, x, y, z)
        for part in range(gap.shape[0]):
            if gap[part] < best and part != first:
                best = min(best, _distance_in_part(packed, X_PO, part, x, y, z))
        out[i] = best


@njit(cache=True, error_model="numpy")
def _part_poses(packed, X_OH, X_HL):  # type: ignore[no-untyped-def]
    """X_PO (Np, 3, 4) and the centres (Np, 3) of the parts' spheres in O."""
    count = packed.part_link.shape[0]
    X_PO, centre_O = np.empty((count, 3, 4)), np.empty((count, 3))
    for part in range(count):
        X_OL = X_OH @ X_HL[packed.part_link[part]]
        P, c = packed.part_X_PL[part], packed.part_centre[part]
        for row in range(3):
            centre_O[part, row] = X_OL[row, 0] * c[0] + X_OL[row, 1] * c[1] + X_OL[row, 2] * c[2] + X_OL[row, 3]
            X_PO[part, row, 3] = P[row, 3]
            for col in range(3):  # R_PO = R_PL R_OL^T, t_PO = t_PL - R_PO t_OL
                X_PO[part, row, col] = P[row, 0] * X_OL[col, 0] + P[row, 1] * X_OL[col, 1] + P[row, 2] * X_OL[col, 2]
                X_PO[part, row, 3] -= X_PO[part, row, col] * X_OL[col, 3]
    return X_PO, centre_O


@njit(cache=True, error_model="numpy")
def _distance_in_part(packed, X_PA, part, x, y, z):  # type: ignore[no-untyped-def]
    """Signed distance from (x, y, z), in any frame A, to one part; X_PA (Np, 3 or 4, 4)."""
    px, py, pz = moved_point(X_PA[part], x, y, z)
    planes = packed.hull_planes[packed.hull_plane_start[part] : packed.hull_plane_start[part + 1]]
    triangles = packed.hull_triangles[packed.hull_tri_start[part] : packed.hull_tri_start[part + 1]]
    return part_distance(packed.part_kind[part], packed.part_size[part], planes, triangles, px, py, pz)
