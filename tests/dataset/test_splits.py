import numpy as np
import pytest

from neuralgrasps.dataset.splits import split_grasps
from neuralgrasps.errors import InputError


@pytest.mark.parametrize(
    ("count", "train", "test", "spare"), [(60, 50, 5, 5), (55, 50, 5, 0), (24, 20, 4, 0), (12, 10, 2, 0), (1, 1, 0, 0)]
)
def test_sizes_are_the_published_ones_scaled_down(count: int, train: int, test: int, spare: int) -> None:
    split = split_grasps(count, hand="fetch", object_name="box", seed=0)
    assert (len(split.train), len(split.test), len(split.spare)) == (train, test, spare)
    assert sorted(split.part("all")) == list(range(count))


def test_choice_depends_on_names_and_seed_only() -> None:
    first = split_grasps(60, hand="fetch", object_name="box", seed=0)
    again = split_grasps(60, hand="fetch", object_name="box", seed=0)
    assert np.array_equal(first.test, again.test)
    others = [
        split_grasps(60, hand="panda", object_name="box", seed=0),
        split_grasps(60, hand="fetch", object_name="box", seed=1),
    ]
    assert all(not np.array_equal(first.test, other.test) for other in others)


def test_unknown_part_and_empty_sets_are_refused() -> None:
    with pytest.raises(InputError, match="at least 1"):
        split_grasps(0, hand="fetch", object_name="box", seed=0)
    with pytest.raises(InputError, match="'tests' is not known"):
        split_grasps(3, hand="fetch", object_name="box", seed=0).part("tests")
