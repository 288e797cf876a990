"""Closing and judging candidates on an NVIDIA GPU, by the CPU's own steps; loaded only when a GPU is asked for.

The search for epsilon grows as it needs on the CPU and cannot on a GPU: what does not fit there is done on the CPU.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from neuralgrasps.errors import DeviceError
from neuralgrasps.grasps.contact import most_points
from neuralgrasps.grasps.polar import OVERFLOW, polar_scratch
from neuralgrasps.hands.packed import PackedHand
from neuralgrasps.synthesis.assess import (
    COLLIDES,
    CONE_EDGES,
    FEW_CONTACTS,
    MAX_RESIDUAL,
    NO_FORCE_CLOSURE,
    VALID,
    Cone,
    Pair,
    epsilon_all,
    most_contacts,
)
from neuralgrasps.synthesis.clusters import most_clusters

if TYPE_CHECKING:
    from neuralgrasps.synthesis.gpu_kernels import Approach, Batch

MOST_THREADS = 65_536  # in flight; more candidates take turns
MOST_CANDIDATES = 131_072  # in the GPU's memory at a time
VERTICES = 1024  # of the search for epsilon; grasps with more than about 20 contacts may need more
THREADS_PER_BLOCK = 64
_MEMORY_SHARE = 0.4  # of the free memory for work space, and as much again for candidates


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """N candidates as `Candidates` has them; `score` is epsilon, or the residual when judged by forces."""

    X_OH: np.ndarray
    q: np.ndarray
    score: np.ndarray
    penetration_m: np.ndarray
    outcome: np.ndarray


class Space(NamedTuple):
    """An array that every thread needs for itself."""

    shape: tuple[int, ...]
    dtype: type = np.float64

    @property
    def bytes(self) -> int:
        return math.prod(self.shape) * np.dtype(self.dtype).itemsize


def is_simulated() -> bool:
    """Whether numba runs kernels in its simulator (NUMBA_ENABLE_CUDASIM=1): slow, for tests without a GPU."""
    return os.environ.get("NUMBA_ENABLE_CUDASIM", "0") == "1"


def require_gpu() -> None:
    """Return where kernels can run.

    Raises:
        DeviceError: the package numba-cuda, a driver, a GPU or the CUDA compiler is missing.
    """
    if is_simulated():
        return
    cause = "the package numba-cuda is not installed (pip install 'neuralgrasps[gpu]')"
    if find_spec("numba_cuda") is not None:
        from numba import cuda  # noqa: PLC0415 - only those who ask for a GPU pay for it

        if cuda.is_available():
            return
        cause = "numba finds no CUDA driver with a GPU, or no libnvvm and libnvrtc (CUDA toolkit 12 or 13)"
    raise DeviceError(f"device 'cuda' is not available: {cause}; use device 'cpu'.")


def slim(pair: Pair) -> Pair:
    """`pair` without the arrays of the hand that no kernel reads: a kernel's arguments may fill 4 KiB only."""
    from neuralgrasps.synthesis.gpu_kernels import HandArrays  # noqa: PLC0415

    hand = HandArrays(*(getattr(pair.packed, name) for name in HandArrays._fields))
    return pair._replace(packed=hand)  # type: ignore[arg-type]


class GpuPair:
    """One hand and one object in the GPU's memory.

    Raises:
        DeviceError: see `require_gpu`.
    """

    def __init__(self, pair: Pair) -> None:
        require_gpu()
        self._on_host = pair
        # the simulator takes what the CPU has compiled its steps for already
        self._on_gpu = _load(pair if is_simulated() else slim(pair))
        self._cone = Cone(self._on_gpu.com, pair.length, pair.friction, pair.torsion)

    def judge(self, X_OH: np.ndarray, q: np.ndarray, *, by_forces: bool) -> Judged:
        """Close N hands from `X_OH` (N, 4, 4) and `q` (N, J) and judge them by their best squeeze, or by epsilon."""
        size = min(MOST_CANDIDATES, max(int(_MEMORY_SHARE * _free_bytes() / _batch_bytes(self._on_host.packed)), 1))
        cuts = range(0, max(len(q), 1), size)
        parts = [self._judge(X_OH[k : k + size], q[k : k + size], by_forces) for k in cuts]
        return Judged(**{name: np.concatenate([getattr(p, name) for p in parts]) for name in Judged.__slots__})

    def advance(
        self,
        X_OH: np.ndarray,
        q: np.ndarray,
        approach: np.ndarray,
        *,
        contact_m: float,
        farthest: float,
        touching: bool,
    ) -> np.ndarray:
        """Travel (N,), metres, of N open hands along `approach` (N, 3); the rest as in `advance_hand`."""
        from neuralgrasps.synthesis.gpu_kernels import Approach, Room, advance_kernel  # noqa: PLC0415

        travel = np.empty(len(q))
        run = self._launcher(self._on_gpu, Room, self._hand_spaces(), min(len(q), MOST_CANDIDATES))
        for k in range(0, len(q), MOST_CANDIDATES):
            rows = slice(k, k + MOST_CANDIDATES)
            X, joints, direction = (np.ascontiguousarray(a[rows], np.float64) for a in (X_OH, q, approach))
            hands = _load(Approach(X, joints, direction, travel[rows], contact_m, farthest, touching))
            run(advance_kernel, hands, np.arange(len(hands.q)))
            travel[rows] = _to_host(hands.travel)
        return travel

    def _judge(self, X_OH: np.ndarray, q: np.ndarray, by_forces: bool) -> Judged:
        from neuralgrasps.synthesis import gpu_kernels as kernels  # noqa: PLC0415

        batch = self._batch(X_OH, q)
        run = self._launcher(self._on_gpu, kernels.Room, self._hand_spaces(), len(q))
        outcome, depth = np.full(len(q), COLLIDES, np.int8), np.zeros(len(q))
        score = np.full(len(q), np.inf if by_forces else 0.0)
        run(kernels.close_kernel, batch, np.arange(len(q)))
        todo = np.flatnonzero(_to_host(batch.closed))
        outcome[todo] = FEW_CONTACTS
        run(kernels.contact_kernel, batch, todo)
        contacts = _to_host(batch.contacts)
        todo = todo[contacts[todo] > 0]
        outcome[todo] = NO_FORCE_CLOSURE
        score[todo] = self._residual(batch, todo) if by_forces else self._epsilon(batch, todo)
        todo = todo[score[todo] <= MAX_RESIDUAL] if by_forces else todo[score[todo] > 0.0]
        run(kernels.overlap_kernel, batch, todo)
        outcome[todo], depth[todo] = _to_host(batch.outcome)[todo], _to_host(batch.penetration)[todo]
        if not by_forces:
            score[outcome != VALID] = 0.0
        return Judged(X_OH=_to_host(batch.X_OH), q=_to_host(batch.q), score=score, penetration_m=depth, outcome=outcome)

    def _residual(self, batch: Batch, todo: np.ndarray) -> np.ndarray:
        """(M,) residuals of the candidates `todo`."""
        from neuralgrasps.synthesis.gpu_kernels import ForceRoom, force_kernel  # noqa: PLC0415

        rows = most_contacts(self._on_host.packed) * (CONE_EDGES + 2)
        spaces = (Space((rows, 6)), Space((rows,)), Space((rows,)))
        self._launcher(self._cone, ForceRoom, spaces, len(todo))(force_kernel, batch, todo)
        return _to_host(batch.score)[todo]

    def _epsilon(self, batch: Batch, todo: np.ndarray) -> np.ndarray:
        """(M,) epsilon of the candidates `todo`."""
        from neuralgrasps.synthesis.gpu_kernels import PolarRoom, epsilon_kernel  # noqa: PLC0415

        rows = most_contacts(self._on_host.packed) * (CONE_EDGES + 2)
        spaces = (Space((rows, 6)), *(Space(a.shape, a.dtype.type) for a in polar_scratch(rows, VERTICES)))
        self._launcher(self._cone, PolarRoom, spaces, len(todo))(epsilon_kernel, batch, todo)
        score = _to_host(batch.score)
        again = todo[score[todo] == OVERFLOW]
        if len(again):
            points, normals, contacts = (_to_host(a)[again] for a in (batch.points, batch.normals, batch.contacts))
            score[again] = epsilon_all(self._on_host, points, normals, contacts, np.arange(len(again)))
        return score[todo]

    def _batch(self, X_OH: np.ndarray, q: np.ndarray) -> Batch:
        from neuralgrasps.synthesis.gpu_kernels import Batch  # noqa: PLC0415

        n, most = len(q), most_contacts(self._on_host.packed)
        joints = np.ascontiguousarray(q, np.float64)
        return Batch(
            q_start=_load(joints),
            X_OH=_load(np.ascontiguousarray(X_OH, np.float64)),
            q=_load(joints),
            closed=_load(np.zeros(n, np.bool_)),
            contacts=_load(np.zeros(n, np.int32)),
            points=_empty((n, most, 3)),
            normals=_empty((n, most, 3)),
            links=_empty((n, most), np.int32),
            score=_load(np.zeros(n)),
            penetration=_load(np.zeros(n)),
            outcome=_load(np.zeros(n, np.int8)),
        )

    def _launcher(self, constants: Any, kind: Any, spaces: Sequence[Space], count: int) -> Any:
        """A function that runs a kernel on the hands `todo` of up to `count`, if any.

        Its threads' work space is a named tuple `kind` of these `spaces`.
        """
        fits = int(_MEMORY_SHARE * _free_bytes() / sum(space.bytes for space in spaces))
        threads = max(min(count, MOST_THREADS, fits), 1)
        room = kind(*(_empty((threads, *space.shape), space.dtype, order="F") for space in spaces))

        def run(kernel: Any, hands: Batch | Approach, todo: np.ndarray) -> None:
            if len(todo):
                blocks = -(-min(len(todo), threads) // THREADS_PER_BLOCK)
                kernel[blocks, THREADS_PER_BLOCK](constants, hands, room, _load(todo.astype(np.int32)))

        return run

    def _hand_spaces(self) -> Sequence[Space]:
        """The arrays of `gpu_kernels.Room`."""
        packed = self._on_host.packed
        links, joints, points = packed.link_radius.shape[0], packed.lower.shape[0], most_points(packed)
        at_centre, flags = Space((most_clusters(self._on_host.clusters),)), Space((joints + 1,), np.bool_)
        of_points = Space((points, 3))
        return Space((links, 4, 4)), at_centre, flags, flags, of_points, of_points, Space((points,))


def _batch_bytes(packed: PackedHand) -> int:
    """Size of one candidate's share of `Batch`."""
    return int(8 * (2 * packed.lower.shape[0] + 18) + 52 * most_contacts(packed) + 6)


def _free_bytes() -> int:
    from numba import cuda  # noqa: PLC0415

    return 2**30 if is_simulated() else int(cuda.current_context().get_memory_info().free)


def _empty(shape: tuple[int, ...], dtype: type = np.float64, *, order: str = "C") -> Any:
    """Memory of the GPU. The simulator's is the CPU's, and as the CPU's kernels know it: always in C order."""
    from numba import cuda  # noqa: PLC0415

    return np.zeros(shape, dtype) if is_simulated() else cuda.device_array(shape, dtype, order=order)


def _load(value: Any) -> Any:
    """An array, or all arrays in nested named tuples, copied to the GPU's memory."""
    from numba import cuda  # noqa: PLC0415

    if isinstance(value, np.ndarray):
        return value.copy() if is_simulated() else cuda.to_device(np.ascontiguousarray(value))
    if isinstance(value, tuple):
        return type(value)(*(_load(v) for v in value))
    return value


def _to_host(array: Any) -> np.ndarray:
    return np.array(array) if is_simulated() else np.asarray(array.copy_to_host())
