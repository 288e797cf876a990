"""Codes and candidate grasps from contact points alone: where an object should be touched, nothing of the hand.

Closeness to a few contact points is less than closeness to a hand, which is near the object without touching, too. How
much less, and where, is regressed from known grasps: of each both the contact points and the whole hand are known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial.distance import cdist

from neuralgrasps.dataset.hand_surface import packed_link_poses
from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.geometry.sdf_grid import SdfGrid
from neuralgrasps.grasps.contact import MAX_PER_LINK, THRESHOLD_M, find_contacts
from neuralgrasps.hands.packed import PackedHand, hand_distance_many
from neuralgrasps.model.codes import CodeBook
from neuralgrasps.model.fit_kernels import FitProblem
from neuralgrasps.model.fit_prior import DEPTH_SD_M, GraspPrior, grasp_prior
from neuralgrasps.model.fit_solver import fit_starts
from neuralgrasps.model.infer import check_kinematic, contact_codes, map_of_points
from neuralgrasps.model.kinematic_field import KinematicField

KERNEL_WIDTH = 0.3  # of mean |closeness| differences, over which corrections are alike
OTHER_HAND = 0.8  # how much a known grasp by another hand says, against one by the same
RIDGE = 0.2
CONTACT_SD_M = 0.002  # contacts are said to lie on the hand to so much
_ITERATIONS = 30
_TESTS = " (test grasps count with include_test=True only)"


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactResult:
    """What contact points say of N grasps, K candidates each, best first.

    Attributes:
        codes: contact blocks and maps as estimated; palm and posture blocks are nan.
        rows: (N, K) int64 places in the gallery of the candidates, nearest by contact block.
        X_OH: (N, K, 4, 4) hand base in the object frame, q: (N, K, J): the candidates, moved so that the hand meets the
            contacts if asked to.
        miss_m: (N, K) mean distance of the contacts to the candidate's surface, metres.
    """

    codes: CodeBook
    rows: np.ndarray
    X_OH: np.ndarray
    q: np.ndarray
    miss_m: np.ndarray


def encode_contacts(
    contact_points_O: Sequence[np.ndarray],
    field: KinematicField,
    gallery: CodeBook,
    *,
    hand: str,
    object_name: str,
    candidates: int = 5,
    refine: bool = True,
    include_test: bool = False,
) -> ContactResult:
    """Codes and candidate grasps of a hand that should touch an object at given points.

    Args:
        contact_points_O: N sets of points (C, 3) on the object, object frame, metres; rows with nan are left out.
        gallery: known codes on this object, by any hands; some by `hand`.
        candidates: at most so many grasps of `hand` per set of points.
        refine: move the candidates so that their surface meets the points, out of the object, postures as usual.
        include_test: learn from and choose among the gallery's test grasps too.
    Raises:
        InputError: no grasp of that hand on that object in the gallery, one of another kind of field, no set of
            points, or one without points.
        ShapeError: a set is not (C, 3).
    """
    if not len(contact_points_O):
        raise InputError("got no contact points; expected a sequence of at least one array (C, 3).")
    contacts = [_checked_contacts(c, i) for i, c in enumerate(contact_points_O)]
    known = _known_grasps(field, gallery, object_name, include_test=include_test)
    own = np.flatnonzero(known.hand == hand)
    field.hand(hand)
    if not len(own):
        raise InputError(f"the gallery holds no grasp of '{object_name}' by hand '{hand}'{_TESTS}; add some.")
    seen = np.stack([map_of_points(field, object_name, c) for c in contacts])
    maps = _corrected(seen, known, np.full(len(seen), hand))
    codes = contact_codes(maps, field, object_name=object_name, hand=hand)
    rows = known.rows[own]
    near = cdist(codes.contact_block, gallery.contact_block[rows], "cityblock")
    chosen = np.argsort(near, axis=1, kind="stable")[:, :candidates]
    X_own, q_own = known.X_OH[hand], known.q[hand]
    X_OH, q = X_own[chosen], q_own[chosen]
    packed, sdf = field.packed[hand], field.object(object_name).sdf
    if refine:
        prior = grasp_prior(packed, sdf, X_own, q_own)
        for i, points in enumerate(contacts):
            problem = _contact_problem(packed, sdf, prior, points)
            cost, done = np.empty(len(q[i])), np.zeros(len(q[i]), np.bool_)
            fit_starts(packed, problem, X_OH[i], q[i], _ITERATIONS, cost, done)
            order = np.argsort(cost, kind="stable")
            X_OH[i], q[i], chosen[i] = X_OH[i][order], q[i][order], chosen[i][order]
    miss = [[_miss(packed, X, p, points) for X, p in zip(Xs, ps, strict=True)]
            for Xs, ps, points in zip(X_OH, q, contacts, strict=True)]  # fmt: skip
    return ContactResult(codes=codes, rows=rows[chosen], X_OH=X_OH, q=q, miss_m=np.array(miss))


def hand_contacts(packed: PackedHand, sdf: SdfGrid, X_OH: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(C, 3) points of the object that one posed hand touches, object frame, as grasp sets list them."""
    room = MAX_PER_LINK * len(packed.parents)
    points, normals, links = np.empty((room, 3)), np.empty((room, 3)), np.empty(room, np.int32)
    count = find_contacts(
        sdf.values, sdf.origin, sdf.inv_spacing, packed, X_OH, packed_link_poses(packed, q), THRESHOLD_M, MAX_PER_LINK,
        points, normals, links,
    )  # fmt: skip
    return points[:count]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Known:
    """Gallery grasps on one object that touch it: rows (G,), hand names (G,), maps of contacts and of hands (G, P).

    X_OH, q: pose and joints of the grasps, by hand, in the order of `rows`.
    """

    rows: np.ndarray
    hand: np.ndarray
    of_contacts: np.ndarray
    of_hand: np.ndarray
    X_OH: dict[str, np.ndarray]
    q: dict[str, np.ndarray]


def _known_grasps(field: KinematicField, gallery: CodeBook, object_name: str, *, include_test: bool) -> _Known:
    check_kinematic(gallery)
    sdf = field.object(object_name).sdf
    if object_name not in gallery.objects:
        raise InputError(f"the gallery holds no grasp of '{object_name}'; add some to learn from.")
    rows, hands, of_contacts, X_all, q_all = [], [], [], {}, {}
    for hand in gallery.hands:
        mine = np.flatnonzero(gallery.where(hand=hand, object_name=object_name) & (include_test | ~gallery.is_test))
        if not len(mine) or hand not in field.hands:
            continue
        with torch.no_grad():
            codes = torch.as_tensor(gallery.values[mine].astype(np.float64))
            grasps = field.decode(codes, hand=hand, object_name=object_name)
        X_OH, q = grasps.X_OH.numpy(), grasps.q.numpy()
        points = [hand_contacts(field.packed[hand], sdf, a, b) for a, b in zip(X_OH, q, strict=True)]
        touching = np.array([len(p) > 0 for p in points])
        rows.append(mine[touching])
        hands += [hand] * int(touching.sum())
        of_contacts += [map_of_points(field, object_name, p) for p in points if len(p)]
        X_all[hand], q_all[hand] = X_OH[touching], q[touching]
    every = np.concatenate(rows) if rows else np.zeros(0, np.int64)
    if not len(every):
        raise InputError(f"the gallery holds no grasp that touches '{object_name}'{_TESTS}; add some.")
    return _Known(
        rows=every, hand=np.array(hands), of_contacts=np.stack(of_contacts), of_hand=gallery.contact_maps[every],
        X_OH=X_all, q=q_all,
    )  # fmt: skip


def _corrected(seen: np.ndarray, known: _Known, hand: np.ndarray) -> np.ndarray:
    """Maps (N, P) of whole hands from maps of contacts: kernel ridge regression of the difference."""

    def kernel(a: np.ndarray, hand_a: np.ndarray) -> np.ndarray:
        far = cdist(a, known.of_contacts, "cityblock") / a.shape[1]
        return np.exp(-far / KERNEL_WIDTH) * np.where(hand_a[:, None] == known.hand[None], 1.0, OTHER_HAND)

    difference = (known.of_hand - known.of_contacts).astype(np.float64)
    mean = difference.mean(axis=0)
    gram = kernel(known.of_contacts, known.hand) + RIDGE * np.eye(len(known.hand))
    return np.clip(seen + mean + kernel(seen, hand) @ np.linalg.solve(gram, difference - mean), 0.0, 1.0)


def _contact_problem(packed: PackedHand, sdf: SdfGrid, prior: GraspPrior, points_O: np.ndarray) -> FitProblem:
    unit = CONTACT_SD_M**2 / len(points_O)
    nothing = np.zeros(0, np.int64)
    return FitProblem(
        points_O=points_O, object_weight=np.zeros(len(points_O)), width=0.01, material=nothing,
        cover=np.zeros(0), seen_O=points_O, cover_free=0.0,
        cover_width=0.01, q_mean=prior.q_mean, q_precision=prior.q_precision, q_freedom=5.0, q_unit=unit,
        probe=prior.probe, touch_mean=prior.touch_mean, touch_weight=unit / prior.touch_sd**2, touch_width=0.0015,
        depth_weight=unit / DEPTH_SD_M**2, depth_width=0.003, depth_free=0.001, sdf_values=sdf.values,
        sdf_origin=sdf.origin, sdf_inv_spacing=sdf.inv_spacing,
    )  # fmt: skip


def _miss(packed: PackedHand, X_OH: np.ndarray, q: np.ndarray, points_O: np.ndarray) -> float:
    out = np.empty(len(points_O))
    hand_distance_many(packed, X_OH, q, points_O, out)
    return float(np.abs(out).mean())


def _checked_contacts(points_O: np.ndarray, index: int) -> np.ndarray:
    points = np.array(points_O, np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ShapeError(f"contact points {index} have shape {points.shape}; expected (C, 3).")
    points = np.ascontiguousarray(points[np.isfinite(points).all(axis=1)])
    if not len(points):
        raise InputError(f"contact points {index} hold no finite point; expected at least one.")
    return points
