"""Charts as inline SVG that follow the page's light or dark scheme: colours of text and lines are CSS variables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from neuralgrasps.report.palette import HAND_COLOURS, hand_colour

# A shape per hand beside its colour, so that the scatter also reads in grey.
_SHAPES = {"fetch": "circle", "panda": "square", "barrett": "triangle", "allegro": "diamond", "human": "cross"}


def scatter_svg(
    points: np.ndarray,
    hands: Sequence[str],
    notes: Sequence[str] = (),
    *,
    label: str = "",
    unseen: Sequence[int] = (),
    letters: Mapping[int, str] | None = None,
    size: float = 1.0,
) -> str:
    """Scatter of (N, 2) points coloured and shaped by hand; no axes, since t-SNE's have no meaning.

    Args:
        points: (N, 2) finite numbers; hands: N names; notes: N hover texts, or none.
        label: what the picture is, read by screen readers.
        unseen: points drawn as outlines. letters: point -> the letter beside it. size: of the marks.
    """
    width, height, border = 640, 460, 22
    points = np.asarray(points, np.float64).reshape(-1, 2)
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(2), np.ones(2))
    scale = np.array([width - 2 * border, height - 2 * border]) / np.maximum(high - low, 1e-9)
    scale = np.minimum(scale, 1.6 * scale.min())  # neither axis means anything: fill the frame, within reason
    at = (points - 0.5 * (low + high)) * scale * [1, -1] + [width / 2, height / 2]
    outlined, named = set(unseen), letters or {}
    marks, tags = [], []
    for index, ((x, y), hand) in enumerate(zip(at, hands, strict=True)):
        note = notes[index] if index < len(notes) else ""
        text = f"{hand}: {note}" if note else hand
        css = "mark unseen" if index in outlined else "mark"
        letter = named.get(index)
        data = f' data-letter="{escape(letter)}"' if letter else ""
        marks.append(
            f'<g class="{css}" data-hand="{escape(hand)}" data-at="{x:.1f} {y:.1f}"{data} '
            f'style="--c:{hand_colour(hand)}">'
            f"{_mark(_shape(hand), x, y, size)}<title>{escape(text)}</title></g>"
        )
        if letter:
            tags.append(
                f'<g class="letter" data-hand="{escape(hand)}" aria-hidden="true">'
                f'<circle cx="{x:.1f}" cy="{y:.1f}" r="8.5"/>'
                f'<text x="{x + 9:.1f}" y="{y - 7:.1f}">{escape(letter)}</text></g>'
            )
    return _svg(width, height, "".join(marks + tags), label or "scatter of latent codes coloured by hand")


def legend_html(hands: Sequence[str], *, toggles: bool = False) -> str:
    """The hands with their colour and shape, in a fixed order; as buttons that show and hide them if `toggles`."""
    known = [name for name in HAND_COLOURS if name in hands]
    items = known + sorted(set(hands) - set(known))
    parts = []
    for hand in items:
        mark = f'<g class="mark" style="--c:{hand_colour(hand)}">{_mark(_shape(hand), 7, 7)}</g>'
        content = f'<svg viewBox="0 0 14 14" aria-hidden="true">{mark}</svg>{escape(hand)}'
        if toggles:
            button = f'<button type="button" aria-pressed="true" data-hand="{escape(hand)}">{content}</button>'
            parts.append(button)
        else:
            parts.append(f"<span>{content}</span>")
    return f'<div class="legend{" toggles" if toggles else ""}">{"".join(parts)}</div>'


def histogram_svg(values: Mapping[str, np.ndarray], unit: str, *, limit: float | None = None, label: str = "") -> str:
    """Stacked histogram of named groups on one axis; `limit` draws a dashed line."""
    width, height, left, right, top, bottom = 640, 260, 40, 16, 16, 44
    finite = {name: np.asarray(v, np.float64)[np.isfinite(v)] for name, v in values.items()}
    everything = np.concatenate([*finite.values(), np.zeros(0)])
    if len(everything) == 0:
        return ""
    low, high = min(float(everything.min()), 0.0), float(everything.max())
    high = max(high, limit * 1.05 if limit is not None else high, low + 1e-9)
    ticks = nice_ticks(low, high, 6)
    low, high = ticks[0], ticks[-1]
    edges = np.linspace(low, high, 31)
    counts = {name: np.histogram(v, edges)[0] for name, v in finite.items()}
    tallest = max(int(np.sum(list(counts.values()), axis=0).max()), 1)
    x_of = lambda v: left + (v - low) / (high - low) * (width - left - right)  # noqa: E731
    y_of = lambda n: height - bottom - n / tallest * (height - top - bottom)  # noqa: E731
    parts = [_grid_line(left, width - right, y_of(n), str(n)) for n in _count_ticks(tallest)]
    base = np.zeros(30)
    for name, count in counts.items():
        for i in np.flatnonzero(count):
            x, y, end = x_of(edges[i]), y_of(base[i] + count[i]), y_of(base[i])
            bar_width = x_of(edges[i + 1]) - x - 1.6
            parts.append(
                f'<rect x="{x + 0.8:.1f}" y="{y:.1f}" width="{bar_width:.1f}" height="{end - y:.1f}" '
                f'rx="1" fill="{hand_colour(name)}"><title>{escape(name)}: {count[i]}</title></rect>'
            )
        base += count
    parts += [
        f'<text class="tick" x="{x_of(t):.1f}" y="{height - bottom + 17}" text-anchor="middle">{t:g}</text>'
        for t in ticks
    ]
    middle = (left + width - right) / 2
    parts.append(f'<text class="axis" x="{middle:.0f}" y="{height - 6}" text-anchor="middle">{escape(unit)}</text>')
    if limit is not None:
        x = x_of(limit)
        parts.append(f'<line class="limit" x1="{x:.1f}" x2="{x:.1f}" y1="{top - 4}" y2="{height - bottom}"/>')
        parts.append(
            f'<text class="tick" x="{x - 5:.1f}" y="{top + 6}" text-anchor="end">accepted up to {limit:g}</text>'
        )
    return _svg(width, height, "".join(parts), label or f"histogram, {unit}")


def bars_svg(names: Sequence[str], values: Sequence[float], unit: str, *, label: str = "") -> str:
    """Horizontal bars with their names before and their values behind."""
    row, width, name_width, value_width = 27, 560, 132, 74
    height = row * len(names) + 6
    biggest = max([v for v in values if math.isfinite(v)] or [1.0]) or 1.0
    parts = []
    for i, (name, value) in enumerate(zip(names, values, strict=True)):
        y = 4 + i * row
        length = max(value / biggest * (width - name_width - value_width), 2.0)
        parts.append(f'<text class="name" x="{name_width - 12}" y="{y + 15}" text-anchor="end">{escape(name)}</text>')
        parts.append(
            f'<rect class="bar" x="{name_width}" y="{y + 3}" width="{length:.1f}" height="{row - 11}" rx="3"/>'
        )
        number = escape(f"{short_number(value)} {unit}")
        parts.append(f'<text class="value" x="{name_width + length + 8:.1f}" y="{y + 15}">{number}</text>')
    return _svg(width, height, "".join(parts), label or f"bars, {unit}")


def short_number(value: float) -> str:
    """Three significant digits without an exponent for everyday sizes: 0.0123, 1.23, 12.3, 1,230."""
    if not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    size = abs(value)
    if size >= 1000:
        return f"{value:,.0f}"
    if size < 1e-4:
        return f"{value:.2g}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(size)))}f}"


def nice_ticks(low: float, high: float, count: int) -> list[float]:
    """Round numbers that enclose [low, high], about `count` steps apart by 1, 2, 2.5 or 5 times a power of ten."""
    raw = (high - low) / count
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(s * power for s in (1, 2, 2.5, 5, 10) if s * power >= raw * (1 - 1e-9))
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [round(i * step, 12) for i in range(first, max(last, first + 1) + 1)]


def _count_ticks(tallest: int) -> list[int]:
    step = max(1, round(tallest / 4))
    return list(range(0, tallest + 1, step))


def _grid_line(x1: float, x2: float, y: float, text: str) -> str:
    return (
        f'<line class="grid" x1="{x1}" x2="{x2}" y1="{y:.1f}" y2="{y:.1f}"/>'
        f'<text class="tick" x="{x1 - 7}" y="{y + 4:.1f}" text-anchor="end">{text}</text>'
    )


def _shape(hand: str) -> str:
    return _SHAPES.get(hand, "circle")


def _mark(shape: str, x: float, y: float, size: float = 1.0) -> str:
    if shape == "circle":
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{4.6 * size:.1f}"/>'
    arm, tip = 1.8, 5.4
    outlines = {
        "square": [(-4.1, -4.1), (4.1, -4.1), (4.1, 4.1), (-4.1, 4.1)],
        "triangle": [(0, -5.6), (5.2, 3.8), (-5.2, 3.8)],
        "diamond": [(0, -5.8), (5.8, 0), (0, 5.8), (-5.8, 0)],
        "cross": [
            *[(-arm, -tip), (arm, -tip), (arm, -arm), (tip, -arm), (tip, arm), (arm, arm)],
            *[(arm, tip), (-arm, tip), (-arm, arm), (-tip, arm), (-tip, -arm), (-arm, -arm)],
        ],
    }
    corners = " ".join(f"{x + size * dx:.1f},{y + size * dy:.1f}" for dx, dy in outlines[shape])
    return f'<polygon points="{corners}"/>'


def _svg(width: float, height: float, body: str, label: str) -> str:
    return f'<svg class="chart" viewBox="0 0 {width} {height}" role="img" aria-label="{escape(label)}">{body}</svg>'
