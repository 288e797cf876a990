"""The largest torque or force that the actuators of an MJCF can put on each joint."""

from __future__ import annotations

import mujoco
import numpy as np

# as plain numbers: MuJoCo's enumerations do not compare equal to numpy integers from the left
ON_JOINT = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
ON_TENDON, WRAPS_JOINT = int(mujoco.mjtTrn.mjTRN_TENDON), int(mujoco.mjtWrap.mjWRAP_JOINT)
FIXED_GAIN, NO_BIAS = int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtBias.mjBIAS_NONE)


def joint_efforts(model: mujoco.MjModel) -> list[float | None]:
    """Largest torque (N m) or force (N) per joint of `model`; None where the file bounds nothing.

    A joint's `actuatorfrcrange` and the sum of its actuators' bounds both hold, so the smaller counts.
    """
    actuated = np.zeros(model.njnt)
    unbounded = np.zeros(model.njnt, bool)
    for a in range(model.nu):
        force = _actuator_force(model, a)
        for joint, arm in _moment_arms(model, a):
            if force is None:
                unbounded[joint] = True
            else:
                actuated[joint] += force * arm
    efforts: list[float | None] = []
    for j in range(model.njnt):
        bounds = []
        if model.jnt_actfrclimited[j]:
            bounds.append(float(np.max(np.abs(model.jnt_actfrcrange[j]))))
        if actuated[j] > 0 and not unbounded[j]:
            bounds.append(float(actuated[j]))
        efforts.append(min(bounds) if bounds else None)
    return efforts


def _actuator_force(model: mujoco.MjModel, a: int) -> float | None:
    """Largest scalar force of an actuator before its transmission; None when unbounded."""
    if model.actuator_forcelimited[a]:
        return float(np.max(np.abs(model.actuator_forcerange[a])))
    is_motor = model.actuator_gaintype[a] == FIXED_GAIN and model.actuator_biastype[a] == NO_BIAS
    if is_motor and model.actuator_ctrllimited[a]:
        return float(abs(model.actuator_gainprm[a, 0]) * np.max(np.abs(model.actuator_ctrlrange[a])))
    return None


def _moment_arms(model: mujoco.MjModel, a: int) -> list[tuple[int, float]]:
    """(joint, factor from the actuator's force to the joint's effort) of joint and fixed-tendon transmissions."""
    gear, target = abs(float(model.actuator_gear[a, 0])), int(model.actuator_trnid[a, 0])
    kind = int(model.actuator_trntype[a])
    if kind in ON_JOINT:
        return [(target, gear)]
    if kind != ON_TENDON:
        return []
    start, count = int(model.tendon_adr[target]), int(model.tendon_num[target])
    is_joint = model.wrap_type[start : start + count] == WRAPS_JOINT
    wraps = start + np.flatnonzero(is_joint)
    return [(int(model.wrap_objid[w]), gear * abs(float(model.wrap_prm[w]))) for w in wraps]
