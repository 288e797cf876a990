"""How far the signed distances of a dataset are from exact ones, computed by other means than those that made them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from neuralgrasps.compiled import njit
from neuralgrasps.dataset.hand_surface import hand_normals, packed_link_poses, packed_part_poses, sample_posed_surface
from neuralgrasps.dataset.samples import hand_distances
from neuralgrasps.errors import ShapeError
from neuralgrasps.geometry.mesh import Mesh, signed_distance
from neuralgrasps.geometry.pose_kernels import moved_point
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import PackedHand, nearest_part
from neuralgrasps.hands.signed_distance import differentiable_distance

SIGN_MARGIN_M = 1e-6  # nearer to the surface than this, either sign is right
_STEP_M = 1e-5  # out of the deepest part; what is then not outside the hand was inside another part, or between two
_DENSE = 400_000  # points of the surface that depths are measured to: about 0.4 mm apart on a hand


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelError:
    """|label - exact| of signed distances; millimetres.

    Attributes:
        samples: how many were compared.
        mean_mm, p95_mm, max_mm: of the absolute error.
        wrong_signs: share of the samples more than a micrometre off the surface whose sign is wrong.
    """

    samples: int
    mean_mm: float
    p95_mm: float
    max_mm: float
    wrong_signs: float


def label_error(labels_m: np.ndarray, exact_m: np.ndarray) -> LabelError:
    """Compare labels with exact signed distances of the same points, both in metres and of one shape.

    Raises:
        ShapeError: different shapes, or no samples.
    """
    labels, exact = np.asarray(labels_m, np.float64), np.asarray(exact_m, np.float64)
    if labels.shape != exact.shape or not labels.size:
        raise ShapeError(f"labels have shape {labels.shape} and exact distances {exact.shape}; expected the same, > 0.")
    error = 1e3 * np.abs(labels - exact)
    away = np.abs(exact) > SIGN_MARGIN_M
    wrong = (labels > 0) != (exact > 0)
    return LabelError(
        samples=labels.size,
        mean_mm=float(error.mean()),
        p95_mm=float(np.percentile(error, 95)),
        max_mm=float(error.max()),
        wrong_signs=float(wrong[away].mean()) if away.any() else 0.0,
    )


def exact_object_distance(mesh: Mesh, points_O: np.ndarray) -> np.ndarray:
    """(M,) metres from points (M, 3) to the mesh, by libigl: pseudonormal sign, winding number where it has none.

    Independent of `geometry.mesh_tree`, which makes the labels of a dataset.
    """
    return signed_distance(mesh, np.asarray(points_O, np.float64))


def exact_hand_distance(hand: Hand, X_OH: np.ndarray, q: np.ndarray, points_O: np.ndarray) -> np.ndarray:
    """(M,) metres from points (M, 3) to a posed hand, X_OH (4, 4), q (J,): torch in float64, the least over its parts.

    Independent of the compiled kernels that make the labels. Exact outside the hand; inside see `hand_depth_bound`.
    """
    with torch.no_grad():
        inputs = [torch.from_numpy(np.array(a, np.float64)) for a in (X_OH[None], q[None], points_O)]
        return differentiable_distance(hand, *inputs)[0].numpy()


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthBound:
    """How far the depth in the deepest part is from the depth in the union of all parts, for points inside a hand.

    Where the nearest point of that part's surface lies inside another part, the union's surface is farther off.

    Attributes:
        inside: samples inside the hand.
        short: those of them whose depth is a lower bound only.
        mean_mm, p95_mm, max_mm: by how much these fall short, millimetres; measured to a surface cloud, which can
            overstate it by a few tenths of a millimetre.
    """

    inside: int
    short: int
    mean_mm: float
    p95_mm: float
    max_mm: float


def hand_depth_bound(
    packed: PackedHand, X_OH: np.ndarray, q: np.ndarray, points_O: np.ndarray, *, seed: int = 0
) -> DepthBound:
    """Measure it for the points (M, 3), object frame, metres, of one posed hand: X_OH (4, 4), q (J,)."""
    X_OH, q, points = (np.array(a, np.float64) for a in (X_OH, q, points_O))
    depth, part = np.empty(len(points)), np.empty(len(points), np.int64)
    _deepest(packed, packed_link_poses(packed, q), np.linalg.inv(X_OH), points, depth, part)
    points, part, depth = points[depth < 0.0], part[depth < 0.0], -depth[depth < 0.0]
    normals = hand_normals(packed, packed_part_poses(packed, X_OH, q), points, part)
    feet = points + (depth[:, None] + _STEP_M) * normals
    covered = hand_distances(packed, X_OH[None], q[None], feet)[0] < 0.5 * _STEP_M
    short = np.zeros(1)
    if covered.any():
        from scipy.spatial import cKDTree  # noqa: PLC0415 - for this measurement only

        surface = sample_posed_surface(packed, X_OH, q, _DENSE, np.random.default_rng(seed))
        short = 1e3 * np.maximum(cKDTree(surface).query(points[covered])[0] - depth[covered], 0.0)
    return DepthBound(
        inside=len(points),
        short=int(covered.sum()),
        mean_mm=float(short.mean()),
        p95_mm=float(np.percentile(short, 95)),
        max_mm=float(short.max()),
    )


@njit(cache=True, error_model="numpy")
def _deepest(packed, X_HL, X_HO, points, distance, part):  # type: ignore[no-untyped-def]
    for i in range(points.shape[0]):
        x, y, z = moved_point(X_HO, points[i, 0], points[i, 1], points[i, 2])
        distance[i], part[i] = nearest_part(packed, X_HL, x, y, z)
