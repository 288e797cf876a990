"""`neuralgrasps bench synthesis`: speed and quality of grasps, hand by hand and object by object."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuralgrasps.cli.bench_library import read_objects
from neuralgrasps.cli.bench_result import object_origins
from neuralgrasps.cli.models import open_hands
from neuralgrasps.cli.terminal import Terminal
from neuralgrasps.errors import InputError

if TYPE_CHECKING:
    from neuralgrasps.evaluate.synthesis_bench import BenchResult

QUICK_OBJECTS = ("cracker_box", "tomato_soup_can", "mustard_bottle")
SOUP_CAN = "tomato_soup_can"
UNSEEN_COUNT = 20
_UNSEEN_LIMIT_S = 600
_NOTES = {
    "warm": "compiled loops are loaded, by a few uncounted grasps of a box, before anything is timed; objects are read "
    "before",
    "cpu_s": "of the whole call: every stage, every thread",
    "validated_per_min_4c": "240 times validated grasps per CPU-second: what four idle cores would make in a minute",
    "success_before_filter": "held of tried in physics, in the order they come; nothing is left out by physics before",
    "penetration": "against the true mesh, points of both surfaces every 2 mm",
    "table_wall_s": "all pairs at once; starts of processes and loading of compiled loops included",
    "alone": "one pair at a time in a warm process, all cores",
    "epsilon_ms": "mean over the grasps in force closure, called from Python",
}


def bench_synthesis(
    terminal: Terminal,
    *,
    objects: Sequence[str],
    hands: Sequence[str],
    count: int | None,
    seed: int,
    workers: int | None,
    quick: bool,
    unseen_hand: Path | None,
) -> dict[str, Any]:
    """Config, figures, pairs and more of the benchmark; `quick`: three objects."""
    from neuralgrasps.evaluate.synthesis_bench import BenchConfig
    from neuralgrasps.evaluate.synthesis_bench import bench_synthesis as run
    from neuralgrasps.evaluate.synthesis_figures import infeasible_pairs
    from neuralgrasps.evaluate.synthesis_pairs import pair_record
    from neuralgrasps.hands.zoo import hand_sources
    from neuralgrasps.parallel import available_cpus
    from neuralgrasps.synthesis.synthesise import SynthesisConfig

    if unseen_hand is not None and not unseen_hand.exists():
        raise InputError(f"--unseen-hand '{unseen_hand}' does not exist; expected a URDF or MJCF file.")
    config = BenchConfig(
        synthesis=SynthesisConfig() if count is None else SynthesisConfig(count=count), seed=seed, workers=workers
    )
    sources = bench_objects(objects, quick=quick)
    with terminal.progress("reading hands"):
        loaded = open_hands(hand_sources(hands))
    models = read_objects(terminal, sources)
    with terminal.progress("synthesis") as bar:
        result = run(list(loaded.values()), list(models.values()), config=config, progress=bar.stage)
    figures = dict(result.figures)
    more: dict[str, Any] = {}
    if unseen_hand is not None:
        with terminal.progress(f"{unseen_hand.name} in a fresh process"):
            more["unseen_hand"] = make_with_unseen_hand(unseen_hand, _soup_can(sources), seed=seed)
        figures["unseen_hand_wall_s"] = more["unseen_hand"]["wall_s_to_count"]
    records = [pair_record(pair) for pair in result.pairs]
    missing = infeasible_pairs(result.pairs)
    _show(terminal, records, result)
    for pair in missing:
        terminal.say(f"{pair['hand']} on {pair['object']}: {pair['validated']} of {pair['wanted']}: {pair['reason']}")
    shown = {
        "objects": list(models),
        "object_sources": object_origins(models),
        "hands": list(loaded),
        "seed": seed,
        "workers": workers or available_cpus(),
        "threads_alone": workers or available_cpus(),
        "quick": quick,
        **asdict(config.synthesis),
        "notes": _NOTES,
    }
    return {
        "config": shown,
        "physics": dict(result.pairs[0].parameters),
        "figures": figures,
        "epsilon": asdict(result.epsilon) if result.epsilon else None,
        **more,
        "infeasible": missing,
        "pairs": records,
    }


def bench_objects(given: Sequence[str], *, quick: bool) -> tuple[str, ...]:
    """Sources of the objects: names and files as given, folders unfolded, the built-in ones when nothing is given.

    `quick` keeps cracker box, soup can and mustard where all three are there, else the first three.
    """
    from neuralgrasps.evaluate.published import plain_name
    from neuralgrasps.objects.builtin import STAND_INS
    from neuralgrasps.objects.zoo import object_sources

    sources = object_sources(tuple(given) or tuple(STAND_INS))
    if not quick:
        return sources
    named = {plain_name(Path(source).stem): source for source in sources}
    return tuple(named[name] for name in QUICK_OBJECTS) if set(QUICK_OBJECTS) <= set(named) else sources[:3]


def _soup_can(sources: Sequence[str]) -> str:
    from neuralgrasps.evaluate.published import plain_name

    return next((source for source in sources if plain_name(Path(source).stem) == SOUP_CAN), SOUP_CAN)


def make_with_unseen_hand(hand: Path, object_source: str, *, seed: int, count: int = UNSEEN_COUNT) -> dict[str, Any]:
    """Grasps by `neuralgrasps synthesise` in a fresh process, from its start to its end.

    Returns:
        `wall_s_to_count` is nan when fewer than `count` were found; `reason` says why.
    """
    with tempfile.TemporaryDirectory(prefix="neuralgrasps-bench-") as folder:
        out, record_file = Path(folder) / "grasps.safetensors", Path(folder) / "record.json"
        command = [
            *(sys.executable, "-m", "neuralgrasps", "synthesise", "--hand", str(hand), "--object", object_source),
            *("--count", str(count), "--seed", str(seed), "--out", str(out), "--json", str(record_file)),
        ]
        start = time.perf_counter()
        reason = ""
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_UNSEEN_LIMIT_S)
            if done.returncode:
                reason = done.stderr.strip()[-300:]
        except subprocess.TimeoutExpired:
            reason = f"not done after {_UNSEEN_LIMIT_S} s"
        wall_s = time.perf_counter() - start
        try:
            record: Mapping[str, Any] = json.loads(record_file.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            record = {}
    validated = int(record.get("validated") or 0)
    return {
        "file": hand.name,
        "object": object_source,
        "wanted": count,
        "validated": validated,
        "wall_s": wall_s,
        "wall_s_to_count": wall_s if validated >= count else float("nan"),
        "reason": reason or record.get("reason") or "",
    }


def _show(terminal: Terminal, records: Sequence[Mapping[str, Any]], result: BenchResult) -> None:
    columns = (
        ("hand", "hand"), ("object", "object"), ("grasps", "validated"), ("valid per CPU s", "valid_per_cpu_s"),
        ("per min, 4 cores", "validated_per_min_4c"), ("held", "success_before_filter"),
        ("overlap p95 mm", "penetration_p95_mm"), ("epsilon", "epsilon_median"),
        ("covered", "approach_coverage_30deg_share"), ("s alone", "alone_wall_s"),
    )  # fmt: skip
    terminal.table([title for title, _ in columns], [[r.get(key) for _, key in columns] for r in records])
    if result.epsilon:
        check = result.epsilon
        terminal.say(
            f"epsilon against Qhull: {check.sign_errors} sign errors of {check.count} ({check.force_closure} in force "
            f"closure), largest difference {check.max_difference:.1e}"
        )
