"""`neuralgrasps bench demo`: the whole path into a temporary folder."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from neuralgrasps.cli.terminal import Terminal
from neuralgrasps.errors import NeuralGraspsError

_IMPORTS = 5


def bench_demo(
    terminal: Terminal,
    *,
    objects: Sequence[str],
    hands: Sequence[str],
    count: int | None,
    seed: int,
    workers: int | None,
    quick: bool,
) -> dict[str, Any]:
    """Config and figures of the benchmark; `quick`: one object, two hands and 8 grasps a pair."""
    from neuralgrasps.demo.data import DemoConfig
    from neuralgrasps.demo.run import run_demo
    from neuralgrasps.parallel import available_cpus

    options: dict[str, Any] = {"count": count or (8 if quick else 24), "seed": seed, "workers": workers}
    if quick:
        options |= {"hands": ("panda", "allegro"), "objects": ("mustard_bottle",), "pose_views": 2}
    if objects:
        options["objects"] = tuple(objects)
    if hands:
        options["hands"] = tuple(hands)
    with tempfile.TemporaryDirectory(prefix="neuralgrasps-bench-") as folder:
        config = DemoConfig(out=Path(folder), **options)
        with terminal.progress("demo") as bar:
            result = run_demo(config, progress=bar.stage)
    figures = {**result.figures, "import_wall_s": import_seconds()}
    shown = {
        "objects": list(config.objects),
        "hands": list(config.hands),
        "count": config.count,
        "seed": seed,
        "workers": workers or available_cpus(),
        "quick": quick,
    }
    return {"config": shown, "figures": figures}


def import_seconds() -> float:
    """Fastest of five `import neuralgrasps`, each in a fresh process, measured inside it."""
    code = "import time; t = time.perf_counter(); import neuralgrasps; print(time.perf_counter() - t)"
    best = float("inf")
    for _ in range(_IMPORTS):
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        if done.returncode:
            raise NeuralGraspsError(f"`import neuralgrasps` failed in a fresh process: {done.stderr.strip()[-300:]}")
        best = min(best, float(done.stdout))
    return best
