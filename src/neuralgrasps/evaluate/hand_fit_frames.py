"""Frames of people's hands that hold objects, with everything known: what fits of a hand are measured on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from neuralgrasps.geometry.camera import Intrinsics, look_at
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.hands.surface import hand_mesh
from neuralgrasps.human.forearm import ForearmSize, tapered_mesh
from neuralgrasps.human.skeleton import joint_points
from neuralgrasps.human.synthetic.person_grasps import PersonGrasps, person_grasps, table_frame
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame
from neuralgrasps.planning.resting_plane import resting_planes
from neuralgrasps.seeds import child_rng, child_seed
from neuralgrasps.sim.camera import STRUCTURED_LIGHT, DepthNoise, render_depth_view

SIZES = (0.68, 0.74, 0.82, 0.90)  # few, since grasps are made for each
CAMERA = Intrinsics(600.0, 600.0, 319.5, 239.5, 640, 480)
_WRONG_SHARE = 0.05  # of the mask's pixels: taken from just outside it
_RIM_PX = 6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HandFrame:
    """One frame of a right hand that holds an object on a table, and the truth.

    Attributes:
        frame: what the camera measured; mask: (h, w) bool, the hand's pixels as a program might find them; true_depth:
            (h, w) without noise, true_mask.
        X_CH (4, 4), q (20,), scale, joints_C (21, 3): the hand; obj, X_CO: what it holds.
        visible: share of the hand's pixels that nothing hides.
    """

    frame: Frame
    mask: np.ndarray
    true_depth: np.ndarray
    true_mask: np.ndarray
    X_CH: np.ndarray
    q: np.ndarray
    scale: float
    joints_C: np.ndarray
    obj: ObjectModel
    X_CO: np.ndarray
    visible: float


def hand_frames(
    objects: Sequence[ObjectModel], *, count: int, seed: int, views: int = 1, noise: DepthNoise = STRUCTURED_LIGHT
) -> Iterator[HandFrame]:
    """`count` people of different sizes, one grasp each, seen from `views` sides; the objects take turns.

    The camera is 0.5 to 0.9 m away, 5 to 75 degrees over the table, at any azimuth. The mask is the true one, grown or
    shrunk by up to a pixel, with 5 % of its pixels from the rim around it.
    """
    for i in range(count):
        obj, rng = objects[i % len(objects)], child_rng(seed, "hand frame", i)
        scale, plane_O = float(rng.choice(SIZES)), resting_planes(obj)[0]
        made = person_grasps(obj, scale=scale, plane_O=plane_O, count=4, seed=seed)
        if not len(made.grasps):
            continue
        row = int(rng.integers(len(made.grasps)))
        for view in range(views):
            yield _frame(obj, plane_O, made, row, scale, child_seed(seed, "view", i, view), noise)


def _frame(
    obj: ObjectModel, plane_O: Plane, made: PersonGrasps, row: int, scale: float, seed: int, noise: DepthNoise
) -> HandFrame:
    rng = child_rng(seed, "camera")
    X_WO, X_OH, q = table_frame(plane_O), made.grasps.X_OH[row], made.grasps.q[row]
    X_WH, size = X_WO @ X_OH, ForearmSize.of(scale)
    joints_W = joint_points(made.hand, X_WH, q)
    arm = tapered_mesh(np.zeros(3), size.length_m * made.forearm_H[row], size.wrist_m, size.elbow_m)
    target = joints_W.mean(axis=0)
    tilt, azimuth, far = np.radians(rng.uniform(5, 75)), rng.uniform(0, 2 * np.pi), rng.uniform(0.5, 0.9)
    eye = target + far * np.array([np.cos(tilt) * np.cos(azimuth), np.cos(tilt) * np.sin(azimuth), np.sin(tilt)])
    X_WC = look_at(eye, target + rng.uniform(-0.05, 0.05, 3))
    X_CW = np.linalg.inv(X_WC)
    meshes = [hand_mesh(made.hand, q), obj.mesh, arm, box_mesh((0.8, 0.8, 0.01))]
    X_table = np.eye(4)
    X_table[2, 3] = -0.01
    X_WM = np.stack([X_WH, X_WO, X_WH, X_table])
    exact = render_depth_view(meshes, X_WM, X_WC=X_WC, intrinsics=CAMERA)
    seen = render_depth_view(meshes, X_WM, X_WC=X_WC, intrinsics=CAMERA, noise=noise, seed=seed)
    alone = render_depth_view(meshes[:1], X_WM[:1], X_WC=X_WC, intrinsics=CAMERA)
    true_mask = exact.mesh_index == 0
    X_CH = X_CW @ X_WH
    return HandFrame(
        frame=Frame(seen.depth, CAMERA),
        mask=_found_mask(true_mask, child_rng(seed, "mask")),
        true_depth=exact.depth,
        true_mask=true_mask,
        X_CH=X_CH,
        q=q,
        scale=scale,
        joints_C=joint_points(made.hand, X_CH, q),
        obj=obj,
        X_CO=X_CW @ X_WO,
        visible=float(true_mask.sum() / max((alone.mesh_index == 0).sum(), 1)),
    )


def _found_mask(true: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A mask as a program finds it: a pixel too large or too small, with wrong pixels of its rim."""
    change = int(rng.integers(-1, 2))
    mask = grown(true, change) if change > 0 else ~grown(~true, -change)
    rim = np.flatnonzero((grown(true, _RIM_PX) & ~true).ravel())
    wrong = rng.choice(rim, size=min(len(rim), int(_WRONG_SHARE * true.sum())), replace=False)
    out = mask.ravel().copy()
    out[wrong] = True
    return out.reshape(true.shape)


def grown(mask: np.ndarray, pixels: int) -> np.ndarray:
    """A mask with every pixel within so many steps along rows or columns of one of its own."""
    out = mask
    for _ in range(pixels):
        out = out | np.roll(out, 1, 0) | np.roll(out, -1, 0) | np.roll(out, 1, 1) | np.roll(out, -1, 1)
    return out
