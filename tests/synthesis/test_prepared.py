"""Prepared hands and surfaces are kept by content, and only so many of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.synthesis.prepared import _MOST_KEPT, Memory, prepare_hand, prepare_surface


def test_equal_hands_share_and_other_hands_do_not(hands):
    hand = hands["panda"]
    first = prepare_hand(hand, spacing=0.006)
    assert prepare_hand(replace(hand, provenance="elsewhere"), spacing=0.006) is first
    assert prepare_hand(hand, spacing=0.007) is not first
    other = prepare_hand(replace(hand, closing_rate=2.0 * hand.closing_rate), spacing=0.006)
    assert other is not first
    np.testing.assert_array_equal(other.packed.closing_rate, 2.0 * first.packed.closing_rate)


def test_surfaces_are_told_apart_by_their_mesh():
    small, large = box_mesh([0.01, 0.02, 0.03]), box_mesh([0.01, 0.02, 0.031])
    assert prepare_surface(small) is prepare_surface(box_mesh([0.01, 0.02, 0.03]))
    assert np.ptp(prepare_surface(large).points[:, 2]) > np.ptp(prepare_surface(small).points[:, 2])


def test_the_longest_unused_goes_first():
    memory, made = Memory(), []

    def make(key):
        return memory.get(key, lambda: made.append(key) or [key])

    for i in range(_MOST_KEPT):
        make(str(i))
    assert make("0") == ["0"] and made.count("0") == 1
    make("new")
    make("0")
    make("1")
    assert made.count("0") == 1 and made.count("1") == 2
