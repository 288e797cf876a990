"""Synthesise grasps of many hands and objects into a folder: on all cores, resumable, the same for any worker count."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import neuralgrasps
from neuralgrasps.errors import DataFormatError, InputError
from neuralgrasps.files import write_whole
from neuralgrasps.grasps.grasp_io import load_grasps, save_grasps
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.fingerprint import fingerprint, hand_fingerprint
from neuralgrasps.hands.hand import Hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.parallel import run_tasks
from neuralgrasps.sim.protocols import get_protocol
from neuralgrasps.synthesis.synthesise import SynthesisConfig, SynthesisResult, synthesise

ENGINES = ("libigl", "mujoco", "numba", "numpy")  # another version of these may make other grasps

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class PairRecord:
    """What synthesis did for one hand and object; times are those of the run that made the grasps.

    Attributes:
        hand, object: names. wanted, validated: grasps asked for, and found.
        proposals: start poses drawn; valid: closed hands that passed all geometric tests, before refinement.
        tried: grasps that went into physics; physics_success: share of them that held, nan when none was tried.
        cpu_s: CPU-seconds. reason: why fewer than wanted were found, "" otherwise.
    """

    hand: str
    object: str
    wanted: int
    validated: int
    proposals: int
    valid: int
    tried: int
    physics_success: float
    cpu_s: float
    reason: str


def record_of(result: SynthesisResult, wanted: int) -> PairRecord:
    """The numbers of one synthesis."""
    return PairRecord(
        hand=result.grasps.hand,
        object=result.grasps.object,
        wanted=wanted,
        validated=result.validated,
        proposals=result.proposals,
        valid=result.outcomes["valid"],
        tried=result.tried,
        physics_success=result.physics_success,
        cpu_s=sum(result.cpu_s.values()),
        reason=result.reason,
    )


def collect_grasps(
    folder: str | Path,
    hands: Sequence[Hand],
    objects: Sequence[ObjectModel],
    *,
    config: SynthesisConfig | None = None,
    seed: int = 0,
    workers: int | None = None,
    progress: Progress | None = None,
) -> tuple[list[GraspSet], list[PairRecord]]:
    """Grasps of every hand on every object, one file a pair.

    A pair whose file is there, made from the same hand, object, config, protocol, seed and versions (`pair_key`), is
    read instead of made again; so a run that was killed goes on where it was.

    Args:
        folder: gets `<object>/<hand>.safetensors` and a `.json` with the numbers beside each.
        workers: processes; all processors when None. The grasps do not depend on it.
        progress: called with (pairs done, pairs, text).
    Returns:
        Grasp sets and records, by object, then hand, in the order given. A set may hold fewer than wanted, or none.
    Raises:
        InputError: two hands or two objects of one name, or a name that is not a file name.
        StorageError: the folder cannot be written.
    """
    folder, config = Path(folder), config or SynthesisConfig()
    _check_names("hand", [hand.name for hand in hands])
    _check_names("object", [obj.name for obj in objects])
    pairs = [(hand, obj) for obj in objects for hand in hands]
    of_hand = {hand.name: hand_fingerprint(hand) for hand in hands}
    of_object = {obj.name: object_fingerprint(obj) for obj in objects}
    keys = [_key(of_hand[hand.name], of_object[obj.name], config, seed) for hand, obj in pairs]
    paths = [folder / obj.name / f"{hand.name}.safetensors" for hand, obj in pairs]
    done = {i: found for i, path in enumerate(paths) if (found := _read(path, keys[i])) is not None}
    # dexterous hands take longest: first in, so that no worker ends alone
    todo = sorted((i for i in range(len(pairs)) if i not in done), key=lambda i: -pairs[i][0].num_dofs)
    tasks = [(*pairs[i], config, seed) for i in todo]
    if progress is not None and done:
        progress(len(done), len(pairs), "kept from an earlier run")
    for index, result in run_tasks(_synthesise_pair, tasks, workers=workers):
        i = todo[index]
        record = record_of(result, config.count)
        grasps = result.grasps.with_config(key=keys[i])
        write_whole(paths[i].with_suffix(".json"), _record_text(record))
        hand, obj = pairs[i]
        save_grasps(paths[i], grasps, hand=hand, object_fingerprint=of_object[obj.name])
        done[i] = (grasps, record)
        if progress is not None:
            progress(len(done), len(pairs), f"{record.hand} on {record.object}: {record.validated}")
    return [done[i][0] for i in range(len(pairs))], [done[i][1] for i in range(len(pairs))]


def _synthesise_pair(hand: Hand, obj: ObjectModel, config: SynthesisConfig, seed: int) -> SynthesisResult:
    return synthesise(hand, obj, config=config, seed=seed)


def object_fingerprint(obj: ObjectModel) -> str:
    """sha256 (hex) over every field of an object but its symmetry and the texts about its origin.

    Neither synthesis nor physics uses those; mass, centre of mass, friction and convex parts they do.
    """
    return fingerprint(obj, leave_out=("symmetry", "provenance"))


def pair_key(hand: Hand, obj: ObjectModel, config: SynthesisConfig, seed: int) -> str:
    """sha256 (hex) of all that the grasps of a pair are made from, with every number of the protocol and `ENGINES`."""
    return _key(hand_fingerprint(hand), object_fingerprint(obj), config, seed)


def _key(of_hand: str, of_object: str, config: SynthesisConfig, seed: int) -> str:
    protocols = tuple(get_protocol(name) for name in (config.protocol, *config.also))
    versions = (neuralgrasps.__version__, *(version(name) for name in ENGINES))
    return fingerprint((versions, of_hand, of_object, config, protocols, seed))


def _check_names(kind: str, names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{kind} '{name}' was given twice; grasps are stored by name: give each {kind} its own.")
        if not name or name in (".", "..") or Path(name).name != name:
            raise InputError(f"{kind} '{name}' cannot name a file; rename it without slashes.")


def _record_text(record: PairRecord) -> str:
    """JSON, which has no nan: null stands for it."""
    values = {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in asdict(record).items()}
    return json.dumps(values, indent=1, allow_nan=False)


def _record_of_text(text: str) -> PairRecord:
    values: dict[str, Any] = {k: math.nan if v is None else v for k, v in json.loads(text).items()}
    return PairRecord(**values)


def _read(path: Path, key: str) -> tuple[GraspSet, PairRecord] | None:
    """A finished pair; None when there is none, it is damaged, or it was made from something else."""
    beside = path.with_suffix(".json")
    if not (path.is_file() and beside.is_file()):
        return None
    try:
        grasps = load_grasps(path)
        record = _record_of_text(beside.read_text())
    except (DataFormatError, ValueError, TypeError, AttributeError):
        return None
    return (grasps, record) if grasps.config.get("key") == key else None
