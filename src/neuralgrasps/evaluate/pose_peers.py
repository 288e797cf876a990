"""Pose estimators of other libraries, to measure beside ours: Open3D, small_gicp, and OpenCV's point pair features.

They come with the extra `peers`. Each is given the object's mesh and its observed points, without strays, and settings
tuned on scenes that are not those of the benchmark. What depends on the object alone (clouds,
features) is made once and kept; `prepare_peer` makes it, so that no estimate pays for it. Each uses one thread when its
process was started with OMP_NUM_THREADS=1, as worker processes are.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from neuralgrasps.errors import NeuralGraspsError
from neuralgrasps.geometry.rotation import super_fibonacci_rotations
from neuralgrasps.geometry.sampling import even_surface_points
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.observation import check_points
from neuralgrasps.perception.pose_model import pose_model
from neuralgrasps.seeds import child_seed

FINE_M = 0.003  # spacing of the clouds that are aligned in the end, model and view alike
_KEPT = 32  # objects whose preparation is kept


class MissingPeerError(NeuralGraspsError, ImportError):
    """A package of the extra `peers` is asked for and not installed."""


class NoPoseError(NeuralGraspsError, ArithmeticError):
    """A peer found no pose at all in a view."""


@dataclass(frozen=True, slots=True)
class _Shape:
    """An object as the key of what is kept for it."""

    content_hash: str
    obj: ObjectModel = field(compare=False, repr=False)


def open3d_pose(obj: ObjectModel, points_C: np.ndarray, *, seed: int = 0) -> np.ndarray:
    """FPFH features, RANSAC over their matches, and point-to-plane ICP; the best of eight runs by share of inliers.

    Args:
        obj: the object. points_C: (M, 3) observed points on it, camera frame, metres; M >= 20. seed: of RANSAC.
    Returns:
        (4, 4) X_CO.
    Raises:
        MissingPeerError: Open3D is not installed. NoPoseError: it found none. InputError: see `check_points`.
    Source:
        Rusu et al. 2009 (FPFH); Zhou et al. 2018 (Open3D).
    """
    o3d = _package("open3d", "Open3D")
    model = _open3d_model(_Shape(obj.content_hash, obj))
    points_C = _observed(points_C)
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        return _inverse(_open3d_best(o3d, model, _open3d_cloud(o3d, points_C), seed), "Open3D")


def small_gicp_pose(obj: ObjectModel, points_C: np.ndarray, *, seed: int = 0) -> np.ndarray:
    """Generalised ICP from 64 evenly spread rotations, best by inliers, then by their distance.

    Every start puts the middle of what is visible of the object at that rotation on the middle of the observed points,
    the same as our own search does. All 64 are aligned on points every 6 mm, the best 8 on points every 3 mm.

    Args, returns and raises: as `open3d_pose`; nothing is random, `seed` is not used.
    Source:
        Segal et al. 2009 (generalised ICP); Koide 2024 (small_gicp).
    """
    del seed
    gicp = _package("small_gicp", "small_gicp")
    points_C = _observed(points_C)
    return _aligned(gicp, obj, points_C, _starts(obj, points_C), _COARSE_M)


def ppf_pose(obj: ObjectModel, points_C: np.ndarray, *, seed: int = 0) -> np.ndarray:
    """OpenCV's point pair features, its best 20 poses aligned by generalised ICP, best by inliers.

    OpenCV's own ICP diverges on partial views (in both directions), so its poses are aligned as in `small_gicp_pose`;
    this needs both packages.

    Args, returns and raises: as `open3d_pose`; nothing is random, `seed` is not used.
    Source:
        Drost et al. 2010.
    """
    del seed
    gicp = _package("small_gicp", "small_gicp")
    detector = _ppf_model(_Shape(obj.content_hash, obj))
    points_C = _observed(points_C)
    scene = _with_normals(points_C)
    found = detector.match(scene, *_PPF_SCENE)[:_PPF_POSES]
    X_CO = np.array([np.asarray(pose.pose, np.float64).reshape(4, 4) for pose in found])
    if not len(X_CO):
        raise NoPoseError("OpenCV found no pose in this view.")
    return _aligned(gicp, obj, points_C, np.linalg.inv(X_CO), _PPF_COARSE_M)


PEERS: MappingProxyType[str, Callable[..., np.ndarray]] = MappingProxyType(
    {"open3d": open3d_pose, "small_gicp": small_gicp_pose, "ppf": ppf_pose}
)
"""Estimators by the suffix of their figures."""


def check_peer(name: str) -> None:
    """Raise `MissingPeerError` unless the packages of a peer are installed."""
    if name == "open3d":
        _package("open3d", "Open3D")
    else:
        _package("small_gicp", "small_gicp")
    if name == "ppf":
        _ppf_package()


def prepare_peer(name: str, obj: ObjectModel) -> None:
    """Make what a peer keeps of an object, unless it is there."""
    check_peer(name)
    shape = _Shape(obj.content_hash, obj)
    if name == "open3d":
        _open3d_model(shape)
        return
    _gicp_model(shape)
    pose_model(obj)
    if name == "ppf":
        _ppf_model(shape)


def _package(module: str, name: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingPeerError(
            f"{name} is not installed. Install it with: pip install 'neuralgrasps[peers]'"
        ) from error


def _observed(points_C: np.ndarray) -> np.ndarray:
    """Without strays, flying pixels at depth edges most of all: points far from their eight nearest ones."""
    points_C = check_points(points_C)
    distance, _ = cKDTree(points_C).query(points_C, k=9)
    apart = distance[:, 1:].mean(axis=1)
    return points_C[apart <= np.median(apart) + 3.0 * apart.std()]


def _inverse(X_OC: np.ndarray, name: str) -> np.ndarray:
    X_OC = np.asarray(X_OC, np.float64)
    if not np.isfinite(X_OC).all() or abs(np.linalg.det(X_OC[:3, :3]) - 1.0) > 1e-3:
        raise NoPoseError(f"{name} found no pose in this view.")
    return np.linalg.inv(X_OC)


# Open3D

_RANSAC_RUNS, _RANSAC_TRIALS = 8, 50_000
VOXEL_M = 0.005  # of the clouds whose features are matched
_ICP_M = (0.010, 0.004)


@dataclass(frozen=True, slots=True)
class _Open3dModel:
    coarse: Any
    features: Any
    fine: Any


@lru_cache(maxsize=_KEPT)
def _open3d_model(shape: _Shape) -> _Open3dModel:
    o3d = _package("open3d", "Open3D")
    coarse = _open3d_cloud(o3d, *even_surface_points(shape.obj.mesh, VOXEL_M, 0)[:2])
    fine = _open3d_cloud(o3d, *even_surface_points(shape.obj.mesh, 0.7 * FINE_M, 0)[:2])
    return _Open3dModel(coarse, _open3d_features(o3d, coarse), fine)


def _open3d_cloud(o3d: Any, points: np.ndarray, normals: np.ndarray | None = None) -> Any:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    if normals is not None:
        cloud.normals = o3d.utility.Vector3dVector(normals)
    return cloud


def _open3d_features(o3d: Any, cloud: Any) -> Any:
    around = o3d.geometry.KDTreeSearchParamHybrid(radius=5.0 * VOXEL_M, max_nn=100)
    return o3d.pipelines.registration.compute_fpfh_feature(cloud, around)


def _open3d_best(o3d: Any, model: _Open3dModel, seen: Any, seed: int) -> np.ndarray:
    """X_OC (4, 4) of the best run."""
    steps = o3d.pipelines.registration
    coarse = seen.voxel_down_sample(VOXEL_M)
    coarse.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=2.5 * VOXEL_M, max_nn=30))
    coarse.orient_normals_towards_camera_location(np.zeros(3))
    features = _open3d_features(o3d, coarse)
    fine, reach = seen.voxel_down_sample(FINE_M), 1.5 * VOXEL_M
    checks = [steps.CorrespondenceCheckerBasedOnEdgeLength(0.9), steps.CorrespondenceCheckerBasedOnDistance(reach)]
    best: Any = None
    for run in range(_RANSAC_RUNS):
        o3d.utility.random.seed(child_seed(seed, "ransac", run) % 2**31)
        found = steps.registration_ransac_based_on_feature_matching(
            coarse, model.coarse, features, model.features, False, reach,
            steps.TransformationEstimationPointToPoint(False), 3, checks,
            steps.RANSACConvergenceCriteria(_RANSAC_TRIALS, 0.999),
        )  # fmt: skip
        for distance in _ICP_M:
            found = steps.registration_icp(
                fine, model.fine, distance, found.transformation, steps.TransformationEstimationPointToPlane(),
                steps.ICPConvergenceCriteria(max_iteration=30),
            )  # fmt: skip
        if best is None or (found.fitness, -found.inlier_rmse) > (best.fitness, -best.inlier_rmse):
            best = found
    return np.asarray(best.transformation)


# small_gicp

_STARTS, _POLISHED = 64, 8
_COARSE_M = 0.006  # spacing of the points that all starts are aligned on
_REACH_M = (0.060, 0.010)  # of correspondences, coarse and fine
_STEPS = (20, 30)
_INLIER_M = 0.003


@lru_cache(maxsize=_KEPT)
def _gicp_model(shape: _Shape) -> tuple[Any, Any]:
    """Cloud with covariances, and its tree."""
    gicp = _package("small_gicp", "small_gicp")
    points, _, _ = even_surface_points(shape.obj.mesh, FINE_M, 0)
    cloud, tree = gicp.preprocess_points(points, downsampling_resolution=0.5 * FINE_M, num_neighbors=10)
    return cloud, tree


def _starts(obj: ObjectModel, points_C: np.ndarray) -> np.ndarray:
    """X_OC (64, 4, 4) whose visible side's middle meets the middle of the observed points."""
    model, middle_C = pose_model(obj), points_C.mean(axis=0)
    R = super_fibonacci_rotations(_STARTS).numpy().astype(np.float64)
    sight_O = R @ (middle_C / np.linalg.norm(middle_C))
    X_OC = np.tile(np.eye(4), (_STARTS, 1, 1))
    X_OC[:, :3, :3] = R
    X_OC[:, :3, 3] = model.visible[(sight_O @ model.views.T).argmax(axis=1)] - R @ middle_C
    return X_OC


def _aligned(gicp: Any, obj: ObjectModel, points_C: np.ndarray, X_OC: np.ndarray, coarse_m: float) -> np.ndarray:
    """The best of many starts X_OC (N, 4, 4) after generalised ICP, as X_CO."""
    target, tree = _gicp_model(_Shape(obj.content_hash, obj))
    coarse, fine = (_gicp_cloud(gicp, points_C, spacing) for spacing in (coarse_m, FINE_M))
    ends = [_gicp_align(gicp, target, tree, coarse, X, 0) for X in X_OC]
    cost = [float(np.minimum(d, 4.0 * _INLIER_M**2).mean()) for d in _squared(tree, coarse, ends)]
    ends = [_gicp_align(gicp, target, tree, fine, ends[i], 1) for i in np.argsort(cost, kind="stable")[:_POLISHED]]
    best, most = 0, (-1, 0.0)
    for i, distance in enumerate(_squared(tree, fine, ends)):
        inliers = distance[distance < _INLIER_M**2]
        if (rank := (len(inliers), -float(inliers.mean()) if len(inliers) else 0.0)) > most:
            best, most = i, rank
    return _inverse(ends[best], "small_gicp")


def _gicp_cloud(gicp: Any, points_C: np.ndarray, spacing: float) -> Any:
    cloud, _ = gicp.preprocess_points(points_C, downsampling_resolution=spacing, num_neighbors=10)
    while len(cloud) < 30 and spacing > 1e-3:  # a small patch
        spacing *= 0.5
        cloud, _ = gicp.preprocess_points(points_C, downsampling_resolution=spacing, num_neighbors=10)
    return cloud


def _gicp_align(gicp: Any, target: Any, tree: Any, cloud: Any, X_OC: np.ndarray, stage: int) -> np.ndarray:
    found = gicp.align(
        target, cloud, tree, X_OC, registration_type="GICP", max_correspondence_distance=_REACH_M[stage], num_threads=1,
        max_iterations=_STEPS[stage],
    )  # fmt: skip
    return np.asarray(found.T_target_source)


def _squared(tree: Any, cloud: Any, X_OC: list[np.ndarray]) -> list[np.ndarray]:
    """Squared distances of a cloud's points to the model at each pose."""
    points = np.asarray(cloud.points())[:, :3]
    return [np.asarray(tree.batch_nearest_neighbor_search(points @ X[:3, :3].T + X[:3, 3])[1]) for X in X_OC]


# point pair features

_PPF_MODEL = (0.1, 0.05, 30.0)  # sampling and distance step in diameters, angles
_PPF_SCENE = (0.2, 0.03)  # share of the points that vote, spacing in diameters
_PPF_POSES, _PPF_COARSE_M = 20, 0.010


def _ppf_package() -> Any:
    cv2 = _package("cv2", "OpenCV with its contributed modules")
    if not hasattr(cv2, "ppf_match_3d"):
        raise MissingPeerError(
            "this OpenCV has no `ppf_match_3d`. Install the contributed modules: pip install 'neuralgrasps[peers]'"
        )
    return cv2


@lru_cache(maxsize=_KEPT)
def _ppf_model(shape: _Shape) -> Any:
    cv2 = _ppf_package()
    points, normals, _ = even_surface_points(shape.obj.mesh, FINE_M, 0)
    detector = cv2.ppf_match_3d.PPF3DDetector(*_PPF_MODEL)
    detector.trainModel(np.hstack([points, normals]).astype(np.float32))
    return detector


def _with_normals(points_C: np.ndarray) -> np.ndarray:
    """(K, 6) float32 thinned points with normals towards the camera, of planes through their 30 neighbours."""
    cells = np.floor(points_C / FINE_M).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    thinned = points_C[np.sort(first)]
    _, near = cKDTree(points_C).query(thinned, k=min(30, len(points_C)))
    around = points_C[near] - points_C[near].mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around))
    normals = axes[:, :, 0]
    normals = normals * -np.sign((normals * thinned).sum(axis=1, keepdims=True))
    return np.ascontiguousarray(np.hstack([thinned, normals]), dtype=np.float32)
