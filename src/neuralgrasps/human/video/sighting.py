"""Where the hand is in the frames of a video: boxes linked over time, and the joints read in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from neuralgrasps.geometry.camera import Intrinsics, project
from neuralgrasps.human.seen import HandBox, SeenJoints, Side
from neuralgrasps.perception.frame import Frame


class HandFinder(Protocol):
    """What finds hands in one frame: the detector that comes with the library, or another."""

    def find(self, frame: Frame) -> Sequence[HandBox]:
        """The hands of a frame, surest first."""
        ...


class JointSource(Protocol):
    """What reads the joints of the hand in a box: the joint net that comes with the library, or another."""

    def read(self, frame: Frame, box: HandBox) -> SeenJoints:
        """The joints of the hand in `box`, taken for a hand of the box's side."""
        ...


@dataclass(slots=True, kw_only=True)
class BoxPath:
    """One hand followed through some frames: its boxes by frame number."""

    boxes: dict[int, HandBox]

    @property
    def last(self) -> HandBox:
        return self.boxes[max(self.boxes)]

    @property
    def score(self) -> float:
        """Sum over the frames."""
        return sum(box.score for box in self.boxes.values())


def linked_paths(found: dict[int, Sequence[HandBox]], *, least_score: float) -> list[BoxPath]:
    """Boxes of several frames as hands followed over time, the surest first.

    A box goes on with the path whose last box is nearest, by the distance of centres and of sizes in widths of the
    box; two boxes of a frame that overlap by half are one hand.
    """
    paths: list[BoxPath] = []
    for number in sorted(found):
        taken: set[int] = set()
        for box in distinct([b for b in found[number] if b.score >= least_score]):
            free = [k for k in range(len(paths)) if k not in taken]
            near = min(free, key=lambda k: _apart(paths[k].last, box), default=None)
            if near is None or _apart(paths[near].last, box) > 1.5:
                paths.append(BoxPath(boxes={}))
                near = len(paths) - 1
            paths[near].boxes[number] = box
            taken.add(near)
    return sorted(paths, key=lambda path: -path.score)


def distinct(boxes: Sequence[HandBox]) -> list[HandBox]:
    """Boxes of one frame without those that mostly cover a surer one."""
    kept: list[HandBox] = []
    for box in sorted(boxes, key=lambda b: -b.score):
        if all(overlap(box, other) < 0.5 for other in kept):
            kept.append(box)
    return kept


def overlap(a: HandBox, b: HandBox) -> float:
    """Common area over the smaller box's area, 0 to 1."""
    width = min(a.u_max, b.u_max) - max(a.u_min, b.u_min)
    height = min(a.v_max, b.v_max) - max(a.v_min, b.v_min)
    if width <= 0 or height <= 0:
        return 0.0
    return width * height / max(min(_area(a), _area(b)), 1e-9)


def joints_box(seen: SeenJoints, intrinsics: Intrinsics, *, score: float = 1.0, grow: float = 1.3) -> HandBox | None:
    """The box round seen joints, `grow` times as large as they reach, cut to the image; None when out of view."""
    pixels = project(seen.points_C, intrinsics)
    pixels = pixels[np.isfinite(pixels).all(axis=1)]
    if len(pixels) < 3:
        return None
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    middle, half = (low + high) / 2, grow * np.maximum(high - low, 12.0) / 2
    limit = np.array([intrinsics.width - 1.0, intrinsics.height - 1.0])
    low, high = np.clip(middle - half, 0.0, limit), np.clip(middle + half, 0.0, limit)
    if (high - low).min() < 4.0:
        return None
    return HandBox(
        u_min=float(low[0]), v_min=float(low[1]), u_max=float(high[0]), v_max=float(high[1]),
        score=score, side=seen.side, side_score=1.0,
    )  # fmt: skip


def side_vote(boxes: Sequence[HandBox]) -> float:
    """Which side boxes of one hand speak for: above 0 right, below left; 0.5 is sure, by the mean of the frames."""
    weight = np.array([box.score for box in boxes])
    vote = [(box.side_score - 0.5) * (1.0 if box.side == "right" else -1.0) for box in boxes]
    return float(np.average(vote, weights=weight)) if weight.sum() > 0 else 0.0


def of_side(box: HandBox, side: Side) -> HandBox:
    """The same box, taken for a hand of this side."""
    return replace(box, side=side)


def box_depth(frame: Frame, box: HandBox) -> np.ndarray:
    """Measured depths (M,) in the middle half of a box, metres, and the share of its pixels that have one."""
    u = np.linspace(0.75 * box.u_min + 0.25 * box.u_max, 0.25 * box.u_min + 0.75 * box.u_max, 24)
    v = np.linspace(0.75 * box.v_min + 0.25 * box.v_max, 0.25 * box.v_min + 0.75 * box.v_max, 24)
    rows = np.clip(np.round(v), 0, frame.depth.shape[0] - 1).astype(int)
    columns = np.clip(np.round(u), 0, frame.depth.shape[1] - 1).astype(int)
    return frame.depth[rows[:, None], columns].ravel()


def _area(box: HandBox) -> float:
    return (box.u_max - box.u_min) * (box.v_max - box.v_min)


def _apart(a: HandBox, b: HandBox) -> float:
    """Distance of centres, in mean sizes, plus the difference of sizes as a log ratio."""
    size_a, size_b = np.sqrt(max(_area(a), 1.0)), np.sqrt(max(_area(b), 1.0))
    du = (a.u_min + a.u_max - b.u_min - b.u_max) / 2
    dv = (a.v_min + a.v_max - b.v_min - b.v_max) / 2
    return float(np.hypot(du, dv) / (0.5 * (size_a + size_b)) + abs(np.log(size_a / size_b)))
