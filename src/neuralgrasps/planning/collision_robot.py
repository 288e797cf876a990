"""A manipulator as tables for collision checks: bodies fused, sphere trees, and the pairs of links that may touch."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.compiled import njit
from neuralgrasps.hands.chains import moved_links, rigid_bodies
from neuralgrasps.hands.hand import ConvexPart, PartKind
from neuralgrasps.hands.parts import bounding_sphere, part_distances
from neuralgrasps.hands.surface import sample_hand_surface
from neuralgrasps.kinematics.forward_kernels import forward_fast, joint_motion
from neuralgrasps.kinematics.tree import FIXED
from neuralgrasps.planning.collision_arrays import BODY, IS_HAND
from neuralgrasps.planning.collision_kernels import links_gap
from neuralgrasps.planning.spheres import SphereTree, cover_part

ARM_EXCESS_M = 0.010  # spheres stand out of the arm's parts by no more
HAND_EXCESS_M = 0.004  # and of the hand's
_ONE_SPHERE_M = 100.0  # of what is fixed to the base: its spheres are not used
POINT_SPACING_M = 0.0055  # of the hand's surface points
_POSTURES = 48  # random ones that decide which links may touch
_PAIR_REACH = 0.05  # metres; distances beyond are not measured
_ALWAYS = 0.5  # share of postures in touch that makes a pair always in touch


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobotTables:
    """The robot's part of `CheckArrays`; see there. X_HO of what is held is in `body` at `X_KH @ X_HO`."""

    parents: np.ndarray
    joint_types: np.ndarray
    X_parent_joint: np.ndarray
    axes: np.ndarray
    coupling: np.ndarray
    offset: np.ndarray
    links: np.ndarray
    link_info: np.ndarray
    parts: np.ndarray
    part_info: np.ndarray
    vertices: np.ndarray
    nodes: np.ndarray
    node_info: np.ndarray
    points: np.ndarray
    pairs: np.ndarray
    pair_margins: np.ndarray
    hand_body: int
    X_KH: np.ndarray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobotShape:
    """What does not depend on joints, links by their index in the manipulator's tree.

    Attributes:
        links: (G,) links with parts, ascending. parts: sorted by link, as `trees` and `corner_start`.
        trees: one sphere tree per part, link frame.
        points_L: surface points of the hand in their links' frames, sorted by the leaf that holds them.
        point_start: (S + 1,) for the nodes of all trees in their order.
        pair: (Sp, 2) indices into `links`; pair_gap: (Sp,) their distance at home, metres, capped.
        always: names of pairs that are not adjacent, and left out because they touch at home or nearly always.
    """

    links: np.ndarray
    parts: tuple[ConvexPart, ...]
    trees: tuple[SphereTree, ...]
    points_L: np.ndarray
    point_start: np.ndarray
    pair: np.ndarray
    pair_gap: np.ndarray
    always: tuple[str, ...]


@lru_cache(maxsize=8)
def robot_shape(manipulator: Manipulator) -> RobotShape:
    """Sphere trees, surface points and touching pairs of a manipulator; kept for the last few."""
    parts = tuple(sorted(manipulator.parts, key=lambda p: p.link))
    moves = np.any(moved_links(manipulator.tree)[:, manipulator.arm_dofs], axis=1)
    trees = tuple(cover_part(p, excess_m=_excess(manipulator, p) if moves[p.link] else _ONE_SPHERE_M) for p in parts)
    points_L, point_start = _points_by_leaf(manipulator, parts, trees)
    links = np.unique([p.link for p in parts])
    none = RobotShape(
        links=links, parts=parts, trees=trees, points_L=points_L, point_start=point_start,
        pair=np.zeros((0, 2), np.int64), pair_gap=np.zeros(0), always=(),
    )  # fmt: skip
    return _with_pairs(manipulator, none)


def _excess(manipulator: Manipulator, part: ConvexPart) -> float:
    return HAND_EXCESS_M if part.link >= manipulator.hand_link else ARM_EXCESS_M


def _points_by_leaf(
    manipulator: Manipulator, parts: tuple[ConvexPart, ...], trees: tuple[SphereTree, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """The hand's surface points (M, 3), each under one leaf of the part it lies on, and starts (S + 1,)."""
    surface = sample_hand_surface(manipulator.hand, spacing=POINT_SPACING_M)
    start = np.cumsum([0] + [len(t.radii) for t in trees])
    node = np.empty(len(surface.links), np.int64)
    for link in np.unique(surface.links):
        own = np.flatnonzero(surface.links == link)
        on = [i for i, p in enumerate(parts) if p.link == link + manipulator.hand_link]
        away = np.abs([part_distances(parts[i], surface.points_L[own]) for i in on])
        nearest = np.argmin(away, axis=0)
        for k, i in enumerate(on):
            mine = own[nearest == k]
            tree = trees[i]
            leaf = np.flatnonzero(tree.leaves)
            gap = surface.points_L[mine, None] - tree.centres_L[leaf]
            node[mine] = start[i] + leaf[np.argmin(np.linalg.norm(gap, axis=-1) - tree.radii[leaf], axis=1)]
    order = np.argsort(node, kind="stable")
    return surface.points_L[order], np.searchsorted(node[order], np.arange(start[-1] + 1)).astype(np.int64)


def _with_pairs(manipulator: Manipulator, shape: RobotShape) -> RobotShape:
    """Pairs of links on different, not adjacent bodies that are apart at home and in most postures."""
    tree, links = manipulator.tree, shape.links
    body = rigid_bodies(tree)
    above = {int(b): int(body[tree.parents[b]]) for b in np.unique(body) if tree.parents[b] >= 0}
    candidates = [
        (i, j)
        for i in range(len(links))
        for j in range(i + 1, len(links))
        if (A := int(body[links[i]])) != (B := int(body[links[j]])) and above.get(A) != B and above.get(B) != A
    ]
    pair = np.array(candidates, np.int64).reshape(-1, 2)
    q = np.random.default_rng(0).uniform(tree.lower, tree.upper, size=(_POSTURES, tree.num_dofs))
    X_BL = np.ascontiguousarray(forward_fast(tree, np.concatenate([manipulator.q_home[None], q]))[:, links])
    loose = _tables(shape, np.arange(len(links)), np.tile(np.eye(4), (len(links), 1, 1)), manipulator.hand_link)
    gaps = np.empty((len(X_BL), len(pair)))
    _pair_gaps(
        loose.links, loose.link_info, loose.parts, loose.part_info, loose.vertices, X_BL, pair, _PAIR_REACH, gaps
    )
    touching = gaps <= 0.0
    kept = ~touching[0] & (touching[1:].mean(axis=0) <= _ALWAYS)
    names = [f"{tree.link_names[links[i]]} and {tree.link_names[links[j]]}" for i, j in pair[~kept]]
    return replace(shape, pair=pair[kept], pair_gap=gaps[0, kept], always=tuple(names))


@njit(cache=True, error_model="numpy")
def _pair_gaps(links, link_info, parts, part_info, vertices, X_BL, pair, reach, out):  # type: ignore[no-untyped-def]
    """Distances (N, S) of pairs of links posed as X_BL (N, G, 4, 4), capped at `reach`."""
    poses, made, simplex = np.empty((parts.shape[0], 12)), np.zeros(parts.shape[0] + 1, np.int64), np.empty((4, 3))
    centres = np.empty((links.shape[0], 3))
    for n in range(X_BL.shape[0]):
        made[-1] += 1
        for g in range(links.shape[0]):
            for r in range(3):
                X = X_BL[n, g]
                centres[g, r] = X[r, 0] * links[g, 0] + X[r, 1] * links[g, 1] + X[r, 2] * links[g, 2] + X[r, 3]
        for k in range(pair.shape[0]):
            out[n, k] = links_gap(
                links, link_info, parts, part_info, vertices, pair[k, 0], pair[k, 1], reach, X_BL[n], centres, poses,
                made, simplex,
            )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Table:
    """Rows of links, parts, nodes and points, in the frames of their bodies."""

    links: np.ndarray
    link_info: np.ndarray
    parts: np.ndarray
    part_info: np.ndarray
    vertices: np.ndarray
    nodes: np.ndarray
    node_info: np.ndarray
    points: np.ndarray


def _moved(X: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.asarray(points @ X[:3, :3].T + X[:3, 3])


def _tables(shape: RobotShape, body: np.ndarray, X_KL: np.ndarray, hand_link: int) -> _Table:
    """All rows, with the body (G,) and X_KL (G, 4, 4) of each link."""
    of = np.searchsorted(shape.links, [p.link for p in shape.parts])  # link of each part, as an index into `links`
    ends = np.searchsorted(of, np.arange(len(shape.links) + 1))
    node_start = np.cumsum([0] + [len(t.radii) for t in shape.trees])
    hulls = [p.vertices if p.kind == PartKind.HULL else np.zeros((0, 3)) for p in shape.parts]
    vertex_start = np.cumsum([0] + [len(v) for v in hulls])
    skip = np.concatenate([t.skip + a for t, a in zip(shape.trees, node_start[:-1], strict=True)] + [np.zeros(1, int)])
    is_hand = shape.links >= hand_link
    info = [body, ends[:-1], ends[1:], is_hand, body != 0, np.zeros(len(body))]
    kinds = [int(p.kind) for p in shape.parts]
    table = _Table(
        links=np.zeros((len(body), 4)),
        link_info=np.column_stack(info).astype(np.int64),
        parts=np.zeros((len(kinds), 19)),
        part_info=np.column_stack([kinds, vertex_start[:-1], vertex_start[1:], node_start[:-1], node_start[1:]]),
        vertices=np.ascontiguousarray(np.concatenate(hulls)),
        nodes=np.zeros((node_start[-1] + 1, 4)),
        node_info=np.ascontiguousarray(np.column_stack([skip, shape.point_start]).astype(np.int64)),
        points=np.zeros_like(shape.points_L),
    )
    table.nodes[:-1, 3] = np.concatenate([t.radii for t in shape.trees])
    _place(shape, table, X_KL, np.arange(len(body)))
    return table


def _place(shape: RobotShape, table: _Table, X_KL: np.ndarray, links: np.ndarray) -> None:
    """Write what depends on X_KL (G, 4, 4) for some links (rows of `shape.links`)."""
    for g in links:
        X, rows = X_KL[g], range(*table.link_info[g, 1:3])
        for i in rows:
            part, tree = shape.parts[i], shape.trees[i]
            centre, radius = bounding_sphere(part)
            table.parts[i, :3], table.parts[i, 3], table.parts[i, 4:7] = _moved(X, centre), radius, part.size
            table.parts[i, 7:] = (X @ part.X_LP)[:3].reshape(-1)
            a, b = table.part_info[i, 3:5]
            table.nodes[a:b, :3] = _moved(X, tree.centres_L)
            c, d = shape.point_start[a], shape.point_start[b]
            table.points[c:d] = _moved(X, shape.points_L[c:d])
        own = table.parts[rows.start : rows.stop]
        table.links[g] = _sphere_around(own[:, :3], own[:, 3])


def _sphere_around(centres: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Centre and radius (4,) of a sphere that holds spheres."""
    low, high = (centres - radii[:, None]).min(axis=0), (centres + radii[:, None]).max(axis=0)
    middle = (low + high) / 2
    return np.append(middle, (np.linalg.norm(centres - middle, axis=1) + radii).max())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Bodies:
    """Links fused to K bodies that the planned joints move; body (L,) and X_KL (L, 4, 4) of every link."""

    parents: np.ndarray
    joint_types: np.ndarray
    X_parent_joint: np.ndarray
    axes: np.ndarray
    coupling: np.ndarray
    offset: np.ndarray
    body: np.ndarray
    X_KL: np.ndarray


def _fused(manipulator: Manipulator, q_hand: np.ndarray) -> _Bodies:
    tree = manipulator.tree
    planned = tree.coupling[:, manipulator.arm_dofs]
    q_rest = manipulator.full_q(np.zeros(len(manipulator.arm_dofs)), q_hand)
    rest = tree.joint_positions(q_rest)  # with the planned joints at zero
    moves = (tree.joint_types != FIXED) & planned.any(axis=1)
    body, X_KL = np.zeros(tree.num_links, np.int64), np.tile(np.eye(4), (tree.num_links, 1, 1))
    first, parents, X_joint = [0], [-1], [np.eye(4)]
    for i in range(1, tree.num_links):
        parent = tree.parents[i]
        X = X_KL[parent] @ tree.X_parent_joint[i]
        if moves[i]:
            body[i] = len(first)
            first.append(i)
            parents.append(int(body[parent]))
            X_joint.append(X)
        else:
            body[i] = body[parent]
            X_KL[i] = X @ joint_motion(int(tree.joint_types[i]), tree.axes[i], rest[i])
    types = tree.joint_types[first].copy()
    types[0] = FIXED
    return _Bodies(
        parents=np.array(parents, np.int32), joint_types=types, X_parent_joint=np.array(X_joint),
        axes=tree.axes[first], coupling=np.ascontiguousarray(planned[first]), offset=rest[first].copy(),
        body=body, X_KL=X_KL,
    )  # fmt: skip


@lru_cache(maxsize=8)
def _open_tables(manipulator: Manipulator) -> _Table:
    """The rows at home; other hand joints change those of the hand only."""
    shape = robot_shape(manipulator)
    bodies = _fused(manipulator, manipulator.q_home[manipulator.hand_dofs])
    return _tables(shape, bodies.body[shape.links], bodies.X_KL[shape.links], manipulator.hand_link)


def robot_tables(manipulator: Manipulator, q_hand: np.ndarray, *, self_margin_m: float) -> RobotTables:
    """The robot at hand joints (J,); pairs closer than twice the margin at home get half of that distance."""
    shape, known = robot_shape(manipulator), _open_tables(manipulator)
    bodies = _fused(manipulator, q_hand)
    moving = ("links", "parts", "nodes", "points")
    table = replace(known, **{name: getattr(known, name).copy() for name in moving})
    _place(shape, table, bodies.X_KL[shape.links], np.flatnonzero(known.link_info[:, IS_HAND]))
    body = known.link_info[:, BODY]
    different = body[shape.pair[:, 0]] != body[shape.pair[:, 1]]
    return RobotTables(
        parents=bodies.parents, joint_types=bodies.joint_types, X_parent_joint=bodies.X_parent_joint,
        axes=bodies.axes, coupling=bodies.coupling, offset=bodies.offset,
        links=table.links, link_info=table.link_info, parts=table.parts, part_info=table.part_info,
        vertices=table.vertices, nodes=table.nodes, node_info=table.node_info, points=table.points,
        pairs=np.ascontiguousarray(shape.pair[different]),
        pair_margins=np.minimum(self_margin_m, 0.5 * shape.pair_gap[different]),
        hand_body=int(bodies.body[manipulator.hand_link]),
        X_KH=bodies.X_KL[manipulator.hand_link],
    )  # fmt: skip
