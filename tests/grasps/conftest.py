"""Random grasps on simple surfaces, shared by the tests of this folder."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from neuralgrasps.geometry.mesh import box_mesh
from neuralgrasps.geometry.sampling import even_surface_points
from neuralgrasps.geometry.sdf_grid import build_sdf_grid
from neuralgrasps.grasps.wrench_space import grasp_wrenches
from neuralgrasps.hands.hand import ConvexPart, Finger, Hand, PartKind
from neuralgrasps.kinematics.tree import FIXED, PRISMATIC, KinematicTree
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.symmetry import trivial_symmetry

BOX_HALF = np.array([0.02, 0.03, 0.04])
PAD_HALF = np.array([0.005, 0.01, 0.012])


def box_contacts(rng: np.random.Generator, count: int, half: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points and outward normals on a box."""
    rows = np.arange(count)
    axis, sign = rng.integers(0, 3, count), rng.choice([-1.0, 1.0], count)
    points, normals = rng.uniform(-1, 1, (count, 3)) * half, np.zeros((count, 3))
    points[rows, axis], normals[rows, axis] = sign * half[axis], sign
    return points, normals


def ball_contacts(rng: np.random.Generator, count: int, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and outward normals on a ball."""
    normals = rng.standard_normal((count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return radius * normals, normals


def can_contacts(
    rng: np.random.Generator, count: int, radius: float, half_height: float
) -> tuple[np.ndarray, np.ndarray]:
    """Points and outward normals on the side of a can."""
    angle = rng.uniform(0, 2 * np.pi, count)
    normals = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    points = radius * normals
    points[:, 2] = rng.uniform(-half_height, half_height, count)
    return points, normals


def finger_patches(rng: np.random.Generator, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One to three coplanar contacts around each point, as real fingertips give; at most 24."""
    out_points, out_normals = [], []
    for p, n in zip(points, normals, strict=True):
        u = np.cross(n, (0.3, 0.5, 0.8))
        u /= np.linalg.norm(u)
        for _ in range(rng.integers(1, 4)):
            a, b = rng.uniform(-0.006, 0.006, 2)
            out_points.append(p + a * u + b * np.cross(n, u))
            out_normals.append(n)
    return np.array(out_points)[:24], np.array(out_normals)[:24]


def wrench_cases(seed: int, count: int) -> list[np.ndarray]:
    """`count` wrench sets: random ones, and grasps of a box, a ball and a can, single contacts and patches."""
    rng = np.random.default_rng(seed)
    half = np.array([0.03, 0.08, 0.105])
    cases = []
    for i in range(count):
        kind = i % 7
        if kind == 0:
            wrenches = rng.standard_normal((rng.integers(10, 200), 6)) * rng.uniform(0.1, 1, 6)
            cases.append(wrenches + 0.1 * rng.standard_normal(6))
            continue
        contacts = int(rng.integers(2, 9) if kind > 3 else rng.integers(3, 13))
        points, normals, length = {
            1: lambda c: (*box_contacts(rng, c, half), float(np.linalg.norm(half))),
            2: lambda c: (*ball_contacts(rng, c, 0.05), 0.05),
            0: lambda c: (*can_contacts(rng, c, 0.033, 0.05), 0.06),
        }[kind % 3](contacts)
        if kind > 3:
            points, normals = finger_patches(rng, points, normals)
        com = np.zeros(3) if rng.random() < 0.3 else rng.normal(0, 0.003, 3)
        friction, torsion = rng.choice([0.3, 0.5, 0.6, 1.0]), rng.choice([0.0, 0.005, 0.01])
        cases.append(grasp_wrenches(points, normals, com, friction, 8, torsion, length))
    return cases


@pytest.fixture(scope="session")
def contacts() -> SimpleNamespace:
    """The functions of this module (test modules cannot import each other)."""
    return SimpleNamespace(
        box=box_contacts, ball=ball_contacts, can=can_contacts, patches=finger_patches, wrench_cases=wrench_cases
    )


@pytest.fixture(scope="session")
def jaw() -> Hand:
    """Two box pads; pad 1 fills x in [q0, q0 + 10 mm], pad 2 x in [-q1 - 10 mm, -q1]; 100 mm above the base box."""
    X = np.tile(np.eye(4), (3, 1, 1))
    X[1:, 2, 3] = 0.1
    tree = KinematicTree(
        link_names=("base", "right", "left"),
        parents=np.array([-1, 0, 0], np.int32),
        joint_names=("", "right_slide", "left_slide"),
        joint_types=np.array([FIXED, PRISMATIC, PRISMATIC], np.int8),
        X_parent_joint=X,
        axes=np.array([[0.0, 0, 0], [1.0, 0, 0], [-1.0, 0, 0]]),
        coupling=np.array([[0.0, 0], [1, 0], [0, 1]]),
        offset=np.zeros(3),
        dof_names=("right", "left"),
        lower=np.full(2, -0.01),
        upper=np.full(2, 0.04),
        effort=np.full(2, 20.0),
    )
    parts = [ConvexPart(link=0, kind=PartKind.BOX, size=np.array([0.06, 0.02, 0.02]), X_LP=np.eye(4))]
    for link, side in ((1, 1.0), (2, -1.0)):
        X_LP = np.eye(4)
        X_LP[0, 3] = side * PAD_HALF[0]
        parts.append(ConvexPart(link=link, kind=PartKind.BOX, size=PAD_HALF, X_LP=X_LP))
    return Hand(
        name="toy_jaw",
        tree=tree,
        parts=tuple(parts),
        fingers=(Finger(name="right", links=(1,), dofs=(0,)), Finger(name="left", links=(2,), dofs=(1,))),
        X_HP=np.eye(4),
        closing_rate=-np.ones(2),
        q_open=np.full(2, 0.04),
        preshape_lower=np.full(2, 0.03),
        preshape_upper=np.full(2, 0.04),
        preshape_groups=((0, 1),),
        is_jaw=True,
        jaw_pad_H=np.array([0.0, 0, 0.1]),
        licence="",
        provenance="test",
    )


@pytest.fixture(scope="session")
def box() -> ObjectModel:
    """A 40 x 60 x 80 mm box centred on its frame."""
    mesh = box_mesh(BOX_HALF)
    points, normals, _ = even_surface_points(mesh, 0.004, 0)
    return ObjectModel(
        name="toy_box",
        mesh=mesh,
        sdf=build_sdf_grid(mesh, cells=80),
        points_O=points,
        normals_O=normals,
        convex_parts=(mesh.vertices,),
        mass_kg=0.1,
        com_O=np.zeros(3),
        friction=0.6,
        symmetry=trivial_symmetry(np.zeros(3), 0.001),
        content_hash="",
        provenance={},
    )


@pytest.fixture(scope="session")
def X_OH() -> np.ndarray:
    """The base of `jaw` such that its pads close on the middle of `box`."""
    X = np.eye(4)
    X[2, 3] = -0.1
    return X
