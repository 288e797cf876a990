"""An arm with a hand on its flange, as one robot."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from neuralgrasps.arms.arm import Arm
from neuralgrasps.errors import ShapeError, check_shape
from neuralgrasps.hands.hand import ConvexPart, Hand
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.kinematics.tree import FIXED, KinematicTree


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Manipulator:
    """An arm and the hand on its flange; make it with `mount`.

    Links and joints of the arm come first, then those of the hand, in their own order. Planning works on `q_arm` (D,),
    the arm's planned joints; everything else is at rest while the arm moves.

    Attributes:
        arm, hand: what it was made of.
        tree: both, L links, Q independent joints; link names of the hand get the prefix "hand/".
        parts: convex solids of both, with indices of links of `tree`.
        hand_link: index of the hand base H in `tree`.
        arm_dofs: (D,) indices into `q` of the planned joints; hand_dofs: (J,) of the hand's.
        q_home: (Q,) the arm at home, the hand open.
        lower, upper, velocity, acceleration: (D,) limits of `q_arm`; continuous: (D,) bool.
    """

    arm: Arm
    hand: Hand
    tree: KinematicTree
    parts: tuple[ConvexPart, ...]
    hand_link: int
    arm_dofs: np.ndarray
    hand_dofs: np.ndarray
    q_home: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    continuous: np.ndarray

    @property
    def name(self) -> str:
        return f"{self.arm.name}+{self.hand.name}"

    @property
    def arm_names(self) -> tuple[str, ...]:
        """Names of the D planned joints."""
        return tuple(self.tree.dof_names[j] for j in self.arm_dofs)

    def full_q(self, q_arm: np.ndarray, q_hand: np.ndarray | None = None) -> np.ndarray:
        """All joints (..., Q) for planned joints `q_arm` (..., D) and hand joints `q_hand` (..., J), default open."""
        q_arm = np.asarray(q_arm, float)
        check_shape("q_arm", q_arm.shape, (len(self.arm_dofs),))
        q = np.broadcast_to(self.q_home, (*q_arm.shape[:-1], len(self.q_home))).copy()
        q[..., self.arm_dofs] = q_arm
        if q_hand is not None:
            self.hand.check_q(np.asarray(q_hand))
            q[..., self.hand_dofs] = q_hand
        return q

    def hand_pose(self, q_arm: np.ndarray) -> np.ndarray:
        """X_BH (..., 4, 4), the hand base in the robot base, for planned joints (..., D)."""
        return forward_fast(self.tree, self.full_q(q_arm))[..., self.hand_link, :, :]

    def camera_pose(self, q_arm: np.ndarray) -> np.ndarray:
        """X_BC (4, 4) of the arm's camera for planned joints (D,).

        Raises:
            ShapeError: the arm has no camera.
        """
        camera = self.arm.camera
        if camera is None:
            raise ShapeError(f"arm '{self.arm.name}' has no camera; state one in its arm.toml.")
        return np.asarray(forward_fast(self.tree, self.full_q(q_arm))[camera.link] @ camera.X_LC)


def joined_tree(arm: KinematicTree, hand: KinematicTree, *, flange: int, X_FH: np.ndarray) -> KinematicTree:
    """One tree of an arm and a hand whose base is fixed to the arm's link `flange` at `X_FH` (4, 4)."""
    shift = arm.num_links
    parents = np.concatenate([arm.parents, np.where(hand.parents < 0, flange, hand.parents + shift)])
    X_parent_joint = np.concatenate([arm.X_parent_joint, hand.X_parent_joint])
    X_parent_joint[shift] = X_FH @ hand.X_parent_joint[0]
    coupling = np.zeros((shift + hand.num_links, arm.num_dofs + hand.num_dofs))
    coupling[:shift, : arm.num_dofs] = arm.coupling
    coupling[shift:, arm.num_dofs :] = hand.coupling
    joint_types = np.concatenate([arm.joint_types, hand.joint_types])
    joint_types[shift] = FIXED
    return KinematicTree(
        link_names=arm.link_names + tuple(f"hand/{n}" for n in hand.link_names),
        parents=parents.astype(np.int32),
        joint_names=(*arm.joint_names, "hand/mount", *(f"hand/{n}" for n in hand.joint_names[1:])),
        joint_types=joint_types.astype(np.int8),
        X_parent_joint=X_parent_joint,
        axes=np.concatenate([arm.axes, hand.axes]),
        coupling=coupling,
        offset=np.concatenate([arm.offset, hand.offset]),
        dof_names=arm.dof_names + tuple(f"hand/{n}" for n in hand.dof_names),
        lower=np.concatenate([arm.lower, hand.lower]),
        upper=np.concatenate([arm.upper, hand.upper]),
        effort=np.concatenate([arm.effort, hand.effort]),
    )


def mount_at(arm: Arm, hand: Hand, X_FH: np.ndarray) -> Manipulator:
    """`hand` on the flange link of `arm`, its base at `X_FH` (4, 4) in that link."""
    tree = joined_tree(arm.tree, hand.tree, flange=arm.flange, X_FH=np.asarray(X_FH, float))
    shift, joints = arm.tree.num_links, np.asarray(arm.joints, np.int64)
    return Manipulator(
        arm=arm,
        hand=hand,
        tree=tree,
        parts=arm.parts + tuple(replace(p, link=p.link + shift) for p in hand.parts),
        hand_link=shift,
        arm_dofs=joints,
        hand_dofs=np.arange(arm.tree.num_dofs, tree.num_dofs),
        q_home=np.concatenate([arm.q_home, hand.q_open]),
        lower=arm.tree.lower[joints],
        upper=arm.tree.upper[joints],
        velocity=arm.velocity[joints],
        acceleration=arm.acceleration[joints],
        continuous=arm.continuous[joints],
    )
