"""What stands around hands in the detector's training images: table, floor, walls, objects, people, robots.

Everything is triangles in the camera frame without a label. Cameras look at a table from any side, at a wall, or at
nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuralgrasps.geometry.mesh import Mesh, box_mesh, capsule_mesh, cylinder_mesh, merge_meshes, sphere_mesh
from neuralgrasps.geometry.se3_numpy import quaternion_matrix
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.surface import hand_mesh
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.human.scenes.grasp_bank import random_solid, thinned
from neuralgrasps.seeds import child_rng

_ROBOTS = {"fetch": 6, "panda": 6, "barrett": 4, "allegro": 2}
"""How many postures of each robot hand: what looks like a person's is rare."""
_SOLIDS = 200
_BACK_M = 2.5  # walls and floors are at most about so far
_EYE_M = (0.45, 1.2)  # from the camera to the middle of the table, along the view
_HUGE_M = 4.0  # half size of floors and walls


@dataclass(frozen=True, slots=True, kw_only=True)
class Props:
    """Meshes to put into rooms: `solids` that stand on tables, `robots` with an arm along -z of their base."""

    solids: tuple[Mesh, ...]
    robots: tuple[Mesh, ...]


def make_props(seed: int = 0) -> Props:
    """Random solids and robot hands in random postures; the same for the same seed."""
    solids = [_solid(child_rng(seed, "prop", k)) for k in range(_SOLIDS)]
    robots = []
    for name, postures in _ROBOTS.items():
        hand = load_hand(name)
        robots += [_robot(hand, child_rng(seed, "robot", name, k)) for k in range(postures)]
    return Props(solids=tuple(solids), robots=tuple(robots))


def random_room(props: Props, rng: np.random.Generator) -> Mesh:
    """A room without a hand, camera frame; it may be empty."""
    kind = rng.random()
    meshes: list[Mesh] = []
    if kind < 0.75:
        X_CT = _table_pose(rng)
        meshes = [_top(X_CT, rng), *_standing(props, X_CT, rng)]
        if rng.random() < 0.7:
            meshes.append(_plane_mesh(X_CT[:3, 2], X_CT[:3, 3] - rng.uniform(0.4, 0.9) * X_CT[:3, 2]))  # the floor
    if kind > 0.92 or rng.random() < 0.35:
        meshes.append(_wall(rng))
    return merged(meshes + _in_the_air(props, rng))


def things_around(props: Props, X_CT: np.ndarray | None, rng: np.random.Generator) -> Mesh:
    """Things on a table with the frame X_CT (z up), and in the air; camera frame; often none."""
    standing = [] if X_CT is None or rng.random() < 0.4 else _standing(props, X_CT, rng)
    return merged(standing + _in_the_air(props, rng))


def merged(meshes: list[Mesh]) -> Mesh:
    """One mesh of any number."""
    return merge_meshes(meshes) if meshes else Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))


def _in_the_air(props: Props, rng: np.random.Generator) -> list[Mesh]:
    chances = ((0.12, _person), (0.12, _bar), (0.12, _floating), (0.15, _placed_robot))
    return [make(props, rng) for chance, make in chances if rng.random() < chance]


def _solid(rng: np.random.Generator) -> Mesh:
    """A thing of a kitchen table: a hand-held solid, a thin rod or plate, a large box or bowl."""
    kind = rng.random()
    if kind < 0.45:
        mesh = thinned(random_solid(rng))
        return Mesh(mesh.vertices * rng.uniform(0.6, 1.3), mesh.faces)
    if kind < 0.57:
        return box_mesh(rng.uniform([0.05, 0.05, 0.02], [0.2, 0.2, 0.15]))
    if kind < 0.67:
        return _rods(rng)
    if kind < 0.77:
        return cylinder_mesh(rng.uniform(0.05, 0.14), rng.uniform(0.004, 0.05), segments=20)
    return _joined(rng)


def _joined(rng: np.random.Generator) -> Mesh:
    """Bars joined anyhow, as a drill, a clamp, scissors or a lamp: most of what is not a hand but has its outline."""
    meshes: list[Mesh] = []
    start, flat = np.zeros(3), rng.random() < 0.5
    for _ in range(int(rng.integers(2, 6))):
        half, thick = rng.uniform(0.02, 0.09), rng.uniform(0.006, 0.028)
        bar = capsule_mesh(thick, half, segments=8)
        if rng.random() < 0.5:
            bar = box_mesh(np.array([thick, thick * rng.uniform(0.5, 1.5), half]))
        along = rng.normal(size=3) * [1.0, 0.1 if flat else 1.0, 1.0]
        frame = plane_frame(along / np.linalg.norm(along), start + half * along / np.linalg.norm(along))
        meshes.append(_moved(bar, frame))
        start = start + rng.choice([0.0, 1.0, 2.0]) * half * frame[:3, 2]
    return merge_meshes(meshes)


def _rods(rng: np.random.Generator) -> Mesh:
    """A few rods side by side: what looks most like fingers."""
    radius, half = rng.uniform(0.004, 0.014), rng.uniform(0.03, 0.09)
    rod = capsule_mesh(radius, half, segments=8)
    count = int(rng.integers(1, 5))
    gap = rng.uniform(2.0, 5.0) * radius
    return merge_meshes([_shifted(rod, k * gap, 0.0, 0.0) for k in range(count)])


def _robot(hand: Hand, rng: np.random.Generator) -> Mesh:
    """A robot hand in a random posture at the end of a round arm."""
    tree = hand.tree
    q = np.clip(
        hand.q_open + rng.random() * (rng.uniform(tree.lower, tree.upper) - hand.q_open), tree.lower, tree.upper
    )
    half = rng.uniform(0.1, 0.35)
    arm = capsule_mesh(rng.uniform(0.03, 0.06), half, segments=12)
    own = thinned(hand_mesh(hand, q, segments=10), 0.006)
    return merge_meshes([own, _shifted(arm, 0.0, 0.0, -half)])


def _table_pose(rng: np.random.Generator) -> np.ndarray:
    """X_CT of a table's top: z up, origin where the view meets it."""
    pitch, roll = np.radians(rng.uniform(15.0, 90.0)), rng.normal(0.0, 0.15)
    up = np.array([np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch), -np.sin(pitch)])
    return plane_frame(up, np.array([rng.normal(0.0, 0.05), rng.normal(0.0, 0.05), rng.uniform(*_EYE_M)]))


def plane_frame(up: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """(4, 4) a frame at `origin` whose z axis is the unit vector `up`."""
    x = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    X = np.eye(4)
    X[:3, 0] = x / np.linalg.norm(x)
    X[:3, 1], X[:3, 2], X[:3, 3] = np.cross(up, X[:3, 0]), up, origin
    return X


def _top(X_CT: np.ndarray, rng: np.random.Generator) -> Mesh:
    """A rectangle with edges in or out of view."""
    half = np.where(rng.random(4) < 0.35, rng.uniform(0.2, 0.6, 4), 2.0)
    corners = np.array([[-half[0], -half[1], 0], [half[2], -half[1], 0], [half[2], half[3], 0], [-half[0], half[3], 0]])
    turned = corners @ _about_z(rng.uniform(0.0, 2.0 * np.pi)).T
    return _moved(Mesh(turned, np.array([[0, 1, 2], [0, 2, 3]], np.int32)), X_CT)


def _standing(props: Props, X_CT: np.ndarray, rng: np.random.Generator) -> list[Mesh]:
    """What stands and lies on a table."""
    meshes = []
    for _ in range(int(rng.integers(0, 8))):
        solid = props.solids[int(rng.integers(len(props.solids)))]
        turned = solid.vertices @ _turn(rng).T
        place = rng.normal(0.0, 0.2, 2)
        meshes.append(_moved(_shifted(Mesh(turned, solid.faces), place[0], place[1], -float(turned[:, 2].min())), X_CT))
    return meshes


def _turn(rng: np.random.Generator) -> np.ndarray:
    """(3, 3) about the vertical; sometimes lying on a side or anyhow."""
    if rng.random() < 0.2:
        return quaternion_matrix(rng.normal(size=4))
    about_z = _about_z(rng.uniform(0.0, 2.0 * np.pi))
    return about_z[:, rng.permutation(3)] if rng.random() < 0.4 else about_z


def _about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _wall(rng: np.random.Generator) -> Mesh:
    """A plane behind everything, nearly across the view."""
    normal = np.array([rng.normal(0.0, 0.4), rng.normal(0.0, 0.3), -1.0])
    return _plane_mesh(normal / np.linalg.norm(normal), np.array([0.0, 0.0, rng.uniform(0.9, _BACK_M)]))


def _plane_mesh(normal: np.ndarray, through: np.ndarray) -> Mesh:
    X = plane_frame(normal, through)
    x, y = X[:3, 0], X[:3, 1]
    corners = through + _HUGE_M * np.array([-x - y, x - y, x + y, y - x])
    return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def _person(props: Props, rng: np.random.Generator) -> Mesh:
    """A trunk and a head, upright or not."""
    trunk = sphere_mesh(1.0, segments=14)
    trunk = Mesh(trunk.vertices * rng.uniform([0.15, 0.25, 0.08], [0.28, 0.4, 0.15]), trunk.faces)
    head = sphere_mesh(rng.uniform(0.08, 0.11), segments=12)
    both = merge_meshes([trunk, _shifted(head, 0.0, -0.5, 0.0)])
    X = _anywhere(rng, 0.9, 2.0, upright=True)
    return _moved(both, X)


def _bar(props: Props, rng: np.random.Generator) -> Mesh:
    """A pole or a handless arm-like bar across the image."""
    bar = capsule_mesh(rng.uniform(0.01, 0.05), rng.uniform(0.15, 0.6), segments=10)
    return _moved(bar, _anywhere(rng, 0.4, 1.3))


def _floating(props: Props, rng: np.random.Generator) -> Mesh:
    """A thing in mid air."""
    return _moved(props.solids[int(rng.integers(len(props.solids)))], _anywhere(rng, 0.35, 1.2))


def _placed_robot(props: Props, rng: np.random.Generator) -> Mesh:
    return _moved(props.robots[int(rng.integers(len(props.robots)))], _anywhere(rng, 0.4, 1.2))


def _anywhere(rng: np.random.Generator, near: float, far: float, *, upright: bool = False) -> np.ndarray:
    """(4, 4) a place in view."""
    X = np.eye(4)
    z = rng.uniform(near, far)
    X[:3, 3] = rng.uniform(-0.5, 0.5) * z, rng.uniform(-0.4, 0.4) * z, z
    if not upright:
        X[:3, :3] = quaternion_matrix(rng.normal(size=4))
    return X


def _moved(mesh: Mesh, X: np.ndarray) -> Mesh:
    return Mesh(mesh.vertices @ X[:3, :3].T + X[:3, 3], mesh.faces)


def _shifted(mesh: Mesh, x: float, y: float, z: float) -> Mesh:
    return Mesh(mesh.vertices + np.array([x, y, z]), mesh.faces)
