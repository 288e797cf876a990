import numpy as np
import pytest

from neuralgrasps.dataset.build import build_dataset
from neuralgrasps.dataset.read import GraspDataset, read_dataset
from neuralgrasps.dataset.splits import sort_held_out, split_grasps
from neuralgrasps.dataset.verify import verify_dataset
from neuralgrasps.errors import InputError, UnknownNameError


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


def parts_of(dataset: GraspDataset) -> dict[tuple[str, str], tuple[list[int], list[int], list[int]]]:
    splits = {pair: dataset.split(*pair) for pair in dataset.pairs}
    return {pair: (list(s.train), list(s.test), list(s.spare)) for pair, s in splits.items()}


def test_no_grasp_is_in_two_parts_and_none_is_lost(small_dataset: GraspDataset) -> None:
    views = [small_dataset, small_dataset.holding_out(["fetch"]), small_dataset.holding_out(objects=["ball"])]
    for view in views:
        for train, test, spare in parts_of(view).values():
            assert sorted(train + test + spare) == list(range(12))


def test_what_is_held_out_trains_nothing_and_the_rest_is_as_before(small_dataset: GraspDataset) -> None:
    before = parts_of(small_dataset)
    after = parts_of(small_dataset.holding_out(hands=["allegro"]))
    for hand, name in small_dataset.pairs:
        expected = ([], list(range(12)), []) if hand == "allegro" else before[hand, name]
        assert after[hand, name] == expected
    both = parts_of(small_dataset.holding_out(["allegro"], ["ball"]))
    assert [pair for pair, (train, _, _) in both.items() if train] == [("fetch", "brick")]
    assert parts_of(small_dataset.holding_out(["allegro"]).holding_out(objects=["ball"])) == both
    assert parts_of(small_dataset) == before


def test_names_to_hold_out_must_be_known_and_leave_something(small_dataset: GraspDataset) -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'fetch'"):
        small_dataset.holding_out(["fech"])
    with pytest.raises(UnknownNameError, match="object 'fetch' is not known"):
        small_dataset.holding_out(objects=["fetch"])
    with pytest.raises(InputError, match="leaves no pair"):
        small_dataset.holding_out(["fetch", "allegro"])
    assert sort_held_out([("a", "x"), ("b", "y"), ("b", "z")], ["y", "a", "y"]) == (("a",), ("y",))
    with pytest.raises(UnknownNameError, match="'q' is not known"):
        sort_held_out([("a", "x")], ["q"])


def test_holding_out_is_stored_and_rebuilds_nothing(small_world, tmp_path) -> None:
    world = small_world
    options = {"hands": world.hands, "objects": world.objects, "config": world.config}
    build_dataset(tmp_path, world.grasp_sets, **options)
    plain = parts_of(read_dataset(tmp_path))
    assert build_dataset(tmp_path, world.grasp_sets, **options, hold_out=["ball", "fetch"]).built == 0
    dataset = read_dataset(tmp_path)
    assert (dataset.manifest.held_out_hands, dataset.manifest.held_out_objects) == (("fetch",), ("ball",))
    assert parts_of(dataset)["fetch", "brick"] == ([], list(range(12)), []) and verify_dataset(dataset).ok
    assert build_dataset(tmp_path, world.grasp_sets, **options).built == 0
    assert parts_of(read_dataset(tmp_path)) == plain
    with pytest.raises(UnknownNameError, match="Did you mean 'ball'"):
        build_dataset(tmp_path, world.grasp_sets, **options, hold_out=["bal"])
