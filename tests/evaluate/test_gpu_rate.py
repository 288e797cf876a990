"""The rate of grasps whose forces balance, measured on the CPU; a GPU that is not there is refused."""

from __future__ import annotations

import pytest

from neuralgrasps.errors import DeviceError
from neuralgrasps.evaluate.gpu_rate import GpuRate, gpu_rate
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.objects.zoo import load_object
from neuralgrasps.synthesis.device import require_gpu


def test_a_can_is_grasped_on_the_cpu():
    rate = gpu_rate(load_hand("barrett"), load_object("tomato_soup_can"), device="cpu", candidates=200)
    assert 190 <= rate.candidates <= 200
    assert 40 <= rate.qp_valid <= 160
    assert 0.0 < rate.per_s < rate.judged_per_s


def test_rates_are_per_second_with_and_without_start_poses():
    rate = GpuRate(hand="h", object="o", device="cpu", candidates=100, qp_valid=30, propose_s=1.0, judge_s=2.0)
    assert (rate.judged_per_s, rate.per_s) == (15.0, 10.0)


def test_without_a_gpu_the_rate_on_one_is_refused():
    try:
        require_gpu()
    except DeviceError:
        with pytest.raises(DeviceError, match="use device 'cpu'"):
            gpu_rate(load_hand("panda"), load_object("tomato_soup_can"), device="cuda", candidates=10)
    else:
        pytest.skip("this machine has a GPU")
