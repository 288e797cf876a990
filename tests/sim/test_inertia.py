from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.hands.hand import ConvexPart, PartKind
from neuralgrasps.sim.inertia import part_bounds, part_volume, solid_inertia

from .toy import HALF, toy_box


def _box_tensor(half: np.ndarray) -> np.ndarray:
    squares = half**2 / 3
    return np.diag(squares.sum() - squares)


def test_inertia_of_a_box_about_its_centre() -> None:
    box = toy_box(centre=(0.1, -0.2, 0.3))
    got = solid_inertia(box.mesh.vertices, box.mesh.faces, box.com_O)
    np.testing.assert_allclose(got, _box_tensor(HALF), rtol=1e-9, atol=1e-15)


def test_inertia_obeys_the_parallel_axis_theorem() -> None:
    box = toy_box()
    shift = np.array([0.3, -0.1, 0.2])
    got = solid_inertia(box.mesh.vertices, box.mesh.faces, -shift)
    np.testing.assert_allclose(
        got, _box_tensor(HALF) + shift @ shift * np.eye(3) - np.outer(shift, shift), rtol=1e-9, atol=1e-15
    )


@pytest.mark.parametrize("faces", ["inside out", "one face only"])
def test_a_mesh_that_is_no_solid_counts_as_its_bounding_box(faces: str) -> None:
    box = toy_box()
    broken = box.mesh.faces[:, ::-1] if faces == "inside out" else box.mesh.faces[:1]
    got = solid_inertia(box.mesh.vertices, broken, box.com_O)
    np.testing.assert_allclose(got, _box_tensor(HALF), rtol=1e-9, atol=1e-15)


def _part(kind: PartKind, size: tuple[float, float, float], X: np.ndarray | None = None) -> ConvexPart:
    return ConvexPart(link=0, kind=kind, size=np.array(size), X_LP=np.eye(4) if X is None else X)


def test_volumes() -> None:
    assert part_volume(_part(PartKind.BOX, (1, 2, 3))) == pytest.approx(48)
    assert part_volume(_part(PartKind.SPHERE, (2, 0, 0))) == pytest.approx(4 / 3 * np.pi * 8)
    assert part_volume(_part(PartKind.CYLINDER, (2, 3, 0))) == pytest.approx(np.pi * 4 * 6)
    assert part_volume(_part(PartKind.CAPSULE, (2, 3, 0))) == pytest.approx(np.pi * 4 * 6 + 4 / 3 * np.pi * 8)
    box = toy_box()
    hull = ConvexPart(
        link=0,
        kind=PartKind.HULL,
        size=np.zeros(3),
        X_LP=np.eye(4),
        vertices=box.mesh.vertices,
        faces=box.mesh.faces,
    )
    assert part_volume(hull) == pytest.approx(8 * HALF.prod())


def test_bounds_follow_the_part_pose() -> None:
    turned = np.array([[0.0, -1, 0, 0.5], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    low, high = part_bounds([_part(PartKind.BOX, (1, 2, 3), turned), _part(PartKind.CAPSULE, (0.5, 4, 0))])
    np.testing.assert_allclose(low, [-1.5, -1, -4.5])
    np.testing.assert_allclose(high, [2.5, 1, 4.5])
