"""A hand that can be moved and measured, and which joints close it in which direction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import RobotDescriptionError
from neuralgrasps.hands.chains import find_fingers, moved_links, rigid_bodies
from neuralgrasps.hands.hand import ConvexPart
from neuralgrasps.hands.linkages import without_struts
from neuralgrasps.hands.notes import HandNotes
from neuralgrasps.hands.parts import sample_part
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.kinematics.tree import PRISMATIC, KinematicTree

PARALLEL = 0.7  # |cos| between flexion axes of one finger
_DENSITY = 1.0 / 0.004**2
_TIP_SHARE = 0.1  # of a finger's outermost body: its end
Clouds = dict[int, tuple[np.ndarray, np.ndarray]]  # link -> points, normals in its frame


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovableHand:
    """Tree with point clouds: per finger its links, its tip point and the surface of its outermost body."""

    tree: KinematicTree
    q0: np.ndarray  # 0, or the nearest value within the limits
    palm: int
    fingers: tuple[tuple[int, ...], ...]
    tip_link: tuple[int, ...]
    tip_L: tuple[np.ndarray, ...]
    clouds: Clouds
    moved: np.ndarray  # (L, J)
    palm_links: tuple[int, ...]

    def poses(self, q: np.ndarray) -> np.ndarray:
        return forward_numpy(self.tree, q)

    def tips(self, q: np.ndarray) -> np.ndarray:
        """(..., F, 3) tip points in H."""
        X = self.poses(q)
        tips = [X[..., i, :3, :3] @ p + X[..., i, :3, 3] for i, p in zip(self.tip_link, self.tip_L, strict=True)]
        return np.stack(tips, axis=-2)

    def cloud_H(self, links: Sequence[int], q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        X = self.poses(q)
        used = [i for i in links if i in self.clouds]
        points = [self.clouds[i][0] @ X[i, :3, :3].T + X[i, :3, 3] for i in used]
        normals = [self.clouds[i][1] @ X[i, :3, :3].T for i in used]
        if not used:
            return np.zeros((0, 3)), np.zeros((0, 3))
        return np.concatenate(points), np.concatenate(normals)

    def palm_centre(self, q: np.ndarray) -> np.ndarray:
        points, _ = self.cloud_H(self.palm_links, q)
        if not len(points):
            return self.poses(q)[self.palm, :3, 3]
        return (points.min(axis=0) + points.max(axis=0)) / 2


def movable_hand(name: str, tree: KinematicTree, parts: Sequence[ConvexPart], given: HandNotes) -> MovableHand:
    """Measure a hand, with its fingers from `given` or found where the tree branches.

    Raises:
        RobotDescriptionError: no fingers.
    """
    palm, fingers = find_fingers(tree, parts)
    if given.fingers is not None:
        fingers = tuple(tuple(tree.link_names.index(n) for n in f.links) for f in given.fingers)
    clouds: Clouds = {}
    for link in {p.link for p in parts}:
        samples = [sample_part(p, _DENSITY) for p in parts if p.link == link]
        clouds[link] = np.concatenate([s[0] for s in samples]), np.concatenate([s[1] for s in samples])
    moved = moved_links(tree)
    if given.fingers is None:
        fingers = tuple(f for f in fingers if any(i in clouds for i in f) and moved[list(f)].any())
        fingers = without_struts(tree, fingers, clouds, moved)
    if not fingers:
        raise RobotDescriptionError(
            f"hand '{name}': no fingers found (branches with movable joints and geometry); name them in a hand.toml "
            "with [[fingers]] tables."
        )
    body = rigid_bodies(tree)
    q0 = np.clip(0.0, tree.lower, tree.upper)
    X = forward_numpy(tree, q0)
    ends = [_tip(tree, clouds, finger, X) for finger in fingers]
    return MovableHand(
        tree=tree,
        q0=q0,
        palm=palm,
        fingers=fingers,
        tip_link=tuple(e[0] for e in ends),
        tip_L=tuple(e[1] for e in ends),
        clouds=clouds,
        moved=moved,
        palm_links=tuple(int(i) for i in np.flatnonzero(body == palm)),
    )


def _tip(tree: KinematicTree, clouds: Clouds, finger: tuple[int, ...], X: np.ndarray) -> tuple[int, np.ndarray]:
    """Outermost link with geometry and the middle of its far end, link frame."""
    link = ([i for i in finger if i in clouds] or [finger[-1]])[-1]
    if link not in clouds:
        return link, np.zeros(3)
    points = clouds[link][0] @ X[link, :3, :3].T + X[link, :3, 3]
    base = X[finger[0], :3, 3]
    reach = np.linalg.norm(points - base, axis=1)
    far = reach >= np.quantile(reach, 1 - _TIP_SHARE)
    return link, clouds[link][0][far].mean(axis=0)


def closing_shares(model: MovableHand) -> np.ndarray:
    """(J,) signed share of each joint in closing, largest magnitude 1; 0 for joints that do not flex a finger."""
    tree = model.tree
    closing = np.zeros(tree.num_dofs)
    X = model.poses(model.q0)
    for f, finger in enumerate(model.fingers):
        sense = _flexion_senses(model, finger, X)
        if not sense.any():
            continue
        ends = [np.where(sense == 0, model.q0, np.where(sense * s > 0, tree.upper, tree.lower)) for s in (1.0, -1.0)]
        cost = [_tip_cost(model, f, q) for q in ends]
        best = 0 if cost[0] <= cost[1] else 1
        sign = sense * (1.0, -1.0)[best]
        room = np.abs(ends[best] - open_values(model, sign, ends[best]))
        share = np.where(sign != 0, sign * room / max(room[sign != 0].max(), 1e-9), 0.0)
        closing = np.where(closing == 0, share, closing)
    return closing


def _flexion_senses(model: MovableHand, finger: tuple[int, ...], X: np.ndarray) -> np.ndarray:
    """(J,) +1 or -1: joints that turn (or slide) like the finger's last one, in its sense or against it; else 0."""
    tree = model.tree
    joints = [i for i in finger if tree.coupling[i].any()]
    sense = np.zeros(tree.num_dofs)
    if not joints:
        return sense
    last = joints[-1]
    reference = X[last, :3, :3] @ tree.axes[last]
    for i in reversed(joints):
        cosine = float(reference @ X[i, :3, :3] @ tree.axes[i])
        if tree.joint_types[i] != tree.joint_types[last] or abs(cosine) < PARALLEL:
            continue
        for j in np.flatnonzero(tree.coupling[i]):
            if sense[j] == 0:
                sense[j] = np.sign(cosine * tree.coupling[i, j])
    return sense


def _tip_cost(model: MovableHand, finger: int, q: np.ndarray) -> float:
    """Distance of a fingertip from the palm and the other tips, metres."""
    tips = model.tips(q)
    others = np.delete(tips, finger, axis=0)
    cost = float(np.linalg.norm(tips[finger] - model.palm_centre(q)))
    return cost + (float(np.linalg.norm(others - tips[finger], axis=1).mean()) if len(others) else 0.0)


def open_values(model: MovableHand, sign: np.ndarray, closed: np.ndarray) -> np.ndarray:
    """Zero posture where the joint is straight there; the other end of the range where zero is (nearly) closed."""
    tree = model.tree
    span = tree.upper - tree.lower
    other_end = np.where(sign > 0, tree.lower, tree.upper)
    slides = sliding_joints(tree)
    return np.where((np.abs(closed - model.q0) < 0.3 * span) | slides, other_end, model.q0)


def sliding_joints(tree: KinematicTree) -> np.ndarray:
    return ((tree.joint_types == PRISMATIC)[:, None] & (tree.coupling != 0)).any(axis=0)


def open_and_closed(model: MovableHand, closing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    tree = model.tree
    closed = np.where(closing > 0, tree.upper, np.where(closing < 0, tree.lower, model.q0))
    opened = np.where(closing != 0, open_values(model, closing, closed), model.q0)
    return opened, closed


def share_to_nearest_tips(model: MovableHand, q_open: np.ndarray, q_closed: np.ndarray) -> float:
    """The share of the way from open to closed at which the fingertips are nearest to each other; then they cross."""
    if len(model.fingers) < 2:
        return 1.0
    shares = np.linspace(0.0, 1.0, 21)[1:]
    tips = model.tips(q_open + shares[:, None] * (q_closed - q_open))
    gaps = np.linalg.norm(tips[:, :, None] - tips[:, None], axis=-1).mean(axis=(1, 2))
    return float(shares[int(np.argmin(gaps))])


def unit(v: np.ndarray) -> np.ndarray:
    return v / max(float(np.linalg.norm(v)), 1e-12)
