"""The focal length that a known object asks for, told the true one, a longer and a shorter one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.geometry.camera import look_at
from neuralgrasps.geometry.primitives import box_mesh, cylinder_mesh
from neuralgrasps.human.video.focal import FocalCheck, object_focal, stretched
from neuralgrasps.perception.frame import Frame
from neuralgrasps.sim.camera import render_depth_view
from tests.human.conftest import CAMERA

ASIDE = (-0.12, 0.10)  # in the world: far off the middle of the image


@pytest.fixture(scope="module")
def can(make_object):
    return make_object("can", cylinder_mesh(0.033, 0.06))


def seen(obj, factor: float) -> tuple[Frame, np.ndarray]:
    """The object on a table aside of the camera's axis, taken for a camera `factor` times as long; its true X_CO."""
    X_WC = look_at(np.array([0.45, 0.35, 0.5]), np.array([0.0, 0.0, 0.03]))
    X_WO, X_WT = np.eye(4), np.eye(4)
    X_WO[:3, 3], X_WT[2, 3] = [*ASIDE, -obj.mesh.bounds[0, 2]], -0.01
    view = render_depth_view(
        [obj.mesh, box_mesh([0.5, 0.5, 0.01])], np.stack([X_WO, X_WT]), X_WC=X_WC, intrinsics=CAMERA
    )
    said = replace(CAMERA, fx=factor * CAMERA.fx, fy=factor * CAMERA.fy)
    return Frame(depth=view.depth, intrinsics=said), np.linalg.inv(X_WC) @ X_WO


@pytest.mark.parametrize("factor", [1.4, 1.25, 0.8, 0.72])
def test_a_wrong_focal_length_is_named(can, factor: float):
    frame, X_CO = seen(can, factor)
    X_CO[:3, 3] = stretched(X_CO[:3, 3], factor)  # where it seems to be
    check = object_focal(frame, can, X_CO)
    assert check is not None and check.factor == pytest.approx(1.0 / factor, rel=0.05)
    assert check.best_m < 0.5 * check.residual_m and not check.sure


def test_the_true_focal_length_is_sure(can):
    frame, X_CO = seen(can, 1.0)
    check = object_focal(frame, can, X_CO)
    assert check is not None and check.factor == 1.0 and check.off == 0.0 and check.sure
    assert check.residual_m < 0.002


def test_it_cannot_be_told_where_no_object_is(can):
    frame, X_CO = seen(can, 1.0)
    X_CO[2, 3] -= 0.3
    assert object_focal(frame, can, X_CO) is None


def test_how_far_off_counts_alike_both_ways():
    shorter, longer = (FocalCheck(factor=f, residual_m=1.0, best_m=0.5, sure=False) for f in (0.5, 2.0))
    assert shorter.off == pytest.approx(longer.off) == pytest.approx(np.log(2.0))
