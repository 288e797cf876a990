"""The `GraspSet` noun: grasps of one object by one hand, with their qualities and verdicts."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from neuralgrasps.errors import InputError, ShapeError, unknown_name

ROTATION_TOLERANCE = 1e-6  # largest entry of R'R - I that still counts as a rotation
DEFAULT_PROTOCOL = "dexgraspbench"


def _frozen(value: Any, dtype: type[np.generic]) -> np.ndarray:
    """A read-only contiguous view of `value` as `dtype`."""
    view = np.ascontiguousarray(value, dtype=dtype).view()
    view.flags.writeable = False
    return view


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """What one physics protocol said about N grasps.

    Attributes:
        success: (N,) bool.
        displacement_m: (N,) float64, largest movement of the object in the hand during the trial, metres.
        rotation_rad: (N,) float64, largest rotation of the object in the hand, rad.
        parameters: the protocol's numbers (mass, friction, forces, ...), the same for all N.
    Raises:
        ShapeError: the arrays do not have the same length.
    """

    success: np.ndarray
    displacement_m: np.ndarray
    rotation_rad: np.ndarray
    parameters: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "success", _frozen(self.success, np.bool_))
        object.__setattr__(self, "displacement_m", _frozen(self.displacement_m, np.float64))
        object.__setattr__(self, "rotation_rad", _frozen(self.rotation_rad, np.float64))
        parameters = {str(k): float(v) for k, v in self.parameters.items()}
        object.__setattr__(self, "parameters", parameters)
        shapes = {name: getattr(self, name).shape for name in ("success", "displacement_m", "rotation_rad")}
        if len(set(shapes.values())) != 1 or self.success.ndim != 1:
            raise ShapeError(f"verdict arrays have shapes {shapes}; expected one (N,) for all three.")

    def __repr__(self) -> str:
        return f"Verdict({int(self.success.sum())} of {len(self)} held)"

    def __len__(self) -> int:
        return len(self.success)

    def _take(self, index: Any) -> Verdict:
        return Verdict(
            success=self.success[index],
            displacement_m=self.displacement_m[index],
            rotation_rad=self.rotation_rad[index],
            parameters=self.parameters,
        )


_ARRAYS: dict[str, type[np.generic]] = {
    "X_OH": np.float64,
    "q": np.float64,
    "q_pregrasp": np.float64,
    "q_squeeze": np.float64,
    "contact_points_O": np.float64,
    "contact_normals_O": np.float64,
    "contact_links": np.int32,
    "epsilon": np.float64,
    "penetration_m": np.float64,
    "force_residual": np.float64,
    "palm_contact": np.bool_,
    "finger_count": np.int32,
    "precision": np.bool_,
}
# What the columns of a set hold that nobody measured.
_UNKNOWN: dict[str, float | int | bool] = {
    "force_residual": np.nan,
    "palm_contact": False,
    "finger_count": -1,
    "precision": False,
}
_FINITE = ("X_OH", "q", "q_pregrasp", "q_squeeze", "epsilon", "penetration_m")


@dataclass(frozen=True, slots=True, kw_only=True)
class GraspSet:
    """N grasps of one object by one hand. `grasps[i]` is a GraspSet of length 1.

    Frames: O object, H hand base. Arrays are read-only; make changed copies with `with_...`
    or `dataclasses.replace`.

    Attributes:
        hand, object: names of the hand and the object.
        X_OH: (N, 4, 4) float64, hand base in the object frame, metres.
        q: (N, J) float64, joints at the grasp, rad or metres; q_pregrasp: before closing; q_squeeze: the
            position targets that press the fingers on the object.
        contact_points_O: (N, C, 3) float64 on the object's surface, metres, nan where there is no contact.
        contact_normals_O: (N, C, 3) float64 unit, outward from the object, nan where there is no contact.
        contact_links: (N, C) int32, the hand link that touches, -1 where there is no contact.
        epsilon: (N,) float64, Ferrari-Canny quality (0 = not force closure).
        penetration_m: (N,) float64, deepest overlap of hand and object or of the hand with itself, >= 0.
        force_residual: (N,) float64, net wrench of the best unit squeeze (`force_qp`), 0 = balanced; nan: not measured.
        palm_contact: (N,) bool, the palm touches. finger_count: (N,) int32, fingers that touch; -1: not labelled.
        precision: (N,) bool, a precision grasp: only fingertips touch. Labelled and not precision: a power grasp.
        verdicts: what each physics protocol said, by the protocol's name.
        protocol: the name of the verdict that `validated` reads.
        seed: the seed the set was made with.
        config: how the set was made, as text, for provenance.
    Raises:
        ShapeError: an array's shape does not agree with the others.
        InputError: not a rotation (to 1e-6), not finite, or contacts padded in only one of their arrays.
    """

    hand: str
    object: str
    X_OH: np.ndarray
    q: np.ndarray
    q_pregrasp: np.ndarray
    q_squeeze: np.ndarray
    contact_points_O: np.ndarray
    contact_normals_O: np.ndarray
    contact_links: np.ndarray
    epsilon: np.ndarray
    penetration_m: np.ndarray
    force_residual: np.ndarray = None  # type: ignore[assignment]  # None becomes a column of unknowns
    palm_contact: np.ndarray = None  # type: ignore[assignment]
    finger_count: np.ndarray = None  # type: ignore[assignment]
    precision: np.ndarray = None  # type: ignore[assignment]
    verdicts: Mapping[str, Verdict] = field(default_factory=dict)
    protocol: str = DEFAULT_PROTOCOL
    seed: int = 0
    config: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, dtype in _ARRAYS.items():
            value = getattr(self, name)
            if value is None and name in _UNKNOWN:
                value = np.full(len(self.X_OH), _UNKNOWN[name])
            object.__setattr__(self, name, _frozen(value, dtype))
        object.__setattr__(self, "verdicts", dict(self.verdicts))
        object.__setattr__(self, "config", {str(k): str(v) for k, v in self.config.items()})
        self._check_shapes()
        self._check_values()

    def _check_shapes(self) -> None:
        if self.X_OH.ndim != 3 or self.q.ndim != 2 or self.contact_links.ndim != 2:
            raise ShapeError(
                f"X_OH, q, contact_links have shapes {self.X_OH.shape}, {self.q.shape}, {self.contact_links.shape}; "
                "expected (N, 4, 4), (N, J), (N, C)."
            )
        count, joints, contacts = len(self.X_OH), self.q.shape[1], self.contact_links.shape[1]
        expected = {
            "X_OH": (count, 4, 4),
            "q": (count, joints),
            "q_pregrasp": (count, joints),
            "q_squeeze": (count, joints),
            "contact_points_O": (count, contacts, 3),
            "contact_normals_O": (count, contacts, 3),
            "contact_links": (count, contacts),
            **dict.fromkeys(("epsilon", "penetration_m", *_UNKNOWN), (count,)),
        }
        for name, shape in expected.items():
            got = getattr(self, name).shape
            if got != shape:
                raise ShapeError(
                    f"grasps of '{self.object}' by '{self.hand}': {name} has shape {got}; expected {shape}."
                )
        for name, verdict in self.verdicts.items():
            if len(verdict) != count:
                raise ShapeError(f"verdict '{name}' holds {len(verdict)} grasps; the set holds {count}.")

    def _check_values(self) -> None:
        where = f"grasps of '{self.object}' by '{self.hand}'"
        for name in _FINITE:
            value = getattr(self, name)
            bad = ~np.isfinite(value).all(axis=tuple(range(1, value.ndim)))
            if bad.any():
                raise InputError(f"{where}: {name} is not finite in grasps {_some(bad)}; drop them first.")
        R = self.X_OH[:, :3, :3]
        defect = np.abs(R.transpose(0, 2, 1) @ R - np.eye(3)).max(axis=(1, 2), initial=0.0)
        bad = (defect > ROTATION_TOLERANCE) | (np.linalg.det(R) < 0) | (self.X_OH[:, 3] != (0, 0, 0, 1)).any(axis=1)
        if bad.any():
            raise InputError(
                f"{where}: X_OH is not a rigid transform in grasps {_some(bad)}: expected R'R = I to "
                f"{ROTATION_TOLERANCE:g}, determinant +1, last row 0 0 0 1; compute it in float64."
            )
        if (self.penetration_m < 0).any():
            raise InputError(f"{where}: penetration_m is negative in grasps {_some(self.penetration_m < 0)}; 0 = none.")
        empty = self.contact_links < 0
        for name in ("contact_points_O", "contact_normals_O"):
            value = getattr(self, name)
            wrong = (np.isnan(value).all(axis=-1) != empty) | (~np.isfinite(value).all(axis=-1) != empty)
            if wrong.any():
                raise InputError(
                    f"{where}: {name} and contact_links disagree on which contacts exist in grasps "
                    f"{_some(wrong.any(axis=1))}; pad points and normals with nan where the link is -1."
                )

    def __repr__(self) -> str:
        count = len(self)
        words = [f"{count} grasp" if count == 1 else f"{count} grasps"]
        if self.protocol in self.verdicts:
            words.append(f"{int(self.validated.sum())} held '{self.protocol}'")
        if count:
            words.append(
                "epsilon " + "-".join(dict.fromkeys(f"{v:.2f}" for v in (self.epsilon.min(), self.epsilon.max())))
            )
        return f"GraspSet({self.hand} on {self.object}: {', '.join(words)})"

    def __len__(self) -> int:
        return len(self.X_OH)

    def __getitem__(self, index: int | slice | Sequence[int] | np.ndarray) -> GraspSet:
        """The chosen grasps, always as a GraspSet (length 1 for an integer).

        Raises:
            InputError: a mask of another length, or an index that is not an integer, slice, mask or integer array.
            IndexError: out of range.
        """
        chosen = self._normal_index(index)
        arrays = {name: getattr(self, name)[chosen] for name in _ARRAYS}
        verdicts = {name: verdict._take(chosen) for name, verdict in self.verdicts.items()}
        return replace(self, **arrays, verdicts=verdicts)

    def _normal_index(self, index: Any) -> slice | np.ndarray:
        if isinstance(index, slice):
            return index
        array = np.asarray(index)
        if array.ndim == 0 and array.dtype != np.bool_:
            i = operator.index(index)
            if not -len(self) <= i < len(self):
                raise IndexError(f"grasp {i} of a set of {len(self)}")
            return np.array([i])
        if array.size == 0 and array.dtype != np.bool_:
            array = array.astype(np.int64)
        if array.ndim != 1 or array.dtype.kind not in "biu":
            raise InputError(
                f"cannot index grasps with {array.dtype} of shape {array.shape}; use int, slice, mask or (K,)."
            )
        if array.dtype == np.bool_ and len(array) != len(self):
            raise InputError(f"the mask has {len(array)} entries; the set holds {len(self)} grasps.")
        return array

    @property
    def num_joints(self) -> int:
        return self.q.shape[1]

    @property
    def num_contacts(self) -> np.ndarray:
        """(N,) contacts per grasp, padding not counted."""
        return (self.contact_links >= 0).sum(axis=1)

    @property
    def validated(self) -> np.ndarray:
        """(N,) bool: success under `protocol`; all False when that protocol was not run."""
        if self.protocol not in self.verdicts:
            return np.zeros(len(self), np.bool_)
        return self.verdicts[self.protocol].success

    def succeeded(self, protocol: str) -> np.ndarray:
        """(N,) bool: success under the named protocol.

        Raises:
            UnknownNameError: the set holds no verdict of that protocol.
        """
        if protocol not in self.verdicts:
            raise unknown_name("verdict", protocol, self.verdicts)
        return self.verdicts[protocol].success

    def with_verdict(self, name: str, verdict: Verdict, *, decides: bool = True) -> GraspSet:
        """A copy with the verdict of protocol `name` added or replaced; if it `decides`, `validated` reads it then."""
        return replace(self, verdicts={**self.verdicts, name: verdict}, protocol=name if decides else self.protocol)

    def with_config(self, **entries: str) -> GraspSet:
        """A copy with provenance entries added or replaced."""
        return replace(self, config={**self.config, **entries})


def empty_grasps(hand: str, object_name: str, *, num_joints: int, num_contacts: int = 0, seed: int = 0) -> GraspSet:
    """A set of no grasps, the neutral element of `concatenate`."""
    joints, vectors = np.zeros((0, num_joints)), np.zeros((0, num_contacts, 3))
    return GraspSet(
        hand=hand,
        object=object_name,
        X_OH=np.zeros((0, 4, 4)),
        q=joints,
        q_pregrasp=joints,
        q_squeeze=joints,
        contact_points_O=vectors,
        contact_normals_O=vectors,
        contact_links=np.zeros((0, num_contacts), np.int32),
        epsilon=np.zeros(0),
        penetration_m=np.zeros(0),
        seed=seed,
    )


def pad_contacts(grasps: GraspSet, num_contacts: int) -> GraspSet:
    """A copy with at least `num_contacts` contact slots (nan and -1 in the new ones)."""
    extra = num_contacts - grasps.contact_links.shape[1]
    if extra <= 0:
        return grasps
    pad = ((0, 0), (0, extra))
    return replace(
        grasps,
        contact_points_O=np.pad(grasps.contact_points_O, (*pad, (0, 0)), constant_values=np.nan),
        contact_normals_O=np.pad(grasps.contact_normals_O, (*pad, (0, 0)), constant_values=np.nan),
        contact_links=np.pad(grasps.contact_links, pad, constant_values=-1),
    )


def concatenate(sets: Sequence[GraspSet]) -> GraspSet:
    """All grasps in order, contacts padded to the widest set. Empty sets may lack the others' verdicts.

    The seed and the protocol are the first non-empty set's; provenance that differs is joined with " | ".

    Raises:
        InputError: no sets; another hand, object or number of joints; other verdicts or other parameters of one.
    """
    if not sets:
        raise InputError("concatenate got no grasp sets; use empty_grasps for a set of none.")
    first = next((s for s in sets if len(s)), sets[0])
    for name, get in (("hand", lambda s: s.hand), ("object", lambda s: s.object), ("joints", lambda s: s.num_joints)):
        values = sorted({str(get(s)) for s in sets})
        if len(values) > 1:
            raise InputError(
                f"cannot concatenate grasps that differ in {name}: {', '.join(values)}; keep one set per pair."
            )
    full = [s for s in sets if len(s)] or [first]
    width = max(s.contact_links.shape[1] for s in full)
    padded = [pad_contacts(s, width) for s in full]
    arrays: dict[str, Any] = {name: np.concatenate([getattr(s, name) for s in padded]) for name in _ARRAYS}
    config = {
        key: " | ".join(dict.fromkeys(s.config[key] for s in full if key in s.config))
        for key in dict.fromkeys(k for s in full for k in s.config)
    }
    return replace(first, **arrays, verdicts=_joined_verdicts(full), config=config)


def _joined_verdicts(sets: Sequence[GraspSet]) -> dict[str, Verdict]:
    names = [tuple(sorted(s.verdicts)) for s in sets]
    if len(set(names)) > 1:
        raise InputError(f"cannot concatenate grasps with other verdicts: {sorted(set(names))}; validate all or none.")
    joined: dict[str, Verdict] = {}
    for name in sets[0].verdicts:
        parts = [s.verdicts[name] for s in sets]
        if any(dict(p.parameters) != dict(parts[0].parameters) for p in parts):
            raise InputError(f"verdict '{name}' was reached with different parameters; validate all grasps alike.")
        joined[name] = Verdict(
            success=np.concatenate([p.success for p in parts]),
            displacement_m=np.concatenate([p.displacement_m for p in parts]),
            rotation_rad=np.concatenate([p.rotation_rad for p in parts]),
            parameters=parts[0].parameters,
        )
    return joined


def array_fields() -> tuple[str, ...]:
    """Names of the array attributes, in order."""
    return tuple(f.name for f in fields(GraspSet) if f.name in _ARRAYS)


def _some(bad: np.ndarray) -> str:
    index = np.flatnonzero(bad)
    return ", ".join(str(i) for i in index[:5]) + (", ..." if len(index) > 5 else "")
