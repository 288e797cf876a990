"""Cells, JSON, progress and failures, apart from any verb."""

from __future__ import annotations

import errno
import io
import json

import numpy as np
import pytest
from rich.console import Console

from neuralgrasps.cli import progress as progress_module
from neuralgrasps.cli.failures import describe
from neuralgrasps.cli.progress import ProgressBar, clock, numbers_text
from neuralgrasps.cli.terminal import cell_text, counted, open_terminal, write_json
from neuralgrasps.errors import DownloadError, InputError, StorageError
from neuralgrasps.parallel import WorkerDiedError


def test_cells() -> None:
    assert [cell_text(v) for v in (None, float("nan"), True, 3, 0.12345, 12345.6, "a")] == [
        "-", "-", "yes", "3", "0.123", "12346", "a",
    ]  # fmt: skip
    assert counted(1, "hand") == "1 hand" and counted(0, "hand") == "0 hands"


def test_json_is_strict_and_whole(tmp_path) -> None:  # type: ignore[no-untyped-def]
    result = {"a_mm": float("nan"), "b": np.arange(3), "c": np.float32(0.5), "d": (1, "x", None), "e": tmp_path}
    stream = io.StringIO()
    write_json("-", result, stream)
    assert json.loads(stream.getvalue()) == {
        "a_mm": None,
        "b": [0, 1, 2],
        "c": 0.5,
        "d": [1, "x", None],
        "e": str(tmp_path),
    }
    write_json(str(tmp_path / "new" / "r.json"), result, stream)
    assert json.loads((tmp_path / "new" / "r.json").read_text())["c"] == 0.5
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["r.json"]


def test_tables_keep_rows_on_one_line_outside_a_terminal() -> None:
    out = io.StringIO()
    terminal = open_terminal("neuralgrasps", json_to_stdout=False, stdout=out, stderr=io.StringIO())
    terminal.table(("name", "value"), [("a" * 150, 1.5), ("b", 20)])
    lines = [line.rstrip() for line in out.getvalue().splitlines()]
    assert lines[2] == "a" * 150 + "    1.5" and lines[3].endswith(" 20")


def test_words_of_progress() -> None:
    assert clock(7.4) == "0:07" and clock(750) == "12:30" and clock(3723) == "1:02:03"
    assert numbers_text(0, 0, 0, 3.0, "grasps") == "0:03"
    assert numbers_text(12, 60, 0, 4.0, "grasps") == "12/60 grasps, 3.0/s, 0:16 left"
    assert numbers_text(8, 10, 6, 60.0, "pairs") == "8/10 pairs, 2.0/min, 1:00 left"  # six were there before
    assert numbers_text(60, 60, 0, 4.0, "") == "60/60, 0:04"
    assert numbers_text(1, 500, 0, 7.8, "") == "1/500, 0:08"  # one slow start says nothing about the rest
    assert numbers_text(50, 500, 0, 20.0, "", rate=5.0) == "50/500, 5.0/s, 1:30 left"
    assert numbers_text(60, 0, 0, 4.0, "kB") == "60 kB, 15.0/s"


def test_progress_outside_a_terminal_is_a_line_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(progress_module.time, "monotonic", lambda: now[0])
    err = io.StringIO()
    with ProgressBar(Console(file=err, width=200), "working", "grasps") as bar:
        for second in range(1, 13):
            now[0] = float(second)
            bar(second, 12, "allegro")
    assert err.getvalue().splitlines() == [
        "working: 5/12 grasps, 1.0/s, 0:07 left (allegro)",
        "working: 10/12 grasps, 1.0/s, 0:02 left (allegro)",
    ]


def test_stages_leave_a_line_each(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(progress_module.time, "monotonic", lambda: now[0])
    err = io.StringIO()
    with ProgressBar(Console(file=err, width=200), "demo") as bar:
        bar.stage("grasps", 1, 2, "")
        now[0] = 2.0
        bar.stage("grasps", 2, 2, "")
        bar.stage("poses", 0, 9, "")
        now[0] = 3.5
    lines = [line.split() for line in err.getvalue().splitlines()]
    assert lines == [["grasps", "2", "2.0", "s"], ["poses", "9", "1.5", "s"]]


def test_quick_work_on_a_terminal_shows_no_bar() -> None:
    err = io.StringIO()
    with ProgressBar(Console(file=err, force_terminal=True, width=80), "quick") as bar:
        bar(1, 2)
    assert err.getvalue() == ""


def test_long_work_on_a_terminal_shows_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress_module, "SHOW_AFTER_S", 0.0)
    err = io.StringIO()
    with ProgressBar(Console(file=err, force_terminal=True, width=80), "slow", "grasps") as bar:
        bar._timer.join()
        bar(3, 6, "allegro on mustard_bottle")
    assert "slow" in err.getvalue() and "3/6 grasps" in err.getvalue()


@pytest.mark.parametrize(
    ("error", "code", "expected"),
    [
        (InputError("count is 0"), 2, "count is 0"),
        (StorageError("cannot write"), 2, "cannot write"),
        (DownloadError("no network"), 1, "no network"),
        (WorkerDiedError("a worker ended"), 1, "a worker"),
        (MemoryError(), 1, "--workers 1"),
        (OSError(errno.ENOSPC, "No space left on device", "x.bin"), 1, "disk is full"),
        (FileNotFoundError(errno.ENOENT, "No such file", "x.bin"), 2, "'x.bin' does not exist"),
        (PermissionError(errno.EACCES, "Permission denied", "x.bin"), 2, "no permission for 'x.bin'"),
        (IsADirectoryError(errno.EISDIR, "Is a directory", "x"), 2, "Is a directory"),
        (ZeroDivisionError("division by zero"), 1, "--debug"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Exception) else "",
)
def test_failures_in_plain_words(error: Exception, code: int, expected: str) -> None:
    failure = describe(error)
    assert failure.exit_code == code and expected in failure.message


def test_a_full_disk_is_not_the_users_fault() -> None:
    try:
        raise StorageError("cannot write") from OSError(errno.ENOSPC, "No space left")
    except StorageError as error:
        assert describe(error).exit_code == 1
