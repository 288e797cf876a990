"""Close and judge a few hands on the CPU and in numba's CUDA simulator; fails where they differ in any bit.

The simulator is chosen when numba is imported: run it as NUMBA_ENABLE_CUDASIM=1 python run_simulated_gpu.py.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.objects.zoo import load_object
from neuralgrasps.synthesis import device
from neuralgrasps.synthesis.assess import advance_all
from neuralgrasps.synthesis.candidates import (
    OUTCOMES,
    VALID,
    Candidates,
    GraspProblem,
    close_and_assess,
    close_and_balance,
    make_problem,
)
from neuralgrasps.synthesis.propose import Proposals, propose_dexterous, propose_jaw


def starts(problem: GraspProblem, count: int) -> Proposals:
    rng = np.random.default_rng(0)
    if problem.hand.is_jaw:
        return propose_jaw(problem.hand, problem.obj, count=count, friction=0.6, pad_depth_m=0.012, rng=rng)
    return propose_dexterous(problem, count=count, friction=0.6, rng=rng)


def check_equal(a: Candidates, b: Candidates) -> None:
    for f in fields(Candidates):
        np.testing.assert_array_equal(getattr(a, f.name), getattr(b, f.name), err_msg=f.name)


def check_pair(hand: str, obj: str, count: int) -> None:
    here = make_problem(
        load_hand(hand), load_object(obj), friction=0.6, torsion=0.005, contact_threshold_m=2.5e-3,
        max_penetration_m=1e-3,
    )  # fmt: skip
    there = replace(here, device="cuda")
    drawn = starts(here, count)
    X_OH, q = drawn.X_OH, drawn.q
    on_cpu = close_and_assess(here, X_OH, q)
    check_equal(on_cpu, close_and_assess(there, X_OH, q))
    balanced, residual = close_and_balance(here, X_OH, q)
    balanced_there, residual_there = close_and_balance(there, X_OH, q)
    check_equal(balanced, balanced_there)
    np.testing.assert_array_equal(residual, residual_there)
    approach, travel = -X_OH[:, :3, 3] / np.linalg.norm(X_OH[:, :3, 3], axis=1, keepdims=True), np.empty(len(q))
    away = X_OH.copy()
    away[:, :3, 3] -= 0.3 * approach
    advance_all(here.arrays, away, q, approach, 1e-3, 0.6, True, travel)
    assert (travel > 0.0).any()
    np.testing.assert_array_equal(
        travel, there.on_gpu().advance(away, q, approach, contact_m=1e-3, farthest=0.6, touching=True)
    )
    assert (on_cpu.outcome == VALID).any()
    print(hand, *(f"{np.sum(on_cpu.outcome == k)} {name}," for k, name in enumerate(OUTCOMES)), "equal")


if __name__ == "__main__":
    device.MOST_CANDIDATES, device.MOST_THREADS = 20, 16  # several rounds, and threads with several candidates
    check_pair("panda", "tomato_soup_can", 40)
    device.VERTICES = 200  # too few for some of the next
    check_pair("barrett", "tomato_soup_can", 24)
