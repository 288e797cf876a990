"""Small things on a table, and exact views of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from neuralgrasps.geometry.camera import Intrinsics, back_project, look_at
from neuralgrasps.geometry.mesh import Mesh, merge_meshes
from neuralgrasps.geometry.plane import Plane, horizontal_plane
from neuralgrasps.geometry.primitives import box_mesh, convex_hull, cylinder_mesh, sphere_mesh
from neuralgrasps.objects.loft import loft, superellipse
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.resting import resting_poses
from neuralgrasps.sim.camera import DepthNoise, render_depth_view

CAMERA = Intrinsics.from_fov(np.deg2rad(35.0), 240, 180)
X_WC = look_at(np.array([0.50, 0.18, 0.42]), np.array([0.0, 0.0, 0.04]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """What a camera sees of an object on the table z = 0.

    Attributes:
        depth: (h, w); intrinsics: its camera; X_WC: (4, 4) of it.
        mask: (h, w) bool, the object's pixels; masks: of every other thing.
        points_C: (M, 3) of the mask. X_CO: (4, 4) true pose. table: in the camera frame.
    """

    depth: np.ndarray
    intrinsics: Intrinsics
    X_WC: np.ndarray
    mask: np.ndarray
    masks: tuple[np.ndarray, ...]
    points_C: np.ndarray
    X_CO: np.ndarray
    table: Plane

    @property
    def image(self) -> dict[str, object]:
        """The view as arguments of `estimate_pose`."""
        return {"depth": self.depth, "intrinsics": self.intrinsics, "mask": self.mask}

    def asked(self, how: str) -> dict[str, object]:
        """Arguments of `estimate_pose`: "points" or "image", "... and table"."""
        table = {"table": self.table} if "table" in how else {}
        return table | ({"points_C": self.points_C} if "points" in how else self.image)


def at(x: float, y: float, z: float, yaw_rad: float = 0.0) -> np.ndarray:
    """(4, 4) a pose turned about z."""
    X = np.eye(4)
    X[:2, :2] = [[np.cos(yaw_rad), -np.sin(yaw_rad)], [np.sin(yaw_rad), np.cos(yaw_rad)]]
    X[:3, 3] = [x, y, z]
    return X


def _standing(obj: ObjectModel, rest: int = 0, *, yaw_rad: float = 0.0, x: float = 0.0, y: float = 0.0) -> np.ndarray:
    poses, _ = resting_poses(obj.mesh.vertices, obj.com_O)
    return at(x, y, 0.0, yaw_rad) @ poses[rest % len(poses)]


def _look(
    mesh: Mesh,
    X_WO: np.ndarray,
    *,
    others: Sequence[tuple[Mesh, np.ndarray]] = (),
    table: bool = True,
    X_WC: np.ndarray = X_WC,
    intrinsics: Intrinsics = CAMERA,
    noise: DepthNoise | None = None,
    seed: int = 0,
) -> Look:
    meshes, poses = [mesh, *(m for m, _ in others)], [X_WO, *(X for _, X in others)]
    if table:
        meshes, poses = [*meshes, box_mesh([0.5, 0.5, 0.01])], [*poses, at(0.0, 0.0, -0.01)]
    view = render_depth_view(meshes, np.stack(poses), X_WC=X_WC, intrinsics=intrinsics, noise=noise, seed=seed)
    masks = [(view.mesh_index == k) & (view.depth > 0) for k in range(1 + len(others))]
    return Look(
        depth=view.depth, intrinsics=intrinsics, X_WC=X_WC, mask=masks[0], masks=tuple(masks[1:]),
        points_C=back_project(view.depth, intrinsics, mask=masks[0]), X_CO=np.linalg.inv(X_WC) @ X_WO,
        table=horizontal_plane(0.0, X_WC),
    )  # fmt: skip


def _wedge() -> Mesh:
    """A lump without symmetry, 6 x 9 x 12 cm."""
    corners = np.array(
        [[-30, -45, 0], [30, -45, 0], [-30, 45, 0], [22, 40, 0], [-30, -45, 120], [10, -38, 105], [-18, 20, 85],
         [28, -45, 40]]
    )  # fmt: skip
    return Mesh(*convex_hull(1e-3 * corners))


def _corner() -> Mesh:
    """A bent thing, not convex."""
    parts = [([50, 20, 15], [0, 0, 15]), ([12, 20, 40], [38, 0, 40]), ([15, 30, 10], [-30, 30, 10])]
    return merge_meshes([box_mesh(1e-3 * np.array(h)).transformed(at(*(1e-3 * np.array(c)))) for h, c in parts])


def _bevelled() -> Mesh:
    """A box whose one vertical edge is cut off by 16 mm."""
    outline = np.array([[30, -45], [30, 29], [14, 45], [-30, 45], [-30, -45]])
    corners = np.concatenate([np.column_stack([outline, np.full(5, z)]) for z in (-60, 60)])
    return Mesh(*convex_hull(1e-3 * corners))


def _rimmed() -> Mesh:
    """A can whose upper end is 5 mm wider over 12 mm of its height."""
    radii, heights = [33, 33, 38, 38], [0, 84, 84.1, 96]
    return loft([superellipse(1e-3 * r, 1e-3 * r, 2.0, 64) for r in radii], [1e-3 * z for z in heights])


@pytest.fixture(scope="session")
def things(make_object: Callable[..., ObjectModel]) -> Mapping[str, ObjectModel]:
    """Objects of 6 to 12 cm with their symmetry."""
    meshes = {
        "box": box_mesh([0.030, 0.045, 0.060]),
        "ball": sphere_mesh(0.04, segments=64),
        "can": cylinder_mesh(0.033, 0.05, segments=64),
        "wedge": _wedge(),
        "corner": _corner(),
        "bevelled": _bevelled(),
        "rimmed": _rimmed(),
    }
    return {name: make_object(name, mesh, symmetry=True) for name, mesh in meshes.items()}


@pytest.fixture(scope="session")
def look() -> Callable[..., Look]:
    """`look(mesh, X_WO, others=(), table=True, X_WC=..., intrinsics=..., noise=None)`: a view of a mesh."""
    return _look


@pytest.fixture(scope="session")
def standing() -> Callable[..., np.ndarray]:
    """`standing(obj, rest=0, yaw_rad=0, x=0, y=0)`: X_WO (4, 4) of a stable pose on the table."""
    return _standing
