import numpy as np
import pytest

from neuralgrasps.apply.transfer_query import (
    ELSEWHERE,
    contact_radius,
    query_from_contacts,
    query_from_grasp,
    query_from_points,
)
from neuralgrasps.dataset.hand_surface import sample_posed_surface
from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.grasps.contact_map import contact_map
from neuralgrasps.hands.packed import pack_shapes
from neuralgrasps.model.kinematic_field import default_object_codec
from tests.apply.conftest import BoxWorld


def test_a_grasp_asks_for_its_own_contact_map_with_the_decay_of_codes(box_world: BoxWorld) -> None:
    hand, obj, grasps = box_world.hand, box_world.obj, box_world.grasps
    query = query_from_grasp(hand, obj, grasps.X_OH[1], grasps.q[1])
    assert contact_radius(obj) == pytest.approx(default_object_codec(obj).radius_m)
    slow = contact_map(obj.points_O, hand, grasps.X_OH[1:2], grasps.q[1:2], radius=query.radius_m)[0]
    assert np.abs(query.contact_map - slow).max() < 1e-5
    assert (query.weight == 1.0).all() and query.source == "panda" and query.object == "brick"
    assert query.X_OP is not None and np.allclose(query.X_OP, grasps.X_OH[1] @ hand.X_HP)
    assert np.array_equal(query.palm_O, query.X_OP[:3, 3]) and np.array_equal(query.approach_O, query.X_OP[:3, 2])
    assert "panda on brick" in repr(query)


def test_points_of_the_hand_ask_for_nearly_the_same(box_world: BoxWorld) -> None:
    hand, obj, grasps = box_world.hand, box_world.obj, box_world.grasps
    packed, rng = pack_shapes(hand), np.random.default_rng(0)
    points = sample_posed_surface(packed, grasps.X_OH[0], grasps.q[0], 4000, rng)
    own = query_from_grasp(hand, obj, grasps.X_OH[0], grasps.q[0])
    seen = query_from_points(obj, points)
    assert np.abs(own.contact_map - seen.contact_map).mean() < 0.06  # points have gaps, the solid has none
    assert seen.X_OP is None and seen.palm_O is None and seen.approach_O is None


def test_drawn_contacts_count_where_they_are_and_little_elsewhere(box_world: BoxWorld) -> None:
    obj = box_world.obj
    at = obj.points_O[:2]
    query = query_from_contacts(obj, at)
    distance = np.linalg.norm(obj.points_O[:, None] - at[None], axis=2).min(axis=1)
    assert np.allclose(query.contact_map, np.exp(-distance / query.radius_m), atol=1e-6)
    assert query.weight.mean() == pytest.approx(1.0)
    assert query.weight[:2].argmax() in (0, 1) and query.weight.max() == pytest.approx(query.weight[0])
    least = ELSEWHERE / (1.0 + ELSEWHERE) * query.weight.max()
    assert query.weight.min() >= least - 1e-9 and query.weight.min() < 2.0 * least


@pytest.mark.parametrize("ask", [query_from_contacts, query_from_points])
def test_points_elsewhere_or_in_millimetres_are_refused(box_world: BoxWorld, ask) -> None:
    with pytest.raises(InputError, match=r"mm from 'brick'.*unit"):
        ask(box_world.obj, 1000.0 * box_world.obj.points_O[:5] + 1.0)
    with pytest.raises(InputError, match="at least one point"):
        ask(box_world.obj, np.zeros((0, 3)))
    with pytest.raises(InputError, match="finite"):
        ask(box_world.obj, np.full((2, 3), np.nan))
    with pytest.raises(ShapeError):
        ask(box_world.obj, np.zeros((3, 2)))


def test_a_grasp_that_is_not_finite_is_refused(box_world: BoxWorld) -> None:
    hand, obj, grasps = box_world.hand, box_world.obj, box_world.grasps
    with pytest.raises(InputError, match="not finite"):
        query_from_grasp(hand, obj, np.full((4, 4), np.nan), grasps.q[0])
    with pytest.raises(ShapeError):
        query_from_grasp(hand, obj, np.eye(4), np.zeros(7))
