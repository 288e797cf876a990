"""Pictures of a transfer: query and grasps beside their contact maps, from the side that shows most of the query's."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from neuralgrasps.apply.constraints import GraspConstraints
from neuralgrasps.apply.transfer import TransferResult
from neuralgrasps.apply.transfer_query import TransferQuery
from neuralgrasps.geometry.mesh import Mesh, merge_meshes
from neuralgrasps.geometry.primitives import sphere_mesh
from neuralgrasps.geometry.sampling import farthest_points
from neuralgrasps.grasps.contact_map import contact_map_packed
from neuralgrasps.grasps.kind import finger_of_link
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import pack_shapes
from neuralgrasps.hands.parts import part_distances
from neuralgrasps.hands.surface import hand_part_meshes
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.report.contact_views import contact_direction
from neuralgrasps.report.figures import SIZE, fine_mesh, object_surface, posed_hand_surfaces, render_contact_map
from neuralgrasps.report.palette import linear_rgb, mix
from neuralgrasps.report.shading import Style, Surface, shade
from neuralgrasps.report.transfer_content import TransferList, TransferredGrasp
from neuralgrasps.report.views import frame_camera

SHOWN = 12
TOUCHED = 0.6  # closeness from which a point of the object counts as touched, for the choice of the view
FREE_COLOUR, ONLY_COLOUR = "#c2412f", "#2f8f5b"
_POINTS_SHOWN, _POINT_COLOUR = 400, "#b3372b"
_FEW, _FEW_M, _MANY_M = 30, 0.0035, 0.0015
_APART = 1000  # more than fingers or contacts of one
_CONTACTS = 40  # points of the object that stand for all that is touched, for the choice of the view


Posed = tuple[Hand, np.ndarray, np.ndarray]  # a hand, X_OH (4, 4) and q (J,)


def touched_view(obj: ObjectModel, touches: Sequence[tuple[np.ndarray, Posed | None]]) -> np.ndarray:
    """(3,) direction towards the camera that shows most of what contact maps touch, object frame.

    Args:
        touches: contact maps (P,) at `obj.points_O`, each with its hand where that is known; every finger counts alike,
            and the view is one that no hand stands in.
    """
    meshes: list[Mesh] = []
    owners: list[int] = []
    points, fingers = [], []
    for k, (closeness, posed) in enumerate(touches):
        touched = np.flatnonzero(closeness >= min(TOUCHED, float(closeness.max())))
        chosen = obj.points_O[touched[farthest_points(obj.points_O[touched], min(_CONTACTS, len(touched)))]]
        points.append(chosen)
        if posed is None:
            fingers.append(k * _APART + np.arange(len(chosen)))
            continue
        hand, X_OH, q = posed
        owner = k * _APART + finger_of_link(hand)[[part.link for part in hand.parts]]
        meshes += [part.transformed(X_OH) for part in hand_part_meshes(hand, q, segments=8)]
        owners += owner.tolist()
        fingers.append(owner[_nearest_part(posed, chosen)])
    return contact_direction(meshes, owners, obj.mesh, np.concatenate(points), np.concatenate(fingers))


def _nearest_part(posed: Posed, points_O: np.ndarray) -> np.ndarray:
    """(M,) which part of a hand is nearest to each point."""
    hand, X_OH, q = posed
    X_OL = X_OH @ forward_fast(hand.tree, q[None])[0]
    far = [part_distances(part, (points_O - X_OL[part.link, :3, 3]) @ X_OL[part.link, :3, :3]) for part in hand.parts]
    return np.argmin(far, axis=0)


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


def _picture(surfaces: Sequence[Surface], view: np.ndarray, size: tuple[int, int] = SIZE) -> np.ndarray:
    X_WC, intrinsics = frame_camera(np.concatenate([s.mesh.vertices for s in surfaces]), view, size)
    return shade(surfaces, X_WC, intrinsics, style=Style())


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
    shown: int = SHOWN,
    progress: Callable[[int, int], None] | None = None,
) -> TransferList:
    """The pictures and figures of a transfer, drawn one after the other; a fifth of a second each.

    Args:
        title, text: what the query is, in a word and in a line.
        grasp: hand, X_OH (4, 4) and q (J,) of the query, where it is one; points_O: (M, 3) of the query, else.
        constraints: tint the object, and measure how far off the grasps are from what is kept free.
        shown: grasps, at most. progress: called with (drawn, to draw).
    """
    count = min(shown, len(result.grasps))
    asked = point_surface(np.zeros((0, 3)) if points_O is None else points_O) if grasp is None else _hand(grasp)
    kept = result.grasps[:count]
    maps = contact_map_packed(obj.points_O, pack_shapes(hand), kept.X_OH, kept.q, radius=query.radius_m)
    best = [(maps[0], (hand, kept.X_OH[0], kept.q[0]))] if count else []
    view, thing = touched_view(obj, [(query.contact_map, grasp), *best]), marked_object(obj, constraints)
    free = np.full(count, np.inf) if constraints is None else constraints.clearance(hand, kept.X_OH, kept.q)
    drawn = []
    for i in range(count):
        if progress is not None:
            progress(i, count)
        pictures = (
            _picture([*_hand((hand, kept.X_OH[i], kept.q[i])), thing], view),
            render_contact_map(obj, maps[i], view=view),
        )
        drawn.append(_transferred(result, i, pictures, None if np.isinf(free[i]) else 1e3 * float(free[i])))
    return TransferList(
        object=obj.name, hand=hand.name, title=title, text=text, image=_picture([*asked, thing], view),
        contacts=render_contact_map(obj, query.contact_map, view=view), grasps=tuple(drawn),
        query_hand="" if grasp is None else grasp[0].name,
    )  # fmt: skip


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
