"""`neuralgrasps hands check` on good and bad files: pictures and a page, or one clear line and exit code 2."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from neuralgrasps.cli.main import run

from .conftest import SLIDE_JAW, three_finger_urdf
from .wild_hands import jaw_on_arm

STIFF = re.sub(r'type="revolute"', 'type="fixed"', three_finger_urdf())
TWO_SLIDES_OPEN_WIDE = SLIDE_JAW.replace('lower="0" upper="0.04"', 'lower="0" upper="-0.3636"')


def _claw(old: str, new: str) -> str:
    assert old in three_finger_urdf()
    return three_finger_urdf().replace(old, new)


PALM_BOX = '<box size="0.08 0.1 0.03"/>'
BAD = {
    "no movable joint": (STIFF, "no movable joints"),
    "not XML": ("solid hand", "not well-formed XML"),
    "a cycle": (_claw('<parent link="palm"/><child link="a0"/>', '<parent link="a1"/><child link="a0"/>'), "cycle"),
    "joint to nowhere": (_claw('<child link="b1"/>', '<child link="bb1"/>'), "child link 'bb1', which is not defined"),
    "NaN": (_claw('xyz="0.04 0.03 0"', 'xyz="0.04 nan 0"'), "finite"),
    "missing mesh": (
        _claw(PALM_BOX, '<mesh filename="package://h/palm.stl"/>'),
        "'package://h/palm.stl' was not found",
    ),
    "no shapes": (re.sub("<collision>.*?</collision>", "", three_finger_urdf()), "no geometry"),
    "slide without end": (SLIDE_JAW.replace('lower="-0.05" upper="0"', ""), "state its travel in metres"),
}


def _check(tmp_path: Path, capsys: pytest.CaptureFixture[str], *args: object) -> tuple[int, dict[str, Any], str]:
    target = tmp_path / "result.json"
    code = run(["hands", "check", *map(str, args), "--json", str(target)])
    return code, json.loads(target.read_text()), capsys.readouterr().err


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_a_hand_is_refused_in_one_line(write_robot, tmp_path, capsys, case):
    text, said = BAD[case]
    code, result, err = _check(tmp_path, capsys, write_robot(text))
    assert code == 2 and said in result["error"] and "Traceback" not in err
    assert len([line for line in err.splitlines() if line]) == 1


MENDED = {
    "torque of zero": ('effort="1"', 'effort="0"', "effort is missing, 0 or not finite for a0_joint"),
    "reversed limits": ('lower="-0.1" upper="1.6"', 'lower="1.6" upper="-0.1"', "are reversed: swapped"),
    "degrees": ('lower="-0.1" upper="1.6"', 'lower="-6" upper="92"', "read as degrees"),
    "no limits": ('lower="-0.1" upper="1.6" ', "", "-pi..pi assumed"),
}


@pytest.mark.parametrize("case", MENDED)
def test_what_can_be_mended_is_mended_and_said(write_robot, tmp_path, capsys, case):
    old, new, said = MENDED[case]
    code, result, _ = _check(tmp_path, capsys, write_robot(three_finger_urdf().replace(old, new)))
    assert code == 0 and any(said in line for line in result["repairs"]), result["repairs"]
    assert all(joint["closing_sign"] == 1 and joint["effort_nm"] == 1.0 for joint in result["joints"])


def test_a_travel_that_cannot_be_is_doubted(write_robot, tmp_path, capsys):
    code, result, _ = _check(tmp_path, capsys, write_robot(TWO_SLIDES_OPEN_WIDE))
    assert code == 0 and any("looks wrong" in line for line in result["derived"]), result


def test_a_limb_is_chosen_and_shown(tmp_path, capsys):
    wild = jaw_on_arm(tmp_path)
    page, picture = tmp_path / "page.html", tmp_path / "hand.png"
    code, result, _ = _check(tmp_path, capsys, wild.path, "--link", "tool", "--report", page, "--picture", picture)
    assert code == 0 and result["report"] == str(page) and result["joints"][0]["effort_n"] == 50.0
    text = page.read_text()
    for words in ("hand.toml", "jaw_pad = [", "left_finger_joint", "self-collision", "How it closes"):
        assert words in text
    assert "http://" not in text.replace("http://www.w3.org", "") and "https://" not in text
    image = np.asarray(Image.open(picture).convert("RGB"), int)
    assert image.shape[1] > 3 * image.shape[0]
    for finger in ((57, 126, 206), (238, 153, 53)):  # both fingers are seen in every frame
        for frame in np.array_split(image, image.shape[1] // 440, axis=1):
            ratio = frame / np.maximum(frame.max(axis=2, keepdims=True), 1)
            assert (np.abs(ratio - np.array(finger) / max(finger)).max(axis=2) < 0.25).sum() > 100
    code, result, _ = _check(tmp_path, capsys, wild.path, "--link", "tol")
    assert code == 2 and "Did you mean 'tool'?" in result["error"]
