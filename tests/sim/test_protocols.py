from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace

import pytest

from neuralgrasps.errors import InputError, UnknownNameError
from neuralgrasps.sim.protocols import PROTOCOLS, get_protocol


def test_dexgraspbench_numbers_are_the_published_ones() -> None:
    p = get_protocol("dexgraspbench")
    assert (p.object_mass_kg, p.friction, p.torsional_friction) == (0.1, 0.6, 0.02)
    assert (p.force_per_mass, p.hold_s, p.drive_s, p.timestep_s) == (10.0, 2.0, 0.4, 0.004)
    assert (p.max_displacement_m, p.max_start_penetration_m) == (0.05, 0.01)
    assert p.max_rotation_rad == pytest.approx(math.radians(15))


def test_hard_differs_only_by_half_the_friction() -> None:
    base, hard = get_protocol("dexgraspbench"), get_protocol("dexgraspbench-hard")
    assert replace(hard, name=base.name, friction_scale=1.0) == base
    assert hard.friction_scale == 0.5


def test_presets_are_named_by_their_keys_and_cannot_be_changed() -> None:
    assert all(protocol.name == name for name, protocol in PROTOCOLS.items())
    with pytest.raises(TypeError):
        PROTOCOLS["mine"] = get_protocol("shake")  # pyright: ignore


def test_unknown_preset_names_the_nearest() -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'dexgraspbench'"):
        get_protocol("dexgraspbnch")


@pytest.mark.parametrize(
    "change", [{"timestep_s": 0.0}, {"friction": -0.1}, {"object_mass_kg": 0.0}, {"hold_s": math.nan}]
)
def test_impossible_numbers_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(change))):
        replace(get_protocol("dexgraspbench"), **change)


def test_protocols_need_no_simulator() -> None:
    code = "import sys, neuralgrasps.sim.protocols; sys.exit('mujoco' in sys.modules or 'torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
