"""One made-up demonstration: a hand that comes to a brick, as far as the transfer."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from neuralgrasps.apply.demonstrate import Demonstration, grasp_in_object
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.human.video.watch import HandTrack
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.object_video import FollowedObject
from neuralgrasps.perception.pose import PoseResult
from tests.human.shown import SCALE, ShownVideo, shown_video

GAPS = (None, 0.12, None, 0.05, 0.01, 0.01)
MOMENT = 4


@pytest.fixture(scope="module")
def obj(make_object: Callable[..., ObjectModel]) -> ObjectModel:
    return make_object("brick", box_mesh(np.array([0.03, 0.03, 0.08])))


@pytest.fixture(scope="module")
def video(obj: ObjectModel) -> ShownVideo:
    return shown_video(obj, GAPS, colour=True)


@pytest.fixture(scope="module")
def demo(obj: ObjectModel, video: ShownVideo) -> Demonstration:
    """All went well up to the transfer, which was not reached."""
    grasp = video.fits[MOMENT]
    assert grasp is not None
    pose = PoseResult(
        X_CO=video.X_CO, confidence=0.97, score=1.0, residual_m=1e-3, explained=1.0, covariance=np.eye(6),
        converged=True, alternatives_X_CO=video.X_CO[None], alternatives_probability=np.ones(1), seed=0,
    )  # fmt: skip
    followed = FollowedObject(
        X_CO=np.tile(video.X_CO, (len(GAPS), 1, 1)), seen=np.ones(len(GAPS)), found_in=0, pose=pose, table=None,
        moves_from=None, lost_from=None, reason="",
    )  # fmt: skip
    track = HandTrack(
        frames=tuple(video.fits), boxes=tuple(video.boxes), seen=tuple(video.seen), looked=tuple(range(len(GAPS))),
        side="right", scale=SCALE,
        moment=MOMENT, grasp=grasp, cloud_C=np.zeros((0, 3)), still=(4, 5), visible=0.8, contacts=("palm", "thumb"),
        stage="", reason="", reasons=("The thumb is <hidden> & far.",),
    )  # fmt: skip
    human, X_OH = grasp_in_object(grasp, video.X_CO)
    return Demonstration(
        object=obj.name, hand="fetch", seed=0, stage="", reason="", followed=followed, track=track, human=human,
        X_OH=X_OH, q=grasp.q, seconds={"object": 0.2, "hand": 0.4},
    )  # fmt: skip
