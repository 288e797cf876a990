"""Why a hand found too few grasps of an object: what stood in the way, in plain words with numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from neuralgrasps.geometry.plane import Plane
from neuralgrasps.hands.hand import Hand
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.seeds import child_rng
from neuralgrasps.synthesis.candidates import GraspProblem
from neuralgrasps.synthesis.jaw import WIDTH_SHARE, jaw_aperture
from neuralgrasps.synthesis.oppose import perpendicular, tip_points
from neuralgrasps.synthesis.propose import TIP_M, draw_pairs, draw_preshapes
from neuralgrasps.synthesis.support import Support

TOO_WIDE, TOO_SMALL, TOO_THIN = "too wide", "too small", "too thin"
NO_OPPOSITE_SIDES, NO_ROOM = "no opposite sides", "no room"
FEW_CONTACTS, NO_FORCE_CLOSURE, OVERLAPS, SLIPS, RARE, FEW_OF_A_KIND = (
    "few contacts", "no force closure", "overlaps", "slips", "rare", "few of a kind",
)  # fmt: skip
KINDS = (
    TOO_WIDE, TOO_SMALL, TOO_THIN, NO_OPPOSITE_SIDES, NO_ROOM, FEW_CONTACTS, NO_FORCE_CLOSURE, OVERLAPS, SLIPS, RARE,
    FEW_OF_A_KIND,
)  # fmt: skip
JAW_CLEARANCE_M = 2.0e-3  # pairs nearer to the aperture than this are not proposed
SMALL_M = 0.03  # an object with no side longer may be too small for fingertips
THIN_M = 0.006
UNDER_M = 0.01  # a finger under a side that faces the table is thicker than this
_FACE_M = 0.005  # of the lowest part of an object, what it stands on
_RAYS, _POSTURES = 8192, 512
_CORNERS = 0.05  # of the widths, the narrowest: slanted across a corner, where nothing can hold
_OBSTACLES = {
    "collides": NO_ROOM,
    "few contacts": FEW_CONTACTS,
    "no force closure": NO_FORCE_CLOSURE,
    "penetrates": OVERLAPS,
    "self-collides": NO_ROOM,
    "meets the table": NO_ROOM,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Shortfall:
    """Why fewer grasps than wanted were found: one of `KINDS`, and a clause with the numbers.

    `str()` gives "kind: clause", which `shortfall_kind` takes apart again.
    """

    kind: str
    clause: str

    def __str__(self) -> str:
        return f"{self.kind}: {self.clause}"


def shortfall_kind(reason: str) -> str:
    """The kind in the text of a `Shortfall`, or "" in any other text."""
    kind = reason.partition(":")[0]
    return kind if kind in KINDS else ""


def why_short(
    problem: GraspProblem,
    *,
    outcomes: Mapping[str, int],
    tried: int,
    held: int,
    missing: str,
    other_kind: int,
    by_kind: bool,
    rounds: int,
    protocol: str,
) -> Shortfall:
    """What stood in the way.

    Args:
        problem: hand, object and friction.
        outcomes: how many closed hands ended how (`OUTCOMES`).
        tried: grasps that went into physics; held: of them, those that held.
        missing: what is still wanted, such as "3 power grasps"; other_kind: finished grasps that were not of the kind
            they were refined for; by_kind: precision and power grasps were asked for in a share.
        rounds: how many rounds of proposals there could be.
        protocol: the physics protocol.
    """
    closed, valid = sum(outcomes.values()), outcomes["valid"]
    if valid == 0:
        return _unfit(problem) or _no_valid(problem, outcomes, closed)
    if by_kind and held >= 0.5 * tried:
        return Shortfall(
            kind=FEW_OF_A_KIND,
            clause=f"{missing} missing after {rounds} rounds; of {valid} valid candidates too few are of that kind "
            f"({other_kind} turned out to be of the other), {held} of {tried} tried held '{protocol}'",
        )
    if tried == 0:
        return Shortfall(
            kind=OVERLAPS,
            clause=f"none of {valid} candidates passed the final check: overlap of at most "
            f"{1e3 * problem.max_penetration_m:g} mm at points 2 mm apart, force closure of what touches within 1 mm",
        )
    if held < 0.5 * tried:
        return Shortfall(
            kind=SLIPS, clause=f"in physics {tried - held} of {tried} slipped under '{protocol}'; {held} held"
        )
    return Shortfall(
        kind=RARE,
        clause=f"{valid} of {closed} closed hands were valid grasps, {held} of {tried} tried held '{protocol}'; "
        f"{missing} missing after {rounds} rounds",
    )


def grip_widths(obj: ObjectModel, friction: float, support: Support | None = None) -> np.ndarray:
    """Distances (M,) between opposite surface points whose friction cones face each other, metres, sorted.

    Rays from surface points; empty where no two sides of the object oppose each other. Beside a support only points
    count that leave room for a finger above it: `UNDER_M` under the lower one of a pair that stands upright.
    """
    across = float(np.linalg.norm(obj.mesh.extents)) + 0.01
    rng = child_rng(0, obj.content_hash, "grip widths")
    start, exits, keep = draw_pairs(obj, _RAYS, friction, across, rng)
    width = np.linalg.norm(exits - start, axis=1)
    if support is not None:
        ends = np.stack([support.plane.height(start), support.plane.height(exits)])
        steep = np.abs(ends[1] - ends[0]) / np.maximum(width, 1e-9)
        keep &= ends.min(axis=0) > support.clearance_m + TIP_M + UNDER_M * steep
    return np.sort(width[keep])


def lying_text(obj: ObjectModel, plane_O: Plane) -> str:
    """How an object lies on a plane: "lying on its 158 x 210 mm face", "standing on its 60 x 158 mm face".

    One that touches the plane with less than half of what it covers is "lying, 66 x 101 mm and 66 mm high".
    """
    vertices = obj.mesh.vertices
    height = plane_O.height(vertices)
    low, high = height.min(), np.ptp(height)
    across = vertices @ perpendicular(plane_O.normal[None], np.zeros(1))[0]
    along = vertices @ perpendicular(plane_O.normal[None], np.full(1, np.pi / 2))[0]
    flat = np.stack([across, along], axis=1)
    under, covered = _rectangle(flat[height < low + _FACE_M]), _rectangle(flat)
    if under[0] * under[1] < 0.5 * covered[0] * covered[1]:
        return f"lying, {1e3 * covered[0]:.0f} x {1e3 * covered[1]:.0f} mm and {1e3 * high:.0f} mm high"
    word = "standing" if high > covered[1] else "lying"
    return f"{word} on its {1e3 * under[0]:.0f} x {1e3 * under[1]:.0f} mm face"


def _rectangle(points: np.ndarray) -> tuple[float, float]:
    """Sides of the smallest rectangle, by turns of a degree, around (M, 2) points, the shorter first."""
    angle = np.radians(np.arange(90.0))
    u = np.ptp(points @ np.stack([np.cos(angle), np.sin(angle)]), axis=0)
    v = np.ptp(points @ np.stack([-np.sin(angle), np.cos(angle)]), axis=0)
    best = int(np.argmin(u * v))
    return min(u[best], v[best]), max(u[best], v[best])


def hand_span(hand: Hand, problem: GraspProblem) -> float:
    """Widest opening of a hand, metres: the aperture of a jaw, else the largest distance between two fingertips.

    A fingertip is the middle of a finger's outermost link; half the link's smallest side is taken off at either end.
    """
    if hand.is_jaw:
        return jaw_aperture(hand)
    rng = child_rng(0, hand.name, "span")
    q = np.concatenate([hand.q_open[None], draw_preshapes(hand, _POSTURES, rng)])
    X_HL = forward_fast(hand.tree, q)
    packed = problem.packed
    tips, thick = [], []
    for finger in (f for f in hand.fingers if f.links):
        link, middle = tip_points(packed, finger)
        tips.append(X_HL[:, link, :3, :3] @ middle + X_HL[:, link, :3, 3])
        own = packed.point_L[packed.link_point_start[link] : packed.link_point_start[link + 1]]
        thick.append(float(np.ptp(own, axis=0).min()) if len(own) else 0.0)
    gaps = [
        np.linalg.norm(tips[a] - tips[b], axis=1).max() - 0.5 * (thick[a] + thick[b])
        for a, b in combinations(range(len(tips)), 2)
    ]
    return float(max(gaps, default=0.0))


def _unfit(problem: GraspProblem) -> Shortfall | None:
    """Sizes that do not go together, where that is plain."""
    hand, obj, support = problem.hand, problem.obj, problem.support
    widths = grip_widths(obj, problem.friction)
    thin, cell = float(obj.mesh.extents.min()), obj.sdf.spacing
    if len(widths) == 0 and thin < 2 * cell:
        return Shortfall(
            kind=TOO_THIN, clause=f"{1e3 * thin:.1f} mm, and its grid of distances has cells of {1e3 * cell:.1f} mm"
        )
    if len(widths) == 0:
        return Shortfall(
            kind=NO_OPPOSITE_SIDES,
            clause=f"no two surface points face each other within friction {problem.friction:g}; "
            f"the object measures {size_text(obj)}",
        )
    span = hand_span(hand, problem)
    narrowest = widths[int(_CORNERS * len(widths))]
    if narrowest > span - (JAW_CLEARANCE_M if hand.is_jaw else 0.0):
        what = "aperture" if hand.is_jaw else "fingers span"
        return Shortfall(
            kind=TOO_WIDE, clause=f"narrowest graspable width {1e3 * narrowest:.0f} mm, {what} {1e3 * span:.0f} mm"
        )
    return None if support is None else _unfit_beside(problem, support, span)


def _unfit_beside(problem: GraspProblem, support: Support, span: float) -> Shortfall | None:
    """What the plane under the object takes away, where that is plain: the sides that face it and the one opposite."""
    hand, obj = problem.hand, problem.obj
    lying, widths = lying_text(obj, support.plane), grip_widths(obj, problem.friction, support)
    if len(widths) == 0:
        return Shortfall(
            kind=NO_OPPOSITE_SIDES,
            clause=f"{lying}: no two surface points face each other within friction {problem.friction:g} high enough "
            f"over the table for fingers {1e3 * support.clearance_m:.1f} mm above it",
        )
    most, what = (WIDTH_SHARE * span, "aperture") if hand.is_jaw else (span, "fingers span")
    narrowest = widths[int(_CORNERS * len(widths))]
    if narrowest <= most:
        return None
    return Shortfall(
        kind=TOO_WIDE,
        clause=f"{lying}: narrowest width across the table {1e3 * narrowest:.0f} mm, {what} {1e3 * most:.0f} mm",
    )


def _no_valid(problem: GraspProblem, outcomes: Mapping[str, int], closed: int) -> Shortfall:
    """No closed hand was a grasp: the commonest obstacle, and the object's size where that may be the cause."""
    sides = np.sort(problem.obj.mesh.extents)
    if closed == 0:
        where = "" if problem.support is None else f", {lying_text(problem.obj, problem.support.plane)},"
        return Shortfall(
            kind=NO_ROOM,
            clause=f"no open hand comes near the object{where or ','} which measures {size_text(problem.obj)}",
        )
    worst = max((name for name in outcomes if name != "valid"), key=lambda name: outcomes[name])
    clause = f"{outcomes[worst]} of {closed} closed hands {_SAID[worst]}"
    small, thin = sides[-1] < SMALL_M, sides[0] < THIN_M
    if worst in ("few contacts", "no force closure", "self-collides") and (small or thin):
        size = f"largest side {1e3 * sides[-1]:.0f} mm" if small else f"{1e3 * sides[0]:.1f} mm thick"
        return Shortfall(kind=TOO_SMALL, clause=f"{size}; {clause}")
    return Shortfall(kind=_OBSTACLES[worst], clause=f"{clause}; the object measures {size_text(problem.obj)}")


_SAID = {
    "collides": "hit the object before closing",
    "few contacts": "touched it with fewer than two links",
    "no force closure": "could not resist a push from every side",
    "penetrates": "cut into it",
    "self-collides": "ran into themselves",
    "meets the table": "came too near to the table",
}


def size_text(obj: ObjectModel) -> str:
    """ "59 x 160 x 213 mm", shortest side first."""
    return " x ".join(f"{1e3 * side:.0f}" for side in np.sort(obj.mesh.extents)) + " mm"
