import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from neuralgrasps.dataset.build import build_dataset
from neuralgrasps.dataset.clouds import SceneClouds, scene_clouds
from neuralgrasps.dataset.read import GraspDataset, read_dataset
from neuralgrasps.dataset.schema import sha256_of_file
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


@pytest.mark.parametrize("kind", ["exact", "rendered"])
def test_clouds_computed_on_demand_equal_the_stored_ones(small_world, small_dataset, tmp_path, kind: str) -> None:
    sets = small_world.grasp_sets[:1]
    build(tmp_path, small_world, grasp_sets=sets, config=replace(small_world.config, clouds=kind, cloud_points=300))
    dataset = read_dataset(tmp_path)
    packed = pack_hand(small_world.hands["allegro"], spacing=0.006)
    stored = dataset.clouds("allegro", "brick", [4, 1])
    lean = replace(small_dataset.manifest, config=replace(small_world.config, cloud_points=300))
    computed = replace(small_dataset, manifest=lean).clouds("allegro", "brick", [4, 1], kind=kind, packed=packed)
    for f in fields(SceneClouds):
        assert getattr(stored, f.name).shape == (2, 300, 3)
        assert np.array_equal(getattr(stored, f.name), getattr(computed, f.name))
    assert len(dataset.clouds("allegro", "brick")) == 12
    with pytest.raises(InputError, match="stores no point clouds"):
        small_dataset.clouds("allegro", "brick")
    with pytest.raises(InputError, match="give the packed hand"):
        small_dataset.clouds("allegro", "brick", kind=kind)
    with pytest.raises(InputError, match="not the model"):
        small_dataset.clouds("allegro", "brick", kind=kind, packed=pack_hand(small_world.hands["fetch"], spacing=0.006))


def test_asking_for_clouds_later_keeps_the_samples_and_the_other_way_round(small_world, tmp_path: Path) -> None:
    sets = small_world.grasp_sets[:2]
    build(tmp_path, small_world, grasp_sets=sets)
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "samples").rglob("*.safetensors")}
    with_clouds = replace(small_world.config, clouds="exact", cloud_points=50)
    assert build(tmp_path, small_world, grasp_sets=sets, config=with_clouds).built == 2
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "samples").rglob("*.safetensors")} == before
    clouds = {p: p.stat().st_mtime_ns for p in (tmp_path / "clouds").rglob("*.safetensors")}
    assert build(tmp_path, small_world, grasp_sets=sets, config=replace(with_clouds, noise_wide=0.01)).built == 2
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "clouds").rglob("*.safetensors")} == clouds
    assert build(tmp_path, small_world, grasp_sets=sets, config=replace(with_clouds, noise_wide=0.01)).built == 0
    assert build(tmp_path, small_world, grasp_sets=sets).built == 2  # the samples of the first noise again


def test_a_build_killed_between_samples_and_clouds_goes_on(small_world, tmp_path: Path, monkeypatch) -> None:
    config = replace(small_world.config, clouds="rendered", cloud_points=50)
    sets = small_world.grasp_sets[:2]
    build(tmp_path / "whole", small_world, grasp_sets=sets, config=config)
    made = []

    def killed(*args, **options):
        made.append(options["object_name"])
        if len(made) == 2:
            raise KeyboardInterrupt
        return scene_clouds(*args, **options)

    with monkeypatch.context() as patch:
        patch.setattr("neuralgrasps.dataset.shards.scene_clouds", killed)
        with pytest.raises(KeyboardInterrupt):
            build(tmp_path / "killed", small_world, grasp_sets=sets, config=config)
    kept = {p: p.stat().st_mtime_ns for k in ("samples", "clouds") for p in (tmp_path / "killed" / k).rglob("*.*")}
    assert len(kept) == 3
    result = build(tmp_path / "killed", small_world, grasp_sets=sets, config=config)
    assert (result.built, result.kept) == (1, 1)
    assert all(p.stat().st_mtime_ns == t for p, t in kept.items())
    assert file_bytes(tmp_path / "killed") == file_bytes(tmp_path / "whole")


@pytest.mark.parametrize("kind", ["samples", "clouds", "grasps", "objects"])
def test_reading_names_and_refuses_a_damaged_file(small_world, tmp_path: Path, kind: str) -> None:
    """A flipped bit that leaves the file readable."""
    config = replace(small_world.config, clouds="exact", cloud_points=50)
    build(tmp_path, small_world, grasp_sets=small_world.grasp_sets[:1], config=config)
    victim = next((tmp_path / kind).rglob("*.safetensors"))
    data = bytearray(victim.read_bytes())
    data[-40] ^= 1
    victim.write_bytes(data)
    dataset = read_dataset(tmp_path)
    reads = {
        "samples": [lambda: dataset.samples("allegro", "brick", [0]), lambda: dataset.contact_maps("allegro", "brick")],
        "clouds": [lambda: dataset.clouds("allegro", "brick", [0])],
        "grasps": [lambda: dataset.grasps("allegro", "brick")],
        "objects": [lambda: dataset.object("brick")],
    }
    for group, calls in reads.items():
        for call in calls:
            if group == kind:
                with pytest.raises(DataFormatError, match=rf"{victim.name}.*sha256"):
                    call()
            else:
                call()
    victim.unlink()
    with pytest.raises(DataFormatError, match=f"{victim.name}' is missing"):
        reads[kind][0]()


def test_a_file_is_hashed_once_until_it_changes(small_world, tmp_path: Path, monkeypatch) -> None:
    build(tmp_path, small_world, grasp_sets=small_world.grasp_sets[:1])
    hashed = []

    def spy(path: Path) -> str:
        hashed.append(path.parent.parent.name)
        return sha256_of_file(path)

    monkeypatch.setattr("neuralgrasps.dataset.stored.sha256_of_file", spy)
    dataset = read_dataset(tmp_path)
    for index in range(5):
        dataset.samples("allegro", "brick", [index])
        dataset.contact_maps("allegro", "brick")
    assert hashed == ["samples"]
    victim = next((tmp_path / "samples").rglob("*.safetensors"))
    victim.write_bytes(victim.read_bytes()[:-1] + b"x")
    with pytest.raises(DataFormatError, match="sha256"):
        dataset.samples("allegro", "brick", [0])


def test_rows_are_those_of_the_whole(small_dataset: GraspDataset) -> None:
    whole = small_dataset.samples("fetch", "ball")
    for rows in ([3, 0, 3], [-1], np.array([5]), []):
        some = small_dataset.samples("fetch", "ball", rows)
        assert np.array_equal(some.points_O, whole.points_O[np.asarray(rows, int)])
        assert np.array_equal(some.hand_index, whole.hand_index[np.asarray(rows, int)])
    with pytest.raises(IndexError, match="the pair has 12"):
        small_dataset.samples("fetch", "ball", [12])


def test_verify_finds_clouds_that_are_not_on_the_object(small_world, tmp_path: Path, monkeypatch) -> None:
    def lifted(*args, **options):
        clouds = scene_clouds(*args, **options)
        return replace(clouds, object_points_O=clouds.object_points_O + np.float32(0.001))

    monkeypatch.setattr("neuralgrasps.dataset.shards.scene_clouds", lifted)
    config = replace(small_world.config, clouds="exact", cloud_points=50)
    build(tmp_path, small_world, grasp_sets=small_world.grasp_sets[:1], config=config)
    found = verify_dataset(read_dataset(tmp_path))
    assert len(found.problems) == 1 and found.problems[0].startswith("clouds/brick/allegro.safetensors")
    assert found.max_error_m > 3e-4


def test_a_dataset_of_the_first_schema_is_read(small_world, tmp_path: Path) -> None:
    build(tmp_path, small_world, grasp_sets=small_world.grasp_sets[:1])
    path = tmp_path / "manifest.json"
    manifest = json.loads(path.read_text())
    manifest["schema_version"] = 1
    for added in ("held_out_hands", "held_out_objects"):
        del manifest[added]
    for added in ("clouds", "cloud_points"):
        del manifest["config"][added]
    for added in ("clouds_key", "clouds_file", "clouds_sha256"):
        del manifest["shards"][0][added]
    path.write_text(json.dumps(manifest))
    dataset = read_dataset(tmp_path)
    assert verify_dataset(dataset).ok and len(dataset.split("allegro", "brick").train) == 10
    assert len(dataset.samples("allegro", "brick")) == 12


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
