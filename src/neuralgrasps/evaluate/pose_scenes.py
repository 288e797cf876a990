"""Simulated depth images of one thing in a room, with the truth that its pose estimate is measured against."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from scipy import ndimage

from neuralgrasps.errors import InputError, unknown_name
from neuralgrasps.evaluate.pose_occluders import Placed, body_of, hide, own_depth, turn_z
from neuralgrasps.evaluate.pose_room import CAMERA, random_room, random_view
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.geometry.plane import Plane, horizontal_plane
from neuralgrasps.geometry.se3_numpy import transform_points_np
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.resting import resting_poses
from neuralgrasps.perception.frame import Frame
from neuralgrasps.seeds import child_rng, child_seed
from neuralgrasps.sim.camera import STRUCTURED_LIGHT, render_depth_view

Condition = Literal["easy", "occluded", "hard"]
CONDITIONS: tuple[Condition, ...] = get_args(Condition)
HARD_NOISE = replace(STRUCTURED_LIGHT, white_m=0.0025, scale_error=0.003, bias_m=0.003)
"""The sensor of the hard scenes: 2.5 mm more noise, 0.3 % too far, and a smooth error of 3 mm."""
SPILL_M = 0.003
VISIBLE = (0.25, 0.80)
"""Between these shares of the object's own pixels stay visible in the occluded and hard scenes."""
_REDRAWS = 30
_MIN_PIXELS = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseScene:
    """One depth image of an object on a table.

    Attributes:
        object: its name; "" for a thing that no library has.
        condition: "easy", "occluded" or "hard".
        depth: (h, w) float32 z-depth, metres; 0 = nothing measured.
        intrinsics: the camera; X_WC: (4, 4) its pose, world z up, the table's top at z = 0.
        mask: (h, w) bool, what an instance segmentation gives the estimator: pixels with a measurement.
        true_mask: (h, w) bool, pixels on the object, measured or not.
        X_CO_true: (4, 4) the object's pose in the camera; nan for an unknown thing.
        table: the true table in the camera's frame.
        visible_share: share of the pixels it would have alone that the object has, and that the sensor's projector
            sees too: nothing is measured in the shadow that a thing in front throws beside itself.
        seed: the scene's.
    """

    object: str
    condition: Condition
    depth: np.ndarray
    intrinsics: Intrinsics
    mask: np.ndarray
    true_mask: np.ndarray
    X_WC: np.ndarray
    X_CO_true: np.ndarray
    table: Plane
    visible_share: float
    seed: int

    @property
    def frame(self) -> Frame:
        """The scene as perception reads it, without colour."""
        return Frame(depth=self.depth, intrinsics=self.intrinsics, X_WC=self.X_WC)


def pose_scene(
    obj: ObjectModel,
    condition: Condition,
    *,
    seed: int,
    distractors: Sequence[ObjectModel] = (),
    intrinsics: Intrinsics = CAMERA,
) -> PoseScene:
    """An object in a random stable pose on a table, seen from 0.5 to 1.2 m at 25 to 65 degrees elevation.

    "easy": nothing in front, exact mask. "occluded": one to three things leave 25 to 80 % (uniform) of its pixels
    visible. "hard": as occluded, and the mask spills over its edge by 3 mm, depths are 0.3 % too large, with a smooth
    error of 3 mm and 2.5 mm more noise. The sensor is `STRUCTURED_LIGHT`. One seed gives the object the same pose,
    view and room in all three, and occluded and hard the same things in front.

    Args:
        obj: the object.
        distractors: library objects that may stand in front; `obj` itself is never among them. Boxes and cylinders
            when there are none.
    Raises:
        UnknownNameError: no such condition.
        InputError: no scene could be made, as of an object too small to be seen.
    """
    if condition not in CONDITIONS:
        raise unknown_name("condition", condition, CONDITIONS)
    others = [other for other in distractors if other.name != obj.name]
    body, (poses, shares) = body_of(obj), resting_poses(obj.mesh.vertices, obj.com_O)
    for attempt in range(_REDRAWS):
        rng = child_rng(seed, "pose scene", obj.name, attempt)
        pose = poses[rng.choice(len(poses), p=shares)]
        target = Placed(body=body, X_WB=turn_z(rng.uniform(0.0, 2.0 * np.pi)) @ pose)
        scene = _scene_of(target, obj.name, condition, seed=seed, rng=rng, others=others, intrinsics=intrinsics)
        if scene is not None:
            return scene
    raise InputError(
        f"'{obj.name}' gave no {condition} scene in {_REDRAWS} draws; expected an object 3 to 50 cm large."
    )


def spilled(mask: np.ndarray, depth_m: float, intrinsics: Intrinsics) -> np.ndarray:
    """A mask (h, w) grown by 3 mm at a depth."""
    pixels = SPILL_M * intrinsics.fx / depth_m
    return np.asarray(ndimage.distance_transform_edt(~mask) <= pixels)


def _scene_of(
    target: Placed,
    name: str,
    condition: Condition,
    *,
    seed: int,
    rng: np.random.Generator,
    others: Sequence[ObjectModel],
    intrinsics: Intrinsics,
) -> PoseScene | None:
    """One draw; None when too little of the target is seen."""
    X_WC = random_view(target.centre_W, target.body.radius_m, intrinsics, rng)
    room = random_room(rng, X_WC)
    things: tuple[Placed, ...] | None = ()
    if condition != "easy":
        share = child_rng(seed, "visible share", name).uniform(VISIBLE[0] + 0.015, VISIBLE[1] - 0.015)
        things = hide(target, share=share, X_WC=X_WC, intrinsics=intrinsics, rng=rng, distractors=others)
    if things is None:
        return None
    placed = (target, *things)
    view = render_depth_view(
        [*(p.body.mesh for p in placed), room],
        np.stack([*(p.X_WB for p in placed), np.eye(4)]),
        X_WC=X_WC,
        intrinsics=intrinsics,
        noise=HARD_NOISE if condition == "hard" else STRUCTURED_LIGHT,
        seed=child_seed(seed, "sensor", name),
    )
    true_mask = view.mesh_index == 0
    own = np.isfinite(own_depth(target, X_WC, intrinsics))
    visible = float((true_mask & view.lit).sum() / max(own.sum(), 1))
    X_CO = np.linalg.inv(X_WC) @ target.X_WB
    distance = float(transform_points_np(X_CO, target.body.centre[None])[0, 2])
    mask = (spilled(true_mask, distance, intrinsics) if condition == "hard" else true_mask) & (view.depth > 0)
    if mask.sum() < _MIN_PIXELS or (condition != "easy" and not VISIBLE[0] <= visible <= VISIBLE[1]):
        return None
    return PoseScene(
        object=name, condition=condition, depth=view.depth, intrinsics=intrinsics, mask=mask, true_mask=true_mask,
        X_WC=X_WC, X_CO_true=X_CO, table=horizontal_plane(0.0, X_WC), visible_share=visible, seed=seed,
    )  # fmt: skip
