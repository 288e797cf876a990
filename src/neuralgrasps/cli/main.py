"""The entry point: find the verb, parse its options, run it, and end with the right exit code."""

from __future__ import annotations

import contextlib
import functools
import inspect
import os
import re
import shlex
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import neuralgrasps
from neuralgrasps.cli.failures import BAD_INPUT, BROKEN_PIPE, DONE, INTERRUPTED, TERMINATED, Terminated, describe
from neuralgrasps.cli.outputs import check_writable
from neuralgrasps.cli.terminal import Outcome, Terminal, open_terminal, write_json
from neuralgrasps.cli.verbs import VERBS, Verb, find_verb, show_help
from neuralgrasps.errors import InputError


@dataclass(frozen=True, slots=True)
class GlobalOptions:
    """Options that every verb takes, and the arguments without them."""

    args: list[str]
    json: str | None
    debug: bool


def run(argv: Sequence[str] | None = None) -> int:
    """Run a command line (`sys.argv` when None) and return its exit code.

    0 done, 1 ran and failed, 2 bad input, 130 stopped with Ctrl-C.
    """
    args = list(sys.argv[1:] if argv is None else argv)
    # Threads that wait actively make small-net training many times slower on shared cores; torch reads this on import.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    before = _catch_sigterm()
    try:
        options = split_global_options(args)
        terminal = open_terminal(
            shlex.join(["neuralgrasps", *args]),
            json_to_stdout=options.json == "-",
            stdout=sys.stdout,
            stderr=sys.stderr,
        )
        code = _guarded(options, terminal)
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        # The reader (head, less) has seen enough. Without this, Python complains when it closes stdout.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def split_global_options(args: Sequence[str]) -> GlobalOptions:
    """Take --json [PATH|-] and --debug out of the arguments, wherever they stand."""
    rest: list[str] = []
    target: str | None = None
    debug = False
    i = 0
    while i < len(args):
        arg = args[i]
        if arg == "--debug":
            debug = True
        elif arg == "--json":
            follows = args[i + 1] if i + 1 < len(args) else "--"
            is_verb = not rest and any(follows == verb.words[0] for verb in VERBS)
            takes = follows == "-" or not (follows.startswith("-") or is_verb)
            target = follows if takes else "-"
            i += takes
        elif arg.startswith("--json="):
            target = arg.removeprefix("--json=") or "-"
        else:
            rest.append(arg)
        i += 1
    return GlobalOptions(rest, target, debug)


def _guarded(options: GlobalOptions, terminal: Terminal) -> int:
    """The command's exit code; whatever it raises becomes a message and, if asked for, a JSON object."""
    try:
        if options.json is not None:
            check_json_target(options.json)
        outcome = _dispatch(options.args, terminal)
        if options.json is not None:
            write_json(options.json, outcome.result, sys.stdout)
        return outcome.exit_code
    except SystemExit as end:  # the option parser has said what is wrong, or has shown its help
        code = end.code if isinstance(end.code, int) else BAD_INPUT
        return _failed(options, terminal, "the options cannot be read", code, quiet=True) if code else DONE
    except BrokenPipeError:
        raise
    except KeyboardInterrupt as error:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # what is left is short: let it finish
        kept = f" {terminal.kept}" if terminal.kept else " Nothing was written."
        code = TERMINATED if isinstance(error, Terminated) else INTERRUPTED
        return _failed(options, terminal, f"stopped.{kept}", code)
    except Exception as error:  # the last resort of a program; everything is named in `describe`
        if options.debug:
            traceback.print_exc()
        failure = describe(error)
        return _failed(options, terminal, failure.message, failure.exit_code)


def _failed(options: GlobalOptions, terminal: Terminal, message: str, code: int, *, quiet: bool = False) -> int:
    if not quiet:
        terminal.complain(f"{'stopped' if code >= INTERRUPTED else 'error'}: {message.removeprefix('stopped. ')}")
    if options.json is not None:
        # an older result must not be taken for this run's; what cannot be written has been said above
        with contextlib.suppress(OSError, ValueError):
            write_json(options.json, {"error": message, "exit_code": code}, sys.stdout)
    return code


def check_json_target(target: str) -> None:
    """Refuse a file that cannot be written before the work; "-" and devices can."""
    path = Path(target)
    if target != "-" and (path.is_file() or path.is_dir() or not path.exists()):
        check_writable(path)


def _dispatch(args: list[str], terminal: Terminal) -> Outcome:
    if "--version" in args[:1]:
        terminal.say(f"neuralgrasps {neuralgrasps.__version__}")
        return Outcome(result={"version": neuralgrasps.__version__})
    verb, words = find_verb(args)
    if verb is None:
        rest = args[len(words) :]
        if rest and rest[0] not in ("-h", "--help"):
            raise InputError(f"option '{rest[0]}' came before a verb; expected: neuralgrasps VERB {rest[0]} ...")
        show_help(terminal.out, words)
        if words and not rest:
            terminal.complain(f"error: '{words[0]}' needs one of the verbs above.")
            raise SystemExit(BAD_INPUT)
        return Outcome()
    return parse_and_call(verb, args[len(words) :], terminal)


def parse_and_call(verb: Verb, args: Sequence[str], terminal: Terminal) -> Outcome:
    """Parse a verb's own options by the types and docstring of its function, and call it."""
    import tyro

    function = verb.function()
    call: Callable[[], Any] = tyro.cli(
        _deferred(function, terminal),
        prog=" ".join(("neuralgrasps", *verb.words)),
        description=_description(function),
        args=[f" {a}" if re.fullmatch(r"-[xyz](:\S*)?", a) else a for a in args],  # an axis, no option
        config=(tyro.conf.FlagCreatePairsOff,),
    )
    outcome = call()
    assert isinstance(outcome, Outcome)
    return outcome


def _deferred(function: Callable[..., Any], terminal: Terminal) -> Callable[..., Callable[[], Any]]:
    """`function` without its first parameter, called later: what it raises is then no matter of the parser."""

    @functools.wraps(function)
    def collect(*args: Any, **options: Any) -> Callable[[], Any]:
        return functools.partial(function, terminal, *args, **options)

    signature = inspect.signature(function, eval_str=True)
    parameters = list(signature.parameters.values())[1:]
    hints: Mapping[str, Any] = {p.name: p.annotation for p in parameters}
    collect.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    collect.__annotations__ = {**hints, "return": Callable[[], Any]}
    del collect.__wrapped__
    return collect


def _description(function: Callable[..., Any]) -> str:
    text = (inspect.getdoc(function) or "").split("\nArgs:")[0].strip()
    return f"{text}\n\nAlso: --json [PATH|-] writes the result as one JSON object; --debug shows tracebacks."


def _catch_sigterm() -> dict[int, Any]:
    """Make SIGTERM end the work in good order; returns the handlers to put back."""

    def stop(*_: object) -> None:
        raise Terminated

    if threading.current_thread() is not threading.main_thread():
        return {}
    before: dict[int, Any] = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    signal.signal(signal.SIGTERM, stop)
    return before
