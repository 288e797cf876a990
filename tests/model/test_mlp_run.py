"""What a stored run of the `MlpField` may and may not hold."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file, save_file

from neuralgrasps.errors import DataFormatError, DeviceError, ShapeError
from neuralgrasps.model.codes import join_codes
from neuralgrasps.model.mlp_bench import made_up_scenes
from neuralgrasps.model.mlp_field import MlpConfig
from neuralgrasps.model.mlp_run import free_codebook, load_mlp_run, save_mlp_run
from neuralgrasps.model.mlp_schedule import MlpTrainConfig
from neuralgrasps.model.mlp_train import MlpResult, train_mlp

SMALL = MlpTrainConfig(
    epochs=1, points_per_scene=32, step_scenes=0, step_points=32, threads=1, decoder=MlpConfig(layers=2, width=16)
)


@pytest.fixture(scope="module")
def result() -> MlpResult:
    return train_mlp(made_up_scenes(4, 200), config=SMALL, device="cpu")


def saved(result: MlpResult, folder: Path, placed: np.ndarray | None = None) -> Path:
    scenes = made_up_scenes(4, 200)
    books = [free_codebook(scenes, result.codes), free_codebook(scenes, result.codes + 1, is_test=True)]
    return save_mlp_run(folder, result, join_codes(books), placed=placed)


def test_both_kinds_of_unseen_codes_come_back(result: MlpResult, tmp_path: Path) -> None:
    run = load_mlp_run(saved(result, tmp_path, result.codes + 2))
    assert run.placed is not None and run.contact_decay == 0.05
    unseen = run.codebook.is_test
    assert np.array_equal(run.codebook.values[unseen], result.codes + 1)
    assert np.array_equal(run.placed.values[unseen], result.codes + 2)
    assert np.array_equal(run.placed.values[~unseen], result.codes)
    assert load_mlp_run(saved(result, tmp_path)).placed is None
    with pytest.raises(ShapeError, match=r"placed codes have shape \(3, 128\)"):
        saved(result, tmp_path, result.codes[:3])


def _set(key: str, value: Any) -> Callable[[dict], None]:
    return lambda record: record.__setitem__(key, value)


def _config(key: str, value: Any) -> Callable[[dict], None]:
    return lambda record: record["config"].__setitem__(key, value)


def _decoder(key: str, value: Any) -> Callable[[dict], None]:
    return lambda record: record["config"]["decoder"].__setitem__(key, value)


@pytest.mark.parametrize(
    "harm",
    [
        *(_set(key, value) for key in ("sha256", "config", "objects", "hands", "scale_m", "clamp", "contact_decay",
                                       "samples", "notes") for value in (None, -1.5, "x", ["a", 3])),
        _set("scale_m", float("nan")), _set("hands", []), _set("objects", []), _set("version", "mlp-1"),
        _config("epochs", 0), _config("epochs", "x"), _config("more", 1), _decoder("layers", 10**9),
        _decoder("width", 10**7), _decoder("code_size", 7), _decoder("norm", "no"), _decoder("skip_layers", 3),
        lambda record: record.pop("sha256"), lambda record: record["sha256"].pop("codes.safetensors"),
        lambda record: record["sha256"].__setitem__("grasps/../../x", "0"),
        lambda record: record["sha256"].__setitem__("grasps/a/b.safetensors", "0"),
    ],
)  # fmt: skip
def test_a_record_that_was_tampered_with_is_refused(result: MlpResult, tmp_path: Path, harm) -> None:
    path = saved(result, tmp_path) / "run.json"
    record = json.loads(path.read_text())
    harm(record)
    path.write_text(json.dumps(record))
    with pytest.raises(DataFormatError):
        load_mlp_run(tmp_path)


@pytest.mark.parametrize("text", ["", "[]", "{", "[" * 100_000, "3", "\x00", '{"version": "mlp-2"}'])
def test_what_is_no_record_is_refused(result: MlpResult, tmp_path: Path, text: str) -> None:
    (saved(result, tmp_path) / "run.json").write_text(text)
    with pytest.raises(DataFormatError):
        load_mlp_run(tmp_path)


def test_codes_that_do_not_fit_are_refused(result: MlpResult, tmp_path: Path) -> None:
    path = saved(result, tmp_path) / "codes.safetensors"
    arrays = load_file(path)
    for name, value in (("values", arrays["values"][:, :5].copy()), ("hand_index", arrays["hand_index"] + 7)):
        save_file(arrays | {name: value}, path)
        record = json.loads((tmp_path / "run.json").read_text())
        record["sha256"][path.name] = hashlib.sha256(path.read_bytes()).hexdigest()
        (tmp_path / "run.json").write_text(json.dumps(record))
        with pytest.raises(DataFormatError):
            load_mlp_run(tmp_path)


@pytest.mark.parametrize("device", ["gpu", "mps", "meta", "cuda:-3", "cuda:99", "", "tpu"])
def test_devices_that_are_not_there(result: MlpResult, tmp_path: Path, device: str) -> None:
    with pytest.raises(DeviceError, match=r"cannot be used.*[Ee]xpected 'cpu'"):
        load_mlp_run(saved(result, tmp_path), device=device)
    with pytest.raises(DeviceError, match=r"cannot be used.*[Ee]xpected 'cpu'"):
        train_mlp(made_up_scenes(4, 200), config=SMALL, device=device)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU here")
def test_a_gpu_that_is_not_there(result: MlpResult, tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="device 'cuda' cannot be used"):
        load_mlp_run(saved(result, tmp_path), device="cuda")


def test_files_outside_the_run_are_not_read(result: MlpResult, tmp_path: Path) -> None:
    (tmp_path / "other").write_bytes(b"x")
    path = saved(result, tmp_path / "run") / "run.json"
    (tmp_path / "run" / "grasps").mkdir(exist_ok=True)
    record = json.loads(path.read_text())
    record["sha256"]["grasps/../../other"] = hashlib.sha256(b"x").hexdigest()
    path.write_text(json.dumps(record))
    with pytest.raises(DataFormatError, match="outside the run"):
        load_mlp_run(tmp_path / "run")
