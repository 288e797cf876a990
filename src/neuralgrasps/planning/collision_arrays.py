"""The arrays that collision kernels work on: the robot with its hand at rest, what is around it, and what it carries."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class RobotArrays(NamedTuple):
    """A manipulator whose hand and other unplanned joints are at rest.

    K bodies (body 0 is fixed to the base), D planned joints, G links with parts, Np parts, S sphere nodes, M points.
    All is in the frame of its body, metres; a frame of a body is that of its first link.

    Attributes:
        parents, joint_types (K,), X_parent_joint (K, 4, 4), axes (K, 3), coupling (K, D), offset (K,): the bodies as a
            tree, arrays as in `KinematicTree`.
        link_body (G,); link_part_start (G + 1,); link_centre (G, 3), link_radius (G,): sphere around each link's parts.
        link_is_hand, link_meets_world (G,) bool: the second is False for what is fixed to the base.
        part_kind (Np,), part_size (Np, 3), part_X (Np, 4, 4): part frame in the body; part_centre (Np, 3),
            part_radius (Np,): sphere around it.
        vertex_start (Np + 1,), vertices (V, 3): corners of hulls, part frame.
        node_start (Np + 1,), node_centre (S, 3), node_radius (S,), node_skip (S,): sphere trees of the parts, as in
            `SphereTree`; parts of links that do not meet the world have none.
        point_start (S + 1,), points (M, 3): surface points of the hand within each leaf.
        pair (Sp, 2) links that may touch each other; pair_margin (Sp,) metres.
    """

    parents: np.ndarray
    joint_types: np.ndarray
    X_parent_joint: np.ndarray
    axes: np.ndarray
    coupling: np.ndarray
    offset: np.ndarray
    link_body: np.ndarray
    link_part_start: np.ndarray
    link_centre: np.ndarray
    link_radius: np.ndarray
    link_is_hand: np.ndarray
    link_meets_world: np.ndarray
    part_kind: np.ndarray
    part_size: np.ndarray
    part_X: np.ndarray
    part_centre: np.ndarray
    part_radius: np.ndarray
    vertex_start: np.ndarray
    vertices: np.ndarray
    node_start: np.ndarray
    node_centre: np.ndarray
    node_radius: np.ndarray
    node_skip: np.ndarray
    point_start: np.ndarray
    points: np.ndarray
    pair: np.ndarray
    pair_margin: np.ndarray


class Grids(NamedTuple):
    """Distance grids of A things, one after the other.

    Attributes:
        values (total,) float32 metres; start (A,), sides (A, 3): where each grid begins and its nodes along x, y, z.
        origin (A, 3), inv_spacing (A,): as in `SdfGrid`.
        low, high (A, 3): box around the thing in its own frame A; outside the grid it gives the distance.
        error (A,): metres by which a value between the nodes may be too large; it is subtracted.
        X_BA (A, 4, 4): the thing's frame in B (for a carried thing: in the body that carries it).
        centre (A, 3), radius (A,): sphere around the thing, same frame as X_BA maps to.
    """

    values: np.ndarray
    start: np.ndarray
    sides: np.ndarray
    origin: np.ndarray
    inv_spacing: np.ndarray
    low: np.ndarray
    high: np.ndarray
    error: np.ndarray
    X_BA: np.ndarray
    centre: np.ndarray
    radius: np.ndarray


class CarriedArrays(NamedTuple):
    """What the hand holds.

    Attributes:
        body: body that carries it; points (C, 3): its surface in that body; centre (3,), radius: sphere around it.
        grid: its distances, at most one, X_BA in that body. meets_link (G,) bool: links that must not touch it.
        box_limit (Nb,), target_limit, other_limit, cloud_limit (A,): least distance, metres, to each obstacle: the
            margin, or less where it starts nearer.
    """

    body: int
    points: np.ndarray
    centre: np.ndarray
    radius: float
    grid: Grids
    meets_link: np.ndarray
    box_limit: np.ndarray
    other_limit: np.ndarray
    cloud_limit: np.ndarray


class CheckArrays(NamedTuple):
    """Everything that one phase of a motion is checked against.

    Attributes:
        robot, carried: see there.
        box_X (Nb, 4, 4), box_half (Nb, 3): boxes in B.
        target, others, cloud: grids of the thing to be grasped (none or one), of other objects, of unknown points.
        margins (2, 4): least distances, metres, of arm and hand to boxes, target, others and cloud; >= 0 for boxes.
        exact_hand: the hand's surface points stand for it against grids, not its spheres.
        max_step_rad, max_step_m: an edge is checked so often that between two checks no joint turns (slides) by more
            than the first (m), and no point of a link moves by more than the second.
    """

    robot: RobotArrays
    box_X: np.ndarray
    box_half: np.ndarray
    target: Grids
    others: Grids
    cloud: Grids
    carried: CarriedArrays
    margins: np.ndarray
    exact_hand: bool
    max_step_rad: float
    max_step_m: float


class Work(NamedTuple):
    """Room that a check writes to; one per thread.

    Attributes:
        X_BK (K, 4, 4) poses of the bodies; link_centre (G, 3) in B; simplex (4, 3); X_a, X_b (4, 4); start (3,);
        q (D,); before (K, 4, 4).
    """

    X_BK: np.ndarray
    link_centre: np.ndarray
    simplex: np.ndarray
    X_a: np.ndarray
    X_b: np.ndarray
    start: np.ndarray
    q: np.ndarray
    before: np.ndarray


def make_work(robot: RobotArrays) -> Work:
    """Room for checks of `robot`."""
    bodies, links, dofs = len(robot.parents), len(robot.link_body), robot.coupling.shape[1]
    return Work(
        X_BK=np.zeros((bodies, 4, 4)),
        link_centre=np.zeros((links, 3)),
        simplex=np.zeros((4, 3)),
        X_a=np.zeros((4, 4)),
        X_b=np.zeros((4, 4)),
        start=np.zeros(3),
        q=np.zeros(dofs),
        before=np.zeros((bodies, 4, 4)),
    )
