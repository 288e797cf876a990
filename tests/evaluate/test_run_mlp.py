"""An `MlpField`'s run measured: hands and object by their surfaces, each way of finding codes on its own."""

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.dataset.samples import Normalisation
from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.evaluate.reconstruction import score_object, score_object_shapes
from neuralgrasps.evaluate.run_mlp import evaluate_mlp_run
from neuralgrasps.evaluate.run_pairs import MeasureConfig
from neuralgrasps.evaluate.run_scores import INPUTS, LEARNED, SDF_AND_MAPS, SDF_SAMPLES, RunScores
from neuralgrasps.geometry.primitives import sphere_mesh
from neuralgrasps.hands.packed import pack_hand
from neuralgrasps.model.codes import join_codes
from neuralgrasps.model.field_surface import FieldSurface
from neuralgrasps.model.mlp_data import object_scenes
from neuralgrasps.model.mlp_field import MlpConfig
from neuralgrasps.model.mlp_run import MlpRun, free_codebook, load_mlp_run, save_mlp_run
from neuralgrasps.model.mlp_schedule import MlpTrainConfig
from neuralgrasps.model.mlp_train import train_mlp

FRAME = Normalisation(offset_O=np.zeros(3), scale_m=0.12)
QUICK = MeasureConfig(queries=4_000, points=300, per_pair=1, seed=1)


def ball(radius: float, slope: float = 1.0):
    return lambda p: slope * (np.linalg.norm(p, axis=1) - radius)


def scored(distance):
    shape = FieldSurface(distance, normalisation=FRAME, cells=40)
    return score_object_shapes([shape], sphere_mesh(0.04), object_name="ball", normalisation=FRAME, queries=4_000)


def test_a_flat_field_does_not_win() -> None:
    """A ball 1 cm too large is 1 cm off, however flat the field is; |f| at the true surface says 0.1 mm."""
    flat = ball(0.05, slope=0.01)
    assert scored(flat).surface.mean_m == pytest.approx(0.01, abs=3e-4)
    by_value = score_object(flat, sphere_mesh(0.04), object_name="ball", normalisation=FRAME, queries=4_000)
    assert by_value.surface.mean_m == pytest.approx(1e-4, rel=0.05)
    exact = scored(ball(0.04))
    assert exact.surface.p95_m < 4e-4 and exact.chamfer == pytest.approx(exact.oracle, rel=0.03)
    with pytest.raises(ShapeError, match="no shapes"):
        score_object_shapes([], sphere_mesh(0.04), object_name="ball", normalisation=FRAME)


def test_stray_surfaces_of_the_object_count() -> None:
    def stray(p: np.ndarray) -> np.ndarray:
        return np.minimum(ball(0.04)(p), np.linalg.norm(p - [0.0, 0.0, 0.1], axis=1) - 0.015)

    assert scored(stray).surface.p95_m > 0.04


def test_what_lies_outside_the_ball_does_not_count() -> None:
    """A stray surface in a corner of the box, and an inside that goes on beyond the ball: closed at its edge."""

    def corner(p: np.ndarray) -> np.ndarray:
        return np.minimum(ball(0.04)(p), np.linalg.norm(p - 0.11, axis=1) - 0.02)

    assert scored(corner).surface.p95_m < 5e-4
    wide = FieldSurface(corner, normalisation=FRAME, cells=40, reach=2.0)
    assert np.linalg.norm(wide.mesh.vertices, axis=1).max() > 0.2
    endless = FieldSurface(lambda p: -np.ones(len(p)), normalisation=FRAME, cells=40).mesh
    assert np.allclose(np.linalg.norm(endless.vertices, axis=1), 0.12, atol=0.004)


@pytest.fixture(scope="module")
def run(small_dataset, tmp_path_factory) -> MlpRun:
    config = MlpTrainConfig(
        epochs=150, points_per_scene=96, step_scenes=0, step_points=96, far_share=0.3, net_rate=5e-3, code_rate=3e-2,
        code_std=0.1, schedule="one-cycle", threads=1, decoder=MlpConfig(layers=4, width=64, dropout=0.0),
    )  # fmt: skip
    scenes = object_scenes(small_dataset, "brick")
    result = train_mlp(scenes, config=config, device="cpu")
    unseen = object_scenes(small_dataset, "brick", part="test")
    nearest = np.abs(unseen.contact_maps[:, None] - scenes.contact_maps).sum(axis=2).argmin(axis=1)
    mean = np.repeat(result.codes.mean(axis=0)[None], len(unseen), axis=0)
    books = [free_codebook(scenes, result.codes), free_codebook(unseen, mean, is_test=True)]
    folder = tmp_path_factory.mktemp("mlp")
    grasps = [small_dataset.grasps(hand, "brick") for hand in scenes.hands]
    save_mlp_run(folder, result, join_codes(books), placed=result.codes[nearest], grasps=grasps)
    return load_mlp_run(folder)


@pytest.fixture(scope="module")
def packed(small_world) -> dict:
    return {name: pack_hand(hand, spacing=0.01) for name, hand in small_world.hands.items()}


@pytest.fixture(scope="module")
def scores(run: MlpRun, packed: dict, small_world) -> RunScores:
    return evaluate_mlp_run(run, packed, small_world.objects["brick"], part="both", config=QUICK)


def test_each_way_of_finding_codes_has_rows_of_its_own(scores: RunScores) -> None:
    cases = [("test", SDF_SAMPLES), ("test", SDF_AND_MAPS), ("train", LEARNED)]
    assert list(scores.parts_and_inputs) == cases and "published inference" in INPUTS[SDF_SAMPLES]
    gaps = {(r.part, r.input): r.gap for r in scores.similarities}
    # all unseen grasps have the same code, so that it finds nothing; the other is that of the best grasp
    assert gaps["test", SDF_AND_MAPS] == pytest.approx(0.0, abs=1e-9) and gaps["test", SDF_SAMPLES] > 0.05
    for case in cases:
        assert {r.hand for r in scores.hands if (r.part, r.input) == case} == {"allegro", "fetch"}
        (shape,) = scores.objects_of(*case)
        assert shape.input == case[1] and shape.shapes == 2
        assert 0 < shape.surface_mean_mm < 40 and np.isfinite(shape.chamfer_e3)
    assert len({r.surface_mean_mm for r in scores.objects}) == 3  # every case has its own codes' object


def test_scores_below_a_perfect_field_are_named(scores: RunScores) -> None:
    row = scores.objects[0]
    hollow = replace(row, chamfer_e3=0.7 * row.oracle_e3)
    fine = replace(row, chamfer_e3=1.1 * row.oracle_e3)
    for shape, names in ((hollow, ("brick: object",)), (fine, ())):
        one = replace(scores, hands=(), objects=(shape,))
        assert one.below_perfect("test", SDF_SAMPLES) == names
        assert ("hollow" in one.chamfer_note("test", SDF_SAMPLES)) is bool(names)
        assert one.record()["against_paper"][0]["below_a_perfect_field"] == names


def test_contact_maps_decay_as_in_the_dataset(run: MlpRun, scores: RunScores, packed: dict, small_world) -> None:
    wide = replace(run, contact_decay=10.0)
    again = evaluate_mlp_run(wide, packed, small_world.objects["brick"], part="train", config=QUICK)
    before = {r.hand: r.contact_error_mean for r in scores.hands if r.part == "train"}
    assert all(r.contact_error_mean < 0.3 * before[r.hand] for r in again.hands)  # all maps near 1


def test_what_cannot_be_measured_is_said(run: MlpRun, packed: dict, small_world) -> None:
    brick = small_world.objects["brick"]
    only = replace(run, codebook=run.codebook[~run.codebook.is_test], placed=None)
    with pytest.raises(InputError, match="holds no codes of test"):
        evaluate_mlp_run(only, packed, brick, config=QUICK)
    with pytest.raises(InputError, match="keeps no grasps"):
        evaluate_mlp_run(replace(run, grasps={}), packed, brick, config=QUICK)
    with pytest.raises(InputError, match="expected 'test', 'train' or 'both'"):
        evaluate_mlp_run(run, packed, brick, part="spare", config=QUICK)
