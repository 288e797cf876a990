"""Labels on pictures: text on dark plates, placed beside what they name and clear of each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from PIL import Image, ImageDraw, ImageFont

_FINE = 3  # drawn this much larger, then averaged: smooth corners and letters
_PLATE, _INK = (14, 17, 22, 226), (255, 255, 255, 255)
_OWN_COVER, _OTHER_COVER = 3.0, 9.0  # label heights of distance that covering a model weighs as much as


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """A text to be placed.

    Attributes:
        text: what it says; colour: "#rrggbb" of the mark before it.
        target: (h, w) bool pixels of what it names, in the picture.
    """

    text: str
    colour: str
    target: np.ndarray


def draw_labels(picture: np.ndarray, labels: Sequence[Label], *, size: int) -> np.ndarray:
    """The picture (h, w, 3) uint8 with labels, letters `size` pixels high; a thin line leads to targets farther off."""
    plates = [_plate(label.text, label.colour, size) for label in labels]
    spots = place_labels([(p.height, p.width) for p in plates], [label.target for label in labels])
    canvas = Image.fromarray(picture)
    draw = ImageDraw.Draw(canvas)
    for label, plate, spot in zip(labels, plates, spots, strict=True):
        ends = _leader(spot, (plate.height, plate.width), label.target)
        if ends is not None:
            draw.line(ends, fill=(14, 17, 22), width=max(size // 5, 3))
            draw.line(ends, fill=label.colour, width=max(size // 12, 1))
    for plate, (row, column) in zip(plates, spots, strict=True):
        canvas.paste(plate, (column, row), plate)
    return np.asarray(canvas)


def place_labels(sizes: Sequence[tuple[int, int]], targets: Sequence[np.ndarray]) -> list[tuple[int, int]]:
    """Where to put labels: near their targets, off all targets where there is room, never over each other.

    Args:
        sizes: (height, width) of each label.
        targets: (h, w) bool pixels that each names, all of the picture's size.
    Returns:
        (row, column) of each label's top left corner, inside the picture where it fits; a label that finds no free
        place covers another one least.
    """
    spots: list[tuple[int, int]] = []
    for index, (height, width) in enumerate(sizes):
        shape = targets[index].shape
        step = max(height // 4, 1)
        rows = np.arange(0, max(shape[0] - height, 0) + 1, step)
        columns = np.arange(0, max(shape[1] - width, 0) + 1, step)
        cost = _distance(rows, columns, (height, width), targets[index]) / height
        for other, target in enumerate(targets):
            weight = _OWN_COVER if other == index else _OTHER_COVER
            cost += weight * _covered(target, rows, columns, (height, width))
        for (row, column), (taken_height, taken_width) in zip(spots, sizes, strict=False):
            gap = max(height // 6, 1)
            down = np.minimum(rows + height + gap, row + taken_height + gap) - np.maximum(rows, row - gap)
            across = np.minimum(columns + width + gap, column + taken_width + gap) - np.maximum(columns, column - gap)
            cost += 1e3 * np.maximum(down, 0)[:, None] * np.maximum(across, 0)[None]
        best = np.unravel_index(int(np.argmin(cost)), cost.shape)
        spots.append((int(rows[best[0]]), int(columns[best[1]])))
    return spots


def _distance(rows: np.ndarray, columns: np.ndarray, size: tuple[int, int], target: np.ndarray) -> np.ndarray:
    """(R, C) pixels between a label at each place and the box around its target; above is a little nearer."""
    if not target.any():
        return np.zeros((len(rows), len(columns)))
    used_rows, used_columns = np.flatnonzero(target.any(axis=1)), np.flatnonzero(target.any(axis=0))
    top, bottom, left, right = used_rows[0], used_rows[-1], used_columns[0], used_columns[-1]
    down = np.maximum(np.maximum(top - rows - size[0], rows - bottom), 0)
    across = np.maximum(np.maximum(left - columns - size[1], columns - right), 0)
    off_centre = np.abs(columns + 0.5 * size[1] - 0.5 * (left + right)) / max(target.shape[1], 1)
    below = 0.5 * size[0] * (rows + 0.5 * size[0] > 0.5 * (top + bottom))
    return np.hypot(down[:, None], across[None]) + size[0] * off_centre[None] + below[:, None]


def _covered(target: np.ndarray, rows: np.ndarray, columns: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(R, C) share of a label at each place that lies on the target."""
    total = np.zeros((target.shape[0] + 1, target.shape[1] + 1))
    total[1:, 1:] = target.cumsum(axis=0, dtype=np.int64).cumsum(axis=1)
    ends_r, ends_c = (np.minimum(a + s, n) for a, s, n in zip((rows, columns), size, target.shape, strict=True))
    inside = total[ends_r][:, ends_c] - total[rows][:, ends_c] - total[ends_r][:, columns] + total[rows][:, columns]
    return inside / (size[0] * size[1])


def _leader(spot: tuple[int, int], size: tuple[int, int], target: np.ndarray) -> list[tuple[int, int]] | None:
    """Ends of a line from a label to the nearest pixel of its target, when that is over half a label's height away."""
    rows, columns = np.nonzero(target)
    if len(rows) == 0:
        return None
    at_row = np.clip(rows, spot[0], spot[0] + size[0])
    at_column = np.clip(columns, spot[1], spot[1] + size[1])
    gap = np.hypot(rows - at_row, columns - at_column)
    nearest = int(np.argmin(gap))
    if gap[nearest] < 0.5 * size[0]:
        return None
    return [(int(at_column[nearest]), int(at_row[nearest])), (int(columns[nearest]), int(rows[nearest]))]


def _plate(text: str, colour: str, size: int) -> Image.Image:
    """RGBA picture of one label."""
    fine = size * _FINE
    font = label_font(fine)
    left, _, right, _ = font.getbbox(text)
    pad, mark = 0.5 * fine, 0.72 * fine
    width, height = round(right - left + 2 * pad + mark + 0.4 * fine), round(1.62 * fine)
    # whole pixels after the averaging
    width, height = (-(-side // _FINE) * _FINE for side in (width, height))
    plate = Image.new("RGBA", (width, height), (*_PLATE[:3], 0))
    draw = ImageDraw.Draw(plate)
    draw.rounded_rectangle((0, 0, width - 1, height - 1), radius=0.36 * fine, fill=_PLATE)
    middle = 0.5 * height
    draw.ellipse((pad, middle - 0.5 * mark, pad + mark, middle + 0.5 * mark), fill=colour)
    draw.text((pad + mark + 0.4 * fine - left, middle), text, font=font, fill=_INK, anchor="lm")
    return plate.resize((width // _FINE, height // _FINE), Image.Resampling.BOX)


@cache
def label_font(size: int) -> ImageFont.FreeTypeFont:
    """The letters of all pictures, `size` pixels high."""
    font = ImageFont.load_default(size=size)
    assert isinstance(font, ImageFont.FreeTypeFont)
    return font
