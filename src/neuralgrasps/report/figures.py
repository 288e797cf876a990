"""Pictures of hands, objects, grasps, contact maps and depth images, as arrays ready for the page or a PNG file."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image
from scipy.spatial import KDTree

from neuralgrasps.errors import ShapeError
from neuralgrasps.files import write_whole
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.surface import hand_part_meshes
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.report.palette import (
    GRAPHITE,
    OBJECT_COLOUR,
    contact_colours,
    hand_colour,
    linear_rgb,
    linear_to_srgb,
    mix,
)
from neuralgrasps.report.shading import Style, Surface, shade
from neuralgrasps.report.views import best_direction, best_surface_direction, frame_camera, view_direction

SIZE = (480, 360)


def render_grasp(
    hand: Hand,
    obj: ObjectModel | Mesh,
    X_OH: np.ndarray,
    q: np.ndarray,
    *,
    size: tuple[int, int] = SIZE,
    view: np.ndarray | None = None,
    vertex_values: np.ndarray | None = None,
) -> np.ndarray:
    """Picture of a hand holding an object, the object upright along its own z.

    Args:
        hand: the hand; obj: the object, or any mesh (z up).
        X_OH: (4, 4) hand base in the object frame; q: (J,) joints.
        size: width and height, pixels.
        view: (3,) direction from the object towards the camera (object frame); the most telling one when None.
        vertex_values: (V,) in [0, 1] contact per vertex of the object's mesh, to colour it by; plain when None.
    Returns:
        (height, width, 4) uint8 RGBA, transparent background.
    Raises:
        ShapeError: `X_OH` or `q` holds more or less than one grasp, or `vertex_values` does not fit the mesh.
    """
    mesh = obj if isinstance(obj, Mesh) else obj.mesh
    hand_surfaces = posed_hand_surfaces(hand, X_OH, q)
    surfaces = [*hand_surfaces, object_surface(mesh, vertex_values)]
    if view is None:
        view = best_direction([s.caster or s.mesh for s in hand_surfaces], mesh)
    return _picture(surfaces, view, size)


def render_hand(
    hand: Hand, q: np.ndarray | None = None, *, size: tuple[int, int] = SIZE, view: np.ndarray | None = None
) -> np.ndarray:
    """Picture of a hand alone, fingers up: the palm's normal points at the sky.

    Args:
        q: (J,) joints; the open posture when None.
        view: (3,) direction towards the camera in the palm frame P (z out of the palm); three-quarter when None.
    Returns:
        (height, width, 4) uint8 RGBA.
    """
    surfaces = posed_hand_surfaces(hand, np.linalg.inv(hand.X_HP), hand.q_open if q is None else q)
    return _picture(surfaces, view_direction(-52, 24) if view is None else view, size)


def render_object(
    obj: ObjectModel | Mesh,
    *,
    vertex_values: np.ndarray | None = None,
    size: tuple[int, int] = SIZE,
    view: np.ndarray | None = None,
) -> np.ndarray:
    """Picture of an object, bare or coloured by a contact map.

    Args:
        obj: the object, or any mesh (z up).
        vertex_values: (V,) contact in [0, 1] per mesh vertex (see `values_at_vertices` for values at other points).
        view: (3,) direction towards the camera, object frame; when None the one that shows most contact.
    Returns:
        (height, width, 4) uint8 RGBA.
    """
    mesh = obj if isinstance(obj, Mesh) else obj.mesh
    surface = object_surface(mesh, vertex_values)
    if view is None:
        shown = vertex_values is not None
        view = best_surface_direction(mesh, np.asarray(vertex_values)) if shown else view_direction(35, 25)
    return _picture([surface], view, size)


def render_depth(depth: np.ndarray) -> np.ndarray:
    """(h, w, 3) uint8 picture of a depth image in metres, near light, far dark; no measurement in plain grey."""
    depth = np.asarray(depth, np.float64)
    if depth.ndim != 2:
        raise ShapeError(f"depth has shape {depth.shape}; expected (height, width).")
    valid = np.isfinite(depth) & (depth > 0)
    low, high = np.percentile(depth[valid], [1, 99]) if valid.any() else (1.0, 1.0)
    # even steps of 1 / depth: what is near, and measured best, gets most of the scale
    at = np.clip((1.0 / low - 1.0 / np.where(valid, depth, low)) / max(1.0 / low - 1.0 / high, 1e-6), 0, 1)
    stops = np.stack([linear_rgb(c) for c in ("#fbf3df", "#b9d3c8", "#5f9db0", "#2f5f8a", "#1c2f55")])
    colour = np.stack([np.interp(at, np.linspace(0, 1, 5), linear_to_srgb(stops[:, k])) for k in range(3)], -1)
    return np.round(np.where(valid[..., None], colour, 0.84) * 255).astype(np.uint8)


def posed_hand_surfaces(hand: Hand, X_OH: np.ndarray, q: np.ndarray) -> list[Surface]:
    """The hand's links in the object frame: fingers in the hand's colour, palm and other links in graphite."""
    X_OH, q = np.asarray(X_OH, np.float64), np.asarray(q, np.float64)
    X_OH = X_OH[0] if X_OH.shape == (1, 4, 4) else X_OH
    q = q[0] if q.ndim == 2 and len(q) == 1 else q
    if X_OH.shape != (4, 4) or q.ndim != 1:
        raise ShapeError(f"X_OH has shape {X_OH.shape} and q {q.shape}; one picture takes one grasp: (4, 4) and (J,).")
    hand.check_q(q)
    colour = linear_rgb(hand_colour(hand.name))
    finger_links = {link for finger in hand.fingers for link in finger.links}
    palm = mix(colour, linear_rgb(GRAPHITE), 0.86)
    return [
        Surface(
            mesh=mesh.transformed(X_OH),
            colour=colour if part.link in finger_links else palm,
            gloss=0.3,
            caster=coarse.transformed(X_OH),
        )
        for part, mesh, coarse in zip(
            hand.parts, hand_part_meshes(hand, q, segments=32), hand_part_meshes(hand, q, segments=12), strict=True
        )
    ]


def object_surface(mesh: Mesh, vertex_values: np.ndarray | None = None) -> Surface:
    """The object for a picture: plain plaster, or coloured by contact values (V,) in [0, 1]."""
    if vertex_values is None:
        return Surface(mesh=mesh, colour=linear_rgb(OBJECT_COLOUR), gloss=0.08)
    values = np.asarray(vertex_values, np.float64)
    if values.shape != (len(mesh.vertices),):
        raise ShapeError(f"vertex_values has shape {values.shape}; the mesh has {len(mesh.vertices)} vertices.")
    return Surface(mesh=mesh, colour=contact_colours(values), gloss=0.03)


def render_contact_map(
    obj: ObjectModel, values: np.ndarray, *, size: tuple[int, int] = SIZE, view: np.ndarray | None = None
) -> np.ndarray:
    """Picture of an object coloured by a contact map.

    Args:
        values: (P,) contact in [0, 1] at `obj.points_O`.
        view: (3,) direction towards the camera, object frame; when None the one that shows most contact.
    Returns:
        (height, width, 4) uint8 RGBA.
    """
    mesh = fine_mesh(obj.mesh)
    vertex_values = values_at_vertices(mesh, obj.points_O, values)
    return render_object(mesh, vertex_values=vertex_values, size=size, view=view)


def values_at_vertices(mesh: Mesh, points_O: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (V,) at a mesh's vertices from values (P,) at surface points: smooth mean of the eight nearest.

    Sparse meshes (a box has eight vertices) cannot show a contact map: see `fine_mesh`.
    """
    points_O, values = np.asarray(points_O, np.float64), np.asarray(values, np.float64)
    if values.shape != (len(points_O),):
        raise ShapeError(f"values has shape {values.shape}; expected ({len(points_O)},), one per point.")
    count = min(8, len(points_O))
    distance, index = KDTree(points_O).query(mesh.vertices, k=count)
    distance, index = distance.reshape(-1, count), index.reshape(-1, count)
    scale = np.median(distance[:, -1]) * 0.6 + 1e-9
    weight = np.exp(-((distance - distance[:, :1]) * (distance + distance[:, :1])) / scale**2)
    return (values[index] * weight).sum(axis=1) / weight.sum(axis=1)


def fine_mesh(mesh: Mesh, *, longest_edge_m: float = 0.005) -> Mesh:
    """The same surface with no edge longer than `longest_edge_m`, so that values at its vertices can be seen."""
    fine = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, longest_edge_m, max_iter=12)
    return Mesh(fine[0], np.asarray(fine[1], np.int32))


def save_picture(path: str | Path, image: np.ndarray, *, background: str | None = None) -> None:
    """Write a picture as a PNG file, on `background` ("#rrggbb") or transparent.

    Raises:
        StorageError: missing or read-only folder, full disk, no permission.
    """
    picture = Image.fromarray(image)
    if background is not None and picture.mode == "RGBA":
        plain = Image.new("RGBA", picture.size, background)
        plain.alpha_composite(picture)
        picture = plain.convert("RGB")
    stream = io.BytesIO()
    picture.save(stream, "PNG", optimize=True)
    write_whole(path, stream.getvalue(), make_folder=False)


def _picture(surfaces: Sequence[Surface], view: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    points = np.concatenate([s.mesh.vertices for s in surfaces])
    X_WC, intrinsics = frame_camera(points, view, size)
    return shade(surfaces, X_WC, intrinsics, style=Style())
