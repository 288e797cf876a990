"""What is said of depth images in which an object was not found."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.apply.demonstrate_checks import depth_trouble
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.perception.frame import Frame

CAMERA = Intrinsics(90.0, 95.0, 31.0, 22.0, 64, 48)


def _frames(depth_m, *, measured=1.0, count=3):
    depth = np.full((48, 64), depth_m)
    for row in depth[12:36]:
        row[16 : 48 - round(measured * 32)] = 0.0
    return [Frame(depth, CAMERA)] * count


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
