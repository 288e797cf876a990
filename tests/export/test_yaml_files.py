"""YAML: the same text for the same data, and nothing surprising on the way back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from neuralgrasps.errors import DataFormatError, InputError
from neuralgrasps.export import yaml_files
from neuralgrasps.export.yaml_files import read_yaml, write_yaml, yaml_text

PLAIN = st.recursive(
    st.floats(allow_nan=False, allow_infinity=False) | st.integers() | st.text(max_size=8) | st.booleans(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)


@settings(max_examples=100, deadline=None)
@given(PLAIN)
def test_plain_yaml_readers_get_back_what_was_written(data: Any) -> None:
    assert yaml.safe_load(yaml_text(data, comment="a: [b")) == data


def test_numbers_and_words_that_yaml_may_misread(tmp_path: Path) -> None:
    data = {"y": 1e-5, "on": "no", "1": "1e3", "e": 1e300, "t": "2001-01-01", "f": -0.1 / 3, "empty": [], "s": ""}
    back = read_yaml(write_yaml(tmp_path / "new" / "a.yaml", data))
    assert back == data and list(back) == list(data)
    assert all(type(back[k]) is type(data[k]) for k in data)


def test_text_is_the_same_with_and_without_the_c_library() -> None:
    data = {"a": [{"x": 1.5, "y": -0.0}, {"names": ["one", "zwölf ", "x: y", "'"]}], "b": {"c": [[1e-7, 3.0], []]}}

    class Slow(yaml.SafeDumper):
        ignore_aliases = yaml_files._Dumper.ignore_aliases

    slow = yaml.dump(data, Dumper=Slow, sort_keys=False, default_flow_style=None, allow_unicode=True, width=1000)
    assert yaml_text(data) == slow


def test_a_list_used_twice_is_written_twice() -> None:
    twice = [1.0, 2.0]
    assert yaml_text({"a": twice, "b": twice}, comment="two\nlines") == (
        "# two\n# lines\na: [1.0, 2.0]\nb: [1.0, 2.0]\n"
    )


@pytest.mark.parametrize(
    ("text", "said"),
    (
        ("a: 1\na: 2\n", "'a' stands twice.*line 2"),
        ("a: &x [1, 2]\nb: *x\n", "references"),
        ("a: &x {b: *x}\n", "references"),
        ("a: [1, 2\n", "line"),
        ("!!python/object/apply:os.system ['true']\n", "could not determine a constructor"),
        ("a: 2001-99-99\n", "month"),
        ("{[1, 2]: 3}\n", "line"),
        ("[" * 100_000, "nested more than"),
    ),
)
def test_files_that_are_not_plain_yaml_are_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    with pytest.raises(DataFormatError, match=said):
        read_yaml(path)


def test_files_that_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="No such file"):
        read_yaml(tmp_path / "none.yaml")
    with pytest.raises(InputError, match="directory"):
        read_yaml(tmp_path)
    (tmp_path / "b.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DataFormatError, match="UTF-8"):
        read_yaml(tmp_path / "b.yaml")
    monkeypatch.setattr(yaml_files, "_MAX_MB", 1e-6)
    with pytest.raises(InputError, match="at most"):
        read_yaml(tmp_path / "b.yaml")
