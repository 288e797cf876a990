"""Pictures of arms with a hand."""

from __future__ import annotations

import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.hands.hand import ConvexPart
from neuralgrasps.hands.parts import part_mesh
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.report.palette import linear_rgb
from neuralgrasps.report.shading import Style, Surface, shade
from neuralgrasps.report.views import frame_camera, view_direction

SIZE = (480, 480)
_LIGHT, _DARK = "#e9e8e4", "#4d545e"  # links of files without colours, by turns


def render_arm(
    manipulator: Manipulator,
    q: np.ndarray | None = None,
    *,
    size: tuple[int, int] = SIZE,
    view: np.ndarray | None = None,
    close: bool = False,
) -> np.ndarray:
    """Picture of an arm with its hand, in the colours of their files.

    Args:
        q: (Q,) all joints; at home, the hand open, when None.
        size: width and height, pixels.
        view: (3,) direction towards the camera in B; from the front and the side when None.
        close: only the hand and the last links of the arm.
    Returns:
        (height, width, 4) uint8 RGBA, transparent background.
    """
    X_BL = forward_fast(manipulator.tree, manipulator.q_home if q is None else q)
    shown = _wrist_links(manipulator) if close else None
    surfaces = [
        Surface(
            mesh=part_mesh(p).transformed(X_BL[p.link]),
            colour=_colour(p),
            gloss=0.3,
            caster=part_mesh(p, segments=12).transformed(X_BL[p.link]),
        )
        for p in manipulator.parts
        if shown is None or p.link in shown
    ]
    points = np.concatenate([s.mesh.vertices for s in surfaces])
    X_BC, intrinsics = frame_camera(points, view_direction(-50, 16) if view is None else view, size)
    return shade(surfaces, X_BC, intrinsics, style=Style())


def _wrist_links(manipulator: Manipulator, count: int = 3) -> set[int]:
    """The hand's links and the last `count` of the arm that have a shape."""
    shaped = {p.link for p in manipulator.parts}
    links, link = {i for i in shaped if i >= manipulator.hand_link}, manipulator.arm.flange
    while link >= 0 and count:
        count -= link in shaped
        links.add(link)
        link = int(manipulator.tree.parents[link])
    return links


def _colour(part: ConvexPart) -> np.ndarray:
    if part.colour is None:
        return linear_rgb(_DARK if part.link % 2 else _LIGHT)
    return linear_rgb("#" + "".join(f"{round(255 * c):02x}" for c in part.colour[:3]))
