"""The `pose` verb: what it finds, prints and writes."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import neuralgrasps
from neuralgrasps.cli.pose_find import Finding, Placed
from neuralgrasps.cli.pose_show import frame_record, others_text, sigmas
from neuralgrasps.evaluate.pose import pose_errors
from neuralgrasps.geometry.camera import Intrinsics, back_project, look_at, project
from neuralgrasps.geometry.mesh import load_mesh
from neuralgrasps.geometry.primitives import box_mesh, cylinder_mesh, sphere_mesh
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.resting import resting_poses
from neuralgrasps.report.pose_overlay import model_colour
from neuralgrasps.sim.camera import render_depth_view
from tests.cli.conftest import Ended

Call = Callable[..., Ended]
CAMERA = Intrinsics(300, 300, 159.5, 119.5, 320, 240)
NAMES = ("mustard_bottle", "gelatin_box")


@dataclass(frozen=True)
class Room:
    """A folder of two frames of a bottle and a box on a table, and the true poses in each."""

    folder: Path
    objects: dict[str, ObjectModel]
    X_CO: dict[str, dict[str, np.ndarray]]
    masks: dict[str, Path]


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Room:
    folder = tmp_path_factory.mktemp("room")
    objects = {name: neuralgrasps.load_object(name) for name in NAMES}
    X_WO = {name: resting_poses(obj.mesh.vertices, obj.com_O)[0][0] for name, obj in objects.items()}
    for name, place in zip(NAMES, ((0.0, -0.08), (0.02, 0.08)), strict=True):
        X_WO[name][:2, 3] += place
    table = np.eye(4)
    table[2, 3] = -0.01
    poses: dict[str, dict[str, np.ndarray]] = {}
    masks = {}
    for frame, eye in (("a", (0.45, 0.1, 0.42)), ("b", (0.44, 0.13, 0.42))):
        X_WC = look_at(np.array(eye), np.array([0.0, 0.0, 0.03]))
        meshes = [*(objects[name].mesh for name in NAMES), box_mesh([0.4, 0.4, 0.01])]
        view = render_depth_view(
            meshes, np.stack([*(X_WO[name] for name in NAMES), table]), X_WC=X_WC, intrinsics=CAMERA
        )
        Image.fromarray((view.depth * 1e4).round().astype(np.uint16)).save(folder / f"{frame}-depth.png")
        colour = np.array([[200, 180, 40], [180, 60, 50], [90, 90, 95], [20, 20, 22]], np.uint8)[view.mesh_index]
        Image.fromarray(colour).save(folder / f"{frame}-color.png")
        np.savetxt(folder / f"{frame}-pose.txt", X_WC)
        poses[frame] = {name: np.linalg.inv(X_WC) @ X_WO[name] for name in NAMES}
        for k, name in enumerate(NAMES):
            masks[f"{frame} {name}"] = folder / f"{frame}.{name}.png"
            Image.fromarray(((view.mesh_index == k) * 255).astype(np.uint8)).save(masks[f"{frame} {name}"])
            np.save(folder / f"{frame}.{name}.npy", back_project(view.depth, CAMERA, mask=view.mesh_index == k))
    camera = {"fx": 300, "fy": 300, "cx": 159.5, "cy": 119.5, "width": 320, "height": 240, "depth_scale": 10000}
    (folder / "camera.json").write_text(json.dumps(camera))
    return Room(folder, objects, poses, masks)


def check(room: Room, frame: str, found: dict[str, object]) -> None:
    """The record of an object is right to a millimetre or so."""
    name = str(found["object"])
    errors = pose_errors(room.objects[name], np.array(found["X_CO_m"]), room.X_CO[frame][name])
    assert errors.mssd_m < 0.005, (frame, name)
    assert found["converged"] and 0.5 <= float(found["confidence"]) <= 1.0  # type: ignore[arg-type]
    np.testing.assert_allclose(found["position_m"], np.array(found["X_CO_m"])[:3, 3])
    assert abs(np.linalg.norm(found["quaternion_wxyz"]) - 1) < 1e-6  # type: ignore[arg-type]


def test_one_object_from_a_mask_and_from_clouds(ng: Call, room: Room, tmp_path: Path) -> None:
    depth = ("--depth", room.folder / "a-depth.png", "--mask", room.masks["a mustard_bottle"])
    cloud = room.folder / "a.mustard_bottle.npy"
    np.savetxt(tmp_path / "cloud.xyz", np.load(cloud) * 1e3)
    for source in (
        (*depth, "--out", tmp_path / "overlay.png"),
        (*depth, "--depth-scale", 10000, "--camera", room.folder / "camera.json", "--table-height", 0,
         "--camera-pose", room.folder / "a-pose.txt"),
        ("--cloud", cloud),
        ("--cloud", tmp_path / "cloud.xyz", "--cloud-scale", 1000),
    ):  # fmt: skip
        found = ng("pose", "mustard_bottle", *source)
        assert found.code == 0, found.err
        check(room, "a", dict(found.result))
        assert found.result["residual_median_mm"] < 1.0 and found.result["explained_share"] > 0.8
        assert found.result["frames"][0]["objects"][0]["X_CO_m"] == found.result["X_CO_m"]
        for word in ("mustard_bottle: found", "% sure", "position", "± ", "quaternion", "explained", "X_CO ="):
            assert word in found.out
        words = " ".join(found.out.split())
        assert "mm (spread of the fit and an assumed sensor error)" in words
        assert ("a cloud cannot rule out larger objects" in words) == ("--cloud" in source)
        assert ("depth scale: 10000 units per metre" in words) == ("--depth" in source)
        assert "only one object is known" not in words
    with Image.open(tmp_path / "overlay.png") as image:
        assert image.size == (640, 480)


def test_points_of_another_object_are_not_found(ng: Call, room: Room) -> None:
    found = ng("pose", "gelatin_box", "--cloud", room.folder / "a.mustard_bottle.npy", "--cloud-scale", 1.3)
    assert found.code == 1 and not found.result["converged"] and found.result["confidence"] < 0.5
    assert "NOT found" in found.out and found.result["found"] == 0


def test_poses_that_were_not_accepted_are_recorded_apart(room: Room) -> None:
    obj = room.objects["gelatin_box"]
    points = np.load(room.folder / "a.gelatin_box.npy")
    sure = replace(neuralgrasps.estimate_pose(obj, points), confidence=0.8)
    placed = tuple(Placed(obj=obj, pose=replace(sure, confidence=c), points=len(points)) for c in (0.8, 0.49))
    record = frame_record(Finding(name="a", placed=placed))
    assert [r["confidence"] for r in record["objects"]] == [0.8]
    assert [(r["confidence"], r["converged"]) for r in record["rejected"]] == [(0.49, False)]


def test_a_mask_and_several_objects_say_which_one_it_is(ng: Call, room: Room) -> None:
    source = ("--depth", room.folder / "a-depth.png", "--mask", room.masks["a gelatin_box"])
    found = ng("pose", *NAMES, "cracker_box", *source)
    assert found.code == 0, found.err
    (frame,) = found.result["frames"]
    (placed,) = frame["objects"]
    assert placed["object"] == "gelatin_box"
    check(room, "a", placed)
    assert sum(frame["identity_probability"].values()) == pytest.approx(1, abs=1e-3)
    assert "which one: gelatin_box" in found.out


def test_everything_on_the_table_is_found_without_a_mask(ng: Call, room: Room, tmp_path: Path) -> None:
    source = ("--depth", room.folder / "a-depth.png", "--colour", room.folder / "a-color.png")
    found = ng("pose", *NAMES, "cracker_box", *source, "--out", tmp_path / "new" / "overlay.png")
    assert found.code == 0, found.err
    (frame,) = found.result["frames"]
    assert sorted(o["object"] for o in frame["objects"]) == sorted(NAMES)
    for placed in frame["objects"]:
        check(room, "a", placed)
    assert frame["unexplained_clusters"] == 0 and "no accepted object explains" not in found.out
    assert frame["depth_units_per_metre"] == 10000 and 0.4 < frame["table"]["distance_m"] < 0.9
    assert f"table: {frame['table']['distance_m']:.2f} m away" in found.out and "is --depth-scale" not in found.out
    assert frame["not_found"] == ["cracker_box"] and "not found: cracker_box" in found.out
    normal_W = np.loadtxt(room.folder / "a-pose.txt")[:3, :3] @ frame["table"]["normal_C"]
    assert normal_W[2] > 0.999 and frame["table"]["rms_mm"] < 1
    with Image.open(tmp_path / "new" / "overlay.png") as image:
        picture = np.asarray(image)
    assert picture.shape == (480, 640, 3)
    centre = room.X_CO["a"]["gelatin_box"][:3, 3]
    column, row = (2 * int(300 * centre[k] / centre[2] + c) for k, c in ((0, 159.5), (1, 119.5)))
    around = picture[row - 60 : row + 60, column - 60 : column + 60].reshape(-1, 3).astype(int)
    rank = [o["object"] for o in frame["objects"]].index("gelatin_box")
    colour = [int(model_colour(rank)[k : k + 2], 16) for k in (1, 3, 5)]
    assert (np.abs(around - colour).max(axis=1) < 40).sum() > 100


def test_a_lone_object_may_be_a_similar_one_and_leaves_clusters(ng: Call, room: Room, tmp_path: Path) -> None:
    found = ng("pose", "gelatin_box", "--depth", room.folder / "a-depth.png", "--out", tmp_path)
    assert found.code == 0, found.err
    (frame,) = found.result["frames"]
    assert [o["object"] for o in frame["objects"]] == ["gelatin_box"] and frame["unexplained_clusters"] == 1
    page = (tmp_path / "index.html").read_text()
    for text in (" ".join(found.out.split()), page):
        assert "nly one object is known: a similar one may be taken for it." in text
        assert "1 cluster on the table that no accepted object explains." in text


def test_a_wrong_depth_scale_is_asked_for(ng: Call, room: Room) -> None:
    found = ng("pose", "gelatin_box", "--depth", room.folder / "a-depth.png", "--depth-scale", 1000)
    assert found.code == 1, found.out
    words = " ".join(found.out.split())
    assert "m away" in words and "is --depth-scale right?" in words and "depth scale: 1000 units" in words


def test_a_folder_of_frames_is_read_frame_by_frame(ng: Call, room: Room, tmp_path: Path) -> None:
    out = tmp_path / "out"
    found = ng("pose", *NAMES, "--frames", room.folder, "--out", out)
    assert found.code == 0, found.err
    assert [f["frame"] for f in found.result["frames"]] == ["a", "b"] and found.result["found"] == 4
    for frame in found.result["frames"]:
        assert sorted(o["object"] for o in frame["objects"]) == sorted(NAMES)
        for placed in frame["objects"]:
            check(room, frame["frame"], placed)
    assert sorted(p.name for p in out.iterdir()) == ["a.png", "b.png", "index.html", "poses.json"]
    numbers = json.loads((out / "poses.json").read_text())
    assert numbers["frames"] == found.result["frames"] and numbers["found"] == 4
    page = (out / "index.html").read_text()
    assert page.count("<figure>") == 2 and "mustard bottle" in page and "What the numbers mean" in page
    assert "[a]" in found.out and "4 objects found in 2 frames." in found.out
    alone = ng("pose", *NAMES, "--depth", room.folder / "b-depth.png", "--camera", room.folder / "camera.json")
    same = {o["object"]: o["X_CO_m"] for o in alone.result["frames"][0]["objects"]}
    for placed in found.result["frames"][1]["objects"]:  # by default nothing is taken over from frame a
        np.testing.assert_array_equal(placed["X_CO_m"], same[placed["object"]])


def test_tracking_goes_on_from_the_frame_before(ng: Call, room: Room) -> None:
    tracked = ng("pose", *NAMES, "--frames", room.folder, "--track")
    searched = ng("pose", *NAMES, "--frames", room.folder)
    assert tracked.code == 0, tracked.err
    for k, (frame, other) in enumerate(zip(tracked.result["frames"], searched.result["frames"], strict=True)):
        assert len(frame["objects"]) == 2
        for placed in frame["objects"]:
            check(room, frame["frame"], placed)
        same = [a["X_CO_m"] for a in frame["objects"]] == [b["X_CO_m"] for b in other["objects"]]
        assert same == (k == 0)  # the first frame is searched, the next one is not


def test_a_broken_frame_does_not_stop_the_others(ng: Call, room: Room, tmp_path: Path) -> None:
    for path in room.folder.glob("a-*.png"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / "camera.json").write_bytes((room.folder / "camera.json").read_bytes())
    Image.fromarray(np.zeros((240, 320), np.uint16)).save(tmp_path / "b-depth.png")
    found = ng("pose", "gelatin_box", "--frames", tmp_path, "--out", tmp_path / "out")
    assert found.code == 0, found.err
    good, bad = found.result["frames"]
    check(room, "a", good["objects"][0])
    assert "no measurement" in bad["problem"] and bad["not_found"] == ["gelatin_box"] and not bad["objects"]
    assert "no measurement" in found.out
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["a.png", "index.html", "poses.json"]


def test_a_bop_scene_is_read(ng: Call, room: Room, tmp_path: Path) -> None:
    scene = tmp_path / "000048"
    for kind in ("depth", "rgb"):
        (scene / kind).mkdir(parents=True)
    (scene / "depth" / "000007.png").write_bytes((room.folder / "a-depth.png").read_bytes())
    (scene / "rgb" / "000007.png").write_bytes((room.folder / "a-color.png").read_bytes())
    record = {"7": {"cam_K": [300, 0, 159.5, 0, 300, 119.5, 0, 0, 1], "depth_scale": 0.1}}
    (scene / "scene_camera.json").write_text(json.dumps(record))
    found = ng("pose", *NAMES, "--frames", scene, "--out", tmp_path / "out")
    assert found.code == 0, found.err
    assert found.result["frames"][0]["frame"] == "000007"
    for placed in found.result["frames"][0]["objects"]:
        check(room, "a", placed)
    assert (tmp_path / "out" / "000007.png").is_file()


def test_a_real_frame(ng: Call, assets: Path) -> None:
    """The sugar box among other things in a real image: drawn where a person sees it (its box marked by hand)."""
    mesh, frame = assets / "ycb" / "004_sugar_box.ply", assets / "rgbd_ycb" / "000002"
    camera = ("--fx", 1066.778, "--fy", 1067.487, "--cx", 312.987, "--cy", 241.311, "--depth-scale", 10000)
    found = ng("pose", mesh, "--depth", f"{frame}-depth.png", "--colour", f"{frame}-color.png", *camera)
    assert found.code == 0, found.err
    placed = max(found.result["frames"][0]["objects"], key=lambda o: o["confidence"])
    X_CO = np.array(placed["X_CO_m"])
    pixels = project(
        load_mesh(mesh).mesh.vertices @ X_CO[:3, :3].T + X_CO[:3, 3],
        Intrinsics(1066.778, 1067.487, 312.987, 241.311, 640, 480),
    )
    corners = np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])
    assert np.abs(corners - [192, 285, 332, 446]).max() < 15
    assert placed["confidence"] > 0.9 and placed["residual_median_mm"] < 5


def test_spread_leaves_out_turns_that_no_one_can_see(make_object: Callable[..., ObjectModel]) -> None:
    can = make_object("can", cylinder_mesh(0.03, 0.05), symmetry=True)
    X_CO = np.linalg.inv(look_at(np.array([0.4, 0.1, 0.2]), np.zeros(3)))
    axis_C = X_CO[:3, :3] @ can.symmetry.continuous_axis
    covariance = np.diag([1e-6, 4e-6, 1e-6, 0.0, 0.0, 0.0])
    covariance[3:, 3:] = 9.0 * np.outer(axis_C, axis_C) + (math.radians(0.5)) ** 2 * np.eye(3)
    position_mm, rotation_deg = sigmas(can, X_CO, covariance)
    assert position_mm == pytest.approx(2.0) and rotation_deg == pytest.approx(0.5)
    box = make_object("box", box_mesh([0.02, 0.03, 0.05]))
    assert sigmas(box, X_CO, covariance)[1] == pytest.approx(math.degrees(3.0), rel=0.01)
    ball = make_object("ball", sphere_mesh(0.04), symmetry=True)
    assert sigmas(ball, X_CO, covariance)[1] is None


def test_other_poses_in_words() -> None:
    def other(probability: float, turn: float, shift: float) -> dict[str, float]:
        return {"probability": probability, "rotation_deg": turn, "translation_mm": shift}

    assert others_text([]) == ""
    assert others_text([other(0.004, 180, 1), other(0.3, 1.0, 0.4)]) == ""  # too unlikely; the same pose
    assert others_text([other(0.12, 179.6, 3.2)]) == "12 % turned 180°, moved 3 mm"
    many = others_text([other(0.1, 90.0 + k, 3) for k in range(5)])
    assert many.count("turned") == 3 and many.endswith("; 2 more")
