"""Frames, clouds and cameras from files."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import Intrinsics, look_at
from neuralgrasps.perception.camera_file import CameraNumbers, read_camera
from neuralgrasps.perception.frame_files import (
    list_frames,
    read_cloud,
    read_colour,
    read_depth,
    read_frame,
    read_frames,
    read_mask,
    read_pose,
)

WIDTH, HEIGHT = 32, 24
CAMERA = Intrinsics(40.0, 41.0, 15.0, 11.0, WIDTH, HEIGHT)
DEPTH_MM = np.linspace(600, 1400, WIDTH * HEIGHT).round().astype(np.uint16).reshape(HEIGHT, WIDTH)
COLOUR = np.arange(WIDTH * HEIGHT * 3, dtype=np.uint32).reshape(HEIGHT, WIDTH, 3).astype(np.uint8)


def _save(path, array):
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, array) if path.suffix == ".npy" else Image.fromarray(array).save(path)
    return path


def _same(frame):
    np.testing.assert_allclose(frame.depth, DEPTH_MM / 1000.0, atol=1e-9)
    np.testing.assert_array_equal(frame.colour, COLOUR)


@pytest.mark.parametrize(
    ("depth", "colour"),
    [
        ("{}-depth.png", "{}-color.png"),
        ("{}_depth.png", "{}_rgb.png"),
        ("{}.depth.png", "{}.color.png"),
        ("depth/{}.png", "rgb/{}.png"),
        ("depth/{}.tif", "colour/{}.bmp"),
    ],
)
def test_a_folder_of_frames_is_paired_by_name(tmp_path, depth, colour):
    for name in ("000010", "000002"):
        _save(tmp_path / depth.format(name), DEPTH_MM)
        _save(tmp_path / colour.format(name), COLOUR)
    (tmp_path / "000002-overlay.png").write_bytes(b"not an image")
    frames = read_frames(tmp_path, intrinsics=CAMERA)
    assert [f.name for f in frames] == ["000002", "000010"]
    for frame in frames:
        _same(frame)
        assert frame.intrinsics == CAMERA
    assert len(read_frames(tmp_path, intrinsics=CAMERA, limit=1)) == 1


def test_colour_and_pose_may_lack_and_are_taken_where_they_are(tmp_path):
    X_WC = look_at(np.array([0.4, 0.3, 0.5]), np.zeros(3))
    _save(tmp_path / "a-depth.npy", (DEPTH_MM / 1000.0).astype(np.float32))
    _save(tmp_path / "b-depth.png", DEPTH_MM)
    _save(tmp_path / "c-color.png", COLOUR)
    np.savetxt(tmp_path / "b-pose.txt", X_WC)
    a, b = read_frames(tmp_path, intrinsics=CameraNumbers(fx=40.0, units_per_metre=1000.0))
    np.testing.assert_allclose(a.depth, b.depth, atol=1e-6)  # a depth scale of whole numbers is not for floating ones
    assert a.colour is None and a.X_WC is None
    np.testing.assert_allclose(b.X_WC, X_WC, atol=1e-12)
    assert a.intrinsics == Intrinsics(40.0, 40.0, 15.5, 11.5, WIDTH, HEIGHT)


def test_a_folder_without_frames_says_what_it_holds(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        list_frames(tmp_path / "none")
    with pytest.raises(InputError, match="It holds nothing"):
        list_frames(tmp_path)
    _save(tmp_path / "photo.png", COLOUR)
    with pytest.raises(InputError, match=r"no depth images.*photo\.png"):
        list_frames(tmp_path)
    (tmp_path / "scene_camera.json").write_text("{}")
    with pytest.raises(InputError, match="BOP"):
        list_frames(tmp_path)


def test_two_files_for_one_image_are_refused(tmp_path):
    for name in ("a-depth.png", "a_depth.tif"):
        _save(tmp_path / name, DEPTH_MM)
    with pytest.raises(InputError, match="two depth files"):
        list_frames(tmp_path)


K = [[40.0, 0.0, 15.0], [0.0, 41.0, 11.0], [0.0, 0.0, 1.0]]


@pytest.mark.parametrize(
    "data",
    [
        {"fx": 40, "fy": 41, "cx": 15, "cy": 11, "width": WIDTH, "height": HEIGHT, "depth_scale": 10000},
        {"fx": 40, "fy": 41, "ppx": 15, "ppy": 11, "depth_scale": 0.0001},
        {"cam_K": np.ravel(K).tolist(), "depth_scale": 0.1},
        {"intrinsic_matrix": np.transpose(K).ravel().tolist(), "width": WIDTH, "height": HEIGHT, "depth_scale": 0.1},
        {"color": {"fx": 40, "fy": 41, "cx": 15, "cy": 11}, "depth_scale": 10000},
        K,
    ],
)
def test_cameras_are_read_however_they_are_written(tmp_path, data):
    (tmp_path / "camera.json").write_text(json.dumps(data))
    _save(tmp_path / "x-depth.png", DEPTH_MM * 10)
    _save(tmp_path / "x-color.png", COLOUR)
    scale = 10000 if isinstance(data, list) else None
    (frame,) = read_frames(tmp_path, depth_scale=scale)
    _same(frame)
    assert frame.intrinsics == CAMERA
    assert read_frame(tmp_path / "x-depth.png", depth_scale=20000).depth.max() == pytest.approx(0.7)


def test_a_camera_file_that_holds_none_is_named(tmp_path):
    path = tmp_path / "camera.json"
    for text, reason in (
        ("{", "not JSON"), ('{"f": 1}', "its names are f"), ("[1, 2]", "2 numbers"), ('{"fx": "wide"}', "wide"),
        ("[[1, 0, 0], [0, 1, 0], [0, 0, 5]]", "its matrix is"), ('{"fx": 1, "depth_scale": -1}', "depth_scale is -1"),
    ):  # fmt: skip
        path.write_text(text)
        with pytest.raises(InputError, match=reason):
            read_camera(path)
    with pytest.raises(InputError, match="does not exist"):
        read_camera(tmp_path / "other.json")


def test_missing_or_foreign_intrinsics_are_said(tmp_path):
    path = _save(tmp_path / "x-depth.png", DEPTH_MM)
    with pytest.raises(InputError, match="give --fx"):
        read_frame(path)
    with pytest.raises(InputError, match=r"is 32 x 24 pixels but the camera's images are 640 x 480"):
        read_frame(path, intrinsics=Intrinsics(600.0, 600.0, 320.0, 240.0, 640, 480))


def test_a_wrong_scale_and_other_sizes_are_said(tmp_path):
    path = _save(tmp_path / "x-depth.png", DEPTH_MM)
    with pytest.raises(InputError, match="--depth-scale"):
        read_frame(path, intrinsics=CAMERA, depth_scale=1.0)
    with pytest.raises(InputError, match="metres were read as millimetres"):
        read_frame(_save(tmp_path / "m.npy", DEPTH_MM / 1000.0), intrinsics=CAMERA, depth_scale=1000.0)
    with pytest.raises(InputError, match="--depth-scale is 0"):
        read_frame(path, intrinsics=CAMERA, depth_scale=0.0)
    with pytest.raises(InputError, match="pixel by pixel"):
        read_frame(path, colour=_save(tmp_path / "c.png", COLOUR[:12]), intrinsics=CAMERA)


def test_files_that_are_no_depth_are_named(tmp_path):
    with pytest.raises(InputError, match="8 bits per pixel"):
        read_depth(_save(tmp_path / "a.png", COLOUR[..., 0]), None)
    with pytest.raises(InputError, match="one channel"):
        read_depth(_save(tmp_path / "b.png", COLOUR), None)
    with pytest.raises(InputError, match="does not exist"):
        read_depth(tmp_path / "none.png", None)
    (tmp_path / "empty.png").touch()
    with pytest.raises(InputError, match="0 bytes"):
        read_depth(tmp_path / "empty.png", None)
    (tmp_path / "text.npy").write_text("hello")
    with pytest.raises(InputError, match="cannot be read"):
        read_depth(tmp_path / "text.npy", None)


def test_colour_is_neither_flipped_nor_rescaled(tmp_path):
    np.testing.assert_array_equal(read_colour(_save(tmp_path / "c.png", COLOUR)), COLOUR)
    grey = read_colour(_save(tmp_path / "g.png", COLOUR[..., 0]))
    np.testing.assert_array_equal(grey, np.repeat(COLOUR[..., :1], 3, axis=2))
    see_through = np.concatenate([COLOUR, np.full((HEIGHT, WIDTH, 1), 9, np.uint8)], axis=2)
    np.testing.assert_array_equal(read_colour(_save(tmp_path / "a.png", see_through)), COLOUR)


def test_masks_are_what_is_not_zero(tmp_path):
    mask = COLOUR[..., 0] > 100
    for name, array in (("m.png", mask.astype(np.uint8)), ("m.npy", mask), ("c.png", COLOUR * mask[..., None])):
        np.testing.assert_array_equal(read_mask(_save(tmp_path / name, array), (HEIGHT, WIDTH)), mask)
    with pytest.raises(InputError, match="32 x 24; the depth image 48 x 36"):
        read_mask(tmp_path / "m.png", (36, 48))


def test_poses_are_read_from_text_arrays_and_json(tmp_path):
    X = look_at(np.array([0.4, 0.3, 0.5]), np.zeros(3))
    np.save(tmp_path / "p.npy", X)
    np.savetxt(tmp_path / "p.txt", X)
    np.savetxt(tmp_path / "p.csv", X[:3], delimiter=",")
    (tmp_path / "p.json").write_text(json.dumps({"X_WC": X.tolist()}))
    for name in ("p.npy", "p.txt", "p.csv", "p.json"):
        np.testing.assert_allclose(read_pose(tmp_path / name), X, atol=1e-12)
    for text, reason in (("1 2 3", "shape"), ("a b", "cannot be read"), (" ".join(["2"] * 12), "reflection")):
        (tmp_path / "bad.txt").write_text(text)
        with pytest.raises(InputError, match=reason):
            read_pose(tmp_path / "bad.txt")


def test_clouds_are_read_from_text_and_arrays(tmp_path):
    points = np.random.default_rng(0).normal(size=(30, 3))
    np.save(tmp_path / "c.npy", np.hstack([points, points]))
    np.savetxt(tmp_path / "c.xyz", points, header="x y z")
    np.savetxt(tmp_path / "c.csv", points, delimiter=",")
    for name in ("c.npy", "c.xyz", "c.csv"):
        np.testing.assert_allclose(read_cloud(tmp_path / name), points, atol=1e-12)
    with pytest.raises(InputError, match=r"of kind '\.obj'"):
        read_cloud(_save(tmp_path / "c.npy", points).rename(tmp_path / "c.obj"))
    np.save(tmp_path / "flat.npy", points[:, 0])
    with pytest.raises(InputError, match=r"\(M, 3\)"):
        read_cloud(tmp_path / "flat.npy")


def test_the_real_frames_are_read(assets):
    camera = CameraNumbers(fx=1066.778, fy=1067.487, cx=312.987, cy=241.311)
    frames = read_frames(assets / "rgbd_ycb", intrinsics=camera, depth_scale=10000)
    assert [f.name for f in frames] == [f"00000{i}" for i in range(1, 6)]
    for frame in frames:
        assert frame.colour is not None and frame.colour.shape == (480, 640, 3)
        assert 0.8 < np.median(frame.depth[frame.depth > 0]) < 2.0
    red = frames[0].colour[200, 300].astype(int)  # the front of the red cracker box: its channels are not swapped
    assert red[0] > 2 * red[2]
