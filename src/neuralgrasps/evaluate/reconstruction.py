"""How well codes hold the shapes of grasps: the published measure beside its oracle, and surface errors in mm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from neuralgrasps.dataset.hand_surface import sample_posed_surface
from neuralgrasps.dataset.read import GraspDataset
from neuralgrasps.dataset.samples import hand_distances
from neuralgrasps.geometry.mesh_tree import build_tree, tree_distance
from neuralgrasps.geometry.sampling import sample_surface
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.hands.packed import PackedHand
from neuralgrasps.model.codes import CodeBook
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.model.reconstruct import (
    QUERIES,
    PublishedChamfer,
    SignedDistance,
    SurfaceErrors,
    hand_surface_distances,
    published_chamfer,
    surface_errors,
)
from neuralgrasps.seeds import child_seed

SURFACE_POINTS = 20_000

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class HandReconstruction:
    """Decoded hands of one hand and object against the true ones.

    Attributes:
        surface: exact surface-to-surface distances, pooled over the grasps.
        chamfer, oracle: means of the published measure, x 1 (the paper prints x 1e-3), and of a perfect field.
        grasps: how many.
    """

    hand: str
    object: str
    surface: SurfaceErrors
    chamfer: float
    oracle: float
    grasps: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectReconstruction:
    """The field's object (its grid) against the true mesh; `surface` one way, from the mesh to the field."""

    object: str
    surface: SurfaceErrors
    chamfer: float
    oracle: float


def reconstruct_hands(
    field: KinematicField,
    dataset: GraspDataset,
    codes: CodeBook,
    *,
    hand: str,
    object_name: str,
    seed: int = 0,
    queries: int = QUERIES,
    points: int = 1000,
) -> HandReconstruction:
    """Decode the codes of one hand and object and compare with the dataset's grasps of the same index.

    Whether the figure belongs to encoded or to inferred codes is the caller's to say: codes of known joints hold the
    grasp by construction.

    Args:
        codes: rows of that hand and object take part; `grasp_index` says which grasp each is of.
        queries: of the published measure. points: per surface and grasp, for the surface distances.
    """
    book = codes[codes.where(hand=hand, object_name=object_name)]
    grasps = dataset.grasps(hand, object_name)[book.grasp_index.astype(np.int64)]
    with torch.no_grad():
        decoded = field.decode(torch.as_tensor(book.values.astype(np.float64)), hand=hand, object_name=object_name)
    X_OH, q = decoded.X_OH.numpy(), decoded.q.numpy()
    packed = field.packed[hand]
    distances = hand_surface_distances(packed, X_OH, q, grasps.X_OH, grasps.q, seed=seed, points=points)
    frame = dataset.object(object_name).normalisation
    scores: list[PublishedChamfer] = []
    for i in range(len(book)):
        rng = np.random.default_rng(child_seed(seed, "true surface", hand, object_name, i))
        scores.append(
            published_chamfer(
                posed_distance(packed, X_OH[i], q[i]),
                posed_distance(packed, grasps.X_OH[i], grasps.q[i]),
                sample_posed_surface(packed, grasps.X_OH[i], grasps.q[i], SURFACE_POINTS, rng),
                normalisation=frame,
                seed=child_seed(seed, "queries", hand, object_name, i),
                queries=queries,
            )
        )
    return HandReconstruction(
        hand=hand,
        object=object_name,
        surface=surface_errors(distances),
        chamfer=float(np.mean([s.chamfer for s in scores])),
        oracle=float(np.mean([s.oracle for s in scores])),
        grasps=len(book),
    )


def posed_distance(packed: PackedHand, X_OH: np.ndarray, q: np.ndarray) -> SignedDistance:
    """The exact signed distance to one posed hand, X_OH (4, 4) and q (J,), as a function of points."""
    return lambda points_O: hand_distances(packed, X_OH[None], q[None], points_O)[0]


def reconstruct_object(
    field: KinematicField, dataset: GraspDataset, *, object_name: str, seed: int = 0, queries: int = QUERIES
) -> ObjectReconstruction:
    """The field's object against the dataset's mesh; the same for all codes, as the field's object is its grid."""
    stored, grid = dataset.object(object_name), field.object(object_name).sdf
    tree = build_tree(stored.mesh)
    surface = sample_surface(stored.mesh, SURFACE_POINTS, child_seed(seed, "surface", object_name))[0]
    score = published_chamfer(
        lambda p: query_grid_numpy(grid, p),
        lambda p: tree_distance(tree, stored.mesh, p),
        surface,
        normalisation=stored.normalisation,
        seed=child_seed(seed, "queries", object_name),
        queries=queries,
    )
    return ObjectReconstruction(
        object=object_name,
        surface=surface_errors(query_grid_numpy(grid, surface)),
        chamfer=score.chamfer,
        oracle=score.oracle,
    )
