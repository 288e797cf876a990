"""The GPU's path without a GPU: equal in numba's simulator, compiled to PTX where a compiler is, refused clearly."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from neuralgrasps.errors import DeviceError, InputError
from neuralgrasps.synthesis.assess import FEW_CONTACTS, MAX_RESIDUAL, VALID
from neuralgrasps.synthesis.candidates import Candidates, check_device, close_and_assess, close_and_balance
from neuralgrasps.synthesis.propose import propose_dexterous, propose_jaw

HERE = Path(__file__).parent


def run_script(name: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(HERE / name)],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
    )


def starts(problem, count):
    rng = np.random.default_rng(3)
    if problem.hand.is_jaw:
        return propose_jaw(problem.hand, problem.obj, count=count, friction=0.6, pad_depth_m=0.012, rng=rng)
    return propose_dexterous(problem, count=count, friction=0.6, rng=rng)


def test_the_simulated_gpu_gives_the_same_bits_as_the_cpu():
    done = run_script("run_simulated_gpu.py", NUMBA_ENABLE_CUDASIM="1")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("equal") == 2


def test_every_kernel_compiles_for_a_gpu():
    done = run_script("compile_gpu_kernels.py")
    if done.returncode == 77:
        pytest.skip(done.stdout.strip())
    assert done.returncode == 0, done.stdout + done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 12
    assert all(int(line.split()[-2]) <= 4096 for line in lines), done.stdout


@pytest.mark.parametrize("hand", ["panda", "allegro"])
@pytest.mark.parametrize("judge", [close_and_assess, lambda *a: close_and_balance(*a)[0]])
def test_a_batch_is_as_its_candidates_one_by_one(problem_of, hand, judge):
    problem = problem_of(hand, "can")
    drawn = starts(problem, 60)
    batch = judge(problem, drawn.X_OH, drawn.q)
    alone = Candidates.join([judge(problem, drawn.X_OH[i : i + 1], drawn.q[i : i + 1]) for i in range(len(drawn.q))])
    for f in fields(Candidates):
        np.testing.assert_array_equal(getattr(batch, f.name), getattr(alone, f.name), err_msg=f.name)


@pytest.mark.parametrize("hand", ["panda", "barrett"])
def test_forces_balance_where_epsilon_is_positive(problem_of, hand):
    problem = problem_of(hand, "can")
    drawn = starts(problem, 300)
    by_epsilon = close_and_assess(problem, drawn.X_OH, drawn.q)
    by_forces, residual = close_and_balance(problem, drawn.X_OH, drawn.q)
    valid = by_epsilon.outcome == VALID
    assert valid.sum() > 20
    assert (by_forces.outcome[valid] == VALID).all()
    assert (residual[valid] <= MAX_RESIDUAL).all()
    # what only forces accept lies within the tolerance of force closure
    assert ((by_forces.outcome == VALID) & ~valid).mean() < 0.02
    assert (by_forces.epsilon == 0.0).all()
    np.testing.assert_array_equal(np.isinf(residual), by_epsilon.outcome <= FEW_CONTACTS)


def test_a_gpu_that_is_not_there_is_refused_with_the_way_out(monkeypatch):
    monkeypatch.delenv("NUMBA_ENABLE_CUDASIM", raising=False)
    try:
        check_device("cuda")
    except DeviceError as error:
        assert isinstance(error, InputError)
        assert "device 'cuda' is not available" in str(error)
        assert "use device 'cpu'" in str(error)
    else:
        pytest.skip("this machine has a GPU")


def test_an_unknown_device_is_refused():
    with pytest.raises(DeviceError, match="device is 'tpu'; expected 'cpu' or 'cuda'"):
        check_device("tpu")


def test_copies_of_a_problem_do_not_share_the_memory_of_a_gpu(problem_of):
    problem = problem_of("panda", "can")
    assert replace(problem, friction=0.3)._gpu is not problem._gpu
