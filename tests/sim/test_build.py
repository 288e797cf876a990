from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from neuralgrasps.errors import RobotDescriptionError
from neuralgrasps.hands.hand import Hand
from neuralgrasps.kinematics.tree import KinematicTree
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.sim.build import grasp_model, joint_name, leaders
from neuralgrasps.sim.protocols import get_protocol

from .toy import HALF, toy_box, toy_hand

DEX = get_protocol("dexgraspbench")


def test_model_has_the_protocols_conditions(hand: Hand, box: ObjectModel) -> None:
    model = grasp_model(hand, box, get_protocol("dexgraspbench-hard"))
    assert model.opt.timestep == 0.004 and model.opt.impratio == 10 and model.opt.noslip_iterations == 2
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    np.testing.assert_array_equal(model.opt.gravity, 0)
    geom = model.geom("object_0")
    np.testing.assert_allclose(geom.friction, [0.3, 0.01, 5e-5])
    np.testing.assert_allclose(geom.solref, [0.005, 1.0])
    np.testing.assert_allclose(geom.solimp[:3], [0.5, 0.99, 1e-4])
    assert geom.condim[0] == 4


def test_object_has_the_protocols_mass_and_the_true_shapes_inertia(hand: Hand) -> None:
    box = toy_box(centre=(0.05, 0.0, -0.02), mass_kg=0.7)
    for name, mass in (("dexgraspbench", 0.1), ("shake", 0.7)):
        model = grasp_model(hand, box, get_protocol(name))
        body = model.body("object")
        assert body.mass[0] == pytest.approx(mass)
        np.testing.assert_allclose(body.ipos, box.com_O)
        squares = HALF**2 / 3
        np.testing.assert_allclose(np.sort(body.inertia), np.sort(mass * (squares.sum() - squares)), rtol=1e-6)


def test_links_stand_where_the_tree_puts_them(box: ObjectModel) -> None:
    hand = toy_hand()
    model = grasp_model(hand, box, DEX)
    data = mujoco.MjData(model)
    q = np.array([0.013, 0.027])
    for link, value in zip((1, 2), hand.tree.joint_positions(q)[1:], strict=True):
        data.qpos[model.joint(joint_name(link)).qposadr[0]] = value
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.body("link_1").xpos, [0.013, 0, 0.1], atol=1e-12)
    np.testing.assert_allclose(data.body("link_2").xpos, [-0.027, 0, 0.1], atol=1e-12)
    np.testing.assert_allclose(data.geom("part_1").xpos, [0.018, 0, 0.1], atol=1e-12)


def test_hand_never_collides_with_itself(hand: Hand, box: ObjectModel) -> None:
    model = grasp_model(hand, box, DEX)
    parts = [model.geom(f"part_{i}") for i in range(len(hand.parts))]
    other = model.geom("object_0")
    for a in parts:
        assert all(not (a.contype & b.conaffinity)[0] and not (b.contype & a.conaffinity)[0] for b in parts)
        assert (a.contype & other.conaffinity)[0] or (other.contype & a.conaffinity)[0]


@pytest.mark.parametrize("gain", [1.0, -2.0])
def test_servo_reaches_its_target_with_the_joints_stiffness_and_limit(gain: float) -> None:
    """Free joints settle at the target; torque is kp (target - q) up to the effort, whatever the gain of the link."""
    hand = toy_hand(gain=1.0)
    tree = replace_tree(hand.tree, gain)
    hand = replace(hand, tree=tree)
    far = toy_box(centre=(0.0, 0.0, 5.0))
    model = grasp_model(hand, far, DEX)
    data = mujoco.MjData(model)
    data.ctrl[:] = [0.01 / gain, 0.03 / gain]
    mujoco.mj_step(model, data, nstep=1)
    expected = np.clip(DEX.prismatic.kp * np.array([0.01, 0.03]) / gain, -20.0, 20.0)
    np.testing.assert_allclose(data.actuator_force, expected, rtol=1e-9)
    mujoco.mj_step(model, data, nstep=500)
    p = [data.joint(joint_name(link)).qpos[0] for link in (1, 2)]
    np.testing.assert_allclose(p, [0.01, 0.03], atol=1e-6)


def replace_tree(tree: KinematicTree, gain: float) -> KinematicTree:
    limits = np.sort(np.stack([tree.lower / gain, tree.upper / gain]), axis=0)
    return replace(tree, coupling=tree.coupling * gain, lower=limits[0], upper=limits[1])


def test_coupled_joints_follow(box: ObjectModel) -> None:
    """One joint moves both pads, the second at half the rate and 5 mm ahead."""
    hand = toy_hand(coupled=True)
    tree = replace(hand.tree, coupling=np.array([[0.0], [1.0], [0.5]]), offset=np.array([0.0, 0.0, 0.005]))
    hand = replace(hand, tree=tree)
    model = grasp_model(hand, toy_box(centre=(0.0, 0.0, 5.0)), DEX)
    data = mujoco.MjData(model)
    data.ctrl[:] = 0.02
    mujoco.mj_step(model, data, nstep=1000)
    assert data.joint(joint_name(1)).qpos[0] == pytest.approx(0.02, abs=1e-5)
    assert data.joint(joint_name(2)).qpos[0] == pytest.approx(0.015, abs=1e-5)


def test_a_joint_of_two_dofs_follows_both() -> None:
    tree = toy_hand().tree
    joints = {
        "link_names": ("base", "a", "b", "sum"),
        "parents": np.array([-1, 0, 0, 0], np.int32),
        "joint_names": ("", "a", "b", "sum"),
        "joint_types": np.array([0, 2, 2, 2], np.int8),
        "X_parent_joint": np.concatenate([tree.X_parent_joint, tree.X_parent_joint[1:2]]),
        "axes": np.concatenate([tree.axes, [[0.0, 1.0, 0.0]]]),
        "coupling": np.array([[0.0, 0], [1, 0], [0, 1], [0.5, -0.25]]),
        "offset": np.array([0.0, 0.0, 0.0, 0.001]),
    }
    hand = replace(toy_hand(), tree=replace(tree, **joints))
    model = grasp_model(hand, toy_box(centre=(0.0, 0.0, 5.0)), DEX)
    data = mujoco.MjData(model)
    data.ctrl[:] = [0.02, 0.03]
    mujoco.mj_step(model, data, nstep=1000)
    assert data.joint(joint_name(3)).qpos[0] == pytest.approx(0.5 * 0.02 - 0.25 * 0.03 + 0.001, abs=1e-5)


def test_leader_is_the_joint_that_equals_q() -> None:
    tree = replace(toy_hand(coupled=True).tree, coupling=np.array([[0.0], [0.3], [1.0]]))
    links, gain, offset = leaders(replace(toy_hand(coupled=True), tree=tree))
    assert (links[0], gain[0], offset[0]) == (2, 1.0, 0.0)


@pytest.mark.parametrize("effort", [0.0, np.inf, np.nan])
def test_a_joint_without_effort_is_refused(box: ObjectModel, effort: float) -> None:
    with pytest.raises(RobotDescriptionError, match=r"jaw_0.*effort"):
        grasp_model(toy_hand(effort=effort), box, DEX)
