"""Colours: one per hand, apart for every colour vision, and a contact scale whose order cannot be misread."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from neuralgrasps.hands.zoo import hand_names
from neuralgrasps.report.palette import (
    HAND_COLOURS,
    OBJECT_COLOUR,
    contact_colours,
    contact_gradient,
    from_oklab,
    hand_colour,
    hex_colour,
    linear_rgb,
    linear_to_srgb,
    mix,
    oklab,
    srgb_to_linear,
)

# Machado, Oliveira and Fernandes 2009, severity 1, linear RGB.
VISION = {
    "normal": np.eye(3),
    "protan": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deutan": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritan": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}


def test_every_built_in_hand_has_its_own_colour():
    assert set(hand_names()) == set(HAND_COLOURS)
    assert len(set(HAND_COLOURS.values())) == len(HAND_COLOURS)


def test_an_unknown_hand_always_gets_the_same_colour():
    assert hand_colour("my_gripper") == hand_colour("my_gripper")
    assert hand_colour("my_gripper") not in HAND_COLOURS.values()


@pytest.mark.parametrize("vision", VISION)
def test_hand_colours_stay_apart_for_every_colour_vision(vision):
    seen = {n: oklab(np.clip(VISION[vision] @ linear_rgb(c), 0, 1)) for n, c in HAND_COLOURS.items()}
    distance = {(a, b): np.linalg.norm(seen[a] - seen[b]) for a, b in itertools.combinations(seen, 2)}
    nearest = min(distance, key=distance.get)
    assert distance[nearest] > 0.10, f"{nearest} are {distance[nearest]:.3f} apart"


def test_srgb_round_trip():
    levels = np.linspace(0, 1, 256)
    np.testing.assert_allclose(linear_to_srgb(srgb_to_linear(levels)), levels, atol=1e-12)
    assert hex_colour(linear_rgb("#12ab9f")) == "#12ab9f"
    assert srgb_to_linear(np.array(0.5)) == pytest.approx(0.21404, abs=1e-5)


def test_oklab_known_values_and_round_trip():
    np.testing.assert_allclose(oklab(np.ones(3)), [1, 0, 0], atol=1e-6)
    rng = np.random.default_rng(0)
    colours = rng.random((100, 3))
    np.testing.assert_allclose(from_oklab(oklab(colours)), colours, atol=1e-9)
    np.testing.assert_allclose(mix(np.zeros(3), np.ones(3), 1.0), 1.0, atol=1e-6)


def test_contact_scale_darkens_steadily():
    lightness = oklab(contact_colours(np.linspace(0, 1, 101)))[:, 0]
    assert (np.diff(lightness) < 0).all()
    assert lightness[0] - lightness[-1] > 0.5


def test_no_contact_looks_like_the_bare_object():
    bare, none = oklab(linear_rgb(OBJECT_COLOUR)), oklab(contact_colours(np.array([0.0]))[0])
    assert np.linalg.norm(bare - none) < 0.04
    np.testing.assert_array_equal(
        contact_colours(np.array([np.nan, -1.0, 2.0])), contact_colours(np.array([0, 0, 1.0]))
    )
    assert contact_gradient(3).count("#") == 3
