"""The command line as a whole: help, versions, options of every verb, streams."""

from __future__ import annotations

import inspect
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import neuralgrasps
from neuralgrasps.cli.main import run, split_global_options
from neuralgrasps.cli.verbs import VERBS


def python(*args: str, **options: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *args], capture_output=True, text=True, check=False, **options)  # type: ignore[call-overload,no-any-return]


@pytest.mark.parametrize("args", [[], ["--help"], ["-h"]])
def test_help_lists_every_verb(args: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(args) == 0
    text = capsys.readouterr().out
    assert all(" ".join(verb.words) in text for verb in VERBS)


@pytest.mark.parametrize("verb", VERBS, ids=lambda v: " ".join(v.words))
def test_every_verb_explains_its_options(verb, capsys: pytest.CaptureFixture[str]) -> None:  # type: ignore[no-untyped-def]
    assert run([*verb.words, "--help"]) == 0
    text = capsys.readouterr().out
    assert f"usage: neuralgrasps {' '.join(verb.words)}" in text
    assert "--json" in text
    described = (inspect.getdoc(verb.function()) or "").partition("Args:")[2]
    options = list(inspect.signature(verb.function()).parameters)[1:]
    assert [name for name in options if f"{name}: " not in described] == []


def test_group_alone_lists_its_verbs_and_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["hands"]) == 2
    streams = capsys.readouterr()
    assert "hands check" in streams.out and "objects" not in streams.out
    assert "needs one of the verbs" in streams.err


@pytest.mark.parametrize(
    ("args", "expected"),
    [
        (["synthesize"], "Did you mean 'synthesise'?"),
        (["hands", "chek"], "Did you mean 'check'?"),
        (["--seed", "3"], "before a verb"),
    ],
)
def test_wrong_verbs_are_answered_with_the_right_one(
    args: list[str], expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(args) == 2
    assert expected in capsys.readouterr().err


def test_wrong_options_end_with_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["hands", "list", "--nonsense"]) == 2
    assert "--nonsense" in capsys.readouterr().err
    assert run(["synthesise", "--count", "many"]) == 2
    assert "--count" in capsys.readouterr().err


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--version"]) == 0
    assert capsys.readouterr().out.strip() == f"neuralgrasps {neuralgrasps.__version__}"


@pytest.mark.parametrize(
    ("args", "rest", "target", "debug"),
    [
        (["--json", "x.json", "hands", "list"], ["hands", "list"], "x.json", False),
        (["hands", "--debug", "list", "--json=x.json"], ["hands", "list"], "x.json", True),
        (["hands", "list", "--json"], ["hands", "list"], "-", False),
        (["hands", "list", "--json", "-"], ["hands", "list"], "-", False),
        (["bench", "demo", "--json", "--quick"], ["bench", "demo", "--quick"], "-", False),
        (["--json", "hands", "list"], ["hands", "list"], "-", False),
        (["demo"], ["demo"], None, False),
    ],
)
def test_global_options_stand_anywhere(args: list[str], rest: list[str], target: str | None, debug: bool) -> None:
    options = split_global_options(args)
    assert (options.args, options.json, options.debug) == (rest, target, debug)


def test_json_on_stdout_leaves_the_text_to_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["hands", "list", "--json"]) == 0
    streams = capsys.readouterr()
    assert [h["name"] for h in json.loads(streams.out)["hands"]] == list(neuralgrasps.hand_names())
    assert "allegro" in streams.err


def test_failures_are_told_in_json_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["hands", "show", "alegro", "--json", "-"]) == 2
    streams = capsys.readouterr()
    told = json.loads(streams.out)
    assert told["exit_code"] == 2 and "Did you mean 'allegro'?" in told["error"]
    assert told["error"] in streams.err


def test_a_json_file_that_cannot_be_written_stops_the_work_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    assert run(["hands", "list", "--json", str(tmp_path / "file" / "x.json")]) == 2
    streams = capsys.readouterr()
    assert streams.out == "" and streams.err.count("error:") == 1


def test_debug_shows_the_traceback_and_nothing_else_does(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["hands", "show", "alegro"]) == 2
    assert "Traceback" not in capsys.readouterr().err
    assert run(["hands", "show", "alegro", "--debug"]) == 2
    assert "Traceback" in capsys.readouterr().err


def test_closed_pipes_are_quiet() -> None:
    command = f"{sys.executable} -m neuralgrasps --help | true; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert done.returncode in (0, 141) and done.stderr == ""
    read, write = os.pipe()
    os.close(read)  # nobody will ever read
    done = subprocess.run(
        [sys.executable, "-m", "neuralgrasps", "hands", "list"],
        stdout=write,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    os.close(write)
    assert done.returncode == 141 and done.stderr == ""


def test_import_and_help_load_nothing_heavy() -> None:
    heavy = "{'numpy', 'torch', 'numba', 'trimesh', 'mujoco', 'matplotlib', 'tyro', 'rich'}"
    done = python("-c", f"import sys, neuralgrasps; print(sorted({heavy} & set(sys.modules)))")
    assert done.stdout.strip() == "[]", done.stderr
    code = (
        f"import sys; from neuralgrasps.cli.main import run; run(['--help']); print(sorted({heavy} & set(sys.modules)))"
    )
    assert python("-c", code).stdout.splitlines()[-1] == "['rich']"


def test_every_public_name_is_there() -> None:
    for name in neuralgrasps.__all__:
        assert getattr(neuralgrasps, name) is not None
    assert set(neuralgrasps.__all__) <= set(dir(neuralgrasps))
    with pytest.raises(AttributeError, match="nonsense"):
        neuralgrasps.nonsense  # noqa: B018
