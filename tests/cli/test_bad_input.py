"""Wrong input of every kind: exit code 2, one clear line, no traceback, nothing half-written."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import neuralgrasps
from tests.cli.conftest import Ended, Pipeline

Call = Callable[..., Ended]

CYCLE = """<robot name="c"><link name="a"/><link name="b"/>
<joint name="j1" type="fixed"><parent link="a"/><child link="b"/></joint>
<joint name="j2" type="fixed"><parent link="b"/><child link="a"/></joint></robot>"""
NAN = """<robot name="n"><link name="a"><collision><geometry><box size="nan 1 1"/></geometry></collision></link>
</robot>"""
BARE = """<robot name="b"><link name="a"/></robot>"""


_TETRAHEDRON = "OFF\n4 4 0\n0 0 0\n{0} 0 0\n0 {0} 0\n0 0 {0}\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with a broken file of every kind."""
    monkeypatch.chdir(tmp_path)
    Path("empty_folder").mkdir()
    Path("bad_parts").mkdir()
    Path("bad_parts/a.stl").touch()
    Path("bad_parts/b.stl").touch()
    Path("cycle.urdf").write_text(CYCLE)
    Path("nan.urdf").write_text(NAN)
    Path("bare.urdf").write_text(BARE)
    Path("torn.urdf").write_text("<robot name=")
    Path("empty.stl").write_text("solid x\nendsolid x\n")
    Path("zero.ply").touch()
    Path("random.stl").write_bytes(np.random.default_rng(0).bytes(700))
    Path("flat.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    Path("nan.off").write_text("OFF\n4 4 0\nnan 0 0\nnan 0 0\nnan 1 0\nnan 0 1\n3 0 1 2\n3 0 1 3\n3 0 2 3\n3 1 2 3\n")
    Path("tiny.off").write_text(_TETRAHEDRON.format(1.25e-4))
    Path("vast.off").write_text(_TETRAHEDRON.format(1e7))
    Path("file").write_text("not a folder")
    return tmp_path


SYNTHESISE = ("synthesise", "--hand", "panda", "--object", "gelatin_box", "--count", 1)


@pytest.mark.parametrize(
    ("args", "expected"),
    [
        (("synthesise", "--hand", "panda", "--object", "none.stl"), "does not exist"),
        (("synthesise", "--hand", "panda", "--object", "empty.stl"), "no vertices"),
        (("synthesise", "--hand", "panda", "--object", "zero.ply"), "empty (0 bytes)"),
        (("synthesise", "--hand", "panda", "--object", "random.stl"), "random.stl"),
        (("synthesise", "--hand", "panda", "--object", "flat.off"), "flat"),
        (("synthesise", "--hand", "panda", "--object", "nan.off"), "finite"),
        (("objects", "show", "tiny.off"), "0.125 mm; expected 5 mm to 3 m"),
        (("objects", "import", "tiny.off"), "0.125 mm; expected 5 mm to 3 m"),
        (("objects", "show", "vast.off"), "--unit"),
        (("synthesise", "--hand", "panda", "--object", "gelatine_box"), "Did you mean 'gelatin_box'?"),
        (("synthesise", "--hand", "pandda", "--object", "gelatin_box"), "Did you mean 'panda'?"),
        (("synthesise", "--hand", "cycle.urdf", "--object", "gelatin_box"), "cycle"),
        (("synthesise", "--hand", "panda"), "--object is missing"),
        (("synthesise",), "--hand and --object are missing"),
        ((*SYNTHESISE, "--seed", -1), "--seed is -1; expected 0 or more"),
        (("demo", "--seed", -1), "--seed is -1"),
        (("bench", "demo", "--seed", -1), "--seed is -1"),
        (("dataset", "build", "nowhere", "--seed", -1), "--seed is -1"),
        (("synthesise", "--hands", "panda", "--objects", "gelatin_box", "flat.off"), "flat"),
        (("synthesise", "--hands", "panda", "--objects", "bad_parts"), "none of 2 mesh files can be used"),
        (("synthesise", "--hand", "panda", "--all"), "Choose one way"),
        ((*SYNTHESISE, "--protocol", "shakes"), "Did you mean 'shake'?"),
        ((*SYNTHESISE[:-1], 0), "count is 0"),
        ((*SYNTHESISE, "--out", "file/g.safetensors"), "not a folder"),
        ((*SYNTHESISE, "--out", "/dev/null"), "device"),
        (("synthesise", "--all", "--hands", "panda", "panda"), "second hand"),
        (("synthesise", "--all", "--workers", 0), "at least 1"),
        (("synthesise", "--all", "--out", "g.safetensors"), "--out-dir"),
        (("synthesise", "--hands", "panda", "--report", "file/p.html"), "not a folder"),
        (("synthesise", "--hands", "panda", "--report", "empty_folder"), "is a folder"),
        (("synthesise", "--hands", "panda", "pandda"), "Did you mean 'panda'?"),
        (("synthesise", "--hands", "panda", "--objects", "gelatine_box"), "Did you mean 'gelatin_box'?"),
        (("synthesise", "--hands", "panda", "--objects", "gelatin_box", "none.stl"), "does not exist"),
        (("synthesise", "--hands", "panda", "--objects", "empty_folder"), "holds no mesh"),
        (("synthesise", "--all", "--object", "gelatin_box"), "Choose one way"),
        (("synthesise", "--all", "--count", 0), "count is 0"),
        (("synthesise", "--all", "--protocol", "shakes"), "Did you mean 'shake'?"),
        ((*SYNTHESISE, "--out-dir", "d"), "--out-dir is of many pairs"),
        ((*SYNTHESISE, "--workers", 0), "at least 1"),
        ((*SYNTHESISE, "--report", "file/p.html"), "not a folder"),
        (("synthesise", "--objects", "gelatin_box", "--mass-kg", -1), "mass_kg is -1"),
        (("synthesise", "--all", "--out-dir", "file"), "expected a folder"),
        (("hands", "check", "nan.urdf"), "finite"),
        (("hands", "check", "bare.urdf"), "no geometry"),
        (("hands", "check", "torn.urdf"), "well-formed"),
        (("hands", "check", "none.urdf"), "does not exist"),
        (("hands", "check", "panda", "--picture", "file/x.png"), "not a folder"),
        (("objects", "show", "none.obj"), "does not exist"),
        (("objects", "import", "file"), "of kind"),
        (("objects", "download", "ycb", "teapot"), "not known"),
        (("dataset", "build", "nowhere"), "nowhere"),
        (("dataset", "build", "file"), "not a grasp file"),
        (("dataset", "build", "."), "no grasp files"),
        (("dataset", "info", "nowhere"), "manifest.json is missing"),
        (("dataset", "verify", "."), "manifest.json is missing"),
        (("train", "nowhere"), "manifest.json is missing"),
        (("evaluate", "nowhere"), "does not exist"),
        (("evaluate", "standin7"), "a run of this library: standins7, ycb7. Did you mean 'standins7'?"),
        (("retrieve", "ycb-7"), "Did you mean 'ycb7'?"),
        (("retrieve", "nowhere"), "neither a folder that `train` wrote nor a run of this library: standins7, ycb7"),
        (("demo", "--objects", "nowhere.stl"), "does not exist"),
        (("demo", "--objects", "empty_folder"), "holds no mesh"),
        (("demo", "--count", 1), "at least"),
        (("bench", "demo", "--objects", "nowhere.stl"), "does not exist"),
    ],
    ids=lambda value: " ".join(map(str, value)) if isinstance(value, tuple) else "",
)
def test_one_clear_line_and_exit_code_2(ng: Call, files: Path, args: tuple[object, ...], expected: str) -> None:
    before = sorted(files.rglob("*"))
    ended = ng(*args)
    assert ended.code == 2, (ended.out, ended.err)
    lines = [line for line in ended.err.splitlines() if line and not line.endswith(("0:10", "0:20"))]  # no heartbeats
    assert len(lines) == 1 and lines[0].startswith("error: "), ended.err
    assert expected in lines[0]
    assert ended.result == {"error": lines[0].removeprefix("error: "), "exit_code": 2}
    assert sorted(p for p in files.rglob("*") if p.name != "result.json") == before


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a folder that not even root can write to")
def test_read_only_folders_are_refused_before_the_work(ng: Call) -> None:
    ended = ng(*SYNTHESISE, "--out", "/proc/none/g.safetensors")
    assert ended.code == 2 and "cannot write" in ended.err and "start poses" not in ended.out


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_folders_without_permission_are_refused(ng: Call, tmp_path: Path) -> None:
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o500)
    ended = ng(*SYNTHESISE, "--out", locked / "g.safetensors")
    assert ended.code == 2 and "no permission" in ended.err


def test_grasps_of_the_wrong_width_are_refused(ng: Call, pipeline: Pipeline, tmp_path: Path) -> None:
    grasps = neuralgrasps.load_grasps(pipeline.grasps / "gelatin_box" / "panda.safetensors")
    wide = {name: np.repeat(getattr(grasps, name), 3, axis=1) for name in ("q", "q_pregrasp", "q_squeeze")}
    file = tmp_path / "wide.safetensors"
    neuralgrasps.save_grasps(file, replace(grasps, **wide))
    expected = "q has 3 columns but hand 'panda' has 1 joints"
    for args in (
        ("evaluate", file),
        ("retrieve", pipeline.run, "--query", file),
        ("dataset", "build", file, "--out", tmp_path / "d"),
    ):
        ended = ng(*args)
        assert ended.code == 2 and expected in ended.err, args
    assert not (tmp_path / "d").exists()


def test_damaged_files_are_refused(ng: Call, pipeline: Pipeline, tmp_path: Path) -> None:
    source = pipeline.grasps / "gelatin_box" / "panda.safetensors"
    data = source.read_bytes()
    damaged = tmp_path / "damaged.safetensors"
    damaged.write_bytes(data[:-8] + bytes(8)[::-1] if data[-8:] != bytes(8) else data[:-8] + b"\x01" * 8)
    assert ng("evaluate", damaged).code == 2
    damaged.write_bytes(data[:200])
    ended = ng("evaluate", damaged)
    assert ended.code == 2 and "damaged" in ended.err
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "manifest.json").write_text("{}")
    assert "schema version" in ng("dataset", "info", tmp_path / "d").err
    (tmp_path / "r").mkdir()
    (tmp_path / "r" / "run.json").write_text("[1, 2")
    assert "damaged" in ng("retrieve", tmp_path / "r").err


def test_runs_and_datasets_are_told_apart(ng: Call, pipeline: Pipeline) -> None:
    train = f"'{pipeline.dataset}' is a dataset, not a run; train it: neuralgrasps train {pipeline.dataset} --out RUN"
    assert train in ng("retrieve", pipeline.dataset).err
    for args in (("dataset", "info", pipeline.run), ("dataset", "verify", pipeline.run), ("train", pipeline.run)):
        ended = ng(*args)
        assert ended.code == 2 and f"'{pipeline.run}' is a run, not a dataset" in ended.err


def test_training_that_cannot_be_is_refused(ng: Call, pipeline: Pipeline, tmp_path: Path) -> None:
    for options, said in (
        (("--steps", 0), "--steps is 0; expected at least 1"),
        (("--learning-rate", -1), "--learning-rate is -1; expected above 0, at most 1"),
        (("--learning-rate", "nan"), "--learning-rate is nan"),
    ):
        ended = ng("train", pipeline.dataset, "--out", tmp_path / "r", *options)
        assert ended.code == 2 and said in ended.err and not (tmp_path / "r").exists()
    ended = ng("dataset", "verify", pipeline.dataset, "--spot-checks", -1)
    assert ended.code == 2 and "--spot-checks is -1; expected 0" in ended.err


def test_grasps_that_are_not_there(ng: Call, pipeline: Pipeline) -> None:
    assert "numbered" in ng("retrieve", pipeline.run, "--query-index", 99).err
    assert "Known objects: gelatin_box" in ng("retrieve", pipeline.run, "--object", "cup").err
    assert "Known hands" in ng("retrieve", pipeline.run, "--hand", "human").err


def test_another_model_of_a_hand_is_noticed(ng: Call, pipeline: Pipeline, tmp_path: Path) -> None:
    folder = Path(neuralgrasps.__file__).parent / "assets" / "hands" / "panda"
    text = (folder / "hand.xml").read_text()
    (tmp_path / "hand.toml").write_text((folder / "hand.toml").read_text())
    (tmp_path / "hand.xml").write_text(text.replace('size="', 'size="0.0011 ', 1) if 'size="' in text else text)
    ended = ng("train", pipeline.dataset, "--out", tmp_path / "run", "--hands", tmp_path / "hand.xml", "--steps", 1)
    assert ended.code == 2 and not (tmp_path / "run").exists()
