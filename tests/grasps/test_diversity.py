"""Variety of grasp sets whose answers are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.grasps.diversity import approach_coverage, grasp_diversity

CAP = (1 - np.cos(np.deg2rad(30.0))) / 2  # share of the sphere within 30 degrees of one direction


def about(axis: str, *degrees: float) -> Rotation:
    return Rotation.from_euler(axis, np.array(degrees)[:, None], degrees=True)


def turned(jaw, rotations: Rotation) -> np.ndarray:
    """Hand poses whose palm has the orientations `rotations` in the object frame."""
    X_OP = np.tile(np.eye(4), (len(rotations), 1, 1))
    X_OP[:, :3, :3] = rotations.as_matrix()
    return X_OP @ np.linalg.inv(jaw.X_HP)


def diversity(hand, X_OH):
    return grasp_diversity(hand, X_OH, np.zeros((len(X_OH), 2)), length=0.05)


def test_diversity_of_equal_and_of_spread_grasps(jaw, X_OH):
    rng = np.random.default_rng(0)
    same = np.tile(X_OH, (50, 1, 1))
    q = np.full((50, 2), 0.02)
    none = grasp_diversity(jaw, same, q, length=0.05)
    assert none.entropy_bits == 0.0
    assert (none.explained == 0).all()
    assert none.nearest_approach_rad == none.nearest_rotation_rad == 0.0
    assert none.approach_coverage == pytest.approx(CAP, abs=0.01)
    along = same.copy()
    along[:, 1, 3] = rng.uniform(-0.03, 0.03, 50)
    shifted = grasp_diversity(jaw, along, q, length=0.05)
    assert shifted.explained[0] == pytest.approx(1.0)
    assert shifted.nearest_rotation_rad == 0.0  # positions do not enter
    two_values = np.repeat([[0.0, 0.0], [0.02, 0.03]], 25, axis=0)
    assert grasp_diversity(jaw, same, two_values, length=0.05).entropy_bits == pytest.approx(1.0)


def test_approaches_along_the_axes_cover_six_caps() -> None:
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    assert approach_coverage(axes) == pytest.approx(6 * CAP, abs=0.02)
    assert approach_coverage(axes[:3]) == pytest.approx(3 * CAP, abs=0.02)
    assert approach_coverage(np.repeat(axes, 7, axis=0)) == approach_coverage(axes)
    assert approach_coverage(np.zeros((0, 3))) == 0.0
    everywhere = Rotation.random(3000, random_state=0).as_matrix()[:, :, 2]
    assert approach_coverage(everywhere) == 1.0


@pytest.mark.parametrize("degrees", [1e-5, 1.0, 40.0, 170.0])
def test_nearest_angles_of_a_turn_about_the_closing_axis(jaw, degrees) -> None:
    pair = about("x", 0.0, degrees)
    found = diversity(jaw, turned(jaw, pair))
    assert np.rad2deg(found.nearest_rotation_rad) == pytest.approx(degrees, rel=1e-6)
    assert np.rad2deg(found.nearest_approach_rad) == pytest.approx(degrees, rel=1e-6)


def test_a_roll_about_the_approach_changes_the_rotation_only_and_half_a_turn_of_a_jaw_nothing(jaw) -> None:
    for degrees, of_jaw in ((50.0, 50.0), (130.0, 50.0), (180.0, 0.0)):
        X_OH = turned(jaw, about("z", 0.0, degrees))
        hand = replace(jaw, is_jaw=False)
        assert np.rad2deg(diversity(jaw, X_OH).nearest_rotation_rad) == pytest.approx(of_jaw, abs=1e-5)
        assert np.rad2deg(diversity(hand, X_OH).nearest_rotation_rad) == pytest.approx(degrees)
        assert diversity(hand, X_OH).nearest_approach_rad == pytest.approx(0.0, abs=1e-7)


def test_the_median_is_over_the_nearest_neighbours(jaw) -> None:
    # neighbours at 10, 10, 20 (to the second) and 90 degrees
    X_OH = turned(jaw, about("x", 0.0, 10.0, 30.0, 120.0))
    assert np.rad2deg(diversity(jaw, X_OH).nearest_rotation_rad) == pytest.approx(15.0)


def test_diversity_does_not_depend_on_the_objects_frame_but_for_the_200_directions(jaw) -> None:
    X_OH = turned(jaw, Rotation.random(30, random_state=1))
    move = np.eye(4)
    move[:3, :3] = Rotation.random(random_state=2).as_matrix()
    here, there = diversity(jaw, X_OH), diversity(jaw, move @ X_OH)
    assert there.nearest_rotation_rad == pytest.approx(here.nearest_rotation_rad)
    assert there.nearest_approach_rad == pytest.approx(here.nearest_approach_rad)
    assert there.approach_coverage == pytest.approx(here.approach_coverage, abs=0.05)


def test_wrong_input_is_refused(jaw, X_OH):
    with pytest.raises(InputError, match="at least 2"):
        grasp_diversity(jaw, X_OH[None], np.zeros((1, 2)), length=0.05)
    with pytest.raises(ShapeError):
        grasp_diversity(jaw, X_OH[None], np.zeros((1, 3)), length=0.05)
    with pytest.raises(ShapeError):
        approach_coverage(np.zeros((4, 2)))
