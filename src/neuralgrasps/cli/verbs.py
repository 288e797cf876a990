"""The verbs of the command line, where each lives, and the page that lists them."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.table import Table

from neuralgrasps.errors import UnknownNameError, unknown_name


@dataclass(frozen=True, slots=True)
class Verb:
    """One command: the words that call it, where its function is, and what it does in a line."""

    words: tuple[str, ...]
    home: str
    summary: str

    def function(self) -> Callable[..., Any]:
        module, _, name = self.home.partition(":")
        return getattr(importlib.import_module(f"neuralgrasps.cli.{module}"), name)


VERBS: tuple[Verb, ...] = (
    Verb(("demo",), "demo:demo", "the whole path once, with built-in or your own objects, to a report page"),
    Verb(("hands", "list"), "hands:list_hands", "the built-in hands"),
    Verb(("hands", "show"), "hands:show_hand", "joints and fingers of a hand"),
    Verb(("hands", "check"), "hands:check_hand", "whether a URDF or MJCF file can be used, and how it was read"),
    Verb(("arms", "list"), "arms:list_arms", "the built-in arms"),
    Verb(("arms", "show"), "arms:show_arm", "joints, limits and flange of an arm, and where a hand goes on it"),
    Verb(("objects", "list"), "objects:list_objects", "built-in, imported and downloaded objects"),
    Verb(("objects", "show"), "objects:show_object", "size, mass and symmetry of an object or mesh file"),
    Verb(("objects", "import"), "objects:import_mesh", "keep a mesh file under a name"),
    Verb(("objects", "download"), "objects:download", "fetch scanned meshes from their publisher"),
    Verb(("synthesise",), "synthesise:synthesise", "make grasps, each proven in physics"),
    Verb(("dataset", "build"), "dataset:build", "from grasp files, or hands and objects, to a dataset for training"),
    Verb(("dataset", "info"), "dataset:info", "what a dataset holds"),
    Verb(("dataset", "verify"), "dataset:verify", "check every file and some distances of a dataset"),
    Verb(("train",), "train:train", "fit the latent space that all hands share"),
    Verb(("evaluate",), "evaluate:evaluate", "measure a trained run, a dataset or grasps"),
    Verb(("retrieve",), "retrieve:retrieve", "grasps of any hand that hold an object alike"),
    Verb(("novel",), "novel:novel", "new grasps from codes near and between known ones, tried in physics"),
    Verb(("transfer",), "transfer:transfer", "grasps of one hand that hold an object as another hand does"),
    Verb(("pose",), "pose:pose", "where an object is, from points or a depth image"),
    Verb(("execute",), "execute:execute", "look, plan, grasp and lift objects in simulation, with films"),
    Verb(("human", "record"), "human_record:human_record", "synthetic RGB-D videos of a hand that grasps an object"),
    Verb(("human", "train"), "human_train:human_train", "the networks that find hands and joints in depth images"),
    Verb(("demonstrate",), "demonstrate:demonstrate", "watch a person grasp an object; a robot hand grasps it alike"),
    Verb(("export",), "export:export", "grasps as MoveIt messages or isaac_grasp files"),
    Verb(("bench",), "bench:bench", "run a benchmark and print its figures"),
)

GLOBAL_OPTIONS = (
    ("--json [PATH|-]", "also write the result as one JSON object to a file or, alone or with -, to stdout"),
    ("--debug", "show the traceback when something fails"),
    ("-h, --help", "help of any verb"),
    ("--version", "print the version"),
)


def find_verb(args: Sequence[str]) -> tuple[Verb | None, tuple[str, ...]]:
    """The verb that the arguments start with and the words before it ends; no verb for a group alone.

    Raises:
        UnknownNameError: no such verb, with the nearest one as a hint.
    """
    words = tuple(a for a in args[:2] if not a.startswith("-"))
    if not args or args[0].startswith("-"):
        return None, ()
    for verb in VERBS:
        if args[: len(verb.words)] == list(verb.words):
            return verb, verb.words
    group = [v.words[1] for v in VERBS if len(v.words) == 2 and v.words[0] == words[0]]
    if not group:
        raise unknown_name("verb", words[0], dict.fromkeys(v.words[0] for v in VERBS))
    if len(words) == 1:
        return None, words
    error = unknown_name("verb", words[1], group)
    raise UnknownNameError(f"{words[0]}: {error}")


def show_help(console: Console, group: tuple[str, ...] = ()) -> None:
    """The list of all verbs, or of those of a group."""
    chosen = [v for v in VERBS if v.words[: len(group)] == group]
    prefix = " ".join(("neuralgrasps", *group))
    console.print(f"usage: {prefix} VERB [OPTIONS]\n")
    if not group:
        console.print("Grasping with any robot hand: synthesis proven in physics, one latent space for all hands.\n")
    console.print(_two_columns([(" ".join(v.words), v.summary) for v in chosen]))
    console.print()
    console.print(_two_columns(GLOBAL_OPTIONS))
    console.print(f"\n{prefix} VERB --help shows what a verb takes. Start with: neuralgrasps demo", soft_wrap=True)


def _two_columns(rows: Sequence[tuple[str, str]]) -> Table:
    grid = Table.grid(padding=(0, 2))
    grid.add_column(no_wrap=True, min_width=17)
    grid.add_column()
    for name, text in rows:
        grid.add_row(f"  {name}", text)
    return grid
