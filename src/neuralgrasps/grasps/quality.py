"""Every quality of a set of grasps in one call; how varied the set is says `diversity`.

The metrics follow what published benchmarks report: penetration depth, contact distance, contact number, Q1 (epsilon),
force residual. State friction, torsion and length beside them: they decide the numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.errors import InputError, check_shape
from neuralgrasps.geometry.pose_kernels import moved_point
from neuralgrasps.geometry.sdf_grid import grid_distance
from neuralgrasps.grasps.contact import MAX_PER_LINK, THRESHOLD_M, find_contacts, link_pose_in_object
from neuralgrasps.grasps.epsilon import epsilon
from neuralgrasps.grasps.force_qp import contact_forces
from neuralgrasps.grasps.penetration import PenetrationDepths, penetration_depths
from neuralgrasps.grasps.wrench_space import characteristic_length, grasp_wrenches
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import PackedHand, pose_links
from neuralgrasps.objects.object_model import ObjectModel

FAR_M = 0.01  # contact distances are clipped to this
NEAR_M = 2e-3  # a link nearer than this counts as touching


@dataclass(frozen=True, slots=True, kw_only=True)
class QualityConfig:
    """How grasps are judged.

    Attributes:
        friction: Coulomb coefficient; None = the object's.
        torsion_m: torsional friction coefficient, metres; 0 = hard fingers.
        edges: edges of the linearised friction cone.
        threshold_m: hand points nearer than this touch; max_per_link: contacts kept per link.
    """

    friction: float | None = None
    torsion_m: float = 0.0
    edges: int = 8
    threshold_m: float = THRESHOLD_M
    max_per_link: int = MAX_PER_LINK

    def __post_init__(self) -> None:
        if self.friction is not None and not self.friction > 0:
            raise InputError(f"friction is {self.friction}; expected > 0, such as 0.6, or None for the object's.")
        if self.torsion_m < 0 or self.threshold_m <= 0:
            raise InputError(f"torsion_m is {self.torsion_m}, threshold_m {self.threshold_m}; expected >= 0 and > 0.")
        if self.edges < 3 or self.max_per_link < 1:
            raise InputError(f"edges is {self.edges}, max_per_link {self.max_per_link}; expected >= 3 and >= 1.")


@dataclass(frozen=True, slots=True, kw_only=True)
class GraspQuality:
    """Qualities of N grasps.

    Attributes:
        epsilon: (N,) float64, Ferrari-Canny; 0 = not force closure.
        force_residual: (N,) float64, net wrench of the best unit squeeze (see `force_qp`); inf without contact.
        depths: overlaps, metres.
        contact_distance_m: (N,) mean over fingers of the finger's distance to the object, clipped to 10 mm.
        touching_links: (N,) int32, links within 2 mm.
        contact_points_O, contact_normals_O: (N, C, 3) nan-padded; contact_links: (N, C) int32, -1-padded.
    """

    epsilon: np.ndarray
    force_residual: np.ndarray
    depths: PenetrationDepths
    contact_distance_m: np.ndarray
    touching_links: np.ndarray
    contact_points_O: np.ndarray
    contact_normals_O: np.ndarray
    contact_links: np.ndarray


@njit(cache=True, error_model="numpy")
def link_distances(sdf_values, origin, inv_spacing, packed, X_OH, X_HL, out):  # type: ignore[no-untyped-def]
    """Smallest signed distance (L,) of each link's surface points to the object, metres; inf without points."""
    X = np.empty((3, 4))
    for link in range(packed.link_radius.shape[0]):
        out[link] = np.inf
        link_pose_in_object(X_OH, X_HL, link, X)
        for k in range(packed.link_point_start[link], packed.link_point_start[link + 1]):
            p = packed.point_L[k]
            x, y, z = moved_point(X, p[0], p[1], p[2])
            out[link] = min(out[link], grid_distance(sdf_values, origin, inv_spacing, x, y, z))


@njit(cache=True, error_model="numpy")
def _judge(  # type: ignore[no-untyped-def]
    sdf_values,
    origin,
    inv_spacing,
    packed,
    X_OH,
    q,
    com,
    friction,
    edges,
    torsion,
    length,
    threshold,
    max_per_link,
    points,
    normals,
    links,
    quality,
    residual,
    distances,
):
    X_HL = np.empty((len(packed.parents), 4, 4))
    for n in range(len(X_OH)):
        pose_links(packed, q[n], X_HL)
        link_distances(sdf_values, origin, inv_spacing, packed, X_OH[n], X_HL, distances[n])
        count = find_contacts(
            sdf_values,
            origin,
            inv_spacing,
            packed,
            X_OH[n],
            X_HL,
            threshold,
            max_per_link,
            points[n],
            normals[n],
            links[n],
        )
        quality[n], residual[n] = 0.0, np.inf
        if count:
            wrenches = grasp_wrenches(points[n, :count], normals[n, :count], com, friction, edges, torsion, length)
            quality[n] = epsilon(wrenches)
            residual[n] = contact_forces(
                points[n, :count], normals[n, :count], com, friction, edges, torsion, length
            ).residual


def grasp_quality(
    hand: Hand,
    packed: PackedHand,
    obj: ObjectModel,
    *,
    X_OH: np.ndarray,
    q: np.ndarray,
    config: QualityConfig | None = None,
) -> GraspQuality:
    """Judge N grasps.

    Args:
        hand: names the fingers; packed: the same hand, its point spacing decides the resolution.
        obj: the object.
        X_OH: (N, 4, 4) float64, metres; q: (N, J) float64, rad or metres.
    Raises:
        ShapeError: `X_OH` or `q`.
    """
    config = config or QualityConfig()
    X_OH, q = np.ascontiguousarray(X_OH, np.float64), np.ascontiguousarray(q, np.float64)
    check_shape("X_OH", X_OH.shape, (None, 4, 4))
    check_shape("q", q.shape, (len(X_OH), hand.num_dofs))
    count, links = len(X_OH), hand.tree.num_links
    slots = links * config.max_per_link
    points, normals = np.full((count, slots, 3), np.nan), np.full((count, slots, 3), np.nan)
    contact_links = np.full((count, slots), -1, np.int32)
    quality, residual, distances = np.zeros(count), np.zeros(count), np.zeros((count, links))
    _judge(
        obj.sdf.values,
        obj.sdf.origin,
        obj.sdf.inv_spacing,
        packed,
        X_OH,
        q,
        np.asarray(obj.com_O, np.float64),
        obj.friction if config.friction is None else config.friction,
        config.edges,
        config.torsion_m,
        characteristic_length(obj.points_O, obj.com_O),
        config.threshold_m,
        config.max_per_link,
        points,
        normals,
        contact_links,
        quality,
        residual,
        distances,
    )
    used = int((contact_links >= 0).sum(axis=1).max(initial=0))
    return GraspQuality(
        epsilon=quality,
        force_residual=residual,
        depths=penetration_depths(packed, obj.sdf, obj.points_O, X_OH=X_OH, q=q),
        contact_distance_m=_finger_distance(hand, distances),
        touching_links=(distances < NEAR_M).sum(axis=1).astype(np.int32),
        contact_points_O=points[:, :used],
        contact_normals_O=normals[:, :used],
        contact_links=contact_links[:, :used],
    )


def _finger_distance(hand: Hand, distances: np.ndarray) -> np.ndarray:
    """(N,) mean over fingers of min(|distance|, 10 mm) of the finger's nearest link."""
    fingers = [f for f in hand.fingers if len(f.links)]
    if not fingers:
        return np.full(len(distances), FAR_M)
    nearest = np.stack([distances[:, list(f.links)].min(axis=1) for f in fingers], axis=1)
    return np.minimum(np.abs(nearest), FAR_M).mean(axis=1)
