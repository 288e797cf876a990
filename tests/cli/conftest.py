"""Running the command line in this process, and one small pipeline that the verbs are tried on."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from neuralgrasps.cli.main import run


@dataclass(frozen=True, slots=True, kw_only=True)
class Ended:
    """How a command ended: exit code, both streams, and its JSON object."""

    code: int
    out: str
    err: str
    result: Mapping[str, Any] = field(default_factory=dict)


@pytest.fixture(scope="session", autouse=True)
def home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A home folder of its own: nothing of the user's is read or changed."""
    folder = tmp_path_factory.mktemp("home")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NEURALGRASPS_HOME", str(folder))
        yield folder


@pytest.fixture
def ng(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Callable[..., Ended]:
    """Run `neuralgrasps ARGS --json FILE`."""

    def call(*args: object) -> Ended:
        target = tmp_path / "result.json"
        target.unlink(missing_ok=True)
        capsys.readouterr()
        code = run([*map(str, args), "--json", str(target)])
        text = capsys.readouterr()
        result = json.loads(target.read_text()) if target.is_file() else {}
        return Ended(code=code, out=text.out, err=text.err, result=result)

    return call


@dataclass(frozen=True, slots=True, kw_only=True)
class Pipeline:
    """Grasps of two jaws on one object, their dataset, and a field fitted to it."""

    grasps: Path
    dataset: Path
    run: Path
    record: Mapping[str, Any]


@pytest.fixture(scope="session")
def pipeline(tmp_path_factory: pytest.TempPathFactory) -> Pipeline:
    folder = tmp_path_factory.mktemp("pipeline")
    grasps, dataset, fitted = folder / "grasps", folder / "dataset", folder / "run"
    made = folder / "made.json"
    pairs = ("--hands", "panda", "fetch", "--objects", "gelatin_box", "--count", "6", "--workers", "1")
    assert run(["synthesise", *pairs, "--out-dir", str(grasps), "--json", str(made)]) == 0
    built = ("--store-samples", "--queries", "200", "--workers", "1")
    assert run(["dataset", "build", str(grasps), "--out", str(dataset), *built]) == 0
    assert run(["train", str(dataset), "--out", str(fitted), "--steps", "3", "--batch", "4"]) == 0
    return Pipeline(grasps=grasps, dataset=dataset, run=fitted, record=json.loads(made.read_text()))
