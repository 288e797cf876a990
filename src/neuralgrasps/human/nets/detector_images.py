"""Full frames with no, one or two hands for the detector's training, at the focal length that it sees.

The same seed gives the same images, whatever is drawn before or beside them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.raster import NEAR_M, raster_labels
from neuralgrasps.human.nets.detector_room import Props, make_props, plane_frame, random_room, things_around
from neuralgrasps.human.nets.detector_view import FOCAL_PX
from neuralgrasps.human.scenes.grasp_bank import GraspBank
from neuralgrasps.human.scenes.image_noise import draw_noise, sense_image
from neuralgrasps.human.scenes.kit import scene_kit
from neuralgrasps.human.scenes.random_scene import SceneMix, compose_scene, scene_buffers
from neuralgrasps.human.scenes.surroundings import FOREARM, HAND, TABLE
from neuralgrasps.seeds import child_rng

HEIGHT, WIDTH = 128, 160
MOST_HANDS = 2

_EMPTY, _TWO = 0.18, 0.18  # shares of images without a hand, with two
_FOV_DEG = (38.0, 78.0)  # of the camera, across the image
_FARTHEST_M, _FAR = (1.0, 1.5), 0.35  # hands reach the second distance in this share of images
_FEWEST_PX, _LEAST_SHARE = 20, 0.12  # less of a hand than this is not asked for
_MARGIN_PX = 2.0  # how far out of the image palms lie at most
_FAR_CUT, _HOLED = 0.25, 0.25  # shares of images
_STRONGEST = 1.3  # noise, times that of a structured-light camera
_AROUND_PX = 96  # a hand's own pixels are counted in an image larger by this on each side


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectorImages:
    """N images and the hands in them, up to `MOST_HANDS` each.

    Attributes:
        depth: (N, h, w) float32 metres, 0 = not measured.
        boxes: (N, H, 4) float32 u_min, v_min, u_max, v_max of all of a hand, hidden parts too, pixels; it may reach
            out of the image.
        right: (N, H) bool. known: (N, H) bool, hands to be found. ignored: (N, H) bool, hands almost out of sight.
        visible: (N, H) float32 share of a hand's pixels that are in the image and not hidden.
        distance_m: (N, H) float32 of the wrist, along the view.
    """

    depth: np.ndarray
    boxes: np.ndarray
    right: np.ndarray
    known: np.ndarray
    ignored: np.ndarray
    visible: np.ndarray
    distance_m: np.ndarray

    @staticmethod
    def room(count: int) -> DetectorImages:
        """Images and hands still to be filled in."""
        hands = (count, MOST_HANDS)
        return DetectorImages(
            depth=np.zeros((count, HEIGHT, WIDTH), np.float32), boxes=np.zeros((*hands, 4), np.float32),
            right=np.zeros(hands, bool), known=np.zeros(hands, bool), ignored=np.zeros(hands, bool),
            visible=np.zeros(hands, np.float32), distance_m=np.zeros(hands, np.float32),
        )  # fmt: skip

    def __getitem__(self, rows: slice) -> DetectorImages:
        return DetectorImages(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})


def with_mirrored(images: DetectorImages) -> DetectorImages:
    """Images, then each of them in the mirror: left hands become right ones."""
    u_min, v_min, u_max, v_max = np.moveaxis(images.boxes, -1, 0)
    last = images.depth.shape[2] - 1
    mirrored = replace(
        images,
        depth=images.depth[:, :, ::-1],
        boxes=np.stack([last - u_max, v_min, last - u_min, v_max], axis=-1),
        right=~images.right,
    )
    both = {f.name: np.concatenate([getattr(images, f.name), getattr(mirrored, f.name)]) for f in fields(images)}
    return DetectorImages(**both)


class _View(NamedTuple):
    """A camera of the detector's focal length: its middle, and the part of the image that it covers, pixels."""

    cx: float
    cy: float
    width: int
    height: int


@dataclass(slots=True)
class _Canvas:
    """An image being drawn: depth, and labels with h + 1 where hand h is seen, else 0."""

    depth: np.ndarray
    labels: np.ndarray
    view: _View

    def add(self, points_C: np.ndarray, faces: np.ndarray, labels: np.ndarray | None = None) -> None:
        if len(faces):
            labels = np.zeros(len(faces), np.int8) if labels is None else labels
            raster_labels(
                points_C, faces, labels, FOCAL_PX, FOCAL_PX, self.view.cx, self.view.cy, NEAR_M, self.depth, self.labels
            )

    def add_mesh(self, mesh: Mesh) -> None:
        self.add(mesh.vertices, mesh.faces)


class ImageMaker:
    """Draws images; keeps what they are made of."""

    def __init__(self, bank: GraspBank, *, props: Props | None = None) -> None:
        self._kit = scene_kit(bank)
        self._props = make_props() if props is None else props
        self._scene = scene_buffers(self._kit)

    def draw(self, seed: int, first: int, count: int) -> DetectorImages:
        """`count` images from number `first` on of the endless sequence of a seed."""
        out = DetectorImages.room(count)
        for row in range(count):
            self._draw_one(child_rng(seed, "detector image", first + row), out[row : row + 1])
        return out

    def _draw_one(self, rng: np.random.Generator, out: DetectorImages) -> None:
        view = _random_view(rng)
        canvas = _Canvas(np.full((HEIGHT, WIDTH), np.inf, np.float32), np.zeros((HEIGHT, WIDTH), np.int8), view)
        share = rng.random()
        hands = 0 if share < _EMPTY else 2 if share > 1.0 - _TWO else 1
        if hands == 0 and rng.random() < 0.7:
            canvas.add_mesh(random_room(self._props, rng))
        else:
            self._draw_hands(rng, canvas, hands, out)
        for hand in range(hands):
            _judge(out, hand, canvas)
        exact = canvas.depth[: view.height, : view.width]
        out.depth[0, : view.height, : view.width] = sensed(np.where(np.isfinite(exact), exact, np.float32(0.0)), rng)

    def _draw_hands(self, rng: np.random.Generator, canvas: _Canvas, hands: int, out: DetectorImages) -> None:
        """A scene with the first hand (its surroundings alone for 0 hands), things around, and further hands."""
        for hand in range(max(hands, 1)):
            mix = _mix(canvas.view, rng)
            if hand > 0:
                mix = mix._replace(table=0.0, wall=0.0, clutter=0)
            compose_scene(self._kit, mix, np.uint32(rng.integers(2**32)), self._scene)
            corners, triangles = self._scene.counts
            points, faces = self._scene.points[:corners], self._scene.faces[:triangles]
            labels = self._scene.labels[:triangles]
            right = bool(rng.random() < 0.5)
            if not right:
                points[:, 0] *= -1.0
            if hands == 0:
                kept = (labels != HAND) & (labels != FOREARM)
                canvas.add(points, faces[kept])
            else:
                canvas.add(points, faces, np.where(labels == HAND, hand + 1, 0).astype(np.int8))
                self._note(out, hand, points, right, canvas.view)
            if hand == 0:
                canvas.add_mesh(things_around(self._props, _table_frame(points, faces[labels == TABLE]), rng))

    def _note(self, out: DetectorImages, hand: int, points: np.ndarray, right: bool, view: _View) -> None:
        """Write a hand's box, side, distance and, for now, its own number of pixels."""
        skin = points[: len(self._kit.skin_core)]
        uv = skin[:, :2] / np.maximum(skin[:, 2:], NEAR_M) * FOCAL_PX + [view.cx, view.cy]
        out.boxes[0, hand] = *uv.min(axis=0), *uv.max(axis=0)
        out.right[0, hand] = right
        out.distance_m[0, hand] = self._scene.X_CH[2, 3]
        shape = (HEIGHT + 2 * _AROUND_PX, WIDTH + 2 * _AROUND_PX)
        alone = _Canvas(
            np.full(shape, np.inf, np.float32), np.zeros(shape, np.int8),
            view._replace(cx=view.cx + _AROUND_PX, cy=view.cy + _AROUND_PX),
        )  # fmt: skip
        alone.add(points, self._kit.skin_faces)
        out.visible[0, hand] = np.isfinite(alone.depth).sum()


def _judge(out: DetectorImages, hand: int, canvas: _Canvas) -> None:
    """Whether a drawn hand can be asked for."""
    view, box = canvas.view, out.boxes[0, hand]
    seen = int((canvas.labels[: view.height, : view.width] == hand + 1).sum())
    visible = seen / max(float(out.visible[0, hand]), 1.0)
    out.visible[0, hand] = visible
    u, v = 0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3])
    inside = -0.5 < u < view.width - 0.5 and -0.5 < v < view.height - 0.5
    out.known[0, hand] = inside and seen >= _FEWEST_PX and visible >= _LEAST_SHARE
    out.ignored[0, hand] = seen > 0 and not out.known[0, hand]


def _mix(view: _View, rng: np.random.Generator) -> SceneMix:
    """Scenes whose palm lies in this view, or a little outside."""
    beside = max(view.cx, view.width - view.cx) + _MARGIN_PX, max(view.cy, view.height - view.cy) + _MARGIN_PX
    farthest = _FARTHEST_M[int(rng.random() < _FAR)]
    return SceneMix(farthest_m=farthest, span_x=beside[0] / FOCAL_PX, span_y=beside[1] / FOCAL_PX)


def _random_view(rng: np.random.Generator) -> _View:
    """A camera of another field of view than the image: a part of a wider one, or a narrower one padded below and
    at the right as `detector_view` does."""
    whole_u = 2.0 * FOCAL_PX * math.tan(0.5 * math.radians(rng.uniform(*_FOV_DEG)))
    whole_v = whole_u * (9.0 / 16.0 if rng.random() < 0.3 else 0.75)
    (u, width), (v, height) = _window(whole_u, WIDTH, rng), _window(whole_v, HEIGHT, rng)
    return _View(0.5 * (whole_u - 1.0) - u, 0.5 * (whole_v - 1.0) - v, width, height)


def _window(whole: float, size: int, rng: np.random.Generator) -> tuple[float, int]:
    """Where a window of `size` pixels starts in a larger image, and how much of the window the image covers."""
    return rng.uniform(0.0, max(whole - size, 0.0)), min(round(whole), size)


def _table_frame(points: np.ndarray, faces: np.ndarray) -> np.ndarray | None:
    """X_CT of a table drawn as two triangles, z to the camera's side; None without one."""
    if not len(faces):
        return None
    a, b, c = points[faces[0]]
    up = np.cross(b - a, c - a)
    up /= np.linalg.norm(up)
    middle = 0.5 * (a + c)
    return plane_frame(up if up @ middle < 0.0 else -up, middle)


def sensed(depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """What a sensor reports of exact depth (h, w): noise of any strength, no depth far away, now and then holes."""
    if rng.random() < _FAR_CUT:
        depth = np.where(depth < rng.uniform(1.2, 3.0), depth, np.float32(0.0))
    out = np.empty_like(depth)
    _sense(depth, np.uint32(rng.integers(2**32)), FOCAL_PX, rng.uniform(1.0, 4.0), out)
    if rng.random() < _HOLED:
        v, u = np.ogrid[: depth.shape[0], : depth.shape[1]]
        for _ in range(int(rng.integers(1, 5))):
            middle_u, middle_v, radius = rng.uniform([0, 0, 2], [*reversed(depth.shape), 9])
            out[(u - middle_u) ** 2 + (v - middle_v) ** 2 < radius**2] = 0.0
    return out


@njit(cache=True, error_model="numpy")
def _sense(depth, seed, fx, ratio, out):  # type: ignore[no-untyped-def]
    np.random.seed(seed)  # noqa: NPY002 - the generator of compiled code
    sense_image(depth, fx, ratio, draw_noise(_STRONGEST), out)
