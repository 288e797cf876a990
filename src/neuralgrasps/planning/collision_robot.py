"""A manipulator as the arrays of collision checks: bodies fused, sphere trees, and the pairs of links that may touch."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.compiled import njit
from neuralgrasps.hands.chains import rigid_bodies
from neuralgrasps.hands.hand import ConvexPart, PartKind
from neuralgrasps.hands.parts import bounding_sphere, part_distances
from neuralgrasps.hands.surface import sample_hand_surface
from neuralgrasps.kinematics.forward_kernels import forward_fast, joint_motion
from neuralgrasps.kinematics.tree import FIXED
from neuralgrasps.planning.collision_arrays import RobotArrays, make_work
from neuralgrasps.planning.collision_kernels import links_gap
from neuralgrasps.planning.spheres import SphereTree, cover_part

ARM_EXCESS_M = 0.010  # spheres stand out of the arm's parts by no more
HAND_EXCESS_M = 0.004  # and of the hand's
POINT_SPACING_M = 0.0055  # of the hand's surface points
_POSTURES = 48  # random ones that decide which links may touch
_PAIR_REACH = 0.05  # metres; distances beyond are not measured
_ALWAYS = 0.5  # share of postures in touch that makes a pair always in touch


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
    trees = tuple(
        cover_part(p, excess_m=HAND_EXCESS_M if p.link >= manipulator.hand_link else ARM_EXCESS_M) for p in parts
    )
    points_L, point_start = _points_by_leaf(manipulator, parts, trees)
    links = np.unique([p.link for p in parts])
    none = RobotShape(
        links=links, parts=parts, trees=trees, points_L=points_L, point_start=point_start,
        pair=np.zeros((0, 2), np.int64), pair_gap=np.zeros(0), always=(),
    )  # fmt: skip
    return _with_pairs(manipulator, none)


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
    X_BL = forward_fast(tree, np.concatenate([manipulator.q_home[None], q]))[:, links]
    gaps = np.empty((len(X_BL), len(pair)))
    robot = _loose_links(manipulator, shape)
    _pair_gaps(robot, make_work(robot), np.ascontiguousarray(X_BL), pair, _PAIR_REACH, gaps)
    touching = gaps <= 0.0
    kept = ~touching[0] & (touching[1:].mean(axis=0) <= _ALWAYS)
    names = [f"{tree.link_names[links[i]]} and {tree.link_names[links[j]]}" for i, j in pair[~kept]]
    return RobotShape(
        links=links, parts=shape.parts, trees=shape.trees, points_L=shape.points_L, point_start=shape.point_start,
        pair=pair[kept], pair_gap=gaps[0, kept], always=tuple(names),
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _pair_gaps(robot, work, X_BL, pair, reach, out):  # type: ignore[no-untyped-def]
    """Distances (N, S) of pairs of links posed as X_BL (N, G, 4, 4), capped at `reach`."""
    for n in range(X_BL.shape[0]):
        work.X_BK[:] = X_BL[n]
        for g in range(X_BL.shape[1]):
            for r in range(3):
                c = robot.link_centre[g]
                X = X_BL[n, g]
                work.link_centre[g, r] = X[r, 0] * c[0] + X[r, 1] * c[1] + X[r, 2] * c[2] + X[r, 3]
        for k in range(pair.shape[0]):
            out[n, k] = links_gap(robot, pair[k, 0], pair[k, 1], reach, work)


def _loose_links(manipulator: Manipulator, shape: RobotShape) -> RobotArrays:
    """Arrays in which every link with parts is a body of its own; its joints are not meant to be used."""
    count = len(shape.links)
    X = np.tile(np.eye(4), (count, 1, 1))
    bodies = _Bodies(
        parents=np.full(count, -1, np.int32), joint_types=np.zeros(count, np.int8), X_parent_joint=X,
        axes=np.zeros((count, 3)), coupling=np.zeros((count, len(manipulator.arm_dofs))), offset=np.zeros(count),
        body=np.arange(count), X_KL=X,
    )  # fmt: skip
    return _arrays(manipulator, shape, bodies, self_margin_m=0.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Bodies:
    """Links fused to K bodies that the planned joints move; body and X_KL: of each link of `RobotShape.links`."""

    parents: np.ndarray
    joint_types: np.ndarray
    X_parent_joint: np.ndarray
    axes: np.ndarray
    coupling: np.ndarray
    offset: np.ndarray
    body: np.ndarray
    X_KL: np.ndarray


def robot_arrays(manipulator: Manipulator, q_hand: np.ndarray, *, self_margin_m: float) -> RobotArrays:
    """The arrays at hand joints (J,); pairs closer than twice the margin at home get half of that distance."""
    shape = robot_shape(manipulator)
    return _arrays(manipulator, shape, _fused(manipulator, q_hand, shape.links), self_margin_m=self_margin_m)


def _fused(manipulator: Manipulator, q_hand: np.ndarray, links: np.ndarray) -> _Bodies:
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
        body=body[links], X_KL=X_KL[links],
    )  # fmt: skip


def _moved(X: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.asarray(points @ X[:3, :3].T + X[:3, 3])


def _arrays(manipulator: Manipulator, shape: RobotShape, bodies: _Bodies, *, self_margin_m: float) -> RobotArrays:
    links, parts = shape.links, shape.parts
    of = np.searchsorted(links, [p.link for p in parts])  # link of each part, as an index into `links`
    spheres = [bounding_sphere(p) for p in parts]
    part_centre = np.array([_moved(bodies.X_KL[g], c) for g, (c, _) in zip(of, spheres, strict=True)])
    part_radius = np.array([r for _, r in spheres])
    part_start = np.searchsorted(of, np.arange(len(links) + 1))
    around = [
        _sphere_around(part_centre[a:b], part_radius[a:b]) for a, b in zip(part_start, part_start[1:], strict=False)
    ]
    is_hand = links >= manipulator.hand_link
    meets = bodies.body != 0
    nodes = _nodes(shape, bodies.X_KL, of)
    different = bodies.body[shape.pair[:, 0]] != bodies.body[shape.pair[:, 1]]
    hulls = [p.vertices if p.kind == PartKind.HULL else np.zeros((0, 3)) for p in parts]
    return RobotArrays(
        parents=bodies.parents, joint_types=bodies.joint_types,
        X_parent_joint=np.ascontiguousarray(bodies.X_parent_joint), axes=np.ascontiguousarray(bodies.axes),
        coupling=bodies.coupling, offset=bodies.offset,
        link_body=bodies.body.astype(np.int64), link_part_start=part_start.astype(np.int64),
        link_centre=np.array([c for c, _ in around]), link_radius=np.array([r for _, r in around]),
        link_is_hand=is_hand, link_meets_world=meets,
        part_kind=np.array([int(p.kind) for p in parts], np.int64),
        part_size=np.array([p.size for p in parts], float),
        part_X=np.array([bodies.X_KL[g] @ p.X_LP for g, p in zip(of, parts, strict=True)]),
        part_centre=part_centre, part_radius=part_radius,
        vertex_start=np.cumsum([0] + [len(v) for v in hulls]).astype(np.int64),
        vertices=np.ascontiguousarray(np.concatenate(hulls)),
        pair=np.ascontiguousarray(shape.pair[different]),
        pair_margin=np.minimum(self_margin_m, 0.5 * shape.pair_gap[different]),
        **nodes,
    )  # fmt: skip


def _nodes(shape: RobotShape, X_KL: np.ndarray, of: np.ndarray) -> dict[str, np.ndarray]:
    """The sphere trees and the points of the hand in the bodies' frames."""
    start = np.cumsum([0] + [len(t.radii) for t in shape.trees]).astype(np.int64)
    centre, points = np.empty((start[-1], 3)), np.empty_like(shape.points_L)
    for i, (g, tree) in enumerate(zip(of, shape.trees, strict=True)):
        a, b = start[i], start[i + 1]
        centre[a:b] = _moved(X_KL[g], tree.centres_L)
        c, d = shape.point_start[a], shape.point_start[b]
        points[c:d] = _moved(X_KL[g], shape.points_L[c:d])
    return {
        "node_start": start,
        "node_centre": centre,
        "node_radius": np.concatenate([t.radii for t in shape.trees]),
        "node_skip": np.concatenate([t.skip + a for t, a in zip(shape.trees, start, strict=False)]),
        "point_start": shape.point_start,
        "points": points,
    }


def _sphere_around(centres: np.ndarray, radii: np.ndarray) -> tuple[np.ndarray, float]:
    """A sphere that holds spheres."""
    low, high = (centres - radii[:, None]).min(axis=0), (centres + radii[:, None]).max(axis=0)
    middle = (low + high) / 2
    return middle, float((np.linalg.norm(centres - middle, axis=1) + radii).max())


def hand_in_body(manipulator: Manipulator, q_hand: np.ndarray) -> tuple[int, np.ndarray]:
    """The body that the hand base belongs to, and X_KH (4, 4)."""
    bodies = _fused(manipulator, q_hand, np.array([manipulator.hand_link]))
    return int(bodies.body[0]), bodies.X_KL[0]


def pose_in_hand(manipulator: Manipulator, q_hand: np.ndarray, X_HO: np.ndarray) -> tuple[int, np.ndarray]:
    """The body that carries the hand, and X_KO (4, 4) of something held at X_HO."""
    body, X_KH = hand_in_body(manipulator, q_hand)
    return body, X_KH @ np.asarray(X_HO, float)
