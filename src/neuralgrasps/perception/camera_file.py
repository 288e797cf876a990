"""Camera intrinsics from JSON files, as cameras and data sets write them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import Intrinsics

# Names a 3 x 3 camera matrix goes by.
_MATRICES = ("cam_K", "K", "camera_matrix", "intrinsic_matrix", "intrinsics", "color", "colour", "depth", "camera")


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraNumbers:
    """A camera whose image size may still be unknown.

    Attributes:
        fx: focal length, pixels; fy: None for the same; cx, cy: principal point, None for the middle of the image.
        width, height: of its images, when known.
        units_per_metre: of its depth images, when known.
    """

    fx: float
    fy: float | None = None
    cx: float | None = None
    cy: float | None = None
    width: int | None = None
    height: int | None = None
    units_per_metre: float | None = None

    def of_size(self, width: int, height: int, what: str) -> Intrinsics:
        """The camera of an image `what` of that size.

        Raises:
            InputError: the camera's images are of another size.
        """
        known = (self.width or width, self.height or height)
        if known != (width, height):
            raise InputError(
                f"{what} is {width} x {height} pixels but the camera's images are {known[0]} x {known[1]}. Scale the "
                "intrinsics to the image, or give those of this camera mode."
            )
        return Intrinsics(
            self.fx,
            self.fx if self.fy is None else self.fy,
            0.5 * (width - 1) if self.cx is None else self.cx,
            0.5 * (height - 1) if self.cy is None else self.cy,
            width,
            height,
        )


def read_camera(path: Path) -> CameraNumbers:
    """Intrinsics of a JSON file: fx, fy, cx, cy, or a 3 x 3 matrix, rows or columns first, alone or under its name.

    `depth_scale` may be units per metre (1000), millimetres per unit (BOP: 0.1, 1) or metres per unit (0.001); which
    one, its size tells: from 50 up, below 0.02, and between.

    Raises:
        InputError: missing, not JSON, or no intrinsics in it.
    """
    try:
        data = json.loads(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"camera file '{path}' does not exist.") from None
    except (OSError, ValueError) as error:
        raise InputError(f"camera file '{path}' is not JSON: {error}.") from error
    try:
        return camera_from(data)
    except (InputError, TypeError, ValueError, KeyError) as error:
        raise InputError(
            f"camera file '{path}' holds no intrinsics ({error}); expected fx, fy, cx, cy in pixels, or a 3 x 3 matrix "
            "K."
        ) from error


def camera_from(data: Any) -> CameraNumbers:
    """Intrinsics of what a JSON file holds; see `read_camera`."""
    if isinstance(data, list):
        return _of_matrix(data, {})
    if not isinstance(data, dict):
        raise InputError(f"it is a {type(data).__name__}")
    if "fx" in data:
        numbers = {name: float(data[name]) for name in ("fx", "fy", "cx", "cy") if name in data}
        if "ppx" in data and "ppy" in data:
            numbers |= {"cx": float(data["ppx"]), "cy": float(data["ppy"])}
        return CameraNumbers(**numbers, **_rest(data))  # type: ignore[arg-type]
    for name in _MATRICES:
        inner = data.get(name)
        if isinstance(inner, dict):
            return camera_from({**{k: v for k, v in data.items() if k in ("width", "height", "depth_scale")}, **inner})
        if isinstance(inner, list):
            return _of_matrix(inner, data)
    raise InputError(f"its names are {', '.join(map(str, list(data)[:8])) or 'none'}")


def _of_matrix(matrix: list[Any], data: dict[str, Any]) -> CameraNumbers:
    K = np.array(matrix, np.float64)
    if K.size != 9:
        raise InputError(f"its matrix has {K.size} numbers")
    K = K.reshape(3, 3)
    K = K.T if np.allclose(K[:2, 2], 0.0) else K  # columns first
    if not np.allclose(K[2], [0, 0, 1]) or abs(K[1, 0]) > 1e-6:
        raise InputError(f"its matrix is {K.tolist()}")
    return CameraNumbers(fx=K[0, 0], fy=K[1, 1], cx=K[0, 2], cy=K[1, 2], **_rest(data))


def _rest(data: dict[str, Any]) -> dict[str, Any]:
    out: dict[str, Any] = {name: int(data[name]) for name in ("width", "height") if name in data}
    if "depth_scale" in data:
        out["units_per_metre"] = units_per_metre(float(data["depth_scale"]))
    return out


def units_per_metre(depth_scale: float) -> float:
    """Units per metre from any of the three meanings of a `depth_scale`; see `read_camera`."""
    if not depth_scale > 0:
        raise InputError(f"depth_scale is {depth_scale}; expected a number above 0.")
    if depth_scale >= 50:
        return depth_scale
    return 1000.0 / depth_scale if depth_scale >= 0.02 else 1.0 / depth_scale
