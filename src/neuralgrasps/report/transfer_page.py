"""Pictures of a transfer: query and grasps beside their contact maps, all from the side where most of them is seen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from neuralgrasps.apply.constraints import GraspConstraints
from neuralgrasps.apply.drawn_contacts import reach, touched_text
from neuralgrasps.apply.transfer import TransferResult
from neuralgrasps.apply.transfer_query import TransferQuery
from neuralgrasps.geometry.mesh import Mesh, merge_meshes
from neuralgrasps.geometry.primitives import sphere_mesh
from neuralgrasps.geometry.sampling import farthest_points
from neuralgrasps.grasps.contact_map import contact_map_packed
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import pack_shapes
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.report.figures import (
    SIZE,
    fine_mesh,
    object_surface,
    posed_hand_surfaces,
    render_object,
    values_at_vertices,
)
from neuralgrasps.report.palette import linear_rgb, mix
from neuralgrasps.report.seen_view import Posed, seen_direction
from neuralgrasps.report.shading import Style, Surface, shade
from neuralgrasps.report.transfer_content import TransferList, TransferredGrasp
from neuralgrasps.report.views import frame_camera, upright

SHOWN = 12
FREE_COLOUR, ONLY_COLOUR = "#c2412f", "#2f8f5b"
_POINTS_SHOWN, _POINT_COLOUR = 400, "#b3372b"
_FEW, _FEW_M, _MANY_M = 30, 0.0035, 0.0015
_CHOSEN_BY = 3  # grasps that the view is chosen by, after the query


def marked_object(obj: ObjectModel, constraints: GraspConstraints | None) -> Surface:
    """The object, what is kept free tinted red, what may be touched green when it is only part of it."""
    plain = object_surface(obj.mesh)
    if constraints is None or not (constraints.keep_free or constraints.only_region):
        return plain
    mesh = fine_mesh(obj.mesh, longest_edge_m=0.0025)
    colour = np.tile(plain.colour, (len(mesh.vertices), 1))
    for within, tint in zip(constraints.marked(mesh.vertices), (FREE_COLOUR, ONLY_COLOUR), strict=True):
        colour[within] = mix(linear_rgb(tint), plain.colour, 0.5)
    return Surface(mesh=mesh, colour=colour, gloss=plain.gloss, caster=obj.mesh)


def point_surface(points_O: np.ndarray) -> list[Surface]:
    """Points (M, 3) as balls, a few as large ones, of many 400 spread evenly; none for no points."""
    points = np.asarray(points_O, np.float64)
    if not len(points):
        return []
    chosen = points[farthest_points(points, min(len(points), _POINTS_SHOWN))]
    ball = sphere_mesh(_FEW_M if len(chosen) <= _FEW else _MANY_M, segments=12)
    balls = merge_meshes([Mesh(ball.vertices + p, ball.faces) for p in chosen])
    return [Surface(mesh=balls, colour=linear_rgb(_POINT_COLOUR), gloss=0.1)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Sight:
    """How all cards of a page are drawn: object turned upright by `X_UO` (4, 4), seen from `view` (3,) there."""

    X_UO: np.ndarray
    view: np.ndarray

    def picture(self, surfaces: Sequence[Surface]) -> np.ndarray:
        turned = [self._turned(surface) for surface in surfaces]
        X_WC, intrinsics = frame_camera(np.concatenate([s.mesh.vertices for s in turned]), self.view, SIZE)
        return shade(turned, X_WC, intrinsics, style=Style())

    def contact_map(self, obj: ObjectModel, values: np.ndarray) -> np.ndarray:
        mesh = fine_mesh(obj.mesh)
        shown = values_at_vertices(mesh, obj.points_O, values)
        return render_object(mesh.transformed(self.X_UO), vertex_values=shown, view=self.view)

    def _turned(self, surface: Surface) -> Surface:
        caster = None if surface.caster is None else surface.caster.transformed(self.X_UO)
        return replace(surface, mesh=surface.mesh.transformed(self.X_UO), caster=caster)


def transfer_list(
    result: TransferResult,
    query: TransferQuery,
    hand: Hand,
    obj: ObjectModel,
    *,
    title: str,
    text: str = "",
    grasp: Posed | None = None,
    points_O: np.ndarray | None = None,
    constraints: GraspConstraints | None = None,
    up_O: np.ndarray | None = None,
    shown: int = SHOWN,
    progress: Callable[[int, int], None] | None = None,
) -> TransferList:
    """The pictures and figures of a transfer, drawn one after the other; a fifth of a second each.

    Args:
        title, text: what the query is, in a word and in a line.
        grasp: hand, X_OH (4, 4) and q (J,) of the query, where it is one; points_O: (M, 3) of the query, else.
        constraints: tint the object, and measure how far off the grasps are from what is kept free.
        up_O: (3,) unit vector that points to the sky, object frame; None: as the constraints say, else z.
        shown: grasps, at most. progress: called with (drawn, to draw).
    """
    count = min(shown, len(result.grasps))
    asked = point_surface(np.zeros((0, 3)) if points_O is None else points_O) if grasp is None else _hand(grasp)
    kept = result.grasps[:count]
    maps = contact_map_packed(obj.points_O, pack_shapes(hand), kept.X_OH, kept.q, radius=query.radius_m)
    best = [(maps[i], (hand, kept.X_OH[i], kept.q[i])) for i in range(min(_CHOSEN_BY, count))]
    sight, thing = _sight(obj, [(query.contact_map, grasp), *best], up_O, constraints), marked_object(obj, constraints)
    free = np.full(count, np.inf) if constraints is None else constraints.clearance(hand, kept.X_OH, kept.q)
    drawn = []
    for i in range(count):
        if progress is not None:
            progress(i, count)
        pictures = (
            sight.picture([*_hand((hand, kept.X_OH[i], kept.q[i])), thing]),
            sight.contact_map(obj, maps[i]),
        )
        card = _transferred(result, i, pictures, None if np.isinf(free[i]) else 1e3 * float(free[i]))
        if points_O is not None and query.source == "contacts":
            off = reach(hand, kept.X_OH[i : i + 1], kept.q[i : i + 1], points_O)[0]
            card = replace(card, touched=touched_text(off), points_off_mm=1e3 * float(off.mean()))
        drawn.append(card)
    return TransferList(
        object=obj.name, hand=hand.name, title=title, text=text, image=sight.picture([*asked, thing]),
        contacts=sight.contact_map(obj, query.contact_map), grasps=tuple(drawn),
        query_hand="" if grasp is None else grasp[0].name,
    )  # fmt: skip


def constraint_text(constraints: GraspConstraints | None) -> str:
    """What is asked besides, and its colours in the pictures; "" when nothing is."""
    if constraints is None or not constraints:
        return ""
    marked = (("kept free: red", constraints.keep_free), ("to be touched only: green", constraints.only_region))
    colours = ", ".join(words for words, regions in marked if regions)
    return f"Asked besides: {constraints}{f' ({colours})' if colours else ''}."


def _sight(
    obj: ObjectModel, cards: Sequence[tuple[np.ndarray, Posed | None]], up_O: np.ndarray | None,
    constraints: GraspConstraints | None,
) -> _Sight:  # fmt: skip
    """The object as it stands, and the one view for all cards."""
    if up_O is None:
        support = None if constraints is None else constraints.support
        up_O = np.array([0.0, 0.0, 1.0]) if support is None else support.plane.normal
    X_UO = upright(up_O)
    return _Sight(X_UO=X_UO, view=seen_direction(obj, cards, X_UO))


def _hand(posed: Posed) -> list[Surface]:
    return posed_hand_surfaces(*posed)


def _transferred(
    result: TransferResult, i: int, pictures: tuple[np.ndarray, np.ndarray], clearance_mm: float | None
) -> TransferredGrasp:
    grasps = result.grasps
    verdict = grasps.verdicts.get(grasps.protocol)
    return TransferredGrasp(
        image=pictures[0],
        contacts=pictures[1],
        similarity=float(result.similarity[i]),
        origin=result.origin[i],
        success=None if verdict is None else bool(verdict.success[i]),
        displacement_mm=None if verdict is None else 1e3 * float(verdict.displacement_m[i]),
        epsilon=float(grasps.epsilon[i]),
        clearance_mm=clearance_mm,
        reason=result.reasons[i],
    )
