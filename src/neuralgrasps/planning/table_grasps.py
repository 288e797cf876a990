"""Grasps of an object that lies on a table: stored ones that clear it, and new ones made with the table present."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.grasps.grasp_set import GraspSet, array_fields, concatenate, empty_grasps
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.copies import moved_grasps, roll_twins, symmetric_copies
from neuralgrasps.planning.grasp_cache import pair_fingerprint, remembered
from neuralgrasps.planning.resting_plane import nearest_resting_plane, representative, rounded_plane
from neuralgrasps.sim.validate import current_verdicts, validate_grasps, verdict_parameters
from neuralgrasps.synthesis.select import diverse_order
from neuralgrasps.synthesis.strength import few_lift, grasp_strengths
from neuralgrasps.synthesis.support import Support
from neuralgrasps.synthesis.synthesise import SynthesisConfig, synthesise

_FEW = 0.25  # of what is wanted: fewer than this left of the kept ones, and they are made for this very plane


def _synthesis() -> SynthesisConfig:
    return SynthesisConfig(max_rounds=6, also=("shake",))


@dataclass(frozen=True, slots=True, kw_only=True)
class TableGraspConfig:
    """Which grasps count as clear of the table, and how new ones are made.

    Attributes:
        clearance_m: least height over the table of the hand at the grasp, a little more open, and on its way back.
        retreat_m: the straight way back, along the approach axis.
        spare_m: what new grasps keep besides, so that they serve in scenes where the object leans a little.
        twins: also give every grasp of a parallel jaw turned by half a turn about its approach axis.
        use_symmetry: carry grasps over by the object's symmetry where its surface moves off by at most `symmetry_m`.
        synthesis: how new grasps are made; its `count` is `want`.
    """

    clearance_m: float = 0.004
    retreat_m: float = 0.10
    spare_m: float = 0.0015
    twins: bool = True
    use_symmetry: bool = True
    symmetry_m: float = 0.001
    synthesis: SynthesisConfig = field(default_factory=_synthesis)


@dataclass(frozen=True, slots=True, kw_only=True)
class TableGrasps:
    """Grasps of one object on one table.

    Attributes:
        grasps: all that clear it: stored ones, their copies by symmetry, new ones (first those that other protocols
            than the one that decides say hold, too), and then the twins of all of these.
        from_stored, made: grasps that were stored or copied from stored ones, and new ones; twins not counted.
        reason: why there are fewer than wanted; "" when there are enough.
    """

    grasps: GraspSet
    from_stored: int
    made: int
    reason: str


def grasps_on_table(
    hand: Hand,
    obj: ObjectModel,
    plane_O: Plane,
    *,
    stored: GraspSet | None,
    want: int = 40,
    config: TableGraspConfig | None = None,
    seed: int = 0,
) -> TableGrasps:
    """Grasps whose hand, open and closed, and whose straight way back stay clear of the table.

    New ones are made once per hand, object and resting pose, and kept (`grasp_cache`): the first call takes seconds,
    later ones milliseconds. The result depends on the arguments only. Jaws that close on more than 97 % of their
    aperture are left out, and, where few of the stored grasps can lift the object, those that cannot.

    Args:
        plane_O: the table in the object's frame, its normal up (`Plane.moved(inv(X_BO))` of the table in B).
        stored: grasps of this hand on this object; None: there are none.
        want: distinct grasps wanted; new ones are made when fewer stored ones clear the table.
        seed: of the synthesis.
    Returns:
        the grasps, with the verdict of every protocol in `config.synthesis`, or none and the reason.
    Raises:
        InputError: `want` is less than 1, or `stored` is of another hand or object.
    """
    config = config or TableGraspConfig()
    if want < 1:
        raise InputError(f"want is {want}; expected at least 1 grasp.")
    support = Support(plane=plane_O, clearance_m=config.clearance_m, retreat_m=config.retreat_m)
    none = empty_grasps(hand.name, obj.name, num_joints=hand.num_dofs, seed=seed)
    kept = (
        none
        if stored is None
        else _strong_enough(hand, obj, _stored(hand, obj, stored, support, config, want), support)
    )
    made, reason = none, ""
    if len(kept) < want:
        made, reason = _made(hand, obj, support, config, want, seed)
        made = made[: want - len(kept)]
    grasps = concatenate([kept, made])
    if config.twins:
        twins = roll_twins(hand, grasps)
        grasps = concatenate([grasps, twins[support.clears(hand, twins.X_OH, twins.q, twins.q_pregrasp)]])
    short = len(kept) + len(made) < want
    return TableGrasps(grasps=grasps, from_stored=len(kept), made=len(made), reason=reason if short else "")


def _usable(hand: Hand, grasps: GraspSet, support: Support) -> GraspSet:
    return grasps[support.allows(hand, grasps.X_OH, grasps.q, grasps.q_pregrasp)]


def _strong_enough(hand: Hand, obj: ObjectModel, grasps: GraspSet, support: Support) -> GraspSet:
    """All the grasps; of an object that is heavy for the hand, those that can lift it."""
    strengths = grasp_strengths(hand, obj, grasps, support.plane.normal)
    return grasps[strengths >= 1.0] if few_lift(strengths) else grasps


def _exact_symmetry(obj: ObjectModel, config: TableGraspConfig) -> bool:
    return config.use_symmetry and len(obj.symmetry) > 1 and obj.symmetry.deviation_m <= config.symmetry_m


def _stored(
    hand: Hand, obj: ObjectModel, stored: GraspSet, support: Support, config: TableGraspConfig, want: int
) -> GraspSet:
    """Stored grasps that clear the table, and as many copies by symmetry as are still wanted, the most diverse."""
    stored = _judged(hand, obj, stored, config.synthesis)
    stored = stored[stored.validated]
    kept = _usable(hand, stored, support)
    if not _exact_symmetry(obj, config) or len(kept) >= want:
        return kept
    copies = _usable(hand, symmetric_copies(obj, stored), support)
    if len(copies):
        best = int(copies.epsilon.argmax())
        copies = copies[diverse_order(hand, copies.X_OH, copies.q, start=best, count=want - len(kept))]
    return concatenate([kept, copies])


def _judged(hand: Hand, obj: ObjectModel, grasps: GraspSet, synthesis: SynthesisConfig) -> GraspSet:
    """The grasps with the verdicts of exactly the wanted protocols, tried now where they are missing."""
    if grasps.hand != hand.name or grasps.object != obj.name:
        raise InputError(
            f"stored grasps are of hand '{grasps.hand}' on object '{grasps.object}'; "
            f"expected hand '{hand.name}' on object '{obj.name}'."
        )
    names = dict.fromkeys((synthesis.protocol, *synthesis.also))
    agreed = {name: v for name, v in current_verdicts(hand, obj, grasps).items() if name in names}
    grasps = replace(grasps, verdicts=agreed, protocol=synthesis.protocol)
    missing = [name for name in names if name not in agreed]
    if not missing or len(grasps) == 0:
        return grasps

    def judge() -> GraspSet:
        out = grasps
        for name in missing:
            out = out.with_verdict(name, validate_grasps(hand, obj, grasps, name), decides=False)
        return out

    arrays = {name: getattr(grasps, name) for name in array_fields()}
    numbers = [verdict_parameters(hand, obj, name) for name in names]
    return remembered(("judged", pair_fingerprint(hand, obj), arrays, tuple(agreed), numbers, grasps.config), judge)


def _made(
    hand: Hand, obj: ObjectModel, support: Support, config: TableGraspConfig, want: int, seed: int
) -> tuple[GraspSet, str]:
    """New grasps that clear the table, and why there are few.

    Those for the nearest resting pose serve, unless the object leans so that too few of them are left.
    """
    resting = nearest_resting_plane(obj, support.plane)
    as_seen = rounded_plane(support.plane)
    if resting is None:
        return _usable_of(hand, _made_for(hand, obj, as_seen, support, config, want, seed), support)
    made = _made_for(hand, obj, resting, support, config, want, seed)
    usable, reason = _usable_of(hand, made, support)
    if len(usable) >= _FEW * len(made):
        return usable, reason
    here, why = _usable_of(hand, _made_for(hand, obj, as_seen, support, config, want, seed), support)
    return (here, why) if len(here) > len(usable) else (usable, reason)


def _usable_of(hand: Hand, made: GraspSet, support: Support) -> tuple[GraspSet, str]:
    """Those of the grasps made that clear the table as it was seen, and why there are few."""
    usable, reason = _usable(hand, made, support), made.config["shortfall"]
    if len(usable) < len(made):
        lost = f"{len(usable)} of {len(made)} grasps made for this pose clear the table as it was seen"
        reason = f"{reason}; {lost}" if reason else lost
    return usable, reason


def _made_for(
    hand: Hand, obj: ObjectModel, plane_O: Plane, support: Support, config: TableGraspConfig, want: int, seed: int
) -> GraspSet:
    """Grasps made for `plane_O`; `config["shortfall"]` says why there are fewer than wanted, if so."""
    back = np.eye(4)
    if _exact_symmetry(obj, config):
        plane_O, back = representative(obj, plane_O)
    planned = Support(
        plane=rounded_plane(plane_O, finely=True),
        clearance_m=support.clearance_m + config.spare_m,
        retreat_m=support.retreat_m,
    )
    settings = replace(config.synthesis, count=want)

    def make() -> GraspSet:
        result = synthesise(hand, obj, config=settings, seed=seed, support=planned)
        held = [result.grasps.succeeded(name) for name in settings.also if len(result.grasps)]
        order = np.argsort(-np.sum(held, axis=0), kind="stable") if held else slice(None)
        return result.grasps[order].with_config(shortfall=result.reason)

    return moved_grasps(remembered(("made", pair_fingerprint(hand, obj), settings, seed, planned), make), back)
