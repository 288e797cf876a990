"""Contact sheets: the first, most diverse grasps of a pair, each drawn from where its contacts are seen best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.grasps.kind import finger_of_link
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.surface import hand_part_meshes
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.parallel import run_tasks
from neuralgrasps.report.contact_views import contact_direction
from neuralgrasps.report.content import ContactSheet, GraspFigure
from neuralgrasps.report.figures import SIZE, render_grasp

SHOWN = 12
_PER_TASK = 6  # pictures; a worker gets the hand and the object once for these
Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetPair:
    """One hand, one object, their grasps in farthest-point order, and the overlap (N,) of each, metres."""

    hand: Hand
    obj: ObjectModel
    grasps: GraspSet
    depth_m: np.ndarray


def contact_sheets(
    pairs: Sequence[SheetPair],
    *,
    shown: int = SHOWN,
    size: tuple[int, int] = SIZE,
    workers: int | None = 1,
    progress: Progress | None = None,
) -> tuple[ContactSheet, ...]:
    """One sheet per pair that has a grasp.

    Args:
        pairs: what to draw; any prefix of a set of grasps is taken to be diverse, as `synthesise` orders them.
        shown: pictures per pair, at most.
        size: width and height of a picture, pixels.
        workers: processes; all processors when None. No picture depends on it.
        progress: called with (pictures drawn, pictures, text).
    """
    pairs = [pair for pair in pairs if len(pair.grasps)]
    slots = [
        (k, range(i, min(i + _PER_TASK, shown, len(pair.grasps))))
        for k, pair in enumerate(pairs)
        for i in range(0, min(shown, len(pair.grasps)), _PER_TASK)
    ]
    tasks = [
        (pairs[k].hand, pairs[k].obj.mesh, pairs[k].grasps[chosen.start : chosen.stop], size) for k, chosen in slots
    ]
    images: list[dict[int, np.ndarray]] = [{} for _ in pairs]
    done, total = 0, sum(len(chosen) for _, chosen in slots)
    for index, drawn in run_tasks(_draw, tasks, workers=workers):
        k, chosen = slots[index]
        images[k].update(zip(chosen, drawn, strict=True))
        done += len(chosen)
        if progress is not None:
            progress(done, total, f"{pairs[k].grasps.hand} on {pairs[k].grasps.object}")
    return tuple(
        ContactSheet(
            hand=pair.grasps.hand,
            object=pair.grasps.object,
            grasps=tuple(_figure(pair, i, drawn[i]) for i in sorted(drawn)),
        )
        for pair, drawn in zip(pairs, images, strict=True)
    )


def grasp_view(hand: Hand, mesh: Mesh, grasp: GraspSet) -> np.ndarray:
    """(3,) direction towards the camera that shows the contacts of one grasp, object frame."""
    touched = grasp.contact_links[0] >= 0
    owner = finger_of_link(hand)
    X_OH = grasp.X_OH[0]
    return contact_direction(
        [part.transformed(X_OH) for part in hand_part_meshes(hand, grasp.q[0], segments=8)],
        [int(owner[part.link]) for part in hand.parts],
        mesh,
        grasp.contact_points_O[0][touched],
        owner[grasp.contact_links[0][touched]],
    )


def kind_text(grasps: GraspSet, index: int) -> str:
    """ "precision, 3 fingers", "power, 4 fingers and palm"; "" where the grasps were not labelled."""
    count = int(grasps.finger_count[index])
    if count < 0:
        return ""
    kind = "precision" if grasps.precision[index] else "power"
    palm = " and palm" if grasps.palm_contact[index] else ""
    return f"{kind}, {count} finger{'s' if count != 1 else ''}{palm}"


def _draw(hand: Hand, mesh: Mesh, grasps: GraspSet, size: tuple[int, int]) -> list[np.ndarray]:
    return [
        render_grasp(hand, mesh, g.X_OH[0], g.q[0], size=size, view=grasp_view(hand, mesh, g))
        for g in (grasps[i] for i in range(len(grasps)))
    ]


def _figure(pair: SheetPair, index: int, image: np.ndarray) -> GraspFigure:
    grasps = pair.grasps
    verdict = grasps.verdicts.get(grasps.protocol)
    return GraspFigure(
        hand=grasps.hand,
        object=grasps.object,
        image=image,
        epsilon=float(grasps.epsilon[index]),
        penetration_mm=float(pair.depth_m[index] * 1e3),
        success=None if verdict is None else bool(verdict.success[index]),
        displacement_mm=None if verdict is None else float(verdict.displacement_m[index] * 1e3),
        kind=kind_text(grasps, index),
        note=f"grasp {index} of the file",
    )
