"""From closed hands to a `GraspSet`: settled, with contacts, exact quality, labels, pre-grasp and squeeze."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.grasps.epsilon import epsilon
from neuralgrasps.grasps.force_qp import contact_forces
from neuralgrasps.grasps.grasp_set import GraspSet, empty_grasps
from neuralgrasps.grasps.kind import ContactKinds, contact_kinds
from neuralgrasps.grasps.penetration import mesh_depths
from neuralgrasps.grasps.wrench_space import grasp_wrenches
from neuralgrasps.hands.packed import pose_links
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.sim.protocols import get_protocol
from neuralgrasps.synthesis.candidates import CONE_EDGES, Candidates, GraspProblem
from neuralgrasps.synthesis.clusters import hand_clearance
from neuralgrasps.synthesis.contacts import contacts_of
from neuralgrasps.synthesis.prepared import prepare_tree
from neuralgrasps.synthesis.settle import settle
from neuralgrasps.synthesis.squeeze import joint_scale, pregrasp_joints, squeeze_joints
from neuralgrasps.synthesis.strength import lift_torques

_OPENING_STEPS = 4


def finish_grasps(
    problem: GraspProblem,
    closed: Candidates,
    *,
    protocol: str,
    seed: int,
    config: Mapping[str, str],
    threads: int = 1,
    lift: bool = False,
) -> GraspSet:
    """Candidates settled on the object, with contacts, labels, squeeze and pre-grasp, in order.

    Those that still overlap too deeply, or whose contacts are not in force closure by the exact epsilon, are dropped.

    Args:
        problem: the pair; closed: its candidates.
        protocol: the physics protocol whose servos the squeeze is meant for.
        seed, config: provenance. threads: of the settling; the result does not depend on it.
        lift: squeeze so that the object can be lifted off the problem's support, instead of evenly.
    """
    hand, obj = problem.hand, problem.obj
    closed, idle = _without_overlap(problem, *settle(problem, closed, threads=threads))
    if len(closed) == 0:
        return empty_grasps(hand.name, obj.name, num_joints=hand.num_dofs, seed=seed)
    servos = get_protocol(protocol)
    stiffness = joint_scale(hand, servos.revolute.kp, servos.prismatic.kp)
    X_HL = forward_fast(hand.tree, closed.q)
    points, normals, links = contacts_of(problem, closed.X_OH, X_HL)
    squeeze, quality, residual = closed.q.copy(), np.zeros(len(closed)), np.full(len(closed), np.nan)
    for i in range(len(closed)):
        found = int((links[i] >= 0).sum())
        if found == 0:
            continue
        quality[i] = _quality(problem, points[i, :found], normals[i, :found])
        balance = contact_forces(
            points[i, :found], normals[i, :found], obj.com_O, problem.friction, CONE_EDGES, problem.torsion,
            problem.length,
        )  # fmt: skip
        residual[i] = balance.residual
        torques = None
        if lift:
            torques = lift_torques(
                problem, closed.X_OH[i], X_HL[i], points[i, :found], normals[i, :found], links[i, :found]
            )
        squeeze[i] = squeeze_joints(
            problem, closed.q[i], closed.X_OH[i], X_HL[i], (points[i, :found], links[i, :found]), balance,
            stiffness=stiffness, idle=idle[i], torques=torques,
        )  # fmt: skip
    kinds = contact_kinds(hand, links)
    grasps = GraspSet(
        hand=hand.name,
        object=obj.name,
        X_OH=closed.X_OH,
        q=closed.q,
        q_pregrasp=clear_pregrasps(problem, closed.X_OH, closed.q, idle),
        q_squeeze=squeeze,
        contact_points_O=points,
        contact_normals_O=normals,
        contact_links=links,
        epsilon=quality,
        penetration_m=closed.penetration_m,
        force_residual=residual,
        palm_contact=kinds.palm_contact,
        finger_count=kinds.finger_count,
        precision=kinds.precision,
        protocol=protocol,
        seed=seed,
        config=config,
    )
    return grasps[quality > 0.0]


def _without_overlap(problem: GraspProblem, closed: Candidates, idle: np.ndarray) -> tuple[Candidates, np.ndarray]:
    """Those that overlap by no more than allowed, by the grid and then by the mesh itself; and their idle joints."""
    shallow = closed.penetration_m <= problem.max_penetration_m
    closed, idle = closed.take(shallow), idle[shallow]
    if len(closed) == 0:
        return closed, idle
    by_mesh = mesh_depths(
        problem.hand_probe, problem.obj.mesh, problem.obj.sdf, X_OH=closed.X_OH, q=closed.q,
        tree=prepare_tree(problem.obj.mesh),
    )  # fmt: skip
    closed = replace(closed, penetration_m=np.maximum(closed.penetration_m, by_mesh))
    shallow = closed.penetration_m <= problem.max_penetration_m
    return closed.take(shallow), idle[shallow]


def kinds_of(problem: GraspProblem, X_OH: np.ndarray, X_HL: np.ndarray) -> ContactKinds:
    """Labels of N grasps by the links that touch."""
    return contact_kinds(problem.hand, contacts_of(problem, X_OH, X_HL)[2])


def _quality(problem: GraspProblem, points: np.ndarray, normals: np.ndarray) -> float:
    wrenches = grasp_wrenches(
        points, normals, problem.obj.com_O, problem.friction, CONE_EDGES, problem.torsion, problem.length
    )
    return epsilon(wrenches)


def clear_pregrasps(problem: GraspProblem, X_OH: np.ndarray, q: np.ndarray, idle: np.ndarray) -> np.ndarray:
    """(N, J) postures more open than `q`, as far as nothing on the way overlaps the object deeper than the grasp may.

    A finger that opens may meet another side of the object, a handle for example; then it opens less, or not at all.
    `idle` (N, J) joints stay where they are.
    """
    opened = np.where(idle, q, pregrasp_joints(problem.hand, q))
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
