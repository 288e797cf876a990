import inspect
from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.apply.novel import NovelResult, decode_novel, novel_grasps
from neuralgrasps.apply.novel_trial import HELD, NovelConfig
from neuralgrasps.errors import InputError, UnknownNameError
from neuralgrasps.evaluate.novel_bench import measure_novel
from neuralgrasps.grasps.grasp_io import load_grasps, save_grasps
from tests.apply.conftest import BoxWorld

PAIR = {"hand": "panda", "object_name": "brick"}


def check_result(result: NovelResult, count: int) -> None:
    assert sum(result.counts.values()) == len(result.outcome) == len(result.codes) == count
    assert result.counts["held"] == len(result.grasps) == len(result.code) == int((result.outcome == HELD).sum())
    assert result.held_share == result.counts["held"] / count <= result.force_closure_share
    assert len(result.grasps) == 0 or result.grasps.validated.all()
    reached = result.outcome >= HELD - 1
    for values in (result.contact_change, result.palm_shift_m, result.palm_turn_rad, result.novelty_m):
        assert np.isfinite(values[reached]).all() and np.isnan(values[~reached]).all()


def test_codes_of_known_grasps_come_back_and_hold(box_world: BoxWorld) -> None:
    result = novel_grasps(box_world.field, box_world.book, **PAIR, config=NovelConfig(spread=0.0, count=8, search=0))
    check_result(result, 8)
    assert result.held_share == 1.0
    assert repr(result) == "NovelResult(panda on brick: 8 codes by noise: 8 held)"
    assert result.palm_shift_m.max() < 1e-3 and result.novelty_m.max() < 1e-3
    assert result.contact_change.max() < 0.02
    assert np.allclose(result.grasps.X_OH, box_world.grasps.X_OH[result.codes.source], atol=1e-3)


def test_new_grasps_are_new_hold_and_can_be_saved(box_world: BoxWorld, tmp_path) -> None:
    for kind, least in (("noise", 0.75), ("midpoint", 0.5)):  # 8 grasps of a box: neighbours hold other faces
        result = novel_grasps(
            box_world.field, box_world.book, **PAIR, config=NovelConfig(kind=kind, count=8, search=8), seed=1
        )
        check_result(result, 8)
        assert result.held_share >= least
        assert np.median(result.novelty_m[result.code]) > 3e-3
        save_grasps(tmp_path / "new.safetensors", result.grasps, hand=box_world.hand)
        assert load_grasps(tmp_path / "new.safetensors").config["novel_kind"] == kind


def test_results_do_not_depend_on_threads_or_on_how_many_are_made(box_world: BoxWorld) -> None:
    config = NovelConfig(kind="sample", count=6, search=8)
    runs = [
        novel_grasps(box_world.field, box_world.book, **PAIR, config=config, seed=2, threads=threads)
        for threads in (1, 3)
    ]
    assert np.array_equal(runs[0].grasps.q_squeeze, runs[1].grasps.q_squeeze)
    assert np.array_equal(runs[0].outcome, runs[1].outcome)
    fewer = novel_grasps(box_world.field, box_world.book, **PAIR, config=replace(config, count=3), seed=2)
    assert np.array_equal(fewer.outcome, runs[0].outcome[:3])
    other = novel_grasps(box_world.field, box_world.book, **PAIR, config=replace(config, count=3), seed=3)
    assert not np.array_equal(other.codes.values, fewer.codes.values)


def test_measure_novel_counts_every_code(box_world: BoxWorld) -> None:
    done = []
    measured = measure_novel(
        box_world.field, box_world.book, kind="noise", spread=0.05, per_pair=4, search=0,
        progress=lambda *at: done.append(at),
    )  # fmt: skip
    assert [(r.hand, r.object, r.codes) for r in measured.rows] == [("panda", "brick", 4)]
    assert measured.total.codes == 4 and measured.per_hand[0].held_share == measured.total.held_share
    assert measured.config.spread == 0.05 and done == [(1, 1)]
    alone = novel_grasps(box_world.field, box_world.book, **PAIR, config=measured.config)
    assert np.array_equal(alone.outcome, measured.results[0].outcome)


def test_search_is_the_same_for_all_but_benchmarks(box_world: BoxWorld) -> None:
    from neuralgrasps.cli.novel import novel  # noqa: PLC0415

    assert inspect.signature(novel).parameters["search"].default == NovelConfig().search == 16
    assert measure_novel(box_world.field, box_world.book, kind="midpoint", per_pair=1).config.search == 0


def test_only_training_codes_are_used(box_world: BoxWorld) -> None:
    book = replace(box_world.book, is_test=np.arange(8) >= 3)
    decoded = decode_novel(box_world.field, book, **PAIR, config=NovelConfig(kind="midpoint", count=3), seed=0)
    assert set(decoded.codes.source) | set(decoded.codes.neighbour) == {0, 1, 2}


def test_wrong_inputs_are_refused(box_world: BoxWorld) -> None:
    field, book = box_world.field, box_world.book
    with pytest.raises(UnknownNameError, match=r"hand 'pand' is not known\. Did you mean 'panda'"):
        novel_grasps(field, book, hand="pand", object_name="brick")
    with pytest.raises(UnknownNameError, match="object 'brik'"):
        novel_grasps(field, book, hand="panda", object_name="brik")
    with pytest.raises(InputError, match=r"no training grasps of 'fetch' on 'brick'.*Those of panda cannot stand in"):
        novel_grasps(field, book, hand="fetch", object_name="brick")
    with pytest.raises(InputError, match="no training grasps"):
        novel_grasps(field, replace(book, is_test=np.ones(8, bool)), **PAIR)
    with pytest.raises(InputError, match="'midpoint' needs 2"):
        novel_grasps(field, book[0], **PAIR, config=NovelConfig(kind="midpoint"))
    with pytest.raises(InputError, match="28 pairs"):
        novel_grasps(field, book, **PAIR, config=NovelConfig(kind="midpoint", count=29))
    for wrong, message in (
        ({"count": 0}, "count is 0"), ({"spread": -0.1}, "spread is -0.1"), ({"spread": float("nan")}, "spread is nan"),
        ({"search": -1}, "search is -1"), ({"share": 1.5}, "share is 1.5"), ({"noise_level": -1.0}, "noise_level"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=message):
            NovelConfig(**wrong)
    with pytest.raises(UnknownNameError, match="kind 'nois'"):
        NovelConfig(kind="nois")  # type: ignore[arg-type]
    with pytest.raises(UnknownNameError, match="protocol"):
        NovelConfig(protocol="shaken")
    with pytest.raises(InputError, match="nothing to sample from"):
        measure_novel(field, replace(book, is_test=np.ones(8, bool)))


def test_free_codes_are_refused(box_world: BoxWorld) -> None:
    free = replace(box_world.book, metric_size=128)
    with pytest.raises(InputError, match="MlpField"):
        novel_grasps(box_world.field, free, **PAIR)
