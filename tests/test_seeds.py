"""Child seeds."""

from __future__ import annotations

import itertools

import numpy as np

from neuralgrasps.seeds import child_rng, child_seed


def test_a_child_seed_is_a_constant_of_its_names():
    assert child_seed(0, "a", 1) == child_seed(0, "a", 1)
    assert 0 <= child_seed(0, "a", 1) < 2**63


def test_seeds_of_other_names_differ():
    names = [(), ("a",), ("a", "b"), ("a/b",), ("a, b",), ('a", "b',), ("b", "a"), ("1",), (1,), (11,), (1, 1)]
    seeds = [child_seed(s, *n) for s in (0, 1, -1) for n in names]
    assert all(x != y for x, y in itertools.combinations(seeds, 2))


def test_numpy_integers_are_integers():
    assert child_seed(3, 2) == child_seed(np.int64(3), np.int32(2))


def test_generators_of_one_name_draw_the_same():
    assert (child_rng(5, "x").random(4) == child_rng(5, "x").random(4)).all()
    assert (child_rng(5, "x").random(4) != child_rng(6, "x").random(4)).any()
