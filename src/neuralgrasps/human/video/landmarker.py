"""Hand joints by a landmark model that the user gives (a MediaPipe `.task` file); that library is optional."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from neuralgrasps.errors import InputError, NeuralGraspsError
from neuralgrasps.human.seen import SeenJoints, Side
from neuralgrasps.human.skeleton import NUM_JOINTS
from neuralgrasps.human.video.lift import PictureJoints, lift_video
from neuralgrasps.perception.frame import Frame

_HANDS = 2  # looked for in a frame


class LandmarkerMissingError(NeuralGraspsError, ImportError):
    """A landmark model is to be used and the library that runs it is not installed."""


def landmark_joints(
    frames: Sequence[Frame], task: str | Path, *, side: Side | None = None, scale: float | None = None
) -> list[SeenJoints | None]:
    """The joints that a landmark model sees in the colour images, lifted to metres with the depth images.

    Args:
        frames: with colour, registered to depth.
        task: the model, a hand landmarker's `.task` file.
        side: of the hand, where known. The model's own word is a hint only: versions differ on whether they take the
            image for a mirrored one.
        scale: of the hand; None: estimated.
    Returns:
        One entry per frame; None where no hand is seen. Of two hands the surer one.
    Raises:
        LandmarkerMissingError: the library is not installed.
        InputError: no such file, one that is no hand landmarker, or frames without colour.
    """
    task = Path(task)
    if not task.is_file():
        raise InputError(f"landmark model '{task}' does not exist; expected a hand landmarker's .task file.")
    bare = next((f.name for f in frames if f.colour is None), None)
    if bare is not None:
        raise InputError(f"frame '{bare}' has no colour image, which a landmark model needs; add rgb/NAME.png.")
    library = _library()
    with _landmarker(library, task) as landmarker:
        found = [_picture_joints(landmarker, library, frame, task.name, side) for frame in frames]
    return lift_video(found, frames, scale=scale)


def _library() -> Any:
    try:
        return import_module("mediapipe")
    except ImportError as error:
        raise LandmarkerMissingError(
            "a landmark model needs the package mediapipe, which is not installed: `pip install mediapipe`. Or run it "
            "elsewhere and give its joints as a JSON file (--joints), or use the built-in joint net."
        ) from error


def _landmarker(library: Any, task: Path) -> Any:
    vision = library.tasks.vision
    options = vision.HandLandmarkerOptions(
        base_options=library.tasks.BaseOptions(model_asset_path=str(task)),
        running_mode=vision.RunningMode.IMAGE,
        num_hands=_HANDS,
    )
    try:
        return vision.HandLandmarker.create_from_options(options)
    except (RuntimeError, ValueError, OSError) as error:
        raise InputError(f"'{task}' cannot be used as a hand landmarker: {error}.") from error


def _picture_joints(
    landmarker: Any, library: Any, frame: Frame, source: str, side: Side | None
) -> PictureJoints | None:
    assert frame.colour is not None
    image = library.Image(image_format=library.ImageFormat.SRGB, data=np.ascontiguousarray(frame.colour))
    result = landmarker.detect(image)
    if not result.hand_landmarks:
        return None
    sure = [hand[0].score if hand else 0.0 for hand in result.handedness]
    best = int(np.argmax(sure)) if sure else 0
    k = frame.intrinsics
    values = np.array([[p.x * k.width, p.y * k.height, p.z * k.width] for p in result.hand_landmarks[best]])
    if values.shape != (NUM_JOINTS, 3):
        raise InputError(f"'{source}' gives {len(values)} landmarks per hand; expected {NUM_JOINTS}.")
    return PictureJoints(
        pixels=values[:, :2], relative=values[:, 2], score=np.full(NUM_JOINTS, max(sure[best] if sure else 1.0, 0.3)),
        side=side or "right", side_known=side is not None, source=source,
    )  # fmt: skip
