"""Child seeds from names, so that a result never depends on order or worker count."""

from __future__ import annotations

import hashlib
import json

import numpy as np


def child_seed(seed: int, *names: str | int) -> int:
    """A 63-bit seed that depends on `seed` and every name, and on nothing else."""
    # JSON keeps ("a", "b") apart from ("a/b",), and 1 from "1"
    text = json.dumps([int(seed), *(name if isinstance(name, str) else int(name) for name in names)])
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little") >> 1


def child_rng(seed: int, *names: str | int) -> np.random.Generator:
    """A generator seeded by `child_seed(seed, *names)`."""
    return np.random.default_rng(child_seed(seed, *names))
