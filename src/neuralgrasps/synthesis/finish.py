"""From closed hands to a `GraspSet`: contacts, exact quality, pre-grasp and squeeze."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numba import njit

from neuralgrasps.grasps.contact import find_contacts
from neuralgrasps.grasps.epsilon import STARTS, epsilon
from neuralgrasps.grasps.grasp_set import GraspSet, empty_grasps
from neuralgrasps.grasps.penetration import mesh_depths, penetration_depths
from neuralgrasps.grasps.wrench_space import grasp_wrenches
from neuralgrasps.hands.packed import pose_links
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.sim.protocols import get_protocol
from neuralgrasps.synthesis.candidates import CONE_EDGES, CONTACTS_PER_LINK, Candidates, GraspProblem
from neuralgrasps.synthesis.clusters import hand_clearance
from neuralgrasps.synthesis.squeeze import joint_scale, pregrasp_joints, squeeze_joints

_OPENING_STEPS = 4


def finish_grasps(
    problem: GraspProblem, closed: Candidates, *, protocol: str, seed: int, config: Mapping[str, str]
) -> GraspSet:
    """Candidates with contacts, squeeze and pre-grasp, in order.

    Those that overlap too deeply, or are not in force closure by the exact epsilon of their contacts, are dropped.

    Args:
        problem: the pair; closed: its candidates.
        protocol: the physics protocol whose servos the squeeze is meant for.
        seed, config: provenance.
    """
    hand, obj = problem.hand, problem.obj
    depth = penetration_depths(problem.packed, obj.sdf, problem.probe, X_OH=closed.X_OH, q=closed.q).deepest
    depth = np.maximum(depth, mesh_depths(problem.hand_probe, obj.mesh, obj.sdf, X_OH=closed.X_OH, q=closed.q))
    shallow = depth <= problem.max_penetration_m
    closed, depth = closed.take(shallow), depth[shallow]
    if len(closed) == 0:
        return empty_grasps(hand.name, obj.name, num_joints=hand.num_dofs, seed=seed)
    count, room = len(closed), hand.tree.num_links * CONTACTS_PER_LINK
    points, normals = np.full((count, room, 3), np.nan), np.full((count, room, 3), np.nan)
    links = np.full((count, room), -1, np.int32)
    squeeze, quality = closed.q.copy(), np.zeros(count)
    servos = get_protocol(protocol)
    stiffness = joint_scale(hand, servos.revolute.kp, servos.prismatic.kp)
    X_HL = forward_fast(hand.tree, closed.q)
    for i in range(count):
        found = find_contacts(
            *problem.sdf_arrays, problem.packed, closed.X_OH[i], X_HL[i], problem.contact_threshold_m,
            CONTACTS_PER_LINK, points[i], normals[i], links[i],
        )  # fmt: skip
        points[i, found:], normals[i, found:], links[i, found:] = np.nan, np.nan, -1
        if found == 0:
            continue
        contacts = points[i, :found], normals[i, :found], links[i, :found]
        quality[i] = _quality(problem, contacts)
        squeeze[i] = squeeze_joints(problem, closed.q[i], closed.X_OH[i], X_HL[i], contacts, stiffness=stiffness)
    used = int((links >= 0).sum(axis=1).max())
    grasps = GraspSet(
        hand=hand.name,
        object=obj.name,
        X_OH=closed.X_OH,
        q=closed.q,
        q_pregrasp=clear_pregrasps(problem, closed.X_OH, closed.q),
        q_squeeze=squeeze,
        contact_points_O=points[:, :used],
        contact_normals_O=normals[:, :used],
        contact_links=links[:, :used],
        epsilon=quality,
        penetration_m=depth,
        protocol=protocol,
        seed=seed,
        config=config,
    )
    return grasps[quality > 0.0]


def _quality(problem: GraspProblem, contacts: tuple[np.ndarray, np.ndarray, np.ndarray]) -> float:
    points, normals, _ = contacts
    wrenches = grasp_wrenches(
        points, normals, problem.obj.com_O, problem.friction, CONE_EDGES, problem.torsion, problem.length
    )
    return epsilon(wrenches, STARTS)


def clear_pregrasps(problem: GraspProblem, X_OH: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(N, J) postures more open than `q`, as far as nothing on the way overlaps the object deeper than the grasp may.

    A finger that opens may meet another side of the object, a handle for example; then it opens less, or not at all.
    """
    opened = pregrasp_joints(problem.hand, q)
    out = q.copy()
    _open_while_clear(
        *problem.sdf_arrays, problem.packed, problem.clusters, np.ascontiguousarray(X_OH), np.ascontiguousarray(q),
        opened, problem.max_penetration_m, out,
    )  # fmt: skip
    return out


@njit(cache=True, error_model="numpy")
def _open_while_clear(values, origin, inv_spacing, packed, clusters, X_OH, q, opened, max_depth, out):  # type: ignore[no-untyped-def]
    X_HL, trial = np.zeros((packed.link_radius.shape[0], 4, 4)), np.empty(q.shape[1])
    for i in range(q.shape[0]):
        for step in range(1, _OPENING_STEPS + 1):
            for j in range(q.shape[1]):
                trial[j] = q[i, j] + step / _OPENING_STEPS * (opened[i, j] - q[i, j])
            pose_links(packed, trial, X_HL)
            if hand_clearance(values, origin, inv_spacing, packed, clusters, X_OH[i], X_HL) < -max_depth:
                break
            out[i] = trial
