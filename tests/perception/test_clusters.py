"""What stands on a table, cut out of a depth image."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import Intrinsics, look_at
from neuralgrasps.geometry.plane import Plane, horizontal_plane
from neuralgrasps.geometry.primitives import box_mesh, cylinder_mesh
from neuralgrasps.perception.clusters import ClusterConfig, find_clusters
from neuralgrasps.perception.frame import Frame
from neuralgrasps.perception.table import find_table
from neuralgrasps.perception.touching import _parts
from neuralgrasps.sim.camera import DepthNoise, render_depth_view

CAMERA = Intrinsics.from_fov(np.deg2rad(45.0), 200, 150)
TABLE = box_mesh([0.5, 0.5, 0.01])
X_WC = look_at(np.array([0.5, 0.1, 0.5]), np.array([0.0, 0.0, 0.03]))


def _scene(boxes, *, X_WC=X_WC, noise=None):
    """Boxes (half sizes, centre) on a table whose top is at z = 0; the table is mesh 0."""
    meshes, X_WM = [TABLE], np.tile(np.eye(4), (len(boxes) + 1, 1, 1))
    X_WM[0, 2, 3] = -0.01
    for i, (half, centre) in enumerate(boxes, start=1):
        meshes.append(box_mesh(half))
        X_WM[i, :3, 3] = centre
    return render_depth_view(meshes, X_WM, X_WC=X_WC, intrinsics=CAMERA, noise=noise)


def _clusters(depth, X_WC=X_WC, intrinsics=CAMERA, **knobs):
    """Clusters on the table at z = 0."""
    return find_clusters(Frame(depth, intrinsics), horizontal_plane(0.0, X_WC), config=ClusterConfig(**knobs))


BIG = ([0.04, 0.05, 0.06], [0.0, -0.12, 0.06])
SMALL = ([0.03, 0.03, 0.03], [0.0, 0.12, 0.03])


def _overlap(mask, truth):
    return (mask & truth).sum() / (mask | truth).sum()


@pytest.mark.parametrize("noise", [None, DepthNoise(grazing_dropout=0.3)])
def test_two_boxes_are_found_the_larger_first(noise):
    view = _scene([BIG, SMALL], noise=noise)
    masks = _clusters(view.depth)
    assert len(masks) == 2
    for mask, index in zip(masks, (1, 2), strict=True):
        assert _overlap(mask, view.mesh_index == index) > 0.8
        assert not (mask & (view.mesh_index == 3 - index)).any()


def test_an_empty_table_has_no_objects():
    assert _clusters(_scene([]).depth) == []


def test_a_depth_jump_separates_what_overlaps_in_the_image():
    # seen from the side, the small box stands before the big one and hides a part of it
    side = look_at(np.array([0.6, 0.05, 0.35]), np.array([0.0, 0.0, 0.05]))
    view = _scene([([0.03, 0.06, 0.08], [-0.1, 0.0, 0.08]), ([0.03, 0.03, 0.03], [0.08, 0.0, 0.03])], X_WC=side)
    masks = _clusters(view.depth, side)
    assert len(masks) == 2
    assert not any((m & (view.mesh_index == 1)).any() and (m & (view.mesh_index == 2)).any() for m in masks)


def test_a_slanted_edge_does_not_leak_through_diagonal_neighbours():
    intrinsics = Intrinsics(100.0, 100.0, 20.0, 20.0, 41, 41)
    down = np.diag([1.0, -1.0, -1.0, 1.0])
    down[2, 3] = 1.0  # 1 m above the table, looking down
    row, column = np.indices((41, 41))
    for slant in (row + column < 40, row - column < 0, row + column > 41, 2 * row + column < 60):
        depth = np.where(slant, 0.9, 0.8)
        masks = _clusters(depth, down, intrinsics)
        assert len(masks) == 2
        assert all(np.ptp(depth[m]) == 0 for m in masks)


def test_height_band_and_least_size_are_kept():
    view = _scene([BIG, SMALL])
    assert len(_clusters(view.depth, min_height_m=0.07)) == 1
    tallest = max(_clusters(view.depth, max_height_m=0.09), key=lambda m: m[view.mesh_index == 1].sum())
    assert Frame(view.depth, CAMERA).height(horizontal_plane(0.0, X_WC))[tallest].max() == pytest.approx(
        0.09, abs=0.003
    )
    assert _clusters(view.depth, max_height_m=0.02) == []  # most of what stands there lies above
    sizes = [m.sum() for m in _clusters(view.depth)]
    assert len(_clusters(view.depth, min_pixels=int(sizes[1]) + 1)) == 1
    assert sizes == sorted(sizes, reverse=True)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("nothing", [0.0, np.nan, np.inf, -1.0])
def test_pixels_without_a_measurement_belong_to_nothing_and_cut_nothing(nothing):
    view = _scene([BIG])
    depth = view.depth.copy()
    depth[::7, ::5] = nothing
    (mask,) = _clusters(depth)
    assert not mask[::7, ::5].any()
    assert _overlap(mask, view.mesh_index == 1) > 0.8


FINE = Intrinsics.from_fov(np.deg2rad(45.0), 480, 360)


def _seen(meshes, poses, X_WC, *, noise=None):
    """Depth of meshes and of a table of 0.6 x 0.6 m; the table is the last mesh."""
    X_WT = np.eye(4)
    X_WT[2, 3] = -0.01
    meshes = [*meshes, box_mesh([0.3, 0.3, 0.01])]
    return render_depth_view(meshes, np.stack([*poses, X_WT]), X_WC=X_WC, intrinsics=FINE, noise=noise)


def _at(x, y, z, turn_deg=0.0):
    X = np.eye(4)
    X[:3, :3] = Rotation.from_euler("z", turn_deg, degrees=True).as_matrix()
    X[:3, 3] = x, y, z
    return X


def _found(view, **knobs):
    frame = Frame(view.depth, view.intrinsics)
    fit = find_table(frame)
    return find_clusters(frame, fit.plane, extent=fit.extent, config=ClusterConfig(**knobs))


FRONT = look_at(np.array([0.65, 0.0, 0.5]), np.array([0.0, 0.0, 0.03]))
CAN, BRICK, TALL = cylinder_mesh(0.035, 0.05), box_mesh([0.03, 0.05, 0.04]), box_mesh([0.03, 0.05, 0.06])
TOUCHING = {
    "cans": ([CAN, CAN], [_at(0.0, -0.0355, 0.05), _at(0.0, 0.0355, 0.05)]),
    "can and box": ([CAN, BRICK], [_at(0.0, -0.0355, 0.05), _at(0.0, 0.0505, 0.04)]),
    "boxes in a corner": ([TALL, BRICK], [_at(-0.05, -0.02, 0.06), _at(0.03, 0.05, 0.04, 90.0)]),
}


@pytest.mark.parametrize("noise", [None, DepthNoise()])
@pytest.mark.parametrize("name", sorted(TOUCHING))
def test_things_that_touch_are_told_apart(name, noise):
    view = _seen(*TOUCHING[name], FRONT, noise=noise)
    assert len(_found(view, creases=None)) == 1
    masks = _found(view)
    assert len(masks) == 2
    for index in (0, 1):
        truth = (view.mesh_index == index) & (view.depth > 0)
        assert max(_overlap(mask, truth) for mask in masks) > 0.8


@pytest.mark.parametrize("noise", [None, DepthNoise()])
def test_one_thing_is_not_cut(noise):
    jug = [cylinder_mesh(0.05, 0.08), box_mesh([0.035, 0.008, 0.035])]  # its handle hangs in the air
    brick = [box_mesh([0.03, 0.05, 0.04])]
    side = look_at(np.array([0.2, 0.6, 0.4]), np.array([0.0, 0.0, 0.05]))
    for meshes, poses in ((jug, [_at(0, 0, 0.08), _at(0.075, 0, 0.1)]), (brick, [_at(0, 0, 0.04, 30.0)])):
        (mask,) = _found(_seen(meshes, poses, side, noise=noise))
        assert mask.sum() > 500


@pytest.mark.parametrize(("rows", "parts"), [(17, 2), (12, 1)])
def test_parts_whose_border_is_not_mostly_a_crease_belong_together(rows, parts):
    mask, creases = np.ones((20, 40), bool), np.zeros((20, 40), bool)
    creases[:rows, 20] = True
    labels = _parts(mask, creases, np.ones_like(mask), 8, 100, 0.7)
    assert labels.max() == parts and (labels > 0).all()
    assert _parts(mask, creases, np.ones_like(mask), 8, 100, 0.0).max() == 2


def test_boxes_with_their_faces_in_line_stay_one_cluster():
    assert len(_found(_seen([BRICK, BRICK], [_at(0, -0.05, 0.04), _at(0, 0.05, 0.04)], FRONT))) == 1


def test_a_fragment_is_given_back_to_its_neighbour_or_dropped():
    view = _seen([CAN], [_at(0.0, 0.0, 0.05)], FRONT)
    height = Frame(view.depth, FINE).height(horizontal_plane(0.0, FRONT))
    depth = np.where(np.abs(height - 0.09) < 0.004, 0.0, view.depth)  # a ring around the can was not measured
    depth = np.where(height > 0.0998, 0.0, depth)  # nor its lid: a narrow strip of the side is left above the ring
    strip = (height > 0.094) & (depth > 0)
    assert 50 < strip.sum() < 400
    apart = Frame(depth, FINE)
    table = horizontal_plane(0.0, FRONT)
    assert len(find_clusters(apart, table, config=ClusterConfig(fragment_m2=0.0))) == 2
    (mask,) = find_clusters(apart, table)
    assert mask[strip].mean() > 0.9
    alone = Frame(np.where((height > 0.01) & ~strip, 0.0, view.depth), FINE)
    assert find_clusters(alone, table) == []


def test_only_what_stands_on_the_table_is_found():
    eye = look_at(np.array([0.7, 0.0, 0.55]), np.array([-0.1, 0.0, 0.0]))
    wall, stool, floor = box_mesh([0.01, 1.5, 1.0]), box_mesh([0.15, 0.15, 0.35]), box_mesh([2.0, 2.0, 0.01])
    meshes, poses = [CAN, wall, stool, floor], [
        _at(-0.27, 0.0, 0.05), _at(-0.9, 0.0, 0.2), _at(-0.5, 0.42, -0.35 + 0.08), _at(0.0, 0.0, -0.63),
    ]  # fmt: skip
    view = _seen(meshes, poses, eye)
    assert (view.mesh_index == 2).sum() > 2000 and (view.mesh_index == 1).sum() > 2000
    (mask,) = _found(view)  # the stool reaches above the table's top beside it, the wall too, but they go on below
    assert _overlap(mask, view.mesh_index == 0) > 0.85


def test_a_thing_in_a_corner_that_was_not_seen_is_found_whole():
    low = look_at(np.array([0.8, 0.0, 0.3]), np.array([0.0, 0.0, 0.05]))
    view = _seen([box_mesh([0.02, 0.07, 0.03]), CAN], [_at(-0.18, -0.23, 0.03), _at(-0.26, -0.2, 0.05)], low)
    whole = view.mesh_index == 1
    assert max(_overlap(mask, whole) for mask in _found(view)) > 0.9
    assert max(_overlap(mask, whole) for mask in _found(view, margin_m=0.0)) < 0.8


def test_a_thing_behind_another_that_hides_the_table_between_is_found():
    low = look_at(np.array([0.8, 0.0, 0.3]), np.array([0.0, 0.0, 0.05]))
    view = _seen([box_mesh([0.03, 0.25, 0.06]), CAN], [_at(0.0, 0.0, 0.06), _at(-0.2, 0.0, 0.05)], low)
    tall = _seen([box_mesh([0.03, 0.25, 0.02]), CAN], [_at(0.0, 0.0, 0.02), _at(-0.2, 0.0, 0.05)], low)
    assert len(_found(view)) == 1  # quite hidden
    assert max(_overlap(mask, tall.mesh_index == 1) for mask in _found(tall)) > 0.8


def test_the_outline_is_looked_for_when_it_is_not_given():
    view = _seen(*TOUCHING["cans"], FRONT)
    frame = Frame(view.depth, FINE)
    fit = find_table(frame)
    given, looked_for = find_clusters(frame, fit.plane, extent=fit.extent), find_clusters(frame, fit.plane)
    np.testing.assert_array_equal(given, looked_for)


def test_a_camera_below_the_table_is_refused():
    frame = Frame(_scene([BIG]).depth, CAMERA)
    with pytest.raises(InputError, match="below the table's top"):
        find_clusters(frame, Plane(np.array([0.0, -1.0, 0.0]), -0.2))
