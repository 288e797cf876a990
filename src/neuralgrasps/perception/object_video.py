"""A known object over a video: found where nothing hides it, kept while it stands still, followed when it moves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.raster import depth_images
from neuralgrasps.geometry.se3_numpy import inverse_np, transform_points_np
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.clusters import find_clusters
from neuralgrasps.perception.frame import Frame, camera_poses
from neuralgrasps.perception.pose import PoseResult, estimate_pose
from neuralgrasps.perception.table import TableFit, find_table
from neuralgrasps.perception.track import track_pose

Hidden = Callable[[int], np.ndarray | None]
"""Of a frame's number: (h, w) bool, pixels that may show a person; None when nobody is there."""

_TRIED, _TRIED_HIDDEN = 3, 5  # frames that the object is looked for in: without a person, and with one
_SURE, _LEAST = 0.9, 0.5  # confidence that ends the search; least that counts as found
_LEAST_HIDDEN = 0.75  # the same in a frame with a person, who may be taken for the object
_CLUSTERS, _LEAST_PIXELS = 3, 50
_AGREE_M = 0.008  # measured so near to the model; farther behind it, the object is not there
_GONE_SHARE, _LOST_SHARE = 0.08, 0.5  # more of its pixels than at first show what is behind: looked at; lost
_MOVED_M = 0.004  # less is no motion
_SUNK_M = 0.010  # nothing is so deep in the table
_SEARCH_STRIDE = 2  # pixels


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FollowedObject:
    """Where an object is in T frames.

    Attributes:
        X_CO: (T, 4, 4) object in each frame's camera; nan where it is lost.
        seen: (T,) share of the pixels it would cover that show its surface there; the rest is hidden, or not measured.
        found_in: the frame it was found in; pose: there. table: the plane it stands on, in that frame's camera.
        moves_from, lost_from: first frame in which it is no longer where it stood at first, or nowhere to be found;
            None: never.
        reason: why it was not found at all, "" when it was.
    """

    X_CO: np.ndarray
    seen: np.ndarray
    found_in: int
    pose: PoseResult | None
    table: TableFit | None
    moves_from: int | None
    lost_from: int | None
    reason: str


def follow_object(
    frames: Sequence[Frame], obj: ObjectModel, *, hidden: Hidden | None = None, seed: int = 0
) -> FollowedObject:
    """Find an object that stands on a table at first, and follow it.

    Args:
        frames: of one camera. It is at rest, or all frames have a camera pose `X_WC`.
        hidden: pixels to leave out when it is looked for, such as a hand's box. A hand before the object is no sign
            that it has gone, so that following needs no mask.
        seed: of the searches.
    Raises:
        InputError: no frames, or some without the pose of a camera that moves.
    """
    if not frames:
        raise InputError("there are no frames to look for the object in; expected at least one.")
    camera_poses(frames)  # refused at once when the camera moves and some frames do not say where
    hidden = hidden or (lambda _: None)
    best, reason = None, "no frame"
    for index in _order(len(frames), hidden):
        found, why = _find(without(frames[index], hidden(index)), obj, seed)
        reason = why or reason
        if found is not None and (best is None or found[0].confidence > best[1].confidence):
            best = (index, *found)
        if best is not None and best[1].confidence >= _SURE:
            break
    if best is None or best[1].confidence < (_LEAST if hidden(best[0]) is None else _LEAST_HIDDEN):
        if best is not None:
            reason = f"what stands there does not look like '{obj.name}': the confidence is {best[1].confidence:.2f}."
        if all(hidden(k) is not None for k in range(len(frames))):
            reason += " A person is in every frame, and may hide it: show it for a moment before the hand comes."
        return _nowhere(len(frames), reason, None if best is None else best[1], None if best is None else best[2])
    index, pose, table = best
    followed = _follow(frames, obj, index, pose, table, seed)
    clear = [k for k in range(index) if hidden(k) is None]
    if hidden(index) is not None and clear and np.isnan(followed.X_CO[clear[0]]).any():
        reason = (
            f"what looks like '{obj.name}' in frame {index} ({100 * pose.confidence:.0f} % sure) is not there in frame "
            f"{clear[0]}, before the person comes: it is another thing, or the person."
        )
        return _nowhere(len(frames), reason, pose, table)
    return followed


def without(frame: Frame, hidden: np.ndarray | None) -> Frame:
    """The frame with the depth of some pixels left out; as it is when nothing would be left."""
    if hidden is None or not (frame.depth[~hidden] > 0).any():
        return frame
    return replace(frame, depth=np.where(hidden, 0.0, frame.depth))


def _order(count: int, hidden: Hidden) -> list[int]:
    """Frames to look in: a few without a person, the first ones first, then a few others."""
    clear: list[int] = []
    for k in range(count):
        if hidden(k) is None:
            clear.append(k)
        elif clear:
            break  # before the hand comes, nobody has moved anything
    some = clear[:: max(1, len(clear) // _TRIED)][:_TRIED]
    rest = [k for k in range(0, count, max(1, count // _TRIED_HIDDEN)) if k not in some]
    return some + rest[:_TRIED_HIDDEN]


def _find(frame: Frame, obj: ObjectModel, seed: int) -> tuple[tuple[PoseResult, TableFit] | None, str]:
    try:
        table = find_table(frame, seed=seed)
    except InputError as error:
        return None, str(error)
    best: PoseResult | None = None
    for mask in find_clusters(frame, table.plane, extent=table.extent)[:_CLUSTERS]:
        if (mask & (frame.depth > 0)).sum() < _LEAST_PIXELS:
            continue
        pose = estimate_pose(
            obj, depth=frame.depth, intrinsics=frame.intrinsics, mask=mask, table=table.plane, seed=seed
        )
        if best is None or pose.confidence > best.confidence:
            best = pose
    if best is None:
        return None, "nothing stands on the table."
    return (best, table), ""


def _nowhere(count: int, reason: str, pose: PoseResult | None, table: TableFit | None) -> FollowedObject:
    return FollowedObject(
        X_CO=np.full((count, 4, 4), np.nan), seen=np.zeros(count), found_in=-1, pose=pose, table=table,
        moves_from=None, lost_from=0, reason=reason,
    )  # fmt: skip


def _follow(
    frames: Sequence[Frame], obj: ObjectModel, start: int, pose: PoseResult, table: TableFit, seed: int
) -> FollowedObject:
    """From the frame it was found in onwards, and back to the first."""
    track = _Track(frames=frames, obj=obj, start=start, table=table, seed=seed)
    X_WO = track.X_WC[start] @ pose.X_CO
    moves_from, lost_from = track.walk(range(start, len(frames)), X_WO)
    came_to, lost_before = track.walk(range(start - 1, -1, -1), X_WO)
    if came_to is not None:  # it stood elsewhere before
        moves_from = min(came_to + 1, start)
    if lost_before is not None and lost_from is None:
        lost_from = 0
    return FollowedObject(
        X_CO=track.X_CO, seen=track.seen, found_in=start, pose=pose, table=table, moves_from=moves_from,
        lost_from=lost_from, reason="",
    )  # fmt: skip


class _Track:
    """Poses of an object in the frames, as far as they are known."""

    def __init__(self, *, frames: Sequence[Frame], obj: ObjectModel, start: int, table: TableFit, seed: int) -> None:
        self.frames, self.obj, self.seed = frames, obj, seed
        self.X_WC = camera_poses(frames)
        self.table_W = table.plane.moved(self.X_WC[start])
        self.X_CO, self.seen = np.full((len(frames), 4, 4), np.nan), np.zeros(len(frames))
        self.usual: float | None = None

    def walk(self, numbers: range, X_WO: np.ndarray) -> tuple[int | None, int | None]:
        """Fill in frames one after the other from a pose; the first in which it has moved, and is lost."""
        moves: int | None = None
        for k in numbers:
            frame, X_CW = self.frames[k], inverse_np(self.X_WC[k])
            self.X_CO[k] = X_CW @ X_WO
            gone, self.seen[k] = _compare(frame, self.obj, self.X_CO[k])
            if self.usual is None:
                self.usual = gone
            if gone <= self.usual + _GONE_SHARE:
                continue
            tracked = _tracked(frame, self.obj, self.X_CO[k], self.table_W.moved(X_CW), self.seed)
            left, agrees = (1.0, 0.0) if tracked is None else _compare(frame, self.obj, tracked)
            if tracked is not None and left < gone and _shift(self.obj, tracked, self.X_CO[k]) > _MOVED_M:
                moves = k if moves is None else moves
                self.X_CO[k], X_WO, gone, self.seen[k] = tracked, self.X_WC[k] @ tracked, left, agrees
            if gone > _LOST_SHARE:
                self.X_CO[k] = np.nan
                return moves, k
        return moves, None


def _tracked(view: Frame, obj: ObjectModel, X_CO: np.ndarray, table_C: Plane, seed: int) -> np.ndarray | None:
    """The pose in the next frame; None when too few pixels lie near the last, or it would be in the table."""
    try:
        found = track_pose(obj, view.depth, view.intrinsics, X_CO, seed=seed).X_CO
    except InputError:
        return None
    lowest = table_C.height(transform_points_np(found, obj.mesh.vertices)).min()
    return found if lowest > -_SUNK_M else None


def _shift(obj: ObjectModel, X_a: np.ndarray, X_b: np.ndarray) -> float:
    """Farthest that a corner of the object's box is moved from one pose to another, metres."""
    low, high = obj.mesh.bounds
    corners = np.stack(np.meshgrid(*np.stack([low, high], axis=1)), axis=-1).reshape(-1, 3)
    return float(np.linalg.norm(transform_points_np(X_a, corners) - transform_points_np(X_b, corners), axis=1).max())


def _compare(view: Frame, obj: ObjectModel, X_CO: np.ndarray) -> tuple[float, float]:
    """Of the pixels that the object at a pose covers: the share seen through, of those not hidden; and that agree."""
    k = view.intrinsics
    model = depth_images(obj.mesh, X_CO[None], k)[0][::_SEARCH_STRIDE, ::_SEARCH_STRIDE]
    depth = view.depth[::_SEARCH_STRIDE, ::_SEARCH_STRIDE]
    covered = np.isfinite(model)
    if not covered.any():
        return 1.0, 0.0
    behind = depth[covered] - model[covered]
    measured = depth[covered] > 0
    agree = float((measured & (np.abs(behind) < _AGREE_M)).sum())
    through = float((measured & (behind > _AGREE_M)).sum())
    return through / max(agree + through, 1.0), agree / covered.sum()


def table_in_object(followed: FollowedObject) -> Plane | None:
    """The table in the object's frame as it stood, normal up; None when it was not found."""
    if followed.table is None or followed.pose is None or followed.reason:
        return None
    return followed.table.plane.moved(inverse_np(followed.pose.X_CO))
