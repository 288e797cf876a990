"""Points of a hand that touches the object: they help where the view leaves it free, and do no harm."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.evaluate.pose import pose_errors
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.perception.contact import ContactPoints
from neuralgrasps.perception.pose import PoseConfig, estimate_pose

ENDS_O = np.array([[0.1, 0.0, 0.0], [0.1, 0.01, 0.0], [-0.1, 0.0, 0.0], [-0.1, -0.01, 0.0]])


def _at(x, y, z, yaw_rad):
    X = np.eye(4)
    X[:2, :2] = [[np.cos(yaw_rad), -np.sin(yaw_rad)], [np.sin(yaw_rad), np.cos(yaw_rad)]]
    X[:3, 3] = [x, y, z]
    return X


@pytest.fixture(scope="module")
def bar(make_object):
    return make_object("bar", box_mesh([0.10, 0.02, 0.02]), symmetry=True)


@pytest.fixture(scope="module")
def between_posts(bar, look):
    """A bar whose middle alone is seen, between two posts: it may lie a centimetre further along."""
    towards = np.array([np.cos(0.345), np.sin(0.345)])
    aside = np.array([-towards[1], towards[0]])
    posts = [
        (box_mesh([0.06, 0.01, 0.06]), _at(*(0.10 * towards + s * 0.075 * aside), 0.06, 0.345 + 0.5 * np.pi))
        for s in (-1, 1)
    ]
    return look(bar.mesh, _at(0.0, 0.0, 0.02, 0.345 + 0.5 * np.pi), others=posts)


def _touched(points_O, X_CO):
    return points_O @ X_CO[:3, :3].T + X_CO[:3, 3]


def test_contacts_at_both_ends_fix_a_bar_that_the_view_leaves_free(bar, between_posts):
    seen = between_posts
    without = estimate_pose(bar, **seen.image)
    slack = pose_errors(bar, without.X_CO, seen.X_CO).mssd_m
    assert slack > 5e-3
    contact = ContactPoints(points_C=_touched(ENDS_O, seen.X_CO))
    found = estimate_pose(bar, contact=contact, **seen.image)
    assert pose_errors(bar, found.X_CO, seen.X_CO).mssd_m < 0.3 * slack
    assert found.score > without.score - 0.01


def test_contacts_say_which_of_two_turns_it_is(things, look):
    # the bevel is at the back: a finger that lies on it tells which edge is cut
    obj = things["bevelled"]
    seen = look(obj.mesh, _at(0.0, 0.0, 0.06, 0.345 + np.pi), table=False)
    bevel_O = np.array([[0.022, 0.037, z] for z in (-0.03, 0.0, 0.03)])
    found = estimate_pose(obj, contact=ContactPoints(points_C=_touched(bevel_O, seen.X_CO)), **seen.image)
    assert pose_errors(obj, found.X_CO, seen.X_CO).mssd_m < 4e-3


@pytest.mark.parametrize("off", [[0.0, 0.0, 0.05], [0.05, 0.0, 0.0], [0.0, -0.05, 0.0], [0.01, 0.01, 0.0]])
def test_wrong_contacts_do_not_make_the_view_less_explained(things, bar, between_posts, look, standing, off):
    views = [(bar, between_posts, ENDS_O)]
    for name in ("wedge", "rimmed"):
        seen = look(things[name].mesh, standing(things[name], yaw_rad=1.0))
        views.append((things[name], seen, things[name].points_O[::200]))
    for obj, seen, points_O in views:
        without = estimate_pose(obj, **seen.image)
        contact = ContactPoints(points_C=_touched(points_O, seen.X_CO) + np.array(off))
        found = estimate_pose(obj, contact=contact, **seen.image)
        assert found.score > without.score - PoseConfig().contact_share
        if obj is not bar:  # what the view fixes stays
            gap = pose_errors(obj, found.X_CO, without.X_CO).mssd_m
            assert gap < 1e-3


def test_right_contacts_leave_a_sure_pose_as_it_is(things, look, standing):
    obj = things["corner"]
    seen = look(obj.mesh, standing(obj, yaw_rad=1.0))
    contact = ContactPoints(points_C=_touched(obj.points_O[::100], seen.X_CO), sigma_m=0.005)
    found = estimate_pose(obj, contact=contact, **seen.image)
    assert pose_errors(obj, found.X_CO, seen.X_CO).mssd_m < 1e-3


def test_contacts_that_mean_nothing_are_refused():
    for points, message in (
        (np.zeros((0, 3)), "0 contact points"),
        (np.full((2, 3), np.nan), "not all finite"),
        ([[0.0, 0.0, np.inf]], "not all finite"),
    ):
        with pytest.raises(InputError, match=message):
            ContactPoints(points_C=np.array(points))
    for sigma in (0.0, -0.001, 0.05, np.nan):
        with pytest.raises(InputError, match="sigma_m"):
            ContactPoints(points_C=np.zeros((1, 3)), sigma_m=sigma)
    with pytest.raises(ShapeError, match="contact points_C has shape"):
        ContactPoints(points_C=np.zeros((3, 2)))
