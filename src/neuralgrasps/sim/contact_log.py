"""Who touched whom, how hard and how deep, while a table-top simulation ran."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import mujoco
import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.compiled import njit
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.sim.self_contact import geom_links
from neuralgrasps.sim.tabletop_model import FLOOR, SolidBox


class Thing(StrEnum):
    """Kinds of things that touch."""

    ARM = "arm"
    HAND = "hand"
    TABLE = "table"
    BOX = "box"
    FLOOR = "floor"
    OBJECT = "object"


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """One thing: its kind, its name (a link's, an object's), and its index among links, boxes or objects."""

    kind: Thing
    name: str
    index: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Touch:
    """Two things that touched in one phase.

    Attributes:
        phase: name of the phase. a, b: the things, in the order robot, objects, surroundings.
        max_force_n: largest sum of normal forces; max_depth_m: deepest overlap.
        first_s: time of the first contact.
    """

    phase: str
    a: Body
    b: Body
    max_force_n: float
    max_depth_m: float
    first_s: float

    def unwanted(self, target: int) -> bool:
        """Should it not have been, when the hand picks up object `target`?

        The robot may touch that object with its hand; the object may touch the table, and was near nothing else.
        """
        a, b = self.a, self.b
        if a.kind is Thing.ARM or (a.kind is Thing.HAND and not (b.kind is Thing.OBJECT and b.index == target)):
            return True
        is_target = [x.kind is Thing.OBJECT and x.index == target for x in (a, b)]
        return any(is_target) and (a.kind is b.kind is Thing.OBJECT or b.kind is Thing.BOX)

    def __str__(self) -> str:
        return (
            f"{self.phase}: {self.a.name} touches {self.b.name} with {self.max_force_n:.1f} N, "
            f"{1e3 * self.max_depth_m:.1f} mm deep, from {self.first_s:.2f} s"
        )


@njit(cache=True, error_model="numpy")
def _collect(owner, geoms, dist, address, efc_force, time, now, force, depth, first):  # type: ignore[no-untyped-def]
    """Add the contacts of one state; `now`, `force`, `depth`, `first` (B, B), upper triangle."""
    for c in range(geoms.shape[0]):
        a, b = owner[geoms[c, 0]], owner[geoms[c, 1]]
        now[min(a, b), max(a, b)] = 0.0
    for c in range(geoms.shape[0]):
        a, b = owner[geoms[c, 0]], owner[geoms[c, 1]]
        i, j = min(a, b), max(a, b)
        if dist[c] > 0.0:
            continue
        # in an elliptic cone the first row of a contact is its normal force
        now[i, j] += efc_force[address[c]] if address[c] >= 0 else 0.0
        depth[i, j] = max(depth[i, j], -dist[c])
        first[i, j] = min(first[i, j], time)
        force[i, j] = max(force[i, j], now[i, j])


class ContactLog:
    """Largest force and depth of every pair of things, phase by phase.

    Args:
        bodies: the things, robot first, then objects, then surroundings. owner: (G,) index into
            `bodies` of every geom.
    """

    def __init__(self, bodies: Sequence[Body], owner: np.ndarray) -> None:
        self.bodies = tuple(bodies)
        self._owner = np.ascontiguousarray(owner, np.int64)
        self._phases: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}
        self._now = self._empty()[0]
        self._current = self._empty()

    def _empty(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        count = len(self.bodies)
        return np.zeros((count, count)), np.full((count, count), -1.0), np.full((count, count), np.inf)

    def clear(self) -> None:
        """Forget everything."""
        self._phases.clear()

    def begin(self, phase: str) -> None:
        """What follows belongs to `phase`; a phase of the same name goes on."""
        self._current = self._phases.setdefault(phase, self._empty())

    def add(self, data: mujoco.MjData) -> None:
        """Look at the contacts of a state after its forces were computed."""
        if data.ncon:
            contact = data.contact
            _collect(
                self._owner, contact.geom, contact.dist, contact.efc_address, data.efc_force, data.time, self._now,
                *self._current,
            )  # fmt: skip

    def touches(self, phases: Sequence[str] | None = None) -> tuple[Touch, ...]:
        """All pairs that touched, by phase in their order, then by time; all phases when None."""
        found = []
        for phase, (force, depth, first) in self._phases.items():
            if phases is not None and phase not in phases:
                continue
            pairs = [(int(i), int(j)) for i, j in np.argwhere(depth >= 0.0)]
            found += [
                self._touch(phase, i, j, force, depth, first) for i, j in sorted(pairs, key=lambda p: (first[p], p))
            ]
        return tuple(found)

    def now(self, data: mujoco.MjData, phase: str) -> tuple[Touch, ...]:
        """The pairs that touch in one state."""
        alone = ContactLog(self.bodies, self._owner)
        alone.begin(phase)
        alone.add(data)
        return alone.touches()

    def _touch(self, phase: str, i: int, j: int, force: np.ndarray, depth: np.ndarray, first: np.ndarray) -> Touch:
        return Touch(
            phase=phase, a=self.bodies[i], b=self.bodies[j], max_force_n=float(force[i, j]),
            max_depth_m=float(depth[i, j]), first_s=float(first[i, j]),
        )  # fmt: skip


def scene_things(
    model: mujoco.MjModel, manipulator: Manipulator, objects: Sequence[ObjectModel], boxes: Sequence[SolidBox]
) -> tuple[list[Body], np.ndarray]:
    """Everything that can touch in a model of `tabletop_model`, and which of it each geom is: `ContactLog`'s."""
    links = manipulator.tree.link_names
    bodies = [
        Body(kind=Thing.HAND if i >= manipulator.hand_link else Thing.ARM, name=name, index=i)
        for i, name in enumerate(links)
    ]
    owner = geom_links(model, len(links))
    for k, obj in enumerate(objects):
        owner[model.geom_bodyid == model.body(f"object_{k}").id] = len(bodies)
        bodies.append(Body(kind=Thing.OBJECT, name=obj.name, index=k))
    for k, box in enumerate(boxes):
        owner[model.geom(f"box_{k}").id] = len(bodies)
        bodies.append(Body(kind=Thing.BOX if k else Thing.TABLE, name=box.name, index=k))
    owner[model.geom(FLOOR).id] = len(bodies)
    bodies.append(Body(kind=Thing.FLOOR, name=FLOOR, index=0))
    return bodies, owner
