"""Retrieving for a hand that was only seen, and what cannot be asked."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import neuralgrasps
from tests.cli.conftest import Ended, Pipeline

Call = Callable[..., Ended]


@pytest.fixture
def cloud(pipeline: Pipeline, tmp_path: Path) -> Path:
    """Points all over a Panda hand that holds the box."""
    grasps = neuralgrasps.load_grasps(pipeline.grasps / "gelatin_box" / "panda.safetensors")
    from neuralgrasps.hands.packed import pack_hand  # noqa: PLC0415

    packed = pack_hand(neuralgrasps.load_hand("panda"), spacing=0.006)
    path = tmp_path / "hand.npy"
    np.save(path, neuralgrasps.observe_hand(packed, grasps.X_OH[0], grasps.q[0], seed=0, noise_m=0.001))
    return path


def test_points_of_a_seen_hand_find_its_grasp(ng: Call, pipeline: Pipeline, cloud: Path) -> None:
    bare = ng("retrieve", pipeline.run, "--query-cloud", cloud, "--hand", "panda", "--count", 1)
    assert bare.code == 0, bare.err
    fitted = ng("retrieve", pipeline.run, "--query-cloud", cloud, "--query-hand", "panda", "--count", 1)
    assert fitted.code == 0 and "fitted" in fitted.out
    assert bare.result["results"][0]["grasp_index"] == fitted.result["results"][0]["grasp_index"] == 0
    assert fitted.result["results"][0]["contact_distance"] < 0.02
    assert "query_index" not in fitted.result and "hand.npy" in fitted.result["query"]


def test_points_that_are_of_no_hand_at_the_object_are_refused(
    ng: Call, pipeline: Pipeline, cloud: Path, tmp_path: Path
) -> None:
    far = tmp_path / "far.npy"
    np.save(far, np.load(cloud) + np.array([0.0, 0.0, 0.8]))
    ended = ng("retrieve", pipeline.run, "--query-cloud", far)
    assert ended.code == 2 and "in the object's frame" in ended.err
    np.save(far, np.load(cloud)[:3])
    assert "at least 10" in ng("retrieve", pipeline.run, "--query-cloud", far).err
    ended = ng("retrieve", pipeline.run, "--query-cloud", cloud, "--viewpoint", 0, 0, 1)
    assert ended.code == 2 and "--query-hand" in ended.err


def test_a_grasp_of_another_object_is_refused(ng: Call, pipeline: Pipeline) -> None:
    file = pipeline.grasps / "gelatin_box" / "panda.safetensors"
    ended = ng("retrieve", pipeline.run, "--query", file, "--object", "cracker_box")
    assert ended.code == 2 and "contacts on one object say nothing about another" in ended.err
