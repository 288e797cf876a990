"""Contact sheets: the view shows the contacts, the pictures come in order, the captions say what touches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.primitives import box_mesh, sphere_mesh
from neuralgrasps.grasps.grasp_set import GraspSet, Verdict
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.report.contact_sheet import SheetPair, contact_sheets, grasp_view, kind_text
from neuralgrasps.report.contact_views import contact_direction

SMALL = (48, 36)


def _at(mesh: Mesh, *offset: float) -> Mesh:
    X = np.eye(4)
    X[:3, 3] = offset
    return mesh.transformed(X)


def _turned(angle: float) -> np.ndarray:
    X = np.eye(4)
    X[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return X


@pytest.fixture(scope="module")
def hand() -> Hand:
    return load_hand("panda")


@pytest.fixture(scope="module")
def ball(make_object: Callable[..., ObjectModel]) -> ObjectModel:
    return make_object("ball", sphere_mesh(0.03))


@pytest.fixture(scope="module")
def pair(hand: Hand, ball: ObjectModel) -> SheetPair:
    """Eight poses of a jaw round a ball, each turned by 45 degrees more; only the labels of the first two differ."""
    X_OH = np.stack([_turned(a) @ _approach(hand) for a in np.arange(8) * np.pi / 4])
    q = np.repeat(hand.q_open[None], 8, axis=0)
    pads = [finger.links[-1] for finger in hand.fingers]
    points = np.array([[0.03, 0, 0], [-0.03, 0, 0]])
    points_O = np.stack([points @ _turned(a)[:3, :3].T for a in np.arange(8) * np.pi / 4])
    grasps = GraspSet(
        hand=hand.name, object=ball.name, X_OH=X_OH, q=q, q_pregrasp=q, q_squeeze=q, contact_points_O=points_O,
        contact_normals_O=points_O / 0.03, contact_links=np.tile(np.array(pads, np.int32), (8, 1)),
        epsilon=np.arange(8) / 10, penetration_m=np.zeros(8), force_residual=np.zeros(8),
        palm_contact=np.arange(8) == 1, finger_count=np.array([2, 2, 1, -1, 2, 2, 2, 2]),
        precision=np.arange(8) != 1,
        verdicts={
            "dexgraspbench": Verdict(
                success=np.ones(8, bool), displacement_m=np.arange(8) * 1e-3, rotation_rad=np.zeros(8)
            )
        },
    )  # fmt: skip
    return SheetPair(hand=hand, obj=ball, grasps=grasps, depth_m=np.full(8, 2e-4))


def _approach(hand: Hand) -> np.ndarray:
    """The pads along x, the hand above the ball."""
    X_OP = np.eye(4)
    X_OP[:3, :3] = np.diag([1.0, -1.0, -1.0])
    X_HP = hand.X_HP.copy()
    X_HP[:3, 3] = hand.jaw_pad_H
    return X_OP @ np.linalg.inv(X_HP)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_camera_stands_where_the_finger_touches(side: float):
    """A larger finger that touches nothing, on the other side, does not draw the camera."""
    finger, idle, target = sphere_mesh(0.006), sphere_mesh(0.015), sphere_mesh(0.03)
    meshes = [_at(finger, 0.036 * side, 0, 0), _at(idle, -0.05 * side, 0, 0)]
    contacts = np.array([[0.03 * side, 0, 0]])
    assert contact_direction(meshes, [0, 1], target, contacts, np.array([0]))[0] * side > 0.3
    # far from the origin too
    X = np.eye(4)
    X[:3, 3] = (0.5, -0.4, 0.2)
    meshes, contacts = [m.transformed(X) for m in meshes], contacts + X[:3, 3]
    assert contact_direction(meshes, [0, 1], target.transformed(X), contacts, np.array([0]))[0] * side > 0.3


def test_two_fingers_on_a_plate_are_seen_from_its_edge():
    """From either face only one of them would be in view."""
    meshes = [_at(sphere_mesh(0.008), x, 0, 0) for x in (0.012, -0.012)]
    plate, contacts = box_mesh([0.004, 0.03, 0.03]), np.array([[0.004, 0, 0], [-0.004, 0, 0]])
    view = contact_direction(meshes, [0, 1], plate, contacts, np.array([0, 1]))
    assert abs(view[0]) < 0.3


def test_the_view_turns_with_the_scene():
    meshes = [_at(sphere_mesh(0.008), 0.035, 0.015, 0), _at(sphere_mesh(0.02), -0.05, 0, 0)]
    target = sphere_mesh(0.03)
    contacts = np.array([[0.028, 0.012, 0], [-0.03, 0, 0]])
    views = []
    for angle in (0.0, np.pi / 3, np.pi):
        X = _turned(angle)
        view = contact_direction(
            [m.transformed(X) for m in meshes], [0, 1], target, contacts @ X[:3, :3].T, np.array([0, 1])
        )
        views.append(X[:3, :3].T @ view)
    np.testing.assert_allclose(views[1:], views[:1] * 2, atol=1e-9)


def test_a_grasp_without_contacts_is_still_looked_at(pair: SheetPair):
    bare = replace(pair.grasps[:1], contact_links=np.full((1, 2), -1), contact_points_O=np.full((1, 2, 3), np.nan),
                   contact_normals_O=np.full((1, 2, 3), np.nan))  # fmt: skip
    assert np.linalg.norm(grasp_view(pair.hand, pair.obj.mesh, bare)) == pytest.approx(1)


def test_sheets_hold_the_first_grasps_in_order(pair: SheetPair):
    done = []
    empty = replace(pair, grasps=pair.grasps[:0], depth_m=np.zeros(0))
    sheets = contact_sheets([empty, pair], shown=7, size=SMALL, progress=lambda d, t, text: done.append((d, t, text)))
    assert [(s.hand, s.object, len(s.grasps)) for s in sheets] == [("panda", "ball", 7)]
    assert [g.epsilon for g in sheets[0].grasps] == pytest.approx(np.arange(7) / 10)
    assert [g.displacement_mm for g in sheets[0].grasps] == pytest.approx(np.arange(7))
    assert sheets[0].grasps[0].penetration_mm == pytest.approx(0.2)
    assert done == [(6, 7, "panda on ball"), (7, 7, "panda on ball")]
    alone = contact_sheets([replace(pair, grasps=pair.grasps[6:7])], size=SMALL)[0]
    np.testing.assert_array_equal(alone.grasps[0].image, sheets[0].grasps[6].image)
    assert sheets[0].grasps[0].image.shape == (36, 48, 4)


def test_captions_say_what_touches(pair: SheetPair):
    texts = [kind_text(pair.grasps, i) for i in range(4)]
    assert texts == ["precision, 2 fingers", "power, 2 fingers and palm", "precision, 1 finger", ""]
