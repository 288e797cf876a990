"""Joint targets around a closed grasp: the squeeze that presses on the object, and the pre-grasp it closes from."""

from __future__ import annotations

import numpy as np

from neuralgrasps.compiled import njit
from neuralgrasps.grasps.force_qp import ContactForces
from neuralgrasps.hands.hand import Hand
from neuralgrasps.kinematics.jacobian import point_jacobian
from neuralgrasps.kinematics.tree import PRISMATIC
from neuralgrasps.sim.build import leaders
from neuralgrasps.synthesis.candidates import GraspProblem

EFFORT_SHARE = 0.9  # of its torque limit that no joint's squeeze exceeds
CLOSING_SHARE = 0.5  # of its torque limit that every closing joint of a dexterous hand adds
JAW_SQUEEZE_M = 0.010  # a jaw's target lies this far past contact
JAW_SQUEEZE_RAD = 0.15  # the same for a jaw on a turning linkage: about as much force, 0.1 m from the joint
GAP_M = 1.0e-3  # between pads and object that a jaw's target makes up for: stiff transmissions have no more to give
PREGRASP_RAD = 0.12  # closing joints start this far back
PREGRASP_JAW_M = 0.010


def joint_scale(hand: Hand, revolute: float, prismatic: float) -> np.ndarray:
    """(J,) `prismatic` for joints whose servo slides, `revolute` for the others, whatever kind follows them."""
    links, _, _ = leaders(hand)
    return np.where(hand.tree.joint_types[links] == PRISMATIC, prismatic, revolute)


def pregrasp_joints(hand: Hand, q: np.ndarray) -> np.ndarray:
    """(N, J) postures a little more open than `q`, within the limits."""
    back = joint_scale(hand, PREGRASP_RAD, PREGRASP_JAW_M)
    opened = q - np.sign(hand.closing_rate) * back * np.abs(hand.closing_rate) / np.abs(hand.closing_rate).max()
    return np.clip(opened, hand.tree.lower, hand.tree.upper)


@njit(cache=True, error_model="numpy")
def _contact_torques(parents, joint_types, axes, coupling, X_HL, R_HO, X_HO_p, points_O, forces_O, links, out):  # type: ignore[no-untyped-def]
    """out (J,) = sum of J_c' f_c: joint torques that exert `forces_O` on the object."""
    jacobian = np.empty((3, out.shape[0]))
    point, force = np.empty(3), np.empty(3)
    out[:] = 0.0
    for c in range(links.shape[0]):
        if links[c] < 0:
            continue
        for r in range(3):
            point[r] = X_HO_p[r]
            force[r] = 0.0
            for k in range(3):
                point[r] += R_HO[r, k] * points_O[c, k]
                force[r] += R_HO[r, k] * forces_O[c, k]
        point_jacobian(parents, joint_types, axes, coupling, X_HL, links[c], point, jacobian)
        for j in range(out.shape[0]):
            for r in range(3):
                out[j] += jacobian[r, j] * force[r]


def contact_torques(
    hand: Hand, X_OH: np.ndarray, X_HL: np.ndarray, points_O: np.ndarray, forces_O: np.ndarray, links: np.ndarray
) -> np.ndarray:
    """(J,) joint torques, N m or N, that exert `forces_O` (C, 3) at `points_O` (C, 3) with `links` (C,)."""
    tree, R_HO, torque = hand.tree, np.ascontiguousarray(X_OH[:3, :3].T), np.empty(hand.num_dofs)
    _contact_torques(
        tree.parents, tree.joint_types, tree.axes, tree.coupling, X_HL, R_HO, -R_HO @ X_OH[:3, 3],
        points_O, forces_O, links, torque,
    )  # fmt: skip
    return torque


def squeeze_joints(
    problem: GraspProblem,
    q: np.ndarray,
    X_OH: np.ndarray,
    X_HL: np.ndarray,
    contacts: tuple[np.ndarray, np.ndarray],
    balance: ContactForces,
    *,
    stiffness: np.ndarray,
    idle: np.ndarray,
    torques: np.ndarray | None = None,
) -> np.ndarray:
    """Position targets (J,) whose servo torques press on the object and push it away as little as they can.

    They mean something only with the servo they are for: `stiffness` is the protocol's.

    The contact forces are those of least net wrench (`force_qp`); their joint torques are scaled until one reaches
    `EFFORT_SHARE` of its limit, closing joints of fingers that touch add `CLOSING_SHARE` of theirs, and every torque is
    clipped to `EFFORT_SHARE`; target = q + torque / stiffness. A jaw's target lies `JAW_SQUEEZE_M` past contact, with
    the same bound from a pad's way of `GAP_M` on. Idle fingers stay where they are. The object still shifts by some
    millimetres: the share that closing joints add is not balanced, and no contact is where it was planned.

    Args:
        problem: the pair.
        q: (J,) closed posture; X_OH (4, 4); X_HL (L, 4, 4) link poses at q.
        contacts: points (C, 3) in O and links (C,), without padding; C >= 1. balance: the forces there.
        stiffness: (J,) servo gain, N m/rad or N/m. idle: (J,) joints of fingers that touch nothing.
        torques: (J,) to exert in place of those of `balance`; a jaw heeds neither.
    """
    hand, closing = problem.hand, np.sign(problem.hand.closing_rate) * ~idle
    most = EFFORT_SHARE * hand.tree.effort
    if hand.is_jaw:
        past = joint_scale(hand, JAW_SQUEEZE_RAD, JAW_SQUEEZE_M)
        return q + GAP_M * problem.closing.unit + np.clip(closing * past * stiffness, -most, most) / stiffness
    points, links = contacts
    torque = contact_torques(hand, X_OH, X_HL, points, balance.forces, links) if torques is None else torques.copy()
    torque *= EFFORT_SHARE / max(np.abs(torque / hand.tree.effort).max(), 1e-9)
    torque += closing * CLOSING_SHARE * hand.tree.effort
    return q + np.clip(torque, -most, most) / stiffness
