"""The hand over the frames of a demonstration as an inline SVG: distance to the object, movement, residual."""

from __future__ import annotations

from html import escape

import numpy as np

from neuralgrasps.report.demonstration_content import TrackFigure

_WIDTH, _LEFT, _RIGHT, _TOP, _LANE, _GAP, _BOTTOM = 1080, 172, 16, 26, 62, 16, 34
_CLIP = 95.0  # percentile of a lane's values at which its scale ends: a wild frame must not flatten the others


def track_svg(track: TrackFigure) -> str:
    """Three lanes over the frames with the moment of the grasp marked; lanes without a number are left out."""
    lanes = [
        (name, np.asarray(values, float))
        for name, values in (
            ("to the object, mm", track.gap_mm),
            ("moved per frame, mm", track.moved_mm),
            ("fit residual, mm", track.residual_mm),
        )
        if np.isfinite(values).any()
    ]
    count = len(track.gap_mm)
    height = _TOP + len(lanes) * (_LANE + _GAP) - _GAP + _BOTTOM
    x = _LEFT + (np.arange(count) + 0.5) * (_WIDTH - _LEFT - _RIGHT) / max(count, 1)
    parts = [_span(track, x, height)]
    for index, (name, values) in enumerate(lanes):
        parts.append(_lane(name, values, x, _TOP + index * (_LANE + _GAP)))
    parts += [_axis(count, x, height), _marker(track, x, height)]
    label = f"The hand in {count} frames" + (f"; the grasp is in frame {track.moment}" if track.moment >= 0 else "")
    return (
        f'<svg class="chart track" viewBox="0 0 {_WIDTH} {height}" role="img" aria-label="{escape(label)}">'
        f"{''.join(parts)}</svg>"
    )


def _lane(name: str, values: np.ndarray, x: np.ndarray, top: float) -> str:
    found = np.isfinite(values)
    largest = max(float(np.percentile(values[found], _CLIP)) * 1.08, 1e-6)
    y = top + _LANE * (1 - np.clip(np.nan_to_num(values) / largest, 0, 1))
    bottom = top + _LANE
    # runs of frames in which the hand was found
    edges = np.flatnonzero(np.diff(np.concatenate([[False], found, [False]]).astype(int)))
    lines = []
    for first, end in edges.reshape(-1, 2):
        spots = " ".join(f"{x[i]:.1f},{y[i]:.1f}" for i in range(first, end))
        if end - first == 1:
            lines.append(f'<circle class="dot1" cx="{x[first]:.1f}" cy="{y[first]:.1f}" r="2.4"/>')
            continue
        area = f"{x[first]:.1f},{bottom:.1f} {spots} {x[end - 1]:.1f},{bottom:.1f}"
        lines.append(f'<polygon class="area" points="{area}"/><polyline class="line" points="{spots}"/>')
    words = (
        f'<text class="name" x="{_LEFT - 14}" y="{top + _LANE / 2 + 4:.0f}" text-anchor="end">{escape(name)}</text>'
        f'<text class="tick" x="{_LEFT + 4}" y="{top + 9:.0f}">{largest / 1.08:.3g}</text>'
    )
    base = f'<line class="grid" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{bottom}" y2="{bottom}"/>'
    return base + "".join(lines) + words


def _axis(count: int, x: np.ndarray, height: int) -> str:
    step = next(s for s in (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 10**6) if count / s <= 12)
    ticks = "".join(
        f'<text class="tick" x="{x[i]:.1f}" y="{height - _BOTTOM + 16}" text-anchor="middle">{i}</text>'
        for i in range(0, count, step)
    )
    return ticks + f'<text class="tick" x="{_LEFT - 14}" y="{height - _BOTTOM + 16}" text-anchor="end">frame</text>'


def _span(track: TrackFigure, x: np.ndarray, height: int) -> str:
    """A band behind the frames that were fused for the grasp."""
    if track.span is None or not len(x):
        return ""
    half = 0.5 * (x[1] - x[0]) if len(x) > 1 else 10.0
    left, right = x[track.span[0]] - half, x[track.span[1]] + half
    return (
        f'<rect class="band" x="{left:.1f}" y="{_TOP}" width="{right - left:.1f}" height="{height - _TOP - _BOTTOM}"/>'
    )


def _marker(track: TrackFigure, x: np.ndarray, height: int) -> str:
    if not 0 <= track.moment < len(x):
        return ""
    at, name = x[track.moment], escape(track.named or str(track.moment))
    anchor = "end" if at > 0.85 * _WIDTH else "start" if at < 0.25 * _WIDTH else "middle"
    return (
        f'<line class="moment" x1="{at:.1f}" x2="{at:.1f}" y1="{_TOP - 6}" y2="{height - _BOTTOM}"/>'
        f'<text class="name" x="{at:.1f}" y="{_TOP - 11}" text-anchor="{anchor}">grasp, frame {name}</text>'
    )
