"""Sphere trees hold the whole part and stand out of it by no more than asked."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.arms.zoo import arm_names, load_arm
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.primitives import convex_hull
from neuralgrasps.hands.hand import ConvexPart, PartKind
from neuralgrasps.hands.parts import part_distances, part_mesh, sample_part
from neuralgrasps.hands.zoo import hand_names, load_hand
from neuralgrasps.planning.collision_robot import ARM_EXCESS_M, HAND_EXCESS_M
from neuralgrasps.planning.spheres import SphereTree, cover_part

_X_LP = np.array([[0.36, 0.48, -0.8, 0.1], [-0.8, 0.6, 0.0, -0.2], [0.48, 0.64, 0.6, 0.3], [0, 0, 0, 1]])


def _part(kind: PartKind) -> ConvexPart:
    vertices, faces = np.zeros((0, 3)), np.zeros((0, 3), np.int32)
    if kind == PartKind.HULL:
        cloud = np.random.default_rng(0).normal(size=(24, 3)) * [0.03, 0.05, 0.02]
        vertices, faces = convex_hull(cloud)
    size = np.array([0.05, 0.03 if kind != PartKind.BOX else 0.08, 0.02])
    return ConvexPart(link=0, kind=kind, size=size, X_LP=_X_LP, vertices=vertices, faces=faces)


def _inside(part: ConvexPart, count: int) -> np.ndarray:
    """About `count` points on the surface, its corners, and points at random depths."""
    area = 0.01
    points, normals = sample_part(part, count / area)
    points, normals = points[:: max(1, len(points) // count)], normals[:: max(1, len(points) // count)]
    depth = np.random.default_rng(1).uniform(0, 0.06, (len(points), 1))
    inner = points - depth * normals
    inner = inner[part_distances(part, inner) <= 0]
    return np.concatenate([points, part_mesh(part).vertices, inner])


def _uncovered(tree: SphereTree, points: np.ndarray) -> float:
    """How far any point is outside all leaves, metres."""
    centres, radii = tree.centres_L[tree.leaves], tree.radii[tree.leaves]
    return max(float((np.linalg.norm(p - centres, axis=1) - radii).min()) for p in points)


def _excess(part: ConvexPart, tree: SphereTree) -> float:
    rng = np.random.default_rng(2)
    u = rng.normal(size=(64, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    centres, radii = tree.centres_L[tree.leaves], tree.radii[tree.leaves]
    return float(part_distances(part, (centres[:, None] + radii[:, None, None] * u).reshape(-1, 3)).max())


@pytest.mark.parametrize("kind", list(PartKind))
@pytest.mark.parametrize("excess", [0.003, 0.01])
def test_leaves_hold_the_part_and_stand_out_no_more_than_asked(kind: PartKind, excess: float) -> None:
    part = _part(kind)
    tree = cover_part(part, excess_m=excess)
    assert _uncovered(tree, _inside(part, 1500)) <= 1e-9
    assert _excess(part, tree) <= excess + 1e-9


@pytest.mark.parametrize("kind", list(PartKind))
def test_a_walk_down_the_tree_reaches_every_point(kind: PartKind) -> None:
    part = _part(kind)
    tree = cover_part(part, excess_m=0.004)
    for p in _inside(part, 150):
        away = np.linalg.norm(tree.centres_L - p, axis=1) - tree.radii
        i, reached = 0, False
        while i < len(away) and not reached:
            reached = bool(away[i] <= 1e-9 and tree.leaves[i])
            i = int(tree.skip[i]) if away[i] > 1e-9 else i + 1
        assert reached


def test_branches_are_nested() -> None:
    tree = cover_part(_part(PartKind.CYLINDER), excess_m=0.004)
    assert tree.skip[0] == len(tree.radii)
    ends = [len(tree.radii)]
    for i, end in enumerate(tree.skip):
        while ends[-1] <= i:
            ends.pop()
        assert i < end <= ends[-1]
        ends.append(int(end))


def _robots() -> list[str]:
    return [f"arm {n}" for n in arm_names()] + [f"hand {n}" for n in hand_names()]


@pytest.mark.parametrize("robot", _robots())
def test_every_built_in_hand_and_arm_is_covered(robot: str) -> None:
    kind, name = robot.split()
    parts = load_arm(name).parts if kind == "arm" else load_hand(name).parts
    excess = ARM_EXCESS_M if kind == "arm" else HAND_EXCESS_M
    for part in parts:
        tree = cover_part(part, excess_m=excess)
        assert _uncovered(tree, _inside(part, 60)) <= 1e-9
        assert _excess(part, tree) <= excess + 1e-9


def test_the_excess_must_be_positive() -> None:
    with pytest.raises(InputError, match="expected a positive length"):
        cover_part(_part(PartKind.BOX), excess_m=0.0)
