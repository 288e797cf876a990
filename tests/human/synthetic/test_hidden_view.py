"""Badly seen demonstrations: the share of the hand asked for, the object in sight, nothing touched by what hides it."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.mesh import Mesh, box_mesh, cylinder_mesh, signed_distance
from neuralgrasps.geometry.raster import rasterise
from neuralgrasps.hands.surface import hand_mesh
from neuralgrasps.hands.variants import scaled_hand
from neuralgrasps.human.skeleton import human_hand
from neuralgrasps.human.synthetic import demonstration
from neuralgrasps.human.synthetic.demonstration import DemonstrationConfig, record_demonstration
from neuralgrasps.human.synthetic.hidden_view import choose_hidden_view
from neuralgrasps.human.synthetic.occluder import is_near, swept
from neuralgrasps.human.synthetic.recording import UNITS_PER_METRE

SHARE = (0.4, 0.75)
SEEDS = tuple(range(6))


@pytest.fixture(scope="module")
def brick(make_object):
    return make_object("brick", box_mesh([0.022, 0.035, 0.05]))


def config(share, **more):
    return DemonstrationConfig(side="left", scale=0.8, noise=None, width=320, height=240, share=share, **more)


@pytest.fixture(scope="module")
def hidden(brick):
    """Recordings, with the views chosen for them and what moved."""
    with pytest.MonkeyPatch.context() as patch:
        views = []

        def watched(rng, acted, **more):
            views.append((choose_hidden_view(rng, acted, **more), acted))
            return views[-1][0]

        patch.setattr(demonstration, "choose_hidden_view", watched)
        made = [record_demonstration(brick, seed=seed, config=config(SHARE)) for seed in SEEDS]
    return list(zip(made, *zip(*views, strict=True), strict=True))


def test_the_share_asked_for_is_seen_and_it_is_not_cut_off(hidden):
    hand = scaled_hand(human_hand("left"), 0.8)
    for recorded, _, _ in hidden:
        truth, t = recorded.truth, recorded.truth.grasp_frame
        assert SHARE[0] <= truth.visible[t] <= SHARE[1]
        inside = rasterise([hand_mesh(hand, truth.q[t])], truth.X_CH[t][None], recorded.intrinsics).mesh_index == 0
        assert truth.hand_mask[t].sum() / inside.sum() == pytest.approx(truth.visible[t], abs=0.05)


def test_some_hands_are_hidden_by_where_the_camera_stands_and_others_by_a_thing(hidden):
    things = [view.occluder is not None for _, view, _ in hidden]
    assert 1 <= sum(things) < len(things)
    for recorded, view, _ in hidden:
        assert any("stands before" in note for note in recorded.truth.notes) == (view.occluder is not None)


def test_the_object_is_seen_before_the_hand_comes(hidden, brick):
    for recorded, _, _ in hidden:
        alone = rasterise([brick.mesh], recorded.truth.X_CO[0][None], recorded.intrinsics)
        on_it = (alone.mesh_index == 0) & (np.abs(recorded.depth_units[0] / UNITS_PER_METRE - alone.depth) < 1e-3)
        assert on_it.sum() > 0.35 * (alone.mesh_index == 0).sum()


def test_the_thing_stands_on_the_table_clear_of_hand_object_and_arm_and_off_the_camera(hidden, brick):
    hand = scaled_hand(human_hand("left"), 0.8)
    for recorded, view, acted in hidden:
        if view.occluder is None:
            continue
        mesh, truth, X_WC = view.occluder.mesh, recorded.truth, recorded.X_WC
        assert mesh.vertices[:, 2].min() == pytest.approx(0.0, abs=1e-12) and mesh.vertices[:, 2].max() < 0.3
        assert np.linalg.norm(mesh.vertices - X_WC[:3, 3], axis=1).min() > 0.15
        for t in range(len(recorded)):
            X_WH, X_WO = X_WC @ truth.X_CH[t], X_WC @ truth.X_CO[t]
            points = [hand_mesh(hand, truth.q[t]).vertices @ X_WH[:3, :3].T + X_WH[:3, 3]]
            points.append(brick.points_O @ X_WO[:3, :3].T + X_WO[:3, 3])
            assert signed_distance(mesh, np.concatenate(points)).min() > 0.012
        assert signed_distance(mesh, acted.swept_W()).min() > 0.02  # the arm is in these, too
        filled = rasterise([mesh], np.linalg.inv(X_WC)[None], recorded.intrinsics).mesh_index == 0
        assert 0.0 < filled.mean() < 0.35


def test_the_same_act_is_seen_well_and_badly_and_the_seed_decides_the_rest(brick, hidden):
    well = record_demonstration(brick, seed=SEEDS[0], config=config(None))
    badly, again = hidden[0][0], record_demonstration(brick, seed=SEEDS[0], config=config(SHARE))
    np.testing.assert_array_equal(well.truth.q, badly.truth.q)
    np.testing.assert_allclose(well.X_WC @ well.truth.X_CH, badly.X_WC @ badly.truth.X_CH, atol=1e-12)
    for name in ("depth_units", "colour", "X_WC"):
        np.testing.assert_array_equal(getattr(badly, name), getattr(again, name))
    assert well.X_WC.tolist() != badly.X_WC.tolist()


def test_a_share_that_no_view_shows_is_said_so(brick):
    recorded = record_demonstration(brick, seed=0, config=config((1e-4, 1.1e-4)))
    assert any("no view tried shows 0.0001 to 0.00011 of" in note for note in recorded.truth.notes)


@pytest.mark.parametrize("share", [(0.0, 0.5), (0.6, 0.4), (0.5, 1.1)])
def test_a_share_that_cannot_be_is_refused(share):
    with pytest.raises(InputError, match="share is"):
        DemonstrationConfig(share=share)


def test_what_a_mesh_sweeps_has_no_gaps():
    sheet = Mesh(np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.1, 0.1, 0.0]]), [[0, 1, 2], [1, 3, 2]])
    cells = swept([sheet], [[sheet.vertices], [sheet.vertices + np.array([0.0, 0.0, 0.05])]])
    assert set(np.unique(cells[:, 2].round(6))) == {0.0, 0.05}
    x, y = np.meshgrid(np.linspace(0.0, 0.1, 60), np.linspace(0.0, 0.1, 60))
    points = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    assert np.linalg.norm(points[:, None] - cells, axis=-1).min(axis=1).max() < 0.01


@pytest.mark.parametrize("mesh", [box_mesh([0.02, 0.05, 0.1]), cylinder_mesh(0.03, 0.1)])
def test_near_is_by_distance(mesh):
    rng = np.random.default_rng(0)
    points = rng.uniform(-1.0, 1.0, (400, 3)) * [0.1, 0.1, 0.15]
    distance = signed_distance(mesh, points)
    near = np.array([is_near(mesh, point[None]) for point in points])
    assert near[distance < 0.025 - 1e-9].all() and not near[distance > 0.025 * np.sqrt(3.0)].any()
    assert 20 < near.sum() < 380
