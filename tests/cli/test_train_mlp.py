from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from neuralgrasps.model import mlp_infer
from neuralgrasps.model.mlp_run import load_mlp_run
from tests.cli.conftest import Ended, Pipeline

Call = Callable[..., Ended]


def test_published_field_of_one_object(ng: Call, pipeline: Pipeline, tmp_path: Path, monkeypatch) -> None:
    for name in ("PUBLISHED_ON_CPU", "PLACED"):  # the whole network for all steps takes a minute
        monkeypatch.setattr(mlp_infer, name, replace(getattr(mlp_infer, name), steps=8, points=64))
    out = tmp_path / "run"
    asked = ("train", pipeline.dataset, "--out", out, "--field", "mlp", "--threads", 1)
    ended = ng(*asked, "--minutes", 0.02)
    assert ended.code == 0 and "gelatin_box" in ended.out
    figures, run = ended.result, load_mlp_run(out)
    assert figures["finished"] and figures["samples"] == run.samples > 0
    assert run.field.object_name == "gelatin_box" and set(run.codebook.hands) == {"fetch", "panda"}
    unseen = run.codebook.is_test
    assert run.placed is not None and not np.array_equal(run.placed.values[unseen], run.codebook.values[unseen])
    assert "8 steps from near 0" in run.notes["test_codes"] and "not published" in run.notes["placed_codes"]
    assert run.codebook.is_test.sum() == 2 and run.codebook.metric_size == 128
    assert {len(g) for g in run.grasps.values()} == {6} and np.isfinite(run.codebook.values).all()
    # the same command, now without --minutes, finds the training finished and keeps its weights
    assert ng(*asked).code == 0
    assert np.array_equal(load_mlp_run(out).codebook.values, run.codebook.values)


def test_wrong_options_of_the_published_field(ng: Call, pipeline: Pipeline, tmp_path: Path) -> None:
    mlp = ("train", pipeline.dataset, "--out", tmp_path / "run", "--field", "mlp")
    assert "Known objects: gelatin_box" in ng(*mlp, "--object", "cup").err
    assert "--minutes and --epochs" in ng(*mlp, "--minutes", 1, "--epochs", 1).err
    assert "cannot be used" in ng(*mlp, "--device", "nowhere", "--minutes", 1).err
    assert "--field mlp" in ng("train", pipeline.dataset, "--out", tmp_path / "run", "--epochs", 2).err
    assert not (tmp_path / "run").exists()
