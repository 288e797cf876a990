"""What a hand's size says of the camera's focal length, in recorded demonstrations seen through wrong ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.geometry.mesh import box_mesh
from neuralgrasps.human.seen import SeenJoints
from neuralgrasps.human.skeleton import LARGEST, SMALLEST
from neuralgrasps.human.synthetic.demonstration import DemonstrationConfig, record_demonstration
from neuralgrasps.human.synthetic.recording import RecordedDemonstration
from neuralgrasps.human.video.focal import FACTORS, beyond_sizes, out_of_sizes, size_doubt
from neuralgrasps.human.video.watch import HandTrack, watch_hand

_FEW_LONG, _MANY_SHORT = 0.74, 0.86  # sizes that 1.25 times too long, and .8 times too short, lead out of the range
_AWAY_M = 0.15


@pytest.fixture(scope="module")
def brick(make_object):
    return make_object("brick", box_mesh([0.022, 0.035, 0.05]))


@pytest.fixture(scope="module")
def record(brick):
    """`record(scale, seed)`: a right hand that grasps the brick, small images."""

    def one(scale: float, seed: int = 0) -> RecordedDemonstration:
        config = DemonstrationConfig(side="right", scale=scale, lift=False, wall=False, width=320, height=240)
        return record_demonstration(brick, seed=seed, config=config)

    return one


def _watched(recorded: RecordedDemonstration, obj: object, factor: float, *, away_m: float = _AWAY_M) -> HandTrack:
    """The video taken for one of a focal length `factor` times the true one, the object's pose off by `away_m`."""
    truth, k = recorded.truth, recorded.intrinsics
    camera = replace(k, fx=factor * k.fx, fy=factor * k.fy)
    frames = [replace(recorded.frame(n), intrinsics=camera) for n in range(len(recorded))]
    rng, shrink = np.random.default_rng(0), np.array([1.0 / factor, 1.0 / factor, 1.0])
    joints = [
        SeenJoints(points_C=(p + 0.004 * rng.normal(size=p.shape)) * shrink, weight=np.full(21, 0.8), mask=m,
                   side="right", source="truth") if v > 0.3 and m.sum() > 200 else None
        for p, m, v in zip(truth.joints_C, truth.hand_mask, truth.visible, strict=True)
    ]  # fmt: skip
    X_CO = np.array(truth.X_CO)
    X_CO[:, :2, 3] /= factor
    X_CO[:, :3, 3] += away_m * X_CO[:, :3, 0]
    return watch_hand(frames, joints=joints, obj=obj, X_CO=X_CO, side="right")


@pytest.mark.parametrize(("factor", "scale"), [(1.25, _FEW_LONG), (1.33, _FEW_LONG), (0.8, _MANY_SHORT)])
def test_a_hand_of_no_persons_size_names_the_focal_length(record, brick, factor, scale):
    """The object is not where its pose says, so that only the hand can tell."""
    track = _watched(record(scale), brick, factor)
    assert out_of_sizes(track.scale) and (track.scale < SMALLEST) == (factor > 1)
    assert track.stage in ("size", "grasp")
    assert "people's are 166 to 232 mm" in track.reason and "fx = " in track.reason
    if track.stage == "size":
        named = float(track.reason.split("with about ")[1].split(" ")[0])
        true = record(scale).intrinsics.fx
        assert abs(np.log(named / true)) < abs(np.log(factor))
    else:
        assert "the focal length may be wrong" in track.reason
        assert ("too long" if factor > 1 else "too short") in track.reason


@pytest.mark.parametrize(("scale", "seed"), [(_FEW_LONG, 0), (_FEW_LONG, 1), (_MANY_SHORT, 0), (_MANY_SHORT, 1)])
def test_the_true_focal_length_is_not_doubted(record, brick, scale, seed):
    track = _watched(record(scale, seed), brick, 1.0, away_m=0.0)
    assert (track.stage, track.reason) == ("", "")
    assert track.scale == pytest.approx(scale, abs=0.02)
    assert not any("focal length" in reason for reason in track.reasons)


def test_a_wrong_pose_alone_is_not_blamed_on_the_camera(record, brick):
    track = _watched(record(_FEW_LONG), brick, 1.0)
    assert track.stage == "grasp" and "focal length" not in track.reason


def test_the_words_say_direction_and_factor():
    assert size_doubt(0.7, 600.0) == ""
    small, large = size_doubt(0.6, 600.0), size_doubt(1.0, 600.0)
    assert "the hand measures 151 mm, people's are 166 to 232 mm" in small
    assert "too long" in small and "0.91 times as long or less (fx = 545)" in small
    assert "too short" in large and "1.09 times as long or more (fx = 652)" in large


def test_sizes_count_by_how_far_they_are_beyond():
    assert beyond_sizes(0.7) == 0.0 == beyond_sizes(LARGEST)
    assert beyond_sizes(SMALLEST / 1.1) == pytest.approx(np.log(1.1)) == pytest.approx(beyond_sizes(1.1 * LARGEST))
    assert 1.0 in FACTORS
