"""Self-collision of a hand that is not annotated yet, and a test that an annotation makes sense."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from neuralgrasps.hands.chains import rigid_bodies
from neuralgrasps.hands.closing import MovableHand
from neuralgrasps.hands.hand import ConvexPart
from neuralgrasps.hands.parts import bounding_sphere, part_distances

ALLOWED_DEPTH = 0.001  # metres: links that touch
DEEP = 0.003  # metres: links that run through each other
NEARER = 0.001  # metres by which closing must narrow the mean gap between fingertips
EARLY = 0.1  # share of the way to the joints' ends within which no finger should meet another one
_STEPS = 24


class SelfContact:
    """Depth of links in each other, over pairs of bodies that are not neighbours and apart at the zero posture."""

    def __init__(self, model: MovableHand, parts: Sequence[ConvexPart]) -> None:
        self._model = model
        self._parts = tuple(parts)
        self._spheres = tuple(bounding_sphere(p) for p in parts)
        body = rigid_bodies(model.tree)
        above = [int(body[max(model.tree.parents[b], 0)]) for b in body]
        self._pairs = [
            (a, b)
            for a, b in combinations(range(len(parts)), 2)
            if body[parts[a].link] != body[parts[b].link]
            and above[parts[a].link] != body[parts[b].link]
            and above[parts[b].link] != body[parts[a].link]
        ]
        X = model.poses(model.q0)
        self._pairs = [pair for pair in self._pairs if self._pair_depth(X, pair) <= ALLOWED_DEPTH]

    def depth(self, q: np.ndarray) -> float:
        """Largest depth at the joints q (J,) of one link's surface points in the parts of another, metres, >= 0."""
        X = self._model.poses(q)
        return max((self._pair_depth(X, pair) for pair in self._pairs), default=0.0)

    def last_free(self, q_open: np.ndarray, q_end: np.ndarray) -> np.ndarray:
        """The last posture on the straight way from open to `q_end`, in `_STEPS` steps, before links collide."""
        return q_open + self._free_share(q_open, q_end, self._pairs) * (q_end - q_open)

    def share_before_fingers_meet(self, q_open: np.ndarray, q_end: np.ndarray) -> float:
        """The share of that way, 0 to 1, before one finger runs into another."""
        finger = {link: f for f, links in enumerate(self._model.fingers) for link in links}
        owners = [tuple(finger.get(self._parts[k].link, -1) for k in pair) for pair in self._pairs]
        between = [pair for pair, (a, b) in zip(self._pairs, owners, strict=True) if -1 < a != b > -1]
        return self._free_share(q_open, q_end, between)

    def _free_share(self, q_open: np.ndarray, q_end: np.ndarray, pairs: Sequence[tuple[int, int]]) -> float:
        free = 0.0
        for share in np.linspace(0.0, 1.0, _STEPS + 1)[1:]:
            X = self._model.poses(q_open + share * (q_end - q_open))
            if any(self._pair_depth(X, pair) > ALLOWED_DEPTH for pair in pairs):
                break
            free = float(share)
        return free

    def _pair_depth(self, X_HL: np.ndarray, pair: tuple[int, int]) -> float:
        centres = [X_HL[self._parts[k].link, :3] @ np.append(self._spheres[k][0], 1.0) for k in pair]
        if np.linalg.norm(centres[1] - centres[0]) > self._spheres[pair[0]][1] + self._spheres[pair[1]][1]:
            return 0.0
        return max(self._depth_in(X_HL, *pair), self._depth_in(X_HL, *pair[::-1]))

    def _depth_in(self, X_HL: np.ndarray, inner: int, outer: int) -> float:
        """Depth of the points of one part's link in another part."""
        link, other = self._parts[inner].link, self._parts[outer].link
        X_OL = np.linalg.inv(X_HL[other]) @ X_HL[link]
        points = self._model.clouds[link][0] @ X_OL[:3, :3].T + X_OL[:3, 3]
        centre, radius = self._spheres[outer]
        near = points[np.linalg.norm(points - centre, axis=1) < radius]
        return max(0.0, -float(part_distances(self._parts[outer], near).min())) if len(near) else 0.0


def doubts(
    model: MovableHand, contact: SelfContact, closing: np.ndarray, q_open: np.ndarray, q_closed: np.ndarray
) -> tuple[str, ...]:
    """What looks wrong when the hand closes as annotated, in words; empty if it looks right.

    Half closed is half of the way to where links first meet: a thumb is meant to meet the fingers, but not at once.

    Args:
        closing: (J,) signed closing rates; q_open, q_closed: (J,) open posture and the joints' closed ends.
    """
    if not closing.any():
        return ("no joint closes the hand",)
    found = []
    if (depth := contact.depth(q_open)) > DEEP:
        found.append(f"links are {1000 * depth:.0f} mm deep in each other in the open posture")
    elif (depth := contact.depth(q_open + EARLY * (q_closed - q_open))) > DEEP:
        found.append(f"links are {1000 * depth:.0f} mm deep in each other as soon as the hand closes")
    met = contact.last_free(q_open, q_closed)
    path = [q_open + share * (met - q_open) for share in (0.25, 0.5, 1.0)]
    if len(model.fingers) > 1 and not min(_gap(model, q) for q in path) < _gap(model, q_open) - NEARER:
        found.append("closing does not bring the fingertips closer to each other")
    return tuple(found)


def _gap(model: MovableHand, q: np.ndarray) -> float:
    """Mean distance between fingertips, metres."""
    tips = model.tips(q)
    return float(np.mean([np.linalg.norm(a - b) for a, b in combinations(tips, 2)]))
