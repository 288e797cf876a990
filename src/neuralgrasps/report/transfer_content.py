"""What the page of a transfer holds: a query, and the grasps of another hand in their order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class TransferredGrasp:
    """One grasp of the target hand.

    Attributes:
        image, contacts: the grasp and its contact map, from the same side.
        similarity: of its contact map to the query's, 0..1. origin: "retrieved" or "generated".
        success: held in the physics trial; None when it was not run. displacement_mm: of the object, in the trial.
        epsilon: largest disturbance resisted. clearance_mm: from what is kept free; None when nothing is.
        touched: "1 of 2" drawn points, "" where none were; points_off_mm: mean distance from the hand to them.
        reason: why it stands where it stands. number: its place in the whole list, from 1; None: that of the card.
    """

    image: np.ndarray
    contacts: np.ndarray
    similarity: float
    origin: str
    success: bool | None = None
    displacement_mm: float | None = None
    epsilon: float | None = None
    clearance_mm: float | None = None
    touched: str = ""
    points_off_mm: float | None = None
    reason: str = ""
    number: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TransferList:
    """A query and the grasps of one hand for it, best first; `title` names the query, `text` says what it is."""

    object: str
    hand: str
    title: str
    image: np.ndarray
    contacts: np.ndarray
    grasps: tuple[TransferredGrasp, ...]
    query_hand: str = ""
    text: str = ""
