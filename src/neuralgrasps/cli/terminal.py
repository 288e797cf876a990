"""What a command shows and returns: text and tables for people, one JSON object for programs."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from rich import box
from rich.console import Console
from rich.table import Table

from neuralgrasps.cli.progress import ProgressBar
from neuralgrasps.files import write_whole

Cell = str | float | int | None
_NAME_WIDTH = 24
_WIDEST = 400


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What a command did: `result` becomes the JSON object; `exit_code` 0 = done, 1 = ran and failed."""

    result: Mapping[str, Any] = field(default_factory=dict)
    exit_code: int = 0


@dataclass(slots=True)
class Terminal:
    """Where a command writes. Results go to `out`, progress and errors to `err`.

    Attributes:
        command: the command line as typed, for reports.
        kept: what is on disk when the command is stopped, and how to go on; commands set it as they work.
    """

    out: Console
    err: Console
    command: str = "neuralgrasps"
    kept: str = ""

    def say(self, text: str = "") -> None:
        """A line of result; wrapped on a terminal only, so that programs find it whole."""
        self.out.print(text, soft_wrap=not self.out.is_terminal)

    def complain(self, text: str) -> None:
        """A line to stderr."""
        self.err.print(text, soft_wrap=not self.err.is_terminal)

    def notes(self, lines: Sequence[str], *, title: str = "") -> None:
        """Lines with a bullet each; nothing when there are none."""
        if lines and title:
            self.out.print(title)
        for line in lines:
            grid = Table.grid(padding=(0, 1))
            grid.add_row("  -", line)
            self.out.print(grid)

    def facts(self, facts: Sequence[tuple[str, Cell]]) -> None:
        """Names and values in two columns."""
        grid = Table.grid(padding=(0, 2))
        grid.add_column(no_wrap=True)
        grid.add_column(overflow="fold")
        for name, value in facts:
            grid.add_row(f"  {name}", cell_text(value))
        self.out.print(grid)

    def table(self, columns: Sequence[str], rows: Sequence[Sequence[Cell]]) -> None:
        """A table; columns of numbers are aligned right."""
        table = Table(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0), header_style="bold")
        for i, name in enumerate(columns):
            texts = [cell_text(row[i]) for row in rows]
            table.add_column(
                name,
                justify="right" if all(_is_number(row[i]) for row in rows) else "left",
                no_wrap=max(map(len, texts), default=0) <= _NAME_WIDTH and " " not in name,
                overflow="fold",
                vertical="bottom",
            )
        for row in rows:
            table.add_row(*map(cell_text, row))
        self.out.print(table)

    def progress(self, title: str, unit: str = "") -> ProgressBar:
        """A progress bar for a `with` block; hidden until the work takes over a second."""
        return ProgressBar(self.err, title, unit)


class _PipedConsole(Console):
    """Reports a closed pipe instead of ending the process with rich's own exit code."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError


def open_terminal(command: str, *, json_to_stdout: bool, stdout: IO[str], stderr: IO[str]) -> Terminal:
    """Consoles for a command; people's text gives way to stderr when stdout carries the JSON object."""

    def console(stream: IO[str]) -> Console:
        # outside a terminal every row stays on one line, as wide as it needs
        width = None if stream.isatty() else _WIDEST
        return _PipedConsole(file=stream, markup=False, highlight=False, emoji=False, width=width)

    return Terminal(out=console(stderr if json_to_stdout else stdout), err=console(stderr), command=command)


def _is_number(value: Cell) -> bool:
    return (
        not isinstance(value, str)
        or value.removesuffix(" %").removeprefix("< ").replace(".", "", 1).lstrip("-").isdigit()
    )


def cell_text(value: Cell) -> str:
    """A table cell: a dash for what was not measured, at most three significant digits behind the point."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"
    return str(value)


def write_json(target: str, result: Mapping[str, Any], stdout: IO[str]) -> None:
    """Write one JSON object to a file, whole or not at all, or to stdout when `target` is "-"."""
    text = json.dumps(plain(result), indent=1, allow_nan=False) + "\n"
    if target == "-":
        stdout.write(text)
        stdout.flush()
    elif Path(target).exists() and not Path(target).is_file():
        Path(target).write_text(text, encoding="utf-8")  # a device or pipe: nothing to put in its place
    else:
        write_whole(Path(target), text)


def plain(value: Any) -> Any:
    """JSON has no nan: None. numpy's numbers and arrays become Python's."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | int | bool):
        return value
    return str(value)


def counted(count: int, noun: str) -> str:
    """ "1 hand", "3 hands"."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
