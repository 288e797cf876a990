"""What every learned or exact grasp field offers: a code and query points in, two signed distances out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from torch import Tensor


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldOutput:
    """Signed distances of N scenes at M query points, metres, negative inside.

    Attributes:
        sdf_object, sdf_hand: (N, M).
    """

    sdf_object: Tensor
    sdf_hand: Tensor


@runtime_checkable
class GraspField(Protocol):
    """A code decodes to the shapes of an object and of a hand that grasps it. Metres in, metres out."""

    def __call__(self, points_O: Tensor, codes: Tensor, *, hand: str, object_name: str) -> FieldOutput:
        """Distances at `points_O` (M, 3) or (N, M, 3), object frame, for codes (N, D) of one hand and object."""
        ...
