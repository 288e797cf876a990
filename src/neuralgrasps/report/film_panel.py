"""What stands beside the picture in a film: the view close to the hand, what the camera saw, and words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from neuralgrasps.report.labels import label_font

PANEL_WIDTH = 208
_PAPER, _INK, _GREY, _RULE = "#f3f2ee", "#22262c", "#767c85", "#d5d2ca"
_ACCENT, GOOD, BAD = "#397ece", "#2f8f5b", "#c0392b"
_FINE = 2  # words are drawn this much larger, then averaged


@dataclass(frozen=True, slots=True, kw_only=True)
class Words:
    """What a frame says.

    Attributes:
        title: what is picked up; lines: two or three short ones under it.
        steps: names of the steps of a pick; step: the one that is shown, or "".
        clock: time and speed. verdict: "" until it is known; good: its colour.
    """

    title: str
    lines: tuple[str, ...] = ()
    steps: tuple[str, ...] = ()
    step: str = ""
    clock: str = ""
    verdict: str = ""
    good: bool = True


def beside(picture: np.ndarray, close: np.ndarray, seen: np.ndarray | None, words: np.ndarray) -> np.ndarray:
    """One frame: the picture (h, w, 3), and to its right a column of the close view, what was seen, and words."""
    height = picture.shape[0]
    column = np.empty((height, PANEL_WIDTH, 3), np.uint8)
    column[:] = _rgb(_PAPER)
    row = 0
    for part in (close, seen, words):
        if part is not None:
            end = min(row + len(part), height)
            column[row:end] = part[: end - row]
            column[end - 2 : end] = _rgb(_PAPER)
            row = end
    column[:, :2] = _rgb(_PAPER)
    return np.concatenate([picture, column], axis=1)


def words_picture(words: Words, size: tuple[int, int]) -> np.ndarray:
    """The words on paper, (height, width, 3) uint8 for a size (width, height)."""
    width, height = size[0] * _FINE, size[1] * _FINE
    sheet = Image.new("RGB", (width, height), _PAPER)
    draw = ImageDraw.Draw(sheet)
    left, row = 12 * _FINE, 8 * _FINE
    room = width - 2 * left
    _put(draw, (left, row), words.title, size=15 * _FINE, width=room, fill=_INK)
    row += 21 * _FINE
    for line in words.lines:
        _put(draw, (left, row), line, size=11 * _FINE, width=room, fill=_GREY)
        row += 15 * _FINE
    bottom = height - 12 * _FINE
    if words.steps:
        _draw_steps(draw, words, left, bottom, room)
        bottom -= 14 * _FINE
    if words.step:
        draw.text((left, bottom), words.step, font=label_font(13 * _FINE), fill=_ACCENT, anchor="ls")
    if words.clock:
        draw.text((width - left, bottom), words.clock, font=label_font(11 * _FINE), fill=_GREY, anchor="rs")
    if words.verdict:
        bottom -= 22 * _FINE
        colour = GOOD if words.good else BAD
        draw.ellipse((left, bottom - 10 * _FINE, left + 10 * _FINE, bottom), fill=colour)
        at, inner = (left + 16 * _FINE, bottom), room - 16 * _FINE
        _put(draw, at, words.verdict, size=14 * _FINE, width=inner, fill=colour, anchor="ls")
    return np.asarray(sheet.resize(size, Image.Resampling.BOX))


def title_card(picture: np.ndarray, words: Words) -> np.ndarray:
    """The whole frame (h, w, 3) pale, with large words over it."""
    pale = np.round(0.22 * picture.astype(np.float32) + 0.78 * _rgb(_PAPER)).astype(np.uint8)
    card = Image.fromarray(pale)
    draw = ImageDraw.Draw(card)
    height, width = picture.shape[:2]
    left, row = round(0.08 * width), round(0.40 * height)
    _put(draw, (left, row), words.title, size=height // 11, width=width - 2 * left, fill=_INK)
    row += height // 8
    for line in words.lines:
        _put(draw, (left, row), line, size=height // 24, width=width - 2 * left, fill="#5a6069")
        row += height // 17
    return np.asarray(card)


def _draw_steps(draw: ImageDraw.ImageDraw, words: Words, left: int, bottom: int, width: int) -> None:
    """A bar of one piece per step; those that are done are filled."""
    gap = 3 * _FINE
    piece = (width - gap * (len(words.steps) - 1)) / len(words.steps)
    at = words.steps.index(words.step) if words.step in words.steps else -1
    for k in range(len(words.steps)):
        x = left + k * (piece + gap)
        colour = _ACCENT if k == at else "#9dbbe0" if k < at else _RULE
        draw.rounded_rectangle((x, bottom - 4 * _FINE, x + piece, bottom), radius=2 * _FINE, fill=colour)


def _put(
    draw: ImageDraw.ImageDraw, at: tuple[int, int], text: str, *, size: int, width: int, fill: str, anchor: str = "la"
) -> None:
    """Write a line no wider than `width`: smaller where it must be, and cut short where that is not enough."""
    least = round(0.72 * size)
    while size > least and label_font(size).getlength(text) > width:
        size -= 1
    font = label_font(size)
    if font.getlength(text) > width:
        while text and font.getlength(text + "...") > width:
            text = text[:-1]
        text = text.rstrip() + "..."
    draw.text(at, text, font=font, fill=fill, anchor=anchor)


def _rgb(colour: str) -> np.ndarray:
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)], np.uint8)


def fit(picture: np.ndarray, width: int) -> np.ndarray:
    """A picture (h, w, 3) scaled to a width, its height even."""
    height = 2 * round(picture.shape[0] * width / picture.shape[1] / 2)
    return np.asarray(Image.fromarray(picture[..., :3]).resize((width, height), Image.Resampling.LANCZOS))


def numbered(index: int, total: int) -> str:
    """ "trial 3 of 10"; "" for a single one."""
    return f"trial {index + 1} of {total}" if total > 1 else ""


def joined(parts: Sequence[str]) -> str:
    """The parts that say something, with a dot between."""
    return "  ·  ".join(part for part in parts if part)
