"""How far an arm's links keep from each other, and a posture to start from for an arm that nobody described."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from neuralgrasps.arms.ready import ReadyPostures, ReadyScene
from neuralgrasps.errors import RobotDescriptionError
from neuralgrasps.hands.chains import rigid_bodies
from neuralgrasps.hands.hand import ConvexPart
from neuralgrasps.hands.parts import bounding_sphere, part_distances, sample_part
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.kinematics.tree import PRISMATIC, KinematicTree
from neuralgrasps.seeds import child_rng

TRIES = 256
_MARGIN = 0.01  # m between links in a posture to start from
_DENSITY = 4000.0  # surface points per square metre: 16 mm apart
_ENOUGH_TURNING = 5  # turning joints that reach any posture; sliding ones rest in their middle then
_SAMPLES = 24  # random postures that tell which links always touch


class SelfClearance:
    """Distances between links of a robot that no joint connects directly.

    Links that touch in nearly every posture, as hulls of hollow shapes do, are left out.

    Args:
        rest: (Q,) a posture; joints: (D,) indices of the joints that move from there, all when None.
    """

    def __init__(
        self, tree: KinematicTree, parts: Sequence[ConvexPart], rest: np.ndarray, joints: np.ndarray | None = None
    ) -> None:
        self.tree, self.parts = tree, tuple(parts)
        self._points = [sample_part(p, _DENSITY)[0] for p in parts]
        self._spheres = [bounding_sphere(p) for p in parts]
        self._pairs = self._moving_pairs()
        q = np.tile(rest, (_SAMPLES, 1))
        moving = np.arange(tree.num_dofs) if joints is None else joints
        rng = child_rng(0, "self-clearance")
        q[:, moving] = rng.uniform(tree.lower[moving], tree.upper[moving], (_SAMPLES, len(moving)))
        poses = forward_fast(tree, q)
        touching = np.array([[self._gap(i, j, X) < 0 for i, j in self._pairs] for X in poses])
        self._pairs = [pair for pair, often in zip(self._pairs, touching.mean(axis=0) > 0.9, strict=True) if not often]

    def _moving_pairs(self) -> list[tuple[int, int]]:
        body = rigid_bodies(self.tree)
        above = {int(b): int(body[self.tree.parents[b]]) for b in np.unique(body) if b}
        links = [int(body[p.link]) for p in self.parts]
        return [
            (i, j)
            for i, j in combinations(range(len(links)), 2)
            if links[i] != links[j] and above.get(links[i]) != links[j] and above.get(links[j]) != links[i]
        ]

    def _gap(self, i: int, j: int, X: np.ndarray) -> float:
        """Metres between two parts, negative inside; beyond 0.1 m only a lower bound."""
        X_ij = np.linalg.inv(X[self.parts[i].link]) @ X[self.parts[j].link]
        (centre, radius), (other, other_radius) = self._spheres[i], self._spheres[j]
        apart = np.linalg.norm(X_ij[:3, :3] @ other + X_ij[:3, 3] - centre) - radius - other_radius
        if apart > 0.1:
            return float(apart)
        there = part_distances(self.parts[i], self._points[j] @ X_ij[:3, :3].T + X_ij[:3, 3])
        back = part_distances(self.parts[j], (self._points[i] - X_ij[:3, 3]) @ X_ij[:3, :3])
        return float(min(there.min(), back.min()))

    def __call__(self, q: np.ndarray) -> float:
        """Least distance, metres, at joints q (Q,), negative where links touch; beyond 0.1 m a lower bound."""
        X = forward_fast(self.tree, np.asarray(q, float))
        return min((self._gap(i, j, X) for i, j in self._pairs), default=np.inf)


def free_posture(
    tree: KinematicTree, parts: Sequence[ConvexPart], joints: np.ndarray, stated: Mapping[str, float], scene: ReadyScene
) -> np.ndarray:
    """(Q,) a natural posture in which nothing touches, clear of the table of `scene` where the arm can be.

    Args:
        joints: (D,) indices of the planned joints; the others are at rest: at 0, or the limit next to it.
        stated: values of joints by name, taken as they are.
    Raises:
        RobotDescriptionError: none of `TRIES` postures is free.
    """
    middle, fixed = middle_posture(tree, joints, stated)
    slides = np.array([tree.joint_types[tree.joint_names.index(n)] == PRISMATIC for n in tree.dof_names], bool)
    swings = ~fixed & ~slides if (~slides[joints]).sum() >= _ENOUGH_TURNING else ~fixed
    if (swings & ~slides).any():
        ready = ReadyPostures(tree, parts, scene, middle, np.flatnonzero(swings))
        clearance = SelfClearance(tree, parts, middle, np.flatnonzero(swings))
        postures = ready.search()
        gaps = ready.table_gap(forward_fast(tree, postures))
        for q in (*postures[gaps > _MARGIN], *postures[gaps <= _MARGIN]):
            if ready.hand_gap(q) > _MARGIN and clearance(q) > _MARGIN:
                return q
    return _near_middle(tree, SelfClearance(tree, parts, middle, np.flatnonzero(~fixed)), middle, fixed)


def middle_posture(
    tree: KinematicTree, joints: np.ndarray, stated: Mapping[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """(Q,) the planned joints in the middle of their ranges, others at rest, `stated` ones there; (Q,) bool: fixed."""
    middle = np.clip(0.0, tree.lower, tree.upper)
    middle[joints] = 0.5 * (tree.lower + tree.upper)[joints]
    fixed = np.ones(tree.num_dofs, bool)
    fixed[joints] = False
    for name, value in stated.items():
        middle[tree.dof_names.index(name)], fixed[tree.dof_names.index(name)] = value, True
    return middle, fixed


def _near_middle(tree: KinematicTree, clearance: SelfClearance, middle: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """(Q,) a posture that does not touch itself, as near the middle as chance finds one."""
    rng = child_rng(0, "free-posture")
    for attempt in range(TRIES):
        reach = min(1.0, attempt / (TRIES / 2))  # grows from the middle outwards
        q = middle + reach * rng.uniform(-0.5, 0.5, tree.num_dofs) * (tree.upper - tree.lower)
        q = np.where(fixed, middle, np.clip(q, tree.lower, tree.upper))
        if clearance(q) > _MARGIN:
            return q
    raise RobotDescriptionError(
        f"no posture of {TRIES} is free of contact between links; state one as 'home' of each joint in an arm.toml "
        "beside the file."
    )
