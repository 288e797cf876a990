"""Why a transferred grasp ranks where it does, why there are few, and why a hand cannot touch an object as asked."""

from __future__ import annotations

import math

import numpy as np

from neuralgrasps.apply.transfer_config import TransferConfig
from neuralgrasps.apply.transfer_order import Candidate
from neuralgrasps.apply.transfer_query import TransferQuery
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.synthesis.candidates import GraspProblem
from neuralgrasps.synthesis.feasibility import JAW_CLEARANCE_M, hand_span

TOUCHED_M = 0.003  # points of the query nearer to its hand than this are touched
_OPPOSED = -0.7  # cosine between the normals of two touched points that are squeezed between
_ALONG = 0.8  # cosine between these normals and the way from one point to the other
_SIDE = 0.8  # cosine to a side's middle normal of what still belongs to the side
_SHARE = 0.1  # of the touched points that a side needs to count
_MOST = 400  # touched points that are looked at


def why_here(place: int, item: Candidate, similarity: float, oracle: float, protocol: str) -> str:
    """One line: what it is, how alike, against what, and that it held."""
    rank = "most alike" if place == 0 else f"number {place + 1} in likeness"
    turned = " turned by the object's symmetry" if item.symmetry else ""
    known = "the query's palm pose" if item.source < 0 else f"row {item.source} of the known grasps{turned}"
    what = f"generated from {known}" if item.origin == "generated" else known
    beside = f" against {oracle:.2f} of the best known" if math.isfinite(oracle) else ""
    return f"{rank}, {what}; similarity {similarity:.2f}{beside}; held in {protocol}"


def why_short(config: TransferConfig, *, found: int, tried: int, known: GraspSet, allowed: int, ruled: bool) -> str:
    """Why fewer grasps than wanted were found.

    Args:
        known: the known grasps; allowed: how many of them the rules allow; ruled: whether there are rules.
    """
    said = [f"{found} of {config.count} grasps found"]
    if shortfall := known.config.get("shortfall", ""):
        said.append(str(shortfall).rstrip("."))
    elif len(known) == 0:
        said.append("no grasp of this hand on this object is known")
    elif ruled and allowed == 0:
        said.append(f"none of {len(known)} known grasps is allowed by the constraints")
    if tried >= config.trials:
        said.append(f"{tried} tried in physics, the most that were to be tried")
    elif tried > found:
        said.append(f"{tried - found} of {tried} tried did not hold in {config.protocol}")
    return "; ".join(said)


def why_unlike(query: TransferQuery, problem: GraspProblem, similarity: float | None) -> str:
    """Why the hand cannot touch the object as asked, where that is plain, and what comes nearest."""
    causes = [text for text in (_too_wide(query, problem), _too_many_sides(query, problem)) if text]
    nearest = "" if similarity is None else f"the nearest feasible grasp has similarity {similarity:.2f}"
    cause = "; ".join(causes) if causes else f"hand '{problem.hand.name}' found no grasp with these contacts"
    return f"{cause}; {nearest}" if nearest else cause


def _touched(query: TransferQuery, problem: GraspProblem) -> tuple[np.ndarray, np.ndarray]:
    """Points (M, 3) that the query touches, and their outward normals."""
    rows = np.flatnonzero(query.contact_map >= math.exp(-TOUCHED_M / query.radius_m))
    rows = rows[:: max(1, -(-len(rows) // _MOST))]
    return query.points_O[rows], problem.obj.normals_O[rows]


def squeezed_width(query: TransferQuery, problem: GraspProblem) -> float:
    """Least distance, metres, between touched points that face away from each other; nan where none do."""
    points, normals = _touched(query, problem)
    way = points[None] - points[:, None]
    width = np.linalg.norm(way, axis=2)
    along = np.einsum("ijk,jk->ij", way, normals) / np.maximum(width, 1e-9)
    pairs = (normals @ normals.T < _OPPOSED) & (along > _ALONG)
    return float(np.quantile(width[pairs], 0.05)) if pairs.any() else float("nan")


def touched_sides(query: TransferQuery, problem: GraspProblem) -> int:
    """Number of directions that the touched surface faces, each by a tenth of it."""
    _, normals = _touched(query, problem)
    left, sides = np.ones(len(normals), bool), 0
    near = normals @ normals.T > _SIDE
    while left.any():
        size = (near & left[None]).sum(axis=1) * left
        middle = int(size.argmax())
        if size[middle] < max(_SHARE * len(normals), 1):
            break
        sides += 1
        left &= ~near[middle]
    return sides


def _too_wide(query: TransferQuery, problem: GraspProblem) -> str:
    width, span = squeezed_width(query, problem), hand_span(problem.hand, problem)
    if not width > span - (JAW_CLEARANCE_M if problem.hand.is_jaw else 0.0):
        return ""
    what = "opens" if problem.hand.is_jaw else "spans"
    return (
        f"the query holds '{query.object}' across {1e3 * width:.0f} mm, hand '{problem.hand.name}' {what} "
        f"{1e3 * span:.0f} mm"
    )


def _too_many_sides(query: TransferQuery, problem: GraspProblem) -> str:
    sides = touched_sides(query, problem)
    if not problem.hand.is_jaw or sides < 3:
        return ""
    return f"the query touches '{query.object}' from {sides} sides, the jaw of hand '{problem.hand.name}' from two"
