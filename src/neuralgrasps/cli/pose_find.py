"""Finding what `pose` was asked for in one observation after the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from neuralgrasps.cli.pose_hints import CLOUD_NOTE, FLAT_NOTE, scale_doubt, with_scale_doubt
from neuralgrasps.cli.pose_input import PoseSource, Seen, check_extent, is_flat, known_table
from neuralgrasps.errors import InputError

if TYPE_CHECKING:
    from neuralgrasps.geometry.plane import Plane
    from neuralgrasps.objects.object_model import ObjectModel
    from neuralgrasps.perception.frame import Frame
    from neuralgrasps.perception.pose import PoseResult
    from neuralgrasps.perception.table import TableFit

_LEAST_PIXELS = 400  # of a cluster that is looked at


@dataclass(frozen=True, slots=True, kw_only=True)
class Placed:
    """An object and its pose.

    Attributes:
        points: how many measured points decided it.
        identity: probability that it is this object and not another one or none; 1 when it was said to be.
    """

    obj: ObjectModel
    pose: PoseResult
    points: int
    identity: float = 1.0

    @property
    def confidence(self) -> float:
        """Probability that it is this object in this pose."""
        return min(self.identity, self.pose.confidence)

    @property
    def is_found(self) -> bool:
        return self.confidence >= 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """What was found in one observation.

    Attributes:
        placed: poses, surest first, also those that are less likely right than wrong.
        missing: names that were looked for and not found.
        frame: what was looked at; None for points alone.
        table: the plane that was found; None when it was given or not needed.
        identity: which object it is, name -> probability, "none" for none of them; of a mask or cloud alone.
        problem: why nothing could be looked for; notes: what else to know.
        units_per_metre: of the depth image, as it was read.
        unexplained: clusters on the table that no accepted object explains; None when none were looked for.
        wall_s: time taken, without what was compiled first.
    """

    name: str
    placed: tuple[Placed, ...] = ()
    missing: tuple[str, ...] = ()
    frame: Frame | None = None
    table: TableFit | None = None
    identity: Mapping[str, float] = field(default_factory=dict)
    problem: str = ""
    notes: tuple[str, ...] = ()
    units_per_metre: float | None = None
    unexplained: int | None = None
    wall_s: float = 0.0

    @property
    def found(self) -> tuple[Placed, ...]:
        return tuple(p for p in self.placed if p.is_found)

    @property
    def rejected(self) -> tuple[Placed, ...]:
        """The best poses of objects that were not accepted."""
        return tuple(p for p in self.placed if not p.is_found)


def find_in(
    models: Sequence[ObjectModel], seen: Seen, given: PoseSource, *, seed: int, before: Finding | None = None
) -> Finding:
    """Look for the models in one observation.

    Args:
        before: what was found in the frame before, to go on from; None to search.
    Raises:
        InputError: the observation cannot be used: no table, points that are not on the object, and so on.
    """
    if not seen.is_one_object:
        return _in_scene(models, seen, given, seed, before)
    assert seen.points_C is not None
    check_extent(list(models), seen.points_C, given)
    view: dict[str, Any] = {"points_C": seen.points_C} if seen.frame is None else _view(seen, given, seed)
    placed, identity = _one(models, view, len(seen.points_C), seed)
    notes = [FLAT_NOTE] if is_flat(seen.points_C) else []
    if seen.frame is None:
        notes.append(CLOUD_NOTE)
    return Finding(
        name=seen.name,
        placed=placed,
        missing=() if identity else tuple(p.obj.name for p in placed if not p.is_found),
        frame=seen.frame,
        identity=identity,
        notes=tuple(notes),
        units_per_metre=seen.units_per_metre,
    )


def _view(seen: Seen, given: PoseSource, seed: int) -> dict[str, Any]:
    """The masked frame as the estimators take it; a table helps where one is in view."""
    assert seen.frame is not None
    table = known_table(given, seen.frame)
    if table is None:
        try:
            table = _find_table(seen.frame, given, seed).plane
        except InputError:
            table = None  # the mask says where the object is
    return {"depth": seen.frame.depth, "intrinsics": seen.frame.intrinsics, "mask": seen.mask, "table": table}


def _one(
    models: Sequence[ObjectModel], view: dict[str, Any], points: int, seed: int
) -> tuple[tuple[Placed, ...], Mapping[str, float]]:
    """The pose of the only model; of several, which one it is and its pose."""
    if len(models) == 1:
        from neuralgrasps.perception.pose import estimate_pose

        return (Placed(obj=models[0], pose=estimate_pose(models[0], seed=seed, **view), points=points),), {}
    from neuralgrasps.perception.identify import identify_object

    named = identify_object(models, seed=seed, **view)
    placed = tuple(
        Placed(obj=obj, pose=named.poses[obj.name], points=points, identity=named.probability[obj.name])
        for obj in models
        if obj.name == named.name
    )
    return placed, {**named.probability, "none": named.none_probability}


def _in_scene(
    models: Sequence[ObjectModel], seen: Seen, given: PoseSource, seed: int, before: Finding | None
) -> Finding:
    """Every model that stands on the table of a frame."""
    assert seen.frame is not None
    table, fit = known_table(given, seen.frame), None
    if table is None:
        fit = _find_table(seen.frame, given, seed)
        table = fit.plane
    placed = _tracked(seen.frame, table, before) if before is not None and before.found else None
    unexplained = None
    if placed is None:
        placed, unexplained = _searched(models, seen.frame, table, seed)
    placed = sorted(placed, key=lambda p: -p.confidence)
    found = {p.obj.name for p in placed if p.is_found}
    doubt = "" if found or fit is None else scale_doubt(seen.frame, fit)
    return Finding(
        name=seen.name,
        placed=tuple(placed),
        missing=tuple(obj.name for obj in models if obj.name not in found),
        frame=seen.frame,
        table=fit,
        notes=(doubt,) if doubt else (),
        units_per_metre=seen.units_per_metre,
        unexplained=unexplained,
    )


def _searched(models: Sequence[ObjectModel], frame: Frame, table: Plane, seed: int) -> tuple[list[Placed], int]:
    """The poses found, and how many clusters no accepted one of them explains."""
    from neuralgrasps.perception.clusters import find_clusters
    from neuralgrasps.perception.find import find_objects

    by_name = {obj.name: obj for obj in models}
    clusters = [mask for mask in find_clusters(frame, table) if _measured(frame, mask) >= _LEAST_PIXELS]
    placed, explained = [], np.zeros(frame.depth.shape, bool)
    for f in find_objects(models, frame, table=table, masks=clusters, min_pixels=_LEAST_PIXELS, seed=seed):
        one = Placed(obj=by_name[f.name], pose=f.pose, points=_measured(frame, f.mask), identity=f.probability)
        placed.append(one)
        if one.is_found:
            explained |= f.mask
    return placed, sum(not (mask & explained).any() for mask in clusters)


def _tracked(frame: Frame, table: Plane, before: Finding) -> list[Placed] | None:
    """The objects of the frame before, followed; None when one was lost, so that all are searched again."""
    from neuralgrasps.perception.track import track_pose

    placed = []
    for last in before.found:
        try:
            pose = track_pose(last.obj, frame.depth, frame.intrinsics, last.pose.X_CO, table=table)
        except InputError:
            return None  # out of view
        placed.append(Placed(obj=last.obj, pose=pose, points=last.points, identity=last.identity))
    return placed if all(p.is_found for p in placed) else None


def _find_table(frame: Frame, given: PoseSource, seed: int) -> TableFit:
    from neuralgrasps.perception.table import find_table

    try:
        return find_table(frame, max_depth_m=given.max_depth, seed=seed)
    except InputError as error:
        raise with_scale_doubt(error, frame) from None


def _measured(frame: Frame, mask: np.ndarray) -> int:
    return int((frame.depth[mask] > 0).sum())
