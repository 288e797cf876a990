"""Grasps aimed at what may be touched, where the known ones touch elsewhere."""

from __future__ import annotations

import numpy as np

from neuralgrasps.apply.constrained_grasps import aimed_object, with_constrained
from neuralgrasps.apply.constraints import GraspConstraints
from neuralgrasps.apply.regions import Ball, Side
from tests.apply.conftest import BoxWorld


def test_new_grasps_touch_only_there(box_world: BoxWorld) -> None:
    hand, known = box_world.hand, box_world.grasps
    rules = GraspConstraints(obj=box_world.obj, only_region=(Side("top", 0.4),))
    both = with_constrained(rules, hand, known, protocol=known.protocol, enough=len(known) + 1, seed=2)
    made = both[len(known) :]
    assert np.array_equal(both.X_OH[: len(known)], known.X_OH) and len(made) >= 4
    assert rules.allows(hand, made.X_OH, made.q, made.q_pregrasp).all() and made.validated.all()
    touched = made.contact_points_O[made.contact_links >= 0]
    assert touched[:, 2].min() > 0.06 - 0.4 * 0.12 - 0.002
    again = with_constrained(rules, hand, known, protocol=known.protocol, enough=len(known) + 1, seed=2)
    assert np.array_equal(again.X_OH, both.X_OH)
    assert both.object == known.object


def test_enough_known_grasps_stay_alone(box_world: BoxWorld) -> None:
    rules = GraspConstraints(
        obj=box_world.obj, approach=None, keep_free=(Ball((0.02, 0.0, 0.06), 0.002),), margin_m=0.0
    )
    known = box_world.grasps
    met = int(rules.allows(box_world.hand, known.X_OH, known.q, known.q_pregrasp).sum())
    assert with_constrained(rules, box_world.hand, known, protocol=known.protocol, enough=met) is known


def test_it_aims_at_what_may_be_touched(box_world: BoxWorld) -> None:
    obj = box_world.obj
    only = aimed_object(GraspConstraints(obj=obj, only_region=(Side("top", 0.4),)))
    free = aimed_object(GraspConstraints(obj=obj, keep_free=(Side("top", 0.4),)))
    assert only is not None and free is not None and len(only.points_O) + len(free.points_O) == len(obj.points_O)
    assert only.points_O[:, 2].min() >= 0.012 >= free.points_O[:, 2].max()
    assert len({only.content_hash, free.content_hash, obj.content_hash}) == 3
    assert aimed_object(GraspConstraints(obj=obj, only_region=(Ball((0.02, 0.0, 0.0), 0.001),))) is None
