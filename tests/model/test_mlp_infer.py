"""Codes of unseen scenes of an `MlpField`."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.model import mlp_infer
from neuralgrasps.model.mlp_bench import made_up_scenes
from neuralgrasps.model.mlp_data import ObjectScenes, SceneSamples, object_scenes
from neuralgrasps.model.mlp_field import MlpConfig
from neuralgrasps.model.mlp_infer import (
    PUBLISHED,
    ContactTerm,
    MlpInferConfig,
    infer_codes,
    infer_scenes,
    maps_from_samples,
    published_inference,
)
from neuralgrasps.model.mlp_schedule import MlpTrainConfig
from neuralgrasps.model.mlp_train import train_mlp

SMALL = MlpTrainConfig(
    epochs=8,
    points_per_scene=64,
    step_scenes=0,
    step_points=64,
    net_rate=5e-3,
    code_rate=1e-2,
    code_std=0.1,
    threads=1,
    decoder=MlpConfig(layers=3, width=32, code_size=8, dropout=0.1),
)


@pytest.fixture(scope="module")
def scenes() -> ObjectScenes:
    return made_up_scenes(6, 400)


def one_scene(scenes: ObjectScenes, k: int) -> SceneSamples:
    samples = scenes.samples
    return SceneSamples(
        rows=samples.rows[k : k + 1],
        positive=samples.positive[k : k + 1],
        inside=samples.inside[k : k + 1],
        far=samples.far[k : k + 1],
    )


def test_inference_finds_codes_and_scenes_do_not_matter_to_each_other(scenes: ObjectScenes) -> None:
    config = replace(SMALL, epochs=300, decoder=replace(SMALL.decoder, dropout=0.0))
    result = train_mlp(scenes, config=config, device="cpu")
    how = MlpInferConfig(steps=60, points=128, rate=0.02, precision="fp32")
    start = infer_codes(result.field, scenes.samples, config=replace(how, steps=0))
    found = infer_codes(result.field, scenes.samples, config=how)
    assert found.losses.mean() < 0.8 * start.losses.mean()
    alone = infer_codes(result.field, one_scene(scenes, 4), config=how)
    assert np.allclose(alone.codes[0], found.codes[4], atol=1e-3)
    nearest = infer_codes(
        result.field, scenes.samples, known=result.codes, config=replace(how, steps=0, start="nearest")
    )
    assert (np.abs(nearest.codes[:, None] - result.codes).sum(axis=2).argmin(axis=1) == np.arange(6)).mean() > 0.6
    with pytest.raises(InputError, match="without known codes"):
        infer_codes(result.field, scenes.samples, config=replace(how, start="nearest"))


@pytest.mark.parametrize(
    "wrong",
    [{"schedule": "foo"}, {"precision": "fp99"}, {"prior": "none"}, {"start": "far"}, {"triplets": 0},
     {"triplet_weight": -1.0}, {"triplet_weight": float("nan")}],
)  # fmt: skip
def test_wrong_inference_is_refused(wrong: dict) -> None:
    with pytest.raises(InputError, match=f"{next(iter(wrong))} .*expected"):
        MlpInferConfig(**wrong)


def test_published_inference_says_what_it_is() -> None:
    assert (PUBLISHED.steps, PUBLISHED.points, PUBLISHED.start, PUBLISHED.prior) == (800, 8_000, "zero", "square")
    assert published_inference("cuda") == PUBLISHED
    assert published_inference("cpu") == replace(PUBLISHED, points=published_inference("cpu").points)


def test_the_prior_pulls_as_its_kind_says() -> None:
    how = MlpInferConfig()
    # far from 0 the square pulls as 2 z / D, the norm as z / |z|: one plain step tells them from each other
    z = torch.full((1, 8), 2.0, requires_grad=True)
    for kind, slope in (("norm", 8**-0.5), ("square", 0.5)):
        (gradient,) = torch.autograd.grad(mlp_infer._priors(z, replace(how, prior=kind)).sum(), z)
        assert torch.allclose(gradient, torch.full((1, 8), slope))


def test_the_fast_path_is_given_back_when_inference_stops(scenes: ObjectScenes) -> None:
    result = train_mlp(scenes, config=replace(SMALL, epochs=1), device="cpu")

    def stopped(done: int, total: int, loss: float) -> None:
        raise KeyboardInterrupt

    for before, precision in ((False, "bf16"), (True, "fp32")):
        result.field.decoder.fast = before
        with pytest.raises(KeyboardInterrupt):
            infer_codes(result.field, scenes.samples, config=MlpInferConfig(precision=precision), progress=stopped)
        assert result.field.decoder.fast is before


def test_maps_decay_as_those_of_the_dataset_do(scenes: ObjectScenes, monkeypatch) -> None:
    result = train_mlp(scenes, config=replace(SMALL, epochs=1), device="cpu")
    asked = []
    monkeypatch.setattr(
        mlp_infer, "maps_from_samples", lambda s, p, *, decay: asked.append(decay) or scenes.contact_maps
    )
    infer_scenes(
        result.field, replace(scenes, contact_decay=0.2), known=scenes, known_codes=result.codes,
        contact_points_O=np.zeros((64, 3)), config=MlpInferConfig(steps=0),
    )  # fmt: skip
    assert asked == [0.2]


def test_maps_are_read_off_samples(small_dataset) -> None:
    scenes = object_scenes(small_dataset, "brick")
    stored = small_dataset.object("brick")
    maps = maps_from_samples(scenes.samples, stored.normalisation.to_unit(stored.points_O), decay=scenes.contact_decay)
    assert np.abs(maps - scenes.contact_maps).mean() < 0.1  # 300 samples around the object
    between = np.abs(scenes.contact_maps[:, None] - scenes.contact_maps).mean(axis=2)
    assert (np.abs(maps[:, None] - scenes.contact_maps).mean(axis=2).argmin(axis=1) == np.arange(20)).all()
    assert between[~np.eye(20, dtype=bool)].min() > 0


def test_contact_maps_place_a_code_among_the_known_ones(scenes: ObjectScenes) -> None:
    many = made_up_scenes(30, 400)
    config = replace(
        SMALL,
        epochs=200,
        triplets_per_anchor=16,
        code_rate=0.05,
        code_std=0.4,
        decoder=replace(SMALL.decoder, dropout=0.0),
        schedule="one-cycle",
    )
    result = train_mlp(many, config=config, device="cpu")
    new = made_up_scenes(6, 400, seed=1)
    by_map = np.linalg.norm(new.contact_maps[:, None] - many.contact_maps, axis=2)
    how = MlpInferConfig(steps=150, points=64, rate=0.05, schedule="cosine", start_std=0.1)
    term = ContactTerm(maps=new.contact_maps, known_maps=many.contact_maps)
    agreement = []
    for contact in (None, term):
        codes = infer_codes(result.field, new.samples, known=result.codes, contact=contact, config=how).codes
        by_code = np.linalg.norm(codes[:, None] - result.codes, axis=2)
        agreement.append(np.corrcoef(by_code.ravel(), by_map.ravel())[0, 1])
    assert agreement[1] > 0.75 and agreement[1] > agreement[0] + 0.1
    with pytest.raises(ShapeError, match="one row per scene"):
        infer_codes(result.field, scenes.samples.to("cpu"), known=result.codes[:2], contact=term, config=how)
