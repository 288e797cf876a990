"""YAML text that is always the same for the same data, and reading it without surprises."""

from __future__ import annotations

import os
from collections.abc import Hashable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from neuralgrasps.errors import DataFormatError, InputError
from neuralgrasps.files import write_whole

if TYPE_CHECKING:
    from yaml import SafeDumper, SafeLoader
else:  # the C versions of the same, where the library was built with them
    SafeDumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    SafeLoader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

_MAX_MB = 256
_DEEPEST = 40


class _Dumper(SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        """Write lists that are used twice twice: references (&, *) are not read by everybody."""
        return True


class _Loader(SafeLoader):
    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Hashable, Any]:
        """A mapping that must not say anything twice (plain YAML readers silently take the last)."""
        seen: set[Any] = set()
        for key, _ in node.value:
            name = (key.tag, str(key.value))
            if name in seen:
                raise yaml.constructor.ConstructorError(None, None, f"'{key.value}' stands twice", key.start_mark)
            seen.add(name)
        return super().construct_mapping(node, deep=deep)


def yaml_text(data: Any, *, comment: str = "") -> str:
    """`data` (dicts, lists, text, numbers) as YAML, in the given order; lists of numbers on one line.

    Args:
        comment: lines that stand above it.
    """
    body = yaml.dump(data, Dumper=_Dumper, sort_keys=False, default_flow_style=None, allow_unicode=True, width=1000)
    return "".join(f"# {line}".rstrip() + "\n" for line in comment.splitlines()) + body


def write_yaml(path: str | os.PathLike[str], data: Any, *, comment: str = "") -> Path:
    """Write `data` to `path`, whole or not at all; returns the path.

    Raises:
        StorageError: missing or read-only folder, full disk, no permission.
    """
    return write_whole(path, yaml_text(data, comment=comment))


def read_yaml(path: str | os.PathLike[str]) -> Any:
    """What a YAML file says, as dicts, lists, text and numbers; nothing in it is executed.

    Raises:
        InputError: the file is missing, too large or cannot be read.
        DataFormatError: not YAML, a key that stands twice, references (&, *), or nested too deeply.
    """
    path = Path(path)
    try:
        size = path.stat().st_size
        if size > _MAX_MB * 1e6:
            raise InputError(f"'{path}' has {size / 1e6:.0f} MB; expected a YAML file of at most {_MAX_MB} MB.")
        text = path.read_bytes().decode()
    except UnicodeDecodeError as error:
        raise DataFormatError(f"'{path}' is not a YAML file: it is no text in UTF-8.") from error
    except OSError as error:
        raise InputError(f"cannot read '{path}': {error.strerror or error}; check the path.") from error
    try:
        _check_structure(text, path)
        return yaml.load(text, Loader=_Loader)  # _Loader is a safe one
    except (yaml.YAMLError, ValueError, TypeError) as error:
        if isinstance(error, DataFormatError):
            raise
        raise DataFormatError(f"'{path}' is not a YAML file that can be read: {_one_line(error)}.") from error


def _check_structure(text: str, path: Path) -> None:
    """Refuse parts that stand in several places, by which a small file can become a huge one, and deep nesting, on
    which the C library runs out of stack."""
    depth = 0
    for event in yaml.parse(text, Loader=SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            raise DataFormatError(f"'{path}' uses references (& and *); expected plain YAML: write the parts out.")
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST:
            raise DataFormatError(f"'{path}' is nested more than {_DEEPEST} deep; expected grasps or motions.")


def _one_line(error: Exception) -> str:
    mark = getattr(error, "problem_mark", None)
    problem = getattr(error, "problem", None) or str(error).splitlines()[0]
    return f"{problem} (line {mark.line + 1})" if mark else str(problem)
