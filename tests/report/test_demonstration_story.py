"""What the page of a demonstration says of an object that moves, of the robot's grasps, and of what the robot did."""

from __future__ import annotations

from dataclasses import replace
from io import BytesIO
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from PIL import Image

from neuralgrasps.apply.demonstrate import Demonstration
from neuralgrasps.apply.transfer import TransferResult
from neuralgrasps.apply.transfer_query import query_from_grasp
from neuralgrasps.evaluate.execute import Attempt, Trial
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.grasps.grasp_set import GraspSet, Verdict
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.human.video.grasp_moment import touch
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.pick import PickPlan, PickResult
from neuralgrasps.report.demonstration_page import (
    DemonstrationStory,
    _grasp_facts,
    _key_figures,
    _times,
    demonstration_figure,
    drawn_frames,
    shown_frame,
    shown_transfer,
    track_figure,
    up_in_object,
)
from neuralgrasps.report.demonstration_pictures import (
    _touched,
    close_ups,
    grasp_views,
    moving_overlay,
    strip_pictures,
)
from neuralgrasps.report.demonstration_stages import demonstration_stages, with_names
from neuralgrasps.report.hand_overlay import HandLayers
from neuralgrasps.report.sections import PictureEncoder
from neuralgrasps.report.transfer_sections import transfer_list_section
from neuralgrasps.report.views import upright
from tests.human.shown import ShownVideo
from tests.report.conftest import GAPS, MOMENT

COUNT = 9


@pytest.fixture(scope="module")
def moving(demo: Demonstration) -> Demonstration:
    """The object is 20 mm farther to the camera's right in every frame, and lost in the last."""
    assert demo.followed is not None and demo.track is not None and demo.track.grasp is not None
    X_CO = demo.followed.X_CO.copy()
    X_CO[:, 0, 3] += 0.02 * np.arange(len(GAPS))
    X_CO[-1] = np.nan
    fused = replace(demo.track.grasp, cloud_rms_m=0.0031, joint_rms_m=0.0042, penetration_m=0.0013, confidence=0.95)
    return replace(
        demo, followed=replace(demo.followed, X_CO=X_CO, lost_from=5), track=replace(demo.track, grasp=fused)
    )


@pytest.fixture(scope="module")
def result(obj: ObjectModel) -> TransferResult:
    hand = load_hand("fetch")
    X_OH = np.tile(np.eye(4), (COUNT, 1, 1))
    X_OH[:, 2, 3] = 0.2 + 0.001 * np.arange(COUNT)
    q, none = np.tile(hand.q_open, (COUNT, 1)), np.zeros((COUNT, 0, 3))
    grasps = GraspSet(
        hand="fetch", object=obj.name, X_OH=X_OH, q=q, q_pregrasp=q, q_squeeze=q, contact_points_O=none,
        contact_normals_O=none, contact_links=np.zeros((COUNT, 0), np.int32), epsilon=np.zeros(COUNT),
        penetration_m=np.zeros(COUNT),
    ).with_verdict(
        "dexgraspbench",
        Verdict(success=np.ones(COUNT), displacement_m=np.full(COUNT, 0.001), rotation_rad=np.zeros(COUNT)),
    )  # fmt: skip
    return TransferResult(
        grasps=grasps, similarity=0.9 - 0.01 * np.arange(COUNT), map_difference=np.zeros(COUNT),
        origin=("retrieved",) * COUNT, source=np.arange(COUNT), reasons=tuple(f"reason {k}" for k in range(COUNT)),
        oracle=0.8, oracle_plain=0.8, scale=0.1, tried=3, reason="", nearest=grasps[:0],
        nearest_similarity=float("nan"),
    )  # fmt: skip


@pytest.fixture(scope="module")
def carried(demo: Demonstration, obj: ObjectModel, result: TransferResult) -> Demonstration:
    assert demo.human is not None and demo.X_OH is not None and demo.q is not None
    return replace(demo, query=query_from_grasp(demo.human, obj, demo.X_OH, demo.q), transfer=result)


def attempt(place: int | None, *, lifted_m: float = 0.0, held: bool = False, reason: str = "", counts=None) -> Attempt:
    """One look, and a pick by the grasp at this place (turned by the third of the object's symmetries)."""
    plan = None if place is None else cast(PickPlan, SimpleNamespace(index=3 * COUNT + place))
    pick = PickResult(
        plan=plan,
        reason=reason,
        counts=counts or {},
        blocked=False,
        tried=1,
        complete=True,
        cpu_s=0.12,
        proof_cpu_s=0.0,
        seed=0,
    )
    return Attempt(
        X_BO_true=np.eye(4), X_BO_estimate=np.eye(4), pose_right=True, pose_error_mm=1.0, pose_error_deg=1.0,
        frame=None, pick=pick, reason=reason, look_cpu_s=0.1, grasps_cpu_s=0.0, lifted_m=lifted_m, held=held,
    )  # fmt: skip


def trial(*attempts: Attempt, cause: Any = "", detail: str = "") -> Trial:
    return Trial(
        object="brick", arm="fetch", hand="fetch", pose_method="ours", seed=0, success=attempts[0].success,
        success_retry=any(a.success for a in attempts), cause=cause, detail=detail, attempts=attempts, recording=None,
        scene=cast(Any, None),
    )  # fmt: skip


def story(video: ShownVideo, demo: Demonstration, obj: ObjectModel, **more: Any) -> DemonstrationStory:
    return DemonstrationStory(frames=video.frames, demo=demo, obj=obj, hand=load_hand("fetch"), **more)


def test_every_frame_has_its_own_object_and_hand(moving, obj, video) -> None:
    layers = drawn_frames(video.frames, moving, obj).layers
    for k in range(len(GAPS) - 1):
        np.testing.assert_array_equal(layers[k].X_CO, moving.followed.X_CO[k])
        assert layers[k].mesh is obj.mesh
    assert layers[-1].mesh is None and layers[-1].X_CO is None  # lost
    assert layers[MOMENT].fitted is moving.track.grasp  # of all still frames
    assert layers[3].fitted is video.fits[3]


def test_gaps_are_to_the_object_where_it_is_then_in_millimetres(moving, obj, video) -> None:
    figure = track_figure(replace(moving, track=replace(moving.track, still=(3, 4, 5))), obj)
    assert figure is not None
    for k in (1, 3, 4):
        gap = touch(video.fits[k], obj, moving.followed.X_CO[k]).nearest_m
        assert figure.gap_mm[k] == pytest.approx(max(1e3 * gap, 0.0))
    assert np.isnan(figure.gap_mm[5])  # lost
    np.testing.assert_allclose(figure.residual_mm[[1, 3, 4, 5]], 2.0)
    assert figure.span == (3, 5)


def test_up_is_the_tables_normal(demo: Demonstration) -> None:
    assert up_in_object(demo).tolist() == [0, 0, 1]
    lying = replace(demo, table_O=Plane(np.array([1.0, 0.0, 0.0]), -0.03))
    assert up_in_object(lying).tolist() == [1, 0, 0]


def test_the_frame_shown_without_a_hand_is_the_one_the_object_was_found_in(demo, obj, video) -> None:
    bare = replace(demo, track=None, followed=replace(demo.followed, found_in=2))
    assert shown_frame(drawn_frames(video.frames, bare, obj), bare) == 2


def test_the_grasp_carried_out_has_its_own_card_and_words(carried, obj, video) -> None:
    done = trial(attempt(None), attempt(COUNT - 1, lifted_m=0.2, held=True))
    shown = shown_transfer(story(video, carried, obj, executed=True, trial=done))
    assert len(shown.grasps) == 7
    assert [g.reason for g in shown.grasps[:6]] == [f"reason {k}" for k in range(6)]
    assert shown.grasps[6].reason == f"Carried out, no. {COUNT}: reason {COUNT - 1}"
    assert [g.number for g in shown.grasps] == [*range(1, 7), COUNT]
    html = transfer_list_section([shown], PictureEncoder(50))
    assert f"</span>{COUNT}. retrieved" in html and "</span>7. retrieved" not in html
    np.testing.assert_allclose([g.similarity for g in shown.grasps], [*(0.9 - 0.01 * np.arange(6)), 0.82])
    assert shown.query_hand == "human"


def test_where_none_holds_the_nearest_is_shown(carried, obj, video, result) -> None:
    none = replace(
        result, grasps=result.grasps[:0], similarity=np.zeros(0), origin=(), reasons=(), reason="none holds.",
        nearest=result.grasps[3:4], nearest_similarity=0.44,
    )  # fmt: skip
    shown = shown_transfer(story(video, replace(carried, transfer=none), obj))
    assert [(g.similarity, g.origin) for g in shown.grasps] == [(0.44, "the nearest")]
    assert shown.text.startswith("None holds.")


def test_key_figures_say_what_was_lifted_and_in_which_units(carried, moving, obj, video) -> None:
    lifted = trial(attempt(0), attempt(1, lifted_m=0.2, held=True), cause="slip")
    demo = replace(carried, track=moving.track)
    figures = {f.label: (f.value, f.note) for f in _key_figures(story(video, demo, obj, executed=True, trial=lifted))}
    assert figures["in simulation"] == ("lifted", "slip")
    assert figures["sure of the fitted grasp"] == ("95 %", "3.1 mm off the points")
    assert figures["contact similarity"] == ("0.89", "grasp no. 2 of 9, carried out; best of all 0.90")
    unmoved = {f.label: (f.value, f.note) for f in _key_figures(story(video, demo, obj))}
    assert unmoved["contact similarity"] == ("0.90", "best known grasp 0.80")
    assert figures["frames with a hand"] == ("4 of 6", "right")
    fell = story(video, demo, obj, executed=True, trial=trial(attempt(0), cause="slip"))
    assert {f.label: f.value for f in _key_figures(fell)}["in simulation"] == "not lifted"


def test_facts_of_the_grasp_have_units(moving) -> None:
    facts = dict(_grasp_facts(moving))
    assert [facts[k].replace("\u202f", " ") for k in ("points off", "joints off", "into the object")] == [
        "3.1 mm", "4.2 mm", "1.3 mm",
    ]  # fmt: skip


def test_times_of_drawing_add_up(demo, obj, video) -> None:
    times = {t.stage: t.wall_s for t in _times(story(video, demo, obj, seconds={"drawing": 3.0, "planning": 0.5}), 1.5)}
    assert times == {"object": 0.2, "hand": 0.4, "drawing": 4.5, "planning": 0.5}


def stage(demo: Demonstration, name: str, done: Trial | None, **more: Any) -> tuple[str, str, str]:
    stages = demonstration_stages(demo, done, executed=True, **more)
    return next((s.verdict, s.text, s.reason) for s in stages if s.name == name)


def test_stages_of_the_robot_say_place_time_and_height(carried) -> None:
    done = trial(attempt(4, lifted_m=0.2, held=True))
    before = "; those before it, as they are or turned: they do not clear the table"
    assert stage(carried, "Plan", done) == ("ok", f"grasp no. 5 of similarity 0.86, in 120 ms{before}", "")
    slow = f"grasp no. 5 of similarity 0.86, in 120 ms with compiling{before}"
    assert stage(carried, "Plan", done, compiled=True)[1] == slow
    first = trial(attempt(0, lifted_m=0.2, held=True))
    assert stage(carried, "Plan", first)[1] == "grasp no. 1 of similarity 0.90, in 120 ms"
    tried = attempt(4, lifted_m=0.2, held=True, counts={"out of reach": 3, "too wide": 0, "does not lift it": 2})
    assert stage(carried, "Plan", trial(tried))[1].endswith("or turned: 3 out of reach, 2 does not lift it")
    assert stage(carried, "Lift", done) == ("ok", "raised by 200 mm and held", "")
    again = trial(attempt(4, lifted_m=0.03), attempt(6, lifted_m=0.21, held=True), cause="slip")
    assert stage(carried, "Lift", again) == (
        "ok",
        "raised by 210 mm and held, at the second attempt, by grasp no. 7 of similarity 0.84",
        "",
    )
    fell = trial(attempt(4, lifted_m=0.03), cause="slip", detail="it slid out")
    assert stage(carried, "Lift", fell) == ("failed", "raised by 30 mm", "slip: it slid out")
    unplanned = trial(attempt(None, reason="all in collision"), cause="no plan")
    assert stage(carried, "Plan", unplanned) == ("failed", "", "all in collision")
    assert stage(carried, "Lift", unplanned)[0] == "not reached"
    assert stage(carried, "Plan", None) == ("failed", "", "nothing was tried.")


def test_frames_in_a_text_are_called_by_their_names() -> None:
    names = [f"{10 * k:06d}" for k in range(6)]
    said = "within 68 mm, in frame 4. Another hand is seen in frames 1 to 5, of 3 frames; frame 9"
    expected = "within 68 mm, in frame 000040. Another hand is seen in frames 000010 to 000050, of 3 frames; frame 9"
    assert with_names(said, names) == expected


def test_doubts_and_losses_are_said_at_their_stage(moving, video) -> None:
    def stages(demo: Demonstration) -> dict[str, tuple[str, str]]:
        return {s.name: (s.verdict, s.text) for s in demonstration_stages(demo, None, executed=False)}

    assert stages(moving)["Object"][1].endswith("in frame 0; lost from frame 5")
    unsure = replace(moving, track=replace(moving.track, grasp=replace(moving.track.grasp, confidence=0.6)))
    assert stages(unsure)["Fit"] == ("doubtful", "hand of 202 mm, 3.1 mm off the points, 60 % sure")
    assert stages(unsure)["Grasp"][0] == "ok"
    weights = iter((1.0, 0.2, 0.4, 0.6))
    seen = tuple(None if s is None else replace(s, weight=np.full(21, next(weights))) for s in video.seen)
    assert "mean weight 0.50" in stages(replace(moving, track=replace(moving.track, seen=seen)))["Joints"][1]


def test_captions_say_how_far_each_frames_hand_is(demo, obj, video) -> None:
    fits = (*demo.track.frames[:3], None, *demo.track.frames[4:])
    seen = drawn_frames(video.frames, replace(demo, track=replace(demo.track, frames=fits, moment=5)), obj)
    gaps = np.array([np.nan, 120.4, np.nan, np.nan, 0.4, 0.0])
    words = [caption.partition(": ")[2] for caption, _ in strip_pictures(seen, gaps)]
    assert words == ["no hand found", "120 mm away", "no hand found", "hand found", "touching", "the grasp"]
    unwatched = replace(demo.track, frames=fits, moment=5, looked=(0, 1, 3, 4, 5))
    seen = drawn_frames(video.frames, replace(demo, track=unwatched), obj)
    words = [caption.partition(": ")[2] for caption, _ in strip_pictures(seen, gaps)]
    assert words == ["no hand found", "120 mm away", "not looked at", "hand found", "touching", "the grasp"]


def test_frames_nobody_looked_at_do_not_count_as_frames_without_a_hand(demo, obj, video) -> None:
    some = replace(demo, track=replace(demo.track, looked=(0, 1, 3, 4, 5)))
    assert stage(some, "Hand", None)[1] == "right, found in 4 of 5 frames looked at (of 6)"
    assert _key_figures(story(video, some, obj))[0].value == "4 of 5"
    assert _key_figures(story(video, some, obj))[0].note == "right; 1 of 6 not looked at"
    nobody = replace(demo.track, boxes=(None,) * 6, seen=(None,) * 6, looked=(0, 2, 4))
    none = replace(demo, track=nobody, stage="detect", reason="none.")
    assert stage(none, "Hand", None)[1] == "in none of 3 frames looked at (of 6)"
    figure = _key_figures(story(video, none, obj))[0]
    assert (figure.value, figure.note) == ("0 of 3", "3 of 6 not looked at")


def test_the_film_ends_at_the_grasp(demo, obj, video) -> None:
    seen = drawn_frames(video.frames, demo, obj)
    one = replace(seen, moment=1)
    film, whole = (Image.open(BytesIO(moving_overlay(s))) for s in (one, replace(seen, moment=-1)))
    assert film.n_frames < whole.n_frames  # type: ignore[attr-defined]
    assert one.window == seen.window  # from the hand's entry on, when it is farthest away


def test_close_ups_show_the_fitted_hand(demo, obj, video) -> None:
    layers = drawn_frames(video.frames, demo, obj).layers[MOMENT]
    (_, bare), (_, joints), (words, fitted) = close_ups(video.frames[MOMENT], layers)
    assert words == "fitted hand and object"
    object_only = HandLayers(mesh=layers.mesh, X_CO=layers.X_CO, name=layers.name)
    assert close_ups(video.frames[MOMENT], object_only)[-1][0] == "the object"
    palm = layers.fitted.joints_C[9]
    assert palm[2] > 0
    # the hand is nearer than what it hides: its picture differs from the bare one where the joints are
    assert (np.abs(fitted.astype(int) - bare).sum(axis=2) > 30).mean() > 0.1
    assert (np.abs(joints.astype(int) - bare).sum(axis=2) > 30).any()


def test_the_side_that_the_hand_touches_is_coloured(demo, obj) -> None:
    mesh, closeness = _touched(demo.human, obj, demo.X_OH, demo.q)
    y = mesh.vertices[:, 1]
    assert closeness[y < -0.029].mean() > 3.0 * closeness[y > 0.029].mean()  # the palm faces -y
    assert closeness[y < -0.029].max() > 0.4


def test_views_of_a_lying_object_are_those_of_one_turned_upright(demo, obj, video, make_object) -> None:
    up_O = np.array([1.0, 0.0, 0.0])
    X_UO = upright(up_O)
    standing = make_object("turned", obj.mesh.transformed(X_UO))
    lying = grasp_views(demo.human, obj, demo.X_OH, demo.q, up_O=up_O)
    same = grasp_views(demo.human, standing, X_UO @ demo.X_OH, demo.q, up_O=np.array([0.0, 0.0, 1.0]))
    for (_, a), (_, b) in zip(lying, same, strict=True):
        assert np.abs(a.astype(int) - b).mean() < 1.0
    table = Plane(up_O, -0.03)
    drawn = demonstration_figure(story(video, replace(demo, table_O=table), obj), lambda _: None).views
    for (words, a), (expected, b) in zip(drawn, lying, strict=True):
        assert words == expected
        np.testing.assert_array_equal(a, b)
