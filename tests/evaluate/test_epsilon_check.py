"""The comparison of the fast epsilon with Qhull, on sets of known answers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from neuralgrasps.evaluate import epsilon_check
from neuralgrasps.evaluate.epsilon_check import check_epsilon, grasp_wrench_sets
from neuralgrasps.geometry.primitives import sphere_mesh
from neuralgrasps.grasps.epsilon import epsilon
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.grasps.wrench_space import characteristic_length, grasp_wrenches
from neuralgrasps.objects.object_model import ObjectModel

AXES = np.concatenate([np.eye(3), -np.eye(3)])


@pytest.fixture(scope="module")
def ball(make_object: Callable[..., ObjectModel]) -> ObjectModel:
    return make_object("ball", sphere_mesh(0.03), cells=16, points=64)


def held(count: int, *, friction: str = "0.5", name: str = "claw") -> GraspSet:
    """Grasps that touch the ball on its six axes with one link each, of a hand with one joint."""
    joints = np.zeros((count, 1))
    return GraspSet(
        hand=name, object="ball", X_OH=np.tile(np.eye(4), (count, 1, 1)), q=joints, q_pregrasp=joints,
        q_squeeze=joints, contact_points_O=np.tile(0.03 * AXES, (count, 1, 1)),
        contact_normals_O=np.tile(AXES, (count, 1, 1)), contact_links=np.tile(np.arange(6), (count, 1)),
        epsilon=np.zeros(count), penetration_m=np.zeros(count), config={"friction": friction, "torsion_m": "0.02"},
    )  # fmt: skip


def cross(normals: np.ndarray, friction: float = 0.5) -> np.ndarray:
    return grasp_wrenches(0.05 * normals, normals, np.zeros(3), friction, 8, 0.02, 0.05)


def test_known_sets_are_counted_right() -> None:
    sets = [cross(AXES), cross(AXES[[0, 3]]), cross(AXES[:3]), cross(AXES[:1]), np.zeros((3, 6))]
    found = check_epsilon(sets, workers=1)
    # two opposite soft fingers hold, three on one side do not
    assert (found.count, found.force_closure, found.sign_errors, found.differing) == (5, 2, 0, 0)
    assert found.max_difference < 1e-8
    assert found.qp_not_converged == 0 and found.qp_residual_max < 1e-3
    assert found.wrenches_median == 20  # of 60, 20, 30, 10 and 3
    assert found.closure_ms_mean > 0 and found.qhull_ms_mean > 0


def test_wrong_values_and_signs_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    sets = [cross(AXES), cross(AXES[[0, 3]]), cross(AXES[:3])]
    monkeypatch.setattr(epsilon_check, "epsilon", lambda w: epsilon(w) + 0.01 * len(w))
    found = check_epsilon(sets, workers=1)
    assert (found.sign_errors, found.differing) == (1, 3)
    assert found.max_difference == pytest.approx(0.6)  # of 60, 20 and 30 wrenches
    monkeypatch.setattr(epsilon_check, "epsilon", lambda _: 0.0)
    assert check_epsilon(sets, workers=1).sign_errors == 2


def test_sets_come_from_every_grasp_whole_thinned_and_slippery(ball: ObjectModel) -> None:
    sets = grasp_wrench_sets([held(5), held(3, friction="0.3", name="paw")], {"ball": ball}, count=80, seed=1)
    length = characteristic_length(ball.points_O, ball.com_O)
    whole = [grasp_wrenches(0.03 * AXES, AXES, ball.com_O, f, 8, 0.02, length) for f in (0.5, 0.3)]
    assert len(sets) == 80
    for k in range(2):  # every second set is of the second hand
        own = sets[k::2]
        same = [w.shape == (60, 6) and np.allclose(w, whole[k]) for w in own]
        thinned = [len(w) < 60 for w in own]
        slippery = [len(w) == 60 and not s for w, s in zip(own, same, strict=True)]
        assert min(sum(same), sum(thinned), sum(slippery)) >= 4
        assert all(len(w) >= 10 and len(w) % 10 == 0 for w in own)
        for w in (w for w, s in zip(own, slippery, strict=True) if s):
            sideways = np.linalg.norm(np.delete(w[:8, :3], 0, axis=1), axis=1)  # the first contact's normal is x
            assert 0.1 <= sideways.max() / float(("0.5", "0.3")[k]) <= 0.6
    again = grasp_wrench_sets([held(5), held(3, friction="0.3", name="paw")], {"ball": ball}, count=80, seed=1)
    assert all(np.array_equal(a, b) for a, b in zip(sets, again, strict=True))
    assert grasp_wrench_sets([held(0)], {"ball": ball}, count=10) == []
