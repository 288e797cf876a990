"""What is said of depth images and cameras with which an object is not found as it should be."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from neuralgrasps.apply.demonstrate import Demonstration, _doubtful, demonstrate
from neuralgrasps.apply.demonstrate_checks import camera_trouble, depth_trouble
from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.demonstrate_execute import execute_demonstration
from neuralgrasps.geometry.camera import Intrinsics, look_at
from neuralgrasps.geometry.mesh import Mesh, merge_meshes
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.geometry.raster import depth_images
from neuralgrasps.geometry.se3_numpy import inverse_np
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.objects.zoo import load_object
from neuralgrasps.perception.frame import Frame
from neuralgrasps.perception.object_video import follow_object

CAMERA = Intrinsics(90.0, 95.0, 31.0, 22.0, 64, 48)


def _frames(depth_m, *, measured=1.0, count=3):
    depth = np.full((48, 64), depth_m)
    for row in depth[12:36]:
        row[16 : 48 - round(measured * 32)] = 0.0
    return [Frame(depth, CAMERA)] * count


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"frames": "video"}, r"frames is a str; expected frames: ng\.read_frames\('video'\)"),
        ({"frames": ["a.png"]}, "frames is a list of str; expected frames"),
        ({"frames": 3}, "frames is a int; expected frames"),
        ({"frames": []}, "there are no frames"),
        ({"obj": "mustard_bottle"}, "obj is a str; expected an object"),
        ({"hand": "fetch"}, "hand is a str; expected a hand"),
    ],
)
def test_names_in_place_of_things_are_refused(given, message):
    things = {"frames": _frames(0.7), "obj": load_object("tomato_soup_can"), "hand": load_hand("fetch")} | given
    with pytest.raises(InputError, match=message):
        demonstrate(**things)


def test_ordinary_depth_is_no_trouble():
    assert depth_trouble(_frames(0.7)) == ""
    assert depth_trouble(_frames(0.3, measured=0.5)) == ""


def test_missing_depth_is_said():
    said = depth_trouble(_frames(0.7, measured=0.25))
    assert said.startswith(" Only 25 % of the pixels in the middle of the images have a depth")
    assert "median" not in said
    assert "Only 0 %" in depth_trouble(_frames(0.7, measured=0.0))
    assert depth_trouble(_frames(0.7, measured=0.0, count=1) + _frames(0.7)) == ""  # one frame of four


@pytest.mark.parametrize(("depth_m", "hint"), [(7.0, "nearer"), (0.07, "away")])
def test_depth_out_of_range_is_said(depth_m, hint):
    said = depth_trouble(_frames(depth_m))
    assert f"median depth there is {depth_m:.2f} m; expected 0.25 to 2 m: check the depth scale" in said
    assert said.endswith(f"{hint}.")


@pytest.fixture(scope="module")
def can():
    """A can on a table as a camera sees it from 0.6 m away, and what a frame with another focal length makes of it."""
    obj = load_object("tomato_soup_can")
    X_WO = np.eye(4)
    X_WO[2, 3] = -obj.mesh.vertices[:, 2].min()
    vertices = obj.mesh.vertices @ X_WO[:3, :3].T + X_WO[:3, 3]
    table = box_mesh([1.2, 1.2, 0.02])
    scene = merge_meshes([Mesh(vertices, obj.mesh.faces), Mesh(table.vertices - [0, 0, 0.01], table.faces)])
    k = Intrinsics(300.0, 300.0, 159.5, 119.5, 320, 240)
    X_WC = look_at(np.array([0.45, 0.15, 0.40]), np.array([0.05, 0.0, 0.03]))
    depth = depth_images(scene, inverse_np(X_WC)[None], k)[0]
    depth = np.where(np.isfinite(depth), depth, 0.0)

    def seen(factor):
        return [Frame(depth, replace(k, fx=k.fx * factor, fy=k.fy * factor))]

    return obj, seen


@pytest.mark.parametrize("factor", [0.75, 1.3])
def test_a_focal_length_with_which_the_object_fits_much_better_is_named(can, factor):
    obj, seen = can
    frames = seen(factor)
    said = camera_trouble(frames, obj, follow_object(frames, obj), nobody)
    assert said.startswith(f"the intrinsics do not fit: with fx = {300 * factor:.0f} 'tomato_soup_can' explains")
    assert float(re.search(r"with about (\d+) \d+ %", said)[1]) == pytest.approx(300, rel=0.08)


def test_the_true_focal_length_is_not_doubted_nor_is_any_named_for_another_thing(can):
    obj, seen = can
    assert camera_trouble(seen(1.0), obj, follow_object(seen(1.0), obj), nobody) == ""
    other = load_object("cracker_box")
    found = follow_object(seen(1.0), other)
    assert found.reason != "" and camera_trouble(seen(1.0), other, found, nobody) == ""


def nobody(_):
    return None


def test_reasons_are_sentences_of_their_own_and_end_once():
    fitted = SimpleNamespace(confidence=0.1, reasons=("they are not of one", "the frame shows only 33 %."))
    assert _doubtful(fitted) == (
        "what was taken for the hand is one with a confidence of 0.10 only. They are not of one. "
        "The frame shows only 33 %."
    )
    failed = Demonstration(object="can", hand="fetch", seed=0, stage="transfer", reason="none holds.")
    with pytest.raises(InputError, match="was transferred: none holds; there is nothing to execute"):
        execute_demonstration(failed, None, None)
