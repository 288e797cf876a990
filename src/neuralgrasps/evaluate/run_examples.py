"""Grasps to show of a run: a query of each object, its nearest by code of every hand, and the farthest of all."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.spatial.distance import cdist

from neuralgrasps.apply.retrieve import retrieve
from neuralgrasps.model.codes import CodeBook


@dataclass(frozen=True, slots=True, kw_only=True)
class Example:
    """Rows of the code book, and how alike the contact maps of their grasps are to the query's.

    Attributes:
        query: an unseen grasp. nearest: the nearest training grasp of each hand by code. farthest: of all hands.
        similarity: of each row, 1 = same, 0 = the most different pair of an unseen and a training grasp on the object:
            as in `score_retrieval`.
    """

    object: str
    query: int
    nearest: tuple[int, ...]
    farthest: int
    similarity: dict[int, float]

    @property
    def rows(self) -> tuple[int, ...]:
        """Query, nearest ones, farthest."""
        return (self.query, *self.nearest, self.farthest)


def retrieval_examples(book: CodeBook, *, prefer: str = "human", rerank: int = 0) -> tuple[Example, ...]:
    """One example per object that has unseen grasps: the first of hand `prefer`, else of any hand.

    Args:
        rerank: put so many in order by contact map before the nearest is taken; 0 = pure code.
    """
    examples = []
    gallery_rows = np.flatnonzero(book.where(is_test=False))
    gallery = book[gallery_rows]
    for name in book.objects:
        asked = np.flatnonzero(book.where(object_name=name, is_test=True))
        if not len(asked) or not gallery.where(object_name=name).any():
            continue
        chosen = [i for i in asked if book.hands[book.hand_index[i]] == prefer]
        query = int(chosen[0] if chosen else asked[0])
        one = book[query]
        here = gallery_rows[gallery.where(object_name=name)]
        hands = sorted({book.hands[i] for i in book.hand_index[here]})
        first = partial(retrieve, one, gallery, object_name=name, count=1, rerank=rerank)
        near = [int(gallery_rows[first(hand=hand).index[0, 0]]) for hand in hands]
        far = int(gallery_rows[first(farthest=True).index[0, 0]])
        distance = cdist(book.contact_maps[asked], book.contact_maps[here], "cityblock")
        similarity = 1.0 - distance[int(np.flatnonzero(asked == query)[0])] / max(float(distance.max()), 1e-12)
        known = dict(zip(here.tolist(), similarity.tolist(), strict=True)) | {query: 1.0}
        examples.append(
            Example(
                object=name, query=query, nearest=tuple(near), farthest=far,
                similarity={i: known[i] for i in (query, *near, far)},
            )
        )  # fmt: skip
    return tuple(examples)
