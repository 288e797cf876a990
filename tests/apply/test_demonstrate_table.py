"""A demonstration before a camera that moves and says so; and the robot's grasps clear the table that was seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.apply.demonstrate import DemonstrateConfig, _first_table, demonstrate, demonstration_support
from neuralgrasps.apply.demonstrate_rules import transfer_under
from neuralgrasps.apply.transfer import TransferConfig
from neuralgrasps.apply.transfer_query import query_from_grasp
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.grasps.grasp_io import load_grasps
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.model.run_notes import run_folder
from neuralgrasps.objects.zoo import load_object
from tests.human.shown import shown_video

GAPS = (None, None, 0.06, 0.004, 0.004, 0.004, 0.004)
UP = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
MOVED = 2  # the camera is elsewhere from this frame on


@pytest.fixture(scope="module")
def can():
    return load_object("tomato_soup_can")


@pytest.fixture(scope="module")
def known(can):
    return load_grasps(run_folder("standins7") / "grasps" / can.name / "fetch.safetensors")


@pytest.fixture(scope="module")
def videos(can):
    """The same from two places."""
    return shown_video(can, GAPS), shown_video(can, GAPS, eye=(0.42, -0.5, 0.4))


@pytest.fixture(scope="module")
def frames(videos):
    return [*videos[0].frames[:MOVED], *videos[1].frames[MOVED:]]


@pytest.fixture(scope="module")
def found(can, known, videos, frames):
    """With known grasps of which most go through the table: the robot's hand below the object's middle."""
    joints = [*videos[0].seen[:MOVED], *videos[1].seen[MOVED:]]
    support = demonstration_support(can, Plane(np.array([0.0, 0.0, 1.0]), float(-can.mesh.bounds[0, 2])))
    clear = np.flatnonzero(support.allows(load_hand("fetch"), known.X_OH, known.q, known.q_pregrasp))
    through = np.setdiff1d(np.arange(len(known)), clear)
    assert len(through) >= 10 <= len(clear)
    config = DemonstrateConfig(transfer=TransferConfig(count=10, trials=20, method="retrieve"))
    return demonstrate(
        frames, can, load_hand("fetch"), joints=joints, known=known[np.sort([*through, *clear[:12]])], config=config
    )


def test_the_grasp_is_in_the_object_frame_wherever_the_camera_is(found, videos):
    assert (found.stage, found.reason) == ("", "")
    assert found.track.moment >= MOVED
    truth = videos[1].fits[found.track.moment]
    X_CH = found.followed.X_CO[found.track.moment] @ found.X_OH
    assert np.linalg.norm((X_CH - truth.X_CH)[:3, 3]) < 0.015
    palm, expected = (X[:3, :3] @ truth.hand.X_HP[:3, 2] for X in (X_CH, truth.X_CH))
    assert palm @ expected > 0.97
    height = (videos[1].frames[0].X_WC @ truth.X_CH)[2, 3]
    above = found.table_O.height(found.X_OH[None, :3, 3])[0]
    assert above == pytest.approx(height, abs=0.015)  # of the hand's base over the table


def test_the_query_is_the_contact_map_of_the_persons_grasp(found, can):
    expected = query_from_grasp(found.human, can, found.X_OH, found.track.grasp.q)
    np.testing.assert_array_equal(found.query.contact_map, expected.contact_map)
    np.testing.assert_array_equal(found.q, found.track.grasp.q)


def test_a_side_that_is_given_is_taken(can, known, videos):
    nothing = DemonstrateConfig(least_confidence=1.1)  # ends after the hand
    video = videos[0]
    told = demonstrate(
        video.frames, can, load_hand("fetch"), joints=video.seen, known=known, side="left", config=nothing
    )
    assert told.track.side == "left"


def test_grasps_through_the_table_are_left_out(found, can):
    support = demonstration_support(can, found.table_O)
    grasps = found.grasps
    assert len(grasps) >= 3
    assert support.allows(load_hand("fetch"), grasps.X_OH, grasps.q, grasps.q_pregrasp).all()


def test_the_table_is_told_in_the_first_frames_camera(found, frames):
    at = 5
    table = replace(found.followed.table, plane=UP.moved(np.linalg.inv(frames[at].X_WC)))
    plane = _first_table(frames, replace(found.followed, table=table, found_in=at))
    expected = UP.moved(np.linalg.inv(frames[0].X_WC))
    np.testing.assert_allclose([*plane.normal, plane.offset_m], [*expected.normal, expected.offset_m], atol=1e-9)


def test_where_no_known_grasp_clears_the_table_new_ones_are_known(can, known):
    """Retrieval alone can give only what was made."""
    hand = load_hand("fetch")
    support = demonstration_support(can, Plane(np.array([0.0, 0.0, 1.0]), float(-can.mesh.bounds[0, 2])))
    through = known[~support.allows(hand, known.X_OH, known.q, known.q_pregrasp)]
    query = query_from_grasp(hand, can, known.X_OH[0], known.q[0])
    config = TransferConfig(count=2, synthesise=12, method="retrieve")
    result = transfer_under(query, hand, can, known=through, config=config, support=support, constraints=None, seed=0)
    assert len(result.grasps) == 2 and (result.source >= len(through)).all()
