"""Grasp codes: [contact closeness of 96 cells | palm frame | posture], 128 numbers for any hand.

The contact block is the metric. The object's contact points are divided into 96 even cells; the block holds the sum of
each cell's closeness. So its L1 distance is never above the L1 distance of the contact maps, and differs from it only
where two grasps swap sides within a cell; it has the same meaning for all hands. The palm block is the same for all
hands too: where the palm is and which way it faces. The posture block belongs to one hand: its normalised joints in a
basis of its own. Codes of known grasps are computed, not fitted, and hold the grasp without loss up to 23 joints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial import KDTree

from neuralgrasps.errors import InputError, ShapeError, unknown_name
from neuralgrasps.geometry.sampling import farthest_points
from neuralgrasps.hands.hand import Hand

CELLS, PALM, POSTURE = 96, 9, 23
CODE_SIZE = CELLS + PALM + POSTURE
CONTACT_BLOCK = slice(0, CELLS)
PALM_BLOCK = slice(CELLS, CELLS + PALM)
POSTURE_BLOCK = slice(CELLS + PALM, CODE_SIZE)
PALM_UNIT_M = 0.1  # one unit of the palm position
_LLOYD_STEPS = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectCodec:
    """What codes need to know of an object.

    Attributes:
        points_O: (P, 3) float64 the object's contact points, metres.
        cell_of: (P,) int32, the cell of each.
        centres_O: (96, 3) float64 middles of the cells, metres.
        offset_O: (3,) centre that palm positions are relative to, metres.
        radius_m: decay length of the contact closeness.
    """

    name: str
    points_O: np.ndarray
    cell_of: np.ndarray
    centres_O: np.ndarray
    offset_O: np.ndarray
    radius_m: float

    @property
    def weights(self) -> np.ndarray:
        """(96,) what the block of a map of ones holds: each cell's number of points, 1 on average."""
        return np.bincount(self.cell_of, minlength=CELLS) * (CELLS / len(self.cell_of))


def object_codec(name: str, points_O: np.ndarray, *, offset_O: np.ndarray, radius_m: float) -> ObjectCodec:
    """The codec of an object from its (P, 3) contact points, P >= 96."""
    if points_O.ndim != 2 or points_O.shape[1] != 3 or len(points_O) < CELLS:
        raise ShapeError(f"object '{name}': points_O has shape {points_O.shape}; expected (P >= {CELLS}, 3).")
    centres, cell_of = even_cells(points_O - offset_O)
    return ObjectCodec(
        name=name,
        points_O=np.ascontiguousarray(points_O, np.float64),
        cell_of=cell_of,
        centres_O=centres + offset_O,
        offset_O=np.asarray(offset_O, np.float64),
        radius_m=float(radius_m),
    )


def even_cells(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middles (96, 3) and cell of each point (P,) int32: farthest points, then Lloyd's iteration; no cell is empty."""
    centres = points[farthest_points(points, CELLS, start=int(np.argmax(np.linalg.norm(points, axis=1))))].copy()
    cell_of = KDTree(centres).query(points)[1]
    for _ in range(_LLOYD_STEPS):
        middles = np.stack([points[cell_of == k].mean(axis=0) for k in range(CELLS)])
        moved = KDTree(middles).query(points)[1]
        if len(np.unique(moved)) < CELLS:  # never seen; the cells before are good too
            break
        centres, cell_of = middles, moved
    return np.ascontiguousarray(centres, np.float64), cell_of.astype(np.int32)


def contact_blocks(maps: np.ndarray, codec: ObjectCodec) -> np.ndarray:
    """Contact blocks (..., 96) float32 of contact maps (..., P).

    Each is the sum over a cell times 96 / P, so that the mean |difference| of two blocks is at most that of the maps.

    Raises:
        ShapeError: the maps are not of this object's contact points.
    """
    count = len(codec.cell_of)
    if maps.shape[-1] != count:
        raise ShapeError(f"contact maps of {maps.shape[-1]} points; '{codec.name}' has {count} contact points.")
    order = np.argsort(codec.cell_of, kind="stable")
    starts = np.searchsorted(codec.cell_of[order], np.arange(CELLS))
    sums = np.add.reduceat(maps[..., order].astype(np.float64), starts, axis=-1)
    return (sums * (CELLS / count)).astype(np.float32)


@dataclass(frozen=True, slots=True, kw_only=True)
class HandCodec:
    """Posture basis of one hand.

    A posture block is `2 (u - mean) @ basis` of the normalised joints u = (q - lower) / (upper - lower).

    Attributes:
        lower, upper: (J,) joint limits, rad or metres.
        mean: (J,) mean normalised joints; basis: (J, 23), orthonormal rows for J <= 23 (zero columns
            beyond J), the 23 strongest synergies otherwise.
        X_HP: (4, 4) palm frame in the hand base.
    """

    name: str
    lower: np.ndarray
    upper: np.ndarray
    mean: np.ndarray
    basis: np.ndarray
    X_HP: np.ndarray

    @property
    def num_joints(self) -> int:
        return len(self.lower)

    @property
    def is_lossless(self) -> bool:
        """Whether every posture can be recovered from its block."""
        return self.num_joints <= POSTURE

    def posture(self, q: np.ndarray) -> np.ndarray:
        """Posture blocks (N, 23) of joints (N, J)."""
        u = (q - self.lower) / joint_spans(self.lower, self.upper)
        return 2.0 * (u - self.mean) @ self.basis

    def joints(self, posture: np.ndarray) -> np.ndarray:
        """Joints (N, J) of posture blocks (N, 23), clamped to the limits."""
        u = self.mean + 0.5 * posture @ self.basis.T
        return self.lower + np.clip(u, 0.0, 1.0) * (self.upper - self.lower)


def joint_spans(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """(J,) ranges of the joints; 1 for those that cannot move."""
    return np.where(upper > lower, upper - lower, 1.0)


def hand_codec(hand: Hand, postures: np.ndarray | None = None) -> HandCodec:
    """The codec of a hand; with example postures (N, J) its basis is their principal components.

    The strongest components come first, and each is signed so that a positive number closes the hand. The
    basis is a rotation, so distances between postures do not depend on the examples (up to 23 joints).
    """
    lower, upper = hand.tree.lower.astype(float), hand.tree.upper.astype(float)
    joints = hand.num_dofs
    if postures is None or len(postures) == 0:
        mean, components = np.full(joints, 0.5), np.eye(joints)
    else:
        hand.check_q(postures)
        u = (postures - lower) / joint_spans(lower, upper)
        mean = u.mean(axis=0)
        values, vectors = np.linalg.eigh((u - mean).T @ (u - mean) / len(u) + 1e-9 * np.diag(np.arange(joints, 0, -1)))
        components = vectors[:, np.argsort(-values, kind="stable")]
    components = components[:, :POSTURE]
    lean = components.T @ np.sign(hand.closing_rate)
    largest = components[np.abs(components).argmax(axis=0), np.arange(components.shape[1])]
    signs = np.sign(np.where(np.abs(lean) > 1e-6, lean, largest))
    basis = np.zeros((joints, POSTURE))
    basis[:, : components.shape[1]] = components * signs
    return HandCodec(name=hand.name, lower=lower, upper=upper, mean=mean, basis=basis, X_HP=np.array(hand.X_HP, float))


def palm_block(X_OH: np.ndarray, X_HP: np.ndarray, offset_O: np.ndarray) -> np.ndarray:
    """(N, 9): palm position relative to the object's centre in units of 0.1 m, and two columns of its rotation."""
    X_OP = X_OH @ X_HP
    position = (X_OP[:, :3, 3] - offset_O) / PALM_UNIT_M
    return np.concatenate([position, X_OP[:, :3, 0], X_OP[:, :3, 1]], axis=1)


def assemble_codes(
    contact: np.ndarray, X_OH: np.ndarray, q: np.ndarray, *, hand: HandCodec, obj: ObjectCodec
) -> np.ndarray:
    """Codes (N, 128) float32 from contact blocks (N, 96), hand poses (N, 4, 4) and joints (N, J)."""
    if contact.shape != (len(X_OH), CELLS) or q.shape != (len(X_OH), hand.num_joints):
        raise ShapeError(
            f"contact {contact.shape}, X_OH {X_OH.shape}, q {q.shape}; "
            f"expected (N, {CELLS}), (N, 4, 4), (N, {hand.num_joints}) for hand '{hand.name}'."
        )
    if not (np.isfinite(X_OH).all() and np.isfinite(q).all()):
        raise InputError(f"a pose or joint of hand '{hand.name}' is not finite; expected numbers.")
    blocks = [contact, palm_block(X_OH, hand.X_HP, obj.offset_O), hand.posture(q)]
    return np.concatenate(blocks, axis=1).astype(np.float32)


@dataclass(frozen=True, slots=True, kw_only=True)
class CodeBook:
    """Codes of N grasps, and whose they are.

    Attributes:
        values: (N, 128) float32.
        hands, objects: names that the indices count in.
        hand_index, object_index: (N,) int32.
        grasp_index: (N,) int32, place in the grasp set of that hand and object (-1: from no set).
        contact_maps: (N, P) float32 closeness at all contact points of the object, or (N, 0).
        is_test: (N,) bool, grasps that training must not see.
        metric_size: how many leading numbers L1 retrieval compares: the contact block, or all 128 of free codes.
    """

    values: np.ndarray
    hands: tuple[str, ...]
    objects: tuple[str, ...]
    hand_index: np.ndarray
    object_index: np.ndarray
    grasp_index: np.ndarray
    contact_maps: np.ndarray
    is_test: np.ndarray = field(default_factory=lambda: np.zeros(0, np.bool_))
    metric_size: int = CELLS

    def __post_init__(self) -> None:
        count = len(self.values)
        if self.values.ndim != 2 or self.values.shape[1] != CODE_SIZE:
            raise ShapeError(f"codes have shape {self.values.shape}; expected (N, {CODE_SIZE}).")
        if self.is_test.size == 0 and count:
            object.__setattr__(self, "is_test", np.zeros(count, np.bool_))
        for name in ("hand_index", "object_index", "grasp_index", "contact_maps", "is_test"):
            got = getattr(self, name).shape[:1]
            if got != (count,):
                raise ShapeError(f"code book: {name} has length {got}; expected {count}, one per code.")
        for name, known in (("hand_index", self.hands), ("object_index", self.objects)):
            index = getattr(self, name)
            if count and (index.min() < 0 or index.max() >= len(known)):
                raise InputError(f"code book: {name} reaches {index.max()}; expected 0 to {len(known) - 1}.")

    def __repr__(self) -> str:
        count, unseen = len(self), int(self.is_test.sum())
        words = [f"{count} code" if count == 1 else f"{count} codes"]
        words += [f"{unseen} unseen"] if unseen else []
        whose = " on ".join(", ".join(names) or "none" for names in (self.hands, self.objects))
        return f"CodeBook({whose}: {', '.join(words)})"

    def __len__(self) -> int:
        return len(self.values)

    @property
    def contact_block(self) -> np.ndarray:
        """(N, 96) closeness of the object's cells to the hand."""
        return self.values[:, CONTACT_BLOCK]

    @property
    def metric(self) -> np.ndarray:
        """(N, metric_size) the part of the codes in which L1 distance is grasp similarity."""
        return self.values[:, : self.metric_size]

    def __getitem__(self, index: int | slice | np.ndarray) -> CodeBook:
        """The chosen codes, always as a CodeBook."""
        chosen = np.array([index]) if isinstance(index, int | np.integer) else index
        names = ("values", "hand_index", "object_index", "grasp_index", "contact_maps", "is_test")
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})

    def where(
        self, *, hand: str | None = None, object_name: str | None = None, is_test: bool | None = None
    ) -> np.ndarray:
        """(N,) bool: codes of a hand, of an object, of the test grasps; each None matches all.

        Raises:
            UnknownNameError: the hand or object is not in the book.
        """
        mask = np.ones(len(self), np.bool_)
        if hand is not None:
            mask &= self.hand_index == _place("hand", hand, self.hands)
        if object_name is not None:
            mask &= self.object_index == _place("object", object_name, self.objects)
        if is_test is not None:
            mask &= self.is_test == is_test
        return mask


def _place(kind: str, name: str, known: Sequence[str]) -> int:
    if name not in known:
        raise unknown_name(kind, name, known)
    return list(known).index(name)


def join_codes(books: Sequence[CodeBook]) -> CodeBook:
    """One book of all codes, in order; names are merged, sorted."""
    if not books:
        raise InputError("join_codes got no code books.")
    hands = tuple(sorted({name for book in books for name in book.hands}))
    objects = tuple(sorted({name for book in books for name in book.objects}))
    widths = {book.contact_maps.shape[1] for book in books}
    if len(widths) > 1:
        raise ShapeError(f"code books hold contact maps of {sorted(widths)} points; expected one size.")
    metrics = {book.metric_size for book in books}
    if len(metrics) > 1:
        raise ShapeError(f"code books compare {sorted(metrics)} numbers; codes of different fields cannot be joined.")

    def renumbered(index: np.ndarray, old: Sequence[str], new: Sequence[str]) -> np.ndarray:
        table: Mapping[str, int] = {name: i for i, name in enumerate(new)}
        return np.array([table[name] for name in old], np.int32)[index]

    return CodeBook(
        values=np.concatenate([b.values for b in books]),
        hands=hands,
        objects=objects,
        hand_index=np.concatenate([renumbered(b.hand_index, b.hands, hands) for b in books]),
        object_index=np.concatenate([renumbered(b.object_index, b.objects, objects) for b in books]),
        grasp_index=np.concatenate([b.grasp_index for b in books]),
        contact_maps=np.concatenate([b.contact_maps for b in books]),
        is_test=np.concatenate([b.is_test for b in books]),
        metric_size=metrics.pop(),
    )
