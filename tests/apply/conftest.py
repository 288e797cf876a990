"""Known grasps of a jaw on a box, and a field and code book of them: seconds to make."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import pytest

from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.model.codes import CodeBook
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.synthesis.synthesise import SynthesisConfig, synthesise


@dataclass(frozen=True, slots=True, kw_only=True)
class BoxWorld:
    """A jaw, a box, grasps that hold, and a field that knows both, untrained."""

    hand: Hand
    obj: ObjectModel
    grasps: GraspSet
    field: KinematicField
    book: CodeBook


@pytest.fixture(scope="session")
def box_world(make_object: Callable[..., ObjectModel]) -> BoxWorld:
    hand, obj = load_hand("panda"), make_object("brick", box_mesh([0.02, 0.03, 0.06]))
    made = synthesise(hand, obj, config=SynthesisConfig(count=8, batch=256, draws=1), seed=0)
    assert made.converged
    field = KinematicField(hands={"panda": hand, "fetch": load_hand("fetch")}, objects={"brick": obj})
    book = field.encode(made.grasps.X_OH, made.grasps.q, hand="panda", object_name="brick")
    return BoxWorld(hand=hand, obj=obj, grasps=made.grasps, field=field, book=book)
