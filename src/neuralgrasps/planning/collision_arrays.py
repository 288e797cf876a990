"""The arrays that collision kernels work on: few wide tables, because each array that is passed on costs time."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from neuralgrasps.compiled import njit

_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "_nrt": False}
# For kernels that neither make nor return arrays: without numba's counting of references a check takes half the time.
plain_kernel: Any = njit(**_OPTIONS)

# columns of `CheckArrays.parts`
SIZE, POSE = 4, 7
# columns of `CheckArrays.link_info`
BODY, FIRST_PART, END_PART, IS_HAND, MEETS_WORLD, MEETS_CARRIED = range(6)
# columns of `CheckArrays.part_info`
KIND, FIRST_VERTEX, END_VERTEX, FIRST_NODE, END_NODE = range(5)
# columns of `CheckArrays.grids`
ORIGIN, INV_SPACING, LOW, HIGH, ERROR, FRAME, MIDDLE, RADIUS = 0, 3, 4, 7, 10, 11, 23, 26
GRID_COLUMNS = 27
# kinds of obstacles: columns of `CheckArrays.margins`
BOXES, TARGET, OTHERS, CLOUD = range(4)


class CheckArrays(NamedTuple):
    """One phase of a motion: the robot with its hand at rest, what is around it, and what it carries.

    K bodies (body 0 is fixed to the base), D planned joints, G links with parts, Np parts, Nb boxes, S sphere nodes, A
    things with a distance grid. The robot's geometry is in the frame of its body (that of the body's first link),
    metres. Poses in tables are the upper three rows of X, row by row: 12 numbers.

    Attributes:
        parents, joint_types (K,), X_parent_joint (K, 4, 4), axes (K, 3), coupling (K, D), offset (K,): the bodies as a
            tree, arrays as in `KinematicTree`.
        links: (G, 4) centre and radius of a sphere around each link's parts.
        link_info: (G, 6) body, first part, end of the parts, is it the hand's, does it meet the world (not what is
            fixed to the base), and what the hand carries.
        parts: (Np + Nb, 19) centre and radius of a sphere around the part, its size, its pose; boxes after the robot's
            parts, in B.
        part_info: (Np + Nb, 5) kind, first vertex and their end, first sphere node and their end.
        vertices: (V, 3) corners of hulls, part frame.
        nodes: (S + 1, 4) centre and radius, trees as in `SphereTree`; node_info: (S + 1, 2) skip and first point.
        points: (M, 3) surface points of the hand within each leaf.
        pairs: (Sp, 2) links that may touch each other; pair_margins: (Sp,) metres.
        grids: (A + 1, 27) the target (none or one), then other objects, then the cloud (none or one); origin and
            1 / spacing as in `SdfGrid`; box around the thing in its frame (low, high), the error of a value, X of its
            frame in B; centre in B and radius of a sphere around it. The last row is what is carried, in its body.
        grid_info: (A + 1, 4) first value, nodes along x, y, z.
        kinds: (5,) first row of `grids` by kind of obstacle, [0, 0, target end, others end, A].
        target_values, other_values, cloud_values: float32 metres; those of what is carried are with the others'.
        margins: (2, 4) least distances, metres, of arm and hand to boxes, target, others and cloud; >= 0 for boxes.
        carried_points: (C, 3) surface of what is carried in `carried_body`; none where C = 0.
        carried_limits: (Nb + A,) its least distance to each box and thing: the margin, or less where it starts nearer.
        exact_hand: the hand's surface points stand for it against grids, not its spheres.
        max_step_rad, max_step_m: an edge is checked so often that between two checks no joint turns (slides) by more
            than the first (m), and no point of a link moves by more than the second.
    """

    parents: np.ndarray
    joint_types: np.ndarray
    X_parent_joint: np.ndarray
    axes: np.ndarray
    coupling: np.ndarray
    offset: np.ndarray
    links: np.ndarray
    link_info: np.ndarray
    parts: np.ndarray
    part_info: np.ndarray
    vertices: np.ndarray
    nodes: np.ndarray
    node_info: np.ndarray
    points: np.ndarray
    pairs: np.ndarray
    pair_margins: np.ndarray
    grids: np.ndarray
    grid_info: np.ndarray
    kinds: np.ndarray
    target_values: np.ndarray
    other_values: np.ndarray
    cloud_values: np.ndarray
    margins: np.ndarray
    carried_points: np.ndarray
    carried_limits: np.ndarray
    carried_body: int
    num_parts: int
    exact_hand: bool
    max_step_rad: float
    max_step_m: float


class Work(NamedTuple):
    """Room that a check writes to; one per thread.

    Attributes:
        X_BK: (K, 4, 4) poses of the bodies; before: the same, earlier. centres: (G, 3) of the links' spheres in B.
        poses: (Np + Nb, 12) of parts in B, made when needed; made: (Np + 1,) the check each was made in, last the
            number of this one.
        simplex: (4, 3); q: (D,); frame: (12,).
    """

    X_BK: np.ndarray
    before: np.ndarray
    centres: np.ndarray
    poses: np.ndarray
    made: np.ndarray
    simplex: np.ndarray
    q: np.ndarray
    frame: np.ndarray


def make_work(check: CheckArrays) -> Work:
    """Room for checks of `check`."""
    bodies = len(check.parents)
    poses = check.parts[:, POSE:].copy()
    return Work(
        X_BK=np.zeros((bodies, 4, 4)),
        before=np.zeros((bodies, 4, 4)),
        centres=np.zeros((len(check.links), 3)),
        poses=poses,
        made=np.zeros(check.num_parts + 1, np.int64),
        simplex=np.zeros((4, 3)),
        q=np.zeros(check.coupling.shape[1]),
        frame=np.zeros(12),
    )
