"""The joints of a hand as its robot names them: those that are moved and those that follow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import DataFormatError, InputError, check_shape
from neuralgrasps.hands.hand import Hand
from neuralgrasps.kinematics.tree import FIXED
from neuralgrasps.sim.build import leaders

# Our names of joints, where the robot's public description has others for the same joint (same zero, same sign).
ROBOT_NAMES: Mapping[str, Mapping[str, str]] = {
    "allegro": {f"joint_{i}": f"joint_{i}.0" for i in range(16)},
    "fetch": {"gripper": "r_gripper_finger_joint"},
    "panda": {"gripper": "panda_finger_joint1"},
}
_AGREE = 1e-4  # rad or metres; a following joint may be rounded differently from its leader


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HandJoints:
    """All K moving joints of a hand, in the order of its links.

    Attributes:
        names: K names, as the robot has them; own: (K,) bool, independent; the others follow rigidly.
        dofs: (J,) the place of each independent joint of `q` among the K.
        effort: (K,) largest torque (N m) or force (N); that of the leader for a follower.
        lower, upper: (J,) limits of the independent joints, rad or metres.
    """

    names: tuple[str, ...]
    own: np.ndarray
    dofs: np.ndarray
    effort: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    _coupling: np.ndarray
    _offset: np.ndarray

    def positions(self, q: np.ndarray) -> np.ndarray:
        """All joints (..., K) for independent joints (..., J), rad or metres.

        Raises:
            ShapeError: another number of joints.
        """
        q = np.asarray(q, np.float64)
        check_shape("q", q.shape, (len(self.dofs),))
        return np.asarray(q @ self._coupling.T + self._offset)

    def targets(self, q: np.ndarray) -> np.ndarray:
        """All joints (..., K) where a robot may be sent for independent joints (..., J): clamped to their limits.

        Targets that press may lie beyond the limits (a jaw's always does, so that a simulated servo is at its full
        force); controllers that check limits refuse these. The force is to be said apart, as a share of `effort`.

        Raises:
            ShapeError: another number of joints.
        """
        q = np.asarray(q, np.float64)
        check_shape("q", q.shape, (len(self.dofs),))
        return self.positions(np.clip(q, self.lower, self.upper))

    def q(self, values: Mapping[str, float], *, where: str) -> np.ndarray:
        """Independent joints (J,) from positions by the robot's names; followers may be left out.

        Raises:
            DataFormatError: a joint is missing or unknown, or a follower is not where its leader puts it.
        """
        known = set(self.names)
        if unknown := [n for n in values if n not in known]:
            raise DataFormatError(f"{where}: joints {', '.join(unknown)} are unknown; known: {', '.join(self.names)}.")
        needed = [self.names[k] for k in self.dofs]
        if missing := [n for n in needed if n not in values]:
            raise DataFormatError(f"{where} lacks joints {', '.join(missing)}; expected {', '.join(needed)}.")
        at = np.array([float(values[n]) for n in needed])
        q = (at - self._offset[self.dofs]) / self._coupling[self.dofs, np.arange(len(self.dofs))]
        for name, expected in zip(self.names, self.positions(q), strict=True):
            if abs(float(values.get(name, expected)) - expected) > _AGREE:
                raise DataFormatError(
                    f"{where}: joint {name} is at {values[name]}, but follows the others to {expected:.6g}."
                )
        return q


def hand_joints(hand: Hand, *, names: Mapping[str, str] | None = None) -> HandJoints:
    """The joints of `hand` by the names of its robot.

    Args:
        names: the robot's names of joints by ours; default `ROBOT_NAMES` for built-in hands. Joints not named keep
            the names of the hand's file.
    Raises:
        RobotDescriptionError: an independent joint moves no link alone.
        InputError: `names` has a joint that the hand has not, or gives two joints one name.
    """
    tree = hand.tree
    given = ROBOT_NAMES.get(hand.name, {}) if names is None else names
    moving = np.flatnonzero((tree.joint_types != FIXED) & (tree.coupling != 0).any(axis=1))
    led = np.searchsorted(moving, leaders(hand)[0])
    ours = [tree.joint_names[i] for i in moving]
    for dof, k in enumerate(led):
        ours[k] = tree.dof_names[dof]
    if unknown := [n for n in given if n not in ours] if names is not None else []:
        raise InputError(f"hand '{hand.name}' has no joints {', '.join(unknown)}; it has {', '.join(ours)}.")
    real = tuple(given.get(n, n) for n in ours)
    if len(set(real)) < len(real):
        raise InputError(f"two joints of hand '{hand.name}' would have one name: {', '.join(real)}.")
    coupling = tree.coupling[moving]
    own = np.zeros(len(moving), np.bool_)
    own[led] = True
    return HandJoints(
        names=real,
        own=own,
        dofs=led,
        effort=np.where(coupling != 0, tree.effort, 0.0).max(axis=1, initial=0.0),
        lower=tree.lower,
        upper=tree.upper,
        _coupling=coupling,
        _offset=tree.offset[moving],
    )
