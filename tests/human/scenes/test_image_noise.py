"""The fast noise of thinned images against the camera's own."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.compiled import njit
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.geometry.mesh import Mesh, box_mesh, sphere_mesh
from neuralgrasps.human.scenes.image_noise import CAMERA_NOISE, sense_image, sensed_image
from neuralgrasps.sim.camera import STRUCTURED_LIGHT, render_depth_view

CAMERA = Intrinsics(580.0, 580.0, 319.5, 239.5, 640, 480)
SAME = CAMERA_NOISE


@njit
def _seeded(seed):
    np.random.seed(seed)  # noqa: NPY002 - the generator that compiled code has


def _view(noise):
    """A ball and a slab before a wall."""
    ball, slab, wall = sphere_mesh(0.08), box_mesh([0.03, 0.15, 0.01]), box_mesh([2.0, 2.0, 0.01])
    X = np.tile(np.eye(4), (3, 1, 1))
    X[:, :3, 3] = [[-0.12, 0.0, 0.7], [0.12, 0.0, 0.6], [0.0, 0.0, 1.1]]
    meshes: list[Mesh] = [ball, slab, wall]
    return render_depth_view(meshes, X, X_WC=np.eye(4), intrinsics=CAMERA, noise=noise, seed=1)


def _fast(exact, noise, *, thin=1):
    depth = np.where(exact.depth > 0, exact.depth, np.inf).astype(np.float32)[::thin, ::thin].copy()
    out = np.empty_like(depth)
    _seeded(3)
    sense_image(depth, CAMERA.fx / thin, float(thin), noise, out)
    return out


def _compare(slow, fast, exact, label):
    """Shares lost, of flying pixels and of shadow, and the deviation on flat ground, agree."""
    for name, chosen in label.items():
        assert (fast == 0)[chosen].mean() == pytest.approx((slow == 0)[chosen].mean(), rel=0.25, abs=0.01), name
        off = [np.abs(np.where(d > 0, d, exact) - exact)[chosen] > 0.03 for d in (fast, slow)]
        assert off[0].mean() == pytest.approx(off[1].mean(), rel=0.3, abs=0.01), name


@pytest.mark.parametrize("thin", [1, 3])
def test_losses_and_flying_pixels_are_the_cameras(thin):
    exact, slow = _view(None), _view(STRUCTURED_LIGHT)
    edge = np.zeros(exact.depth.shape, bool)
    for axis in (0, 1):
        step = np.abs(np.diff(exact.depth, axis=axis)) > 0.05
        edge[: -1 if axis == 0 else None, : -1 if axis == 1 else None] |= step
        edge[1 if axis == 0 else 0 :, 1 if axis == 1 else 0 :] |= step
    wall, ball = (exact.mesh_index == 2) & ~edge, (exact.mesh_index == 0) & ~edge
    label = {"wall": wall, "ball": ball, "all": np.ones_like(wall)}
    thinned = {name: chosen[::thin, ::thin] for name, chosen in label.items()}
    _compare(
        slow.depth[::thin, ::thin], _fast(exact, SAME, thin=thin), exact.depth[::thin, ::thin], thinned
    )  # fmt: skip


def test_flat_ground_has_the_cameras_deviation():
    exact, slow = _view(None), _view(STRUCTURED_LIGHT)
    fast = _fast(exact, SAME)
    flat = (exact.mesh_index == 2) & (fast > 0) & (slow.depth > 0)
    error = [(d - exact.depth)[flat] for d in (fast, slow.depth)]
    error = [e[np.abs(e) < 0.01] for e in error]
    assert error[0].std() == pytest.approx(error[1].std(), rel=0.1)
    assert abs(error[0].mean() - error[1].mean()) < 2e-4


def test_the_shadow_is_on_the_projectors_far_side():
    exact = _view(None)
    clean = SAME._replace(axial_m=0.0, step_m=0.0, grazing_dropout=0.0, edge_dropout=0.0, flying=0.0, lateral_px=0.0)
    right, left = _fast(exact, clean) == 0, _fast(exact, clean._replace(baseline_m=-clean.baseline_m)) == 0
    np.testing.assert_array_equal(right, _view_shadow())
    mirrored = exact.depth[:, ::-1]
    depth = np.where(mirrored > 0, mirrored, np.inf).astype(np.float32)
    out = np.empty_like(depth)
    sense_image(np.ascontiguousarray(depth), CAMERA.fx, 1.0, clean, out)
    np.testing.assert_array_equal(left[:, ::-1], out == 0)


def _view_shadow():
    view = _view(STRUCTURED_LIGHT)
    return ~view.lit | (_view(None).depth == 0)


def test_a_seed_gives_one_image():
    exact = _view(None)
    depth = np.where(exact.depth > 0, exact.depth, np.inf).astype(np.float32)
    first, again, other = (sensed_image(depth, CAMERA.fx, noise=SAME, seed=seed) for seed in (3, 3, 2**32 - 1))
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(first, _fast(exact, SAME))
    assert (first != other).mean() > 0.1
