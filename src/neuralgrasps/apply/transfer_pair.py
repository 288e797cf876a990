"""What a transfer needs of a hand, an object and the known grasps, made once and kept: packed shapes, maps, a trial."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from neuralgrasps.apply.novel_trial import novel_problem
from neuralgrasps.apply.transfer_kernels import Hands, Target, margins
from neuralgrasps.apply.transfer_query import TransferQuery
from neuralgrasps.geometry.sampling import farthest_points
from neuralgrasps.grasps.contact_map import contact_map_packed
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.fingerprint import fingerprint, hand_fingerprint
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import PackedHand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.grasp_cache import pair_fingerprint
from neuralgrasps.sim.build import grasp_model
from neuralgrasps.sim.grasp_trial import GraspTrial
from neuralgrasps.sim.protocols import get_protocol
from neuralgrasps.synthesis.assess import Cone
from neuralgrasps.synthesis.candidates import GraspProblem
from neuralgrasps.synthesis.contacts import TOUCH_M
from neuralgrasps.synthesis.prepared import Memory, prepare_hand
from neuralgrasps.synthesis.squeeze import PREGRASP_JAW_M, PREGRASP_RAD, joint_scale

SPARSE = 256  # contact points that the search compares maps at; results are compared at all
PROBES_M = 0.008  # spacing of the hand's points that the descent keeps out of the object
SLIPPERY = 0.5  # share of the friction at which grasps are compared by how well they would hold
COMPARED = 300  # known grasps that are compared with each other, at most
CLOSING_OVERLAP_M = 0.001  # that closing may leave; settling takes it away


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TransferPair:
    """One hand and one object under one protocol.

    Attributes:
        problem: as `synthesise` sees it; searching: the same, judged by what counts as contact when finished;
            probes: fewer points on the hand, that the descent keeps out of the object.
        hands: how the hand opens. sparse: (M,) rows of the object's contact points that the search looks at.
        slippery: contacts with `SLIPPERY` of the friction.
        turned: (S, M) the contact point nearest to where each of the sparse ones goes by each symmetry.
        trial: ready to try grasps; not for two threads at once.
    """

    problem: GraspProblem
    searching: GraspProblem
    probes: PackedHand
    hands: Hands
    slippery: Cone
    sparse: np.ndarray
    turned: np.ndarray
    trial: GraspTrial


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KnownMaps:
    """Known grasps with their contact maps (N, P) float32, and the largest distance between two of them (`widest`).

    `margins` (N,) say how well they would hold where it is slippery, see `transfer_kernels.margin`.
    """

    grasps: GraspSet
    maps: np.ndarray
    widest: float
    margins: np.ndarray


_PAIRS = Memory[TransferPair](most=40)
_KNOWN = Memory[KnownMaps](most=80)


def transfer_pair(hand: Hand, obj: ObjectModel, protocol: str) -> TransferPair:
    """The pair, kept for the next transfer."""
    shape = fingerprint((obj.points_O, obj.symmetry.rotations))
    return _PAIRS.get(
        f"{pair_fingerprint(hand, obj)} {shape} {protocol}", lambda: _made_pair(hand, obj, protocol)
    )  # fmt: skip


def known_maps(pair: TransferPair, grasps: GraspSet, radius_m: float) -> KnownMaps:
    """Contact maps of known grasps at the object's contact points, kept for the next transfer."""
    problem = pair.problem
    contacts = grasps.contact_points_O, grasps.contact_normals_O, grasps.contact_links
    held = (*pair.slippery, *contacts)
    key = fingerprint((hand_fingerprint(problem.hand), problem.obj.points_O, grasps.X_OH, grasps.q, radius_m, *held))

    def make() -> KnownMaps:
        maps = contact_map_packed(problem.obj.points_O, problem.packed, grasps.X_OH, grasps.q, radius=radius_m)
        return KnownMaps(grasps=grasps, maps=maps, widest=widest(maps), margins=margins(pair.slippery, *contacts))

    return replace(_KNOWN.get(key, make), grasps=grasps)


def widest(maps: np.ndarray, weight: np.ndarray | None = None) -> float:
    """Largest mean absolute difference between two of the contact maps (N, P), 0 where there are no two.

    Of more than `COMPARED` maps so many are compared, evenly spread over their order; the time would grow with N².

    Args:
        weight: (P,) of the points, of sum 1; None: all count alike.
    """
    if len(maps) > COMPARED:
        maps = maps[np.linspace(0, len(maps) - 1, COMPARED).round().astype(np.int64)]
    largest = 0.0
    for i in range(len(maps) - 1):
        apart = np.abs(maps[i + 1 :] - maps[i])
        mean = apart.mean(axis=1) if weight is None else apart @ weight.astype(apart.dtype)
        largest = max(largest, float(mean.max()))
    return largest


def forget() -> None:
    """Drop what is kept in memory."""
    _PAIRS.clear()
    _KNOWN.clear()


def _made_pair(hand: Hand, obj: ObjectModel, protocol: str) -> TransferPair:
    problem = novel_problem(hand, obj, protocol)
    searching = replace(problem, max_penetration_m=CLOSING_OVERLAP_M, contact_threshold_m=TOUCH_M)
    tools = prepare_hand(hand, spacing=PROBES_M)
    rates = np.abs(hand.closing_rate) / max(float(np.abs(hand.closing_rate).max()), 1e-9)
    step = np.sign(hand.closing_rate) * joint_scale(hand, PREGRASP_RAD, PREGRASP_JAW_M) * rates
    hands = Hands(
        step=np.ascontiguousarray(step, np.float64),
        approach_H=np.ascontiguousarray(hand.X_HP[:3, 2], np.float64),
        q_open=np.ascontiguousarray(hand.q_open, np.float64),
    )
    points = np.ascontiguousarray(obj.points_O, np.float64)
    sparse = farthest_points(points, min(SPARSE, len(points)))
    tree = KDTree(points)
    turned = [tree.query(points[sparse] @ X[:3, :3].T + X[:3, 3])[1] for X in obj.symmetry.rotations]
    chosen = get_protocol(protocol)
    return TransferPair(
        problem=problem,
        searching=searching,
        probes=tools.packed,
        hands=hands,
        slippery=Cone(problem.obj.com_O, problem.length, SLIPPERY * problem.friction, SLIPPERY * problem.torsion),
        sparse=sparse,
        turned=np.stack(turned),
        trial=GraspTrial(hand, obj, chosen, model=grasp_model(hand, obj, chosen)),
    )


def target_of(query: TransferQuery, rows: np.ndarray | None = None) -> Target:
    """The query as compiled code reads it, at all its points or at some."""
    chosen = slice(None) if rows is None else rows
    weight = query.weight[chosen]
    return Target(
        points=np.ascontiguousarray(query.points_O[chosen], np.float64),
        closeness=np.ascontiguousarray(query.contact_map[chosen], np.float64),
        weight=np.ascontiguousarray(weight / weight.mean(), np.float64),
        inv_radius=1.0 / query.radius_m,
    )
