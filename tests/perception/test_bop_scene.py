"""BOP scene folders, written here."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import Intrinsics, look_at
from neuralgrasps.perception.bop_scene import bop_images, is_bop_scene, read_bop_scene

CAMERA = Intrinsics(40.0, 41.0, 15.0, 11.0, 32, 24)
X_WC = look_at(np.array([0.4, 0.3, 0.5]), np.zeros(3))
X_CO = np.tile(np.eye(4), (2, 1, 1))
X_CO[:, :3, :3] = Rotation.from_rotvec([[0.3, 1.0, -0.5], [2.0, 0.1, 0.0]]).as_matrix()
X_CO[:, :3, 3] = [[0.02, -0.1, 0.8], [0.1, 0.05, 1.1]]
DEPTH_M = np.linspace(0.6, 1.4, 32 * 24).reshape(24, 32)


def _write(folder, *, annotated=True, images=(3, 12)):
    """A scene whose depth is stored in tenths of millimetres."""
    for name in ("depth", "rgb", "mask_visib"):
        (folder / name).mkdir(parents=True)
    X_CW = np.linalg.inv(X_WC)
    for i in images:
        Image.fromarray((DEPTH_M * 1e4).round().astype(np.uint16)).save(folder / f"depth/{i:06d}.png")
        Image.fromarray(np.full((24, 32, 3), i, np.uint8)).save(folder / f"rgb/{i:06d}.jpg", quality=100)
        for k in range(2):
            mask = np.zeros((24, 32), np.uint8)
            mask[4 * k : 4 * k + 3] = 255
            Image.fromarray(mask).save(folder / f"mask_visib/{i:06d}_{k:06d}.png")
    camera = {
        "cam_K": CAMERA.matrix.ravel().tolist(), "depth_scale": 0.1, "cam_R_w2c": X_CW[:3, :3].ravel().tolist(),
        "cam_t_w2c": (X_CW[:3, 3] * 1e3).tolist(),
    }  # fmt: skip
    truth = [
        {"obj_id": 5 * k + 2, "cam_R_m2c": X[:3, :3].ravel().tolist(), "cam_t_m2c": (X[:3, 3] * 1e3).tolist()}
        for k, X in enumerate(X_CO)
    ]
    (folder / "scene_camera.json").write_text(json.dumps({str(i): camera for i in images}))
    if annotated:
        (folder / "scene_gt.json").write_text(json.dumps({str(i): truth for i in images}))
    return folder


def test_a_scene_is_read_in_metres(tmp_path):
    scene = read_bop_scene(_write(tmp_path / "000048"))
    assert [s.image for s in scene] == [3, 12]
    assert [s.frame.name for s in scene] == ["000048/000003", "000048/000012"]
    for one in scene:
        np.testing.assert_allclose(one.frame.depth, DEPTH_M, atol=6e-5)
        np.testing.assert_allclose(one.X_CO, X_CO, atol=1e-9)
        np.testing.assert_allclose(one.frame.X_WC, X_WC, atol=1e-9)
        assert one.frame.intrinsics == CAMERA
        assert one.object_ids == (2, 7)
        assert [int(m.sum()) for m in one.masks] == [96, 96]
        assert one.masks[1][4].all() and not one.masks[1][3].any()
        assert one.frame.colour.shape == (24, 32, 3) and abs(one.frame.colour.mean() - one.image) < 2


def test_annotations_masks_and_colour_may_lack(tmp_path):
    folder = _write(tmp_path / "s", annotated=False)
    (folder / "mask_visib/000003_000000.png").unlink()
    (folder / "rgb/000003.jpg").unlink()
    first, second = read_bop_scene(folder)
    assert first.X_CO is None and first.object_ids == ()
    assert first.masks[0] is None and first.masks[1] is not None
    assert first.frame.colour is None and second.frame.colour is not None


def test_chosen_images_only(tmp_path):
    folder = _write(tmp_path / "s")
    assert bop_images(folder) == [3, 12]
    (one,) = read_bop_scene(folder, images=[12])
    assert one.image == 12
    with pytest.raises(InputError, match="no image 4; it has 2, from 3 to 12"):
        read_bop_scene(folder, images=[3, 4])


def test_a_folder_of_scenes_says_which_there_are(tmp_path):
    for name in ("000001", "000002"):
        _write(tmp_path / "test" / name)
    assert is_bop_scene(tmp_path / "test") and is_bop_scene(tmp_path / "test/000001")
    assert not is_bop_scene(tmp_path)
    with pytest.raises(InputError, match=r"holds 2 BOP scenes \(000001, 000002\); give one"):
        read_bop_scene(tmp_path / "test")
    with pytest.raises(InputError, match=r"no scene_camera.json"):
        read_bop_scene(tmp_path)
    with pytest.raises(InputError, match="does not exist"):
        read_bop_scene(tmp_path / "none")


def _break(folder, name, change):
    data = json.loads((folder / name).read_text())
    change(data["3"])
    (folder / name).write_text(json.dumps(data))


@pytest.mark.parametrize(
    ("name", "change", "reason"),
    [
        ("scene_camera.json", lambda c: c.pop("cam_K"), "cam_K"),
        ("scene_camera.json", lambda c: c.update(depth_scale=0.0), "depth_scale 0"),
        ("scene_camera.json", lambda c: c.update(depth_scale=1000.0), "--depth-scale"),
        ("scene_gt.json", lambda t: t[0].pop("obj_id"), "obj_id"),
        ("scene_gt.json", lambda t: t[1].update(cam_R_m2c=[1.0, 0, 0]), "3 and 3 numbers"),
        ("scene_gt.json", lambda t: t[1].update(cam_R_m2c=np.diag([1, 1, -1.0]).ravel().tolist()), "reflection"),
    ],
)
def test_broken_records_are_named(tmp_path, name, change, reason):
    folder = _write(tmp_path / "s")
    _break(folder, name, change)
    with pytest.raises(InputError, match=reason) as caught:
        read_bop_scene(folder)
    assert "s" in str(caught.value)


def test_files_that_are_not_records_are_named(tmp_path):
    folder = _write(tmp_path / "s")
    (folder / "scene_gt.json").write_text("[1]")
    with pytest.raises(InputError, match="cannot be read as records"):
        read_bop_scene(folder)
    (folder / "depth").rename(folder / "gone")
    with pytest.raises(InputError, match="no depth images"):
        bop_images(folder)
