"""The pose benchmark: figures of known trials, and a run over two small objects."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.errors import InputError
from neuralgrasps.evaluate import pose_bench
from neuralgrasps.evaluate.pose import FAILED, PoseErrors
from neuralgrasps.evaluate.pose_bench import PoseBench, PoseBenchConfig, bench_pose
from neuralgrasps.evaluate.pose_bench_figures import (
    contact_scores,
    expected_figures,
    figure_names,
    is_right,
    pose_figures,
    pose_table,
)
from neuralgrasps.evaluate.pose_bench_methods import (
    Library,
    MethodTrial,
    TableTrial,
    gripper_pose,
    has_grasps,
    measure_methods,
    open_library_run,
    scene_of,
)
from neuralgrasps.evaluate.pose_bench_trials import ContactTrial, IdentityTrial, TrackTrial, _pushes, measure_contact
from neuralgrasps.evaluate.pose_peers import MissingPeerError
from neuralgrasps.evaluate.pose_scenes import UNKNOWN_KINDS
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.primitives import box_mesh, cylinder_mesh
from neuralgrasps.objects.builtin import STAND_INS
from neuralgrasps.objects.store import ply_bytes

SMALL = PoseBenchConfig(
    scenes=2, others=1, peers=1, identity=1, left_out=1, background=1, held=1, sequences=1, frames=3, seed=4
)


def off(add_s_mm: float, mssd_mm: float, deg: float = 1.0, mm: float = 1.0) -> PoseErrors:
    return PoseErrors(
        add_s_m=1e-3 * add_s_mm, mssd_m=1e-3 * mssd_mm, rotation_rad=math.radians(deg), translation_m=1e-3 * mm
    )


def tried(errors: PoseErrors, **changes: object) -> MethodTrial:
    trial = MethodTrial(
        method="ours", object="box", condition="occluded", index=0, visible_share=0.5, errors=errors, cpu_s=0.1,
        confidence=0.95,
    )  # fmt: skip
    return replace(trial, **changes)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, ...]:
    folder = tmp_path_factory.mktemp("meshes")
    meshes: dict[str, Mesh] = {"brick": box_mesh([0.03, 0.05, 0.08]), "tin": cylinder_mesh(0.04, 0.03)}
    for name, mesh in meshes.items():
        (folder / f"{name}.ply").write_bytes(ply_bytes(mesh))
    return tuple(str(folder / f"{name}.ply") for name in meshes)


@pytest.fixture(scope="module")
def library(files: tuple[str, ...]) -> Library:
    return Library(sources=files)


@pytest.fixture(scope="module")
def measured(library: Library) -> PoseBench:
    return bench_pose(library, config=SMALL, workers=1)


def test_figures_of_known_trials() -> None:
    trials = [
        tried(off(2, 8, deg=1, mm=1)),  # right
        tried(off(8, 30, deg=3, mm=5), cpu_s=0.3),  # within 1 cm, yet turned
        tried(off(50, 90, deg=90, mm=50), confidence=0.2, visible_share=0.3),
        tried(off(1, 2), condition="easy", cpu_s=0.5),
        tried(FAILED, method="baseline", confidence=math.nan, reason="no pose"),
    ]
    figures = pose_figures(PoseBench(methods=trials, diameters_m={"box": 0.1}))
    assert figures["occluded_adds_auc"] == pytest.approx(100 * (0.98 + 0.92 + 0.5) / 3)
    assert figures["occluded_mssd_01d"] == pytest.approx(1 / 3)
    assert (figures["easy_mssd_01d"], figures["easy_adds_auc"]) == (1.0, pytest.approx(99.0))
    assert figures["occluded_rot_median_deg"] == pytest.approx(3.0)
    assert figures["occluded_trans_median_mm"] == pytest.approx(5.0)
    assert figures["pose_ms"] == pytest.approx(200.0)  # median of 100, 100, 300, 500
    assert figures["low_visible_mssd_01d"] == 0.0
    assert (figures["calibration_at_90"], figures["calibration_at_90_count"]) == (1.0, 3.0)
    assert figures["calibration_at_90_mssd"] == pytest.approx(2 / 3)
    assert (figures["occluded_adds_auc_baseline"], figures["occluded_mssd_01d_baseline"]) == (0.0, 0.0)
    assert "hard_adds_auc" not in figures and "pose_ms_open3d" not in figures
    assert set(figures) - {"calibration_at_90_mssd"} <= set(expected_figures())


def test_confidence_is_compared_with_what_came_true() -> None:
    trials = [
        tried(off(2, 8), confidence=0.99),
        tried(off(2, 8), confidence=0.95),
        tried(off(2, 50), confidence=0.92),
        tried(off(20, 50), confidence=0.1),
    ]
    rows = pose_table(PoseBench(methods=trials, diameters_m={"box": 0.1}))["reliability"]
    assert [(r["above"], r["to"], r["count"]) for r in rows] == [(0.0, 0.5, 1), (0.9, 0.97, 2), (0.97, 1.0, 1)]
    assert [r["within_1cm"] for r in rows] == [0.0, 1.0, 1.0]
    assert [r["right"] for r in rows] == [0.0, 0.5, 1.0]
    assert rows[1]["said"] == pytest.approx(0.935)


def test_right_needs_both_the_surface_and_the_turn() -> None:
    assert is_right(off(9, 9), 0.1)
    assert not is_right(off(9, 11), 0.1) and not is_right(off(11, 9), 0.1)


def test_identity_and_refusals() -> None:
    def named(kind: str, thing: str, said: str | None, right: bool) -> IdentityTrial:
        return IdentityTrial(
            kind=kind, object=thing, named=said, right=right, probability=0.8, visible_share=0.5, cpu_s=1.0  # type: ignore[arg-type]
        )  # fmt: skip

    bench = PoseBench(
        identity=[
            named("occluded", "box", "box", True), named("occluded", "box", "can", False),
            named("hard", "can", None, False), named("background", "mug", None, True),
            named("left out", "box", "can", False),
        ]
    )  # fmt: skip
    figures = pose_figures(bench)
    assert (figures["identity_occluded"], figures["identity_hard"]) == (0.5, 0.0)
    assert (figures["background_refused"], figures["left_out_refused"]) == (1.0, 0.0)
    rows = {(row["kind"], row["object"]): row for row in pose_table(bench)["identity"]}
    assert rows["occluded", "box"]["taken_for"] == {"can": 1} and rows["hard", "can"]["taken_for"] == {"none": 1}


def held(before: PoseErrors, after: PoseErrors, seen: float = 1.0) -> ContactTrial:
    return ContactTrial(
        object="box", hand="fetch", grasp=0, contacts=2, seen_share=seen, visible_share=0.5, before=before, after=after,
        cpu_s=0.1,
    )  # fmt: skip


def test_contact_is_judged_in_pairs() -> None:
    good, bad = off(2, 5), off(20, 60)
    trials = [*[held(bad, good)] * 6, held(good, bad, seen=0.0), *[held(good, good)] * 3]
    scores = contact_scores(trials, {"box": 0.1})
    assert (scores["right_without"], scores["right_with"]) == (pytest.approx(0.4), pytest.approx(0.9))
    assert scores["mssd_gain"] == pytest.approx(0.5)
    assert (scores["made_better"], scores["made_worse"]) == (pytest.approx(0.6), pytest.approx(0.1))
    assert scores["sign_p"] == pytest.approx(2 * (1 + 7) / 2**7)  # 6 of 7
    assert (scores["nearer"], scores["further_off"]) == (pytest.approx(0.6), pytest.approx(0.1))
    assert scores["nearer_p"] == scores["sign_p"]
    assert (scores["mssd_median_without_mm"], scores["mssd_median_with_mm"]) == (pytest.approx(60), pytest.approx(5))
    assert contact_scores([held(good, good)], {"box": 0.1})["sign_p"] == 1.0
    figures = pose_figures(PoseBench(contact=trials, diameters_m={"box": 0.1}))
    assert figures["contact_mssd_gain_unseen"] == -1.0
    assert figures["contact_mssd_gain_seen"] == pytest.approx(6 / 9)


def test_a_track_counts_frame_by_frame() -> None:
    lost = TrackTrial(object="box", start=off(1, 2), errors=(off(1, 2), FAILED), cpu_s=(0.004, 0.008))
    kept = TrackTrial(object="box", start=off(1, 2), errors=(off(1, 2), off(1, 2)), cpu_s=(0.004, 0.004))
    figures = pose_figures(PoseBench(tracking=[lost, kept], diameters_m={"box": 0.1}))
    assert (figures["track_kept"], figures["track_kept_to_end"]) == (0.75, 0.5)
    assert figures["track_ms"] == pytest.approx(4.0)


def test_every_figure_has_a_subject() -> None:
    names = expected_figures()
    assert len(set(names)) == len(names)
    assert {"pose_ms", "hard_mssd_01d_open3d", "occluded_rot_median_deg_contact", "easy_adds_auc_small_gicp"} <= set(
        names
    )
    assert {"identity_hard", "background_refused", "calibration_at_90", "contact_mssd_gain", "track_ms"} <= set(names)
    assert "pose_ms_ppf" in figure_names("ppf")


def test_a_run_over_two_objects(measured: PoseBench) -> None:
    per_method = {m: [t for t in measured.methods if t.method == m] for m in ("ours", "baseline")}
    assert [(t.object, t.condition, t.index) for t in per_method["baseline"]] == [
        (name, condition, 0) for name in ("brick", "tin") for condition in ("easy", "occluded", "hard")
    ]
    assert len(per_method["ours"]) == 12 and len(measured.tables) == 12
    ours = [t for t in per_method["ours"] if t.condition == "easy"]
    assert all(is_right(t.errors, measured.diameters_m[t.object]) for t in ours)
    assert measured.diameters_m["brick"] == pytest.approx(2 * math.hypot(0.03, 0.05, 0.08))
    assert all(0 < t.cpu_s < 60 and 0 <= t.confidence <= 1 for t in per_method["ours"])
    assert {(t.kind, t.object) for t in measured.identity} == {
        *((k, name) for k in ("occluded", "hard", "left out") for name in ("brick", "tin")),
        ("background", UNKNOWN_KINDS[0]),
    }  # fmt: skip
    assert all(t.named != t.object for t in measured.identity if t.kind == "left out")
    (brick, tin) = measured.tracking
    assert all(is_right(e, measured.diameters_m["brick"]) for e in brick.errors)
    assert len(brick.errors) == len(tin.errors) == 3 and tin.errors[-1].add_s_m < 0.003
    assert measured.contact == [] and "no shipped run" in measured.absent["contact term"]
    assert all(t.angle_rad < 0.05 and t.height_m < 0.01 for t in measured.tables if not math.isnan(t.angle_rad))


def test_trials_do_not_depend_on_how_they_are_cut_into_tasks(library: Library, measured: PoseBench) -> None:
    alone, _ = measure_methods(library, 1, [1], {"ours": 2}, SMALL.seed)
    same = [t for t in measured.methods if (t.method, t.object, t.index) == ("ours", "tin", 1)]
    assert [(t.condition, t.errors, t.confidence) for t in alone] == [
        (t.condition, t.errors, t.confidence) for t in same
    ]
    scenes = [scene_of(library, 1, "easy", index, SMALL.seed) for index in (0, 1, 1)]
    assert not np.array_equal(scenes[0].depth, scenes[1].depth) and np.array_equal(scenes[1].depth, scenes[2].depth)


def test_what_cannot_be_measured_is_absent_with_the_reason(
    files: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> None:
        raise MissingPeerError(f"{name} is not installed.")

    monkeypatch.setattr(pose_bench, "check_peer", missing)
    nothing = replace(SMALL, scenes=1, identity=0, left_out=0, background=0, sequences=0)
    other = Library(sources=files[:1], run="standins7", run_sources=files)
    for library, said in (
        (Library(sources=files[:1]), "no shipped run"),
        (other, "run 'standins7' is also of "),
    ):
        bench = bench_pose(library, config=nothing, workers=1)
        assert set(bench.absent) == {"contact", "contact term", "open3d", "small_gicp", "ppf", "identity"}
        assert said in bench.absent["contact"] and bench.absent["contact term"] == bench.absent["contact"]
        assert "one object" in bench.absent["identity"] and bench.absent["ppf"] == "ppf is not installed."
        assert {t.method for t in bench.methods} == {"ours", "baseline"}


def test_no_scenes_are_refused() -> None:
    with pytest.raises(InputError, match="0 scenes"):
        PoseBenchConfig(scenes=0)


def test_pushes_are_as_said() -> None:
    pushes = _pushes(20, np.random.default_rng(0))
    shifts, turns = np.array([s for s, _ in pushes]), np.rad2deg([t for _, t in pushes])
    assert ((np.linalg.norm(shifts, axis=1) >= 0.005) & (np.linalg.norm(shifts, axis=1) <= 0.010)).all()
    assert ((np.abs(turns) >= 2) & (np.abs(turns) <= 3)).all() and len({np.sign(t) for t in turns}) == 1
    assert np.abs(np.cumsum(shifts, axis=0)).max() < 0.08 and (shifts[:, 2] == 0).all()


@pytest.fixture(scope="module")
def stand_ins() -> Library:
    return Library(sources=("gelatin_box",), run="standins7", run_sources=tuple(STAND_INS))


def test_the_gripper_stands_at_an_unseen_grasp(stand_ins: Library) -> None:
    run = open_library_run(stand_ins)
    assert has_grasps(run, "gelatin_box") and not has_grasps(run, "brick")
    scene = scene_of(stand_ins, 0, "easy", 0, 0)
    X_OH = np.linalg.inv(scene.X_CO_true) @ gripper_pose(run, scene, np.random.default_rng(1))
    book, grasps = run.codebook, run.grasps["fetch", "gelatin_box"]
    unseen, known = (
        grasps.X_OH[book.grasp_index[book.where(hand="fetch", object_name="gelatin_box", is_test=test)]]
        for test in (True, False)
    )
    assert np.abs(unseen - X_OH).max(axis=(1, 2)).min() < 1e-9
    assert np.abs(known - X_OH).max(axis=(1, 2)).min() > 1e-6


def test_contact_trials_pair_the_same_view(stand_ins: Library) -> None:
    (trial,) = measure_contact(stand_ins, "fetch", "gelatin_box", [3], 0)
    assert (trial.hand, trial.object, trial.grasp) == ("fetch", "gelatin_box", 3)
    assert trial.contacts >= 2 and 0 <= trial.seen_share <= 1 and 0 < trial.visible_share <= 1
    assert trial.after.mssd_m <= max(trial.before.mssd_m, 0.01)


def test_table_rows_hold_what_the_figures_say(measured: PoseBench) -> None:
    figures, table = pose_figures(measured), pose_table(measured)
    (row,) = [r for r in table["methods"] if (r["method"], r["set"]) == ("ours", "hard")]
    assert row["count"] == 4 and row["mssd_01d"] == figures["hard_mssd_01d"] and row["no_pose"] == 0
    assert sum(r["count"] for r in table["objects"] if (r["method"], r["set"]) == ("ours", "hard")) == 4
    assert sum(r["count"] for r in table["visibility"] if (r["method"], r["set"]) == ("ours", "hard")) == 4
    assert table["table_plane"]["found"] == 1.0 - figures["table_missed"]
    missing = PoseBench(tables=[TableTrial(cpu_s=0.1, angle_rad=math.nan, height_m=math.nan)])
    assert pose_table(missing)["table_plane"] == {"count": 1.0, "found": 0.0}
