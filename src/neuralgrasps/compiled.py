"""numba's `njit`, but what only compiled code calls gets no entry from Python, and files on disk notice more changes.

The entry from Python takes every argument apart; with tuples of dozens of arrays that is often more code than the
function. Here it is made when Python calls the function: a third of the time that compiling took before.

numba keeps compiled code under the hash of the file a function is in. Code of functions it calls in other files is
compiled in, so that an edit there, or an update of the package, would leave the old code in use. Here the hash is over
the file and over all files of this package that it imports, directly or not.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core import caching, sigutils
from numba.core.registry import CPUDispatcher

_NO_ENTRY = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def njit(function: Callable[..., Any] | None = None, /, *, cache: bool = False, **options: Any) -> Any:
    """As numba's; `options` are its own."""

    def compiled(function: Callable[..., Any]) -> Any:
        plain = numba.njit(function, **options)
        if not isinstance(plain, CPUDispatcher):  # NUMBA_DISABLE_JIT
            return plain
        kernel = _Kernel(function, targetoptions=plain.targetoptions)
        if cache:
            kernel.enable_caching()
        return kernel

    return compiled if function is None else compiled(function)


class _Kernel(CPUDispatcher):
    """A function as Python sees it; `inner` is the same function without an entry, for compiled code that calls it."""

    def __init__(self, py_func: Any, locals: Any = None, targetoptions: Any = None, **options: Any) -> None:
        super().__init__(py_func, locals or {}, targetoptions or {}, **options)
        self.inner: Any = CPUDispatcher(py_func, locals or {}, {**(targetoptions or {}), **_NO_ENTRY}, **options)

    def enable_caching(self) -> None:
        super().enable_caching()
        self.inner._cache = _InnerCache(self.py_func)

    @property
    def is_compiling(self) -> Any:
        return super().is_compiling or self.inner.is_compiling

    def get_call_template(self, args: Any, kws: Any) -> Any:
        known = tuple(self.fold_argument_types(args, kws)[1]) in self.overloads
        return super().get_call_template(args, kws) if known else self.inner.get_call_template(args, kws)

    def get_overload(self, sig: Any) -> Any:
        known = tuple(sigutils.normalize_signature(sig)[0]) in self.inner.overloads
        return self.inner.get_overload(sig) if known else super().get_overload(sig)


class _InnerCache(caching.FunctionCache):
    """Functions without an entry from Python on disk, in the same index; one with an entry serves as well."""

    def __init__(self, py_func: Any) -> None:
        super().__init__(py_func)
        self._with_entry = caching.FunctionCache(py_func)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = super().load_overload(sig, target_context)
        return self._with_entry.load_overload(sig, target_context) if found is None else found

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        return (*super()._index_key(sig, codegen), "inner")


_PACKAGE = Path(__file__).parent
_IMPORT = re.compile(rf"^\s*from ({_PACKAGE.name}[\w.]*) import ([^\n(]*|\([^)]*\))", re.MULTILINE)


@cache
def _imported(path: Path) -> frozenset[Path]:
    """Files of this package that a file imports."""
    found = set()
    for module, names in _IMPORT.findall(path.read_text()):
        place = _PACKAGE.joinpath(*module.split(".")[1:])
        candidates = [place.with_suffix(".py"), *(place / f"{name}.py" for name in re.findall(r"\w+", names))]
        found |= {candidate for candidate in candidates if candidate.is_file()}
    return frozenset(found)


@cache
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
