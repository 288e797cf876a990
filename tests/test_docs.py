"""The documents: the tour runs, and what they show of Python and of the command line exists."""

from __future__ import annotations

import ast
import inspect
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

import neuralgrasps as ng
from neuralgrasps.cli.main import run
from neuralgrasps.cli.verbs import VERBS, find_verb

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def blocks(text: str, language: str) -> list[str]:
    return [body for said, body in re.findall(r"^```(\w*)\n(.*?)^```", text, re.S | re.M) if said == language]


def command_lines(text: str) -> Iterator[list[str]]:
    """Words after `neuralgrasps` in code blocks and in code within a line, comments left out."""
    quoted = blocks(text, "") + re.findall(r"(?<!`)`([^`\n]+)`(?!`)", text)
    for line in "\n".join(quoted).replace(".venv/bin/", "").splitlines():
        if line.startswith("neuralgrasps ") and "VERB" not in line:
            yield shlex.split(line, comments=True)[1:]


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_what_python_snippets_call_exists(document: Path) -> None:
    for block in blocks(document.read_text(), "python"):
        for node in ast.walk(ast.parse(block)):
            name = _name_of_ours(node.func) if isinstance(node, ast.Call) else _name_of_ours(node)
            assert name is None or hasattr(ng, name), f"{document.name} shows ng.{name}"
            if name is not None and isinstance(node, ast.Call):
                taken = inspect.signature(getattr(ng, name)).parameters
                shown = {k.arg for k in node.keywords if k.arg is not None}
                assert shown <= set(taken), f"{document.name}: {ast.unparse(node)}"


def _name_of_ours(node: ast.AST) -> str | None:
    ours = isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "ng"
    return node.attr if ours and isinstance(node, ast.Attribute) else None


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_the_command_lines_shown_exist(document: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words in command_lines(document.read_text()):
        verb, said = find_verb(words)
        assert verb is not None, f"{document.name} shows 'neuralgrasps {shlex.join(words)}'"
        if verb.words == ("bench",):
            continue
        assert run([*said, "--help"]) == 0
        taken = set(re.findall(r"--[a-z][a-z0-9-]*", capsys.readouterr().out))
        options = {word.split("=")[0] for word in words if word.startswith("--")}
        assert options <= taken, f"{document.name} shows 'neuralgrasps {shlex.join(words)}'"


def test_every_verb_is_in_the_readme() -> None:
    table = (ROOT / "README.md").read_text()
    for verb in VERBS:
        shown = re.findall(rf"^\| `{verb.words[0]}\b([^`]*)`|, `{verb.words[0]}\b()", table, re.M)
        assert shown, f"'{' '.join(verb.words)}' is not in the README's table"
        assert all(word in " ".join(map(str, shown)) for word in verb.words[1:])


def test_the_tour_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    seen: dict[str, object] = {}
    for block in blocks((ROOT / "docs" / "tour.md").read_text(), "python"):
        exec(compile(block, "docs/tour.md", "exec"), seen)
    assert seen["demo"].stage == "" and len(seen["result"].grasps) > 0  # type: ignore[attr-defined]
    assert seen["proposal"].plan is not None  # type: ignore[attr-defined]
    assert (tmp_path / "allegro_mustard.safetensors").is_file()


def test_links_between_documents_lead_somewhere() -> None:
    for document in DOCUMENTS:
        for target in re.findall(r"\]\(([^)#:]+)\)", document.read_text()):
            assert (document.parent / target).exists(), f"{document.name} links to {target}"
