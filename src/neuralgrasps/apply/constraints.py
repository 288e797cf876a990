"""What a grasp is for, as conditions on where the hand may be: touch only here, keep this free, come from there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from neuralgrasps.apply.region_kernels import surface_distances
from neuralgrasps.apply.regions import AXES, Region, SplitSurface, region_depths, split_surface
from neuralgrasps.errors import InputError, ShapeError, unknown_name
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import pack_shapes
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.resting_plane import resting_planes
from neuralgrasps.synthesis.contacts import TOUCH_M
from neuralgrasps.synthesis.support import Support

MARGIN_M = 5e-3
_EXACT_M = 5e-5  # distances are decided to so much
_LEAST_AREA = 0.005  # of the surface: a smaller patch cannot be held by two fingers
_Check = Callable[
    [Hand, np.ndarray, np.ndarray, np.ndarray | None], np.ndarray
]  # hand, X_OH, q, q_pregrasp -> (N,) bool
_TOO_STEEP_RAD = np.radians(60.0)  # off straight up: a palm that rises more than that comes through the table
_UP_COSINE = np.cos(np.radians(30.0))  # a face of an object counts as "+z" up to so much off the axis


@dataclass(frozen=True, slots=True, kw_only=True)
class ApproachCone:
    """Directions in which the palm may come: its approach axis (z of the palm frame) is in a cone.

    Attributes:
        axis: (3,) the middle of the cone, of any length: (0, 0, -1) comes down from above.
        half_angle_rad: above 0, at most pi.
        frame: "object", or "world", in which z is up; that needs `side_up`.
    """

    axis: tuple[float, float, float]
    half_angle_rad: float
    frame: str = "object"

    def __post_init__(self) -> None:
        if self.frame not in ("object", "world"):
            raise unknown_name("frame", self.frame, ("object", "world"))
        if not (np.shape(self.axis) == (3,) and np.isfinite(self.axis).all() and np.linalg.norm(self.axis) > 1e-9):
            raise InputError(f"approach axis {self.axis} is no direction; expected three numbers, not all 0.")
        if not 0 < self.half_angle_rad <= np.pi:
            raise InputError(
                f"approach cone of half angle {np.degrees(self.half_angle_rad):g} degrees holds no direction; expected "
                "above 0 and at most 180, such as 30deg."
            )

    @property
    def unit(self) -> np.ndarray:
        """(3,) the axis at length 1."""
        axis = np.asarray(self.axis, np.float64)
        return axis / np.linalg.norm(axis)

    def __str__(self) -> str:
        name = next((n for n, a in AXES.items() if np.allclose(a, self.unit)), ",".join(f"{v:.3g}" for v in self.unit))
        frame = "" if self.frame == "object" else "world:"
        return f"{frame}{name} within {np.degrees(self.half_angle_rad):.3g}°"


@dataclass(frozen=True, kw_only=True, eq=False)
class GraspConstraints:
    """Conditions on grasps of one object, checked on the whole of the hand's solids, not on contact points only.

    Attributes:
        obj: the object; regions are parts of its surface.
        only_region: the hand touches (is nearer than `touch_m` to) the surface in these regions only. A hand that
            touches nothing passes.
        keep_free: no part of the hand, closed or before closing, is nearer than `margin_m` to the surface in these.
        approach: cone that the palm's approach axis lies in; None: any.
        side_up: which side faces up while the object rests on a table: +x -x +y -y +z -z; the hand keeps clear of that
            table (`support`). None: no table.
        X_WO: (4, 4) the object in the world; only for a world axis that is not vertical.
    Raises:
        InputError: conditions that no hand can meet, a region without surface, a side the object does not rest on.
    """

    obj: ObjectModel
    only_region: tuple[Region, ...] = ()
    keep_free: tuple[Region, ...] = ()
    approach: ApproachCone | None = None
    side_up: str | None = None
    margin_m: float = MARGIN_M
    touch_m: float = TOUCH_M
    X_WO: np.ndarray | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        for name in ("margin_m", "touch_m"):
            value = getattr(self, name)
            if not 0 <= value < np.inf:
                raise InputError(f"constraints: {name} is {value}; expected 0 or more, metres.")
        if self.side_up is not None and self.side_up not in AXES:
            raise unknown_name("side", self.side_up, AXES)
        if self.X_WO is not None and np.shape(self.X_WO) != (4, 4):
            raise ShapeError(f"X_WO has shape {np.shape(self.X_WO)}; expected (4, 4).")
        self._check_surface()
        self._check_approach()

    def __bool__(self) -> bool:
        return bool(self.only_region or self.keep_free or self.approach or self.side_up)

    def __str__(self) -> str:
        return "; ".join(self.names) or "no constraints"

    @cached_property
    def support(self) -> Support | None:
        """The table under the object, for `side_up`; None without."""
        if self.side_up is None:
            return None
        planes, axis = resting_planes(self.obj), AXES[self.side_up]
        best = max(planes, key=lambda p: float(p.normal @ axis))
        if best.normal @ axis < _UP_COSINE:
            possible = [n for n, a in AXES.items() if any(p.normal @ a >= _UP_COSINE for p in planes)]
            raise InputError(
                f"'{self.obj.name}' does not rest with its {self.side_up} side up: it would fall over. It rests with "
                f"{', '.join(possible) or 'none of its sides'} up."
            )
        return Support(plane=best)

    @cached_property
    def up_O(self) -> np.ndarray:
        """(3,) unit, what is up in the object's frame: +z when neither `side_up` nor `X_WO` says otherwise."""
        if self.X_WO is not None:
            return np.asarray(self.X_WO, np.float64)[2, :3]
        return AXES["+z"] if self.support is None else self.support.plane.normal

    @cached_property
    def only_surface(self) -> SplitSurface | None:
        """The object's surface in and out of `only_region`."""
        return split_surface(self.obj, self.only_region, up_O=self._side_axis) if self.only_region else None

    @cached_property
    def free_surface(self) -> SplitSurface | None:
        """The object's surface in and out of `keep_free`."""
        return split_surface(self.obj, self.keep_free, up_O=self._side_axis) if self.keep_free else None

    @cached_property
    def approach_O(self) -> np.ndarray | None:
        """(3,) unit axis of the approach cone in the object's frame."""
        cone = self.approach
        if cone is None or cone.frame == "object":
            return None if cone is None else cone.unit
        if self.X_WO is not None:
            return np.asarray(self.X_WO, np.float64)[:3, :3].T @ cone.unit
        if self.side_up is None:
            raise InputError(
                f"approach '{cone}' is in the world's frame; say which side of the object is up (such as side_up='+z')."
            )
        if abs(cone.unit[2]) < 1 - 1e-9:
            raise InputError(
                f"approach '{cone}' is not vertical, and how the object is turned on its table is not known; give "
                "an axis in the object's frame, or the object's pose (X_WO)."
            )
        return np.sign(cone.unit[2]) * self.up_O

    @property
    def names(self) -> tuple[str, ...]:
        """The conditions in words, in the order of `verdicts`."""
        return tuple(self._checks())

    def allows(self, hand: Hand, X_OH: np.ndarray, q: np.ndarray, q_pregrasp: np.ndarray | None = None) -> np.ndarray:
        """(N,) bool: grasps that meet every condition.

        Args:
            hand: the hand. X_OH: (N, 4, 4) in the object; q: (N, J) closed; q_pregrasp: (N, J) before closing, checked
                against `keep_free` and the table too when given.
        """
        good = np.ones(len(X_OH), np.bool_)
        for check in self._checks().values():  # cheap ones first; the rest see what is left
            left = np.flatnonzero(good)
            before = None if q_pregrasp is None else q_pregrasp[left]
            good[left] = check(hand, X_OH[left], q[left], before)
        return good

    def verdicts(
        self, hand: Hand, X_OH: np.ndarray, q: np.ndarray, q_pregrasp: np.ndarray | None = None
    ) -> Mapping[str, np.ndarray]:
        """Condition in words -> (N,) bool, which grasps meet it; arguments as for `allows`."""
        return {name: check(hand, X_OH, q, q_pregrasp) for name, check in self._checks().items()}

    def describe(
        self, hand: Hand, X_OH: np.ndarray, q: np.ndarray, q_pregrasp: np.ndarray | None = None, *,
        support: Support | None = None,
    ) -> str:  # fmt: skip
        """Which condition took away how many of N grasps, and how many are left; `support`: a table to clear, too."""
        verdicts = dict(self.verdicts(hand, X_OH, q, q_pregrasp))
        if support is not None:
            verdicts["clear of the table"] = support.allows(hand, X_OH, q, q_pregrasp)
        count = len(X_OH)
        if not verdicts or not count:
            return f"{count} candidates, {'no constraints' if not verdicts else str(self)}"
        all_met = np.stack(list(verdicts.values()))
        parts = []
        for k, name in enumerate(verdicts):
            lost = ~all_met[k]
            alone = int((lost & np.delete(all_met, k, axis=0).all(axis=0)).sum())
            only = f" ({alone} by nothing else)" if len(verdicts) > 1 and lost.any() else ""
            parts.append(f"'{name}' takes {int(lost.sum())}{only}")
        return f"of {count} candidates, {', '.join(parts)}; {int(all_met.all(axis=0).sum())} left"

    def clearance(self, hand: Hand, X_OH: np.ndarray, q: np.ndarray) -> np.ndarray:
        """(N,) distance of hands to the surface of `keep_free`, metres, to 0.1 mm; inf when nothing is kept free."""
        if self.free_surface is None:
            return np.full(len(X_OH), np.inf)
        return surface_distances(pack_shapes(hand), self.free_surface.inside_groups, X_OH, q)

    def marked(self, points_O: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(M,) bool each: which surface points (M, 3) lie in `keep_free`, and which in `only_region`; for pictures."""
        free, only = (
            region_depths(points_O, self.obj, regions, up_O=self._side_axis) <= 0
            if regions
            else np.zeros(len(points_O), np.bool_)
            for regions in (self.keep_free, self.only_region)
        )
        return free, only & ~free

    @property
    def _side_axis(self) -> np.ndarray:
        """What the sides top and bottom are measured along: the axis nearest to up, as users name it."""
        return max(AXES.values(), key=lambda a: float(a @ self.up_O))

    def _checks(self) -> dict[str, _Check]:
        """By their names."""
        checks: dict[str, _Check] = {}
        if self.approach is not None:
            checks[f"approach along {self.approach}"] = self._comes_along
        if self.support is not None:
            checks[f"clear of the table, {self.side_up} up"] = self.support.allows
        if self.keep_free:
            name = " or ".join(map(str, self.keep_free))
            checks[f"keep {name} free by {1e3 * self.margin_m:g} mm"] = self._keeps_free
        if self.only_region:
            checks[f"touch only {' or '.join(map(str, self.only_region))}"] = self._touches_only
        return checks

    def _comes_along(self, hand: Hand, X_OH: np.ndarray, q: np.ndarray, before: np.ndarray | None) -> np.ndarray:
        assert self.approach is not None and self.approach_O is not None
        cosine = (X_OH[:, :3, :3] @ hand.X_HP[:3, 2]) @ self.approach_O
        return cosine >= np.cos(self.approach.half_angle_rad) - 1e-12

    def _keeps_free(self, hand: Hand, X_OH: np.ndarray, q: np.ndarray, before: np.ndarray | None) -> np.ndarray:
        assert self.free_surface is not None
        clear = self._apart(hand, X_OH, q, self.free_surface.inside_groups, self.margin_m)
        if before is not None:
            left = np.flatnonzero(clear)
            clear[left] = self._apart(hand, X_OH[left], before[left], self.free_surface.inside_groups, self.margin_m)
        return clear

    def _touches_only(self, hand: Hand, X_OH: np.ndarray, q: np.ndarray, before: np.ndarray | None) -> np.ndarray:
        assert self.only_surface is not None
        return self._apart(hand, X_OH, q, self.only_surface.outside_groups, self.touch_m)

    @staticmethod
    def _apart(hand, X_OH, q, groups, least_m):  # type: ignore[no-untyped-def]
        """(N,) bool: hands no nearer than `least_m` to a surface."""
        far = surface_distances(pack_shapes(hand), groups, X_OH, q, most=least_m, enough=least_m, within=_EXACT_M)
        return far >= least_m

    def _check_surface(self) -> None:
        """Refuse regions that leave nothing to hold."""
        free, only = self.free_surface, self.only_surface
        if free is not None and free.share > 1 - _LEAST_AREA:
            raise InputError(
                f"keep free '{free.name}' covers all of the surface of '{self.obj.name}': nothing is left to touch. "
                "Make the region smaller."
            )
        if free is not None and only is not None:
            depth = region_depths(only.inside.mean(axis=1), self.obj, self.keep_free, up_O=self._side_axis)
            kept = SplitSurface(inside=only.inside[depth > 0], outside=only.outside, name=only.name)
            if kept.share < _LEAST_AREA:
                raise InputError(
                    f"only region '{only.name}' lies in what is kept free, '{free.name}': nothing is left to touch. "
                    "Choose regions that do not cover each other."
                )

    def _check_approach(self) -> None:
        """Refuse a side that cannot be up, and a cone in which every direction comes up through the table."""
        support, axis_O, cone = self.support, self.approach_O, self.approach
        if support is None or axis_O is None or cone is None:
            return
        tilt = np.arccos(np.clip(axis_O @ self.up_O, -1.0, 1.0))
        if tilt + cone.half_angle_rad < _TOO_STEEP_RAD:
            raise InputError(
                f"approach '{cone}' comes from below, through the table under '{self.obj.name}' with its "
                f"{self.side_up} side up. Approach from the side or from above, or leave the table out."
            )
