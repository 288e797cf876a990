"""Proof that a grasp lifts the object off its table, kept for the next scene in the same resting pose."""

from __future__ import annotations

import json
from collections import OrderedDict
from contextlib import suppress
from pathlib import Path

from neuralgrasps.errors import StorageError
from neuralgrasps.files import write_whole
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.fingerprint import fingerprint
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.cache import home_folder
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.planning.grasp_cache import engine_versions, pair_fingerprint
from neuralgrasps.planning.resting_plane import nearest_resting_plane, rounded_plane
from neuralgrasps.sim.table_lift import LiftConfig, try_lifts

_VERSION = 1  # raise it when the trial changes


class LiftProof:
    """Says of grasps of one object, as it lies, whether they lift it in physics: `sim.table_lift`, 0.1 s each, once.

    Verdicts are kept in the library's cache folder, one file per hand, object, resting pose and trial. They depend on
    nothing else, so a lost file costs time only.

    Args:
        plane_O: the table in the object's frame, normal up; the nearest resting pose stands for it.
        config: of the trial; its friction is a margin.
    """

    def __init__(self, hand: Hand, obj: ObjectModel, plane_O: Plane, *, config: LiftConfig | None = None) -> None:
        self.hand, self.obj, self.config = hand, obj, config or LiftConfig()
        self.plane_O = nearest_resting_plane(obj, plane_O) or rounded_plane(plane_O)
        self.key = fingerprint((_VERSION, engine_versions(), pair_fingerprint(hand, obj), self.plane_O, self.config))
        self._path = home_folder() / "cache" / "lifts" / f"{self.key}.json"
        self._known = _read(self._path)
        self.tried = 0

    def __call__(self, grasp: GraspSet) -> bool:
        """Whether one grasp (a set of one) lifts the object and holds it."""
        key = fingerprint((grasp.X_OH, grasp.q, grasp.q_pregrasp, grasp.q_squeeze))
        if key not in self._known:
            self.tried += 1
            self._known[key] = bool(try_lifts(self.hand, self.obj, grasp, self.plane_O, config=self.config).success[0])
        return self._known[key]

    def keep(self) -> None:
        """Write what was found out; a folder that cannot be written costs time only."""
        if self.tried:
            with suppress(StorageError, OSError):
                write_whole(self._path, json.dumps({**_read(self._path), **self._known}, sort_keys=True))
            self.tried = 0


def _read(path: Path) -> dict[str, bool]:
    try:
        read = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return {str(k): v for k, v in read.items() if isinstance(v, bool)} if isinstance(read, dict) else {}


_KEPT: OrderedDict[str, LiftProof] = OrderedDict()
_MOST_KEPT = 128


def lift_proof(hand: Hand, obj: ObjectModel, plane_O: Plane, *, friction_scale: float, grip: float) -> LiftProof:
    """The `LiftProof` of this process with a share of the object's friction and of the hand's effort; opened once."""
    proof = LiftProof(hand, obj, plane_O, config=LiftConfig(friction_scale=friction_scale, grip=grip))
    proof = _KEPT.setdefault(proof.key, proof)
    _KEPT.move_to_end(proof.key)
    while len(_KEPT) > _MOST_KEPT:
        _KEPT.popitem(last=False)
    return proof
