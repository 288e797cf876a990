from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuralgrasps.dataset.build import build_dataset
from neuralgrasps.dataset.read import GraspDataset, read_dataset
from neuralgrasps.dataset.verify import verify_dataset
from neuralgrasps.errors import DataFormatError, InputError, UnknownNameError
from neuralgrasps.hands.packed import pack_hand


def build(folder: Path, world, **changes):
    arguments = {"hands": world.hands, "objects": world.objects, "config": world.config} | changes
    return build_dataset(folder, arguments.pop("grasp_sets", world.grasp_sets), **arguments)


def file_bytes(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_the_same_bytes_for_any_number_of_workers(small_world, small_dataset: GraspDataset, tmp_path: Path) -> None:
    build(tmp_path / "three", small_world, workers=3)
    assert file_bytes(tmp_path / "three") == file_bytes(small_dataset.folder)


def test_what_is_read_is_what_was_given(small_world, small_dataset: GraspDataset) -> None:
    assert small_dataset.hands == ("allegro", "fetch")
    assert small_dataset.pairs == (("allegro", "ball"), ("fetch", "ball"), ("allegro", "brick"), ("fetch", "brick"))
    for given in small_world.grasp_sets:
        read = small_dataset.grasps(given.hand, given.object)
        assert np.array_equal(read.X_OH, given.X_OH) and np.array_equal(read.q, given.q)
        assert small_dataset.contact_maps(given.hand, given.object).shape == (12, 512)
    ball = small_dataset.object("ball")
    assert ball.normalisation.scale_m == pytest.approx(0.12, rel=0.02)
    assert small_dataset.contact_radius_m("ball") == pytest.approx(0.05 * ball.normalisation.scale_m)


def test_samples_computed_on_demand_equal_the_stored_ones(small_world, small_dataset: GraspDataset, tmp_path) -> None:
    sets = small_world.grasp_sets[:1]
    lean = replace(small_world.config, store_samples=False)
    build(tmp_path / "lean", small_world, grasp_sets=sets, config=lean)
    dataset = read_dataset(tmp_path / "lean")
    packed = pack_hand(small_world.hands["allegro"], spacing=0.006)
    computed = dataset.samples("allegro", "brick", [4, 1], packed=packed)
    stored = small_dataset.samples("allegro", "brick", [4, 1])
    for name in ("points_O", "sdf_object", "sdf_hand", "hand_index"):
        assert np.array_equal(getattr(computed, name), getattr(stored, name))
    with pytest.raises(InputError, match="stores no SDF samples"):
        dataset.samples("allegro", "brick")
    with pytest.raises(InputError, match="not the model"):
        dataset.samples("allegro", "brick", packed=pack_hand(small_world.hands["fetch"], spacing=0.006))


def test_a_killed_build_goes_on_where_it_was(small_world, small_dataset, tmp_path: Path, monkeypatch) -> None:
    finished = []

    def killed_after_two(done: int, total: int, name: str) -> None:
        finished.append(name)
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build(tmp_path, small_world, progress=killed_after_two)
    with pytest.raises(DataFormatError, match=r"manifest\.json is missing"):
        read_dataset(tmp_path)
    result = build(tmp_path, small_world)
    assert (result.built, result.kept) == (2, 2)
    assert file_bytes(tmp_path) == file_bytes(small_dataset.folder)
    assert build(tmp_path, small_world).built == 0


def test_other_inputs_rebuild_only_what_they_change(small_world, tmp_path: Path) -> None:
    build(tmp_path, small_world)
    first, *rest = small_world.grasp_sets
    assert build(tmp_path, small_world, grasp_sets=(first[:6], *rest)).built == 1
    assert build(tmp_path, small_world, config=replace(small_world.config, seed=4)).built == 4


@pytest.mark.parametrize("kind", ["samples", "grasps", "objects"])
def test_a_damaged_file_is_found_and_replaced(small_world, small_dataset, tmp_path: Path, kind: str) -> None:
    build(tmp_path, small_world)
    assert verify_dataset(read_dataset(tmp_path)).ok
    victim = next((tmp_path / kind).rglob("*.safetensors"))
    data = bytearray(victim.read_bytes())
    data[-40] ^= 1
    victim.write_bytes(data)
    result = verify_dataset(read_dataset(tmp_path))
    assert not result.ok and victim.name in result.problems[0] and "sha256" in result.problems[0]
    build(tmp_path, small_world)
    assert file_bytes(tmp_path) == file_bytes(small_dataset.folder)


def test_wrong_distances_are_found_even_under_a_right_checksum(small_world, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("neuralgrasps.dataset.samples.tree_distance", lambda tree, mesh, p: np.full(len(p), 0.01))
    build(tmp_path, small_world, grasp_sets=small_world.grasp_sets[:1])
    result = verify_dataset(read_dataset(tmp_path))
    assert "off by up to" in result.problems[0] and result.max_error_m > 0.005


def test_bad_inputs_say_what_is_wrong(small_world, small_dataset: GraspDataset, tmp_path: Path) -> None:
    first = small_world.grasp_sets[0]
    with pytest.raises(InputError, match="given twice"):
        build(tmp_path, small_world, grasp_sets=(first, first))
    with pytest.raises(InputError, match="is empty"):
        build(tmp_path, small_world, grasp_sets=(first[:0],))
    with pytest.raises(UnknownNameError, match="Known hands: fetch"):
        build(tmp_path, small_world, hands={"fetch": small_world.hands["fetch"]})
    with pytest.raises(InputError, match="file name"):
        build(tmp_path, small_world, grasp_sets=(replace(first, object="../x"),))
    with pytest.raises(UnknownNameError, match="Did you mean 'brick'"):
        small_dataset.object("brik")
    (tmp_path / "manifest.json").write_text('{"schema_version": 99}')
    with pytest.raises(DataFormatError, match="schema version 99"):
        read_dataset(tmp_path)
