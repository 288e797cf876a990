"""Random scenes: objects rest on the table, within reach, apart; and the same seed draws the same."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from neuralgrasps.apply.table_scenes import draw_scene, scene_table, scene_world, table_plane, work_area
from neuralgrasps.arms.arm import Arm
from neuralgrasps.arms.zoo import load_arm
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.primitives import box_mesh, cylinder_mesh
from neuralgrasps.geometry.sampling import sample_surface
from neuralgrasps.geometry.se3_numpy import transform_points_np
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.ik import solve_ik
from neuralgrasps.planning.world import PlacedObject


@pytest.fixture(scope="module")
def arm() -> Arm:
    return load_arm("fetch")


@pytest.fixture(scope="module")
def things(make_object) -> list[ObjectModel]:
    """Five of different sizes; the bar is long, the last is not centred in its own frame."""
    off = cylinder_mesh(0.033, 0.05, segments=32)
    return [
        make_object("bar", box_mesh([0.02, 0.03, 0.10]), cells=32),
        make_object("brick", box_mesh([0.03, 0.05, 0.04]), cells=32),
        make_object("cube", box_mesh([0.03, 0.03, 0.03]), cells=32),
        make_object("slab", box_mesh([0.06, 0.05, 0.015]), cells=32),
        make_object("can", type(off)(vertices=off.vertices + np.array([0.1, -0.2, 0.3]), faces=off.faces), cells=32),
    ]


def vertices_B(placed: PlacedObject) -> np.ndarray:
    return transform_points_np(placed.X_BO, placed.obj.mesh.vertices)


@pytest.mark.parametrize("seed", range(6))
def test_objects_rest_on_the_table_within_the_work_area(arm, things, seed: int) -> None:
    scene, area = draw_scene(things, arm, seed=seed), work_area(arm)
    assert [p.obj.name for p in scene.objects] == [o.name for o in things] and scene.seed == seed
    for placed in scene.objects:
        low = vertices_B(placed)
        assert low[:, 2].min() == pytest.approx(arm.table_height_m, abs=1e-9)
        com = placed.X_BO[:3, :3] @ placed.obj.com_O + placed.X_BO[:3, 3]
        assert area.near_m <= com[0] <= area.far_m and abs(com[1]) <= area.side_m
        foot = low[low[:, 2] < arm.table_height_m + 1e-3]
        assert len(foot) >= 3 and (foot[:, :2].min(0) <= com[:2]).all() and (com[:2] <= foot[:, :2].max(0)).all()
        inside = np.abs(low[:, :2] - scene.table.X_BX[:2, 3]) <= scene.table.half[:2]
        assert inside.all(), "hangs over the edge"


@pytest.mark.parametrize("seed", range(3))
def test_objects_keep_apart(arm, things, seed: int) -> None:
    """Distances between dense points of the surfaces, not by the fields that the drawing asks."""
    scene = draw_scene(things, arm, seed=seed)
    clouds = [transform_points_np(p.X_BO, sample_surface(p.obj.mesh, 3000, 0)[0]) for p in scene.objects]
    for a, b in combinations(clouds, 2):
        assert cdist(a, b).min() > 0.014


def test_the_same_seed_draws_the_same_scene(arm, things) -> None:
    first, again, other = (draw_scene(things, arm, seed=s) for s in (4, 4, 5))
    for a, b, c in zip(first.objects, again.objects, other.objects, strict=True):
        np.testing.assert_array_equal(a.X_BO, b.X_BO)
        assert np.abs(a.X_BO - c.X_BO).max() > 1e-3


def test_draws_spread_over_places_turns_and_resting_poses(arm, things) -> None:
    brick, area = things[1], work_area(arm)
    poses = np.stack([draw_scene([brick], arm, seed=s).objects[0].X_BO for s in range(150)])
    across = (poses[:, 0, 3] - area.near_m) / (area.far_m - area.near_m)
    assert across.min() < 0.1 and across.max() > 0.9 and np.abs(poses[:, 1, 3]).max() > 0.9 * area.side_m
    down = np.abs(poses[:, 2, :3]).argmax(axis=1)  # the axis of O that is vertical
    sign = np.sign(poses[np.arange(150), 2, down])
    assert len({*zip(down, sign, strict=True)}) == 6
    heading = np.arctan2(poses[:, 1, :3], poses[:, 0, :3])[np.arange(150), (down + 1) % 3]
    assert np.histogram(heading, bins=8, range=(-np.pi, np.pi))[0].min() > 5


def test_too_many_objects_do_not_fit(arm, make_object) -> None:
    plate = make_object("plate", box_mesh([0.2, 0.2, 0.02]), cells=24)
    with pytest.raises(InputError, match="9 objects do not fit on the table of arm 'fetch'"):
        draw_scene([plate] * 9, arm, seed=0)


@pytest.mark.parametrize("name", ["fetch", "panda"])
def test_the_work_area_is_within_reach(make_arm, name: str) -> None:
    """From above, at all its corners and its middle, 20 cm over the table."""
    robot = make_arm(name)
    area, z = work_area(robot.arm), robot.arm.table_height_m + 0.2
    X_BP = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (6, 1, 1))
    X_BP[:, :3, 3] = [
        [x, y, z] for x in (area.near_m, area.far_m) for y in (-area.side_m, 0.0, area.side_m)
    ]  # fmt: skip
    found = solve_ik(robot, X_BP @ np.linalg.inv(robot.hand.X_HP), starts=robot.q_home[robot.arm_dofs][None])
    assert found.converged.any(axis=1).mean() >= 0.5
    assert 0.2 < area.near_m < area.far_m < 1.3


@pytest.fixture(scope="module")
def make_arm():
    from neuralgrasps.arms.mount import mount  # noqa: PLC0415
    from neuralgrasps.hands.zoo import load_hand  # noqa: PLC0415

    return lambda name: mount(load_arm(name), load_hand(name))


def test_the_world_of_a_scene(arm, things) -> None:
    scene = draw_scene(things[:3], arm, seed=1)
    world = scene_world(scene, 1)
    assert world.target is not None and world.target.obj is things[1]
    assert [p.obj.name for p in world.objects] == ["bar", "cube"] and world.boxes == (scene.table,)
    nobody = scene_world(scene, None, [np.eye(4)] * 3)
    assert nobody.target is None and len(nobody.objects) == 3
    np.testing.assert_array_equal(nobody.objects[2].X_BO, np.eye(4))
    plane = table_plane(scene)
    top = scene_table(arm)
    assert plane.height(np.array([[0.3, 0.1, arm.table_height_m + 0.07]]))[0] == pytest.approx(0.07)
    assert top.X_BX[2, 3] + top.half[2] == pytest.approx(arm.table_height_m)
