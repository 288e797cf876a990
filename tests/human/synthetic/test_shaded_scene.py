"""Pictures of things that stay and things that move: what is kept from before is what would be drawn anew."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.geometry.camera import Intrinsics, look_at
from neuralgrasps.geometry.mesh import box_mesh, sphere_mesh
from neuralgrasps.human.synthetic.motion import Motion
from neuralgrasps.human.synthetic.shaded_scene import ShadedScene, Thing

VIEW = {
    "intrinsics": Intrinsics(100.0, 100.0, 59.5, 39.5, 120, 80),
    "X_WC": look_at(np.array([0.5, 0.2, 0.4]), np.zeros(3)),
    "light_W": np.array([0.5, -0.4, 1.6]),
}
TABLE, BLOCK = box_mesh([0.4, 0.4, 0.015]), box_mesh([0.03, 0.03, 0.1])
BALL = sphere_mesh(0.04, segments=12)


@pytest.mark.parametrize("place", [(0.1, 0.05, 0.1), (-0.1, 0.1, 0.06), (0.05, -0.02, 0.3), (3.0, 0.0, 0.0)])
def test_a_picture_is_the_same_whether_things_stay_or_are_drawn_anew(place):
    table, block, ball = (
        Thing(mesh=m, colour=c) for m, c in ((TABLE, (200,) * 3), (BLOCK, (90, 60, 30)), (BALL, (9, 99, 199)))
    )
    kept, anew = (
        ShadedScene(stay=[table, block], move=[ball], **VIEW),
        ShadedScene(stay=[], move=[table, block, ball], **VIEW),
    )
    for moved in (BALL.vertices + np.array([0.0, 0.1, 0.2]), BALL.vertices + np.array(place)):
        one, two = kept.draw([moved]), anew.draw([TABLE.vertices, BLOCK.vertices, moved])
        for name in ("depth", "index", "colour"):
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    assert len(np.unique(one.index)) >= 3 and len(np.unique(one.colour.reshape(-1, 3), axis=0)) > 20


def test_a_shadow_falls_on_what_stays():
    scene = ShadedScene(stay=[Thing(mesh=TABLE, colour=(200,) * 3)], move=[Thing(mesh=BALL, colour=(9, 9, 9))], **VIEW)
    with_ball, without = (scene.draw([BALL.vertices + np.array(p)]) for p in ((0.0, 0.0, 0.2), (3.0, 0.0, 0.0)))
    table = (with_ball.index == 0) & (without.index == 0)
    darker = table & (with_ball.colour.sum(axis=-1) < without.colour.sum(axis=-1))
    assert 30 < darker.sum() < 0.5 * table.sum()
    assert (with_ball.colour[table & ~darker] == without.colour[table & ~darker]).all()


def test_a_frame_keeps_what_nothing_in_it_moved():
    X = np.tile(np.eye(4), (4, 1, 1))
    lifted = X.copy()
    lifted[3:, 2, 3] = 0.1
    q = np.zeros((4, 2))
    q[1:, 0] = 0.5
    motion = Motion(X_WH=X, q=q, X_WO=lifted, still=(1, 3))
    assert [motion.keeps(t) for t in range(4)] == [False, False, True, False]
