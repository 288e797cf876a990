"""Joints from files of other trackers."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import project
from neuralgrasps.human.video.joint_files import read_joints

NUMBERS = (0, 20, 23)


@pytest.fixture
def shown(grasp_video):
    """Three frames, the first without a hand; their joints (3, 21, 3)."""
    return [grasp_video.frames[n] for n in NUMBERS], grasp_video.joints_C[list(NUMBERS)]


def _write(path, content):
    path.write_text(json.dumps(content))
    return path


def _pixels(points, frame):
    return project(points, frame.intrinsics)


def _off(seen, points):
    return float(np.nanmean(np.linalg.norm(seen.points_C - points, axis=1)))


def _records(points, frames, kind):
    """A list of records of each kind of numbers."""
    out = []
    for p, f in zip(points, frames, strict=True):
        if not np.isfinite(p).all():
            out.append(None)
            continue
        k, uv = f.intrinsics, _pixels(p, f)
        depth = (p[:, 2] / p[0, 2] - 1.0) * k.fx
        out.append({
            "bare pixels": uv.tolist(),
            "pixels and depth": {"joints": np.column_stack([uv, depth]).tolist(), "unit": "px"},
            "metres": {"xyz": p.tolist(), "side": "Right"},
            "millimetres": {"keypoints": (1e3 * p).tolist(), "unit": "mm", "handedness": "right"},
            "landmarks": {"landmarks": [
                {"x": u / k.width, "y": v / k.height, "z": z / k.width} for (u, v), z in zip(uv, depth, strict=True)
            ]},
        }[kind])  # fmt: skip
    return out


@pytest.mark.parametrize(
    ("kind", "within"),
    [("bare pixels", 0.03), ("pixels and depth", 0.015), ("landmarks", 0.015), ("metres", 1e-9), ("millimetres", 1e-9)],
)
def test_all_kinds_give_metres(tmp_path, shown, kind, within):
    frames, points = shown
    seen = read_joints(_write(tmp_path / "hand.json", _records(points, frames, kind)), frames)
    assert seen[0] is None
    for s, p in zip(seen[1:], points[1:], strict=True):
        assert _off(s, p) < within
        assert s.source == "hand.json"


def test_all_ways_to_name_frames(tmp_path, shown):
    frames, points = shown
    records = _records(points, frames, "metres")
    by_name = {f.name: r for f, r in zip(frames, records, strict=True)}
    folder = tmp_path / "joints"
    folder.mkdir()
    _write(folder / "000020.json", records[1])
    _write(folder / "000023.json", {"frames": [records[2]]}["frames"][0])
    ways = {
        "list": records, "frames": {"frames": records}, "named": by_name,
        "numbered": {"1": records[1], "2": records[2]},
    }  # fmt: skip
    paths = [_write(tmp_path / f"{name}.json", content) for name, content in ways.items()]
    for path in [*paths, folder]:
        seen = read_joints(path, frames)
        assert seen[0] is None and _off(seen[1], points[1]) < 1e-9 and _off(seen[2], points[2]) < 1e-9
    one = read_joints(_write(tmp_path / "one.json", points[2].tolist()), frames[2:])
    assert _off(one[0], points[2]) < 1e-9  # metres, by the numbers


def test_scores_and_gaps(tmp_path, shown):
    frames, points = shown
    rows = points[2].tolist()
    rows[4] = None
    record = {"joints": rows, "unit": "m", "score": [0.5] * 20 + [None], "side": "left"}
    seen = read_joints(_write(tmp_path / "a.json", [record]), frames[2:])[0]
    assert seen.side == "left" and seen.weight[4] == 0.0 and seen.weight[5] == 0.5 and seen.weight[20] == 1.0
    assert np.isnan(seen.points_C[4]).all()
    uv = _pixels(points[2], frames[2])
    scored = np.column_stack([uv, np.linspace(0.3, 0.9, 21)]).tolist()  # u, v, score
    seen = read_joints(_write(tmp_path / "b.json", [scored]), frames[2:])[0]
    assert seen.weight.max() <= 0.9 and _off(seen, points[2]) < 0.03


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([[[1.0, 2.0]] * 20], "are 20; expected 21: wrist"),
        ([[[1.0, 2.0]] * 20 + [[1.0]]], "have 1 and 2 numbers"),
        ([[[1.0, "x"]] * 21], "no number"),
        ([None, None], "2 records for 1 frames"),
        ({"joints": [[1.0, 2.0]] * 21, "unit": "feet"}, "unit of joints in .* is 'feet'"),
        ({"joints": [[1.0, 2.0]] * 21, "unit": "m"}, "have 2 numbers each; expected x, y, z"),
        ({"joints": [[0.01, 0.02, 0.001]] * 21, "unit": "m"}, "relative to the wrist"),
        ({"joints": [[100.0, 120.0, 500.0]] * 21}, "not clear"),
        ({"joints": [[100.0, 120.0]] * 21, "side": "both"}, "side in .* is 'both'"),
        ({"joints": [[100.0, 120.0]] * 21, "score": "high"}, "scores of .* are str"),
        ({"other": [[1.0, 2.0]] * 21}, "no frame is named so"),
        ("text", "has str for 1 frames"),
    ],
)
def test_wrong_files_are_explained(tmp_path, shown, content, message):
    with pytest.raises(InputError, match=message):
        read_joints(_write(tmp_path / "wrong.json", content), shown[0][2:])


def test_files_that_cannot_be_read(tmp_path, shown):
    frames, points = shown
    with pytest.raises(InputError, match="does not exist"):
        read_joints(tmp_path / "none.json", frames)
    (tmp_path / "bad.json").write_text("{")
    with pytest.raises(InputError, match="cannot be read as JSON"):
        read_joints(tmp_path / "bad.json", frames)
    with pytest.raises(InputError, match="joints of one frame, but there are 3"):
        read_joints(_write(tmp_path / "one.json", points[2].tolist()), frames)
    folder = tmp_path / "odd"
    folder.mkdir()
    _write(folder / "a.json", points[2].tolist())
    with pytest.raises(InputError, match="1 JSON files for 3 frames"):
        read_joints(folder, frames)
    assert _off(read_joints(folder, [replace(frames[2], name="x")])[0], points[2]) < 1e-9


def test_joints_under_an_unknown_key_are_refused_and_the_known_ones_named(shown, tmp_path):
    frames, _ = shown
    with pytest.raises(
        InputError, match=r"frame 1' has 'joint' and no joints; .* one of the keys joints_C, xyz, joints"
    ):
        read_joints(_write(tmp_path / "a.json", [None, {"joint": [[1.0, 2.0]] * 21}, None]), frames)
    empty = [None, {"joints": [], "extra": [1]}, {"frame": 2, "score": [1.0]}]
    assert read_joints(_write(tmp_path / "b.json", empty), frames) == [None] * 3
