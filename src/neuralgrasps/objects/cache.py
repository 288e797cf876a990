"""The home folder of downloads and derived data, and an array cache in it keyed by content hash.

The folder is NEURALGRASPS_HOME, or else the platform's cache folder of the user. A cache is never needed: a folder
that cannot be read or written costs time only, and says so.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import platformdirs
from safetensors import SafetensorError, safe_open

from neuralgrasps.errors import StorageError
from neuralgrasps.files import write_whole
from neuralgrasps.tensor_files import tensor_bytes

CACHE_VERSION = "5"  # raise it when what is computed from a mesh changes


def home_folder() -> Path:
    """Where downloads, imports and caches live; it need not exist yet."""
    chosen = os.environ.get("NEURALGRASPS_HOME", "").strip()
    return Path(chosen).expanduser() if chosen else Path(platformdirs.user_cache_dir("neuralgrasps"))


def cache_key(content_hash: str, options: Mapping[str, str | int | float]) -> str:
    """sha256 (hex) of a mesh's content hash, every option that shapes the result, and the cache version."""
    text = json.dumps({"content": content_hash, "options": dict(options), "version": CACHE_VERSION}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def read_cache(key: str) -> tuple[dict[str, np.ndarray], dict[str, str]] | None:
    """The arrays and the notes stored under `key`; None when there are none or the file is damaged."""
    path = _cache_file(key)
    try:
        with safe_open(path, framework="numpy") as file:
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dict
            return arrays, dict(file.metadata() or {})
    except (OSError, SafetensorError, ValueError):
        return None


def write_cache(key: str, arrays: Mapping[str, np.ndarray], notes: Mapping[str, str]) -> str | None:
    """Store arrays and notes under `key`. Returns None, or why nothing could be stored."""
    try:
        write_whole(_cache_file(key), tensor_bytes(arrays, notes))
    except StorageError as error:
        return f"not cached: {error}"
    return None


def _cache_file(key: str) -> Path:
    return home_folder() / "cache" / "objects" / f"{key}.safetensors"
