"""The whole synthesis: proven grasps, one seed one result, and plain words where nothing fits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.errors import InputError, UnknownNameError
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.grasps.grasp_set import array_fields
from neuralgrasps.sim.validate import validate_grasps
from neuralgrasps.synthesis.candidates import make_problem
from neuralgrasps.synthesis.select import grasp_features
from neuralgrasps.synthesis.synthesise import SynthesisConfig, synthesise

SMALL = SynthesisConfig(count=4, batch=300, draws=1, max_rounds=3, spare=1.0, generations=1, children=3)


@pytest.mark.parametrize(("name", "solid"), [("panda", "box"), ("barrett", "can")])
def test_every_grasp_is_proven_distinct_and_complete(hands, solids, name, solid):
    hand, obj = hands[name], solids[solid]
    seen: list[tuple[int, int]] = []
    result = synthesise(hand, obj, config=SMALL, seed=1, progress=lambda *n: seen.append(n))
    grasps = result.grasps
    assert result.converged and result.reason == "" and len(grasps) >= SMALL.count
    assert (grasps.hand, grasps.object, grasps.seed) == (name, solid, 1)
    assert grasps.validated.all()
    assert validate_grasps(hand, obj, grasps, SMALL.protocol).success.all()
    assert seen[-1] == (SMALL.count, SMALL.count)
    assert result.tried >= result.validated == len(grasps) and 0 < result.physics_success <= 1
    assert sum(result.outcomes.values()) == result.proposals > 0
    assert grasps.config["count"] == "4" and grasps.config["protocol"] == "dexgraspbench"
    features = grasp_features(hand, grasps.X_OH, grasps.q)
    gap = np.linalg.norm(features[:, None] - features, axis=-1) + np.eye(len(features))
    assert gap.min() > 0.003
    assert grasps.epsilon[0] == grasps.epsilon.max()


def test_one_seed_one_result_and_another_seed_another(hands, solids):
    first, same, other = (synthesise(hands["panda"], solids["ball"], config=SMALL, seed=s).grasps for s in (5, 5, 6))
    for name in ("X_OH", "q", "q_pregrasp", "q_squeeze", "contact_points_O", "epsilon"):
        np.testing.assert_array_equal(getattr(first, name), getattr(same, name))
    assert first.X_OH.shape != other.X_OH.shape or (first.X_OH != other.X_OH).any()


@pytest.mark.parametrize(("name", "solid"), [("fetch", "box"), ("allegro", "can")])
def test_threads_change_nothing(hands, solids, name, solid):
    alone = synthesise(hands[name], solids[solid], config=SMALL, seed=3)
    beside = synthesise(hands[name], solids[solid], config=SMALL, seed=3, threads=3)
    assert alone.outcomes == beside.outcomes and alone.tried == beside.tried
    for field in array_fields():
        np.testing.assert_array_equal(getattr(alone.grasps, field), getattr(beside.grasps, field))


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_power_and_precision_grasps_come_in_the_share_asked_for(hands, solids, share):
    config = replace(SMALL, batch=500, draws=3, power_share=share)
    result = synthesise(hands["barrett"], solids["can"], config=config, seed=2)
    assert result.converged and result.grasps.validated.all()
    assert (~result.grasps.precision).sum() == round(share * config.count)
    assert (result.grasps.finger_count > 0).all()


def test_other_protocols_are_stored_beside_the_one_that_decides(hands, solids):
    config = replace(SMALL, also=("dexgraspbench-hard", "shake"))
    grasps = synthesise(hands["panda"], solids["box"], config=config, seed=1).grasps
    assert set(grasps.verdicts) == {"dexgraspbench", "dexgraspbench-hard", "shake"}
    assert grasps.protocol == "dexgraspbench" and grasps.validated.all()
    assert grasps.verdicts["dexgraspbench-hard"].parameters["friction"] == pytest.approx(0.3)
    again = validate_grasps(hands["panda"], solids["box"], grasps, "shake")
    np.testing.assert_array_equal(grasps.succeeded("shake"), again.success)
    np.testing.assert_array_equal(grasps.verdicts["shake"].displacement_m, again.displacement_m)


def test_a_jaw_has_one_kind_of_grasp(hands, solids):
    either = synthesise(hands["panda"], solids["box"], config=replace(SMALL, power_share=1.0), seed=2)
    assert either.converged


def test_an_object_wider_than_the_jaw_says_so(hands, solids):
    result = synthesise(hands["panda"], solids["cube"], config=SMALL)
    assert not result.converged and len(result.grasps) == 0 and result.tried == 0
    assert np.isnan(result.physics_success)
    assert result.reason == "too wide: narrowest graspable width 300 mm, aperture 80 mm"


def test_a_hand_that_cannot_span_the_object_says_what_fails(hands, solids):
    config = SynthesisConfig(count=3, batch=60, draws=1, max_rounds=4, generations=0, children=1)
    result = synthesise(hands["allegro"], solids["cube"], config=config)
    assert not result.converged
    assert result.reason.startswith("too wide: narrowest graspable width 300 mm, fingers span")
    assert len(result.grasps) == result.validated


def test_a_slab_thicker_than_the_jaw_in_two_ways_is_grasped_the_third(hands, make_object):
    slab = make_object("slab", box_mesh([0.1, 0.1, 0.01]))
    result = synthesise(hands["panda"], slab, config=SMALL)
    assert result.converged
    closing_O = result.grasps.X_OH[:, :3, :3] @ hands["panda"].X_HP[:3, 0]
    assert (np.abs(closing_O[:, 2]) > 0.85).all()


def test_the_same_bits_whatever_other_objects_were_made_before(hands, solids):
    alone = synthesise(hands["fetch"], solids["box"], config=SMALL, seed=2).grasps
    synthesise(hands["panda"], solids["ball"], config=SMALL, seed=9)
    after = synthesise(hands["fetch"], solids["box"], config=SMALL, seed=2).grasps
    np.testing.assert_array_equal(alone.X_OH, after.X_OH)


@pytest.mark.parametrize(
    ("field", "value"),
    [("count", 0), ("batch", 0), ("spare", -1), ("power_share", 1.1), ("draws", 0), ("generations", -1),
     ("friction", 0.0), ("friction", 9.0),
     ("max_penetration_m", -1e-3), ("contact_threshold_m", float("nan"))],
)  # fmt: skip
def test_bad_settings_are_named(field, value):
    with pytest.raises(InputError, match=field):
        SynthesisConfig(**{field: value})


def test_an_unknown_protocol_is_refused_at_once():
    with pytest.raises(UnknownNameError, match="dexgraspbench"):
        SynthesisConfig(protocol="dexgraspbenhc")


@pytest.mark.parametrize(
    ("given", "friction", "torsion"),
    [({}, 0.6, 0.02), ({"protocol": "dexgraspbench-hard"}, 0.3, 0.01), ({"protocol": "shake"}, 0.45, 0.02),
     ({"protocol": "dexgraspbench-hard", "friction": 0.5, "torsion_m": 0.0}, 0.5, 0.0)],
)  # fmt: skip
def test_friction_is_the_protocols_unless_given_and_is_recorded(hands, solids, monkeypatch, given, friction, torsion):
    seen = []

    def spy(*args, **kwargs):
        seen.append((kwargs["friction"], kwargs["torsion"]))
        return make_problem(*args, **kwargs)

    monkeypatch.setattr("neuralgrasps.synthesis.synthesise.make_problem", spy)
    obj = replace(solids["box"], friction=0.45)
    grasps = synthesise(hands["panda"], obj, config=replace(SMALL, **given), seed=1).grasps
    assert seen == [(friction, torsion)]
    assert (float(grasps.config["friction"]), float(grasps.config["torsion_m"])) == (friction, torsion)
