"""The retrieval rows of the demo's page."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.demo.latent import _example
from neuralgrasps.evaluate.retrieval import score_codebook
from neuralgrasps.model.codes import CODE_SIZE, CodeBook


def test_similarities_are_on_the_scale_of_the_table() -> None:
    """Maps of one number: the second query is four times as far from the farthest grasp as the first is."""
    maps = np.array([[0.0], [-3.0], [0.2], [1.0]], np.float32)
    values = np.zeros((4, CODE_SIZE), np.float32)
    values[:, :1] = maps
    none = np.zeros(4, np.int32)
    book = CodeBook(
        values=values, hands=("human",), objects=("box",), hand_index=none, object_index=none,
        grasp_index=np.arange(4, dtype=np.int32), contact_maps=maps, is_test=np.array([True, True, False, False]),
    )  # fmt: skip
    example = _example(book, book[~book.is_test], "box", "human")
    assert example is not None and example.query.grasp == 0
    assert [f.grasp for f in example.nearest] == [2] and example.farthest.grasp == 3
    assert example.nearest[0].similarity == pytest.approx(0.95) and example.farthest.similarity == pytest.approx(0.75)
    assert score_codebook(book, object_name="box").far_z == pytest.approx((0.75 + 0.0) / 2)
