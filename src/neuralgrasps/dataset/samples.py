"""SDF samples and contact maps of scenes (one hand grasping one object).

A scene's samples are a pure function of the scene and a seed, so they may be stored or
recomputed. Nothing here imports torch: it runs in the workers of a dataset build.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from neuralgrasps.dataset.hand_surface import sample_posed_surface
from neuralgrasps.dataset.schema import DatasetConfig
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.mesh_tree import build_tree, tree_distance
from neuralgrasps.geometry.sampling import sample_surface
from neuralgrasps.hands.packed import PackedHand, hand_distance_many
from neuralgrasps.seeds import child_rng


@dataclass(frozen=True, slots=True, kw_only=True)
class Normalisation:
    """The frame in which an object lies in a ball of radius 1/3.

    Hands reach beyond the unit ball where they are large against the object (18 % of the hand queries of a Barrett
    hand on a soup can lie outside it). A view: arrays stay in metres in the object frame, and are mapped when a
    definition of the published method needs its units.

    Attributes:
        offset_O: (3,) float64, mean of the object's surface points, metres.
        scale_m: three times the largest distance from it, metres per normalised unit.
    """

    offset_O: np.ndarray
    scale_m: float

    def to_unit(self, points_O: np.ndarray) -> np.ndarray:
        """Object-frame metres to normalised units, (..., 3)."""
        return (points_O - self.offset_O) / self.scale_m

    def to_object(self, points_unit: np.ndarray) -> np.ndarray:
        """Normalised units to object-frame metres, (..., 3)."""
        return points_unit * self.scale_m + self.offset_O


def normalisation_of(points_O: np.ndarray) -> Normalisation:
    """The normalisation of an object from its (P, 3) surface points; shared by all hands."""
    offset = points_O.mean(axis=0)
    return Normalisation(offset_O=offset, scale_m=3.0 * float(np.linalg.norm(points_O - offset, axis=1).max()))


@dataclass(frozen=True, slots=True, kw_only=True)
class SdfSamples:
    """Signed distances of N scenes at M query points each; metres, negative inside.

    Attributes:
        points_O: (N, M, 3) float32; of each scene the first M/2 were drawn around the object, the rest
            around the hand.
        sdf_object, sdf_hand: (N, M) float32, exact at `points_O` up to the rounding to float32, but for a few points
            inside several parts of a hand (of those inside the built-in hands 1 %): the union's surface is farther off
            than |sdf_hand| there. `evaluate.label_error.hand_depth_bound` measures them.
        hand_index: (N,) int32 index into the dataset's hand names.
    """

    points_O: np.ndarray
    sdf_object: np.ndarray
    sdf_hand: np.ndarray
    hand_index: np.ndarray

    def __len__(self) -> int:
        return len(self.points_O)


def scene_rng(
    seed: int, hand: str, object_name: str, X_OH: np.ndarray, q: np.ndarray, *, what: str = "sdf"
) -> np.random.Generator:
    """The generator of `what` of a scene: depends on the seed, the names and the grasp itself, not on its index."""
    grasp = np.concatenate([np.asarray(X_OH, np.float64).ravel(), np.asarray(q, np.float64).ravel()])
    return child_rng(seed, what, object_name, hand, hashlib.sha256(grasp.tobytes()).hexdigest())


def ball_points(count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, 3) points uniform in the unit ball."""
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return direction * rng.random((count, 1)) ** (1.0 / 3.0)


def _around(
    surface_O: np.ndarray, count: int, normalisation: Normalisation, config: DatasetConfig, rng: np.random.Generator
) -> np.ndarray:
    """Noisy copies of the surface points, then uniform points of the unit ball, `count` in all."""
    wide = np.arange(len(surface_O)) % 2 == 0
    sigma = np.where(wide, config.noise_wide, config.noise_narrow) * normalisation.scale_m
    near = surface_O + rng.normal(size=surface_O.shape) * sigma[:, None]
    rest = normalisation.to_object(ball_points(count - len(surface_O), rng))
    return np.concatenate([near, rest])


def scene_queries(
    mesh: Mesh,
    packed: PackedHand,
    X_OH: np.ndarray,
    q: np.ndarray,
    *,
    normalisation: Normalisation,
    config: DatasetConfig,
    rng: np.random.Generator,
) -> np.ndarray:
    """(M, 3) float32 query points of one scene, object frame, metres: around the object, then around the hand."""
    half = config.queries_per_scene // 2
    near = round(half * config.surface_share)
    on_object = sample_surface(mesh, near, int(rng.integers(2**31)))[0]
    on_hand = sample_posed_surface(packed, X_OH, q, near, rng)
    around = [_around(surface, half, normalisation, config, rng) for surface in (on_object, on_hand)]
    return np.concatenate(around).astype(np.float32)


def sample_scenes(
    mesh: Mesh,
    packed: PackedHand,
    X_OH: np.ndarray,
    q: np.ndarray,
    *,
    hand: str,
    object_name: str,
    normalisation: Normalisation,
    config: DatasetConfig,
    hand_index: int = 0,
) -> SdfSamples:
    """Signed distances of N scenes of one hand and object; see `SdfSamples` for where they are exact.

    Args:
        mesh: the object's true surface, object frame, metres.
        packed: the hand's arrays (`hands.packed.pack_hand`).
        X_OH: (N, 4, 4) hand base in the object frame; q: (N, J) joints, rad or metres.
        hand, object_name: part of each scene's seed.
        normalisation: sets the noise lengths and the unit ball.
        hand_index: value of `SdfSamples.hand_index`.

    Source:
        Khargonkar et al. 2022, Sec. 4. Differs: distances are exact, not votes of nearest normals.
    """
    X_OH, q = np.array(X_OH, np.float64), np.array(q, np.float64)
    count, queries = len(X_OH), config.queries_per_scene
    points = np.empty((count, queries, 3), np.float32)
    sdf_object, sdf_hand = np.empty((2, count, queries), np.float32)
    tree = build_tree(mesh)
    distance = np.empty(queries)
    for i in range(count):
        rng = scene_rng(config.seed, hand, object_name, X_OH[i], q[i])
        points[i] = scene_queries(mesh, packed, X_OH[i], q[i], normalisation=normalisation, config=config, rng=rng)
        hand_distance_many(packed, X_OH[i], q[i], points[i].astype(np.float64), distance)
        sdf_hand[i] = distance
        sdf_object[i] = tree_distance(tree, mesh, points[i])
    return SdfSamples(
        points_O=points,
        sdf_object=sdf_object,
        sdf_hand=sdf_hand,
        hand_index=np.full(count, hand_index, np.int32),
    )


def hand_distances(packed: PackedHand, X_OH: np.ndarray, q: np.ndarray, points_O: np.ndarray) -> np.ndarray:
    """Signed distances (N, P) float64, metres, from (P, 3) points to N posed hands.

    Exact outside the hand and inside one part. Inside several overlapping parts it is the distance to the deepest
    part's own surface: the sign is right, the depth a lower bound.
    """
    # Copies, because kernels are compiled for writable arrays.
    X_OH, q, points = (np.array(a, np.float64) for a in (X_OH, q, points_O))
    distance = np.empty((len(X_OH), len(points)))
    for i in range(len(X_OH)):
        hand_distance_many(packed, X_OH[i], q[i], points, distance[i])
    return distance


def closeness(distance_m: np.ndarray, radius_m: float) -> np.ndarray:
    """Contact closeness exp(-d / radius) in (0, 1], 1 at and inside the hand; float32."""
    return np.exp(-np.maximum(distance_m, 0.0) / radius_m).astype(np.float32)


def contact_maps(
    packed: PackedHand, X_OH: np.ndarray, q: np.ndarray, points_O: np.ndarray, *, radius_m: float
) -> np.ndarray:
    """Closeness (N, P) float32 of each object point to each posed hand, exact distances."""
    return closeness(hand_distances(packed, X_OH, q, points_O), radius_m)
