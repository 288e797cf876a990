"""Drawn contacts: put on the surface, and how many of them a hand touches."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from neuralgrasps.apply.drawn_contacts import TOUCHED_M, on_surface, reach, touched_text
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.hands.surface import hand_part_meshes
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.objects.object_model import ObjectModel


def test_points_are_put_on_the_nearest_place_of_the_surface(make_object: Callable[..., ObjectModel]) -> None:
    obj = make_object("brick", box_mesh(np.array([0.02, 0.03, 0.06])))
    nearest, off = on_surface(obj, np.array([[0.05, 0.01, 0.0], [0.0, 0.0, 0.06]]))
    assert nearest == pytest.approx(np.array([[0.02, 0.01, 0.0], [0.0, 0.0, 0.06]]), abs=1e-9)
    assert off == pytest.approx([0.03, 0.0], abs=1e-9)


def test_a_point_is_touched_when_the_hands_surface_is_near_it() -> None:
    hand = load_hand("panda")
    q = hand.q_open
    highest = max((m.vertices[m.vertices[:, 2].argmax()] for m in hand_part_meshes(hand, q)), key=lambda p: p[2])
    points = highest + np.array([[0, 0, 0.001], [0, 0, 0.03]])
    distance = reach(hand, np.eye(4)[None], q[None], points)
    assert distance == pytest.approx(np.array([[0.001, 0.03]]), abs=3e-4)
    assert touched_text(distance[0]) == "1 of 2"
    assert touched_text(np.array([TOUCHED_M + 1e-6])) == "0 of 1"
