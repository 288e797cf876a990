"""The GraspSet noun: checks, indexing, joining; and its files."""

from __future__ import annotations

import errno
import json
import os
import pickle
import re
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.numpy import load, save
from scipy.spatial.transform import Rotation

from neuralgrasps.errors import DataFormatError, InputError, ShapeError, StorageError, UnknownNameError
from neuralgrasps.grasps import grasp_io
from neuralgrasps.grasps.grasp_io import load_grasps, save_grasps
from neuralgrasps.grasps.grasp_set import GraspSet, Verdict, array_fields, concatenate, empty_grasps, pad_contacts
from neuralgrasps.hands.fingerprint import hand_fingerprint


def make_grasps(count: int = 6, contacts: int = 4, seed: int = 0, *, verdict: bool = True) -> GraspSet:
    rng = np.random.default_rng(seed)
    X_OH = np.tile(np.eye(4), (count, 1, 1))
    if count:
        X_OH[:, :3, :3] = Rotation.random(count, random_state=seed).as_matrix()
    X_OH[:, :3, 3] = rng.normal(0, 0.1, (count, 3))
    links = rng.integers(-1, 5, (count, contacts))
    points, normals = rng.normal(size=(count, contacts, 3)), rng.normal(size=(count, contacts, 3))
    points[links < 0], normals[links < 0] = np.nan, np.nan
    grasps = GraspSet(
        hand="jaw",
        object="box",
        X_OH=X_OH,
        q=rng.normal(size=(count, 3)),
        q_pregrasp=rng.normal(size=(count, 3)),
        q_squeeze=rng.normal(size=(count, 3)),
        contact_points_O=points,
        contact_normals_O=normals,
        contact_links=links,
        epsilon=rng.random(count),
        penetration_m=rng.random(count),
        seed=seed,
        config={"count": "6"},
    )
    if not verdict:
        return grasps
    return grasps.with_verdict(
        "shake",
        Verdict(
            success=rng.random(count) < 0.5,
            displacement_m=rng.random(count),
            rotation_rad=rng.random(count),
            parameters={"mass_kg": 0.1},
        ),
    )


def assert_same(a: GraspSet, b: GraspSet) -> None:
    for name in array_fields():
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        assert getattr(a, name).dtype == getattr(b, name).dtype
    assert (a.hand, a.object, a.seed, a.protocol, dict(a.config)) == (
        b.hand,
        b.object,
        b.seed,
        b.protocol,
        dict(b.config),
    )
    assert list(a.verdicts) == list(b.verdicts)
    for name, verdict in a.verdicts.items():
        other = b.verdicts[name]
        np.testing.assert_array_equal(verdict.success, other.success)
        np.testing.assert_array_equal(verdict.displacement_m, other.displacement_m)
        np.testing.assert_array_equal(verdict.rotation_rad, other.rotation_rad)
        assert dict(verdict.parameters) == dict(other.parameters)


def test_indexing_by_integer_slice_mask_and_array():
    grasps = make_grasps()
    assert len(grasps[2]) == 1
    np.testing.assert_array_equal(grasps[2].q, grasps.q[2:3])
    np.testing.assert_array_equal(
        grasps[-1].verdicts["shake"].displacement_m, [grasps.verdicts["shake"].displacement_m[5]]
    )
    assert_same(grasps[1:4], grasps[[1, 2, 3]])
    assert_same(grasps[grasps.validated], grasps[np.flatnonzero(grasps.validated)])
    assert len(grasps[[]]) == len(grasps[:0]) == 0
    assert [len(g) for g in grasps] == [1] * 6  # iteration ends


@pytest.mark.parametrize(
    ("index", "error"),
    [(6, IndexError), (-7, IndexError), (np.ones(5, bool), InputError), ([0.5], InputError), ([[0]], InputError)],
)
def test_bad_indices_are_refused(index, error):
    with pytest.raises(error):
        make_grasps()[index]


def test_arrays_and_attributes_cannot_be_changed():
    grasps = make_grasps()
    with pytest.raises(FrozenInstanceError):
        grasps.seed = 3
    with pytest.raises(ValueError, match="read-only"):
        grasps.q[0] = 0


def test_worker_processes_can_send_sets():
    assert_same(pickle.loads(pickle.dumps(make_grasps())), make_grasps())


def test_wrong_arrays_are_refused_and_named():
    grasps = make_grasps()
    with pytest.raises(ShapeError, match=r"q_squeeze has shape \(6, 2\); expected \(6, 3\)"):
        replace(grasps, q_squeeze=np.zeros((6, 2)))
    with pytest.raises(ShapeError, match="verdict 'shake' holds 6"):
        replace(grasps[:2], verdicts=grasps.verdicts)
    X = grasps.X_OH.copy()
    X[4, :3, :3] *= 1 + 1e-5
    with pytest.raises(InputError, match="X_OH is not a rigid transform in grasps 4"):
        replace(grasps, X_OH=X)
    X = grasps.X_OH.copy()
    X[:, :, 0] *= -1
    with pytest.raises(InputError, match=r"in grasps 0, 1, 2, 3, 4, \.\.\."):
        replace(grasps, X_OH=X)
    q = grasps.q.copy()
    q[3, 1] = np.nan
    with pytest.raises(InputError, match="q is not finite in grasps 3"):
        replace(grasps, q=q)
    with pytest.raises(InputError, match="negative"):
        replace(grasps, penetration_m=-grasps.penetration_m)
    with pytest.raises(InputError, match="contact_points_O and contact_links disagree"):
        replace(grasps, contact_links=np.zeros((6, 4), np.int32))
    with pytest.raises(ShapeError):
        Verdict(success=np.ones(2), displacement_m=np.ones(3), rotation_rad=np.ones(2))


def test_a_rotation_off_by_less_than_the_tolerance_is_accepted():
    X = make_grasps().X_OH.copy()
    X[:, :3, :3] *= 1 + 2e-7
    replace(make_grasps(), X_OH=X)


def test_validated_reads_the_named_protocol():
    grasps = make_grasps()
    np.testing.assert_array_equal(grasps.validated, grasps.verdicts["shake"].success)
    hard = Verdict(success=np.zeros(6), displacement_m=np.ones(6), rotation_rad=np.ones(6))
    both = grasps.with_verdict("hard", hard)
    assert not both.validated.any()
    np.testing.assert_array_equal(both.succeeded("shake"), grasps.validated)
    with pytest.raises(UnknownNameError, match="Did you mean 'shake'"):
        both.succeeded("shak")
    assert not make_grasps(verdict=False).validated.any()


def test_concatenate_pads_contacts_and_joins_verdicts():
    a, b = make_grasps(3, 2, seed=1), make_grasps(4, 5, seed=2).with_config(count="9")
    joined = concatenate([a, empty_grasps("jaw", "box", num_joints=3), b])
    assert len(joined) == 7
    assert_same(joined[3:], replace(b, seed=1, config=joined.config))
    assert (joined.contact_links[:3, 2:] == -1).all()
    assert np.isnan(joined.contact_points_O[:3, 2:]).all()
    np.testing.assert_array_equal(joined.num_contacts[:3], a.num_contacts)
    assert joined.config["count"] == "6 | 9"
    assert pad_contacts(a, 1) is a


def test_sets_that_do_not_belong_together_are_not_concatenated():
    a = make_grasps()
    with pytest.raises(InputError, match="differ in object"):
        concatenate([a, replace(a, object="can")])
    with pytest.raises(InputError, match="verdicts"):
        concatenate([a, make_grasps(verdict=False)])
    verdict = replace(a.verdicts["shake"], parameters={"mass_kg": 0.5})
    with pytest.raises(InputError, match="different parameters"):
        concatenate([a, a.with_verdict("shake", verdict)])
    with pytest.raises(InputError):
        concatenate([])


@settings(max_examples=25, deadline=None)
@given(count=st.integers(0, 7), contacts=st.integers(0, 5), seed=st.integers(0, 1000))
def test_files_give_back_what_was_saved(tmp_path_factory, count, contacts, seed):
    path = tmp_path_factory.mktemp("grasps") / "set.safetensors"
    grasps = make_grasps(count, contacts, seed).with_config(note='quotes " and ünïcode')
    assert save_grasps(path, grasps) == path
    assert_same(load_grasps(path), grasps)
    assert [p.name for p in path.parent.iterdir()] == ["set.safetensors"]


def description_of(path):
    data = path.read_bytes()
    return json.loads(json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])["__metadata__"]["description"])


def test_a_file_explains_itself(tmp_path, jaw):
    grasps = replace(make_grasps(), hand=jaw.name, **{n: np.zeros((6, 2)) for n in ("q", "q_pregrasp", "q_squeeze")})
    path = save_grasps(tmp_path / "set.safetensors", grasps, hand=jaw, object_fingerprint="abc")
    described = description_of(path)
    assert described["joints"] == ["right", "left"] and described["links"] == ["base", "right", "left"]
    assert described["hand_fingerprint"] == hand_fingerprint(jaw) and described["object_fingerprint"] == "abc"
    tensors = {re.sub(r"verdict\.\d+", "verdict.I", name) for name in load(path.read_bytes())}
    assert set(described["columns"]) == tensors
    assert_same(load_grasps(path), grasps)


def test_a_file_without_a_hand_is_read_as_are_older_ones(tmp_path):
    path = save_grasps(tmp_path / "set.safetensors", make_grasps())
    assert not {"joints", "links", "hand_fingerprint", "object_fingerprint"} & set(description_of(path))
    data = path.read_bytes()
    arrays, metadata = load(data), json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])["__metadata__"]
    older = json.loads(metadata["description"])
    del older["columns"]
    metadata["description"] = json.dumps(older)
    metadata["sha256"] = grasp_io._checksum(arrays, metadata["description"])
    path.write_bytes(save(arrays, metadata))
    assert_same(load_grasps(path), make_grasps())


def test_the_hand_of_other_grasps_is_refused(tmp_path, jaw):
    with pytest.raises(InputError, match="are of hand 'jaw', but hand 'toy_jaw'"):
        save_grasps(tmp_path / "set.safetensors", make_grasps(), hand=jaw)
    with pytest.raises(ShapeError, match="q has 3 columns"):
        save_grasps(tmp_path / "set.safetensors", replace(make_grasps(), hand=jaw.name), hand=jaw)
    assert not list(tmp_path.iterdir())


def test_damaged_files_are_refused(tmp_path):
    path = tmp_path / "set.safetensors"
    save_grasps(path, make_grasps())
    data = path.read_bytes()
    rng = np.random.default_rng(0)
    for position in [0, 3, 8, 20, len(data) - 1, *rng.integers(0, len(data), 200)]:
        changed = bytearray(data)
        changed[position] ^= 1 << int(rng.integers(0, 8))
        path.write_bytes(changed)
        with pytest.raises(DataFormatError):
            load_grasps(path)
    for size in (0, 5, 100, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:size])
        with pytest.raises(DataFormatError):
            load_grasps(path)


def test_files_of_another_kind_or_version_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "set.safetensors"
    path.write_bytes(save({"a": np.zeros(3)}))
    with pytest.raises(DataFormatError, match="other data"):
        load_grasps(path)
    monkeypatch.setattr(grasp_io, "VERSION", 99)
    save_grasps(path, make_grasps())
    monkeypatch.undo()
    with pytest.raises(DataFormatError, match="version 99; this library reads version 2"):
        load_grasps(path)
    with pytest.raises(InputError, match="No such file"):
        load_grasps(tmp_path / "missing.safetensors")


def test_equal_grasps_make_equal_files(tmp_path):
    first = save_grasps(tmp_path / "first.safetensors", make_grasps()).read_bytes()
    for _ in range(8):  # the order of the description's keys must not be left to chance
        assert save_grasps(tmp_path / "again.safetensors", make_grasps()).read_bytes() == first


def test_a_well_formed_file_with_inconsistent_arrays_is_refused(tmp_path):
    path = tmp_path / "set.safetensors"
    save_grasps(path, make_grasps())
    data = path.read_bytes()
    arrays = load(data)
    metadata = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])["__metadata__"]
    arrays["q"] = arrays["q"][:, :2].copy()
    metadata["sha256"] = grasp_io._checksum(arrays, metadata["description"])
    path.write_bytes(save(arrays, metadata))
    with pytest.raises(DataFormatError, match="q_pregrasp has shape"):
        load_grasps(path)


@pytest.mark.parametrize(("code", "message"), [(errno.ENOSPC, "disk is full"), (errno.EROFS, "no permission")])
def test_a_failed_write_is_explained_and_leaves_the_old_file(tmp_path, monkeypatch, code, message):
    path = tmp_path / "set.safetensors"
    save_grasps(path, make_grasps(seed=1))

    def fail(_):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(StorageError, match=message):
        save_grasps(path, make_grasps(seed=2))
    monkeypatch.undo()
    assert_same(load_grasps(path), make_grasps(seed=1))
    assert [p.name for p in tmp_path.iterdir()] == ["set.safetensors"]
    with pytest.raises(StorageError, match="does not exist"):
        save_grasps(tmp_path / "nowhere" / "set.safetensors", make_grasps())


def test_a_set_prints_as_one_line() -> None:
    grasps = empty_grasps("fetch", "mug", num_joints=1)
    assert repr(grasps) == "GraspSet(fetch on mug: 0 grasps)"
