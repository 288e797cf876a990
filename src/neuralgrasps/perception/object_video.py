"""A known object over a video: found where nothing hides it, kept while it stands still, followed when it moves."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.raster import depth_images
from neuralgrasps.geometry.se3_numpy import inverse_np, transform_points_np
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame, camera_poses
from neuralgrasps.perception.object_sighting import Sighting, sight
from neuralgrasps.perception.pose import PoseResult
from neuralgrasps.perception.table import TableFit
from neuralgrasps.perception.track import track_pose

Hidden = Callable[[int], np.ndarray | None]
"""Of a frame's number: (h, w) bool, pixels that may show a person; None when nobody is there."""

_TRIED, _TRIED_HIDDEN = 3, 5  # frames that the object is looked for in: without a person, and with one
_SURE = 0.99  # confidence that ends the search
_AS_WELL = 0.05  # poses that differ by less in what is seen of them are shown alike
_AGREE_M = 0.008  # measured so near to the model; farther behind it, the object is not there
_GONE_SHARE, _LOST_SHARE = 0.08, 0.5  # more of its pixels than at first show what is behind: looked at; lost
_MOVED_M = 0.004  # less is no motion
_STANDS_M = 0.012  # what stands on a table seems no higher above it or deeper in it
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
        stands_in: first frame in which it stands at rest on the table; None: in none, or not found. table_O: the table
            in its frame then, normal up. note: what that says against the table, in words, or "".
    """

    X_CO: np.ndarray
    seen: np.ndarray
    found_in: int
    pose: PoseResult | None
    table: TableFit | None
    moves_from: int | None
    lost_from: int | None
    reason: str
    stands_in: int | None = None
    table_O: Plane | None = None
    note: str = ""


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
    seen, reason = _looked(frames, obj, hidden, seed)
    best = _best(frames, obj, seen)
    if best is None or not best.found:
        if best is not None:
            reason = f"what stands there does not look like '{obj.name}': the confidence is {best.pose.confidence:.2f}"
            reason += f", {100 * best.pose.score:.0f} % of the view is explained." if best.hidden else "."
        if all(hidden(k) is not None for k in range(len(frames))):
            reason += " A person is in every frame, and may hide it: show it for a moment before the hand comes."
        return _nowhere(len(frames), reason, best)
    followed = _follow(frames, obj, best, seed)
    clear = [k for k in range(best.frame) if hidden(k) is None]
    if best.hidden and clear and np.isnan(followed.X_CO[clear[0]]).any():
        reason = (
            f"what looks like '{obj.name}' in frame {best.frame} ({100 * best.pose.confidence:.0f} % sure) is not "
            f"there in frame {clear[0]}, before the person comes: it is another thing, or the person."
        )
        return _nowhere(len(frames), reason, best)
    return followed


def _looked(frames: Sequence[Frame], obj: ObjectModel, hidden: Hidden, seed: int) -> tuple[list[Sighting], str]:
    """The object in a few frames, up to one in which it is sure; and why the last one of the others shows none."""
    seen: list[Sighting] = []
    reason = "no frame"
    for number in _order(len(frames), hidden):
        found = sight(frames[number], number, obj, hidden=hidden(number), seed=seed)
        if isinstance(found, str):
            reason = found
            continue
        seen.append(found)
        if found.found and found.pose.confidence >= _SURE:
            break
    return seen, reason


def _best(frames: Sequence[Frame], obj: ObjectModel, seen: Sequence[Sighting]) -> Sighting | None:
    """The surest sighting; of those without a person the one whose pose all of them show.

    Nobody has moved anything before the person comes: a pose that a half hidden view suggests is refuted by the others.
    """
    clear = [s for s in seen if not s.hidden and s.found]
    if len(clear) < 2:
        return max(seen, key=lambda s: (s.found, s.pose.confidence), default=None)
    X_WC = camera_poses(frames)
    shown = []
    for one in clear:
        X_WO = X_WC[one.frame] @ one.pose.X_CO
        views = [_compare(frames[s.frame], obj, inverse_np(X_WC[s.frame]) @ X_WO) for s in clear]
        shown.append(float(np.mean([v.agree - v.through for v in views])))
    alike = [s for s, share in zip(clear, shown, strict=True) if share > max(shown) - _AS_WELL]
    return max(alike, key=lambda s: s.pose.confidence)


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


def _nowhere(count: int, reason: str, best: Sighting | None) -> FollowedObject:
    pose, table = (None, None) if best is None else (best.pose, best.table)
    return FollowedObject(
        X_CO=np.full((count, 4, 4), np.nan), seen=np.zeros(count), found_in=-1, pose=pose, table=table,
        moves_from=None, lost_from=0, reason=reason,
    )  # fmt: skip


def _follow(frames: Sequence[Frame], obj: ObjectModel, found: Sighting, seed: int) -> FollowedObject:
    """From the frame it was found in onwards, and back to the first."""
    start = found.frame
    track = _Track(frames=frames, obj=obj, start=start, table=found.table, seed=seed)
    X_WO = track.X_WC[start] @ found.pose.X_CO
    moved, lost_from = track.walk(range(start, len(frames)), X_WO)
    moved_before, lost_before = track.walk(range(start - 1, -1, -1), X_WO)
    moves_from = moved[0] if moved else None
    if moved_before:  # it stood elsewhere before: at first where it was in the last of these
        moves_from = moved_before[-1] + 1
    if lost_before is not None and lost_from is None:
        lost_from = 0
    stands_in, above_m = track.rest()
    table_O = None
    if stands_in is not None:
        table_O = track.table_W.moved(inverse_np(track.X_WC[stands_in] @ track.X_CO[stands_in]))
    return FollowedObject(
        X_CO=track.X_CO, seen=track.seen, found_in=start, pose=found.pose, table=found.table, moves_from=moves_from,
        lost_from=lost_from, reason="", stands_in=stands_in, table_O=table_O,
        note="" if stands_in is not None else _not_standing(obj.name, above_m),
    )  # fmt: skip


def _not_standing(name: str, above_m: float) -> str:
    where = f"at least {1e3 * abs(above_m):.0f} mm {'above' if above_m > 0 else 'below'} it"
    return (
        f"'{name}' is in no frame seen standing on the table, but {where}: how it stood is not known, and the table is "
        "left out of account. Show it on the table before it is lifted."
    )


@dataclass(frozen=True, slots=True)
class _View:
    """Of the pixels that an object covers: the shares that agree, and that are seen through; others are hidden."""

    agree: float
    through: float

    @property
    def gone(self) -> float:
        """Share seen through, of what is not hidden."""
        return self.through / max(self.agree + self.through, 1e-9)


class _Track:
    """Poses of an object in the frames, as far as they are known."""

    def __init__(self, *, frames: Sequence[Frame], obj: ObjectModel, start: int, table: TableFit, seed: int) -> None:
        self.frames, self.obj, self.seed = frames, obj, seed
        self.X_WC = camera_poses(frames)
        self.table_W = table.plane.moved(self.X_WC[start])
        self.X_CO, self.seen = np.full((len(frames), 4, 4), np.nan), np.zeros(len(frames))
        self.usual: float | None = None

    def walk(self, numbers: range, X_WO: np.ndarray) -> tuple[list[int], int | None]:
        """Fill in frames one after the other from a pose; those to which it has moved, and where it is lost."""
        moved: list[int] = []
        for k in numbers:
            frame, X_CW = self.frames[k], inverse_np(self.X_WC[k])
            self.X_CO[k] = X_CW @ X_WO
            view = _compare(frame, self.obj, self.X_CO[k])
            gone, self.seen[k] = view.gone, view.agree
            if self.usual is None:
                self.usual = gone
            if gone <= self.usual + _GONE_SHARE:
                continue
            tracked = _tracked(frame, self.obj, self.X_CO[k], self.table_W.moved(X_CW), self.seed)
            there = _View(0.0, 1.0) if tracked is None else _compare(frame, self.obj, tracked)
            if tracked is not None and there.gone < gone and _shift(self.obj, tracked, self.X_CO[k]) > _MOVED_M:
                moved.append(k)
                self.X_CO[k], X_WO, gone, self.seen[k] = tracked, self.X_WC[k] @ tracked, there.gone, there.agree
            if gone > _LOST_SHARE:
                self.X_CO[k] = np.nan
                return moved, k
        return moved, None

    def rest(self) -> tuple[int | None, float]:
        """The first frame in which the object stands on the table and keeps still; how high it is at least above it."""
        known = np.flatnonzero(np.isfinite(self.X_CO).all(axis=(1, 2)))
        X_WO = self.X_WC[known] @ self.X_CO[known]
        height = np.array([self.table_W.height(transform_points_np(X, self.obj.mesh.vertices)).min() for X in X_WO])
        steps = np.array([_shift(self.obj, a, b) for a, b in itertools.pairwise(X_WO)])
        still = np.ones(len(known), bool) if not len(steps) else np.append(steps, np.inf) < _MOVED_M
        still[1:] |= steps < _MOVED_M
        standing = np.flatnonzero(still & (np.abs(height) < _STANDS_M))
        if len(standing):
            return int(known[standing[0]]), 0.0
        return None, float(height[np.argmin(np.abs(height))])


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


def _compare(view: Frame, obj: ObjectModel, X_CO: np.ndarray) -> _View:
    """What a frame shows of the object at a pose."""
    k = view.intrinsics
    model = depth_images(obj.mesh, X_CO[None], k)[0][::_SEARCH_STRIDE, ::_SEARCH_STRIDE]
    depth = view.depth[::_SEARCH_STRIDE, ::_SEARCH_STRIDE]
    covered = np.isfinite(model)
    if not covered.any():
        return _View(0.0, 1.0)
    behind = depth[covered] - model[covered]
    measured = depth[covered] > 0
    agree, through = measured & (np.abs(behind) < _AGREE_M), measured & (behind > _AGREE_M)
    return _View(float(agree.mean()), float(through.mean()))
