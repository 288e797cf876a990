"""From start poses to assessed grasps: close, find contacts, epsilon, penetration."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numba import njit

from neuralgrasps.grasps.contact import find_contacts
from neuralgrasps.grasps.epsilon import epsilon, epsilon_upper_bound
from neuralgrasps.grasps.penetration import object_points_in_hand, self_penetration
from neuralgrasps.grasps.probe_points import ProbePoints, probe_hand, probe_surface
from neuralgrasps.grasps.wrench_space import characteristic_length, fill_grasp_wrenches
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import PackedHand, pack_hand, pose_links
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.synthesis.close import Closing, close_fingers, close_jaw, make_closing
from neuralgrasps.synthesis.clusters import Clusters, cluster_points, hand_clearance

CONE_EDGES = 8
CONTACTS_PER_LINK = 3
SPACING_M = 0.004  # of the hand's surface points; at 9 mm, round links overlap by 2 mm between the points
PROBE_SPACING_M = 0.002  # of the points, and along the edges, that look for overlap between those
# Outcome of one candidate, from first to last obstacle.
COLLIDES, FEW_CONTACTS, NO_FORCE_CLOSURE, PENETRATES, SELF_COLLIDES, VALID = range(6)
OUTCOMES = ("collides", "few contacts", "no force closure", "penetrates", "self-collides", "valid")


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidates:
    """Closed hands around one object.

    Attributes:
        X_OH: (N, 4, 4); q: (N, J) after closing; q_start: (N, J) before it.
        epsilon: (N,) Ferrari-Canny quality, 0 unless the outcome is VALID.
        penetration_m: (N,) deepest overlap found, metres; 0 for candidates that failed before it was measured.
        outcome: (N,) int8, one of `OUTCOMES`.
    """

    X_OH: np.ndarray
    q: np.ndarray
    q_start: np.ndarray
    epsilon: np.ndarray
    penetration_m: np.ndarray
    outcome: np.ndarray

    def __len__(self) -> int:
        return len(self.q)

    def take(self, index: np.ndarray) -> Candidates:
        """The candidates at `index` (mask or integers)."""
        return Candidates(**{f.name: getattr(self, f.name)[index] for f in fields(self)})

    @staticmethod
    def join(parts: list[Candidates]) -> Candidates:
        """All candidates of `parts`, in order."""
        return Candidates(**{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Candidates)})


@dataclass(frozen=True, slots=True, kw_only=True)
class GraspProblem:
    """One hand and one object, packed for the compiled kernels."""

    hand: Hand
    obj: ObjectModel
    packed: PackedHand
    probe: ProbePoints
    hand_probe: PackedHand
    clusters: Clusters
    closing: Closing
    length: float
    friction: float
    torsion: float
    contact_threshold_m: float
    max_penetration_m: float

    @property
    def sdf_arrays(self) -> tuple[np.ndarray, np.ndarray, float]:
        return self.obj.sdf.values, self.obj.sdf.origin, self.obj.sdf.inv_spacing


def make_problem(
    hand: Hand,
    obj: ObjectModel,
    *,
    spacing: float = SPACING_M,
    friction: float,
    torsion: float,
    contact_threshold_m: float,
    max_penetration_m: float,
) -> GraspProblem:
    """Pack `hand` and `obj`.

    Args:
        hand, obj: the pair.
        spacing: of the hand's surface points, metres.
        friction: Coulomb coefficient; torsion: torsional friction, metres.
        contact_threshold_m, max_penetration_m: see `SynthesisConfig`.
    """
    packed, clusters = cluster_points(pack_hand(hand, spacing=spacing))
    return GraspProblem(
        hand=hand,
        obj=obj,
        packed=packed,
        probe=probe_surface(obj.mesh, spacing=PROBE_SPACING_M),
        hand_probe=probe_hand(hand, spacing=PROBE_SPACING_M),
        clusters=clusters,
        closing=make_closing(hand),
        length=characteristic_length(obj.points_O, obj.com_O),
        friction=friction,
        torsion=torsion,
        contact_threshold_m=contact_threshold_m,
        max_penetration_m=max_penetration_m,
    )


@njit(cache=True, error_model="numpy")
def _open_idle(packed, closing, contact_links, q_start, q, X_HL):  # type: ignore[no-untyped-def]
    """Open the fingers that touch nothing to where they started, so that they are out of the others' way.

    Returns whether any joint moved; `q` and `X_HL` change.
    """
    busy = np.zeros(closing.groups, np.bool_)
    for link in contact_links:
        if closing.link_group[link] >= 0:
            busy[closing.link_group[link]] = True
    moved = False
    for j in range(q.shape[0]):
        if closing.group[j] >= 0 and not busy[closing.group[j]] and q[j] != q_start[j]:
            q[j] = q_start[j]
            moved = True
    if moved:
        pose_links(packed, q, X_HL)
    return moved


@njit(cache=True, error_model="numpy")
def _close_and_assess(  # type: ignore[no-untyped-def]
    values, origin, inv_spacing, packed, clusters, closing, is_jaw, probe, com, length, friction, torsion, threshold,
    max_penetration, q_start, X_OH, q, eps, penetration, outcome,
):  # fmt: skip
    links = packed.link_radius.shape[0]
    X_HL = np.zeros((links, 4, 4))
    room = links * CONTACTS_PER_LINK
    points, normals = np.empty((room, 3)), np.empty((room, 3))
    contact_links = np.empty(room, np.int32)
    wrenches = np.empty((room * (CONE_EDGES + 2), 6))
    for i in range(q.shape[0]):
        eps[i] = 0.0
        penetration[i] = 0.0
        if is_jaw:
            closed = close_jaw(values, origin, inv_spacing, packed, clusters, closing, X_OH[i], q[i], X_HL)
        else:
            closed = close_fingers(values, origin, inv_spacing, packed, clusters, closing, X_OH[i], q[i], X_HL)
        if not closed:
            outcome[i] = COLLIDES
            continue
        count = find_contacts(
            values, origin, inv_spacing, packed, X_OH[i], X_HL, threshold, CONTACTS_PER_LINK,
            points, normals, contact_links,
        )  # fmt: skip
        touching = 0
        for c in range(count):
            if c == 0 or contact_links[c] != contact_links[c - 1]:
                touching += 1
        if touching < 2:
            outcome[i] = FEW_CONTACTS
            continue
        rows = fill_grasp_wrenches(points, normals, count, com, friction, CONE_EDGES, torsion, length, wrenches)
        if epsilon_upper_bound(wrenches[:rows]) <= 0.0:
            outcome[i] = NO_FORCE_CLOSURE
            continue
        quality = epsilon(wrenches[:rows], 8)
        if quality <= 0.0:
            outcome[i] = NO_FORCE_CLOSURE
            continue
        own_depth = self_penetration(packed, X_HL)
        if own_depth > max_penetration and _open_idle(packed, closing, contact_links[:count], q_start[i], q[i], X_HL):
            own_depth = self_penetration(packed, X_HL)
        depth = max(
            -hand_clearance(values, origin, inv_spacing, packed, clusters, X_OH[i], X_HL),
            object_points_in_hand(probe, packed, X_OH[i], X_HL),
        )
        penetration[i] = max(depth, 0.0)
        if depth > max_penetration:
            outcome[i] = PENETRATES
            continue
        penetration[i] = max(penetration[i], own_depth)
        if own_depth > max_penetration:
            outcome[i] = SELF_COLLIDES
            continue
        eps[i] = quality
        outcome[i] = VALID


def close_and_assess(problem: GraspProblem, X_OH: np.ndarray, q: np.ndarray) -> Candidates:
    """Close every hand from its start (N poses and postures) and assess it."""
    hand, obj = problem.hand, problem.obj
    X_OH, q_start = np.ascontiguousarray(X_OH).copy(), np.ascontiguousarray(q)
    closed, count = q_start.copy(), len(q_start)
    eps, depth, outcome = np.zeros(count), np.zeros(count), np.zeros(count, np.int8)
    _close_and_assess(
        *problem.sdf_arrays, problem.packed, problem.clusters, problem.closing, hand.is_jaw, problem.probe, obj.com_O,
        problem.length, problem.friction, problem.torsion, problem.contact_threshold_m, problem.max_penetration_m,
        q_start, X_OH, closed, eps, depth, outcome,
    )  # fmt: skip
    return Candidates(X_OH=X_OH, q=closed, q_start=q_start, epsilon=eps, penetration_m=depth, outcome=outcome)
