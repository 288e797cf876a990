"""Fixtures of the tests that watch a hand: a small video of a grasp, and eyes that know the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from neuralgrasps.geometry.camera import Intrinsics, look_at, project
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.primitives import box_mesh, cylinder_mesh
from neuralgrasps.grasps.grasp_io import load_grasps
from neuralgrasps.hands.surface import hand_mesh
from neuralgrasps.hands.variants import mirror_matrix, scaled_hand
from neuralgrasps.human.seen import HandBox, SeenJoints
from neuralgrasps.human.skeleton import human_hand, joint_points
from neuralgrasps.model.run_notes import run_folder
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.zoo import load_object
from neuralgrasps.perception.frame import Frame
from neuralgrasps.sim.camera import STRUCTURED_LIGHT, render_depth_view

SCALE = 0.8
CAMERA = Intrinsics(307.0, 307.0, 159.5, 119.5, 320, 240)
STILL_FROM = 9
_START, _GRASP = 3, 12  # first frame with a hand; which of the stored grasps
_FOREARM, _TABLE = 0.035, 0.6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GraspVideo:
    """A right hand comes in `_START`, closes round a can until `STILL_FROM`, and stays.

    Attributes:
        frames: (T,). X_CO: (T, 4, 4). joints_C: (T, 21, 3), nan without a hand. masks: (T, h, w) pixels of the hand.
        X_CH: (T, 4, 4), q: (T, 20). table_up: (3,) in the camera.
    """

    frames: list[Frame]
    obj: ObjectModel
    X_CO: np.ndarray
    joints_C: np.ndarray
    masks: np.ndarray
    X_CH: np.ndarray
    q: np.ndarray

    def surface_error(self, track: object) -> float:
        """Root mean square distance of the mesh's points between a track's grasp and the truth, metres."""
        k, fitted = track.moment, track.grasp
        true = hand_mesh(scaled_hand(human_hand(), SCALE), self.q[k], segments=8).vertices
        found = hand_mesh(fitted.hand, fitted.q, segments=8).vertices
        apart = (true @ self.X_CH[k, :3, :3].T + self.X_CH[k, :3, 3]) - (
            found @ fitted.X_CH[:3, :3].T + fitted.X_CH[:3, 3]
        )
        return float(np.sqrt((apart**2).sum(axis=1).mean()))

    def mirrored(self) -> GraspVideo:
        """The same seen in a mirror: a left hand. The can is its own image."""
        flip = np.array([-1.0, 1.0, 1.0])
        F, S = np.diag([-1.0, 1.0, 1.0, 1.0]), mirror_matrix(human_hand())
        frames = [
            replace(f, depth=f.depth[:, ::-1].copy(), intrinsics=replace(CAMERA, cx=CAMERA.width - 1 - CAMERA.cx))
            for f in self.frames
        ]
        return replace(
            self, frames=frames, X_CO=F @ self.X_CO @ np.diag([-1.0, 1.0, 1.0, 1.0]), joints_C=self.joints_C * flip,
            masks=self.masks[:, :, ::-1].copy(), X_CH=F @ self.X_CH @ S,
        )  # fmt: skip


@dataclass(slots=True, kw_only=True, eq=False)
class TrueEyes:
    """Detector and reader that know the truth and add errors: of boxes, joints (common and by frame) and mask.

    Attributes:
        side: of the video's hand; said: what the boxes say; sure: how surely. Read for the other side, joints are
            mirrored, as by a net for right hands.
        stretch: x and y of joints are divided by it, as by a camera with so many times the true focal length.
    """

    video: GraspVideo
    side: str = "right"
    said: str = "right"
    sure: float = 0.95
    noise_m: float = 0.005
    stretch: float = 1.0
    reads: int = 0

    def find(self, frame: Frame) -> list[HandBox]:
        joints = self.video.joints_C[int(frame.name)]
        if not np.isfinite(joints).all():
            return []
        pixels = project(joints, self.video.frames[0].intrinsics)
        low, high = pixels.min(axis=0) - 8, pixels.max(axis=0) + 8
        return [HandBox(u_min=low[0], v_min=low[1], u_max=high[0], v_max=high[1], score=0.9, side=self.said,
                        side_score=self.sure)]  # fmt: skip

    def read(self, frame: Frame, box: HandBox) -> SeenJoints:
        self.reads += 1
        number = int(frame.name)
        common, own = np.random.default_rng(1), np.random.default_rng([2, number])
        points = self.video.joints_C[number] + self.noise_m * (common.normal(size=(21, 3)) + own.normal(size=(21, 3)))
        if box.side != self.side:
            points = points.mean(axis=0) + (points - points.mean(axis=0)) * [-1.0, 1.0, 1.0]
        mask = self.video.masks[number] & (own.random(self.video.masks[number].shape) < 0.9)
        points = points * [1.0 / self.stretch, 1.0 / self.stretch, 1.0]
        return SeenJoints(points_C=points, weight=np.full(21, 0.8), mask=mask, side=box.side, source="truth")


def _film(
    obj: ObjectModel,
    X_OH: np.ndarray,
    q_grasp: np.ndarray,
    count: int,
    *,
    drift: tuple[float, float, float] | None = None,
) -> GraspVideo:
    """`drift`: the camera moves so far in the world in every frame, and the frames say where it is."""
    hand = scaled_hand(human_hand(), SCALE)
    eyes = np.array([0.28, 0.42, 0.35]) + np.arange(count)[:, None] * (drift or (0.0, 0.0, 0.0))
    X_WC = np.stack([look_at(eye, np.array([0.0, 0.0, 0.03])) for eye in eyes])
    X_CW, X_WT, X_HF = np.linalg.inv(X_WC), np.eye(4), np.eye(4)
    X_WT[2, 3] = obj.mesh.bounds[0, 2] - 0.02
    X_HF[:3, :3], X_HF[0, 3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], 0.12  # behind the wrist, along its x
    table, forearm = box_mesh([_TABLE, _TABLE, 0.02]), cylinder_mesh(_FOREARM, 0.11)
    away = X_OH[:3, 3] / np.linalg.norm(X_OH[:3, 3]) + [0.0, 0.0, 0.3]
    frames, X_CH, qs, masks = [], np.full((count, 4, 4), np.nan), np.zeros((count, 20)), []
    for k in range(count):
        part = np.clip((k - _START) / (STILL_FROM - _START), 0.0, 1.0)
        X, closed = X_OH.copy(), np.clip((part - 0.6) / 0.4, 0.0, 1.0)
        X[:3, 3] += away * 0.25 * (1.0 - part)
        qs[k] = (1.0 - closed) * hand.q_open + closed * q_grasp
        meshes, poses = [table, obj.mesh], [X_WT, np.eye(4)]
        if k >= _START:
            meshes += [hand_mesh(hand, qs[k], segments=12), forearm]
            poses += [X, X @ X_HF]
            X_CH[k] = X_CW[k] @ X
        view = render_depth_view(
            meshes, np.stack(poses), X_WC=X_WC[k], intrinsics=CAMERA, noise=STRUCTURED_LIGHT, seed=100 + k
        )
        said = None if drift is None else X_WC[k]
        frames.append(Frame(depth=view.depth, intrinsics=CAMERA, X_WC=said, name=f"{k:06d}"))
        masks.append(view.mesh_index == 2)
    return GraspVideo(
        frames=frames, obj=obj, X_CO=X_CW, joints_C=joint_points(hand, X_CH, qs),
        masks=np.stack(masks), X_CH=X_CH, q=qs,
    )  # fmt: skip


def _filmed(make_object: Callable[..., ObjectModel], **more: tuple[float, float, float]) -> GraspVideo:
    can = load_object("tomato_soup_can").mesh
    grasps = load_grasps(run_folder("standins7") / "grasps" / "tomato_soup_can" / "human.safetensors")
    X_OH = grasps.X_OH[_GRASP].copy()
    X_OH[:3, 3] *= SCALE  # hand and can are made smaller alike
    smaller = make_object("can", Mesh(SCALE * can.vertices, can.faces), cells=40, points=512)
    return _film(smaller, X_OH, grasps.q[_GRASP], 24, **more)


@pytest.fixture(scope="session")
def grasp_video(make_object: Callable[..., ObjectModel]) -> GraspVideo:
    """24 frames, 320 x 240; do not change its arrays."""
    return _filmed(make_object)


@pytest.fixture(scope="session")
def moving_video(make_object: Callable[..., ObjectModel]) -> GraspVideo:
    """The same, by a camera that moves by 15 mm a frame, and says so; do not change its arrays."""
    return _filmed(make_object, drift=(-0.012, 0.006, 0.007))


@pytest.fixture
def true_eyes() -> type[TrueEyes]:
    """The class `TrueEyes`."""
    return TrueEyes
