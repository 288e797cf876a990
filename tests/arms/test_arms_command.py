"""`neuralgrasps arms`: tables, JSON, a picture, and errors with exit code 2."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

from neuralgrasps.cli.main import run


def test_list_names_both_arms(capsys):
    assert run(["arms", "list", "--json"]) == 0
    arms = json.loads(capsys.readouterr().out)["arms"]
    assert [a["name"] for a in arms] == ["fetch", "panda"]
    torso = arms[0]["joints"][0]
    assert torso["upper_m"] == pytest.approx(0.38615) and torso["velocity_m_s"] == 0.1 and torso["planned"]
    assert [j["type"] for j in arms[0]["joints"]].count("continuous") == 3


def test_show_mounts_a_hand_and_draws_it(tmp_path, capsys):
    picture = tmp_path / "new" / "robot.png"
    assert run(["arms", "show", "panda", "--hand", "allegro", "--picture", str(picture), "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["hand"] == "allegro" and record["flange"] == "panda_link8" and len(record["joints"]) == 7
    image = np.asarray(Image.open(picture))
    assert image.shape == (480, 1440, 4) and (image[..., 3] > 0).mean() > 0.1


def test_show_says_what_was_assumed_of_a_file(assets, capsys):
    file = assets / "robots" / "fetch" / "fetch.urdf"
    assert run(["arms", "show", str(file), "--missing-meshes", "skip"]) == 0
    out = capsys.readouterr().out
    assert "wrist_roll_link" in out and "Assumed:" in out and "at rest" in out


def test_unknown_names_end_with_code_2(capsys):
    assert run(["arms", "show", "fetsch"]) == 2
    assert "Did you mean 'fetch'" in capsys.readouterr().err
    assert run(["arms", "show", "panda", "--hand", "alegro"]) == 2
    assert "Did you mean 'allegro'" in capsys.readouterr().err
