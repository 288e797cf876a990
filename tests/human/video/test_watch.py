"""A hand's grasp in a video; and what is said where there is none to see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.errors import InputError
from neuralgrasps.human.fit.hand_cloud import CloudConfig
from neuralgrasps.human.seen import SeenJoints
from neuralgrasps.human.video.hand_video import HandVideo
from neuralgrasps.human.video.look import LookConfig, coarse_frames, look
from neuralgrasps.human.video.watch import WatchConfig, watch_hand
from neuralgrasps.perception.frame import camera_poses

STILL_FROM = 9  # of `grasp_video`


def _watched(video, eyes, **changes):
    given = dict(detector=eyes, reader=eyes, obj=video.obj, X_CO=video.X_CO)
    return watch_hand(changes.pop("frames", video.frames), **{**given, **changes})


def test_the_grasp_is_found_and_fits(grasp_video, true_eyes):
    track = _watched(grasp_video, true_eyes(video=grasp_video))
    assert (track.stage, track.reason) == ("", "")
    assert track.side == "right" and track.scale == pytest.approx(0.8, abs=0.03)
    assert track.moment >= STILL_FROM and min(track.still) >= STILL_FROM - 1 and len(track.still) >= 10
    assert "thumb" in track.contacts and len(track.contacts) >= 3
    assert grasp_video.surface_error(track) < 0.004
    assert track.grasp.confidence > 0.5 and track.visible > 0.3
    assert track.frames[0] is None and track.frames[track.moment] is not None
    assert len(track.cloud_C) > 100


def test_the_track_says_which_frames_were_looked_at(grasp_video, true_eyes):
    track = _watched(grasp_video, true_eyes(video=grasp_video), config=WatchConfig(look=LookConfig(frames=8)))
    coarse = coarse_frames(len(grasp_video.frames), LookConfig(frames=8))
    assert track.looked == tuple(sorted({*coarse, *track.still})) and len(track.looked) < len(grasp_video.frames)
    assert track.found == tuple(n for n in track.looked if track.seen[n] is not None)
    assert set(coarse) - set(track.found)  # looked at before the hand came


def test_fusing_frames_beats_one_frame(grasp_video, true_eyes):
    track = _watched(grasp_video, true_eyes(video=grasp_video))
    fused = np.linalg.norm(track.grasp.joints_C - grasp_video.joints_C[track.moment], axis=1).mean()
    alone = [np.linalg.norm(track.frames[n].joints_C - grasp_video.joints_C[n], axis=1).mean() for n in track.still]
    assert fused < np.mean(alone)


def test_the_same_twice(grasp_video, true_eyes):
    one, two = (_watched(grasp_video, true_eyes(video=grasp_video)) for _ in range(2))
    np.testing.assert_array_equal(one.grasp.X_CH, two.grasp.X_CH)
    np.testing.assert_array_equal(one.grasp.q, two.grasp.q)


def test_a_left_hand_is_the_mirror_image(grasp_video, true_eyes):
    video = grasp_video.mirrored()
    left = _watched(video, true_eyes(video=video, side="left", said="left"))
    assert left.side == "left" and left.grasp.side == "left" and left.stage == ""
    error = np.linalg.norm(left.grasp.joints_C - video.joints_C[left.moment], axis=1)
    assert error.mean() < 0.006


@pytest.mark.parametrize("said", ["right", "left"])
def test_an_unsure_side_is_decided_by_the_fit(grasp_video, true_eyes, said):
    track = _watched(grasp_video, true_eyes(video=grasp_video, said=said, sure=0.55))
    assert track.side == "right" and track.stage == ""
    assert any("fits better" in r for r in track.reasons) == (said == "left")


@pytest.mark.parametrize("known", [True, False])
def test_a_moving_camera_changes_nothing_where_it_is_known(moving_video, true_eyes, known):
    there = {} if known else {"obj": None, "X_CO": None}
    track = _watched(moving_video, true_eyes(video=moving_video), **there)
    assert track.stage == "" and len(track.still) >= 10 and min(track.still) >= STILL_FROM - 1
    assert moving_video.surface_error(track) < 0.005


def test_a_moving_camera_that_is_not_known_makes_the_hand_seem_to_move(moving_video, true_eyes):
    silent = [replace(f, X_WC=None) for f in moving_video.frames]
    track = _watched(moving_video, true_eyes(video=moving_video), frames=silent, obj=None, X_CO=None)
    assert len(track.still) < 8
    silent[3] = moving_video.frames[3]
    silent[9] = moving_video.frames[9]
    with pytest.raises(InputError, match="22 of 24 frames have no camera pose"):
        _watched(moving_video, true_eyes(video=moving_video), frames=silent)


def test_a_lifted_object_takes_the_hand_along(grasp_video):
    """Everything moves on by 12 pixels early in the still phase: the grasp is described before that."""
    k, frames = grasp_video.frames[0].intrinsics, list(grasp_video.frames)
    X_CO, joints = grasp_video.X_CO.copy(), grasp_video.joints_C.copy()
    X_CO[13:, 0, 3] += 12 / k.fx * X_CO[13:, 2, 3]
    joints[13:, :, 0] += 12 / k.fx * joints[13:, :, 2]
    frames[13:] = [replace(f, depth=np.roll(f.depth, 12, axis=1)) for f in frames[13:]]
    given = [
        SeenJoints(points_C=p, weight=np.ones(21), mask=None, side="right", source="test")
        if np.isfinite(p).all()
        else None
        for p in joints
    ]
    track = watch_hand(frames, joints=given, obj=grasp_video.obj, X_CO=X_CO)
    assert track.stage == "" and STILL_FROM <= track.moment < 13
    assert grasp_video.surface_error(track) < 0.005


def test_given_joints_need_no_detector(grasp_video):
    rng = np.random.default_rng(0)
    given = [
        SeenJoints(points_C=p + 0.004 * rng.normal(size=p.shape), weight=np.ones(21), mask=None, side="left",
                   source="test") if np.isfinite(p).all() else None for p in grasp_video.joints_C
    ]  # fmt: skip
    track = watch_hand(grasp_video.frames, joints=given, obj=grasp_video.obj, X_CO=grasp_video.X_CO[0])
    assert track.side == "right"  # they said left
    assert grasp_video.surface_error(track) < 0.005


def test_one_frame_is_enough_but_less_sure(grasp_video, true_eyes):
    last = [replace(grasp_video.frames[-1])]
    track = _watched(grasp_video, true_eyes(video=grasp_video), frames=last, X_CO=grasp_video.X_CO[-1])
    assert track.stage == "" and track.moment == 0
    assert any("kept still" in reason for reason in track.reasons)


def test_an_unknown_object_leaves_contact_open(grasp_video, true_eyes):
    sure = _watched(grasp_video, true_eyes(video=grasp_video)).grasp.confidence
    for unknown in ({"obj": None}, {"X_CO": None}):
        track = _watched(grasp_video, true_eyes(video=grasp_video), **unknown)
        assert track.stage == "" and track.contacts == ()
        assert any("not known" in reason for reason in track.reasons)
        assert track.grasp.confidence < 0.8 * sure


def _lost(video, *, known):
    X_CO = np.full_like(video.X_CO, np.nan)
    X_CO[known] = video.X_CO[known]
    return X_CO


@pytest.mark.parametrize("known", [slice(0, 13), slice(18, None)])
def test_the_moment_is_one_where_the_object_is_known(grasp_video, true_eyes, known):
    X_CO = _lost(grasp_video, known=known)
    track = _watched(grasp_video, true_eyes(video=grasp_video), X_CO=X_CO)
    assert track.stage == "" and "thumb" in track.contacts
    assert np.isfinite(X_CO[[track.moment, *track.still]]).all()
    assert grasp_video.surface_error(track) < 0.006


@pytest.mark.parametrize(
    ("known", "why"),
    [
        (slice(0, 6), "the object was lost from frame 6, before the hand held still in frame"),
        (slice(0, 0), "the object's pose is not known in any frame"),
    ],
)
def test_an_object_lost_before_the_hand_keeps_still(grasp_video, true_eyes, known, why):
    track = _watched(grasp_video, true_eyes(video=grasp_video), X_CO=_lost(grasp_video, known=known))
    assert track.stage == "grasp" and track.reason.startswith(why)
    assert track.grasp is None and track.moment == -1


def test_a_still_hand_without_an_object_does_not_count_as_touching(grasp_video, true_eyes):
    """It keeps still far from the object for some frames, and on after that is lost."""
    X_CO = _lost(grasp_video, known=slice(0, 13))
    X_CO[:, :3, 3] += 0.25 * X_CO[:, :3, 0]
    track = _watched(grasp_video, true_eyes(video=grasp_video), X_CO=X_CO)
    assert track.stage == "grasp" and "never touches the object" in track.reason


def test_no_hand(grasp_video, true_eyes):
    track = _watched(
        grasp_video, true_eyes(video=grasp_video), frames=grasp_video.frames[:3], X_CO=grasp_video.X_CO[:3]
    )
    assert track.stage == "detect" and "no hand was found in 3 frames" in track.reason
    assert track.grasp is None and track.moment == -1


def test_nothing_in_range(grasp_video, true_eyes):
    far = [replace(f, depth=4.0 * f.depth) for f in grasp_video.frames[:3]]
    track = _watched(grasp_video, true_eyes(video=grasp_video), frames=far, X_CO=grasp_video.X_CO[:3])
    assert track.stage == "detect" and "hardly anything lies" in track.reason


def test_a_hand_out_of_range(grasp_video, true_eyes):
    far = [replace(f, depth=3.0 * f.depth) for f in grasp_video.frames]
    track = _watched(grasp_video, true_eyes(video=grasp_video), frames=far)
    assert track.stage == "detect" and "m from the camera; expected" in track.reason


def test_a_hand_without_depth(grasp_video, true_eyes):
    holes = [
        replace(f, depth=np.where(m, 0.0, f.depth)) for f, m in zip(grasp_video.frames, grasp_video.masks, strict=True)
    ]
    for frame in holes:
        frame.depth[40:200, 60:260] = 0.0
    track = _watched(grasp_video, true_eyes(video=grasp_video), frames=holes)
    assert track.stage == "detect" and "of its pixels have a depth" in track.reason


class _TwoHands:
    """The hand's box, and another one at the edge of the image, or just beside."""

    def __init__(self, eyes, shift):
        self.eyes, self.shift, self.read = eyes, shift, eyes.read

    def find(self, frame):
        boxes = self.eyes.find(frame)
        aside = [self.shift * (b.u_max - b.u_min) for b in boxes]
        return boxes + [
            replace(b, u_min=b.u_min + du, u_max=b.u_max + du, score=0.85) for b, du in zip(boxes, aside, strict=True)
        ]


def test_two_hands_at_the_object(grasp_video, true_eyes):
    track = _watched(grasp_video, _TwoHands(true_eyes(video=grasp_video), 0.6))
    assert track.stage == "detect" and "two hands" in track.reason


def test_a_second_hand_far_from_the_object_is_let_be(grasp_video, true_eyes):
    track = _watched(grasp_video, _TwoHands(true_eyes(video=grasp_video), -1.2))
    assert track.stage == "" and any("second hand" in reason for reason in track.reasons)
    assert grasp_video.surface_error(track) < 0.004


class _InTurn:
    """The hand's box but in a gap; after it moved by `shift` pixels, `step` more along the rows a frame, resized."""

    def __init__(self, eyes, *, gap, shift=(0.0, 0.0), side="right", step=0.0, scale=1.0):
        self.eyes, self.gap, self.shift, self.side, self.step, self.scale = eyes, gap, shift, side, step, scale

    def find(self, frame):
        number, boxes = int(frame.name), self.eyes.find(frame)
        if number < self.gap[0]:
            return boxes
        return [self._other(box, number - self.gap[1]) for box in boxes] if number >= self.gap[1] else []

    def _other(self, box, after):
        du, dv = self.shift[0] + self.step * after, self.shift[1]
        u, v = (box.u_min + box.u_max) / 2 + du, (box.v_min + box.v_max) / 2 + dv
        a, b = self.scale * (box.u_max - box.u_min) / 2, self.scale * (box.v_max - box.v_min) / 2
        return replace(box, u_min=u - a, u_max=u + a, v_min=v - b, v_max=v + b, side=self.side)


def _looked(video, finder, **more):
    """The video with the boxes that `look` puts in, and why not."""
    given = HandVideo(
        frames=video.frames, reader=None, obj=video.obj, X_CO=video.X_CO, X_WC=camera_poses(video.frames), table=None,
        cloud_config=CloudConfig(),
    )  # fmt: skip
    return given, look(given, finder, None, more.get("side"), LookConfig())


ASIDE = (130.0, 0.0)  # 0.26 m, too far for one path


@pytest.mark.parametrize("known", [True, False])
def test_a_hand_lost_for_a_while_is_joined(grasp_video, true_eyes, known):
    """It comes back so far away that it is another path of boxes."""
    film = grasp_video if known else replace(grasp_video, X_CO=np.full_like(grasp_video.X_CO, np.nan))
    video, reason = _looked(film, _InTurn(true_eyes(video=film), gap=(14, 18), shift=ASIDE))
    assert reason == "" and not video.notes
    assert set(video.boxes) == {*range(3, 14), *range(18, 24)}


@pytest.mark.parametrize(
    "change",
    [
        {"gap": (14, 18), "shift": ASIDE, "side": "left"},
        {"gap": (18, 18), "shift": ASIDE},
        {"gap": (14, 18), "scale": 4.6, "step": 20.0},
    ],
)
def test_another_hand_later_on_is_not_the_same(grasp_video, true_eyes, change):
    """By its side, by its place, or by its size: the one at the object is followed."""
    video, reason = _looked(grasp_video, _InTurn(true_eyes(video=grasp_video), **change))
    assert reason == "" and set(video.boxes) == set(range(3, change["gap"][0]))
    assert any("another hand is seen in frames 18 to 23" in note for note in video.notes)


def test_two_hands_in_turn_at_the_object_cannot_be_told_apart(grasp_video, true_eyes):
    eyes = _InTurn(true_eyes(video=grasp_video), gap=(17, 17), shift=(70.0, 106.0), side="left")
    video, reason = _looked(grasp_video, eyes)
    assert "two hands are seen one after the other, the other one in frames 17 to 23" in reason
    track = watch_hand(grasp_video.frames, detector=eyes, reader=eyes.eyes, obj=grasp_video.obj, X_CO=grasp_video.X_CO)
    assert track.stage == "detect" and "two hands" in track.reason and track.grasp is None
    video, reason = _looked(grasp_video, eyes, side="right")
    assert reason == "" and max(video.boxes) == 16


def test_no_still_phase(grasp_video, true_eyes):
    frames, X_CO = grasp_video.frames[3:8], grasp_video.X_CO[3:8]
    track = _watched(grasp_video, true_eyes(video=grasp_video), frames=frames, X_CO=X_CO)
    assert track.stage == "grasp" and "never keeps still" in track.reason


def test_a_hand_that_rests_elsewhere(grasp_video, true_eyes):
    X_CO = grasp_video.X_CO.copy()
    X_CO[:, :3, 3] += 0.25 * X_CO[:, :3, 0]
    track = _watched(grasp_video, true_eyes(video=grasp_video), X_CO=X_CO)
    assert track.stage == "grasp" and "never touches the object" in track.reason
    assert track.scale == pytest.approx(0.8, abs=0.03)


@pytest.mark.parametrize(("factor", "known"), [(0.7, True), (1.4, True), (0.7, False)])
def test_wrong_focal_lengths_are_noticed(grasp_video, true_eyes, factor, known):
    k = grasp_video.frames[0].intrinsics
    wrong = [replace(f, intrinsics=replace(k, fx=factor * k.fx, fy=factor * k.fy)) for f in grasp_video.frames]
    X_CO = grasp_video.X_CO.copy()
    X_CO[:, :2, 3] /= factor
    obj = grasp_video.obj if known else None
    track = _watched(grasp_video, true_eyes(video=grasp_video, stretch=factor), frames=wrong, X_CO=X_CO, obj=obj)
    assert track.stage == "size" and "intrinsics do not fit" in track.reason
    if known:
        said = float(track.reason.split("with about ")[1].split(" ")[0])
        assert said == pytest.approx(k.fx, rel=0.06)


def test_hands_are_followed_where_the_detector_misses_them(grasp_video, true_eyes):
    class Blinking:
        def __init__(self, eyes):
            self.eyes, self.read = eyes, eyes.read

        def find(self, frame):
            return self.eyes.find(frame) if int(frame.name) % 4 == 0 else []

    track = _watched(grasp_video, Blinking(true_eyes(video=grasp_video)))
    assert track.stage == "" and len(track.still) >= 10


def test_a_hand_that_leaves_is_not_followed_into_nothing(grasp_video, true_eyes):
    """Frames are shown again without the hand: what is read in its last box is not as clear."""

    class Leaving:
        def __init__(self, eyes):
            self.eyes, self.find = eyes, eyes.find

        def read(self, frame, box):
            if frame.name != "000001":
                return self.eyes.read(frame, box)
            rng = np.random.default_rng(0)
            points = rng.normal(size=(21, 3)) * 0.05 + [0.0, 0.0, 0.5]
            return SeenJoints(points_C=points, weight=np.full(21, 0.2), mask=None, side=box.side, source="nothing")

    frames = [*grasp_video.frames, *[grasp_video.frames[1]] * 4]
    X_CO = grasp_video.X_CO[0]
    track = _watched(grasp_video, Leaving(true_eyes(video=grasp_video)), frames=frames, X_CO=X_CO)
    assert track.stage == "" and track.boxes[24:] == (None,) * 4 and track.seen[24:] == (None,) * 4
    assert max(track.still) < 24


def test_bad_input_is_refused(grasp_video, true_eyes):
    eyes = true_eyes(video=grasp_video)
    with pytest.raises(InputError, match="no frames"):
        watch_hand([], detector=eyes, reader=eyes)
    with pytest.raises(InputError, match="nothing finds the hand"):
        watch_hand(grasp_video.frames, detector=eyes)
    with pytest.raises(InputError, match="joints are given for 1 frames, but there are 24"):
        watch_hand(grasp_video.frames, joints=[None])
    track = watch_hand(grasp_video.frames, joints=[None] * 24)
    assert track.stage == "detect" and "show no hand" in track.reason


def test_long_videos_are_looked_at_coarsely():
    assert coarse_frames(24, LookConfig()) == list(range(24))
    assert coarse_frames(45, LookConfig())[:3] == [0, 2, 4]
    assert coarse_frames(100, LookConfig())[:3] == [0, 5, 10]
    assert coarse_frames(600, LookConfig())[:3] == [0, 6, 12]
