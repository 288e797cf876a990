"""Point clouds of scenes: where their points lie, what they leave out, and that they are a function of the scene."""

from dataclasses import fields, replace

import numpy as np
import pytest

from neuralgrasps.dataset import clouds as clouds_module
from neuralgrasps.dataset.camera_ring import (
    even_directions,
    object_views,
    ring_intrinsics,
    ring_level,
    ring_poses,
)
from neuralgrasps.dataset.clouds import SceneClouds, scene_clouds
from neuralgrasps.dataset.samples import hand_distances, normalisation_of
from neuralgrasps.dataset.scene_views import hand_reach
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import project
from neuralgrasps.geometry.mesh import Mesh, box_mesh, merge_meshes, signed_distance, sphere_mesh
from neuralgrasps.geometry.raster import rasterise
from neuralgrasps.hands.hand import ConvexPart, PartKind
from neuralgrasps.hands.packed import PackedHand, pack_hand
from neuralgrasps.hands.surface import hand_mesh
from neuralgrasps.hands.zoo import load_hand

COUNT = 700


@pytest.fixture(scope="module")
def packed() -> PackedHand:
    return pack_hand(load_hand("allegro"), spacing=0.009)


def clouds_of(small_world, packed: PackedHand, kind: str, which=slice(0, 3), mesh: Mesh | None = None, **changes):
    grasps, brick = small_world.grasp_sets[0], small_world.objects["brick"]
    config = replace(small_world.config, clouds=kind, cloud_points=COUNT, **changes)
    return grasps[which], mesh or brick.mesh, scene_clouds(
        mesh or brick.mesh, packed, grasps.X_OH[which], grasps.q[which], hand="allegro", object_name="brick",
        normalisation=normalisation_of(brick.points_O), config=config,
    )  # fmt: skip


def same(first: SceneClouds, second: SceneClouds) -> bool:
    return all(np.array_equal(getattr(first, f.name), getattr(second, f.name)) for f in fields(SceneClouds))


@pytest.mark.parametrize("kind", ["exact", "rendered"])
def test_points_lie_on_their_surface_with_its_normals(small_world, packed: PackedHand, kind: str) -> None:
    grasps, mesh, clouds = clouds_of(small_world, packed, kind)
    assert clouds.object_points_O.shape == clouds.hand_normals_O.shape == (3, COUNT, 3)
    step = 1e-4
    for i in range(3):
        on_object, on_hand = clouds.object_points_O[i].astype(float), clouds.hand_points_O[i].astype(float)
        pose = (packed, grasps.X_OH[i : i + 1], grasps.q[i : i + 1])
        assert np.abs(signed_distance(mesh, on_object)).max() < 1e-7
        assert np.abs(hand_distances(*pose, on_hand)).max() < 2e-6
        assert np.allclose(signed_distance(mesh, on_object + step * clouds.object_normals_O[i]), step, atol=1e-6)
        outside = hand_distances(*pose, on_hand + step * clouds.hand_normals_O[i])[0]
        assert np.mean(np.abs(outside - step) < 1e-6) > 0.95  # the others are in a corner with another part
        assert outside.max() < step + 1e-6


def test_a_rendered_cloud_shows_nothing_of_one_shape_inside_the_other(small_world, packed: PackedHand) -> None:
    grasps, mesh, _ = clouds_of(small_world, packed, "exact")
    closer = np.array(grasps.X_OH)
    closer[:, :3, 3] *= 0.5  # hand and object run through each other
    rendered = scene_clouds(
        mesh, packed, closer, grasps.q, hand="allegro", object_name="brick",
        normalisation=normalisation_of(small_world.objects["brick"].points_O),
        config=replace(small_world.config, clouds="rendered", cloud_points=COUNT),
    )  # fmt: skip
    exact = scene_clouds(
        mesh, packed, closer, grasps.q, hand="allegro", object_name="brick",
        normalisation=normalisation_of(small_world.objects["brick"].points_O),
        config=replace(small_world.config, clouds="exact", cloud_points=COUNT),
    )  # fmt: skip
    hidden = 0
    for i in range(len(grasps)):
        pose = (packed, closer[i : i + 1], grasps.q[i : i + 1])
        assert signed_distance(mesh, rendered.hand_points_O[i]).min() > -1e-6
        assert hand_distances(*pose, rendered.object_points_O[i]).min() > -1e-6
        hidden += (signed_distance(mesh, exact.hand_points_O[i]) < -1e-3).sum()
    assert hidden > 20


def test_the_views_are_those_of_a_triangle_renderer(small_world, packed: PackedHand) -> None:
    """Every rendered point is seen by some camera in a plain z-buffer of both meshes, at the depth of its own shape."""
    grasps, mesh, clouds = clouds_of(small_world, packed, "rendered", slice(0, 1))
    centre = normalisation_of(small_world.objects["brick"].points_O).offset_O
    base = np.linalg.norm(mesh.vertices - centre, axis=1).max()
    ring = ring_poses(centre, base, ring_level(hand_reach(packed, grasps.X_OH[0], grasps.q[0], centre), base))
    posed = hand_mesh(small_world.hands["allegro"], grasps.q[0], segments=64).transformed(grasps.X_OH[0])
    seen = {"object": np.zeros(COUNT, bool), "hand": np.zeros(COUNT, bool)}
    for X_OC in ring:
        X_CO = np.linalg.inv(X_OC)
        image = rasterise([mesh, posed], np.stack([X_CO, X_CO]), ring_intrinsics())
        for label, (name, points) in enumerate(
            {"object": clouds.object_points_O, "hand": clouds.hand_points_O}.items()
        ):
            points_C = points[0] @ X_CO[:3, :3].T + X_CO[:3, 3]
            u, v = np.rint(project(points_C, ring_intrinsics())).astype(int).T
            assert u.min() >= 0 and u.max() < 320 and v.min() >= 0 and v.max() < 240
            seen[name] |= (image.mesh_index[v, u] == label) & (np.abs(image.depth[v, u] - points_C[:, 2]) < 5e-4)
    assert seen["object"].all()
    assert seen["hand"].mean() > 0.99  # round parts are a little smaller as triangles


def test_nothing_is_taken_from_a_surface_that_another_encloses(small_world, packed: PackedHand) -> None:
    shell, core = box_mesh([0.03, 0.05, 0.08]), sphere_mesh(0.02)
    _, _, clouds = clouds_of(small_world, packed, "rendered", slice(0, 1), mesh=merge_meshes([core, shell]))
    assert np.abs(signed_distance(shell, clouds.object_points_O[0])).max() < 1e-7


def test_the_back_of_a_face_hides_but_gives_no_point() -> None:
    """A box without its top: cameras look through the hole onto the inside of its walls."""
    whole = box_mesh([0.04, 0.04, 0.04])
    up = np.cross(whole.triangles[:, 1] - whole.triangles[:, 0], whole.triangles[:, 2] - whole.triangles[:, 0])[:, 2]
    open_box = Mesh(whole.vertices, whole.faces[up < 1e-9])
    views = object_views(open_box, ring_poses(np.zeros(3), 0.07, 0))
    assert (views.face == -2).sum() > 10_000
    from_above = views.X_OC[:, 2, 3] > 0.15
    for view in np.flatnonzero(from_above)[:3]:
        own = views.face[views.starts[view] : views.starts[view + 1]]
        assert (own == -2).sum() > 0.2 * (own != -1).sum()


@pytest.mark.parametrize("kind", ["exact", "rendered"])
def test_a_cloud_depends_on_its_own_scene_and_the_seed_alone(small_world, packed: PackedHand, kind: str) -> None:
    _, _, together = clouds_of(small_world, packed, kind)
    _, _, alone = clouds_of(small_world, packed, kind, slice(2, 3))
    for f in fields(SceneClouds):
        assert np.array_equal(getattr(together, f.name)[2], getattr(alone, f.name)[0])
    _, _, other = clouds_of(small_world, packed, kind, seed=9)
    assert not same(together, other)


def test_rendered_points_are_spread_evenly(small_world, packed: PackedHand) -> None:
    _, _, clouds = clouds_of(small_world, packed, "rendered", slice(0, 1))
    for points in (clouds.object_points_O[0], clouds.hand_points_O[0]):
        apart = np.linalg.norm(points[:, None] - points[None], axis=2) + 9.0 * np.eye(COUNT)
        nearest = apart.min(axis=1)
        assert nearest.min() > 0.6 * nearest.mean()  # of points drawn at random it is 0.02


def test_exact_points_are_uniform_over_the_union(small_world) -> None:
    """Two cubes that touch: each of the 10 faces in view gets its share, the two between them get none."""
    hand = load_hand("fetch")
    cube = ConvexPart(link=0, kind=PartKind.BOX, size=np.full(3, 0.02), X_LP=np.eye(4))
    shifted = np.eye(4)
    shifted[0, 3] = 0.04
    other = replace(cube, X_LP=shifted)
    two = pack_hand(replace(hand, parts=(cube, other)), spacing=0.01)
    brick = small_world.objects["brick"]
    clouds = scene_clouds(
        brick.mesh, two, np.eye(4)[None], hand.q_open[None], hand="fetch", object_name="brick",
        normalisation=normalisation_of(brick.points_O),
        config=replace(small_world.config, clouds="exact", cloud_points=20_000),
    )  # fmt: skip
    points, normals = clouds.hand_points_O[0], clouds.hand_normals_O[0]
    sides = [(np.abs(normals[:, axis]) > 0.5) for axis in range(3)]
    assert not (sides[0] & (np.abs(points[:, 0] - 0.02) < 1e-6)).any()
    assert sides[0].mean() == pytest.approx(2 / 10, abs=0.01)
    assert sides[1].mean() == pytest.approx(4 / 10, abs=0.01)


def test_a_shape_that_no_camera_sees_has_no_points(small_world, packed: PackedHand) -> None:
    """A hand inside a large box."""
    box = box_mesh([0.5, 0.5, 0.5])
    _, _, clouds = clouds_of(small_world, packed, "rendered", slice(0, 1), mesh=box)
    assert np.isnan(clouds.hand_points_O).all() and np.isfinite(clouds.object_points_O).all()


def test_few_pixels_are_repeated(monkeypatch, small_world, packed: PackedHand) -> None:
    original = clouds_module.seen_in_scene

    def few(*args, **options):
        seen_object, seen_hand = original(*args, **options)
        return replace(seen_object, points_O=seen_object.points_O[:9], normals_O=seen_object.normals_O[:9]), seen_hand

    monkeypatch.setattr(clouds_module, "seen_in_scene", few)
    _, _, clouds = clouds_of(small_world, packed, "rendered", slice(0, 1))
    _, counts = np.unique(clouds.object_points_O[0], axis=0, return_counts=True)
    assert len(counts) == 9 and counts.max() - counts.min() <= 1


def test_the_ring_is_even_and_has_the_whole_scene_in_view() -> None:
    directions = even_directions(128)
    apart = np.arccos(np.clip(directions @ directions.T - 2 * np.eye(128), -1, 1)).min(axis=1)
    assert apart.min() > 0.8 * np.sqrt(4 * np.pi / 128) and np.abs(directions.mean(axis=0)).max() < 0.01
    ball = 0.1 * 1.25**3 * even_directions(500) + [0.1, 0.0, -0.2]
    for X_OC in ring_poses(np.array([0.1, 0.0, -0.2]), 0.1, 3):
        pixels = project((ball - X_OC[:3, 3]) @ X_OC[:3, :3], ring_intrinsics())
        assert pixels.min() >= 0 and pixels[:, 0].max() <= 319 and pixels[:, 1].max() <= 239
    for reach in (0.05, 0.1, 0.11500000000000002, 0.2, 0.3):
        level = ring_level(reach, 0.1)
        assert 0.1 * 1.25**level >= reach and (level == 0 or 0.1 * 1.25 ** (level - 1) < reach)


def test_clouds_must_be_asked_for(small_world, packed: PackedHand) -> None:
    with pytest.raises(InputError, match='"none"'):
        clouds_of(small_world, packed, "none")
    with pytest.raises(InputError, match="expected none or exact or rendered"):
        replace(small_world.config, clouds="both")
