"""Draw the demo's pictures on all cores; equal requests are drawn once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neuralgrasps.demo.data import DemoData
from neuralgrasps.demo.measure import Progress
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.parallel import run_tasks
from neuralgrasps.report.figures import render_contact_map, render_grasp, render_hand

Request = tuple[str, str, str, int]  # kind, hand, object, grasp
Job = tuple[str, np.ndarray, np.ndarray, np.ndarray]  # kind, X_OH, q, contact map; what a kind does not use is empty
_EMPTY = np.zeros(0)


class PicturePlan:
    """Pictures asked for; each call returns the slot that `draw` fills."""

    def __init__(self) -> None:
        self.requests: list[Request] = []

    def hand(self, name: str) -> int:
        """A hand by itself."""
        return self._slot(("hand", name, "", 0))

    def grasp(self, hand: str, object_name: str, index: int) -> int:
        """A grasp of the pair's grasp set."""
        return self._slot(("grasp", hand, object_name, index))

    def contact(self, hand: str, object_name: str, index: int) -> int:
        """The contact map of a grasp, on the object."""
        return self._slot(("contact", hand, object_name, index))

    def _slot(self, request: Request) -> int:
        if request not in self.requests:
            self.requests.append(request)
        return self.requests.index(request)


def draw(plan: PicturePlan, data: DemoData, *, workers: int, progress: Progress) -> list[np.ndarray]:
    """RGBA pictures of all requests, in the order of their slots."""
    groups: dict[tuple[str, str], list[int]] = {}
    for slot, (_, hand, obj, _) in enumerate(plan.requests):
        groups.setdefault((hand, obj), []).append(slot)
    tasks = []
    for (hand, obj), slots in groups.items():
        jobs = []
        for slot in slots:
            kind, _, _, index = plan.requests[slot]
            if kind == "hand":
                jobs.append((kind, _EMPTY, _EMPTY, _EMPTY))
                continue
            grasps = data.set_of(hand, obj)
            values = data.latent.maps[hand, obj][index] if kind == "contact" else _EMPTY
            jobs.append((kind, grasps.X_OH[index], grasps.q[index], values))
        tasks.append((data.hands[hand], data.objects.get(obj), jobs))
    pictures: list[np.ndarray] = [np.zeros((1, 1, 4), np.uint8)] * len(plan.requests)
    done = 0
    for index, images in run_tasks(_draw_group, tasks, workers=workers):
        slots = list(groups.values())[index]
        for slot, image in zip(slots, images, strict=True):
            pictures[slot] = image
        done += len(slots)
        progress(done, len(pictures), "")
    return pictures


def _draw_group(hand: Hand, obj: ObjectModel | None, jobs: Sequence[Job]) -> list[np.ndarray]:
    images = []
    for kind, X_OH, q, values in jobs:
        if kind == "hand" or obj is None:
            images.append(render_hand(hand, hand.q_open))
        elif kind == "grasp":
            images.append(render_grasp(hand, obj, X_OH, q))
        else:
            images.append(render_contact_map(obj, values))
    return images
