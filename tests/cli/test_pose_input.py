"""Wrong input of `pose`: exit code 2, one clear line that says what to do, nothing half-written."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from neuralgrasps.cli.pose_input import is_flat
from neuralgrasps.geometry.camera import Intrinsics, look_at
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.sim.camera import render_depth_view
from tests.cli.conftest import Ended

Call = Callable[..., Ended]
X_WC = look_at(np.array([0.5, 0.1, 0.45]), np.zeros(3))


def save_depth(path: str, depth: np.ndarray, units_per_metre: float = 1000) -> None:
    Image.fromarray((np.asarray(depth) * units_per_metre).round().astype(np.uint16)).save(path)


@pytest.fixture(scope="module")
def table_depth() -> np.ndarray:
    """(120, 160) depth of a box on a table, camera at `X_WC`."""
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, 2, 3] = 0.04, -0.01
    meshes = [box_mesh([0.05, 0.04, 0.04]), box_mesh([0.5, 0.5, 0.01])]
    camera = Intrinsics(150, 150, 79.5, 59.5, 160, 120)
    return render_depth_view(meshes, poses, X_WC=X_WC, intrinsics=camera).depth


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, table_depth: np.ndarray) -> Path:
    """The working folder, with broken observations of every kind."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    bottle = rng.uniform([-0.03, -0.09, 0.7], [0.03, 0.09, 0.73], (400, 3))
    save_depth("table.png", table_depth)
    save_depth("blank.png", np.zeros((120, 160)))
    np.save("nan.npy", np.full((120, 160), np.nan))
    np.save("mm.npy", table_depth * 1000)
    Image.fromarray((table_depth * 100).astype(np.uint8)).save("eight.png")
    Image.fromarray(np.zeros((120, 160, 3), np.uint8)).save("colour.png")
    Image.fromarray(np.zeros((60, 80, 3), np.uint8)).save("small.png")
    Image.fromarray(np.zeros((120, 160), np.uint8)).save("no_mask.png")
    Image.fromarray(np.full((60, 80), 255, np.uint8)).save("small_mask.png")
    Image.fromarray(np.full((120, 160), 255, np.uint8)).save("all.png")
    save_depth("clutter.png", rng.uniform(0.5, 2.0, (120, 160)))
    save_depth("far.png", rng.uniform(3.5, 12.0, (120, 160)))
    np.savetxt("pose.txt", X_WC)
    np.savetxt("upside_down.txt", np.diag([1.0, -1.0, -1.0, 1.0]) @ X_WC)
    Path("broken.json").write_text("{fx: 1")
    Path("empty").mkdir()
    Path("pictures").mkdir()
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save("pictures/holiday.png")
    Path("frames").mkdir()
    save_depth("frames/1-depth.png", table_depth)
    Path("blanks").mkdir()
    for k in "12":
        save_depth(f"blanks/{k}-depth.png", np.zeros((120, 160)))
    Path("words.xyz").write_text("here 1\nbe 2\ndragons 3\n")
    Path("few.xyz").write_text("0 0 0\n1 1 1\n")
    Path("zero.ply").touch()
    np.save("objects.npy", np.array([{"a": 1}]), allow_pickle=True)
    np.save("none.npy", np.zeros((0, 3)))
    np.save("nan_cloud.npy", np.full((500, 3), np.nan))
    np.save("mm_cloud.npy", bottle * 1000)
    np.save("cm_cloud.npy", bottle * 100)
    np.save("behind.npy", bottle * [1, -1, -1])
    np.save("line.npy", np.linspace([0, -0.08, 0.7], [0, 0.08, 0.7], 400))
    np.save("spot.npy", bottle * 0.01 + [0, 0, 0.7])
    np.save("wide.npy", rng.uniform([-1, -1, 0.7], [1, 1, 0.7001], (400, 3)))
    np.save("good.npy", bottle)
    Path("file").write_text("not a folder")
    return tmp_path


def on(*args: object) -> tuple[object, ...]:
    return ("pose", "mustard_bottle", *args)


DEPTH = ("--depth", "table.png", "--fx", 150)


@pytest.mark.parametrize(
    ("args", "expected"),
    [
        # what to look at
        (on(), "either --cloud FILE, --depth FILE or --frames FOLDER, one of them; got none"),
        (on("--cloud", "good.npy", "--depth", "table.png"), "got --depth and --cloud"),
        (on(*DEPTH, "--frames", "frames"), "got --depth and --frames"),
        (("pose", "--cloud", "good.npy"), "no object was given"),
        (("pose", "mustard_botle", "--cloud", "good.npy"), "Did you mean 'mustard_bottle'?"),
        (("pose", "nowhere.stl", "--cloud", "good.npy"), "does not exist"),
        (("pose", "empty", "--cloud", "good.npy"), "holds no mesh"),
        (("pose", "mustard_bottle", "mustard_bottle", "--cloud", "good.npy"), "second object"),
        (on("--cloud", "good.npy", "--seed", -1), "--seed is -1"),
        # options that contradict each other
        (on("--cloud", "good.npy", "--fx", 500), "--fx goes with --depth or --frames, not with --cloud"),
        (on("--cloud", "good.npy", "--mask", "all.png"), "--mask goes with --depth, not with --cloud"),
        (on("--cloud", "good.npy", "--depth-scale", 1000), "--depth-scale goes with --depth or --frames"),
        (on(*DEPTH, "--cloud-scale", 1000), "--cloud-scale goes with --cloud, not with --depth"),
        (on("--frames", "frames", "--mask", "all.png"), "--mask goes with --depth, not with --frames"),
        (on("--frames", "frames", "--camera-pose", "pose.txt"), "Frames of a folder bring their own"),
        (on(*DEPTH, "--camera", "camera.json"), "--camera and --fx both give the camera"),
        (on("--depth", "table.png", "--cx", 80), "--cx was given without --fx"),
        (on(*DEPTH, "--table-height", 0), "--camera-pose"),
        (on("--frames", "frames", "--fx", 150, "--table-height", 0), "has no camera pose"),
        (on(*DEPTH, "--max-depth", 0), "--max-depth is 0"),
        (on(*DEPTH, "--track"), "--track follows objects through the frames"),
        # where to write
        (on("--cloud", "good.npy", "--out", "o.png"), "give --depth FILE instead of --cloud"),
        (on(*DEPTH, "--out", "o.jpg"), "expected a file ending in .png, or a folder"),
        (on("--frames", "frames", "--fx", 150, "--out", "o.png"), "give a folder"),
        (on(*DEPTH, "--out", "file/o.png"), "not a folder"),
        (on(*DEPTH, "--out", "file"), "expected a folder"),
        # clouds
        (on("--cloud", "missing.ply"), "does not exist"),
        (on("--cloud", "zero.ply"), "empty (0 bytes)"),
        (on("--cloud", "few.xyz"), "at least 20"),
        (on("--cloud", "none.npy"), "0 finite points"),
        (on("--cloud", "words.xyz"), "words.xyz"),
        (on("--cloud", "objects.npy"), "objects.npy"),
        (on("--cloud", "nan_cloud.npy"), "0 finite points (500 others are NaN or infinite)"),
        (on("--cloud", "mm_cloud.npy"), "looks like millimetres: --cloud-scale 1000"),
        (on("--cloud", "behind.npy"), "behind the camera"),
        (on("--cloud", "line.npy"), "on a line"),
        (on("--cloud", "spot.npy"), "is the unit right? --cloud-scale is 1"),
        (on("--cloud", "wide.npy"), "a cloud must hold one object; to find objects in a scene give --depth"),
        (on("--cloud", "cm_cloud.npy"), "looks like centimetres: --cloud-scale 100"),
        (on("--cloud", "good.npy", "--cloud-scale", 0), "--cloud-scale is 0"),
        # depth images
        (on("--depth", "missing.png", "--fx", 150), "does not exist"),
        (on("--depth", "file", "--fx", 150), "cannot be read"),
        (on("--depth", "table.png"), "give --fx PIXELS"),
        (on("--depth", "table.png", "--camera", "missing.json"), "does not exist"),
        (on("--depth", "table.png", "--camera", "broken.json"), "not JSON"),
        (on("--depth", "table.png", "--fx", 150, "--depth-scale", 0), "--depth-scale is 0"),
        (on("--depth", "blank.png", "--fx", 150), "no measurement"),
        (on("--depth", "nan.npy", "--fx", 150), "no measurement"),
        (on("--depth", "mm.npy", "--fx", 150), "--depth-scale"),
        (on("--depth", "eight.png", "--fx", 150), "8 bits"),
        (on("--depth", "colour.png", "--fx", 150), "one channel"),
        (on(*DEPTH, "--colour", "small.png"), "80 x 60"),
        (on(*DEPTH, "--mask", "small_mask.png"), "80 x 60"),
        (on(*DEPTH, "--mask", "no_mask.png"), "marks no pixel"),
        (on(*DEPTH, "--mask", "all.png"), "give only the object's points (--mask)"),
        (on("--depth", "clutter.png", "--fx", 150), "table"),
        (on("--depth", "far.png", "--fx", 150), "is --depth-scale right?"),
        (on(*DEPTH, "--camera-pose", "upside_down.txt"), "upside down"),
        (on(*DEPTH, "--camera-pose", "file"), "pose 'file'"),
        (on(*DEPTH, "--camera-pose", "pose.txt", "--table-height", 3), "below the table"),
        # folders
        (on("--frames", "missing", "--fx", 150), "does not exist"),
        (on("--frames", "pictures", "--fx", 150), "has no depth images"),
        (on("--frames", "frames"), "give --fx PIXELS"),
        (on("--frames", "blanks", "--fx", 150), "no measurement"),
    ],
    ids=lambda value: " ".join(map(str, value)) if isinstance(value, tuple) else "",
)  # fmt: skip
def test_one_clear_line_and_exit_code_2(ng: Call, files: Path, args: tuple[object, ...], expected: str) -> None:
    before = sorted(files.rglob("*"))
    ended = ng(*args)
    assert ended.code == 2, (ended.out, ended.err)
    lines = [line for line in ended.err.splitlines() if line and not line.endswith(("0:10", "0:20", "run only"))]
    assert len(lines) == 1 and lines[0].startswith("error: "), ended.err
    assert expected in lines[0]
    assert ended.result == {"error": lines[0].removeprefix("error: "), "exit_code": 2}
    assert sorted(p for p in files.rglob("*") if p.name != "result.json") == before


def test_scenes_of_a_bop_data_set_bring_their_camera(ng: Call, files: Path) -> None:
    scene = files / "000001"
    scene.mkdir()
    (scene / "scene_camera.json").write_text(json.dumps({}))
    ended = ng(*on("--frames", scene, "--fx", 150))
    assert ended.code == 2 and "scene_camera.json gives camera and scale" in ended.err
    ended = ng(*on("--frames", scene))
    assert ended.code == 2 and "no depth images" in ended.err


def test_points_on_one_plane_are_noted() -> None:
    rng = np.random.default_rng(1)
    flat = rng.uniform([-0.05, -0.05, 0], [0.05, 0.05, 1e-4], (300, 3))
    assert is_flat(flat)
    assert not is_flat(rng.uniform(-0.05, 0.05, (300, 3)))
    bent = np.where(flat[:, :1] > 0, flat[:, [2, 1, 0]], flat)  # two faces of a box
    assert not is_flat(bent)
