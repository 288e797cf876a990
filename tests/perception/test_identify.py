"""Which object of a library a view shows."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.pose import pose_errors
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.perception.identify import identify_object
from neuralgrasps.sim.camera import DepthNoise

LIBRARY = ("box", "ball", "can", "wedge")


@pytest.fixture(scope="module")
def library(things):
    return [things[name] for name in LIBRARY]


@pytest.mark.parametrize("shown", LIBRARY)
@pytest.mark.parametrize("how", ["points", "image and table", "noisy image and table"])
def test_the_shown_one_of_four_is_named(things, library, look, standing, shown, how):
    noise = DepthNoise() if how == "noisy image and table" else None
    seen = look(things[shown].mesh, standing(things[shown], yaw_rad=1.0), noise=noise)
    found = identify_object(library, **seen.asked(how))
    assert found.name == shown
    assert max(found.probability, key=found.probability.get) == shown
    assert sum(found.probability.values()) + found.none_probability == pytest.approx(1.0)
    assert min(found.probability.values()) >= 0.0
    assert pose_errors(things[shown], found.poses[shown].X_CO, seen.X_CO).add_s_m < 3e-3
    scores = {name: pose.score for name, pose in found.poses.items()}
    assert max(scores, key=scores.get) == shown


def test_the_order_of_the_library_does_not_matter(things, library, look, standing):
    seen = look(things["wedge"].mesh, standing(things["wedge"], yaw_rad=1.0))
    first, second = (identify_object(objects, **seen.asked("image and table")) for objects in (library, library[::-1]))
    assert first.name == second.name == "wedge"
    for name in LIBRARY:
        assert first.probability[name] == pytest.approx(second.probability[name], abs=1e-9)
        np.testing.assert_array_equal(first.poses[name].X_CO, second.poses[name].X_CO)


def test_a_thing_that_none_of_them_is_has_no_name(things, look, standing):
    ball = [things[name] for name in ("box", "wedge", "corner")]
    for objects, shown in ((ball, "ball"), ([things["ball"]], "box"), ([things["ball"], things["can"]], "corner")):
        seen = look(things[shown].mesh, standing(things[shown], yaw_rad=1.0))
        found = identify_object(objects, **seen.asked("image and table"))
        assert found.name is None
        assert found.none_probability > 0.5
        assert set(found.poses) == {obj.name for obj in objects}


@pytest.mark.parametrize("shown", ["corner", "ball"])
@pytest.mark.parametrize("how", ["points", "image and table"])
def test_a_thing_alike_in_size_has_no_name(things, look, standing, shown, how):
    objects = [things[name] for name in LIBRARY if name != shown]
    seen = look(things[shown].mesh, standing(things[shown], yaw_rad=1.0))
    assert identify_object(objects, **seen.asked(how)).name is None


def test_a_piece_of_table_has_no_name(library, look):
    hidden = np.eye(4)
    hidden[2, 3] = -0.1
    seen = look(box_mesh([0.001] * 3), hidden)
    mask = np.zeros(seen.mask.shape, bool)
    mask[70:110, 80:130] = True
    found = identify_object(library, depth=seen.depth, intrinsics=seen.intrinsics, mask=mask, table=seen.table)
    assert found.name is None and found.none_probability > 0.5


def test_a_library_that_cannot_be_used_is_named(things, look, standing):
    seen = look(things["box"].mesh, standing(things["box"]))
    with pytest.raises(InputError, match=r"box.*each name once"):
        identify_object([things["box"], things["can"], things["box"]], seen.points_C)
    with pytest.raises(InputError, match="no objects"):
        identify_object([], seen.points_C)
    with pytest.raises(InputError, match="nothing to look at"):
        identify_object([things["box"]])
