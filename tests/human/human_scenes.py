"""A small bank of grasps for tests of random scenes."""

from __future__ import annotations

from functools import cache

from neuralgrasps.geometry.mesh import box_mesh, cylinder_mesh
from neuralgrasps.human.scenes.grasp_bank import GraspBank, make_grasp_bank
from neuralgrasps.human.scenes.kit import SceneKit, scene_kit


@cache
def small_bank() -> GraspBank:
    """Hands on a box and a can."""
    return make_grasp_bank([box_mesh([0.03, 0.04, 0.09]), cylinder_mesh(0.04, 0.06, segments=20)], proposals=96)


@cache
def small_kit() -> SceneKit:
    return scene_kit(small_bank())
