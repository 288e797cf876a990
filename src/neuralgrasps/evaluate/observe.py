"""What a sensor sees of a grasping hand: points on its whole surface, or those one depth camera sees."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from neuralgrasps.dataset.hand_surface import sample_posed_surface
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import Intrinsics, look_at, pixel_rays
from neuralgrasps.geometry.raster import RasterImage, rasterise
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import PackedHand
from neuralgrasps.hands.surface import hand_mesh
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.seeds import child_rng

CAMERA = Intrinsics(600.0, 600.0, 319.5, 239.5, 640, 480)
DISTANCE_M = 0.6
MIN_PIXELS = 200
BOX_MARGIN_M = 0.05
_TRIES = 64


def observe_hand(
    packed: PackedHand,
    X_OH: np.ndarray,
    q: np.ndarray,
    *,
    seed: int,
    points: int = 1024,
    noise_m: float = 0.0,
) -> np.ndarray:
    """Points on the whole surface of one posed hand, uniform by area.

    Args:
        X_OH: (4, 4) hand base in the object frame, metres; q: (J,) joints.
        seed: with the grasp itself it determines the points. noise_m: standard deviation added to each coordinate.
    Returns:
        (points, 3) float64, object frame, metres.
    """
    rng = _grasp_rng(seed, "whole surface", X_OH, q)
    cloud = sample_posed_surface(packed, X_OH, q, points, rng)
    return cloud + rng.normal(scale=noise_m, size=cloud.shape) if noise_m > 0 else cloud


@dataclass(frozen=True, slots=True, kw_only=True)
class HandView:
    """What one depth camera sees of a hand.

    Attributes:
        points_O: (M, 3) float64 hand points, object frame, metres.
        viewpoint_O: (3,) float64 centre of the camera.
    """

    points_O: np.ndarray
    viewpoint_O: np.ndarray


def observe_hand_one_view(
    hand: Hand,
    obj: ObjectModel,
    X_OH: np.ndarray,
    q: np.ndarray,
    *,
    seed: int,
    noise_m: float = 0.001,
    points: int = 1024,
) -> np.ndarray:
    """The points (M <= points, 3) of `view_hand`."""
    return view_hand(hand, obj, X_OH, q, seed=seed, noise_m=noise_m, points=points).points_O


def view_hand(
    hand: Hand,
    obj: ObjectModel,
    X_OH: np.ndarray,
    q: np.ndarray,
    *,
    seed: int,
    noise_m: float = 0.001,
    points: int = 1024,
    spill: float = 0.0,
) -> HandView:
    """Hand points that one depth camera sees, the object and the hand itself in the way.

    The camera is `DISTANCE_M` from the middle of the hand, in a random direction; directions that show
    fewer than `MIN_PIXELS` pixels of the hand are drawn again.

    Args:
        X_OH: (4, 4) hand base in the object frame, metres; q: (J,) joints.
        seed: with the grasp itself it determines the direction and the noise.
        noise_m: standard deviation of the depth along each pixel's ray. points: at most so many, a random subset.
        spill: share of the points that are not the hand's but of visible object, as of a mask that is too wide; less
            where less of the object is seen.
    Raises:
        InputError: the hand is hidden from all directions tried.
    """
    rng = _grasp_rng(seed, "one view", X_OH, q)
    mesh = hand_mesh(hand, np.asarray(q, np.float64))
    X_OH = np.asarray(X_OH, np.float64)
    middle_O = X_OH[:3, :3] @ mesh.bounds.mean(axis=0) + X_OH[:3, 3]
    rays_C = pixel_rays(CAMERA)
    for _ in range(_TRIES):
        direction = rng.normal(size=3)
        X_OC = look_at(middle_O + DISTANCE_M * direction / np.linalg.norm(direction), middle_O)
        X_CO = np.linalg.inv(X_OC)
        image = rasterise([obj.mesh, mesh], np.stack([X_CO, X_CO @ X_OH]), CAMERA)
        seen = image.mesh_index == 1
        if seen.sum() < MIN_PIXELS:
            continue
        points_C = rays_C[seen] * image.depth[seen][:, None].astype(np.float64)
        chosen = np.sort(rng.permutation(len(points_C))[:points])
        points_C = points_C[chosen]
        if spill > 0.0:
            points_C = _spilled(points_C, rays_C, image, spill, rng)
        far = np.linalg.norm(points_C, axis=1, keepdims=True)
        points_C *= 1.0 + rng.normal(scale=noise_m, size=far.shape) / far if noise_m > 0 else 1.0
        return HandView(points_O=points_C @ X_OC[:3, :3].T + X_OC[:3, 3], viewpoint_O=X_OC[:3, 3].copy())
    raise InputError(
        f"hand '{hand.name}' on '{obj.name}' is hidden: of {_TRIES} random views none shows {MIN_PIXELS} pixels of it."
    )


def with_outliers(cloud_O: np.ndarray, share: float, *, seed: int) -> np.ndarray:
    """A cloud (M, 3) with a share of its points replaced by others, uniform in its bounding box grown by 5 cm."""
    rng = child_rng(seed, "outliers", hashlib.sha256(cloud_O.tobytes()).hexdigest())
    out = cloud_O.copy()
    lost = rng.permutation(len(out))[: round(share * len(out))]
    out[lost] = rng.uniform(out.min(axis=0) - BOX_MARGIN_M, out.max(axis=0) + BOX_MARGIN_M, (len(lost), 3))
    return out


def with_pose_error(
    cloud_O: np.ndarray, shift_m: float, turn_rad: float, *, centre_O: np.ndarray, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """A cloud (M, 3) in the frame of an object whose pose is off in a random direction, and that frame (4, 4).

    The object is believed to be shifted by `shift_m`, and turned by `turn_rad` about `centre_O`.
    """
    rng = child_rng(seed, "pose error", hashlib.sha256(cloud_O.tobytes()).hexdigest())
    shift, axis = rng.normal(size=(2, 3))
    R = Rotation.from_rotvec(turn_rad * axis / np.linalg.norm(axis)).as_matrix()
    X = np.eye(4)
    X[:3, :3] = R
    X[:3, 3] = centre_O - R @ centre_O + shift_m * shift / np.linalg.norm(shift)
    return cloud_O @ R.T + X[:3, 3], X


def _spilled(
    points_C: np.ndarray, rays_C: np.ndarray, image: RasterImage, share: float, rng: np.random.Generator
) -> np.ndarray:
    """Hand points, a share of them replaced by points of the object."""
    mine = image.mesh_index == 0
    other_C = rays_C[mine] * image.depth[mine][:, None].astype(np.float64)
    count = min(round(share * len(points_C)), len(other_C))
    out = points_C.copy()
    out[rng.permutation(len(out))[:count]] = other_C[rng.permutation(len(other_C))[:count]]
    return out


def _grasp_rng(seed: int, what: str, X_OH: np.ndarray, q: np.ndarray) -> np.random.Generator:
    grasp = np.concatenate([np.asarray(X_OH, np.float64).ravel(), np.asarray(q, np.float64).ravel()])
    return child_rng(seed, what, hashlib.sha256(grasp.tobytes()).hexdigest())
