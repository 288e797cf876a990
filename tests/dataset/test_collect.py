"""Collecting grasps of many pairs: resumable, the same for any number of workers."""

from __future__ import annotations

import copy as copies
import json
from dataclasses import fields, is_dataclass, replace
from importlib.metadata import version

import numpy as np
import pytest

from neuralgrasps.dataset import collect
from neuralgrasps.dataset.collect import collect_grasps, pair_key, record_of
from neuralgrasps.errors import InputError, StorageError
from neuralgrasps.geometry.primitives import box_mesh, sphere_mesh
from neuralgrasps.grasps.grasp_io import load_grasps
from neuralgrasps.hands.fingerprint import PROSE
from neuralgrasps.hands.hand import ConvexPart, Finger, Hand
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.kinematics.tree import KinematicTree
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.sim import protocols
from neuralgrasps.sim.protocols import Actuation, Protocol
from neuralgrasps.synthesis.synthesise import SynthesisConfig, synthesise

CONFIG = SynthesisConfig(count=2, batch=200, draws=1, max_rounds=2, spare=1.0, generations=1, children=2)


@pytest.fixture(scope="module")
def hands():
    return [load_hand("panda"), load_hand("fetch")]


@pytest.fixture(scope="module")
def objects(make_object):
    return [make_object("ball", sphere_mesh(0.03, segments=32)), make_object("slab", box_mesh([0.05, 0.05, 0.01]))]


@pytest.fixture(scope="module")
def collected(tmp_path_factory, hands, objects):
    folder = tmp_path_factory.mktemp("collected")
    return folder, *collect_grasps(folder, hands, objects, config=CONFIG, seed=1, workers=1)


def _same(first, second):
    for a, b in zip(first, second, strict=True):
        assert (a.hand, a.object, len(a)) == (b.hand, b.object, len(b))
        for name in ("X_OH", "q", "q_pregrasp", "q_squeeze", "contact_points_O", "contact_links", "epsilon"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        for name, verdict in a.verdicts.items():
            np.testing.assert_array_equal(verdict.displacement_m, b.verdicts[name].displacement_m)


def test_sets_come_by_object_then_hand_and_lie_in_the_folder(collected):
    folder, sets, records = collected
    assert [(s.object, s.hand) for s in sets] == [
        ("ball", "panda"), ("ball", "fetch"), ("slab", "panda"), ("slab", "fetch"),
    ]  # fmt: skip
    for grasps, record in zip(sets, records, strict=True):
        stored = load_grasps(folder / grasps.object / f"{grasps.hand}.safetensors")
        _same([grasps], [stored])
        assert (record.hand, record.object, record.validated) == (grasps.hand, grasps.object, len(grasps))
        assert record.wanted == 2 and record.reason == "" and record.cpu_s > 0


@pytest.mark.parametrize("workers", [2, 3])
def test_the_grasps_have_the_same_bits_for_any_number_of_workers(collected, tmp_path, hands, objects, workers):
    _, sets, _ = collected
    seen = []
    again, _ = collect_grasps(
        tmp_path, hands, objects, config=CONFIG, seed=1, workers=workers, progress=lambda *p: seen.append(p)
    )
    _same(sets, again)
    assert [p[0] for p in seen] == [1, 2, 3, 4] and {p[1] for p in seen} == {4}


def test_a_second_run_makes_nothing_again(collected, hands, objects, monkeypatch):
    folder, sets, records = collected
    before = {p: p.stat().st_mtime_ns for p in folder.rglob("*.*")}
    monkeypatch.setattr("neuralgrasps.dataset.collect.synthesise", None)
    seen = []
    again, found = collect_grasps(folder, hands, objects, config=CONFIG, seed=1, progress=lambda *p: seen.append(p))
    _same(sets, again)
    assert found == records
    assert {p: p.stat().st_mtime_ns for p in folder.rglob("*.*")} == before
    assert seen == [(4, 4, "kept from an earlier run")]


def _remade(folder, hands, objects, monkeypatch, **changes):
    """Names of the pairs that another run synthesises."""
    made = []

    def spy(hand, obj, **arguments):
        made.append((obj.name, hand.name))
        return synthesise(hand, obj, **arguments)

    monkeypatch.setattr("neuralgrasps.dataset.collect.synthesise", spy)
    arguments = {"config": CONFIG, "seed": 1, "workers": 1} | changes
    collect_grasps(folder, hands, objects, **arguments)
    return made


@pytest.fixture
def copy(collected, tmp_path):
    folder, _, _ = collected
    for path in folder.rglob("*.*"):
        target = tmp_path / path.relative_to(folder)
        target.parent.mkdir(exist_ok=True)
        target.write_bytes(path.read_bytes())
    return tmp_path


def test_an_interrupted_run_goes_on_with_what_is_missing_or_damaged(copy, hands, objects, monkeypatch):
    (copy / "ball" / "panda.safetensors").unlink()
    (copy / "slab" / "panda.json").unlink()
    damaged = copy / "slab" / "fetch.safetensors"
    damaged.write_bytes(damaged.read_bytes()[:-20])
    (copy / "ball" / "fetch.json").write_text("[]")
    made = _remade(copy, hands, objects, monkeypatch)
    assert sorted(made) == [("ball", "fetch"), ("ball", "panda"), ("slab", "fetch"), ("slab", "panda")]
    assert _remade(copy, hands, objects, monkeypatch) == []


@pytest.mark.parametrize("change", ["seed", "config", "object", "hand"])
def test_grasps_of_something_else_are_not_taken_for_these(copy, hands, objects, monkeypatch, make_object, change):
    changes, objs, used = {}, objects[:1], hands[:1]
    if change == "seed":
        changes["seed"] = 2
    elif change == "config":
        changes["config"] = replace(CONFIG, friction=0.5)
    elif change == "object":
        objs = [make_object("ball", sphere_mesh(0.031, segments=32))]
    else:
        used = [replace(hands[0], parts=hands[0].parts[:-1])]
    assert _remade(copy, used, objs, monkeypatch, **changes) == [("ball", "panda")]


def _changed(value):
    """`value`, different by as little as there is."""
    match value:
        case np.ndarray():
            if not value.size:
                return np.concatenate([value, np.zeros((1, *value.shape[1:]), value.dtype)])
            other = value.copy()
            first = other.reshape(-1)[:1]
            first[...] = np.nextafter(first, np.inf) if other.dtype.kind == "f" else first + 1
            return other
        case bool():
            return not value
        case int() | float():
            return type(value)(value + 1)
        case str():
            return value + "x"
        case None:
            return (0.1, 0.2, 0.3, 1.0)
        case tuple():
            return (*value[:-1], _changed(value[-1])) if value else (0,)
        case _:
            assert is_dataclass(value)
            return _with(value, fields(value)[0].name)


def _with(instance, name):
    """A copy with one field changed, past all validation."""
    other = copies.copy(instance)
    object.__setattr__(other, name, _changed(getattr(instance, name)))
    return other


def _names(kind, *without):
    return [f.name for f in fields(kind) if f.name not in without]


@pytest.mark.parametrize("name", _names(Hand, *PROSE))
def test_every_field_of_the_hand_is_in_the_key(hands, objects, name):
    key = pair_key(hands[0], objects[0], CONFIG, 1)
    assert pair_key(replace(hands[0]), objects[0], CONFIG, 1) == key
    assert pair_key(_with(hands[0], name), objects[0], CONFIG, 1) != key


@pytest.mark.parametrize(
    ("part", "name"), [(kind, n) for kind in (KinematicTree, ConvexPart, Finger) for n in _names(kind)]
)
def test_every_field_of_what_a_hand_is_made_of_is_in_the_key(hands, objects, part, name):
    hand = hands[0]
    if part is KinematicTree:
        other = copies.copy(hand)
        object.__setattr__(other, "tree", _with(hand.tree, name))
    else:
        field = "parts" if part is ConvexPart else "fingers"
        other = replace(hand, **{field: (*getattr(hand, field)[:-1], _with(getattr(hand, field)[-1], name))})
    assert pair_key(other, objects[0], CONFIG, 1) != pair_key(hand, objects[0], CONFIG, 1)


@pytest.mark.parametrize("name", _names(ObjectModel, "symmetry", "provenance"))
def test_every_field_of_the_object_is_in_the_key(hands, objects, name):
    assert pair_key(hands[0], _with(objects[0], name), CONFIG, 1) != pair_key(hands[0], objects[0], CONFIG, 1)


@pytest.mark.parametrize("name", _names(SynthesisConfig, "protocol"))
def test_every_field_of_the_config_is_in_the_key(hands, objects, name):
    if name == "also":
        other = replace(CONFIG, also=("shake",))
        assert pair_key(hands[0], objects[0], other, 1) != pair_key(hands[0], objects[0], CONFIG, 1)
        return
    assert pair_key(hands[0], objects[0], _with(CONFIG, name), 1) != pair_key(hands[0], objects[0], CONFIG, 1)


@pytest.mark.parametrize(
    "names", [(n,) for n in _names(Protocol)] + [(k, n) for k in ("revolute", "prismatic") for n in _names(Actuation)]
)
def test_every_number_of_the_protocol_is_in_the_key(hands, objects, monkeypatch, names):
    before = pair_key(hands[0], objects[0], CONFIG, 1)
    old = protocols.PROTOCOLS[CONFIG.protocol]
    if len(names) == 1:
        new = _with(old, names[0])
    else:
        new = replace(old, **{names[0]: _with(getattr(old, names[0]), names[1])})
    monkeypatch.setattr(protocols, "PROTOCOLS", {**protocols.PROTOCOLS, CONFIG.protocol: new})
    assert pair_key(hands[0], objects[0], CONFIG, 1) != before


@pytest.mark.parametrize("name", ["libigl", "mujoco", "numba", "numpy"])
def test_the_version_of_every_engine_is_in_the_key(hands, objects, monkeypatch, name):
    before = pair_key(hands[0], objects[0], CONFIG, 1)
    monkeypatch.setattr(collect, "version", lambda one: version(one) + ("x" if one == name else ""))
    assert pair_key(hands[0], objects[0], CONFIG, 1) != before


def test_a_moved_palm_and_a_heavier_object_remake_the_pair(copy, hands, objects, monkeypatch):
    X_HP = hands[0].X_HP.copy()
    X_HP[2, 3] -= 0.03
    moved = replace(hands[0], X_HP=X_HP)
    assert _remade(copy, [moved], objects[:1], monkeypatch) == [("ball", "panda")]
    heavier = replace(objects[1], mass_kg=0.3)
    assert _remade(copy, hands[:1], [heavier], monkeypatch) == [("slab", "panda")]


def test_pairs_that_do_not_fit_are_empty_sets_with_a_reason_and_valid_json(tmp_path, hands, make_object):
    cube = make_object("cube", box_mesh([0.15, 0.15, 0.15]))
    (grasps,), (record,) = collect_grasps(tmp_path, hands[:1], [cube], config=CONFIG, workers=1)
    assert len(grasps) == 0 and "aperture 80 mm" in record.reason
    assert np.isnan(record.physics_success)

    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    json.loads((tmp_path / "cube" / "panda.json").read_text(), parse_constant=refuse)
    (_,), (again,) = collect_grasps(tmp_path, hands[:1], [cube], config=CONFIG, workers=1)
    assert np.isnan(again.physics_success) and again.reason == record.reason


def test_names_that_would_share_a_file_are_refused(tmp_path, hands, objects):
    with pytest.raises(InputError, match="panda"):
        collect_grasps(tmp_path, [hands[0], hands[0]], objects, config=CONFIG, workers=1)
    with pytest.raises(InputError, match="ball"):
        collect_grasps(tmp_path, hands, [objects[0], replace(objects[1], name="ball")], config=CONFIG, workers=1)
    with pytest.raises(InputError, match=r"\.\./ball"):
        collect_grasps(tmp_path, hands, [replace(objects[0], name="../ball")], config=CONFIG, workers=1)


def test_a_folder_that_cannot_be_written_is_a_storage_error(tmp_path, hands, objects):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError):
        collect_grasps(tmp_path / "file", hands[:1], objects[:1], config=CONFIG, workers=1)


def test_a_record_holds_the_numbers_of_its_synthesis(hands, objects):
    result = synthesise(hands[0], objects[0], config=CONFIG, seed=1)
    record = record_of(result, 2)
    assert record.valid == result.outcomes["valid"] and record.tried == result.tried
    assert record.proposals == result.proposals and record.cpu_s == pytest.approx(sum(result.cpu_s.values()))
