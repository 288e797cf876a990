"""Lifting from a table: what holds does, what cannot does not, and the margin of friction is one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.plane import Plane, standing_on
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.sim.table_lift import LiftConfig, try_lifts

from .toy import HALF, toy_box, toy_grasps

# the toy hand looks along its z, so that it is above a box whose z points down
ON_Z_FACE = Plane(np.array([0.0, 0.0, -1.0]), float(HALF[2]))


def test_central_grasps_lift_and_misses_do_not(hand: Hand, box: ObjectModel) -> None:
    grasps = toy_grasps(hand, np.array([[0.0, 0.0, 0.1], [0.0, 0.005, 0.11], [0.0, 0.2, 0.1]]), obj=box)
    verdict = try_lifts(hand, box, grasps, ON_Z_FACE)
    assert verdict.success.tolist() == [True, True, False]
    assert (verdict.displacement_m[:2] < 0.003).all()
    assert verdict.displacement_m[2] == pytest.approx(0.1, abs=1e-3)  # left where it was
    assert verdict.parameters["friction"] == pytest.approx(0.75 * box.friction)


def test_weight_and_friction_decide(hand: Hand) -> None:
    """Two pads of 10 N each and friction 0.6 carry 12 N, at half the friction 6 N."""
    light, heavy = toy_box(mass_kg=0.8), toy_box(mass_kg=1.6)
    centre = np.array([[0.0, 0.0, 0.1]])

    def lifts(obj: ObjectModel, scale: float) -> bool:
        config = LiftConfig(friction_scale=scale)
        return bool(try_lifts(hand, obj, toy_grasps(hand, centre, obj=obj), ON_Z_FACE, config=config).success[0])

    assert lifts(light, 1.0) and not lifts(light, 0.5) and not lifts(heavy, 1.0)


def test_table_is_put_level() -> None:
    normal = np.array([0.6, 0.0, 0.8])
    plane = Plane(normal, 0.07)
    level = plane.moved(standing_on(plane))
    np.testing.assert_allclose(level.normal, [0, 0, 1], atol=1e-12)
    assert level.offset_m == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.det(standing_on(plane)[:3, :3]) == pytest.approx(1.0)


def test_same_verdict_twice_and_alone(hand: Hand, box: ObjectModel) -> None:
    grasps = toy_grasps(hand, np.array([[0.0, 0.0, 0.1], [0.0, 0.01, 0.1]]), obj=box)
    both = try_lifts(hand, box, grasps, ON_Z_FACE)
    alone = try_lifts(hand, box, grasps[1:], ON_Z_FACE)
    np.testing.assert_array_equal(both.displacement_m[1:], alone.displacement_m)


def test_wrong_settings_are_refused(hand: Hand, box: ObjectModel) -> None:
    with pytest.raises(InputError, match="friction_scale"):
        LiftConfig(friction_scale=0.0)
    grasps = replace(toy_grasps(hand, np.array([[0.0, 0.0, 0.1]]), obj=box), object="other")
    with pytest.raises(InputError, match="grasps are of"):
        try_lifts(hand, box, grasps, ON_Z_FACE)
