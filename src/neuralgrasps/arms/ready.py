"""Natural postures to start from: the face in front of the arm, above a table, pointing down; elbow up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuralgrasps.hands.chains import rigid_bodies
from neuralgrasps.hands.hand import ConvexPart
from neuralgrasps.hands.parts import part_distances, part_mesh
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.kinematics.tree import REVOLUTE, KinematicTree
from neuralgrasps.seeds import child_rng

TABLE_FROM_M = 0.25  # x of B from which on there may be a table
TABLE_CLEARANCE_M = 0.12  # wanted between the table and everything that moves
_HAND_M, _HAND_RADIUS_M = 0.20, 0.09  # stand-in for a hand that is not known: a rod out of the face
_LENGTH = 1.0  # m; an arm with less reach has its face as much nearer to the table
_HEIGHT_M, _AHEAD = 0.45, 0.55  # of the face above the table; ahead of the shoulder, in reaches
_DOWN = np.array([0.35, 0.0, -0.94])  # where the face looks, in B
_STARTS, _CHILDREN, _ROUNDS = 64, 12, 12
_SIDES = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z], float)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReadyScene:
    """What a posture to start from is judged by.

    Attributes:
        flange: link that carries the hand; X_FM: (4, 4) mounting face in it, z outwards.
        table_height_m: of a table in front of the arm, above B.
    """

    flange: int
    X_FM: np.ndarray
    table_height_m: float


class ReadyPostures:
    """Scores postures of an arm, and searches good ones at random.

    Args:
        rest: (Q,) values of the joints that stay; joints: (D,) indices of those that move.
    """

    def __init__(
        self, tree: KinematicTree, parts: Sequence[ConvexPart], scene: ReadyScene, rest: np.ndarray, joints: np.ndarray
    ) -> None:
        self.tree, self.scene, self.rest, self.joints = tree, scene, rest, joints
        chain = _chain(tree, scene.flange)
        self._turning = [i for i in chain if tree.joint_types[i] == REVOLUTE]
        self._movers = [i for i in chain if tree.coupling[i, joints].any()]
        body = rigid_bodies(tree)
        wrist = {int(body[scene.flange]), int(body[tree.parents[body[scene.flange]]])}
        self._arm_parts = [p for p in parts if int(body[p.link]) not in wrist]
        swung = _beyond(tree, self._turning[0])
        self._points = [(p.link, _outline(p), 0.0) for p in parts if swung[p.link]]
        window = np.maximum(tree.lower, -np.pi), np.minimum(tree.upper, np.pi)
        usable = window[1] - window[0] > 0.5
        self.lower = np.where(usable, window[0], tree.lower)[joints]
        self.upper = np.where(usable, window[1], tree.upper)[joints]
        self._shoulder = forward_fast(tree, rest)[self._turning[min(1, len(self._turning) - 1)], :3, 3]
        self._shoulder[1] = 0.0
        self.reach = 1.0

    def search(self, seed: int = 0) -> np.ndarray:
        """(K, Q) postures, best first; they may touch themselves."""
        rng, span = child_rng(seed, "ready-posture"), self.upper - self.lower
        drawn = self.lower + rng.uniform(0.05, 0.95, (2048, len(self.joints))) * span
        tips = self._poses(drawn)[:, self.scene.flange, :3, 3]
        self.reach = max(0.1, float(np.linalg.norm(tips - self._shoulder, axis=1).max()))
        best = drawn[np.argsort(self.cost(drawn), kind="stable")[:_STARTS]]
        for step in 0.25 * 0.75 ** np.arange(_ROUNDS):
            moves = rng.normal(0.0, step, (_STARTS, _CHILDREN, best.shape[1])) * np.minimum(span, 2 * np.pi) / 2
            moves[:, 0] = 0.0
            tried = np.clip(best[:, None] + moves, self.lower + 0.02 * span, self.upper - 0.02 * span)
            cost = self.cost(tried.reshape(-1, best.shape[1])).reshape(_STARTS, _CHILDREN)
            best = tried[np.arange(_STARTS), cost.argmin(axis=1)]
        best = best[np.argsort(self.cost(best), kind="stable")]
        q = np.tile(self.rest, (len(best), 1))
        q[:, self.joints] = best
        return q

    def cost(self, q: np.ndarray) -> np.ndarray:
        """(N,) of the moving joints (N, D): 0 is perfect, 1 poor."""
        X = self._poses(q)
        face = X[:, self.scene.flange] @ self.scene.X_FM
        size, height = min(1.0, self.reach / _LENGTH), self.scene.table_height_m
        wanted = self._shoulder + np.array([_AHEAD * self.reach, 0.0, 0.0])
        wanted[2] = height + _HEIGHT_M * size
        place = np.linalg.norm((face[:, :3, 3] - wanted) / (0.25 * size), axis=1)
        aim = 1.0 - face[:, :3, 2] @ (_DOWN / np.linalg.norm(_DOWN))
        near = np.maximum(0.0, 1.0 - self.table_gap(X) / (TABLE_CLEARANCE_M * size))
        middle, half = (self.lower + self.upper) / 2, np.maximum((self.upper - self.lower) / 2, 1e-6)
        limits = (np.maximum(0.0, np.abs((q - middle) / half) - 0.6) ** 2).sum(axis=1)
        turned = ((q - np.clip(0.0, self.lower, self.upper)) ** 2).sum(axis=1) / np.pi**2
        elbow = self._elbow(X) / self.reach
        stiff = np.maximum(0.0, 0.15 - self._agility(X)) / 0.15
        return np.asarray(place**2 + 3 * aim + 5 * near + 3 * limits + 0.2 * turned + stiff - np.minimum(elbow, 0.3))

    def table_gap(self, X: np.ndarray) -> np.ndarray:
        """(N,) metres from the table to what moves, hand included, for link poses (N, L, 4, 4); negative inside."""
        height, gaps = self.scene.table_height_m, []
        for link, points, radius in (*self._points, (self.scene.flange, self._hand(), _HAND_RADIUS_M)):
            at = points @ X[:, link, :3, :3].transpose(0, 2, 1) + X[:, link, None, :3, 3]
            outside = np.stack([TABLE_FROM_M - at[..., 0], at[..., 2] - height])
            far = np.linalg.norm(np.maximum(outside, 0.0), axis=0)
            gap = np.where((outside > 0).any(axis=0), far, outside.max(axis=0)).min(axis=1)
            gaps.append(gap - radius)
        return np.asarray(np.min(gaps, axis=0))

    def hand_gap(self, q: np.ndarray) -> float:
        """Metres from a hand on the face to the arm behind its wrist, at all joints (Q,)."""
        X = forward_fast(self.tree, q)
        gaps = [part_distances(p, _into(X[p.link], X[self.scene.flange], self._hand())).min() for p in self._arm_parts]
        return float(min(gaps, default=np.inf)) - _HAND_RADIUS_M

    def _hand(self) -> np.ndarray:
        along = np.linspace(_HAND_RADIUS_M, _HAND_M, 5)[:, None]
        return np.asarray(self.scene.X_FM[:3, 3] + along * self.scene.X_FM[:3, 2])

    def _poses(self, q: np.ndarray) -> np.ndarray:
        full = np.tile(self.rest, (len(q), 1))
        full[:, self.joints] = q
        return forward_fast(self.tree, full)

    def _elbow(self, X: np.ndarray) -> np.ndarray:
        """(N,) metres that the highest joint is above the line from the shoulder to the wrist's end."""
        ends = X[:, self._turning[1 if len(self._turning) > 2 else 0], 2, 3], X[:, self.scene.flange, 2, 3]
        return np.asarray(X[:, self._turning, 2, 3].max(axis=1) - (ends[0] + ends[1]) / 2)

    def _agility(self, X: np.ndarray) -> np.ndarray:
        """(N,) least singular value of the face's Jacobian, lengths in reaches: 0 where the arm is stretched."""
        tip = (X[:, self.scene.flange] @ self.scene.X_FM)[:, :3, 3]
        columns = []
        for i in self._movers:
            axis = X[:, i, :3, :3] @ self.tree.axes[i]
            turns = self.tree.joint_types[i] == REVOLUTE
            moved = np.cross(axis, tip - X[:, i, :3, 3]) if turns else axis
            columns.append(np.concatenate([moved / self.reach, axis if turns else 0.0 * axis], axis=1))
        return np.asarray(np.linalg.svd(np.stack(columns, axis=2), compute_uv=False)[:, -1])


def _into(X_BL: np.ndarray, X_BF: np.ndarray, points_F: np.ndarray) -> np.ndarray:
    X = np.linalg.inv(X_BL) @ X_BF
    return np.asarray(points_F @ X[:3, :3].T + X[:3, 3])


def _chain(tree: KinematicTree, link: int) -> list[int]:
    chain = [link]
    while tree.parents[chain[-1]] >= 0:
        chain.append(int(tree.parents[chain[-1]]))
    return chain[::-1]


def _beyond(tree: KinematicTree, link: int) -> np.ndarray:
    """(L,) bool: hangs on `link`, behind a further joint."""
    body = rigid_bodies(tree)
    beyond = np.zeros(tree.num_links, bool)
    for i in range(link + 1, tree.num_links):
        parent = int(tree.parents[i])
        beyond[i] = beyond[parent] or (body[parent] == body[link] and body[i] != body[link])
    return beyond


def _outline(part: ConvexPart) -> np.ndarray:
    """(26, 3) outermost vertices of a part along the sides and diagonals of its link."""
    vertices = part_mesh(part).vertices
    return np.asarray(vertices[np.argmax(vertices @ _SIDES.T, axis=0)])
