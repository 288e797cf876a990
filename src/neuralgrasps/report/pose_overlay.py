"""Found poses drawn over the camera's picture: the models' lines, each in its own colour, with names beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image
from scipy import ndimage

from neuralgrasps.errors import ShapeError
from neuralgrasps.geometry.camera import Intrinsics, pixel_rays
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.report.figures import render_depth
from neuralgrasps.report.labels import Label, draw_labels
from neuralgrasps.report.model_lines import ModelLines, model_lines

# Bright hues that stand out from each other and, on their dark edging, from light and dark pictures.
MODEL_COLOURS = (
    "#37d3ff", "#ff7ad9", "#8cf04e", "#ffab3d", "#b9a2ff", "#fff04d", "#2ff0c0", "#ff6f61", "#70b85c", "#ff29ff",
    "#ffc2ff", "#c2ffc2",
)  # fmt: skip
TRUE_COLOUR = "#ffffff"
_EDGING = np.array([8, 10, 14]) / 255.0
_LIGHT = np.array([-0.40, -0.36, -0.84])  # towards the lamp, camera frame: left and above the camera
_HIDDEN_M = 0.015  # a line this far behind what was measured is hidden by it
_HIDDEN_SHARE = 0.34  # of its strength that a hidden line keeps


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnModel:
    """One model in a picture.

    Attributes:
        mesh: the model; X_CO: (4, 4) its pose in the camera frame.
        label: text beside it; none when empty.
        colour: "#rrggbb" of its lines.
        contour_only: leave out the creases and the tint.
    """

    mesh: Mesh
    X_CO: np.ndarray
    label: str = ""
    colour: str = MODEL_COLOURS[0]
    contour_only: bool = False


def model_colour(index: int) -> str:
    """Colour of the `index`-th of several models."""
    return MODEL_COLOURS[index % len(MODEL_COLOURS)]


def render_pose_overlay(
    image: np.ndarray,
    models: Sequence[DrawnModel],
    intrinsics: Intrinsics,
    *,
    depth: np.ndarray | None = None,
    scale: int = 2,
) -> np.ndarray:
    """Lines and labels of posed models over a picture; lines hidden behind what was measured are faint.

    Args:
        image: (h, w, 3) uint8 colour, or (h, w) depth in metres, which is shown as relief.
        models: what to draw; later ones over earlier ones.
        intrinsics: the camera; must be of the image's size.
        depth: (h, w) measured depth in metres that can hide lines, 0 = nothing; a depth `image` serves itself.
        scale: pixels of the result per pixel of the image, each way.
    Returns:
        (h * scale, w * scale, 3) uint8.
    Raises:
        ShapeError: the image or the depth is not of the camera's size.
    """
    size = (intrinsics.height, intrinsics.width)
    if image.ndim == 2:
        depth = image if depth is None else depth
    for name, array in (("image", image), ("depth", depth)):
        if array is not None and array.shape[:2] != size:
            raise ShapeError(f"{name} has shape {array.shape}; the camera's images are {size} (height, width).")
    background = render_relief(image, intrinsics) if image.ndim == 2 else image[..., :3]
    fine = intrinsics.scaled(scale)
    enlarged = Image.fromarray(background).resize((fine.width, fine.height), Image.Resampling.BICUBIC)
    canvas = np.asarray(enlarged, np.float32) / 255.0
    labels = []
    for model in models:
        lines = model_lines(model.mesh, model.X_CO, fine)
        if not lines.depth.size:
            continue
        measured = None if depth is None else np.repeat(np.repeat(depth, scale, 0), scale, 1)[lines.window]
        _draw(canvas[lines.window], model, lines, measured, float(scale))
        if model.label:
            target = np.zeros((fine.height, fine.width), bool)
            target[lines.window] = np.isfinite(lines.depth)
            if target.any():
                labels.append(Label(text=model.label, colour=model.colour, target=target))
    picture = np.round(np.clip(canvas, 0, 1) * 255).astype(np.uint8)
    return draw_labels(picture, labels, size=max(fine.height // 38, 13)) if labels else picture


def _draw(canvas: np.ndarray, model: DrawnModel, lines: ModelLines, measured: np.ndarray | None, scale: float) -> None:
    """Blend one model's lines into its window of the canvas, in place."""
    colour = np.array([int(model.colour[i : i + 2], 16) for i in (1, 3, 5)], np.float32) / 255.0
    shown = np.isfinite(lines.depth)
    seen = shown if measured is None else shown & ~((measured > 0) & (lines.depth > measured + _HIDDEN_M))
    # a line is as strong as the nearest surface that carries it
    strength = np.where(seen, 1.0, _HIDDEN_SHARE)
    index = ndimage.distance_transform_edt(~shown, return_distances=False, return_indices=True)
    strength = ndimage.uniform_filter(strength[tuple(index)], 3)
    thick = _stroke(lines.contour, 0.9 * scale)
    edging = _stroke(lines.contour, 1.55 * scale)
    if not model.contour_only:
        thick = np.maximum(thick, 0.85 * _stroke(lines.crease, 0.6 * scale))
        edging = np.maximum(edging, 0.7 * _stroke(lines.crease, 1.1 * scale))
        _blend(canvas, colour, 0.10 * seen)
    _blend(canvas, _EDGING, 0.62 * edging * strength)
    _blend(canvas, colour, thick * strength)


def _stroke(line: np.ndarray, half_width: float) -> np.ndarray:
    """(h, w) coverage of a line of the given half width, with smooth rims."""
    distance = np.asarray(ndimage.distance_transform_edt(~line), np.float32)
    return ndimage.gaussian_filter((distance <= half_width).astype(np.float32), 0.6)


def _blend(canvas: np.ndarray, colour: np.ndarray, alpha: np.ndarray) -> None:
    canvas += alpha[..., None].astype(np.float32) * (colour.astype(np.float32) - canvas)


def render_relief(depth: np.ndarray, intrinsics: Intrinsics) -> np.ndarray:
    """(h, w, 3) uint8 picture of a depth image in metres: near light, far dark, shaded by the slope of the surface."""
    picture = render_depth(depth).astype(np.float32)
    depth = np.asarray(depth, np.float64)
    valid = np.isfinite(depth) & (depth > 0)
    share = ndimage.gaussian_filter(valid.astype(np.float32), 1.2)
    smooth = ndimage.gaussian_filter(np.where(valid, depth, 0.0), 1.2) / np.maximum(share, 1e-3)
    points = pixel_rays(intrinsics) * smooth[..., None]
    down, right = np.gradient(points, axis=(0, 1))
    normal = np.cross(down, right)  # towards the camera
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    light = np.clip(normal @ _LIGHT, 0.0, 1.0)
    shade = np.where(valid, 0.55 + 0.6 * light, 1.0)
    return np.round(np.clip(picture * shade[..., None], 0, 255)).astype(np.uint8)
