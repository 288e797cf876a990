"""numba's `njit`, whose files on disk also notice when something they call has changed.

numba keeps compiled code under the hash of the file a function is in. Code of functions it calls in other files is
compiled in, so that an edit there, or an update of the package, would leave the old code in use. Here the hash is over
the file and over all files of this package that it imports, directly or not.

numba reads a file's list of what is compiled before it looks whether that is out of date. A list that names a type
which an update has moved ends in an error there; here it counts as empty.
"""

from __future__ import annotations

import functools
import hashlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core import caching

_PACKAGE = Path(__file__).parent
_IMPORT = re.compile(rf"^\s*from ({_PACKAGE.name}[\w.]*) import ([^\n(]*|\([^)]*\))", re.MULTILINE)


def njit(function: Callable[..., Any] | None = None, /, *, cache: bool = False, **options: Any) -> Any:
    """As numba's; `options` are its own."""

    def compiled(function: Callable[..., Any]) -> Any:
        kernel = numba.njit(function, cache=cache, **options)
        if cache and hasattr(kernel, "_cache"):  # not with NUMBA_DISABLE_JIT
            kernel._cache = _Kept(function)
        return kernel

    return compiled if function is None else compiled(function)


class _Kept(caching.FunctionCache):
    """Compiled code on disk; what names a thing that is no longer there is dropped."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except (AttributeError, ImportError):
            self.flush()
            return None


@functools.cache
def _imported(path: Path) -> frozenset[Path]:
    """Files of this package that a file imports."""
    found = set()
    for module, names in _IMPORT.findall(path.read_text()):
        place = _PACKAGE.joinpath(*module.split(".")[1:])
        candidates = [place.with_suffix(".py"), *(place / f"{name}.py" for name in re.findall(r"\w+", names))]
        found |= {candidate for candidate in candidates if candidate.is_file()}
    return frozenset(found)


@functools.cache
def source_stamp(path: Path) -> str:
    """sha256 (hex) over a file of this package and everything of the package that it imports, directly or not."""
    known, new = {path}, {path}
    while new:
        new = {found for one in new for found in _imported(one)} - known
        known |= new
    content = hashlib.sha256()
    for one in sorted(known):
        content.update(hashlib.sha256(one.read_bytes()).digest())
    return content.hexdigest()


def _is_ours(path: str) -> bool:
    return Path(path).is_relative_to(_PACKAGE) and Path(path).is_file()


def _locator(kind: Any) -> Any:
    """A cache locator for files of this package only, at the place of `kind`, with our stamp."""

    class Locator(kind):  # type: ignore[misc]
        def get_source_stamp(self) -> str:
            return source_stamp(Path(self._py_file))

        @classmethod
        def from_function(cls, py_func: Any, py_file: str) -> Any:
            return super().from_function(py_func, py_file) if _is_ours(py_file) else None

    return Locator


_OURS = [
    _locator(kind)
    for kind in (caching.UserProvidedCacheLocator, caching.InTreeCacheLocator, caching.UserWideCacheLocator)
]
caching.CompileResultCacheImpl._locator_classes = [*_OURS, *caching.CacheImpl._locator_classes]
