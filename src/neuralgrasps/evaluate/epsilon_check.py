"""The fast epsilon against Qhull, on contacts of real grasps."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from neuralgrasps.grasps.epsilon import epsilon, epsilon_qhull
from neuralgrasps.grasps.force_qp import edge_forces
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.grasps.wrench_space import characteristic_length, grasp_wrenches
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.parallel import available_cpus, run_tasks
from neuralgrasps.seeds import child_rng

EDGES = 8
_REPEATS = 3  # the fastest counts: other processes interrupt
_CHUNK = 25


@dataclass(frozen=True, slots=True, kw_only=True)
class EpsilonCheck:
    """Fast against slow, over `count` sets of wrenches; times are per set, by call from Python, milliseconds.

    Attributes:
        force_closure: how many are, by Qhull.
        sign_errors: how many the fast one takes for force closure and Qhull does not, or the other way round.
        max_difference: largest absolute difference. differing: how many differ by over 1e-6.
        ms_median, ms_mean: over all; closure_ms_median, closure_ms_mean: over those in force closure, which cost most.
        qhull_ms_median, qhull_ms_mean: of Qhull, over all, other processes beside it.
        qp_ms_median, qp_ms_mean: of the force programme, over all.
        qp_residual_max: largest net wrench it leaves in force closure, for a unit squeeze.
        qp_not_converged: how many it stopped early on.
        wrenches_median: wrenches per set.
    """

    count: int
    force_closure: int
    sign_errors: int
    max_difference: float
    differing: int
    ms_median: float
    ms_mean: float
    closure_ms_median: float
    closure_ms_mean: float
    qhull_ms_median: float
    qhull_ms_mean: float
    qp_ms_median: float
    qp_ms_mean: float
    qp_residual_max: float
    qp_not_converged: int
    wrenches_median: float


def grasp_wrench_sets(
    sets: Sequence[GraspSet], objects: Mapping[str, ObjectModel], *, count: int, seed: int = 0
) -> list[np.ndarray]:
    """`count` sets (W, 6) of the wrenches of grasps that were synthesised, in force closure and not.

    Evenly from all sets, each grasp in turn: of every four, two as they are, one without the contacts of some links,
    one with a tenth to six tenths of the friction. Friction and torsion are those that the grasps were made with.

    Args:
        sets: of any hands; their objects by name in `objects`.
    """
    filled = [g for g in sets if len(g)]
    if not filled:
        return []
    rng = child_rng(seed, "epsilon check")
    found = []
    for i in range(count):
        grasps = filled[i % len(filled)]
        obj = objects[grasps.object]
        k = (i // len(filled)) % len(grasps)
        links = grasps.contact_links[k]
        used = links >= 0
        scale = 1.0
        # not i % 4: with an even number of sets each would meet the same case for ever
        case = int(rng.integers(4))
        if case == 2:
            touching = np.unique(links[used])
            kept = rng.permutation(touching)[: rng.integers(1, max(2, len(touching)))]
            used &= np.isin(links, kept)
        elif case == 3:
            scale = rng.uniform(0.1, 0.6)
        found.append(
            grasp_wrenches(
                grasps.contact_points_O[k][used],
                grasps.contact_normals_O[k][used],
                np.asarray(obj.com_O, np.float64),
                scale * float(grasps.config["friction"]),
                EDGES,
                scale * float(grasps.config["torsion_m"]),
                characteristic_length(obj.points_O, obj.com_O),
            )
        )
    return found


def check_epsilon(
    wrench_sets: Sequence[np.ndarray],
    *,
    workers: int | None = None,
    progress: Callable[[int, int, str], None] | None = None,
) -> EpsilonCheck:
    """Compare and time `epsilon` and Qhull on the same wrenches; Qhull runs on worker processes, after.

    Args:
        wrench_sets: at least one (W, 6). workers: processes for Qhull; the timed calls are made in this one.
    """
    epsilon(wrench_sets[0]), edge_forces(wrench_sets[0])  # loads the compiled loops
    fast, fast_ms = _timed(epsilon, wrench_sets)
    forces, qp_ms = _timed(edge_forces, wrench_sets)
    residual = np.array([np.linalg.norm(f @ w) for (f, _), w in zip(forces, wrench_sets, strict=True)])
    chunks = [(list(wrench_sets[i : i + _CHUNK]),) for i in range(0, len(wrench_sets), _CHUNK)]
    done: dict[int, Any] = {}
    for index, result in run_tasks(_qhull, chunks, workers=workers or available_cpus()):
        done[index] = result
        if progress is not None:
            progress(len(done), len(chunks), "Qhull")
    slow, slow_ms = (np.concatenate([done[i][k] for i in range(len(chunks))]) for k in range(2))
    closure, apart = slow > 0.0, np.abs(np.array(fast) - slow)
    return EpsilonCheck(
        count=len(wrench_sets),
        force_closure=int(closure.sum()),
        sign_errors=int(((np.array(fast) > 0.0) != closure).sum()),
        max_difference=float(apart.max()),
        differing=int((apart > 1e-6).sum()),
        ms_median=float(np.median(fast_ms)),
        ms_mean=float(fast_ms.mean()),
        closure_ms_median=float(np.median(fast_ms[closure])) if closure.any() else float("nan"),
        closure_ms_mean=float(fast_ms[closure].mean()) if closure.any() else float("nan"),
        qhull_ms_median=float(np.median(slow_ms)),
        qhull_ms_mean=float(slow_ms.mean()),
        qp_ms_median=float(np.median(qp_ms)),
        qp_ms_mean=float(qp_ms.mean()),
        qp_residual_max=float(residual[closure].max(initial=0.0)),
        qp_not_converged=sum(not converged for _, converged in forces),
        wrenches_median=float(np.median([len(w) for w in wrench_sets])),
    )


def _timed(function: Callable[[np.ndarray], Any], wrench_sets: Sequence[np.ndarray]) -> tuple[list[Any], np.ndarray]:
    """What `function` returns for each set, and the fastest of three calls, ms."""
    results, times = [], np.empty(len(wrench_sets))
    for i, wrenches in enumerate(wrench_sets):
        best = np.inf
        for _ in range(_REPEATS):
            start = time.perf_counter()
            result = function(wrenches)
            best = min(best, time.perf_counter() - start)
        results.append(result)
        times[i] = 1e3 * best
    return results, times


def _qhull(wrench_sets: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    values, times = np.empty(len(wrench_sets)), np.empty(len(wrench_sets))
    for i, wrenches in enumerate(wrench_sets):
        start = time.perf_counter()
        values[i] = epsilon_qhull(wrenches)
        times[i] = 1e3 * (time.perf_counter() - start)
    return values, times
