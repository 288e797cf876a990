"""Grasps for an object on a table: stored ones that clear it, new ones made once a resting pose, plain reasons."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.primitives import box_mesh, cylinder_mesh
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix
from neuralgrasps.grasps.grasp_set import GraspSet, array_fields
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.surface import sample_hand_surface
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.planning import grasp_cache, table_grasps
from neuralgrasps.planning.copies import moved_grasps, roll_twins, symmetric_copies
from neuralgrasps.planning.resting_plane import nearest_resting_plane, representative, resting_planes, rounded_plane
from neuralgrasps.planning.table_grasps import TableGraspConfig, TableGrasps, grasps_on_table
from neuralgrasps.sim.validate import validate_grasps
from neuralgrasps.synthesis.jaw import leaves_room
from neuralgrasps.synthesis.synthesise import SynthesisConfig, synthesise

SMALL = SynthesisConfig(batch=200, draws=2, max_rounds=4, generations=1, children=3, also=("shake",))
CONFIG = TableGraspConfig(synthesis=SMALL)


@pytest.fixture(scope="module")
def fetch() -> Hand:
    return load_hand("fetch")


@pytest.fixture(scope="module")
def box(make_object):
    """Flat, 28 mm high, and the table under it."""
    return make_object("gelatin", box_mesh([0.0365, 0.0425, 0.014]), symmetry=True)


@pytest.fixture(scope="module")
def can(make_object):
    return make_object("can", cylinder_mesh(0.033, 0.05, segments=64), symmetry=True)


@pytest.fixture(scope="module")
def stored(fetch, box) -> GraspSet:
    return synthesise(fetch, box, config=replace(SMALL, count=24, also=()), seed=5).grasps


UP = np.array([0.0, 0.0, 1.0])
FLAT = Plane(UP, 0.014)


def lowest_on_the_way_back(hand: Hand, grasps: GraspSet, plane: Plane, retreat: float) -> float:
    """Least height of even points of the hand, 5 mm apart, along the straight way back."""
    surface = sample_hand_surface(hand, spacing=0.005)
    least = np.inf
    for q in (grasps.q, grasps.q_pregrasp):
        X_OL = (grasps.X_OH[:, None] @ forward_numpy(hand.tree, q))[:, surface.links]
        points_O = np.einsum("nkij,kj->nki", X_OL[..., :3, :3], surface.points_L) + X_OL[..., :3, 3]
        back = -(grasps.X_OH[:, :3, :3] @ hand.X_HP[:3, 2])[:, None]
        least = min(least, *(plane.height(points_O + way * back).min() for way in np.linspace(0.0, retreat, 6)))
    return float(least)


def same(a: TableGrasps, b: TableGrasps) -> bool:
    names = [name for name in array_fields() if getattr(a.grasps, name).dtype.kind == "f"]
    return all(np.array_equal(getattr(a.grasps, n), getattr(b.grasps, n), equal_nan=True) for n in names)


@pytest.mark.parametrize("tilt", [0.0, 0.05])
def test_a_flat_box_gets_stored_grasps_that_clear_and_new_ones(fetch, box, stored, tilt):
    plane = Plane(np.array([0.0, np.sin(tilt), np.cos(tilt)]), 0.0145)
    found = grasps_on_table(fetch, box, plane, stored=stored, want=12, config=CONFIG)
    assert found.from_stored + found.made >= 10 and found.made > 0
    assert len(found.grasps) > found.from_stored + found.made  # and twins
    assert lowest_on_the_way_back(fetch, found.grasps, plane, CONFIG.retreat_m) >= CONFIG.clearance_m - 1e-9
    assert lowest_on_the_way_back(fetch, stored, plane, CONFIG.retreat_m) < 0.0
    shake = found.grasps.succeeded("shake")[found.from_stored : found.from_stored + found.made]
    assert (np.diff(shake.astype(int)) <= 0).all()  # those that hold their own weight first
    assert set(found.grasps.verdicts) == {"dexgraspbench", "shake"} and found.grasps.validated.all()
    assert leaves_room(fetch, found.grasps.q).all()


def test_stored_grasps_that_clear_come_first_and_suffice(fetch, box, stored, monkeypatch):
    monkeypatch.setattr(table_grasps, "synthesise", lambda *_, **__: pytest.fail("enough were stored"))
    standing = Plane(np.array([0.0, 1.0, 0.0]), 0.0425)
    found = grasps_on_table(fetch, box, standing, stored=stored, want=3, config=replace(CONFIG, use_symmetry=False))
    assert found.made == 0 and found.from_stored >= 3 and found.reason == ""
    for X in found.grasps.X_OH[: found.from_stored]:
        assert (np.abs(stored.X_OH - X).max(axis=(1, 2)) == 0.0).any()


def test_the_same_call_gives_equal_arrays_from_memory_from_disk_and_anew(fetch, box, stored, monkeypatch, tmp_path):
    monkeypatch.setenv("NEURALGRASPS_HOME", str(tmp_path))
    grasp_cache.forget()
    calls = []

    def counted(*args, **kwargs):
        calls.append(1)
        return synthesise(*args, **kwargs)

    monkeypatch.setattr(table_grasps, "synthesise", counted)
    results = []
    for forget in (False, False, True):
        if forget:
            grasp_cache.forget()
        results.append(grasps_on_table(fetch, box, FLAT, stored=stored, want=12, config=CONFIG))
    assert len(calls) == 1
    monkeypatch.setenv("NEURALGRASPS_HOME", str(tmp_path / "another"))
    grasp_cache.forget()
    results.append(grasps_on_table(fetch, box, FLAT, stored=stored, want=12, config=CONFIG))
    assert len(calls) == 2
    assert results[0].made > 0 and all(same(results[0], other) for other in results[1:])
    seen = grasps_on_table(fetch, box, Plane(UP, 0.0146), stored=stored, want=12, config=CONFIG)
    assert len(calls) == 2 and seen.made > 0  # the same resting pose, seen 0.6 mm higher
    grasps_on_table(fetch, box, FLAT, stored=stored, want=12, config=CONFIG, seed=1)
    assert len(calls) == 3


def test_a_damaged_cache_file_is_made_again(fetch, box, monkeypatch, tmp_path):
    monkeypatch.setenv("NEURALGRASPS_HOME", str(tmp_path))
    grasp_cache.forget()
    first = grasps_on_table(fetch, box, FLAT, stored=None, want=4, config=CONFIG)
    for path in tmp_path.rglob("*.safetensors"):
        path.write_bytes(b"no grasps")
    grasp_cache.forget()
    assert same(first, grasps_on_table(fetch, box, FLAT, stored=None, want=4, config=CONFIG))


def test_a_flat_box_that_no_jaw_spans_says_so(fetch, make_object):
    cracker = make_object("cracker", box_mesh([0.105, 0.079, 0.030]))
    found = grasps_on_table(fetch, cracker, Plane(UP, 0.030), stored=None, config=CONFIG)
    assert len(found.grasps) == 0 == found.made
    assert found.reason == (
        "too wide: lying on its 158 x 210 mm face: narrowest width across the table 158 mm, aperture 97 mm"
    )


def test_a_wide_grip_is_left_out(fetch, make_object):
    """97.6 mm fit the jaw of 100 mm, but 1.2 mm on either side are too little for an error of pose."""
    brick = make_object("brick", box_mesh([0.0488, 0.08, 0.08]))
    wide = synthesise(fetch, brick, config=replace(SMALL, count=6), seed=0).grasps
    mask = leaves_room(fetch, wide.q)
    assert len(wide) and not mask.all()
    found = grasps_on_table(fetch, brick, Plane(UP, 0.08), stored=wide, want=1, config=CONFIG)
    assert leaves_room(fetch, found.grasps.q).all()


def test_twins_hold_as_well_and_swap_the_fingers(fetch, box, stored):
    twins = roll_twins(fetch, stored)
    assert len(twins) == len(stored)
    pad = np.append(fetch.jaw_pad_H, 1.0)
    np.testing.assert_allclose(twins.X_OH @ pad, stored.X_OH @ pad, atol=1e-9)
    approach = fetch.X_HP[:3, 2]
    np.testing.assert_allclose(twins.X_OH[:, :3, :3] @ approach, stored.X_OH[:, :3, :3] @ approach, atol=1e-9)
    closing = fetch.X_HP[:3, 0]
    np.testing.assert_allclose(twins.X_OH[:, :3, :3] @ closing, -(stored.X_OH[:, :3, :3] @ closing), atol=1e-9)
    swapped = {1: 2, 2: 1, 0: 0, -1: -1}
    np.testing.assert_array_equal(twins.contact_links, np.vectorize(swapped.get)(stored.contact_links))
    assert validate_grasps(fetch, box, twins[:6], "dexgraspbench").success.mean() >= 5 / 6
    assert len(roll_twins(load_hand("barrett"), replace(stored, hand="barrett"))) == 0


def test_grasps_are_carried_over_by_the_symmetry(fetch, box, stored):
    assert len(box.symmetry) == 4
    copies = symmetric_copies(box, stored[:4])
    assert len(copies) == 12
    assert validate_grasps(fetch, box, copies, "dexgraspbench").success.mean() > 0.8
    back = moved_grasps(copies[:4], np.linalg.inv(box.symmetry.rotations[1]))
    np.testing.assert_allclose(back.X_OH, stored[:4].X_OH, atol=1e-9)
    np.testing.assert_allclose(back.contact_points_O, stored[:4].contact_points_O, atol=1e-9)


def test_symmetry_is_used_only_where_it_is_exact_enough(fetch, box, stored):
    rough = replace(box, symmetry=replace(box.symmetry, deviation_m=0.002))
    alone, copied = (
        grasps_on_table(fetch, obj, Plane(np.array([1.0, 0, 0]), 0.0365), stored=stored, want=20, config=CONFIG)
        for obj in (rough, box)
    )
    assert copied.from_stored > alone.from_stored
    off = grasps_on_table(
        fetch, box, Plane(np.array([1.0, 0, 0]), 0.0365), stored=stored, want=20,
        config=replace(CONFIG, use_symmetry=False),
    )  # fmt: skip
    assert off.from_stored == alone.from_stored


def test_a_can_that_lies_is_one_problem_however_it_is_rolled(fetch, can, monkeypatch):
    grasp_cache.forget()
    calls = []

    def counted(*args, **kwargs):
        calls.append(1)
        return synthesise(*args, **kwargs)

    monkeypatch.setattr(table_grasps, "synthesise", counted)
    for angle in (0.0, 1.0, 2.5):
        plane = Plane(np.array([np.cos(angle), np.sin(angle), 0.0]), 0.033)
        found = grasps_on_table(fetch, can, plane, stored=None, want=6, config=CONFIG, seed=11)
        assert len(calls) == 1 and found.made >= 4
        assert lowest_on_the_way_back(fetch, found.grasps, plane, CONFIG.retreat_m) >= CONFIG.clearance_m - 1e-9


def test_the_representative_is_the_same_plane_carried_by_the_symmetry(can, box):
    for obj, normal in ((can, [0.6, -0.8, 0.0]), (can, [0.0, 0.6, -0.8]), (box, [0.0, 0.0, -1.0])):
        plane = Plane(np.array(normal), 0.05)
        one, X = representative(obj, plane)
        back = one.moved(X)
        np.testing.assert_allclose(back.normal, plane.normal, atol=1e-9)
        assert back.offset_m == pytest.approx(plane.offset_m)
        for S in obj.symmetry.rotations[::5]:
            other, _ = representative(obj, plane.moved(S))
            np.testing.assert_allclose(other.normal, one.normal, atol=1e-3)


def test_an_object_that_leans_a_little_lies_on_its_face(box):
    lean = axis_angle_matrix(np.array([1.0, 0, 0]), 0.07)
    near = nearest_resting_plane(box, Plane(lean @ UP, 0.016))
    assert near is not None
    np.testing.assert_allclose(near.normal, UP, atol=1e-6)
    assert near.offset_m == pytest.approx(0.014, abs=1e-6)
    assert nearest_resting_plane(box, Plane(axis_angle_matrix(np.array([1.0, 0, 0]), 0.3) @ UP, 0.014)) is None
    assert nearest_resting_plane(box, Plane(UP, 0.030)) is None
    assert len(resting_planes(box)) == 6


def test_rounding_a_plane_moves_it_little():
    rng = np.random.default_rng(0)
    for _ in range(20):
        normal = rng.standard_normal(3)
        plane = Plane(normal / np.linalg.norm(normal), float(rng.uniform(-0.1, 0.1)))
        for finely, angle, way in ((False, 0.02, 6e-4), (True, 0.0025, 8e-5)):
            rounded = rounded_plane(plane, finely=finely)
            assert np.arccos(min(rounded.normal @ plane.normal, 1.0)) < angle
            assert abs(rounded.offset_m - plane.offset_m) < way


def test_bad_input_is_named(fetch, box, stored):
    with pytest.raises(InputError, match="want"):
        grasps_on_table(fetch, box, FLAT, stored=None, want=0)
    with pytest.raises(InputError, match="stored grasps are of hand 'panda'"):
        grasps_on_table(fetch, box, FLAT, stored=replace(stored, hand="panda"))
