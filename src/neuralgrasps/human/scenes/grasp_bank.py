"""Many closed hands around many solids, for training images: made without physics, one size of hand.

Everything is relative to the hand at scale 1; a scene scales hand and solid together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load

from neuralgrasps.errors import InputError
from neuralgrasps.files import write_whole
from neuralgrasps.geometry.mesh import Mesh, box_mesh, capsule_mesh, cylinder_mesh, sphere_mesh
from neuralgrasps.human.skeleton import LARGEST, SMALLEST, human_hand
from neuralgrasps.objects.build import object_from_mesh
from neuralgrasps.objects.builtin import STAND_INS
from neuralgrasps.objects.loft import loft, rounded_box, superellipse
from neuralgrasps.seeds import child_rng
from neuralgrasps.synthesis.candidates import NO_FORCE_CLOSURE, VALID, close_and_assess, make_problem
from neuralgrasps.synthesis.propose import propose_dexterous
from neuralgrasps.tensor_files import tensor_bytes

_CELL_M = 0.007  # of the grid that thins meshes
_FRICTION, _TORSION_M = 0.6, 0.005
_CONTACT_M, _OVERLAP_M = 2.5e-3, 3e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class GraspBank:
    """G closed hands (the right one, scale 1) around S solids with few triangles.

    Attributes:
        points_O: (V, 3) float64 corners of all solids, each in its own frame; faces: (F, 3) int32 into the solid's own
            corners. point_start, face_start: (S + 1,) int64 where each solid's begin.
        solid: (G,) int32 the solid held; X_OH: (G, 4, 4); q: (G, 20).
    """

    points_O: np.ndarray
    faces: np.ndarray
    point_start: np.ndarray
    face_start: np.ndarray
    solid: np.ndarray
    X_OH: np.ndarray
    q: np.ndarray

    @property
    def num_solids(self) -> int:
        return len(self.point_start) - 1

    def __len__(self) -> int:
        return len(self.solid)


def make_grasp_bank(solids: list[Mesh], *, proposals: int = 512, seed: int = 0) -> GraspBank:
    """Close the human hand on every solid from many sides.

    Args:
        solids: their surfaces, metres, as large as they are to a hand of scale 1.
        proposals: start poses per solid; about a half end in a grasp.
    """
    hand = human_hand()
    held, X_OH, q = [], [], []
    for index, mesh in enumerate(solids):
        obj = object_from_mesh(f"solid_{index}", mesh)
        problem = make_problem(
            hand, obj, friction=_FRICTION, torsion=_TORSION_M, contact_threshold_m=_CONTACT_M,
            max_penetration_m=_OVERLAP_M,
        )  # fmt: skip
        rng = child_rng(seed, "bank", index)
        start = propose_dexterous(problem, count=proposals, friction=_FRICTION, rng=rng, threads=1)
        closed = close_and_assess(problem, start.X_OH, start.q)
        good = (closed.outcome == VALID) | (closed.outcome == NO_FORCE_CLOSURE)
        held.append(np.full(int(good.sum()), index, np.int32))
        X_OH.append(closed.X_OH[good])
        q.append(closed.q[good])
    points_O, faces, point_start, face_start = pack_meshes([thinned(mesh) for mesh in solids])
    return GraspBank(
        points_O=points_O, faces=faces, point_start=point_start, face_start=face_start,
        solid=np.concatenate(held), X_OH=np.concatenate(X_OH), q=np.concatenate(q),
    )  # fmt: skip


def joined_banks(banks: Sequence[GraspBank]) -> GraspBank:
    """All solids and grasps of some banks in one; at least one bank."""
    points, faces = (np.cumsum([0, *(len(getattr(bank, name)) for bank in banks)]) for name in ("points_O", "faces"))
    solids = np.cumsum([0, *(bank.num_solids for bank in banks)])
    return GraspBank(
        points_O=np.concatenate([bank.points_O for bank in banks]),
        faces=np.concatenate([bank.faces for bank in banks]),
        point_start=np.concatenate([[0], *(b.point_start[1:] + at for b, at in zip(banks, points, strict=False))]),
        face_start=np.concatenate([[0], *(b.face_start[1:] + at for b, at in zip(banks, faces, strict=False))]),
        solid=np.concatenate([b.solid + np.int32(at) for b, at in zip(banks, solids, strict=False)]),
        X_OH=np.concatenate([bank.X_OH for bank in banks]),
        q=np.concatenate([bank.q for bank in banks]),
    )


def training_solids(count: int = 96, *, seed: int = 0) -> list[Mesh]:
    """The stand-ins as large as they are to hands of four sizes, and `count` random solids."""
    solids = []
    for scale in np.linspace(SMALLEST + 0.03, LARGEST - 0.03, 4):
        for stand_in in STAND_INS.values():
            mesh = stand_in.build(stand_in.size_m)
            solids.append(Mesh(mesh.vertices / scale, mesh.faces))
    return solids + [random_solid(child_rng(seed, "solid", index)) for index in range(count)]


def random_solid(rng: np.random.Generator) -> Mesh:
    """A box, cylinder, ball, rod, bottle or bowl-like solid of a size that a hand of scale 1 holds."""
    kind = rng.integers(7)
    if kind == 0:
        half = rng.uniform([0.012, 0.02, 0.03], [0.05, 0.08, 0.14])
        return box_mesh(half[rng.permutation(3)])
    if kind == 1:
        return cylinder_mesh(rng.uniform(0.015, 0.055), rng.uniform(0.015, 0.15), segments=24)
    if kind == 2:
        ball = sphere_mesh(1.0, segments=20)
        return Mesh(ball.vertices * (rng.uniform(0.025, 0.06) * rng.uniform(0.75, 1.25, 3)), ball.faces)
    if kind == 3:
        return capsule_mesh(rng.uniform(0.01, 0.025), rng.uniform(0.03, 0.14), segments=16)
    if kind == 4:
        half = rng.uniform([0.015, 0.025, 0.04], [0.045, 0.06, 0.12])
        return rounded_box(half[rng.permutation(3)].tolist(), rng.uniform(0.3, 0.95) * float(half.min()), arc_steps=3)
    return _turned(rng, bottle=kind == 5)


def _turned(rng: np.random.Generator, *, bottle: bool) -> Mesh:
    """A stack of ellipses whose width wanders with height; a bottle has a neck."""
    heights = np.linspace(-0.5, 0.5, 7) * rng.uniform(0.1, 0.3)
    width = np.clip(1.0 + np.cumsum(rng.normal(0.0, 0.12, 7)), 0.5, 1.5)
    if bottle:
        width[5:] = rng.uniform(0.3, 0.5)
    radius = rng.uniform(0.022, 0.05)
    flat, exponent = rng.uniform(0.6, 1.0), rng.uniform(2.0, 4.0)
    return loft([superellipse(radius * w, radius * flat * w, exponent, 20) for w in width], list(heights))


def thinned(mesh: Mesh, cell_m: float = _CELL_M) -> Mesh:
    """The mesh with all corners of one cell of a grid joined in their mean; a few hundred triangles of a hand-held."""
    cells = np.floor(mesh.vertices / cell_m).astype(np.int64)
    _, group = np.unique(cells, axis=0, return_inverse=True)
    group = group.reshape(-1)
    sums = np.zeros((group.max() + 1, 3))
    np.add.at(sums, group, mesh.vertices)
    faces = group[mesh.faces]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return Mesh(sums / np.bincount(group)[:, None], faces[whole])


def pack_meshes(meshes: list[Mesh]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Corners (V, 3), faces (F, 3) int32 into each mesh's own corners, where each mesh's corners and faces begin."""
    point_start = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    face_start = np.cumsum([0, *(len(m.faces) for m in meshes)])
    points = np.concatenate([m.vertices for m in meshes])
    return points, np.concatenate([m.faces for m in meshes]).astype(np.int32), point_start, face_start


def save_bank(bank: GraspBank, file: Path) -> None:
    """Write a bank for `load_bank`."""
    write_whole(file, tensor_bytes({name: getattr(bank, name) for name in GraspBank.__slots__}))


def load_bank(file: Path) -> GraspBank:
    """Read what `save_bank` wrote.

    Raises:
        InputError: the file is missing or is none of these.
    """
    try:
        return GraspBank(**load(Path(file).read_bytes()))
    except (OSError, TypeError, ValueError, SafetensorError) as error:
        raise InputError(f"grasp bank '{file}' cannot be read: {error}. Make it with `make_grasp_bank`.") from error
