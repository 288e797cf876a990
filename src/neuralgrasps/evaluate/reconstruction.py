"""How well codes hold the shapes of grasps: the published measure beside its oracle, and surface errors in mm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from neuralgrasps.dataset.read import GraspDataset
from neuralgrasps.dataset.samples import Normalisation, normalisation_of
from neuralgrasps.errors import ShapeError
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.mesh_tree import MeshTree, build_tree, tree_distance
from neuralgrasps.geometry.sampling import sample_surface
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.model.codes import CodeBook
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.model.reconstruct import (
    QUERIES,
    ChamferScene,
    Shape,
    SignedDistance,
    SurfaceErrors,
    f_score,
    posed_hands,
    published_chamfer,
    surface_distances,
    surface_errors,
)
from neuralgrasps.seeds import child_rng, child_seed

SURFACE_POINTS = 20_000
F_SCORES_M = (0.001, 0.002)


@dataclass(frozen=True, slots=True, kw_only=True)
class ShapeScores:
    """N reconstructed shapes against the true ones.

    Attributes:
        chamfer, oracle: (N,) the published measure x 1 (the paper prints x 1e-3), and that of a perfect field.
        distances_m: (N, 2, M) surface to surface, metres: points of the reconstructed one, then of the true one.
    """

    chamfer: np.ndarray
    oracle: np.ndarray
    distances_m: np.ndarray

    def __len__(self) -> int:
        return len(self.chamfer)

    @property
    def surface(self) -> SurfaceErrors:
        """Both ways and all shapes pooled."""
        return surface_errors(self.distances_m)

    def f_scores(self, threshold_m: float) -> np.ndarray:
        """(N,) `f_score` of each shape."""
        return np.array([f_score(there, back, threshold_m) for there, back in self.distances_m])


def score_shapes(
    given: Mapping[str, Sequence[Shape]],
    true: Sequence[Shape],
    *,
    normalisation: Normalisation,
    seeds: Sequence[int],
    queries: int = QUERIES,
    points: int = 1000,
) -> dict[str, ShapeScores]:
    """Score several kinds of reconstruction of the same shapes; queries and oracle are made once per shape.

    Args:
        given: kind -> N reconstructions. true: N shapes; seeds: N, of queries and surface points.
        queries: of the published measure. points: per surface and shape, for the surface distances.
    Raises:
        ShapeError: not one reconstruction and seed for every true shape.
    """
    lengths = {kind: len(shapes) for kind, shapes in given.items()} | {"seeds": len(seeds)}
    if any(length != len(true) for length in lengths.values()):
        raise ShapeError(f"{lengths} for {len(true)} true shapes; expected one each.")
    scores: dict[str, list[tuple[float, float, np.ndarray]]] = {kind: [] for kind in given}
    for i, (shape, seed) in enumerate(zip(true, seeds, strict=True)):
        scene = ChamferScene(
            shape.signed_distance,
            shape.surface_points(SURFACE_POINTS, child_rng(seed, "true surface")),
            normalisation=normalisation,
            seed=child_seed(seed, "queries"),
            queries=queries,
            bounds_O=shape.bounds_O,
        )
        for kind, shapes in given.items():
            chamfer = scene.score(shapes[i].signed_distance, bounds_O=shapes[i].bounds_O).chamfer
            distances = surface_distances(shapes[i], shape, points=points, rng=child_rng(seed, "surface"))
            scores[kind].append((chamfer, scene.oracle, distances))
    return {
        kind: ShapeScores(
            chamfer=np.array([row[0] for row in rows]),
            oracle=np.array([row[1] for row in rows]),
            distances_m=np.array([row[2] for row in rows]).reshape(-1, 2, points),
        )
        for kind, rows in scores.items()
    }


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
    """A field's object against the true mesh.

    Attributes:
        surface: of a shape (`score_object_shapes`) both ways; of a grid of true distances (`score_object`) from points
            of the mesh to the grid's zero.
        chamfer, oracle: means of the published measure, x 1, and of a perfect field.
        shapes: how many reconstructions were scored.
    """

    object: str
    surface: SurfaceErrors
    chamfer: float
    oracle: float
    shapes: int = 1


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
    packed = field.packed[hand]
    scores = score_shapes(
        {"codes": posed_hands(packed, *decoded_grasps(field, book.values, hand=hand, object_name=object_name))},
        posed_hands(packed, grasps.X_OH, grasps.q),
        normalisation=dataset.object(object_name).normalisation,
        seeds=[child_seed(seed, "shapes", hand, object_name, int(i)) for i in book.grasp_index],
        queries=queries,
        points=points,
    )["codes"]
    return HandReconstruction(
        hand=hand,
        object=object_name,
        surface=scores.surface,
        chamfer=float(scores.chamfer.mean()),
        oracle=float(scores.oracle.mean()),
        grasps=len(book),
    )


def decoded_grasps(
    field: KinematicField, values: np.ndarray, *, hand: str, object_name: str
) -> tuple[np.ndarray, np.ndarray]:
    """X_OH (N, 4, 4) and q (N, J), float64, that codes (N, 128) say, in closed form."""
    with torch.no_grad():
        decoded = field.decode(torch.as_tensor(values.astype(np.float64)), hand=hand, object_name=object_name)
    return decoded.X_OH.numpy(), decoded.q.numpy()


def reconstruct_object(
    field: KinematicField, dataset: GraspDataset, *, object_name: str, seed: int = 0, queries: int = QUERIES
) -> ObjectReconstruction:
    """The field's object against the dataset's mesh; the same for all codes, as the field's object is its grid."""
    grid = field.object(object_name).sdf
    return score_object(
        lambda p: query_grid_numpy(grid, p),
        dataset.object(object_name).mesh,
        object_name=object_name,
        normalisation=dataset.object(object_name).normalisation,
        seed=seed,
        queries=queries,
    )


def score_object(
    reconstructed: SignedDistance,
    mesh: Mesh,
    *,
    object_name: str,
    normalisation: Normalisation | None = None,
    seed: int = 0,
    queries: int = QUERIES,
) -> ObjectReconstruction:
    """A grid of an object's true distances against its mesh; `normalisation` is that of the mesh's surface when None.

    The surface error is |reconstructed| at points of the mesh, which is a distance only where the grid holds distances.
    What a network says may be flat: score that with `score_object_shapes`.
    """
    tree = build_tree(mesh)
    surface = sample_surface(mesh, SURFACE_POINTS, child_seed(seed, "surface", object_name))[0]
    score = published_chamfer(
        reconstructed,
        lambda p: tree_distance(tree, mesh, p),
        surface,
        normalisation=normalisation or normalisation_of(surface),
        seed=child_seed(seed, "queries", object_name),
        queries=queries,
    )
    return ObjectReconstruction(
        object=object_name,
        surface=surface_errors(reconstructed(surface)),
        chamfer=score.chamfer,
        oracle=score.oracle,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class MeshShape:
    """A true object as a `Shape`."""

    mesh: Mesh
    tree: MeshTree

    @property
    def bounds_O(self) -> np.ndarray:
        return self.mesh.bounds

    def signed_distance(self, points_O: np.ndarray) -> np.ndarray:
        return tree_distance(self.tree, self.mesh, np.ascontiguousarray(points_O, np.float64))

    def surface_distance(self, points_O: np.ndarray) -> np.ndarray:
        return np.abs(self.signed_distance(points_O))

    def surface_points(self, count: int, rng: np.random.Generator) -> np.ndarray:
        return sample_surface(self.mesh, count, int(rng.integers(2**31)))[0]


def score_object_shapes(
    given: Sequence[Shape],
    mesh: Mesh,
    *,
    object_name: str,
    normalisation: Normalisation,
    seed: int = 0,
    queries: int = QUERIES,
    points: int = 1000,
) -> ObjectReconstruction:
    """Surfaces that a field says the object has, one per code, against its mesh: scored as hands are, both ways.

    Raises:
        ShapeError: no shapes.
    """
    if not len(given):
        raise ShapeError(f"no shapes of '{object_name}' to score; expected at least one.")
    true = MeshShape(mesh=mesh, tree=build_tree(mesh))
    scores = score_shapes(
        {"field": given},
        [true] * len(given),
        normalisation=normalisation,
        seeds=[child_seed(seed, "object", object_name, i) for i in range(len(given))],
        queries=queries,
        points=points,
    )["field"]
    return ObjectReconstruction(
        object=object_name,
        surface=scores.surface,
        chamfer=float(scores.chamfer.mean()),
        oracle=float(scores.oracle.mean()),
        shapes=len(given),
    )
