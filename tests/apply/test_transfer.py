"""Transfer as a whole: what comes back holds, is in order, obeys the rules, and says why."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.apply.transfer import TransferConfig, TransferResult, made_grasps, transfer
from neuralgrasps.apply.transfer_kernels import Sturdy, margins
from neuralgrasps.apply.transfer_order import Candidate, Order
from neuralgrasps.apply.transfer_pair import TransferPair, forget, target_of, transfer_pair
from neuralgrasps.apply.transfer_query import TransferQuery, query_from_contacts, query_from_grasp
from neuralgrasps.apply.transfer_reasons import squeezed_width, touched_sides
from neuralgrasps.apply.transfer_search import SearchConfig
from neuralgrasps.apply.transfer_verdicts import verdict_of, whole_trial
from neuralgrasps.errors import InputError, UnknownNameError
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.grasps.contact_map import contact_map_packed
from neuralgrasps.grasps.grasp_set import empty_grasps
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.copies import moved_grasps
from neuralgrasps.sim.validate import validate_grasps
from neuralgrasps.synthesis.select import grasp_features
from neuralgrasps.synthesis.support import Support
from tests.apply.conftest import BoxWorld

SHORT = TransferConfig(count=3, search=SearchConfig(starts=3, generations=1, children=4))


def sturdy_of(pair: TransferPair, *, give: float = 0.0) -> Sturdy:
    """Weak is what has a margin below 0.1."""
    return Sturdy(pair.slippery, 0.1, give, 0.0)


@pytest.fixture(scope="module")
def query(box_world: BoxWorld) -> TransferQuery:
    return query_from_grasp(box_world.hand, box_world.obj, box_world.grasps.X_OH[0], box_world.grasps.q[0])


class AtLeast:
    """Hands whose palm lies above a height in the object's frame."""

    def __init__(self, height_m: float) -> None:
        self.height_m = height_m

    def allows(self, hand: Hand, X_OH: np.ndarray, q: np.ndarray, q_pregrasp: np.ndarray | None = None) -> np.ndarray:
        return (X_OH @ hand.X_HP)[:, 2, 3] >= self.height_m


def check(result: TransferResult, query: TransferQuery, hand: Hand, obj: ObjectModel, config: TransferConfig) -> None:
    """What every result must be, found out anew."""
    count = len(result.grasps)
    assert count == len(result.similarity) == len(result.origin) == len(result.reasons) == len(result.source)
    assert (np.diff(result.similarity) <= 1e-12).all() and (result.weak >= 0.0).all()
    assert validate_grasps(hand, obj, result.grasps, config.protocol).success.all() and result.grasps.validated.all()
    packed = transfer_pair(hand, obj, config.protocol).problem.packed
    maps = contact_map_packed(obj.points_O, packed, result.grasps.X_OH, result.grasps.q, radius=query.radius_m)
    difference = (np.abs(maps - query.contact_map) * query.weight).mean(axis=1)
    assert np.allclose(result.map_difference, difference, atol=1e-6)
    assert np.allclose(result.similarity, 1.0 - difference / result.scale, atol=1e-5)
    features = grasp_features(hand, result.grasps.X_OH, result.grasps.q)
    apart = np.linalg.norm(features[:, None] - features[None], axis=2)[np.triu_indices(count, 1)]
    assert count < 2 or apart.min() >= config.apart_m
    for similarity, reason in zip(result.similarity, result.reasons, strict=True):
        assert f"similarity {similarity:.2f}" in reason and reason.endswith(f"held in {config.protocol}")


def test_a_known_grasp_is_found_again_and_new_ones_follow(box_world: BoxWorld, query: TransferQuery) -> None:
    result = transfer(query, box_world.hand, box_world.obj, known=box_world.grasps, config=SHORT)
    check(result, query, box_world.hand, box_world.obj, SHORT)
    assert len(result.grasps) == 3 and result.reason == ""
    assert result.similarity[0] > 0.98 and result.oracle == pytest.approx(1.0, abs=1e-6)
    assert result.reasons[0].startswith("most alike, ") and "against 1.00 of the best known" in result.reasons[0]
    assert "number 2 in likeness" in result.reasons[1]
    assert "3 grasps by panda on brick" in repr(result)


def test_what_slips_easily_is_chosen_later(box_world: BoxWorld, query: TransferQuery) -> None:
    def asked(robust: float) -> TransferResult:
        config = replace(SHORT, robust=robust)
        return transfer(query, box_world.hand, box_world.obj, known=box_world.grasps, config=config)

    alike, sturdy = asked(TransferConfig().robust), asked(1.0)  # by default likeness alone decides
    assert (np.diff(alike.similarity) <= 1e-12).all() and (alike.weak == 0.0).all()
    check(sturdy, query, box_world.hand, box_world.obj, replace(SHORT, robust=1.0))
    cone = transfer_pair(box_world.hand, box_world.obj, "dexgraspbench").slippery
    held = [
        margins(cone, r.grasps.contact_points_O, r.grasps.contact_normals_O, r.grasps.contact_links)
        for r in (alike, sturdy)
    ]
    assert held[1].min() > 1.5 * held[0].min() and len(held[1]) == 3
    with pytest.raises(InputError, match="robust is -1"):
        TransferConfig(robust=-1.0)


def test_what_the_whole_trial_held_is_not_tried_again(box_world: BoxWorld, query: TransferQuery) -> None:
    assert set(box_world.grasps.verdicts) == {"dexgraspbench"} and box_world.grasps.validated.all()
    config = replace(SHORT, method="retrieve")
    assert config.protocol == "dexgraspbench-quick" and whole_trial(config.protocol) == "dexgraspbench"
    assert whole_trial("shake") == "shake"
    result = transfer(query, box_world.hand, box_world.obj, known=box_world.grasps, config=config)
    assert result.tried == 0 and result.grasps.protocol == config.protocol and len(result.grasps) == 3
    again = validate_grasps(box_world.hand, box_world.obj, box_world.grasps, config.protocol)
    derived = verdict_of(box_world.hand, box_world.obj, box_world.grasps, config.protocol)[config.protocol]
    assert again.success.all() and dict(derived.parameters) == dict(again.parameters)
    assert (again.displacement_m <= derived.displacement_m).all()  # it ends before the whole one


def test_generation_beats_what_is_known(box_world: BoxWorld, query: TransferQuery) -> None:
    others = box_world.grasps[1:]
    alone, made = (
        transfer(query, box_world.hand, box_world.obj, known=others, config=replace(SHORT, method=method))
        for method in ("retrieve", "generate")
    )
    check(alone, query, box_world.hand, box_world.obj, SHORT)
    check(made, query, box_world.hand, box_world.obj, SHORT)
    assert set(alone.origin) == {"retrieved"} and set(made.origin) == {"generated"}
    assert alone.tried == 0 and made.tried > 0  # stored verdicts serve
    assert np.array_equal(alone.grasps.X_OH, others.X_OH[alone.source])
    assert alone.similarity[0] == pytest.approx(alone.oracle, abs=1e-6)
    assert made.similarity[0] > made.oracle + 0.02


def test_a_query_without_a_palm_is_served_as_well(box_world: BoxWorld, query: TransferQuery) -> None:
    blind = replace(query, X_OP=None)
    result = transfer(blind, box_world.hand, box_world.obj, known=box_world.grasps[1:], config=SHORT)
    check(result, blind, box_world.hand, box_world.obj, SHORT)
    assert result.similarity[0] >= result.oracle and (result.source >= 0).all()


def test_the_same_seed_gives_the_same_grasps_whatever_came_before(box_world: BoxWorld, query: TransferQuery) -> None:
    common = {"known": box_world.grasps[1:], "config": SHORT}
    first = transfer(query, box_world.hand, box_world.obj, **common, seed=4)
    transfer(query, box_world.hand, box_world.obj, **common, seed=5)
    forget()
    again = transfer(query, box_world.hand, box_world.obj, **common, seed=4)
    assert np.array_equal(first.grasps.X_OH, again.grasps.X_OH) and np.array_equal(first.grasps.q, again.grasps.q)
    assert first.reasons == again.reasons and first.tried == again.tried


def test_the_object_s_symmetry_turns_known_grasps(box_world: BoxWorld, make_object: Callable[..., ObjectModel]) -> None:
    obj = make_object("brick", box_mesh([0.02, 0.03, 0.06]), symmetry=True)
    turned = next(X for X in obj.symmetry.rotations[1:] if np.trace(X[:3, :3]) < 0)
    other = moved_grasps(box_world.grasps[:1], turned)
    query = query_from_grasp(box_world.hand, obj, other.X_OH[0], other.q[0])
    config = replace(SHORT, method="retrieve", count=1, scale=0.3)
    result = transfer(query, box_world.hand, obj, known=box_world.grasps[:1], config=config)
    assert result.oracle > 0.97 > result.oracle_plain + 0.1
    assert result.similarity[0] > 0.9 and result.tried == 1  # a turned grasp is tried again
    assert "row 0 of the known grasps turned by the object's symmetry" in result.reasons[0]
    plain = transfer(query, box_world.hand, obj, known=box_world.grasps[:1], config=replace(config, use_symmetry=False))
    assert plain.similarity[0] == pytest.approx(plain.oracle_plain, abs=1e-6) and plain.oracle == plain.oracle_plain


def test_rules_hold_for_known_and_new_grasps(box_world: BoxWorld, query: TransferQuery) -> None:
    palms = (box_world.grasps.X_OH @ box_world.hand.X_HP)[:, 2, 3]
    rule = AtLeast(float(np.median(palms)))
    result = transfer(query, box_world.hand, box_world.obj, known=box_world.grasps, config=SHORT, constraints=rule)
    check(result, query, box_world.hand, box_world.obj, SHORT)
    assert rule.allows(box_world.hand, result.grasps.X_OH, result.grasps.q).all()
    support = Support(plane=Plane(normal=np.array([0.0, 0.0, 1.0]), offset_m=float(box_world.obj.points_O[:, 2].min())))
    lying = transfer(query, box_world.hand, box_world.obj, known=box_world.grasps, config=SHORT, support=support)
    assert support.allows(box_world.hand, lying.grasps.X_OH, lying.grasps.q, lying.grasps.q_pregrasp).all()


def test_rules_that_allow_nothing_are_named(box_world: BoxWorld, query: TransferQuery) -> None:
    nothing = transfer(
        query, box_world.hand, box_world.obj, known=box_world.grasps, config=SHORT, constraints=AtLeast(10.0)
    )
    assert len(nothing.grasps) == 0 == len(nothing.nearest) and np.isnan(nothing.nearest_similarity)
    assert "0 of 3 grasps found" in nothing.reason and "none of 8 known grasps is allowed" in nothing.reason


def test_what_does_not_hold_is_not_given_but_named(box_world: BoxWorld, query: TransferQuery, monkeypatch) -> None:
    pair = transfer_pair(box_world.hand, box_world.obj, SHORT.protocol)
    run = pair.trial.run
    monkeypatch.setattr(type(pair.trial), "run", lambda self, *args: replace(run(*args), success=False))
    config = replace(SHORT, method="generate", trials=2)
    result = transfer(query, box_world.hand, box_world.obj, known=box_world.grasps, config=config)
    assert len(result.grasps) == 0 and result.tried == 2 and len(result.nearest) == 1
    assert 0.5 < result.nearest_similarity <= 1.0 and "2 tried in physics" in result.reason


def test_hand_and_object_that_nobody_has_seen(
    make_object: Callable[..., ObjectModel], box_world: BoxWorld, query: TransferQuery
) -> None:
    obj = make_object("slab", box_mesh([0.02, 0.04, 0.05]))
    hand = load_hand("fetch")
    config = TransferConfig(count=1, synthesise=4, search=SearchConfig(generations=0, starts=6))
    made = made_grasps(hand, obj, config, support=None, seed=0)
    assert len(made) == 4 and made_grasps(hand, obj, config, support=None, seed=0) is made
    query = query_from_grasp(hand, obj, made.X_OH[2], made.q[2])
    result = transfer(query, hand, obj, config=config)
    check(result, query, hand, obj, config)
    assert result.similarity[0] > 0.97
    none = empty_grasps("panda", "slab", num_joints=box_world.hand.num_dofs)
    bare = transfer(query, box_world.hand, obj, known=none, config=config)  # only the query's palm to start from
    assert np.isnan(bare.oracle) and (len(bare.grasps) == 0 or bare.source[0] == -1)
    blind = transfer(replace(query, X_OP=None), box_world.hand, obj, known=none, config=config)
    assert len(blind.grasps) == 0 and "no grasp of this hand on this object is known." in blind.reason


def test_drawn_contacts_are_touched(box_world: BoxWorld) -> None:
    grasp = box_world.grasps[2]
    drawn = grasp.contact_points_O[0][np.isfinite(grasp.contact_points_O[0, :, 0])]
    query = query_from_contacts(box_world.obj, drawn)
    result = transfer(query, box_world.hand, box_world.obj, known=box_world.grasps, config=SHORT)
    check(result, query, box_world.hand, box_world.obj, SHORT)
    made = result.grasps[0].contact_points_O[0]
    made = made[np.isfinite(made[:, 0])]
    assert np.linalg.norm(drawn[:, None] - made[None], axis=2).min(axis=1).max() < 0.015


def test_a_grasp_that_the_hand_cannot_make_is_explained(
    make_object: Callable[..., ObjectModel], box_world: BoxWorld
) -> None:
    obj = make_object("crate", box_mesh([0.03, 0.06, 0.06]))  # half sizes
    sides = obj.points_O[np.abs(np.abs(obj.points_O[:, 1]) - 0.06) < 1e-3]
    near = sides[np.linalg.norm(sides[:, [0, 2]], axis=1) < 0.02]
    query = query_from_contacts(obj, near)
    pair = transfer_pair(box_world.hand, obj, "dexgraspbench")
    assert squeezed_width(query, pair.problem) == pytest.approx(0.12, abs=2e-3)
    assert touched_sides(query, pair.problem) == 2
    assert touched_sides(query_from_contacts(obj, obj.points_O[::5]), pair.problem) == 6
    config = TransferConfig(count=1, synthesise=4, search=SearchConfig(generations=0, starts=6))
    result = transfer(query, box_world.hand, obj, config=config)
    assert "The query holds 'crate' across 120 mm, hand 'panda' opens 80 mm" in result.reason
    assert len(result.grasps) == 1 and f"similarity {result.similarity[0]:.2f}" in result.reason
    assert "the nearest feasible grasp" in result.reason


def test_wrong_input_is_refused(box_world: BoxWorld, query: TransferQuery, make_object) -> None:
    with pytest.raises(InputError, match="object 'brick', the object is 'slab'"):
        transfer(query, box_world.hand, make_object("slab", box_mesh([0.02, 0.04, 0.05])), known=box_world.grasps)
    with pytest.raises(InputError, match="hand 'panda'"):
        transfer(query, load_hand("fetch"), box_world.obj, known=box_world.grasps)
    with pytest.raises(UnknownNameError, match="retrieve"):
        TransferConfig(method="retreive")  # type: ignore[arg-type]
    for wrong in ({"count": 0}, {"trials": 0}, {"scale": 0.0}, {"apart_m": -1.0}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            TransferConfig(**wrong)
    with pytest.raises(UnknownNameError, match="protocol"):
        TransferConfig(protocol="shaky")


def test_a_verdict_on_other_numbers_is_none(box_world: BoxWorld, query: TransferQuery) -> None:
    config = replace(SHORT, method="retrieve", protocol="shake", count=8, apart_m=0.0)
    usual = box_world.grasps.with_verdict(
        "shake", validate_grasps(box_world.hand, box_world.obj, box_world.grasps, "shake")
    )
    before = transfer(query, box_world.hand, box_world.obj, known=usual, config=config)
    assert len(before.grasps) == 8 and before.tried == 0
    heavy = replace(box_world.obj, friction=0.05, mass_kg=3 * box_world.obj.mass_kg)
    really = validate_grasps(box_world.hand, heavy, usual, "shake").success
    assert really.sum() < 8
    after = transfer(query, box_world.hand, heavy, known=usual, config=config)
    assert after.tried == len(usual) and len(after.grasps) == really.sum()
    fell = usual.with_verdict("shake", validate_grasps(box_world.hand, heavy, usual, "shake"))
    fell = replace(fell, verdicts={"shake": fell.verdicts["shake"]})
    assert not fell.validated.all()
    again = transfer(query, box_world.hand, box_world.obj, known=fell, config=config)
    assert len(again.grasps) == again.tried == 8  # those that the heavy one slipped from are tried with this one


def test_what_settles_nearer_than_it_looked_still_comes_in_order(
    box_world: BoxWorld, query: TransferQuery, monkeypatch: pytest.MonkeyPatch
) -> None:
    pair = transfer_pair(box_world.hand, box_world.obj, "dexgraspbench")
    order = Order(
        pair, target_of(query), SHORT, lambda X, q, before: np.ones(len(q), bool), sturdy=sturdy_of(pair), seed=0
    )
    exact = (0.12, 0.11, 0.05, 0.3)  # of candidates that look 0.10, 0.11, 0.12 and 0.13 away

    def finish(self: Order, item: Candidate) -> bool:
        item.grasp, item.difference = box_world.grasps[item.source], exact[item.source]
        return True

    monkeypatch.setattr(Order, "_finish", finish)
    for i in range(4):
        grasp = box_world.grasps[i]
        order.add(Candidate("generated", i, 0, grasp.X_OH[0], grasp.q[0], 0.10 + 0.01 * i))
    chosen = order.best(3)
    assert [item.source for item in chosen] == [2, 1, 0]
    assert [item.difference for item in chosen] == sorted(item.difference for item in chosen)
    assert order.tried == 3


def order_of(
    box_world: BoxWorld, monkeypatch: pytest.MonkeyPatch, items: list[tuple[int, int]], **changes: object
) -> Order:
    """Candidates by source and place among the known grasps, the most alike first; all hold."""
    pair, box = transfer_pair(box_world.hand, box_world.obj, "dexgraspbench"), box_world.grasps
    config = replace(SHORT, **changes)
    order = Order(
        pair, target_of(query_from_contacts(box_world.obj, box_world.obj.points_O[:5])), config,
        lambda X, q, before: np.ones(len(q), bool), sturdy=sturdy_of(pair), seed=0,
    )  # fmt: skip

    def prove(self: Order, item: Candidate) -> bool:
        self.tried += 1
        return True

    monkeypatch.setattr(Order, "_prove", prove)
    for k, (source, place) in enumerate(items):
        grasp = box[place]
        order.add(Candidate("retrieved", source, 0, grasp.X_OH[0], grasp.q[0], 0.1 + 0.01 * k, grasp=grasp))
    return order


def test_few_results_come_from_one_source_while_there_are_others(
    box_world: BoxWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    items = [(0, 0), (0, 1), (0, 2), (0, 3), (0, 4), (5, 5), (6, 6)]

    def sources(count: int, **changes: object) -> list[int]:
        return [item.source for item in order_of(box_world, monkeypatch, items, **changes).best(count)]

    assert sources(1) == [0] and sources(4) == [0, 0, 0, 5]
    assert sources(4, per_source=1) == [0, 0, 5, 6]  # nothing else is left: a second one fills up
    assert sources(6) == [0, 0, 0, 0, 5, 6]
    assert sources(4, per_source=None) == sources(4, per_source=0) == [0, 0, 0, 0]
    assert sources(4, trials=3) == [0, 0, 0, 0]  # most trials are used up: no more for the others
    with pytest.raises(InputError, match="per_source is -1"):
        TransferConfig(per_source=-1)


def test_what_is_near_to_others_only_fills_up(box_world: BoxWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    features = grasp_features(box_world.hand, box_world.grasps.X_OH, box_world.grasps.q)
    apart = np.linalg.norm(features - features[0], axis=1)
    near = int(np.argsort(apart)[1])
    far = int(apart.argmax())
    assert 0.004 < apart[near] < apart[far]
    items = [(0, 0), (1, near), (2, near), (3, far)]
    wide = 0.5 * float(apart[near] + apart[far])

    def places(count: int) -> list[int]:
        return [item.source for item in order_of(box_world, monkeypatch, items, apart_m=wide).best(count)]

    assert places(1) == [0] and places(2) == [0, 3]
    assert places(4) == [0, 1, 3]  # the near one after all, but not what is the same


def test_retrieval_tries_as_many_known_grasps_as_trials_allow(box_world: BoxWorld, query: TransferQuery) -> None:
    box = box_world.grasps
    alone = [query_from_grasp(box_world.hand, box_world.obj, g.X_OH[0], g.q[0]) for g in box]
    order = np.argsort([np.abs(one.contact_map - query.contact_map).mean() for one in alone])
    last = int(order[-1])
    loose = np.where((np.arange(len(box)) == last)[:, None], box.q_squeeze, box.q_pregrasp)  # only the last one holds
    known = replace(box, q_squeeze=loose, verdicts={})
    config = replace(SHORT, method="retrieve", count=1)
    assert config.search.starts < len(box) <= config.trials
    result = transfer(query, box_world.hand, box_world.obj, known=known, config=config)
    assert result.source.tolist() == [last] and result.tried == len(box)


def test_a_finished_grasp_is_weighed_by_its_own_contacts(box_world: BoxWorld, query: TransferQuery) -> None:
    pair = transfer_pair(box_world.hand, box_world.obj, SHORT.protocol)
    sturdy, grasp = sturdy_of(pair, give=0.5), box_world.grasps[1]
    order = Order(pair, target_of(query), SHORT, lambda X, q, before: np.ones(len(q), bool), sturdy=sturdy, seed=0)
    order.add(Candidate("generated", 1, 0, grasp.X_OH[0], grasp.q[0], 0.1, 0.05))
    (chosen,) = order.best(1)
    made = chosen.grasp
    assert made is not None
    held = float(margins(sturdy.cone, made.contact_points_O, made.contact_normals_O, made.contact_links)[0])
    expected = 0.5 * min(max(1.0 - held / 0.1, 0.0), 2.0)
    assert chosen.weak == pytest.approx(expected, abs=1e-9) and abs(expected - 0.05) > 0.01
