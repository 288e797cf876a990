"""`neuralgrasps bench`: benchmarks that print their figures."""

from __future__ import annotations

import importlib
import platform
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from neuralgrasps.cli.options import (
    AllNames,
    OptionalFile,
    OptionalFolder,
    OptionalInt,
    OptionalText,
    Workers,
    check_seed,
)
from neuralgrasps.cli.terminal import Outcome, Terminal
from neuralgrasps.errors import InputError

Benchmark = Literal["demo", "synthesis", "latent", "pose", "execute", "transfer", "demonstrate", "joints"]
_FIXED_HANDS = {
    "pose": "the hands are those of the shipped run",
    "execute": "it measures Fetch, and Panda with the Allegro hand",
    "demonstrate": "a Fetch repeats what people show",
    "joints": "it reads the human hand",
}


def bench(
    terminal: Terminal,
    name: Annotated[
        Literal["demo", "synthesis", "latent", "pose", "execute", "transfer", "demonstrate", "joints"],
        tyro.conf.Positional,
    ],
    /,
    *,
    objects: AllNames = (),
    hands: AllNames = (),
    count: OptionalInt = None,
    seed: int = 0,
    workers: Workers = None,
    quick: bool = False,
    unseen_hand: OptionalFile = None,
    run: OptionalText = None,
    grasps: OptionalFolder = None,
) -> Outcome:
    """Run a benchmark and print its figures; with --json as one object {name, machine, config, figures, ...}.

    Args:
        name: demo, the whole path into a temporary folder; synthesis, speed and quality of grasps pair by pair;
            latent, cost and quality of the latent space; pose, errors and speed of pose estimates beside others';
            execute, objects lifted in simulation, by pose method and robot; transfer, grasps carried over between all
            pairs of hands; demonstrate, synthetic RGB-D demonstrations repeated by a robot; or joints, a person's hand
            read by the joint net in random scenes.
        objects: names, mesh files or folders of mesh files; default the three objects of the demo, or all built-in;
            latent and what follows: the scans where they were imported or downloaded.
        hands: default the five built-in hands; not of pose, execute, demonstrate and joints.
        count: grasps per hand and object; default 24 in demo, 60 in synthesis and latent; pose: scenes per object and
            set, default 20, with --quick 10; execute: scenes per object, default 50, with --quick 5; transfer: queries
            per pair of hands and object, default 10, with --quick 2; demonstrate: videos per object, default 10, with
            --quick 2; joints: scenes of each set of solids, default 700, with --quick 240.
        seed: root of every random number.
        workers: processes.
        quick: demo: one object, two hands and 8 grasps a pair; synthesis: three objects; latent: the shipped run, and
            two objects trained anew; the others: fewer scenes, queries or videos.
        unseen_hand: synthesis: also time 20 grasps of the soup can by this URDF or MJCF in a fresh process.
        run: latent: measure this run, by folder or shipped name, and train two of its objects anew.
        grasps: latent: folder of grasps; those of all pairs are made there first unless they are.
    """
    check_seed(seed)
    if count is not None and count < 1:
        raise InputError(f"--count is {count}; expected at least 1.")
    options: dict[str, Any] = {
        "objects": objects, "hands": hands, "count": count, "seed": seed, "workers": workers, "quick": quick,
    }  # fmt: skip
    options |= {"unseen_hand": unseen_hand, "run": run, "grasps": grasps}
    chosen = _options(name, options)
    measured_on = machine()
    measure = getattr(importlib.import_module(f"neuralgrasps.cli.bench_{name}"), f"bench_{name}")
    result = measure(terminal, **chosen)
    terminal.table(("figure", "value"), [(key, float(value)) for key, value in result["figures"].items()])
    return Outcome(result={"name": name, "machine": measured_on, **result})


def _options(name: Benchmark, given: dict[str, Any]) -> dict[str, Any]:
    """Those that a benchmark takes.

    Raises:
        InputError: one was given that belongs to another.
    """
    options = dict(given)
    if name != "synthesis" and options.pop("unseen_hand") is not None:
        raise InputError(f"--unseen-hand is of 'bench synthesis'; 'bench {name}' takes every hand with --hands.")
    if name != "latent" and (options.pop("run") is not None) | (options.pop("grasps") is not None):
        raise InputError(f"--run and --grasps are of 'bench latent'; 'bench {name}' makes its own.")
    if name in _FIXED_HANDS and options.pop("hands"):
        raise InputError(f"--hands is not of 'bench {name}': {_FIXED_HANDS[name]}.")
    return options


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    import psutil

    from neuralgrasps.parallel import available_cpus

    return {
        "system": platform.system(),
        "architecture": platform.machine(),
        "processor": _processor(),
        "cores": available_cpus(),
        "load_1_min_before": round(psutil.getloadavg()[0], 2),
        "memory_gb": round(psutil.virtual_memory().total / 1e9, 1),
        "python": platform.python_version(),
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "")
