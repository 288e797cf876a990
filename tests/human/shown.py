"""A small made-up video: an object on a table, and a person's hand that comes from the left and rests at its side."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from neuralgrasps.geometry.camera import Intrinsics, look_at
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.geometry.raster import rasterise
from neuralgrasps.hands.surface import hand_part_meshes
from neuralgrasps.hands.variants import scaled_hand
from neuralgrasps.human.seen import FittedHand, HandBox, SeenJoints
from neuralgrasps.human.skeleton import human_hand, joint_points
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame

CAMERA = Intrinsics(290.0, 290.0, 159.5, 119.5, 320, 240)
SCALE = 0.8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShownVideo:
    """Frames (T), and the truth of each; None in frames without a hand. X_CO (4, 4): the object in all of them."""

    frames: list[Frame]
    boxes: list[HandBox | None]
    seen: list[SeenJoints | None]
    fits: list[FittedHand | None]
    X_CO: np.ndarray


def shown_video(
    obj: ObjectModel,
    gaps_m: tuple[float | None, ...],
    *,
    colour: bool = False,
    eye: tuple[float, float, float] = (0.5, -0.35, 0.45),
) -> ShownVideo:
    """A frame for each gap between the palm and the object's side; None: no hand. `eye`: the camera in the world."""
    low = obj.mesh.vertices.min(axis=0)
    X_WO = np.eye(4)
    X_WO[2, 3] = -low[2]
    X_WC = look_at(np.array(eye), np.array([0.0, -0.02, -low[2]]))
    X_CO = np.linalg.inv(X_WC) @ X_WO
    table = box_mesh(np.array([0.6, 0.6, 0.01])).transformed(np.linalg.inv(X_WC) @ _shift([0.0, 0.0, -0.01]))
    video = ShownVideo(frames=[], boxes=[], seen=[], fits=[], X_CO=X_CO)
    for index, gap in enumerate(gaps_m):
        fitted = None if gap is None else _hand_beside(obj, X_CO, gap)
        parts = [] if fitted is None else hand_part_meshes(fitted.hand, fitted.q, segments=12)
        meshes = [table, obj.mesh.transformed(X_CO), *(p.transformed(fitted.X_CH) for p in parts if fitted)]
        image = rasterise(meshes, np.tile(np.eye(4), (len(meshes), 1, 1)), CAMERA)
        shade = np.array([[40, 42, 46], [150, 140, 120], [60, 90, 160], *([[190, 150, 130]] * len(parts))], np.uint8)
        video.frames.append(
            Frame(
                depth=np.where(np.isfinite(image.depth), image.depth, 0.0),
                intrinsics=CAMERA,
                X_WC=X_WC,
                colour=shade[image.mesh_index + 1] if colour else None,
                name=f"{index:06d}",
            )
        )
        mask = image.mesh_index >= 2
        video.fits.append(fitted)
        video.seen.append(None if fitted is None else _seen(fitted, mask))
        video.boxes.append(_box(mask) if mask.any() else None)
    return video


def write_video(folder: Path, video: ShownVideo) -> Path:
    """The frames as files, and the joints in metres; returns the file of these."""
    (folder / "depth").mkdir(parents=True)
    (folder / "pose").mkdir()
    for frame in video.frames:
        Image.fromarray(np.round(frame.depth * 1e4).astype(np.uint16)).save(folder / "depth" / f"{frame.name}.png")
        np.savetxt(folder / "pose" / f"{frame.name}.txt", frame.X_WC)
    k = CAMERA
    camera = {"fx": k.fx, "fy": k.fy, "cx": k.cx, "cy": k.cy, "width": k.width, "height": k.height}
    (folder / "camera.json").write_text(json.dumps(camera | {"depth_scale": 1e4}))
    joints = folder.parent / "joints.json"
    records = [None if s is None else {"joints_C": s.points_C.tolist(), "side": s.side} for s in video.seen]
    joints.write_text(json.dumps({"frames": records}))
    return joints


def _hand_beside(obj: ObjectModel, X_CO: np.ndarray, gap_m: float) -> FittedHand:
    """The palm faces the object's -y side, fingers half closed."""
    hand = scaled_hand(human_hand("right"), SCALE)
    X_OP = _shift([0.0, obj.mesh.vertices[:, 1].min() - gap_m, 0.0])
    z, x = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    X_OP[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    q = 0.45 * hand.tree.upper + 0.55 * hand.q_open
    X_CH = X_CO @ X_OP @ np.linalg.inv(hand.X_HP)
    return FittedHand(
        X_CH=X_CH, q=q, scale=SCALE, side="right", joints_C=joint_points(hand, X_CH, q), cloud_rms_m=0.002,
        joint_rms_m=0.005, penetration_m=0.0, confidence=0.9,
    )  # fmt: skip


def _seen(fitted: FittedHand, mask: np.ndarray) -> SeenJoints:
    return SeenJoints(points_C=fitted.joints_C, weight=np.ones(21), mask=mask, side="right", source="the test")


def _box(mask: np.ndarray) -> HandBox:
    v, u = np.nonzero(mask)
    return HandBox(
        u_min=float(u.min()), v_min=float(v.min()), u_max=float(u.max()), v_max=float(v.max()), score=0.9,
        side="right", side_score=0.9,
    )  # fmt: skip


def _shift(by: list[float]) -> np.ndarray:
    X = np.eye(4)
    X[:3, 3] = by
    return X
