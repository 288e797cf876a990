"""Fingerprints: every change of content changes them, nothing else does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.hands.fingerprint import fingerprint, hand_fingerprint
from neuralgrasps.hands.zoo import load_hand


def test_the_same_content_has_the_same_fingerprint():
    assert hand_fingerprint(load_hand("allegro")) == hand_fingerprint(load_hand("allegro"))
    assert fingerprint({"b": 1, "a": (2, None)}) == fingerprint({"a": [2, None], "b": 1})
    a = np.arange(12.0).reshape(3, 4)
    assert fingerprint(a) == fingerprint(np.asfortranarray(a))


def test_text_about_the_origin_does_not_count():
    hand = load_hand("panda")
    told = replace(hand, licence="other", provenance="elsewhere", extra={"repairs": "none"})
    assert hand_fingerprint(told) == hand_fingerprint(hand)


@pytest.mark.parametrize(
    ("a", "b"),
    [
        (np.zeros(4), np.zeros((2, 2))),
        (np.zeros(2), np.zeros(2, np.float32)),
        (np.zeros(2), np.array([0.0, 5e-324])),
        ((1, (2, 3)), ((1, 2), 3)),
        (("ab", "c"), ("a", "bc")),
        ((), None),
        ((1,), ("1",)),
        (True, 1),
        ({"a": "b"}, {"b": "a"}),
        ([[1], []], [[], [1]]),
    ],
)
def test_different_content_has_another_fingerprint(a, b):
    assert fingerprint(a) != fingerprint(b)


@pytest.mark.parametrize("value", [object(), {"f": print}, np.array([object()]), {1, 2}])
def test_what_cannot_be_compared_is_refused(value):
    with pytest.raises(TypeError, match="hash"):
        fingerprint(value)
