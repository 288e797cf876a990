"""A known object over a video: when exactly it moved, with a camera that moves, and beside a look-alike on a person."""

from __future__ import annotations

import numpy as np

from neuralgrasps.evaluate.pose import pose_errors
from neuralgrasps.geometry.camera import look_at
from neuralgrasps.perception.frame import Frame
from neuralgrasps.perception.object_video import follow_object


def frame_of(seen, **more) -> Frame:
    return Frame(seen.depth, seen.intrinsics, **more)


def test_an_object_that_was_put_elsewhere_moves_in_that_frame_wherever_it_is_found(things, look, standing):
    obj = things["wedge"]
    here, there = standing(obj, yaw_rad=1.0), standing(obj, yaw_rad=1.0, x=0.015)
    seen = [look(obj.mesh, X) for X in [here] * 5 + [there] * 5]
    nobody = np.zeros(seen[0].depth.shape, bool)
    frames = [frame_of(s) for s in seen]
    early = follow_object(frames, obj)
    late = follow_object(frames, obj, hidden=lambda k: nobody if k < 7 else None)
    assert early.found_in < 5 and late.found_in >= 7
    assert early.moves_from == late.moves_from == 5
    assert early.lost_from is None and late.lost_from is None
    for found, where in ((early, range(5)), (late, range(5, 10))):
        assert max(pose_errors(obj, found.X_CO[k], seen[k].X_CO).mssd_m for k in where) < 4e-3


def test_an_object_lifted_before_a_moving_camera_is_followed(things, look, standing):
    """The table is known in the world: a lifted object is never taken for one inside of it."""
    obj, count = things["wedge"], 10
    X_WO = standing(obj, yaw_rad=1.0)
    frames, truth = [], []
    for k in range(count):
        X = X_WO.copy()
        X[2, 3] += 0.012 * max(0, k - 4)
        eye = np.array([0.50, 0.18 - 0.03 * k, 0.42])
        seen = look(obj.mesh, X, X_WC=look_at(eye, np.array([0.0, 0.0, 0.04])))
        frames.append(frame_of(seen, X_WC=seen.X_WC))
        truth.append(seen.X_CO)
    found = follow_object(frames, obj)
    assert found.moves_from is not None and found.lost_from is None
    assert pose_errors(obj, found.X_CO[-1], truth[-1]).mssd_m < 5e-3
    nobody = np.zeros(frames[0].depth.shape, bool)
    back = follow_object(frames[::-1], obj, hidden=lambda k: nobody if k < 7 else None)  # found standing, at the end
    assert back.found_in >= 7
    assert pose_errors(obj, back.X_CO[0], truth[-1]).mssd_m < 5e-3


def test_what_a_person_hides_is_not_looked_at(things, look, standing):
    """A second, equal object in the person's pixels, nearer and better seen."""
    obj = things["wedge"]
    X_WO, decoy = standing(obj, yaw_rad=1.0, x=-0.12, y=-0.1), standing(obj, yaw_rad=0.4, x=0.12, y=0.06)
    seen = look(obj.mesh, X_WO, others=[(obj.mesh, decoy)])
    assert seen.masks[0].sum() > seen.mask.sum() > 200
    found = follow_object([frame_of(seen)], obj, hidden=lambda _: seen.masks[0])
    assert found.reason == "" and pose_errors(obj, found.X_CO[0], seen.X_CO).mssd_m < 4e-3
