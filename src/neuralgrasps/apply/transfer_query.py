"""What a transfer is asked for: how the object is touched, by any hand, or by points, or by contacts that someone drew.

A query is a contact map at the object's contact points, phi(p) = exp(-d(p) / radius) with the decay length of the
object's codes. Where it comes from a hand, or from points all over a hand, every object point counts alike: what is not
touched says as much as what is. Where it comes from a few contacts, d is the distance to the nearest of them, and a
point counts by its own closeness, and by `ELSEWHERE` besides: only what is touched counts, but of two hands that touch
the contacts alike the one that touches little else comes first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.dataset.samples import normalisation_of
from neuralgrasps.dataset.schema import DatasetConfig
from neuralgrasps.errors import InputError, ShapeError, check_shape
from neuralgrasps.grasps.contact_map import contact_map_from_points, contact_map_packed
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import pack_shapes
from neuralgrasps.objects.object_model import ObjectModel

ELSEWHERE = 0.1  # weight of object points far from drawn contacts; a contact's own point weighs 1.1
FAR_M = 0.05  # contacts farther than this from the object's surface are not on this object


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TransferQuery:
    """How an object is to be touched.

    Attributes:
        object: its name. points_O: (P, 3) float64 contact points, metres; contact_map: (P,) float32 closeness there.
        weight: (P,) float64 how much each point counts, 1 on average.
        radius_m: decay length of the closeness.
        source: the hand's name, "points" or "contacts".
        X_OP: (4, 4) palm frame of the hand (z: approach, x: closing axis) in the object frame; None when not known.
    """

    object: str
    points_O: np.ndarray
    contact_map: np.ndarray
    weight: np.ndarray
    radius_m: float
    source: str
    X_OP: np.ndarray | None = None

    def __post_init__(self) -> None:
        count = len(self.points_O)
        for name in ("contact_map", "weight"):
            if getattr(self, name).shape != (count,):
                raise ShapeError(f"query: {name} has shape {getattr(self, name).shape}; expected ({count},).")

    def __repr__(self) -> str:
        touched = int((self.contact_map > 0.9).sum())
        return f"TransferQuery({self.source} on {self.object}: {touched} of {len(self.contact_map)} points touched)"

    @property
    def palm_O(self) -> np.ndarray | None:
        """(3,) palm point in the object frame, metres; None when not known."""
        return None if self.X_OP is None else self.X_OP[:3, 3]

    @property
    def approach_O(self) -> np.ndarray | None:
        """(3,) unit approach axis of the palm in the object frame; None when not known."""
        return None if self.X_OP is None else self.X_OP[:3, 2]


def contact_radius(obj: ObjectModel) -> float:
    """Decay length, metres, of contact maps on this object, in proportion to its size: that of its codes."""
    return DatasetConfig().contact_decay * normalisation_of(obj.points_O).scale_m


def query_from_grasp(hand: Hand, obj: ObjectModel, X_OH: np.ndarray, q: np.ndarray) -> TransferQuery:
    """The query of a grasp of any hand, known or not.

    Args:
        X_OH: (4, 4) hand base in the object frame; q: (J,) joints, rad or metres.
    Raises:
        ShapeError: wrong shapes. InputError: not finite.
    """
    X_OH, q = np.array(X_OH, np.float64), np.array(q, np.float64)
    check_shape("X_OH", X_OH.shape, (4, 4))
    hand.check_q(q[None])
    if not (np.isfinite(X_OH).all() and np.isfinite(q).all()):
        raise InputError("the query grasp's pose or joints are not finite; expected numbers.")
    radius = contact_radius(obj)
    closeness = contact_map_packed(obj.points_O, pack_shapes(hand), X_OH[None], q[None], radius=radius)[0]
    return _query(obj, closeness, np.ones(len(closeness)), radius, hand.name, X_OH @ hand.X_HP)


def query_from_points(
    obj: ObjectModel, hand_points_O: np.ndarray, *, X_OP: np.ndarray | None = None, source: str = "points"
) -> TransferQuery:
    """The query of a hand that is known only by points on its surface.

    Args:
        hand_points_O: (K, 3) points all over the hand, object frame, metres.
        X_OP: (4, 4) its palm frame, where it is known. source: for messages.
    Raises:
        ShapeError, InputError: no points, not finite, or none within 5 cm of the object.
    """
    points = np.asarray(hand_points_O, np.float64)
    check_shape("hand_points_O", points.shape, (None, 3))
    radius = contact_radius(obj)
    closeness = contact_map_from_points(obj.points_O, points, radius=radius)
    _check_near(obj, closeness, radius, "hand_points_O")
    return _query(obj, closeness, np.ones(len(closeness)), radius, source, X_OP)


def query_from_contacts(obj: ObjectModel, contact_points_O: np.ndarray) -> TransferQuery:
    """The query of contacts drawn on the object: touch these, and little else.

    Args:
        contact_points_O: (K, 3) points on the object's surface, metres, K >= 1; a few.
    Raises:
        ShapeError, InputError: no points, not finite, or none within 5 cm of the object.
    """
    points = np.asarray(contact_points_O, np.float64)
    check_shape("contact_points_O", points.shape, (None, 3))
    radius = contact_radius(obj)
    closeness = contact_map_from_points(obj.points_O, points, radius=radius)
    _check_near(obj, closeness, radius, "contact_points_O")
    weight = closeness.astype(np.float64) + ELSEWHERE
    return _query(obj, closeness, weight / weight.mean(), radius, "contacts", None)


def _query(
    obj: ObjectModel, closeness: np.ndarray, weight: np.ndarray, radius: float, source: str, X_OP: np.ndarray | None
) -> TransferQuery:
    return TransferQuery(
        object=obj.name,
        points_O=np.ascontiguousarray(obj.points_O, np.float64),
        contact_map=closeness.astype(np.float32),
        weight=np.ascontiguousarray(weight, np.float64),
        radius_m=radius,
        source=source,
        X_OP=None if X_OP is None else np.array(X_OP, np.float64),
    )


def _check_near(obj: ObjectModel, closeness: np.ndarray, radius: float, name: str) -> None:
    nearest = -radius * np.log(max(float(closeness.max()), 1e-300))
    if nearest > FAR_M:
        raise InputError(
            f"the nearest of {name} is {1e3 * nearest:.0f} mm from '{obj.name}'; expected points in the object's "
            "frame, metres, some of them on its surface. Check the frame and the unit."
        )
