"""A view in which a given share of the hand is seen: by where the camera stands, else by a thing that stands before."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from neuralgrasps.geometry.camera import Intrinsics, look_at
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.human.synthetic.occluder import draw_occluder, is_near
from neuralgrasps.human.synthetic.scene import (
    OBJECTS,
    alone_mask,
    drawn_labels,
    picked,
    smaller,
    visible_share,
)
from neuralgrasps.human.synthetic.shaded_scene import Thing

_CAMERAS, _OCCLUDERS = 40, 40  # places that are tried; things, before each of these cameras
_ENOUGH, _NEAR = 0.1, 0.04  # from the share drawn: what a camera alone may be, and with a thing before it
_INSIDE = (0.97, 0.6)  # of the hand's outline lies in the image at the grasp, at the end: it is hidden, not cut off
_FOUND, _HELD = 0.45, 0.15  # of the object's outline that is seen before the hand comes, and at the grasp
_ARM = 0.3  # of the image that the arm may fill
_OCCLUDER = 0.3  # of the image that the thing may fill
_ARMS, _THING = 2, 100  # labels in an image: of the first mesh of the arm, of the thing


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HiddenView:
    """A camera, and what hides the hand from it.

    Attributes:
        X_WC: (4, 4) the camera.
        occluder: a thing in W that stands before the hand; None where the camera's place is enough.
        note: what is to be known of it, in words; "" for nothing.
    """

    X_WC: np.ndarray
    occluder: Thing | None = None
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Acted:
    """What moves in a demonstration, in W.

    Attributes:
        person: azimuth from which the arm comes, rad. hand_W: (3,) middle of the hand at the grasp.
        meshes: the hand, the object, then the arm's.
        moments: their vertices (V, 3) at the first frame, the grasp and the last frame.
        swept_W: gives (M, 3) places that anything of it ever takes, see `swept`; asked for only where it is needed.
    """

    person: float
    hand_W: np.ndarray
    meshes: Sequence[Mesh]
    moments: Sequence[Sequence[np.ndarray]]
    swept_W: Callable[[], np.ndarray]


def choose_hidden_view(
    rng: np.random.Generator, acted: Acted, *, intrinsics: Intrinsics, share: tuple[float, float]
) -> HiddenView:
    """A view that shows a share of the hand drawn from a range.

    Cameras are tried all round, low ones and those behind the arm too; where none sees so little, things that stand on
    the table between camera and hand. The object is seen well enough to be found before the hand comes.

    Args:
        share: least and most of the hand's outline that is seen at the grasp.
    Returns:
        The view; where none tried shows a share within the range, the nearest, and a note.
    """
    wanted = float(rng.uniform(*share))
    views = [_View(acted, _camera(rng, acted), intrinsics) for _ in range(_CAMERAS)]
    inside = sorted((view for view in views if share[0] < view.share < share[1]), key=lambda v: abs(v.share - wanted))
    for view in inside:
        if abs(view.share - wanted) < _ENOUGH and view.usable and share[0] <= view.exact_share() <= share[1]:
            return HiddenView(X_WC=view.X_WC)
    colour = picked(OBJECTS, rng)
    for view in views:
        for _ in range(_OCCLUDERS if view.share > wanted and view.usable else 0):
            mesh = draw_occluder(rng, hand_W=acted.hand_W, X_WC=view.X_WC)
            if mesh is None or not abs(view.share_behind(mesh) - wanted) < _NEAR or is_near(mesh, acted.swept_W()):
                continue
            if share[0] <= view.exact_share(mesh) <= share[1]:
                thing = Thing(mesh=mesh, colour=colour)
                return HiddenView(X_WC=view.X_WC, occluder=thing, note="a thing stands before the hand")
    return _nearest(views, share)


def _nearest(views: Sequence[_View], share: tuple[float, float]) -> HiddenView:
    """The camera that comes nearest to the range."""
    best = min(views, key=lambda view: (not view.usable, max(share[0] - view.share, view.share - share[1], 0.0)))
    note = f"no view tried shows {share[0]:g} to {share[1]:g} of the hand"
    return HiddenView(X_WC=best.X_WC, note="" if share[0] <= best.exact_share() <= share[1] else note)


def _camera(rng: np.random.Generator, acted: Acted) -> np.ndarray:
    """X_WC (4, 4) of a camera 0.5 to 0.95 m from the object, low or high, not looking along the arm from behind."""
    azimuth = acted.person + rng.choice([-1.0, 1.0]) * np.radians(rng.uniform(20.0, 180.0))
    height, distance = np.radians(rng.uniform(12.0, 62.0)), rng.uniform(0.5, 0.95)
    toward = np.array([np.cos(azimuth) * np.cos(height), np.sin(azimuth) * np.cos(height), np.sin(height)])
    aim = 0.5 * acted.hand_W + 0.03 * rng.standard_normal(3)
    return look_at(aim + distance * toward, aim)


class _View:
    """What a camera sees at the first frame, the grasp and the last frame, in small images; drawn when asked for."""

    def __init__(self, acted: Acted, X_WC: np.ndarray, intrinsics: Intrinsics) -> None:
        self.X_WC, self._acted, self._intrinsics = X_WC, acted, intrinsics
        self._small, self._grasp = smaller(intrinsics), acted.moments[1]
        self._alone = self._outline(self._grasp, 0)
        self._drawn = drawn_labels(self._things(self._grasp), X_WC, self._small)
        self.share = visible_share(self._drawn[1] == 0, self._alone)

    @cached_property
    def usable(self) -> bool:
        """Whether the hand is in the image, the arm does not fill it, and the object can be found."""
        for vertices_W, least in zip(self._acted.moments[1:], _INSIDE, strict=True):
            _, inside = drawn_labels([self._things(vertices_W)[0]], self.X_WC, self._small)
            if visible_share(inside == 0, self._outline(vertices_W, 0)) < least:
                return False
        labels = [self._first[1], self._drawn[1]]
        return max((seen >= _ARMS).mean() for seen in labels) <= _ARM and self._shows_object(labels)

    def share_behind(self, mesh: Mesh) -> float:
        """Share of the hand that is seen at the grasp behind a thing; nan where that hides too much else."""
        seen = [self._with(mesh, drawn) for drawn in (self._first, self._drawn)]
        if (seen[0] == _THING).mean() > _OCCLUDER or not self._shows_object(seen):
            return float("nan")
        return visible_share(seen[1] == 0, self._alone)

    def exact_share(self, mesh: Mesh | None = None) -> float:
        """Share of the hand that is seen at the grasp, perhaps behind a thing, in the full image."""
        things = self._things(self._grasp) + ([] if mesh is None else [(mesh.vertices, mesh.faces)])
        _, labels = drawn_labels(things, self.X_WC, self._intrinsics)
        return visible_share(labels == 0, alone_mask(*things[0], self.X_WC, self._intrinsics))

    @cached_property
    def _first(self) -> tuple[np.ndarray, np.ndarray]:
        return drawn_labels(self._things(self._acted.moments[0]), self.X_WC, self._small)

    @cached_property
    def _objects(self) -> list[np.ndarray]:
        return [self._outline(vertices_W, 1) for vertices_W in self._acted.moments[:2]]

    def _shows_object(self, labels: Sequence[np.ndarray]) -> bool:
        shares = [visible_share(seen == 1, alone) for seen, alone in zip(labels, self._objects, strict=True)]
        return shares[0] >= _FOUND and shares[1] >= _HELD

    def _things(self, vertices_W: Sequence[np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
        return list(zip(vertices_W, (m.faces for m in self._acted.meshes), strict=True))

    def _outline(self, vertices_W: Sequence[np.ndarray], which: int) -> np.ndarray:
        return alone_mask(vertices_W[which], self._acted.meshes[which].faces, self.X_WC, self._small)

    def _with(self, mesh: Mesh, drawn: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """Labels with a thing added."""
        return drawn_labels([(mesh.vertices, mesh.faces)], self.X_WC, self._small, over=drawn, first=_THING)[1]
