"""Automatic annotation of hands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neuralgrasps.hands.hand import ConvexPart
from neuralgrasps.hands.notes import HandNotes
from neuralgrasps.kinematics.tree import KinematicTree


def complete_notes(
    name: str, tree: KinematicTree, parts: Sequence[ConvexPart], given: HandNotes
) -> tuple[HandNotes, tuple[str, ...]]:
    """`given` with every gap filled, and one sentence per guess."""
    return given, ()


def moved_links(tree: KinematicTree) -> np.ndarray:
    """(L, J) bool: does link i move when independent joint j moves?"""
    moved = tree.coupling != 0
    for i, parent in enumerate(tree.parents):
        if parent >= 0:
            moved[i] |= moved[parent]
    return moved
