import importlib.util
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from neuralgrasps.apply.code_index import CodeIndex, MissingFaissError, merged
from neuralgrasps.errors import InputError, ShapeError


def brute_force(values: np.ndarray, queries: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    distance = cdist(queries, values, "cityblock")
    order = np.argsort(distance, axis=1, kind="stable")[:, :count]
    return order, np.take_along_axis(distance, order, axis=1)


@settings(max_examples=40, deadline=None)
@given(
    rows=st.integers(1, 300),
    columns=st.integers(1, 40),
    count=st.integers(1, 12),
    levels=st.integers(2, 5),
    seed=st.integers(0, 2**16),
)
def test_equals_brute_force_with_ties(rows: int, columns: int, count: int, levels: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.integers(levels, size=(rows, columns)).astype(np.float32)  # few levels: many equal distances
    queries = rng.integers(levels, size=(3, columns)).astype(np.float32)
    index, distance = CodeIndex(values).search(queries, count, threads=1)
    expected, expected_distance = brute_force(values, queries, min(count, rows))
    found = min(count, rows)
    assert np.array_equal(index[:, :found], expected) and (index[:, found:] == -1).all()
    assert np.allclose(distance[:, :found], expected_distance) and np.isinf(distance[:, found:]).all()


def test_many_rows_on_any_number_of_threads() -> None:
    rng = np.random.default_rng(1)
    centres = rng.random((40, 96)).astype(np.float32)
    values = centres[rng.integers(40, size=150_000)] + rng.normal(scale=0.1, size=(150_000, 96)).astype(np.float32)
    queries = values[:5] + 0.01
    index = CodeIndex(values)
    one, three = (index.search(queries, 10, threads=threads) for threads in (1, 3))
    assert np.array_equal(one[0], three[0]) and np.array_equal(one[1], three[1])
    expected, distance = brute_force(values, queries, 10)
    assert np.array_equal(one[0], expected) and np.allclose(one[1], distance, rtol=1e-5)


def test_bounds_hold_for_large_values_that_cancel() -> None:
    """Group sums cancel to rounding error here: a bound without its slack would lose the nearest row."""
    rng = np.random.default_rng(2)
    values = (1e6 * rng.normal(size=(3000, 24))).astype(np.float32)
    queries = values[::500] * np.float32(1.0000001)
    expected, _ = brute_force(values, queries, 1)
    assert np.array_equal(CodeIndex(values).search(queries, 1)[0], expected)


def test_wide_rows_keep_their_nearest() -> None:
    """Rounding of sums grows with the columns; the slack must, too."""
    rng = np.random.default_rng(4)
    for columns in (1024, 4096):
        values = rng.random((400, columns)).astype(np.float32)
        queries = values[:20] + rng.normal(scale=1e-6, size=(20, columns)).astype(np.float32)
        assert np.array_equal(CodeIndex(values).search(queries, 1)[0][:, 0], np.arange(20))


def test_only_the_given_parts_are_searched() -> None:
    values = np.arange(20, dtype=np.float32)[:, None]
    index, distance = CodeIndex(values).search(np.array([[9.6]]), 4, parts=[slice(0, 3), slice(12, 14)])
    assert index.tolist() == [[12, 13, 2, 1]] and np.allclose(distance, [[2.4, 3.4, 7.6, 8.6]])
    index, distance = CodeIndex(values).search(np.array([[9.6]]), 2, parts=[])
    assert index.tolist() == [[-1, -1]] and np.isinf(distance).all()


def test_results_of_parts_are_merged_in_order() -> None:
    index, distance = merged(
        [np.array([[4, -1]]), np.array([[2, 9]])], [np.array([[1.0, np.inf]]), np.array([[1.0, 3.0]])], 3
    )
    assert index.tolist() == [[2, 4, 9]] and distance.tolist() == [[1.0, 1.0, 3.0]]


def test_wrong_inputs_are_refused() -> None:
    with pytest.raises(ShapeError, match="N >= 1"):
        CodeIndex(np.zeros((0, 3)))
    with pytest.raises(InputError, match="not finite"):
        CodeIndex(np.array([[np.nan]]))
    with pytest.raises(InputError, match="too large"):
        CodeIndex(np.full((2, 3), 1e38))
    with pytest.raises(InputError, match="'native' or 'faiss'"):
        CodeIndex(np.zeros((1, 1)), backend="annoy")
    index = CodeIndex(np.zeros((2, 3)))
    with pytest.raises(ShapeError, match=r"\(Q, 3\)"):
        index.search(np.zeros((1, 4)), 1)
    with pytest.raises(InputError, match="count is 0"):
        index.search(np.zeros((1, 3)), 0)


def test_faiss_gives_the_same_or_says_that_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    values, queries = rng.random((500, 17)), rng.random((4, 17))
    if importlib.util.find_spec("faiss") is not None:
        ours = CodeIndex(values).search(queries, 6, parts=[slice(10, 200), slice(300, 450)])
        theirs = CodeIndex(values, backend="faiss").search(queries, 6, parts=[slice(10, 200), slice(300, 450)])
        assert np.array_equal(ours[0], theirs[0]) and np.allclose(ours[1], theirs[1], rtol=1e-5)
    monkeypatch.setitem(sys.modules, "faiss", None)
    with pytest.raises(MissingFaissError, match=r"neuralgrasps\[retrieve\]"):
        CodeIndex(values, backend="faiss")
