"""Simulated depth images of an object in a hand, with what the robot knows of its hand and its contacts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.pose_occluders import Body, Placed, body_of, body_of_mesh, own_depth
from neuralgrasps.evaluate.pose_room import CAMERA, random_room, random_view
from neuralgrasps.evaluate.pose_views import see
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.geometry.se3_numpy import make_transform_np, transform_points_np
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.surface import hand_mesh
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame
from neuralgrasps.seeds import child_rng, child_seed

HELD_VISIBLE = (0.15, 0.85)
"""Views are redrawn until so much of the object's own pixels is visible."""
CALIBRATION_M, CALIBRATION_DEG, CONTACT_M = 0.002, 1.0, 0.001
_REDRAWS = 25
_HEIGHT_M = 0.4


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldScene:
    """One depth image of an object in a hand, no table; O object, H hand base, C camera, W world with z up.

    Attributes:
        object, hand: their names. grasp: which grasp of the set. q: (J,) the hand's joints.
        depth: (h, w) float32 z-depth, metres; 0 = nothing measured.
        intrinsics: the camera; X_WC: (4, 4) its pose.
        mask: (h, w) bool, what an instance segmentation gives, spilling 3 mm over hand and background: pixels with a
            measurement. true_mask: (h, w) bool, pixels on the object, measured or not.
        X_CO_true, X_CH_true: (4, 4) true poses of the object and of the hand.
        X_CH: (4, 4) the hand's pose as the robot believes it.
        contact_points_C: (K, 3) where the hand feels the object, as the robot believes it; K may be 0.
        contact_normals_C: (K, 3) the object's outward unit normals there.
        visible_share: share of the pixels it would have alone that the object has, and that the projector sees too.
        seed: the scene's.
    """

    object: str
    hand: str
    grasp: int
    q: np.ndarray
    depth: np.ndarray
    intrinsics: Intrinsics
    mask: np.ndarray
    true_mask: np.ndarray
    X_WC: np.ndarray
    X_CO_true: np.ndarray
    X_CH_true: np.ndarray
    X_CH: np.ndarray
    contact_points_C: np.ndarray
    contact_normals_C: np.ndarray
    visible_share: float
    seed: int

    @property
    def frame(self) -> Frame:
        """The scene as perception reads it, without colour."""
        return Frame(depth=self.depth, intrinsics=self.intrinsics, X_WC=self.X_WC)


def held_scene(
    obj: ObjectModel, hand: Hand, grasps: GraspSet, index: int, *, seed: int, intrinsics: Intrinsics = CAMERA
) -> HeldScene:
    """An object in a hand at `grasps.q[index]`, turned at random in the air, in a room without a table.

    The camera is 0.5 to 1.2 m off, 10 degrees below to 65 above; the sensor and the mask are those of hard scenes.
    Views are redrawn, 25 times at most, until 15 to 85 % of the object is visible; where none is, as of a large box in
    a gripper, the view nearest to that range is taken. The robot's belief of its hand is off by a rigid error of 2 mm
    and 1 degree about the hand's base, and every contact by 1 mm more (all root mean squares).

    Raises:
        InputError: the grasps are of another hand or object, `index` is not in the set, or no view shows the object.
    """
    if (grasps.hand, grasps.object) != (hand.name, obj.name) or not -len(grasps) <= index < len(grasps):
        raise InputError(
            f"held_scene got grasp {index} of {len(grasps)} of '{grasps.object}' by '{grasps.hand}', with the object "
            f"'{obj.name}' and the hand '{hand.name}'; expected the same names, and an index in the set."
        )
    index %= len(grasps)
    hand_body = body_of_mesh(hand_mesh(hand, grasps.q[index], segments=16), seed=0)
    best, off = None, np.inf
    for attempt in range(_REDRAWS):
        rng = child_rng(seed, "held scene", hand.name, obj.name, index, attempt)
        target = _in_the_air(body_of(obj), rng)
        held_by = Placed(body=hand_body, X_WB=target.X_WB @ grasps.X_OH[index])
        X_WC = random_view(target.centre_W, target.body.radius_m, intrinsics, rng, elevation_deg=(-10.0, 65.0))
        share = _unhidden(target, held_by, X_WC, intrinsics)
        outside = max(HELD_VISIBLE[0] - share, share - HELD_VISIBLE[1], 0.0)
        if share > 0.0 and outside < off:
            best, off = (target, held_by, X_WC), outside
        if off == 0.0:
            break
    if best is None:
        raise InputError(f"no view in {_REDRAWS} shows '{obj.name}' in grasp {index} of '{hand.name}'.")
    return _scene(obj, hand, grasps, index, *best, seed=seed, intrinsics=intrinsics)


def _in_the_air(body: Body, rng: np.random.Generator) -> Placed:
    R = Rotation.random(rng=rng).as_matrix()
    return Placed(body=body, X_WB=make_transform_np(R, np.array([0.0, 0.0, _HEIGHT_M]) - R @ body.centre))


def _unhidden(target: Placed, hand: Placed, X_WC: np.ndarray, intrinsics: Intrinsics) -> float:
    own = own_depth(target, X_WC, intrinsics)
    alone = np.isfinite(own)
    return float((own <= own_depth(hand, X_WC, intrinsics))[alone].mean()) if alone.any() else 0.0


def _scene(
    obj: ObjectModel, hand: Hand, grasps: GraspSet, index: int, target: Placed, held_by: Placed, X_WC: np.ndarray,
    *, seed: int, intrinsics: Intrinsics,
) -> HeldScene:  # fmt: skip
    """Sense one view, and disturb what the robot knows."""
    rng = child_rng(seed, "belief", hand.name, obj.name, index)
    names = (hand.name, obj.name, index)
    sight = see(
        target, [held_by], random_room(child_rng(seed, "room", *names), X_WC, table=False), X_WC=X_WC,
        intrinsics=intrinsics, hard=True, seed=child_seed(seed, "sensor", *names),
    )  # fmt: skip
    X_CO, X_CH_true = np.linalg.inv(X_WC) @ target.X_WB, np.linalg.inv(X_WC) @ held_by.X_WB
    X_CH = X_CH_true @ _small_motion(rng)
    X_HO = np.linalg.inv(grasps.X_OH[index])
    touches = np.isfinite(grasps.contact_points_O[index]).all(axis=1)
    points = transform_points_np(X_CH @ X_HO, grasps.contact_points_O[index][touches])
    return HeldScene(
        object=obj.name, hand=hand.name, grasp=index, q=grasps.q[index], depth=sight.depth,
        intrinsics=intrinsics, mask=sight.mask, true_mask=sight.true_mask, X_WC=X_WC, X_CO_true=X_CO,
        X_CH_true=X_CH_true, X_CH=X_CH,
        contact_points_C=points + rng.standard_normal(points.shape) * CONTACT_M / np.sqrt(3.0),
        contact_normals_C=grasps.contact_normals_O[index][touches] @ (X_CH @ X_HO)[:3, :3].T,
        visible_share=sight.visible_share, seed=seed,
    )  # fmt: skip


def _small_motion(rng: np.random.Generator) -> np.ndarray:
    """(4, 4) rigid motion of 2 mm and 1 degree, root mean square."""
    turn, shift = rng.standard_normal((2, 3)) / np.sqrt(3.0)
    R = Rotation.from_rotvec(np.deg2rad(CALIBRATION_DEG) * turn).as_matrix()
    return make_transform_np(R, CALIBRATION_M * shift)
