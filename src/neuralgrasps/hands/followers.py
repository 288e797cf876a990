"""Branches of a hand that have no joint of their own: what is said of them, for some may be struts of a linkage."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neuralgrasps.hands.closing import MovableHand

FEW = 2  # two fingers on one joint are a jaw


def branch_doubts(model: MovableHand, branches: Sequence[tuple[int, ...]]) -> tuple[str, ...]:
    """What was taken for a strut, and which fingers might be one, in a sentence each.

    Args:
        model: the hand with the fingers that were kept; branches: links of each branch of the tree.
    """
    names, said = model.tree.link_names, []
    struts = [b for b in branches if b not in model.fingers and any(i in model.clouds for i in b)]
    struts = [b for b in struts if model.moved[list(b)].any()]
    if struts:
        said.append(f"taken for struts of a linkage, no fingers: {', '.join(names[b[0]] for b in struts)}.")
    for joint, count in _followers(model).items():
        if count > FEW:
            said.append(
                f"{count} branches follow joint {joint} and have none of their own: if some are struts of a linkage, "
                "state 'fingers' in hand.toml."
            )
    return tuple(said)


def _followers(model: MovableHand) -> dict[str, int]:
    """How many fingers each joint moves that no joint moves alone."""
    of_finger = np.array([model.moved[list(f)].any(axis=0) for f in model.fingers])
    shared = of_finger & (of_finger.sum(axis=0) > 1)
    own = (of_finger & ~shared).any(axis=1)
    count = shared[~own].sum(axis=0)
    return {model.tree.dof_names[j]: int(count[j]) for j in np.flatnonzero(count)}


def counted_fingers(count: int) -> str:
    return "1 finger" if count == 1 else f"{count} fingers"
