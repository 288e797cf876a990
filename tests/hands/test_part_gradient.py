import numpy as np
import pytest

from neuralgrasps.geometry.primitives import convex_hull
from neuralgrasps.hands.hand import ConvexPart, PartKind
from neuralgrasps.hands.part_gradient import part_distance_gradient
from neuralgrasps.hands.parts import hull_planes, part_distance


def part_of(kind: PartKind) -> ConvexPart:
    size = np.array([0.02, 0.03, 0.05])
    if kind != PartKind.HULL:
        return ConvexPart(link=0, kind=kind, size=size, X_LP=np.eye(4))
    vertices, faces = convex_hull(np.random.default_rng(0).normal(scale=0.03, size=(20, 3)))
    return ConvexPart(link=0, kind=kind, size=np.zeros(3), X_LP=np.eye(4), vertices=vertices, faces=faces)


@pytest.mark.parametrize("kind", list(PartKind))
def test_gradients_are_those_of_the_distance(kind: PartKind) -> None:
    part = part_of(kind)
    planes, triangles = hull_planes(part)
    step = 1e-7

    def distance(p: np.ndarray) -> float:
        return part_distance(int(kind), part.size, planes, triangles, *p)

    checked = 0
    for p in np.random.default_rng(1).normal(scale=0.05, size=(300, 3)):
        got = np.array(part_distance_gradient(int(kind), part.size, planes, triangles, *p))
        ahead = [(distance(p + step * e) - distance(p)) / step for e in np.eye(3)]
        behind = [(distance(p) - distance(p - step * e)) / step for e in np.eye(3)]
        if np.abs(np.subtract(ahead, behind)).max() < 1e-4:  # not on a crease
            np.testing.assert_allclose(got, ahead, atol=2e-4)
            checked += 1
        assert np.linalg.norm(got) == pytest.approx(1.0)
    assert checked > 250
