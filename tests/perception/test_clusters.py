"""What stands on a table, cut out of a depth image."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import Intrinsics, look_at
from neuralgrasps.geometry.plane import Plane, horizontal_plane
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.perception.clusters import ClusterConfig, find_clusters
from neuralgrasps.perception.frame import Frame
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


def test_a_camera_below_the_table_is_refused():
    frame = Frame(_scene([BIG]).depth, CAMERA)
    with pytest.raises(InputError, match="below the table's top"):
        find_clusters(frame, Plane(np.array([0.0, -1.0, 0.0]), -0.2))
