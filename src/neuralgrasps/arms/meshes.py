"""Triangle meshes of a robot's links, for pictures and simulated cameras."""

from __future__ import annotations

import numpy as np

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.geometry.mesh import Mesh, merge_meshes
from neuralgrasps.hands.parts import part_mesh
from neuralgrasps.kinematics.forward_kernels import forward_fast


def link_meshes(manipulator: Manipulator, *, segments: int = 24) -> tuple[tuple[int, Mesh], ...]:
    """Links that have a shape: their index and mesh in the link frame; `segments` around for round parts."""
    found = []
    for link in range(manipulator.tree.num_links):
        own = [part_mesh(p, segments=segments) for p in manipulator.parts if p.link == link]
        if own:
            found.append((link, merge_meshes(own)))
    return tuple(found)


def posed_meshes(manipulator: Manipulator, q: np.ndarray, *, segments: int = 24) -> tuple[tuple[Mesh, ...], np.ndarray]:
    """Meshes of K links and their poses X_BL (K, 4, 4) for all joints q (Q,)."""
    links = link_meshes(manipulator, segments=segments)
    X_BL = forward_fast(manipulator.tree, q)
    return tuple(mesh for _, mesh in links), X_BL[[link for link, _ in links]]
