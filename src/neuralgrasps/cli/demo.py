"""`neuralgrasps demo`: the whole path once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from neuralgrasps.cli.options import AllNames, Folder, Workers, check_seed
from neuralgrasps.cli.outputs import check_writable
from neuralgrasps.cli.terminal import Outcome, Terminal

DemoObjects = Annotated[
    tuple[str, ...], tyro.conf.arg(metavar="NAME|FILE ...", help_behavior_hint="(default: three built-in ones)")
]


def demo(
    terminal: Terminal,
    /,
    *,
    objects: DemoObjects = ("cracker_box", "tomato_soup_can", "mustard_bottle"),
    hands: AllNames = (),
    count: int = 24,
    seed: int = 0,
    workers: Workers = None,
    out: Folder = Path("out"),
) -> Outcome:
    """Run the whole path once: grasps, dataset, latent space, retrieval, object poses, and a page that shows it all.

    Args:
        objects: names, mesh files, or folders of mesh files.
        hands: names, or URDF or MJCF files; default the five built-in hands.
        count: grasps per hand and object.
        seed: the same seed gives the same result.
        workers: processes.
        out: folder for report.html and everything that was made.
    """
    from neuralgrasps.demo.data import DemoConfig
    from neuralgrasps.demo.run import run_demo
    from neuralgrasps.hands.zoo import hand_names

    check_seed(seed)
    check_writable(out, folder=True)
    config = DemoConfig(
        objects=objects,
        hands=hands or hand_names(),
        count=count,
        seed=seed,
        workers=workers,
        out=out,
        command=terminal.command,
    )
    terminal.kept = f"Finished grasps are kept in '{out}'; the same command goes on from there."
    with terminal.progress("demo") as bar:
        result = run_demo(config, progress=bar.stage)
    terminal.say()
    terminal.notes(result.summary)
    terminal.say(f"\nReport: {result.report_path}")
    return Outcome(result={"report": str(result.report_path), **result.figures})
