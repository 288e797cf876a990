"""Verdicts on many grasps: tried in order, on one thread or several, with the same result."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.grasps.grasp_set import GraspSet, Verdict
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.parallel import thread_map
from neuralgrasps.sim.build import CONTACT_DIMENSIONS, contact_friction, object_mass
from neuralgrasps.sim.grasp_trial import GraspTrial, TrialOutcome, silent_engine
from neuralgrasps.sim.protocols import PROTOCOLS, Protocol, get_protocol


def validate_grasps(
    hand: Hand,
    obj: ObjectModel,
    grasps: GraspSet,
    protocol: str | Protocol = "dexgraspbench",
    *,
    stop_after: int | None = None,
    threads: int = 1,
) -> Verdict:
    """Try grasps in physics, in order.

    Hopeless grasps cost little: where each force starts from the squeeze, all six are first tried for 0.2 s each, and a
    grasp that lets go then is dropped. This is the pre-screen; the verdict is that of the six forces in turn.

    Args:
        hand, obj: what `grasps` was made for.
        grasps: N grasps; uses `X_OH`, `q_pregrasp`, `q`, `q_squeeze`.
        protocol: preset name or protocol.
        stop_after: stop after this many successes. The verdict then has one row per grasp *tried*: it belongs to
            `grasps[:len(verdict.success)]`.
        threads: trials run side by side; the verdict does not depend on it.
    Returns:
        The verdict; its parameters are `verdict_parameters`: mass, friction, forces, limits, every protocol number.
    Raises:
        InputError: `grasps` is of another hand or object. ShapeError: wrong number of joints.
        UnknownNameError: no such preset.
    """
    protocol = get_protocol(protocol)
    check_pair(hand, obj, grasps)
    with silent_engine():
        outcomes = _try_in_order(GraspTrial(hand, obj, protocol), grasps, stop_after, threads)
    return Verdict(
        success=np.array([o.success for o in outcomes], bool),
        displacement_m=np.array([o.displacement_m for o in outcomes], np.float64),
        rotation_rad=np.array([o.rotation_rad for o in outcomes], np.float64),
        parameters=verdict_parameters(hand, obj, protocol),
    )


def _try_in_order(trial: GraspTrial, grasps: GraspSet, stop_after: int | None, threads: int) -> list[TrialOutcome]:
    """Outcomes of the grasps in order, up to the success number `stop_after`.

    As many are tried side by side as successes are still missing (at least one per thread), so that little is tried
    in vain; what was tried beyond the last success that counts is dropped.
    """
    trials = [trial] + [trial.another() for _ in range(min(threads, len(grasps)) - 1)]
    outcomes: list[TrialOutcome] = []
    wins = 0
    while len(outcomes) < len(grasps) and (stop_after is None or wins < stop_after):
        missing = len(grasps) if stop_after is None else max(stop_after - wins, len(trials))
        rows = range(len(outcomes), min(len(outcomes) + missing, len(grasps)))
        for outcome in _try_rows(trials, grasps, rows):
            if stop_after is not None and wins >= stop_after:
                break
            outcomes.append(outcome)
            wins += outcome.success
    return outcomes


def _try_rows(trials: Sequence[GraspTrial], grasps: GraspSet, rows: Sequence[int]) -> list[TrialOutcome]:
    """Outcomes of grasps `rows`, in order; the next free trial takes the next grasp."""
    free = list(trials)

    def run(row: int) -> TrialOutcome:
        trial = free.pop()
        try:
            return trial.run(grasps.X_OH[row], grasps.q_pregrasp[row], grasps.q[row], grasps.q_squeeze[row])
        finally:
            free.append(trial)

    return thread_map(run, rows, threads=len(trials))


def verdict_parameters(hand: Hand, obj: ObjectModel, protocol: str | Protocol) -> dict[str, float]:
    """Every number a success rate must be quoted with: the hand's, the object's and all of the protocol.

    SI units, named in the key, except for pure numbers; `settled_speed` is both m/s and rad/s. Mass and frictions are
    those used in the trial, after `object_mass_kg`, `friction` and `friction_scale`. Switches are 1 or 0.
    """
    protocol = get_protocol(protocol)
    mass = object_mass(obj, protocol)
    sliding, torsional, rolling = contact_friction(obj, protocol)
    effort = hand.tree.effort
    return {
        "mass_kg": mass,
        "friction": sliding,
        "friction_scale": protocol.friction_scale,
        "torsional_friction_m": torsional,
        "rolling_friction_m": rolling,
        "force_n": mass * protocol.force_per_mass,
        "force_per_mass_m_s2": protocol.force_per_mass,
        "min_joint_effort": float(effort.min()),
        "max_joint_effort": float(effort.max()),
        "drive_s": protocol.drive_s,
        "hold_s": protocol.hold_s,
        "from_reset": float(protocol.from_reset),
        "max_displacement_m": protocol.max_displacement_m,
        "max_rotation_rad": protocol.max_rotation_rad,
        "max_start_penetration_m": protocol.max_start_penetration_m,
        "check_every_steps": float(protocol.check_every),
        "settled_speed": protocol.settled_speed,
        "revolute_kp_n_m_per_rad": protocol.revolute.kp,
        "revolute_kv_n_m_s_per_rad": protocol.revolute.kv,
        "revolute_armature_kg_m2": protocol.revolute.armature,
        "prismatic_kp_n_per_m": protocol.prismatic.kp,
        "prismatic_kv_n_s_per_m": protocol.prismatic.kv,
        "prismatic_armature_kg": protocol.prismatic.armature,
        "timestep_s": protocol.timestep_s,
        "noslip_iterations": float(protocol.noslip_iterations),
        "solref_time_constant_s": protocol.solref[0],
        "solref_damping_ratio": protocol.solref[1],
        "solimp_lowest_impedance": protocol.solimp[0],
        "solimp_highest_impedance": protocol.solimp[1],
        "solimp_width_m": protocol.solimp[2],
        "impratio": protocol.impratio,
        "solver_iterations": float(protocol.solver_iterations),
        "condim": float(CONTACT_DIMENSIONS),
        "multiccd": float(protocol.multiccd),
    }


def current_verdicts(hand: Hand, obj: ObjectModel, grasps: GraspSet) -> dict[str, Verdict]:
    """Those verdicts of `grasps`, by protocol, that a trial of today would be run with the same numbers for.

    A verdict on a lighter object, another friction or an older protocol says nothing about a trial of today.
    """
    return {
        name: verdict
        for name, verdict in grasps.verdicts.items()
        if name in PROTOCOLS and dict(verdict.parameters) == verdict_parameters(hand, obj, name)
    }


def not_let_fall(hand: Hand, obj: ObjectModel, grasps: GraspSet) -> GraspSet:
    """Without the grasps that every one of the `current_verdicts` lets fall; all of them where there are none."""
    current = current_verdicts(hand, obj, grasps)
    if not current:
        return grasps
    return grasps[np.any([verdict.success for verdict in current.values()], axis=0)]


def check_pair(hand: Hand, obj: ObjectModel, grasps: GraspSet) -> None:
    """Raise `InputError` unless `grasps` are of this hand and object, with as many joints as the hand."""
    if grasps.hand != hand.name or grasps.object != obj.name:
        raise InputError(
            f"these grasps are of hand '{grasps.hand}' on object '{grasps.object}'; "
            f"got hand '{hand.name}' and object '{obj.name}'. Load the pair that the grasps were made for."
        )
    for name in ("q", "q_pregrasp", "q_squeeze"):
        hand.check_q(getattr(grasps, name))
