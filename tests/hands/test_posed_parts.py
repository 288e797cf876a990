"""The part of a posed hand that is nearest to a point, against the plain distance."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.hands.packed import hand_distance, pack_shapes, part_distance_H, pose_links
from neuralgrasps.hands.posed_parts import gradient_in_H, nearest_of_parts, part_poses_H
from neuralgrasps.hands.zoo import load_hand


@pytest.mark.parametrize("name", ["human", "allegro", "panda"])
def test_nearest_part_and_gradient(name: str) -> None:
    packed, rng = pack_shapes(load_hand(name)), np.random.default_rng(0)
    q, count = rng.uniform(packed.lower, packed.upper), len(packed.part_link)
    X_HL, X_PH, centre_H = np.empty((len(packed.parents), 4, 4)), np.empty((count, 3, 4)), np.empty((count, 3))
    pose_links(packed, q, X_HL)
    part_poses_H(packed, X_HL, X_PH, centre_H)
    for x, y, z in 0.15 * rng.standard_normal((60, 3)):
        distance, part = nearest_of_parts(packed, X_PH, centre_H, rng.integers(count), x, y, z)
        assert distance == pytest.approx(hand_distance(packed, X_HL, x, y, z), abs=1e-12)
        slope = [
            (part_distance_H(packed, X_HL, part, x + a, y + b, z + c)
             - part_distance_H(packed, X_HL, part, x - a, y - b, z - c)) / 2e-6
            for a, b, c in 1e-6 * np.eye(3)
        ]  # fmt: skip
        np.testing.assert_allclose(gradient_in_H(packed, X_PH, part, x, y, z), slope, atol=1e-3)
