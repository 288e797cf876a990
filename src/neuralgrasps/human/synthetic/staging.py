"""Who grasps what, how, and on what way: a person's grasp of an object that rests on a table, drawn at random."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.human.forearm import WristAxes
from neuralgrasps.human.seen import Side
from neuralgrasps.human.synthetic.hand_path import HandPath, find_path
from neuralgrasps.human.synthetic.person_grasps import PersonGrasps, person_grasps, table_frame
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.resting_plane import resting_planes

GraspKind = Literal["any", "power", "precision"]
_SAME_HEIGHT_M = 0.008  # resting poses whose centres of mass are this near in height count as alike
_MOST_PATHS = 6  # grasps to which a way is looked for, of each hand and resting pose


class NoPersonGraspError(InputError):
    """No hand of the sizes tried grasps the object in any resting pose."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Act:
    """A hand, a grasp and the way to it, in W with the table at z = 0, the object's centre of mass above the origin.

    Attributes:
        hand: the human hand of that side and scale.
        X_WO: (4, 4) the object at rest. path: the way to the grasp, which it ends with.
        forearm_H: (3,) unit direction from the wrist to the elbow, in H.
        precision: only fingertips touch.
        notes: sizes and resting poses that were drawn before, and why they gave no grasp.
    """

    hand: Hand
    side: Side
    scale: float
    X_WO: np.ndarray
    path: HandPath
    forearm_H: np.ndarray
    precision: bool
    notes: tuple[str, ...]

    @property
    def person(self) -> float:
        """Azimuth in W from which the arm comes, rad."""
        out_W = self.path.X_WH[:3, :3] @ self.forearm_H
        if np.hypot(out_W[0], out_W[1]) < 0.3:
            out_W = self.path.X_WH[:3, :3] @ WristAxes.of(self.hand).out
        return float(np.arctan2(out_W[1], out_W[0]))


def stage(obj: ObjectModel, *, side: Side, sizes: Sequence[float], kind: GraspKind, rng: np.random.Generator) -> Act:
    """A grasp with a way to it; where the first size and resting pose drawn give none, others are tried.

    Args:
        sizes: scales of the hand, in the order they are tried.
    Raises:
        NoPersonGraspError: none of them grasps the object in any resting pose; says why.
    """
    planes, notes = resting_planes(obj), list[str]()
    for scale in sizes:
        for k in _poses_in_turn(obj, planes, rng):
            people = person_grasps(obj, scale=scale, side=side, plane_O=planes[k])
            found = _with_path(obj, people, planes[k], kind, scale, rng)
            if found is not None:
                X_WO, row, path = found
                return Act(
                    hand=people.hand, side=side, scale=scale, X_WO=X_WO, path=path, forearm_H=people.forearm_H[row],
                    precision=bool(people.grasps.precision[row]), notes=tuple(notes),
                )  # fmt: skip
            why = people.reason or "no grasp of that kind has a clear way to it"
            notes.append(f"hand of scale {scale:g}, resting pose {k}: {why}")
    raise NoPersonGraspError(
        f"no person's grasp of '{obj.name}' was found for a {side} hand: {'; '.join(notes)}. Choose another object, "
        "size, side or kind of grasp."
    )


def _poses_in_turn(obj: ObjectModel, planes: Sequence[Plane], rng: np.random.Generator) -> list[int]:
    """Resting poses in the order they are tried: one of each height, in random order, then others of the same heights.

    A bottle that stands is as likely as one that lies, however many sides it can lie on.
    """
    heights: dict[int, list[int]] = {}
    for k, plane in enumerate(planes):
        heights.setdefault(round(float(plane.height(obj.com_O)) / _SAME_HEIGHT_M), []).append(k)
    groups = [list(rng.permutation(ks)[:2]) for ks in heights.values()]
    order = rng.permutation(len(groups))
    return [int(groups[g][n]) for n in range(2) for g in order if n < len(groups[g])]


def _with_path(
    obj: ObjectModel, people: PersonGrasps, plane_O: Plane, kind: GraspKind, scale: float, rng: np.random.Generator
) -> tuple[np.ndarray, int, HandPath] | None:
    """X_WO (4, 4) of the object put down at random, the row of a grasp of that kind, and a way to it."""
    X_WO = _put_down(obj, table_frame(plane_O), rng)
    for row in rng.permutation(np.flatnonzero(_of_kind(people.grasps, kind)))[:_MOST_PATHS]:
        X_WH, forearm_H = X_WO @ people.grasps.X_OH[row], people.forearm_H[row]
        path = find_path(people.hand, obj, X_WO, X_WH, people.grasps.q[row], forearm_H, scale=scale, rng=rng)
        if path is not None:
            return X_WO, int(row), path
    return None


def _of_kind(grasps: GraspSet, kind: GraspKind) -> np.ndarray:
    return np.ones(len(grasps), bool) if kind == "any" else grasps.precision == (kind == "precision")


def _put_down(obj: ObjectModel, X_TO: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(4, 4) X_WO: resting as in X_TO, turned at random, its centre of mass above the origin."""
    yaw, X = rng.uniform(0.0, 2.0 * np.pi), np.eye(4)
    X[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    X_WO = X @ X_TO
    X_WO[:2, 3] -= (X_WO[:3, :3] @ obj.com_O + X_WO[:3, 3])[:2]
    return X_WO
