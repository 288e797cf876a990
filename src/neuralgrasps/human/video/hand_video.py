"""What is known of the hand in a video so far: boxes, joints, clouds and fits, each made once, when asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.se3_numpy import inverse_np
from neuralgrasps.human.fit.hand_cloud import CloudConfig, hand_cloud
from neuralgrasps.human.fit.hand_fit import fit_hand
from neuralgrasps.human.seen import FittedHand, HandBox, SeenJoints, Side
from neuralgrasps.human.video.sighting import JointSource, joints_box, of_side
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame

_LEAST_WEIGHT = 0.02  # mean of the joints: less is no sight of a hand


@dataclass(slots=True, kw_only=True, eq=False)
class HandVideo:
    """One hand in T frames.

    Attributes:
        frames: the video. reader: of joints; None where all are given.
        obj: what is grasped; None when it is not known. X_CO: (T, 4, 4) where it is; nan when not known.
        X_WC: (T, 4, 4) the camera in the world; identities when it is at rest.
        table: what it stands on, in the first frame's camera, normal up; None: there is none.
        cloud_config: which pixels count as the hand's.
        side, scale: of the hand, once decided. boxes: found so far, by frame. scanned: frames searched for a hand.
        notes: what speaks against the outcome, in words.
    """

    frames: Sequence[Frame]
    reader: JointSource | None
    obj: ObjectModel | None
    X_CO: np.ndarray
    X_WC: np.ndarray
    table: Plane | None
    cloud_config: CloudConfig
    side: Side = "right"
    scale: float | None = None
    boxes: dict[int, HandBox] = field(default_factory=dict)
    scanned: set[int] = field(default_factory=set)
    notes: list[str] = field(default_factory=list)
    _seen: dict[tuple[int, Side], SeenJoints | None] = field(default_factory=dict)
    _clouds: dict[tuple[int, Side], np.ndarray] = field(default_factory=dict)
    _fits: dict[int, FittedHand] = field(default_factory=dict)

    def give(self, number: int, seen: SeenJoints) -> None:
        """Take joints from elsewhere for a frame."""
        self._seen[number, seen.side] = seen

    def forget(self, number: int) -> None:
        """Take it that no hand is in a frame after all."""
        self.boxes.pop(number, None)
        self._seen[number, self.side] = None

    def see(self, number: int, *, side: Side | None = None) -> SeenJoints | None:
        """The joints in a frame, taken for a hand of `side`, None for the decided one; None where none are seen."""
        side = side or self.side
        key = (number, side)
        if key not in self._seen:
            self._seen[key] = self._given(number, side) if self.reader is None else self._read(number, side)
        return self._seen[key]

    def _given(self, number: int, side: Side) -> SeenJoints | None:
        """Joints that were given for the other side, taken for this one."""
        other = self._seen.get((number, "left" if side == "right" else "right"))
        return None if other is None else replace(other, side=side)

    def _read(self, number: int, side: Side) -> SeenJoints | None:
        box = self._box(number)
        if self.reader is None or box is None:
            return None
        seen = self.reader.read(self.frames[number], of_side(box, side))
        known = np.isfinite(seen.points_C).all(axis=1)
        return seen if known.sum() >= 6 and seen.weight[known].mean() >= _LEAST_WEIGHT else None

    def cloud(self, number: int, *, side: Side | None = None) -> np.ndarray:
        """(M, 3) the hand's measured points in a frame where it is seen; M = 0 elsewhere."""
        key = (number, side or self.side)
        if key not in self._clouds:
            seen = self.see(number, side=side)
            self._clouds[key] = np.zeros((0, 3)) if seen is None else self.cloud_near(number, seen)
        return self._clouds[key]

    def cloud_near(self, number: int, seen: SeenJoints, *, reach_m: float | None = None) -> np.ndarray:
        """(M, 3) the hand's measured points in a frame, near these joints."""
        config = self.cloud_config if reach_m is None else replace(self.cloud_config, reach_m=reach_m)
        return hand_cloud(
            self.frames[number], seen, box=self.boxes.get(number), obj=self.held(number),
            table=None if self.table is None else self.table.moved(inverse_np(self.X_WC[number]) @ self.X_WC[0]),
            config=config,
        )  # fmt: skip

    def held(self, number: int) -> tuple[ObjectModel, np.ndarray] | None:
        """The object and its X_CO in a frame; None where either is not known."""
        if self.obj is None or not np.isfinite(self.X_CO[number]).all():
            return None
        return self.obj, self.X_CO[number]

    def fit(self, number: int) -> FittedHand | None:
        """The hand fitted to one frame, at the decided side and size; None where no hand is seen."""
        seen = self.see(number)
        if seen is None:
            return None
        if number not in self._fits:
            before = [k for k in self._fits if abs(k - number) <= 2]
            start = self._fits[min(before, key=lambda k: abs(k - number))] if before else None
            self._fits[number] = fit_hand(
                seen, self.cloud(number), side=self.side, scale=self.scale, start=start, obj=self.held(number)
            )
        return self._fits[number]

    def seen_frames(self) -> list[int]:
        """Frames in which joints of the decided side are known, ascending."""
        return sorted(n for (n, side), seen in self._seen.items() if side == self.side and seen is not None)

    def looked_frames(self) -> tuple[int, ...]:
        """Frames in which a hand was looked for, by its box or its joints, ascending; a hand is in some of them."""
        return tuple(sorted(self.scanned | set(self.boxes) | {n for n, _ in self._seen}))

    def to_frame(self, source: int, target: int) -> np.ndarray:
        """(4, 4) maps the camera frame of one frame to that of another, as if the object had stood still.

        Where the object is not known, as if nothing but the camera had moved.
        """
        if self.obj is None or not np.isfinite(self.X_CO[[source, target]]).all():
            return inverse_np(self.X_WC[target]) @ self.X_WC[source]
        return self.X_CO[target] @ inverse_np(self.X_CO[source])

    def object_in_world(self) -> np.ndarray:
        """(T, 4, 4) the object in the world, or in the camera at rest; nan where not known."""
        return self.X_WC @ self.X_CO

    def fits_by_frame(self) -> tuple[FittedHand | None, ...]:
        """(T,) the fits made so far."""
        return tuple(self._fits.get(n) for n in range(len(self.frames)))

    def seen_by_frame(self) -> tuple[SeenJoints | None, ...]:
        """(T,) the joints read so far, of the decided side."""
        return tuple(self._seen.get((n, self.side)) for n in range(len(self.frames)))

    def _box(self, number: int) -> HandBox | None:
        """The box of a frame: found there, or followed from the nearest frame where joints or a box are known."""
        if number in self.boxes:
            return self.boxes[number]
        near = [n for n in self.seen_frames() if abs(n - number) <= 6]
        if near:
            nearest = min(near, key=lambda n: abs(n - number))
            seen = self._seen[nearest, self.side]
            box = None if seen is None else joints_box(seen, self.frames[nearest].intrinsics, score=0.5)
            if box is not None:
                self.boxes[number] = box
                return box
        boxed = [n for n in self.boxes if abs(n - number) <= 6]
        return self.boxes[min(boxed, key=lambda n: abs(n - number))] if boxed else None


def object_poses(X_CO: np.ndarray | Sequence[np.ndarray | None] | None, count: int) -> np.ndarray:
    """(count, 4, 4) the object's poses; one pose holds for all frames; nan where not known."""
    out = np.full((count, 4, 4), np.nan)
    if X_CO is None:
        return out
    if isinstance(X_CO, np.ndarray) and X_CO.shape == (4, 4):
        out[:] = X_CO
        return out
    for number, pose in enumerate(X_CO):
        if pose is not None:
            out[number] = pose
    return out
