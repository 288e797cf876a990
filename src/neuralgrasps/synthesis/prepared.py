"""What synthesis makes of a hand, or of an object, before it can start; kept for the process's next pairs.

Both are pure functions of the hand's and the mesh's content, so that keeping them changes no result.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.mesh_tree import MeshTree, build_tree
from neuralgrasps.grasps.probe_points import ProbePoints, probe_hand, probe_surface
from neuralgrasps.hands.fingerprint import fingerprint, hand_fingerprint
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import PackedHand, pack_hand
from neuralgrasps.synthesis.close import Closing, make_closing
from neuralgrasps.synthesis.clusters import Clusters, cluster_points

PROBE_SPACING_M = 0.002  # of the points, and along the edges, that look for overlap between those of the hand
_MOST_KEPT = 16  # of hands and of objects; a few MB each
T = TypeVar("T")


class PreparedHand(NamedTuple):
    """A hand packed for the compiled kernels: points in clusters, finer points, and how it closes."""

    packed: PackedHand
    clusters: Clusters
    probe: PackedHand
    closing: Closing


class Memory(Generic[T]):
    """The last few results of a pure function, by content."""

    def __init__(self, most: int = _MOST_KEPT) -> None:
        self._kept: OrderedDict[str, T] = OrderedDict()
        self._most = most

    def clear(self) -> None:
        """Forget all."""
        self._kept.clear()

    def get(self, key: str, make: Callable[[], T]) -> T:
        """What is kept under `key`, else what `make` returns."""
        value = self._kept.pop(key, None)
        if value is None:
            value = make()
        self._kept[key] = value
        while len(self._kept) > self._most:
            self._kept.popitem(last=False)
        return value


_HANDS = Memory[PreparedHand]()
_SURFACES = Memory[ProbePoints]()
_TREES = Memory[MeshTree]()


def prepare_hand(hand: Hand, *, spacing: float) -> PreparedHand:
    """`hand` with surface points `spacing` metres apart."""

    def make() -> PreparedHand:
        packed, clusters = cluster_points(pack_hand(hand, spacing=spacing))
        probe = probe_hand(hand, spacing=PROBE_SPACING_M)
        return PreparedHand(packed=packed, clusters=clusters, probe=probe, closing=make_closing(hand))

    return _HANDS.get(f"{hand_fingerprint(hand)} {spacing}", make)


def prepare_surface(mesh: Mesh) -> ProbePoints:
    """Points that probe an object for overlap."""
    return _SURFACES.get(fingerprint(mesh), lambda: probe_surface(mesh, spacing=PROBE_SPACING_M))


def prepare_tree(mesh: Mesh) -> MeshTree:
    """The tree for exact distances to an object."""
    return _TREES.get(fingerprint(mesh), lambda: build_tree(mesh))
