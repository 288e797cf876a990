"""Point clouds of scenes, object and hand apart: exact surface samples, or what 128 virtual cameras see. Torch-free."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.dataset.camera_ring import object_views, ring_level, ring_poses
from neuralgrasps.dataset.hand_surface import hand_normals, packed_part_poses, part_areas, sample_posed_parts
from neuralgrasps.dataset.samples import Normalisation, scene_rng
from neuralgrasps.dataset.scene_views import ObjectCells, SeenPoints, hand_reach, object_cells, seen_in_scene
from neuralgrasps.dataset.schema import DatasetConfig
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.mesh import Mesh, face_areas_normals
from neuralgrasps.geometry.sampling import even_subset, sample_surface
from neuralgrasps.hands.packed import PackedHand

_FINE = 6.0  # cells per point wanted, before thinning
_SCANT = 2.5  # seen points per point wanted below which cells are made smaller
_TRIES = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneClouds:
    """Point clouds of N scenes, K points on each shape; object frame, metres.

    Attributes:
        object_points_O, hand_points_O: (N, K, 3) float32, on the surface to the rounding to float32.
        object_normals_O, hand_normals_O: (N, K, 3) float32 outward unit normals.
    """

    object_points_O: np.ndarray
    object_normals_O: np.ndarray
    hand_points_O: np.ndarray
    hand_normals_O: np.ndarray

    def __len__(self) -> int:
        return len(self.object_points_O)


def scene_clouds(
    mesh: Mesh,
    packed: PackedHand,
    X_OH: np.ndarray,
    q: np.ndarray,
    *,
    hand: str,
    object_name: str,
    normalisation: Normalisation,
    config: DatasetConfig,
) -> SceneClouds:
    """Clouds of N scenes of one hand and object, of the kind and size that `config` says.

    "exact": points uniform by area on the object's mesh, and on the outside of the union of the hand's parts.
    "rendered": of all pixels of 128 cameras of 320 x 240 pixels around the scene that see a shape before the other,
    back-projected, points spread evenly; nothing that is hidden from every camera is in them. Pixels that see the
    back of a face, through a hole of a scan, hide what is behind and give no point.

    A cloud depends on its scene and `config` alone. Where fewer pixels see a shape than points are wanted, points come
    several times; where none does, they are NaN.

    Args:
        mesh: the object's true surface, object frame, metres.
        packed: the hand's arrays; X_OH: (N, 4, 4) hand base in the object frame; q: (N, J) joints, rad or metres.
        hand, object_name: part of each scene's seed.
        normalisation: of the object; cameras look at its middle.
    Raises:
        InputError: `config.clouds` is "none".

    Source:
        Khargonkar et al. 2022, Sec. 4. Differs: rays meet the hand's exact shapes, and points are thinned evenly.
    """
    if config.clouds == "none":
        raise InputError('clouds are "none" in this configuration; expected "exact" or "rendered".')
    X_OH, q = np.array(X_OH, np.float64), np.array(q, np.float64)
    rngs = [
        scene_rng(config.seed, hand, object_name, X, joints, what="clouds") for X, joints in zip(X_OH, q, strict=True)
    ]
    if config.clouds == "exact":
        pairs = [_exact(mesh, packed, *scene, config.cloud_points) for scene in zip(X_OH, q, rngs, strict=True)]
    else:
        pairs = _rendered(mesh, packed, X_OH, q, rngs, normalisation.offset_O, config.cloud_points)
    stacked = np.array([[[c.points_O, c.normals_O] for c in pair] for pair in pairs], np.float32)
    stacked = stacked.reshape(len(X_OH), 2, 2, config.cloud_points, 3)
    return SceneClouds(
        object_points_O=stacked[:, 0, 0],
        object_normals_O=stacked[:, 0, 1],
        hand_points_O=stacked[:, 1, 0],
        hand_normals_O=stacked[:, 1, 1],
    )


def _exact(
    mesh: Mesh, packed: PackedHand, X_OH: np.ndarray, q: np.ndarray, rng: np.random.Generator, count: int
) -> tuple[SeenPoints, SeenPoints]:
    points_O, normals_O, _ = sample_surface(mesh, count, int(rng.integers(2**31)))
    on_hand_O, parts = sample_posed_parts(packed, X_OH, q, count, rng)
    outward_O = hand_normals(packed, packed_part_poses(packed, X_OH, q), on_hand_O, parts)
    return SeenPoints(points_O=points_O, normals_O=normals_O), SeenPoints(points_O=on_hand_O, normals_O=outward_O)


def _rendered(
    mesh: Mesh,
    packed: PackedHand,
    X_OH: np.ndarray,
    q: np.ndarray,
    rngs: list[np.random.Generator],
    centre_O: np.ndarray,
    count: int,
) -> list[tuple[SeenPoints, SeenPoints]]:
    """Scenes by the size of the ring they need, so that each ring sees the object alone once."""
    areas, normals_O = face_areas_normals(mesh)
    base_m = float(np.linalg.norm(mesh.vertices - centre_O, axis=1).max())
    levels = [ring_level(hand_reach(packed, X, joints, centre_O), base_m) for X, joints in zip(X_OH, q, strict=True)]
    sizes = [float(np.sqrt(area / (_FINE * count))) for area in (areas.sum(), part_areas(packed).sum())]
    pairs: dict[int, tuple[SeenPoints, SeenPoints]] = {}
    for level in sorted(set(levels)):
        views = object_views(mesh, ring_poses(centre_O, base_m, level))
        cells: dict[float, ObjectCells] = {}
        for i in (i for i, own in enumerate(levels) if own == level):
            object_cell, hand_cell = sizes
            for _ in range(_TRIES):
                if object_cell not in cells:
                    cells[object_cell] = object_cells(views, object_cell)
                pair = seen_in_scene(
                    packed, X_OH[i], q[i], views=views, cells=cells[object_cell], normals_O=normals_O,
                    hand_cell_m=hand_cell,
                )  # fmt: skip
                short = [0 < len(c.points_O) < _SCANT * count for c in pair]
                if not any(short):
                    break
                object_cell, hand_cell = object_cell / (1 + short[0]), hand_cell / (1 + short[1])
            pairs[i] = (_thinned(pair[0], count, rngs[i]), _thinned(pair[1], count, rngs[i]))
    return [pairs[i] for i in range(len(levels))]


def _thinned(seen: SeenPoints, count: int, rng: np.random.Generator) -> SeenPoints:
    """`count` of the points, evenly spread; some several times when there are fewer."""
    total = len(seen.points_O)
    if not total:
        nothing = np.full((count, 3), np.nan)
        return SeenPoints(points_O=nothing, normals_O=nothing)
    order = rng.permutation(total)
    chosen = np.resize(order, count) if total <= count else order[even_subset(seen.points_O[order], count)]
    return SeenPoints(points_O=seen.points_O[chosen], normals_O=seen.normals_O[chosen])
