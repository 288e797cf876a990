"""`neuralgrasps bench`: benchmarks that print their figures."""

from __future__ import annotations

import platform
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from neuralgrasps.cli.options import AllNames, Workers
from neuralgrasps.cli.terminal import Outcome, Terminal
from neuralgrasps.errors import NeuralGraspsError

_IMPORTS = 5


def bench(
    terminal: Terminal,
    name: Annotated[Literal["demo"], tyro.conf.Positional],
    /,
    *,
    objects: AllNames = (),
    hands: AllNames = (),
    count: int = 24,
    seed: int = 0,
    workers: Workers = None,
    quick: bool = False,
) -> Outcome:
    """Run a benchmark and print its figures; with --json as one object {name, machine, config, figures}.

    Args:
        name: demo, the whole path into a temporary folder.
        objects: names, mesh files or folders of mesh files; default the three objects of the demo.
        hands: default the five built-in hands.
        count: grasps per hand and object.
        seed: root of every random number.
        workers: processes.
        quick: one object, two hands and 8 grasps a pair.
    """
    from neuralgrasps.demo.data import DemoConfig
    from neuralgrasps.demo.run import run_demo
    from neuralgrasps.parallel import available_cpus

    options: dict[str, Any] = {"count": count, "seed": seed, "workers": workers}
    if quick:
        options |= {"count": 8, "hands": ("panda", "allegro"), "pose_views": 2}
        options |= {} if objects else {"objects": ("mustard_bottle",)}
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
    terminal.table(("figure", "value"), [(key, float(value)) for key, value in figures.items()])
    return Outcome(result={"name": name, "machine": machine(), "config": shown, "figures": figures})


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    import psutil

    from neuralgrasps.parallel import available_cpus

    return {
        "system": platform.system(),
        "architecture": platform.machine(),
        "processor": _processor(),
        "cores": available_cpus(),
        "memory_gb": round(psutil.virtual_memory().total / 1e9, 1),
        "python": platform.python_version(),
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "")


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
