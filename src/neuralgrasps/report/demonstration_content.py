"""What the page of a human demonstration holds: plain records of pictures, numbers and texts, see `content`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

Verdict = Literal["ok", "doubtful", "failed", "not reached"]
Picture = tuple[str, np.ndarray]
"""Caption and (h, w, 3) or (h, w, 4) uint8 picture."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StageFigure:
    """One stage on the way from the video to the lifted object.

    Attributes:
        name: such as "hand"; text: what it came to, in a few words; verdict: how it went.
        reason: why it failed, in words; "" otherwise.
    """

    name: str
    text: str = ""
    verdict: Verdict = "ok"
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackFigure:
    """The hand over the frames of a video, (T,) each, nan where it was not found.

    Attributes:
        gap_mm: from the hand's surface to the object's; nan everywhere when the object was not found.
        moved_mm: how far the hand moved since the frame before. residual_mm: of the fit to the measured points.
        moment: frame of the grasp, or -1. span: first and last frame that were fused for it, or None.
        named: the moment's frame by its name; its number when "".
    """

    gap_mm: np.ndarray
    moved_mm: np.ndarray
    residual_mm: np.ndarray
    moment: int = -1
    span: tuple[int, int] | None = None
    named: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class DemonstrationFigure:
    """What was seen of a human demonstration, and how far it was carried; what is empty is left out of the page.

    Attributes:
        stages: in their order.
        frames: a strip from the hand's entry to the grasp. animation: the same moving, a WebP, or b"".
        track: the hand over the frames.
        close_ups: the moment of the grasp, layer by layer.
        views: fitted hand and object with its contact map, from several sides. facts: of the fitted hand.
    """

    stages: tuple[StageFigure, ...]
    frames: tuple[Picture, ...] = ()
    animation: bytes = b""
    track: TrackFigure | None = None
    close_ups: tuple[Picture, ...] = ()
    views: tuple[Picture, ...] = ()
    facts: tuple[tuple[str, str], ...] = ()
