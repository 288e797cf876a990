"""The zero surface of any distance field as a mesh, so that it can be measured like a true shape."""

from __future__ import annotations

from functools import cached_property

import igl
import numpy as np
from scipy.ndimage import map_coordinates

from neuralgrasps.dataset.samples import Normalisation
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.mesh_tree import build_tree, tree_distance
from neuralgrasps.geometry.sampling import sample_surface
from neuralgrasps.model.reconstruct import SignedDistance

COARSE, FINE = 80, 2  # cells along each axis, and how much finer near the surface


class FieldSurface:
    """What a field calls the surface of a shape, within a ball; a `Shape`.

    Stray surfaces far from the shape are part of it, as the field's user would meet them. What the field says outside
    the ball is nothing: it was not trained there. Where the inside reaches the ball's edge it is closed there.

    Attributes:
        bounds_O: None: such a field may say "inside" anywhere.
    """

    bounds_O = None

    def __init__(
        self,
        distance: SignedDistance,
        *,
        normalisation: Normalisation,
        cells: int = COARSE,
        coarse_m: np.ndarray | None = None,
        reach: float = 1.0,
    ) -> None:
        """
        Args:
            distance: (M, 3) points, object frame, metres -> (M,) metres. cells: of the coarse grid, along each axis.
            coarse_m: its values at `coarse_points`, where they are known already.
            reach: radius of the ball, normalised units.
        """
        self._distance = distance
        self._normalisation = normalisation
        self._cells = cells
        self._coarse_m = coarse_m
        self._reach = reach

    def signed_distance(self, points_O: np.ndarray) -> np.ndarray:
        return self._distance(points_O)

    def surface_distance(self, points_O: np.ndarray) -> np.ndarray:
        mesh = self.mesh
        return np.abs(tree_distance(self._tree, mesh, np.ascontiguousarray(points_O, np.float64)))

    def surface_points(self, count: int, rng: np.random.Generator) -> np.ndarray:
        return sample_surface(self.mesh, count, int(rng.integers(2**31)))[0]

    @cached_property
    def mesh(self) -> Mesh:
        """The surface, object frame, metres.

        Raises:
            InputError: the field is positive everywhere in the ball.
        """
        return level_mesh(
            self._distance, self._normalisation, cells=self._cells, coarse_m=self._coarse_m, reach=self._reach
        )

    @cached_property
    def _tree(self):  # type: ignore[no-untyped-def]
        return build_tree(self.mesh)


def level_mesh(
    distance: SignedDistance,
    normalisation: Normalisation,
    *,
    cells: int = COARSE,
    coarse_m: np.ndarray | None = None,
    reach: float = 1.0,
) -> Mesh:
    """Marching cubes within a ball: everywhere on a coarse grid of its box, again on a finer one near the surface.

    Args:
        cells: of the coarse grid along each axis; the finer one has `FINE` times as many.
        coarse_m: distances at `coarse_points`, if known already. reach: radius of the ball, normalised units.
    Raises:
        InputError: no surface is found.
    """
    if coarse_m is None:
        coarse_m = distance(coarse_points(normalisation, cells=cells, reach=reach))
    values = coarse_m.reshape((cells + 1,) * 3) / normalisation.scale_m
    fine = FINE * cells
    at = np.indices((fine + 1,) * 3).reshape(3, -1) / FINE
    guess = map_coordinates(values, at, order=1)
    near = np.flatnonzero(np.abs(guess) < 1.5 * 2.0 * reach / cells)
    if len(near):
        points = reach * ((at[:, near].T * (2.0 / cells)) - 1.0)
        guess[near] = distance(normalisation.to_object(points)) / normalisation.scale_m
    edge = reach * (np.linalg.norm(at * (2.0 / cells) - 1.0, axis=0) - (1.0 - 1.0 / cells))  # half a cell inside
    volume = np.maximum(guess, edge).reshape((fine + 1,) * 3)
    if not volume.min() < 0.0 < volume.max():
        raise InputError("the field has no surface in the ball: it is positive everywhere; train it longer.")
    axis = np.linspace(-reach, reach, fine + 1)
    corners = np.stack(np.meshgrid(axis, axis, axis, indexing="ij")[::-1], axis=-1).reshape(-1, 3)  # x runs fastest
    size = (fine + 1,) * 3
    unit, faces, _ = igl.marching_cubes(np.ascontiguousarray(volume.T).ravel(), corners, *size, 0.0)
    return Mesh(np.asarray(normalisation.to_object(unit), np.float64), np.ascontiguousarray(faces, np.int32))


def coarse_points(normalisation: Normalisation, *, cells: int = COARSE, reach: float = 1.0) -> np.ndarray:
    """((cells + 1)^3, 3) points of the coarse grid, object frame, metres."""
    axis = np.linspace(-reach, reach, cells + 1)
    return normalisation.to_object(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3))
