"""What a transfer depends on: its seed, the table, verdicts on the grasps known, and the hand before it closes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.apply.transfer import TransferConfig, made_grasps, transfer
from neuralgrasps.apply.transfer_query import TransferQuery, query_from_grasp
from neuralgrasps.apply.transfer_search import SearchConfig
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.grasps.grasp_set import Verdict
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.sim.validate import verdict_parameters
from neuralgrasps.synthesis.support import Support
from tests.apply.conftest import BoxWorld

FEW = TransferConfig(count=2, trials=8, method="generate", search=SearchConfig(starts=2, generations=1))


@pytest.fixture(scope="module")
def query(box_world: BoxWorld) -> TransferQuery:
    grasps = box_world.grasps
    return query_from_grasp(box_world.hand, box_world.obj, grasps.X_OH[0], grasps.q[0])


def test_another_seed_searches_elsewhere(box_world: BoxWorld, query: TransferQuery) -> None:
    def searched(seed: int) -> np.ndarray:
        found = transfer(query, box_world.hand, box_world.obj, known=box_world.grasps, config=FEW, seed=seed)
        return np.asarray(found.grasps.X_OH)

    first = searched(0)
    np.testing.assert_array_equal(searched(0), first)
    assert any(not np.array_equal(searched(seed), first) for seed in (1, 2))


def test_grasps_made_for_another_seed_or_table_are_others(box_world: BoxWorld) -> None:
    hand, obj, config = load_hand("fetch"), box_world.obj, TransferConfig(synthesise=4)
    table = Support(plane=Plane(np.array([0.0, 0.0, 1.0]), float(-obj.mesh.bounds[0, 2])))
    first = made_grasps(hand, obj, config, support=None, seed=0)
    assert not np.array_equal(made_grasps(hand, obj, config, support=None, seed=1).X_OH, first.X_OH)
    above = made_grasps(hand, obj, config, support=table, seed=0)
    assert table.allows(hand, above.X_OH, above.q, above.q_pregrasp).all()
    ceiling = Support(plane=Plane(np.array([0.0, 0.0, -1.0]), float(obj.mesh.bounds[1, 2])))
    below = made_grasps(hand, obj, config, support=ceiling, seed=0)
    assert ceiling.allows(hand, below.X_OH, below.q, below.q_pregrasp).all()
    assert not np.array_equal(below.X_OH, above.X_OH)


def test_grasps_that_were_let_fall_are_no_starts(box_world: BoxWorld, query: TransferQuery) -> None:
    hand, obj, grasps = box_world.hand, box_world.obj, box_world.grasps
    count = len(grasps)
    held = np.arange(count) % 2 == 1
    verdict = Verdict(
        success=held, displacement_m=np.zeros(count), rotation_rad=np.zeros(count),
        parameters=verdict_parameters(hand, obj, "dexgraspbench"),
    )  # fmt: skip
    known = replace(grasps, verdicts={"dexgraspbench": verdict}, protocol="dexgraspbench")
    config = TransferConfig(method="retrieve", count=count, apart_m=0.0, per_source=None)
    result = transfer(query, hand, obj, known=known, config=config)
    assert result.tried == 0 and len(result.grasps) <= held.sum()
    kept = grasps.X_OH[held]
    for X in result.grasps.X_OH:
        assert np.abs(kept - X).max(axis=(1, 2)).min() < 1e-9
    best = np.abs(grasps.X_OH[~held] - result.grasps.X_OH[0]).max(axis=(1, 2)).min()
    assert best > 1e-3 and result.oracle < 1.0  # the query itself was let fall


def test_known_grasps_must_be_allowed_before_they_close_too(box_world: BoxWorld, query: TransferQuery) -> None:
    class NoPregrasp:
        """Allows every closed hand, and none whose hand before closing is told."""

        def allows(self, hand, X_OH, q, q_pregrasp=None):  # type: ignore[no-untyped-def]
            return np.full(len(X_OH), q_pregrasp is None)

    config = TransferConfig(method="retrieve", count=2)
    result = transfer(
        query, box_world.hand, box_world.obj, known=box_world.grasps, config=config, constraints=NoPregrasp()
    )
    assert len(result.grasps) == 0 and np.isnan(result.oracle) and result.tried == 0
