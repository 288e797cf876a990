"""What is asked of a robot's grasps before it is seen how the object stands: top and down are bound afterwards."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from neuralgrasps.apply.constrained_grasps import ENOUGH, with_constrained, with_more
from neuralgrasps.apply.constraint_text import constraint_fields
from neuralgrasps.apply.constraints import MARGIN_M, GraspConstraints
from neuralgrasps.apply.regions import AXES, Side
from neuralgrasps.apply.transfer import Constraint, TransferConfig, TransferResult, made_grasps, transfer
from neuralgrasps.apply.transfer_query import TransferQuery
from neuralgrasps.errors import InputError
from neuralgrasps.geometry.plane import Plane, standing_on
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.synthesis.support import Support

_CLEARANCE_M, _RETREAT_M = 0.004, 0.10  # that the robot's hand keeps from the table, and goes back straight
TableRules = Callable[[Plane | None], Constraint]  # the table in the object's frame, normal up, as it was seen


@dataclass(frozen=True, slots=True, kw_only=True)
class TextRules:
    """Constraints as they were typed, bound to what is up once a table was seen.

    Attributes:
        obj: the object. fields: what `GraspConstraints` takes. names: the conditions in words.
    """

    obj: ObjectModel
    fields: Mapping[str, Any]
    names: tuple[str, ...]

    def __call__(self, table_O: Plane | None) -> GraspConstraints:
        """The constraints on the object as it stands on a table (in its frame, normal up).

        Raises:
            InputError: no table, and a condition that depends on what is up; or conditions that no hand can meet.
        """
        if table_O is None and _needs_up(self.fields):
            raise InputError(
                "no table was seen, so it is not known what is up on the object; give sides and approach as axes of "
                "the object, +x to -z, in place of top, bottom, side, up and down."
            )
        return GraspConstraints(obj=self.obj, X_WO=None if table_O is None else standing_on(table_O), **self.fields)


def rules_from_text(
    obj: ObjectModel,
    *,
    only_region: Sequence[str] = (),
    keep_free: Sequence[str] = (),
    approach: tuple[str, str] | None = None,
) -> TextRules | None:
    """Constraints as for `constraints_from_text`, with up left to the table that will be seen; None: no text.

    Raises:
        InputError, UnknownNameError: a text that cannot be read, or constraints that no hand can meet however the
            object stands.
    """
    if not (only_region or keep_free or approach):
        return None
    fields = constraint_fields(
        only_region=only_region, keep_free=keep_free, approach=approach, up=None, margin_m=MARGIN_M
    )
    cone = fields["approach"]
    if cone is not None and cone.frame == "world" and abs(cone.unit[2]) < 1 - 1e-9:
        raise InputError(
            f"approach '{cone}' is not vertical, and what is the world's x in a video is not known; expected down, up, "
            "or an axis of the object."
        )
    ways = [Plane(axis, 0.0) for axis in AXES.values()] if _needs_up(fields) else [None]
    return TextRules(obj=obj, fields=fields, names=_possible(TextRules(obj=obj, fields=fields, names=()), ways).names)


def table_support(plane_O: Plane) -> Support:
    """The table that grasps of a demonstration must clear, when they are found and when they are carried out."""
    return Support(plane=plane_O, clearance_m=_CLEARANCE_M, retreat_m=_RETREAT_M)


def transfer_under(
    query: TransferQuery,
    hand: Hand,
    obj: ObjectModel,
    *,
    known: GraspSet | None,
    config: TransferConfig,
    support: Support | None,
    constraints: Constraint | None,
    seed: int,
) -> TransferResult:
    """`transfer`; where few known grasps clear the table or meet the constraints, new ones are made for these first."""
    known = known_under(hand, obj, known=known, config=config, support=support, constraints=constraints, seed=seed)
    return transfer(query, hand, obj, known=known, config=config, support=support, constraints=constraints, seed=seed)


def known_under(
    hand: Hand, obj: ObjectModel, *, known: GraspSet | None, config: TransferConfig, support: Support | None,
    constraints: Constraint | None, seed: int,
) -> GraspSet | None:  # fmt: skip
    """The known grasps with those that are made for a table or constraints that few of them meet; made once, kept."""
    enough = min(config.count, ENOUGH)
    if known is not None and support is not None and len(known):
        clear = support.allows(hand, known.X_OH, known.q, known.q_pregrasp)
        if int(clear.sum()) < enough:
            made = made_grasps(hand, obj, config, support=support, seed=seed)
            known = with_more(hand, obj, known, made, protocol=config.protocol)
    if isinstance(constraints, GraspConstraints) and constraints:
        if known is None:
            known = made_grasps(hand, obj, config, support=support, seed=seed)
        known = with_constrained(
            constraints, hand, known, protocol=config.protocol, enough=enough, support=support, seed=seed
        )
    return known


def _needs_up(fields: Mapping[str, Any]) -> bool:
    regions = (*fields["only_region"], *fields["keep_free"])
    cone = fields["approach"]
    by_name = any(isinstance(region, Side) and region.name not in AXES for region in regions)
    return by_name or (cone is not None and cone.frame == "world")


def _possible(rules: TextRules, ways: Sequence[Plane | None]) -> GraspConstraints:
    """The rules with the first of these tables that lets a hand meet them; the first one's error when none does."""
    errors: list[InputError] = []
    for table_O in ways:
        try:
            return rules(table_O)
        except InputError as error:
            errors.append(error)
    raise errors[0]
