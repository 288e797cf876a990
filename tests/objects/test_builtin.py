from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.geometry.mesh import convex_hull, is_closed, is_manifold, mass_properties
from neuralgrasps.objects.builtin import STAND_INS, find_stand_in

# Published, in millimetres and grams, written down again on purpose.
PUBLISHED = {
    "cracker_box": ((60, 158, 210), 411),
    "tomato_soup_can": ((66, 66, 101), 349),
    "mustard_bottle": ((58, 95, 190), 603),
    "pudding_box": ((35, 110, 89), 187),
    "gelatin_box": ((28, 85, 73), 97),
    "potted_meat_can": ((50, 97, 82), 370),
    "bleach_cleanser": ((65, 98, 250), 1131),
}


def test_there_are_the_seven():
    assert set(STAND_INS) == set(PUBLISHED)


@pytest.mark.parametrize("name", PUBLISHED)
def test_size_mass_and_place_are_as_published(name: str):
    stand_in = STAND_INS[name]
    mesh = stand_in.build(stand_in.size_m)
    size_mm, mass_g = PUBLISHED[name]
    np.testing.assert_allclose(mesh.extents * 1e3, size_mm, atol=0.01)
    np.testing.assert_allclose(mesh.bounds.sum(axis=0), 0.0, atol=1e-6)
    assert stand_in.mass_kg == pytest.approx(mass_g * 1e-3)


@pytest.mark.parametrize("name", PUBLISHED)
def test_mesh_is_a_solid_of_a_sane_volume(name: str):
    stand_in = STAND_INS[name]
    mesh = stand_in.build(stand_in.size_m)
    assert is_closed(mesh) and is_manifold(mesh)
    volume = mass_properties(mesh).volume
    assert 0.5 * mesh.extents.prod() < volume < mesh.extents.prod()
    density = stand_in.mass_kg / volume
    assert 150 < density < 1500
    assert 2000 < len(mesh.faces) < 12000


@pytest.mark.parametrize("name", ["mustard_bottle", "bleach_cleanser"])
def test_bottles_have_a_neck(name: str):
    stand_in = STAND_INS[name]
    mesh = stand_in.build(stand_in.size_m)
    hull = mass_properties(type(mesh)(*convex_hull(mesh.vertices))).volume
    assert mass_properties(mesh).volume < 0.985 * hull


def test_content_hash_does_not_change_with_the_run_or_the_last_bits():
    stand_in = STAND_INS["bleach_cleanser"]
    first, again = stand_in.build(stand_in.size_m), stand_in.build(stand_in.size_m)
    assert first.content_hash() == again.content_hash()
    np.testing.assert_array_equal(first.vertices, np.round(first.vertices, 7))


def test_ycb_ids_are_aliases():
    assert find_stand_in("003_cracker_box") is STAND_INS["cracker_box"]
    assert find_stand_in("no_such") is None
