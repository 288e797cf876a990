"""What was seen of a hand, drawn over the camera's picture: its box, mask, 21 joints and the hand fitted to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw
from scipy import ndimage

from neuralgrasps.errors import ShapeError
from neuralgrasps.geometry.camera import Intrinsics, project
from neuralgrasps.geometry.mesh import Mesh, merge_meshes
from neuralgrasps.hands.surface import hand_part_meshes
from neuralgrasps.human.seen import FittedHand, HandBox, SeenJoints
from neuralgrasps.human.skeleton import BONES, NUM_JOINTS, TIPS
from neuralgrasps.report.labels import Label, draw_labels
from neuralgrasps.report.model_lines import model_lines
from neuralgrasps.report.palette import hand_colour, linear_rgb, mix
from neuralgrasps.report.pose_overlay import DrawnModel, render_pose_overlay, render_relief
from neuralgrasps.report.shading import Style, Surface, shade

FINGER_COLOURS = ("#ff5d5d", "#ffb02e", "#f4f04a", "#5fe06a", "#4db8ff")
"""Thumb to little finger."""
WRIST_COLOUR, BOX_COLOUR, MASK_COLOUR, OBJECT_LINES = "#ffffff", "#ff7ad9", "#ff9ec4", "#37d3ff"
_FITTED_COLOUR = "#ffd3e2"
_EDGE = (8, 10, 14)
_R_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # camera to a frame whose z is up in the image
_SEEN, _HIDDEN = 0.66, 0.30  # how much of the picture the fitted hand covers, where seen and behind something
_HIDDEN_M = 0.02
_LEAST_WEIGHT = 0.02  # a joint trusted less is not drawn
_UNSURE = 0.75  # a side less sure gets a question mark

Window = tuple[int, int, int, int]
"""Left, top, width and height of a part of an image, pixels."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HandLayers:
    """What is drawn over one picture; what is None is left out.

    Attributes:
        box: of the detector. joints: with their mask. fitted: the hand model.
        mesh, X_CO: the object, whose lines are drawn. name: said beside them; nothing when empty.
    """

    box: HandBox | None = None
    joints: SeenJoints | None = None
    fitted: FittedHand | None = None
    mesh: Mesh | None = None
    X_CO: np.ndarray | None = None
    name: str = ""


def render_hand_overlay(
    image: np.ndarray,
    layers: HandLayers,
    intrinsics: Intrinsics,
    *,
    depth: np.ndarray | None = None,
    window: Window | None = None,
    scale: int = 2,
    labels: bool = True,
) -> np.ndarray:
    """A picture with what was seen of the hand over it.

    Args:
        image: (h, w, 3) uint8 colour, or (h, w) depth in metres, which is shown as relief.
        layers: what to draw; box and joints are in pixels and metres of the whole image's camera.
        intrinsics: of the whole image.
        depth: (h, w) measured depth in metres, 0 = nothing; makes faint what lies behind it. A depth `image` serves.
        window: the part to show; all when None.
        scale: pixels of the result per pixel of the image, each way.
        labels: names beside the box and the object.
    Returns:
        (height * scale, width * scale, 3) uint8, of the window's size.
    Raises:
        ShapeError: an image or a mask is not of the camera's size.
    """
    if image.ndim == 2 and depth is None:
        depth = image
    mask = None if layers.joints is None else layers.joints.mask
    for name, array in (("image", image), ("depth", depth), ("mask", mask)):
        if array is not None and array.shape[:2] != (intrinsics.height, intrinsics.width):
            size = (intrinsics.height, intrinsics.width)
            raise ShapeError(f"{name} has shape {array.shape}; the camera's images are {size} (height, width).")
    picture = render_relief(image, intrinsics) if image.ndim == 2 else image[..., :3]
    left, top, width, height = window or (0, 0, intrinsics.width, intrinsics.height)
    rows, columns = slice(top, top + height), slice(left, left + width)
    k = Intrinsics(intrinsics.fx, intrinsics.fy, intrinsics.cx - left, intrinsics.cy - top, width, height)
    measured = None if depth is None else depth[rows, columns]
    models = []
    if layers.mesh is not None and layers.X_CO is not None:
        models.append(DrawnModel(mesh=layers.mesh, X_CO=layers.X_CO, colour=OBJECT_LINES))
    drawn = render_pose_overlay(picture[rows, columns], models, k, depth=measured, scale=scale)
    canvas = drawn.astype(np.float32) / 255.0
    if mask is not None:
        _draw_mask(canvas, mask[rows, columns], scale)
    if layers.fitted is not None:
        _draw_hand(canvas, layers.fitted, k.scaled(scale), measured, scale)
    out = np.round(np.clip(canvas, 0, 1) * 255).astype(np.uint8)
    return _draw_lines(out, layers, k, (left, top), scale, labels)


def focus_window(
    layers: Sequence[HandLayers], intrinsics: Intrinsics, *, aspect: float = 4 / 3, margin: float = 0.18
) -> Window:
    """The part of the image that holds the hands and the object of some frames; all of it when there are none.

    Args:
        aspect: width over height. margin: free border, as a share of the part's longer side.
    """
    spots = [p for layer in layers for p in _pixels(layer, intrinsics)]
    points = np.concatenate(spots) if spots else np.zeros((0, 2))
    points = points[np.isfinite(points).all(axis=1)]
    whole = np.array([intrinsics.width, intrinsics.height], float)
    if not len(points):
        return 0, 0, intrinsics.width, intrinsics.height
    low, high = np.clip(points.min(axis=0), 0, whole), np.clip(points.max(axis=0), 0, whole)
    middle, side = 0.5 * (low + high), (high - low).max() * margin + (high - low)
    width = min(max(side[0], side[1] * aspect), whole[0], whole[1] * aspect)
    size = np.array([width, width / aspect])
    corner = np.clip(middle - 0.5 * size, 0, whole - size)
    left, top = (int(v) for v in np.floor(corner))
    return left, top, min(round(size[0]), intrinsics.width - left), min(round(size[1]), intrinsics.height - top)


def hand_meshes(fitted: FittedHand, *, segments: int = 24) -> list[Mesh]:
    """The parts of a fitted hand as meshes in the camera frame."""
    return [part.transformed(fitted.X_CH) for part in hand_part_meshes(fitted.hand, fitted.q, segments=segments)]


def _pixels(layer: HandLayers, k: Intrinsics) -> list[np.ndarray]:
    """Places (M, 2) in the image that the layers of a frame reach."""
    found = []
    if layer.box is not None:
        found.append(np.array([[layer.box.u_min, layer.box.v_min], [layer.box.u_max, layer.box.v_max]]))
    if layer.joints is not None:
        found.append(project(layer.joints.points_C, k))
    if layer.fitted is not None:
        found.append(project(layer.fitted.joints_C, k))
    if layer.mesh is not None and layer.X_CO is not None:
        found.append(project(layer.mesh.vertices @ layer.X_CO[:3, :3].T + layer.X_CO[:3, 3], k))
    return found


def _rgb(colour: str) -> np.ndarray:
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)], np.float32)


def _blend(canvas: np.ndarray, colour: np.ndarray, alpha: np.ndarray) -> None:
    canvas += alpha[..., None].astype(np.float32) * (colour.astype(np.float32) - canvas)


def _enlarged(array: np.ndarray, scale: int) -> np.ndarray:
    return np.repeat(np.repeat(array, scale, axis=0), scale, axis=1)


def _draw_mask(canvas: np.ndarray, mask: np.ndarray, scale: int) -> None:
    """A tint with a soft rim, in place."""
    soft = ndimage.gaussian_filter(_enlarged(mask, scale).astype(np.float32), 0.6 * scale)
    rim = np.clip(1.0 - np.abs(soft - 0.5) / 0.3, 0.0, 1.0)
    _blend(canvas, _rgb(MASK_COLOUR) / 255, 0.30 * soft)
    _blend(canvas, _rgb(MASK_COLOUR) / 255, 0.55 * rim)


def _draw_hand(
    canvas: np.ndarray, fitted: FittedHand, fine: Intrinsics, measured: np.ndarray | None, scale: int
) -> None:
    """The fitted hand, shaded and half transparent, with its outline, in place."""
    meshes = hand_meshes(fitted)
    lines = model_lines(merge_meshes(meshes), np.eye(4), fine)
    if not lines.depth.size or not np.isfinite(lines.depth).any():
        return
    rows, columns = lines.window
    height, width = lines.depth.shape
    part = Intrinsics(fine.fx, fine.fy, fine.cx - columns.start, fine.cy - rows.start, width, height)
    X_up = np.eye(4)
    X_up[:3, :3] = _R_UP
    colour = mix(linear_rgb(hand_colour("human")), np.ones(3), 0.30)
    surfaces = [Surface(mesh=mesh.transformed(X_up), colour=colour, gloss=0.25) for mesh in meshes]
    shaded = shade(surfaces, X_up, part, style=Style(ground=False)).astype(np.float32) / 255.0
    strength = np.full((height, width), _SEEN, np.float32)
    if measured is not None:
        front = _enlarged(measured, scale)[rows, columns]
        hidden = (front > 0) & np.isfinite(lines.depth) & (lines.depth > front + _HIDDEN_M)
        strength = ndimage.gaussian_filter(np.where(hidden, _HIDDEN, _SEEN).astype(np.float32), 0.6 * scale)
    view = canvas[rows, columns]
    view += (strength * shaded[..., 3])[..., None] * (shaded[..., :3] - view)
    distance = np.asarray(ndimage.distance_transform_edt(~lines.contour), np.float32)
    for tone, width_px, amount in ((np.array(_EDGE), 1.1, 0.55), (_rgb(_FITTED_COLOUR), 0.55, 0.95)):
        stroke = ndimage.gaussian_filter((distance <= width_px * min(scale, 2)).astype(np.float32), 0.6)
        _blend(view, tone / 255.0, amount * stroke * (strength / _SEEN))


def _draw_lines(
    picture: np.ndarray, layers: HandLayers, k: Intrinsics, corner: tuple[int, int], scale: int, labels: bool
) -> np.ndarray:
    """Skeleton, box and labels over the finished picture."""
    twice = 2
    height, width = picture.shape[:2]
    sheet = Image.new("RGBA", (width * twice, height * twice), (0, 0, 0, 0))
    draw, unit = ImageDraw.Draw(sheet), max(width / 420, 1.2) * twice

    def at(uv: np.ndarray) -> np.ndarray:
        return (np.asarray(uv) + 0.5) * scale * twice

    if layers.joints is not None:
        _draw_skeleton(draw, at(project(layers.joints.points_C, k)), layers.joints.weight, unit)
    if layers.box is not None:
        b = layers.box
        ends = np.array([[b.u_min, b.v_min], [b.u_max, b.v_max]]) - corner
        _draw_box(draw, at(ends), unit)
    layer = np.asarray(sheet.resize((width, height), Image.Resampling.BOX), np.float32) / 255.0
    # averaged colours of clear pixels would darken the rims: weigh by what covers
    colour = np.asarray(_premultiplied(sheet).resize((width, height), Image.Resampling.BOX), np.float32) / 255.0
    mixed = picture / 255.0 * (1 - layer[..., 3:]) + colour[..., :3]
    out = np.round(np.clip(mixed, 0, 1) * 255).astype(np.uint8)
    found = _labels(layers, k, corner, scale, (height, width)) if labels else []
    return draw_labels(out, found, size=max(height // 32, 13)) if found else out


def _premultiplied(sheet: Image.Image) -> Image.Image:
    values = np.asarray(sheet).astype(np.uint16)
    values[..., :3] = values[..., :3] * values[..., 3:] // 255
    return Image.fromarray(values.astype(np.uint8))


def _draw_skeleton(draw: ImageDraw.ImageDraw, uv: np.ndarray, weight: np.ndarray, unit: float) -> None:
    """Bones and joints (21, 2), each as clear as it is trusted (21,)."""
    alpha = np.where(weight >= _LEAST_WEIGHT, 60 + 195 * np.sqrt(np.clip(weight, 0, 1)), 0.0)
    alpha = np.where(np.isfinite(uv).all(axis=1), alpha, 0.0).astype(int)
    for edging in (True, False):
        for a, b in BONES:
            shown = int(min(alpha[a], alpha[b]))
            if shown:
                colour = _EDGE if edging else tuple(_rgb(_joint_colour(b)).astype(int))
                ends = [tuple(uv[a]), tuple(uv[b])]
                strength, width = (shown * 2 // 3, 4) if edging else (shown, 2)
                draw.line(ends, fill=(*colour, strength), width=round(unit * width))
    for k in range(NUM_JOINTS):
        if not alpha[k]:
            continue
        radius = unit * (3.1 if k == 0 or k in TIPS else 2.5)
        colour = tuple(_rgb(_joint_colour(k)).astype(int))
        for r, tone in ((radius + 0.8 * unit, _EDGE), (radius, colour)):
            draw.ellipse([*(uv[k] - r), *(uv[k] + r)], fill=(*tone, int(alpha[k])))


def _joint_colour(joint: int) -> str:
    return WRIST_COLOUR if joint == 0 else FINGER_COLOURS[(joint - 1) // 4]


def _draw_box(draw: ImageDraw.ImageDraw, ends: np.ndarray, unit: float) -> None:
    """A thin frame with strong corners."""
    (left, top), (right, bottom) = ends.tolist()
    colour = tuple(_rgb(BOX_COLOUR).astype(int))
    draw.rectangle([left, top, right, bottom], outline=(*colour, 120), width=max(round(unit), 1))
    arm = 0.2 * min(right - left, bottom - top)
    for tone, width in ((_EDGE, 4.6), (colour, 2.8)):
        for x, along in ((left, 1), (right, -1)):
            for y, down in ((top, 1), (bottom, -1)):
                bend = [(x + along * arm, y), (x, y), (x, y + down * arm)]
                draw.line(bend, fill=(*tone, 255), width=round(unit * width))


def _labels(
    layers: HandLayers, k: Intrinsics, corner: tuple[int, int], scale: int, shape: tuple[int, int]
) -> list[Label]:
    found = []
    if layers.box is not None:
        b = layers.box
        ends = (np.array([[b.u_min, b.v_min], [b.u_max, b.v_max]]) - corner + 0.5) * scale
        side = f"{b.side} hand" if b.side_score >= _UNSURE else f"hand, {b.side}?"
        text = f"{side}, box {100 * b.score:.0f} %"
        found.append(Label(text=text, colour=BOX_COLOUR, target=_area(ends, shape)))
    elif layers.fitted is not None:
        uv = project(layers.fitted.joints_C, k)
        uv = (uv[np.isfinite(uv).all(axis=1)] + 0.5) * scale
        if len(uv):
            area = _area(np.array([uv.min(axis=0), uv.max(axis=0)]), shape)
            found.append(Label(text=f"fitted {layers.fitted.side} hand", colour=_FITTED_COLOUR, target=area))
    if layers.name and layers.mesh is not None and layers.X_CO is not None:
        uv = project(layers.mesh.vertices @ layers.X_CO[:3, :3].T + layers.X_CO[:3, 3], k)
        uv = uv[np.isfinite(uv).all(axis=1)]
        if len(uv):
            ends = (np.array([uv.min(axis=0), uv.max(axis=0)]) + 0.5) * scale
            found.append(Label(text=layers.name, colour=OBJECT_LINES, target=_area(ends, shape)))
    return [label for label in found if label.target.any()]


def _area(ends: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """(h, w) bool pixels between two corners (2, 2) of u and v."""
    (left, top), (right, bottom) = np.clip(ends, 0, [shape[1], shape[0]]).astype(int).tolist()
    area = np.zeros(shape, bool)
    area[top:bottom, left:right] = True
    return area
