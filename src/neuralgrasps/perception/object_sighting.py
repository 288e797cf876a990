"""A known object that stands on a table, in one frame: alone, or under a person's hand."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.spatial.distance import pdist

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.se3_numpy import transform_points_np
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.clusters import find_clusters
from neuralgrasps.perception.frame import Frame
from neuralgrasps.perception.pose import PoseConfig, PoseResult, observe, result_of
from neuralgrasps.perception.pose_confidence import surface_distances
from neuralgrasps.perception.pose_model import PoseModel, pose_model
from neuralgrasps.perception.pose_search import NO_CONTACTS, search
from neuralgrasps.perception.table import TableFit, find_table

LEAST, LEAST_HIDDEN = 0.5, 0.8  # confidence that counts as found; the same where a person may be taken for the object
_LEAST_SCORE_HIDDEN = 0.9  # and of the view so much must be explained there: a small part can look like another one
_CLUSTERS, _LEAST_PIXELS = 3, 50
_RIM = 3  # pixels: what lies so near to a person's outline may go on under it
_ALIKE_M = 0.01  # mean distance of the surfaces of two poses that are one for whoever grasps
_SPREAD_POINTS, _LARGER = 150, 1.05  # points that tell how large a thing is; so much larger for noise
_CONFIG = PoseConfig()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sighting:
    """An object in a frame.

    Attributes:
        frame: its number. table: what the object was looked for on.
        pose: with the confidence that no other pose, which explains the view alike, is the right one.
        hidden: a person was in the frame.
    """

    frame: int
    pose: PoseResult
    table: TableFit
    hidden: bool

    @property
    def found(self) -> bool:
        """Whether it is sure enough."""
        return accepted(self.pose, hidden=self.hidden)


def accepted(pose: PoseResult, *, hidden: bool) -> bool:
    """Whether a pose counts as found; hidden: a person may be taken for the object, or hide what tells poses apart."""
    if hidden:
        return pose.confidence >= LEAST_HIDDEN and pose.score >= _LEAST_SCORE_HIDDEN
    return pose.confidence >= LEAST


def sight(
    frame: Frame, number: int, obj: ObjectModel, *, hidden: np.ndarray | None = None, seed: int = 0
) -> Sighting | str:
    """The likeliest pose of the object in a frame, however unlikely; or why there is none.

    Args:
        number: the frame's. hidden: (h, w) bool, pixels that may show a person; None: nobody is there. They are not the
            object's, but what lies behind them may be.
    """
    rest = without(frame, hidden)
    try:
        table = find_table(rest, seed=seed)
    except InputError as error:
        return str(error)
    found = find_clusters(rest, table.plane, extent=table.extent)
    masks = [mask for mask in found if (mask & (rest.depth > 0)).sum() >= _LEAST_PIXELS]
    model, seen = pose_model(obj), []
    parts = None if hidden is None else _parts(rest, hidden, masks, model.diameter)
    for mask in [*([] if parts is None else [parts]), *masks[:_CLUSTERS]]:
        seen.append(_pose(model, frame, mask, table, seed, present=hidden is None))
        if mask is parts and accepted(seen[-1], hidden=True):
            break  # a part alone may be explained by more poses, and by wrong ones
    if not seen:
        return "nothing stands on the table."
    best = max(seen, key=lambda pose: (accepted(pose, hidden=hidden is not None), pose.confidence))
    return Sighting(frame=number, pose=best, table=table, hidden=hidden is not None)


def without(frame: Frame, hidden: np.ndarray | None) -> Frame:
    """The frame with the depth of some pixels left out; as it is when nothing would be left."""
    if hidden is None or not (frame.depth[~hidden] > 0).any():
        return frame
    return replace(frame, depth=np.where(hidden, 0.0, frame.depth))


def _pose(model: PoseModel, frame: Frame, mask: np.ndarray, table: TableFit, seed: int, *, present: bool) -> PoseResult:
    """The pose that explains a mask best. The person stays in the depth image: what it hides speaks for nothing.

    Args:
        present: see `result_of`; a person's parts are taken for objects that float more readily than for others.
    """
    scene = observe(
        None, depth=frame.depth, intrinsics=frame.intrinsics, mask=mask, table=table.plane, reach_m=model.diameter,
        seed=seed,
    )  # fmt: skip
    found = search(model, scene, NO_CONTACTS, _CONFIG)
    pose = result_of(model, scene, found, _CONFIG, seed, present=present)
    confidence = pose.confidence * _share_alike(model, pose)
    return replace(pose, confidence=confidence, converged=confidence >= LEAST)


def _share_alike(model: PoseModel, pose: PoseResult) -> float:
    """Probability of the poses whose surface is that of the best one, among all that explain the view about alike."""
    off = np.array([
        np.abs(surface_distances(model, transform_points_np(X, model.points), pose.X_CO)).mean()
        for X in pose.alternatives_X_CO
    ])  # fmt: skip
    return float(pose.alternatives_probability[off < _ALIKE_M].sum())


def _parts(frame: Frame, hidden: np.ndarray, masks: list[np.ndarray], diameter_m: float) -> np.ndarray | None:
    """Pieces of one thing that a hand cuts in several, as one mask; None when there are not two.

    They lie at the person's outline, and no farther apart than the object is large.
    """
    rim = ndimage.binary_dilation(hidden, iterations=_RIM)
    whole, pieces = np.zeros(hidden.shape, bool), 0
    for mask in masks:
        if (mask & rim).any() and _extent(frame, whole | mask) <= _LARGER * diameter_m:
            whole, pieces = whole | mask, pieces + 1
    return whole if pieces > 1 else None


def _extent(frame: Frame, mask: np.ndarray) -> float:
    """Largest distance between points that a mask shows, metres."""
    points = frame.points[mask & (frame.depth > 0)]
    return float(pdist(points[:: max(1, len(points) // _SPREAD_POINTS)]).max(initial=0.0))
