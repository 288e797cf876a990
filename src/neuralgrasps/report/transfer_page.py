"""Pictures of a transfer: query and grasps beside their contact maps, from the side that shows most of the query's."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from neuralgrasps.apply.transfer import TransferResult
from neuralgrasps.apply.transfer_query import TransferQuery
from neuralgrasps.geometry.mesh import Mesh, merge_meshes
from neuralgrasps.geometry.primitives import sphere_mesh
from neuralgrasps.geometry.sampling import farthest_points
from neuralgrasps.grasps.contact_map import contact_map_packed
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import pack_shapes
from neuralgrasps.hands.surface import hand_part_meshes
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.report.contact_views import contact_direction
from neuralgrasps.report.figures import SIZE, object_surface, render_contact_map, render_grasp
from neuralgrasps.report.palette import linear_rgb
from neuralgrasps.report.shading import Style, Surface, shade
from neuralgrasps.report.transfer_content import TransferList, TransferredGrasp
from neuralgrasps.report.views import frame_camera

SHOWN = 12
TOUCHED = 0.6  # closeness from which a point of the object counts as touched, for the choice of the view
_POINTS_SHOWN, _POINT_COLOUR = 400, "#b3372b"


def touched_view(obj: ObjectModel, closeness: np.ndarray, hand_meshes: list[Mesh] | None = None) -> np.ndarray:
    """(3,) direction towards the camera that shows most of what a contact map touches, object frame.

    Args:
        closeness: (P,) at `obj.points_O`. hand_meshes: what may stand before it; none for an object alone.
    """
    touched = np.flatnonzero(closeness >= min(TOUCHED, float(closeness.max())))
    chosen = touched[farthest_points(obj.points_O[touched], min(24, len(touched)))]
    meshes = hand_meshes or []
    own = np.full(len(chosen), -1)
    return contact_direction(meshes, [-1] * len(meshes), obj.mesh, obj.points_O[chosen], own)


def render_points(
    obj: ObjectModel, points_O: np.ndarray, *, view: np.ndarray, radius_m: float = 0.0015, size: tuple[int, int] = SIZE
) -> np.ndarray:
    """Picture (h, w, 4) of points (M, 3) as small balls around and on an object; at most 400 of them, spread evenly."""
    points = np.asarray(points_O, np.float64)
    if len(points) > _POINTS_SHOWN:
        points = points[farthest_points(points, _POINTS_SHOWN)]
    ball = sphere_mesh(radius_m, segments=8)
    surfaces = [object_surface(obj.mesh)]
    if len(points):
        balls = merge_meshes([Mesh(ball.vertices + p, ball.faces) for p in points])
        surfaces.append(Surface(mesh=balls, colour=linear_rgb(_POINT_COLOUR), gloss=0.1))
    X_WC, intrinsics = frame_camera(np.concatenate([s.mesh.vertices for s in surfaces]), view, size)
    return shade(surfaces, X_WC, intrinsics, style=Style())


def grasp_pictures(
    hand: Hand, obj: ObjectModel, X_OH: np.ndarray, q: np.ndarray, closeness: np.ndarray, *, view: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A grasp and its contact map (P,) from the same side."""
    return render_grasp(hand, obj, X_OH, q, view=view), render_contact_map(obj, closeness, view=view)


def transfer_list(
    result: TransferResult,
    query: TransferQuery,
    hand: Hand,
    obj: ObjectModel,
    *,
    title: str,
    text: str = "",
    grasp: tuple[Hand, np.ndarray, np.ndarray] | None = None,
    points_O: np.ndarray | None = None,
    clearance_m: np.ndarray | None = None,
    shown: int = SHOWN,
    progress: Callable[[int, int], None] | None = None,
) -> TransferList:
    """The pictures and figures of a transfer, drawn one after the other; a fifth of a second each.

    Args:
        title, text: what the query is, in a word and in a line.
        grasp: hand, X_OH (4, 4) and q (J,) of the query, where it is one; points_O: (M, 3) of the query, else.
        clearance_m: (N,) of the grasps from what is kept free.
        shown: grasps, at most. progress: called with (drawn, to draw).
    """
    count = min(shown, len(result.grasps))
    meshes = (
        [] if grasp is None else [p.transformed(grasp[1]) for p in hand_part_meshes(grasp[0], grasp[2], segments=8)]
    )
    view = touched_view(obj, query.contact_map, meshes)
    if grasp is not None:
        image = render_grasp(grasp[0], obj, grasp[1], grasp[2], view=view)
    else:
        image = render_points(obj, np.zeros((0, 3)) if points_O is None else points_O, view=view)
    contacts = render_contact_map(obj, query.contact_map, view=view)
    kept = result.grasps[:count]
    maps = contact_map_packed(obj.points_O, pack_shapes(hand), kept.X_OH, kept.q, radius=query.radius_m)
    drawn = []
    for i in range(count):
        if progress is not None:
            progress(i, count)
        free = None if clearance_m is None or not np.isfinite(clearance_m[i]) else 1e3 * float(clearance_m[i])
        drawn.append(_transferred(result, i, hand, obj, maps[i], view, free))
    return TransferList(
        object=obj.name, hand=hand.name, title=title, text=text, image=image, contacts=contacts, grasps=tuple(drawn),
        query_hand="" if grasp is None else grasp[0].name,
    )  # fmt: skip


def _transferred(
    result: TransferResult, i: int, hand: Hand, obj: ObjectModel, closeness: np.ndarray, view: np.ndarray,
    clearance_mm: float | None,
) -> TransferredGrasp:  # fmt: skip
    grasps = result.grasps
    verdict = grasps.verdicts.get(grasps.protocol)
    image, contacts = grasp_pictures(hand, obj, grasps.X_OH[i], grasps.q[i], closeness, view=view)
    return TransferredGrasp(
        image=image,
        contacts=contacts,
        similarity=float(result.similarity[i]),
        origin=result.origin[i],
        success=None if verdict is None else bool(verdict.success[i]),
        displacement_mm=None if verdict is None else 1e3 * float(verdict.displacement_m[i]),
        epsilon=float(grasps.epsilon[i]),
        clearance_mm=clearance_mm,
        reason=result.reasons[i],
    )
