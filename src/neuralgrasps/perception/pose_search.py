"""The search for a pose: coarse scores, Levenberg-Marquardt in three rounds, evidence of the image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.perception.observation import Observation
from neuralgrasps.perception.pose_kernels import Terms, coarse_scores, polish, slide
from neuralgrasps.perception.pose_model import PoseModel
from neuralgrasps.perception.pose_starts import start_poses
from neuralgrasps.perception.pose_visibility import COST, EVIDENCE, ray_evidence

_SAME_COSINE, _SAME_M = float(np.cos(np.deg2rad(8.0))), 0.010  # poses nearer than this are one
NO_CONTACTS = np.zeros((0, 4))
_ANY = -2.0  # every rotation of a ball is the same
_TABLE_DOUBT = 0.1  # a pose off the table must explain so much more of the view


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseConfig:
    """Knobs of `estimate_pose`.

    Attributes:
        yaw_steps: turns of every stable pose about the table's normal.
        coarse_points, coarse_model_points: observed points and points of the model in the coarse score.
        slid, coarse_kept, middle_kept, finalists: poses that survive each stage; wide: times so many where the best
            pose costs more than `wide_cost`.
        kernels_m: scale of the Geman-McClure loss in each round of polishing; points, model_points, steps likewise.
        clip_m: residuals count at most this much in coarse scores.
        tolerance_m: distance at which a point counts as half explained.
        free_weight, table_weight, rest_weight: weights of free space, of touching the table and of a stable pose on it.
        table_trust: factor of the last two in each round; at last the view decides: tables are found millimetres off.
        margin_m: what sensor noise may explain, at 1 m.
        ray_cells: about so many pixels of the mask are looked at in the image, in each round.
        contact_weight: weight of all contact points together, 3 mm accurate, as a share of that of the points.
        contact_share: cost of contacts that the object does not touch; they choose among poses that explain the view
            worse than the best by no more than this.
    """

    yaw_steps: int = 36
    coarse_points: int = 48
    coarse_model_points: int = 64
    slid: int = 300
    coarse_kept: int = 48
    middle_kept: int = 16
    finalists: int = 4
    wide: int = 4
    wide_cost: float = 0.30
    kernels_m: tuple[float, float, float] = (0.010, 0.006, 0.004)
    points: tuple[int, int, int] = (120, 250, 1000)
    model_points: tuple[int, int, int] = (64, 128, 384)
    steps: tuple[int, int, int] = (5, 8, 8)
    clip_m: float = 0.020
    tolerance_m: float = 0.005
    free_weight: float = 1.0
    table_weight: float = 0.1
    rest_weight: float = 0.05
    table_trust: tuple[float, float, float] = (1.0, 1.0, 0.1)
    margin_m: float = 0.006
    ray_cells: tuple[int, int, int] = (120, 200, 500)
    fine_weight: float = 0.4
    contact_weight: float = 0.1
    contact_share: float = 0.01

    def terms(self, stage: int) -> Terms:
        """What one round of polishing minimises."""
        trust = self.table_trust[stage]
        return Terms(
            self.kernels_m[stage], self.free_weight, trust * self.table_weight, trust * self.rest_weight, self.margin_m,
            self.points[stage], self.model_points[stage],
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Candidates:
    """Distinct poses, best first.

    Attributes:
        X_CO: (K, 4, 4). cost: (K,) lower is better. evidence: (K, 6), see `pose_visibility`.
    """

    X_CO: np.ndarray
    cost: np.ndarray
    evidence: np.ndarray


def search(model: PoseModel, scene: Observation, contacts: np.ndarray, config: PoseConfig) -> Candidates:
    """Poses of a model that explain an observation; contacts: (K, 4), see `normal_equations`."""
    starts = start_poses(model, scene, yaw_steps=config.yaw_steps)
    order = np.argsort(_coarse(model, scene, starts, config), kind="stable")
    found = _descend(model, scene, contacts, starts[order[: config.slid]], config, 1)
    if found.cost[0] <= config.wide_cost or config.wide <= 1:
        return found
    found = _cheaper(
        found, _descend(model, scene, contacts, starts[order[: config.wide * config.slid]], config, config.wide)
    )
    if found.cost[0] > config.wide_cost and scene.table.any():  # it may not rest on this table
        free = search(model, scene._replace(table=np.zeros(4)), contacts, config)
        return free if free.evidence[0, COST] < found.evidence[0, COST] - _TABLE_DOUBT else found
    return found


def _cheaper(one: Candidates, other: Candidates) -> Candidates:
    return other if other.cost[0] < one.cost[0] else one


def _descend(
    model: PoseModel, scene: Observation, contacts: np.ndarray, X: np.ndarray, config: PoseConfig, width: int
) -> Candidates:
    """From start poses to candidates, `width` times as many at each stage as the configuration says."""
    slide(model, scene, X, config.coarse_points, 3)
    X = _best(model, X, _coarse(model, scene, X, config), width * config.coarse_kept)
    cost = np.empty(len(X))
    polish(model, scene, contacts, config.terms(0), X, config.steps[0], cost)
    X = _best(model, X, cost, width * config.middle_kept)
    finalists = width * config.finalists
    X = polished(model, scene, contacts, X, config, 1).X_CO[:finalists]
    # what the object's near symmetry made equal so far is told apart now
    X = (X[:, None] @ model.turns).reshape(-1, 4, 4)
    X = polished(model, scene, contacts, X, config, 1).X_CO[:finalists]
    return polished(model, scene, contacts, X, config, 2)


def polished(
    model: PoseModel, scene: Observation, contacts: np.ndarray, X: np.ndarray, config: PoseConfig, stage: int
) -> Candidates:
    """Distinct poses after one round of polishing."""
    X = np.ascontiguousarray(X)
    cost = np.empty(len(X))
    polish(model, scene, contacts, config.terms(stage), X, config.steps[stage], cost)
    cost /= min(config.points[stage], len(scene.points)) * config.kernels_m[stage] ** 2
    evidence = evidence_of(model, scene, X, config, stage)
    cost = evidence[:, COST] + config.fine_weight * cost
    order = distinct(model, X, cost, len(X), model.same)  # of equal poses the copy that fits best
    return Candidates(X[order], cost[order], evidence[order])


def evidence_of(
    model: PoseModel, scene: Observation, X_CO: np.ndarray, config: PoseConfig, stage: int = 2
) -> np.ndarray:
    """(N, 6) evidence of the image for every pose."""
    out = np.empty((len(X_CO), EVIDENCE))
    stride = max(1, round(float(np.sqrt((scene.outside == 0.0).sum() / config.ray_cells[stage]))))
    ray_evidence(model, scene, X_CO, stride, config.tolerance_m, config.clip_m, config.margin_m, out)
    return out


def _coarse(model: PoseModel, scene: Observation, X: np.ndarray, config: PoseConfig) -> np.ndarray:
    cost = np.empty(len(X))
    coarse_scores(
        model, scene, X, config.coarse_points, config.coarse_model_points, config.clip_m, config.free_weight,
        config.margin_m, cost,
    )  # fmt: skip
    return cost


def _best(model: PoseModel, X: np.ndarray, cost: np.ndarray, count: int) -> np.ndarray:
    """The best `count` poses that differ; a first cut by cost alone keeps the comparison short."""
    first = np.argsort(cost, kind="stable")[: 4 * count]
    return X[first][distinct(model, X[first], cost[first], count, model.turns)]


def distinct(model: PoseModel, X: np.ndarray, cost: np.ndarray, count: int, turns: np.ndarray) -> np.ndarray:
    """Indices of at most `count` best poses that differ from every better one by 8 degrees or 10 mm.

    turns: (S, 4, 4) motions of the object that count as none.
    """
    order = np.argsort(cost, kind="stable")
    kept = np.zeros(count, np.int64)
    cosine = _ANY if model.is_ball else _SAME_COSINE
    found = _suppress(X[order], turns, model.axis, model.centre, cosine, _SAME_M, kept)
    return order[kept[:found]]


def same_pose(model: PoseModel, X: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """(N,) for each pose X (N, 4, 4) the first of the chosen (K, 4, 4) that it equals up to the object's symmetry."""
    near = (model.same, model.axis, model.centre, _ANY if model.is_ball else _SAME_COSINE, _SAME_M)
    return np.array([next((k for k, c in enumerate(chosen) if _alike(one, c, *near)), 0) for one in X])


@njit(cache=True, error_model="numpy")
def _suppress(X, turns, axis, centre, cosine, distance, kept):  # type: ignore[no-untyped-def]
    found = 0
    for i in range(X.shape[0]):
        fresh = True
        for k in range(found):
            if _alike(X[i], X[kept[k]], turns, axis, centre, cosine, distance):
                fresh = False
                break
        if fresh:
            kept[found] = i
            found += 1
            if found == kept.shape[0]:
                break
    return found


@njit(cache=True, error_model="numpy")
def _alike(A, B, turns, axis, centre, cosine, distance):  # type: ignore[no-untyped-def]
    """Whether two poses agree up to the given motions of the object and turns about its axis."""
    gap = 0.0
    for r in range(3):
        d = A[r, 3] - B[r, 3]
        for c in range(3):
            d += (A[r, c] - B[r, c]) * centre[c]
        gap += d * d
    if gap > distance * distance:
        return False
    M = np.zeros((3, 3))  # B in A
    for r in range(3):
        for c in range(3):
            for k in range(3):
                M[r, c] += A[k, r] * B[k, c]
    is_round = axis[0] != 0.0 or axis[1] != 0.0 or axis[2] != 0.0
    for s in range(turns.shape[0]):
        agreement = 0.0
        for r in range(3):
            for c in range(3):
                if is_round:
                    e = turns[s, c, 0] * axis[0] + turns[s, c, 1] * axis[1] + turns[s, c, 2] * axis[2]
                    agreement += axis[r] * M[r, c] * e
                else:
                    agreement += 0.5 * M[r, c] * turns[s, r, c]
        if (agreement if is_round else agreement - 0.5) > cosine:
            return True
    return False
