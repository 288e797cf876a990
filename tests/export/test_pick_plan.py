"""A whole pick as one document."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import neuralgrasps
from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.arms.mount import mount
from neuralgrasps.arms.zoo import load_arm
from neuralgrasps.errors import DataFormatError, InputError
from neuralgrasps.export.frames import Wrist
from neuralgrasps.export.messages import check_message
from neuralgrasps.export.moveit_grasp import GraspMessageConfig, grasps_of
from neuralgrasps.export.pick_plan import STEPS, load_pick_plan, plan_document, save_pick_plan
from neuralgrasps.export.plan_origin import PlanOrigin, gripper_opening
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.geometry.se3_numpy import axis_angle_matrix, make_transform_np
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.planning.pick import PickPlan
from tests.export.conftest import smooth_motion
from tests.export.test_moveit_grasp import placed


@pytest.fixture
def plan(fetch: Manipulator, grasps_by: Callable[..., GraspSet]) -> PickPlan:
    """The approach ends where the hand is at the grasp."""
    names, grasp = fetch.arm_names, grasps_by(fetch.hand, 1)
    approach = smooth_motion(names, 2)
    q_end = np.random.default_rng(1).uniform(np.maximum(fetch.lower, -2), np.minimum(fetch.upper, 2))
    approach = replace(approach, q=np.concatenate([approach.q[:-1], q_end[None]]))
    return PickPlan(
        grasp=grasp, index=17, X_BH=fetch.hand_pose(q_end), transfer=smooth_motion(names, 1), approach=approach,
        lift=smooth_motion(names, 3), q_pregrasp=grasp.q_pregrasp[0], q_grasp=grasp.q[0], q_squeeze=grasp.q_squeeze[0],
        clearance_m=0.01,
    )  # fmt: skip


def test_a_plan_survives_a_file(plan: PickPlan, fetch: Manipulator, tmp_path: Path) -> None:
    path = save_pick_plan(tmp_path / "plan.yaml", plan, fetch)
    read = load_pick_plan(path)
    assert (read.arm, read.hand, read.object, read.frame_id) == ("fetch", "fetch", "box", "base_link")
    assert [(s.name, s.group) for s in read.steps] == list(STEPS)
    steps = {s.name: s for s in read.steps}
    for name in ("transfer", "approach", "lift"):
        motion, written = steps[name].trajectory(fetch.arm_names), getattr(plan, name)
        np.testing.assert_array_equal(motion.q, written.q)
        np.testing.assert_array_equal(motion.qd, written.qd)
    (opened,) = steps["open_hand"].message["points"]
    closed, pressed = steps["close_hand"].message["points"]
    assert steps["close_hand"].message["joint_names"] == ["r_gripper_finger_joint", "l_gripper_finger_joint"]
    for point, q in ((opened, plan.q_pregrasp), (closed, plan.q_grasp), (pressed, plan.q_squeeze)):
        assert point["positions"] == [q[0], q[0]]
    with pytest.raises(DataFormatError, match="step open_hand"):
        steps["open_hand"].trajectory()
    assert save_pick_plan(tmp_path / "again.yaml", plan, fetch).read_bytes() == path.read_bytes()


def test_the_grasp_is_where_the_approach_ends(plan: PickPlan, fetch: Manipulator, tmp_path: Path) -> None:
    read = load_pick_plan(save_pick_plan(tmp_path / "plan.yaml", plan, fetch))
    (approach,) = (s for s in read.steps if s.name == "approach")
    q = fetch.full_q(approach.trajectory(fetch.arm_names).q[-1])[: fetch.arm.tree.num_dofs]
    X_BL = forward_numpy(fetch.arm.tree, q)[fetch.arm.tree.link_names.index(read.wrist_link)]
    for p in np.eye(3):
        np.testing.assert_allclose(placed(read.grasp["grasp_pose"]["pose"], p), (X_BL @ [*p, 1.0])[:3], atol=1e-9)
    assert read.grasp["id"] == "grasp_17"
    assert read.grasp["grasp_pose"]["header"]["frame_id"] == "base_link"


def test_ros_1_times_and_headers(plan: PickPlan, fetch: Manipulator) -> None:
    document = plan_document(plan, fetch, config=GraspMessageConfig(ros=1))
    check_message("moveit_msgs/Grasp", document["grasp"], ros=1)
    for step in document["plan"]:
        check_message(step["kind"], step["message"], ros=1)


def test_the_grasp_can_be_read_as_a_set(plan: PickPlan, fetch: Manipulator) -> None:
    document = plan_document(plan, fetch)
    X_BO = plan.X_BH @ np.linalg.inv(plan.grasp.X_OH[0])
    X_LH = np.eye(4)
    X_LH[0, 3] = 0.16645  # the vendor's fixed joint from wrist_roll_link to gripper_link
    wrist = Wrist(link=document["wrist_link"], X_LH=X_LH)
    back = grasps_of([document["grasp"]], fetch.hand, object_name="box", X_frame_O=X_BO, wrist=wrist)
    np.testing.assert_allclose(back.X_OH, plan.grasp.X_OH, atol=1e-6)


def test_one_close_target_within_the_limits(plan: PickPlan, fetch: Manipulator) -> None:
    stored = replace(plan.grasp, q_squeeze=plan.grasp.q_squeeze - 0.001)
    pressing = replace(plan, grasp=stored, q_squeeze=np.array([-0.0146]))
    document = plan_document(pressing, fetch, config=GraspMessageConfig(force=0.5))
    steps = {s["name"]: s["message"] for s in document["plan"]}
    press = steps["close_hand"]["points"][-1]
    assert press["positions"] == [0.0, 0.0] and press["effort"] == [0.5 * fetch.hand.tree.effort[0]] * 2
    for field, step in (("pre_grasp_posture", "open_hand"), ("grasp_posture", "close_hand")):
        assert document["grasp"][field]["points"] == steps[step]["points"]


def test_what_the_plan_was_made_from(plan: PickPlan, fetch: Manipulator, tmp_path: Path) -> None:
    X_BO = make_transform_np(axis_angle_matrix([0.0, 0.0, 1.0], np.pi / 2), [0.7, 0.1, 0.8])
    made = PlanOrigin(X_BO=X_BO, confidence=0.75, table_B=Plane(np.array([0.0, 0.0, 1.0]), -0.72), seed=7)
    path = save_pick_plan(tmp_path / "plan.yaml", plan, fetch, origin=made)
    data = yaml.safe_load(path.read_text())
    assert data["library"] == f"neuralgrasps {neuralgrasps.__version__}" and data["seed"] == 7
    assert data["object_pose"]["position"] == {"x": 0.7, "y": 0.1, "z": 0.8} and data["confidence"] == 0.75
    turn = data["object_pose"]["orientation"]
    np.testing.assert_allclose([turn[k] for k in "xyzw"], [0, 0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-12)
    assert data["table"] == {"normal": {"x": 0.0, "y": 0.0, "z": 1.0}, "height_m": 0.72}
    read = load_pick_plan(path)
    assert read.X_BO is not None
    np.testing.assert_allclose(read.X_BO, X_BO, atol=1e-12)
    unknown = load_pick_plan(save_pick_plan(tmp_path / "bare.yaml", plan, fetch))
    assert unknown.X_BO is None and yaml.safe_load((tmp_path / "bare.yaml").read_text())["confidence"] is None


def test_the_height_of_a_tilted_table_is_below_the_object() -> None:
    normal = np.array([np.sin(0.1), 0.0, np.cos(0.1)])
    table = Plane(normal, float(-normal @ [0.6, 0.2, 0.7]))
    X_BO = make_transform_np(np.eye(3), [0.6, 0.2, 0.9])
    assert PlanOrigin(X_BO=X_BO, table_B=table).fields()["table"]["height_m"] == pytest.approx(0.7)


@pytest.mark.parametrize("name", ("fetch", "panda"))
def test_the_opening_is_what_is_between_the_jaws(name: str, plan: PickPlan, fetch: Manipulator) -> None:
    robot = mount(load_arm("fetch"), load_hand(name))
    grasp = replace(plan.grasp, hand=name)
    pressing = replace(
        plan, grasp=grasp, q_pregrasp=np.array([0.03]), q_grasp=np.array([0.02]), q_squeeze=np.array([-0.01])
    )
    gripper = plan_document(pressing, robot)["gripper"]
    assert gripper["opening_m"] == {"open_hand": 0.06, "touch": 0.04, "close_hand": 0.0}
    assert gripper["max_effort"] == robot.hand.tree.effort[0]
    tree, pads = robot.hand.tree, []
    for q in (0.02, 0.0):  # what the model's links say: the jaws' distance changes by the opening
        X_HL = forward_numpy(tree, np.array([q]))
        moving = [f.links[-1] for f in robot.hand.fingers]
        pads.append(float(np.linalg.norm(X_HL[moving[0], :3, 3] - X_HL[moving[1], :3, 3])))
    assert abs(pads[0] - pads[1]) == pytest.approx(0.04)


def test_a_hand_with_fingers_has_no_opening() -> None:
    assert gripper_opening(load_hand("allegro"), np.zeros(16)) is None


def test_motions_of_other_joints_are_refused(plan: PickPlan, fetch: Manipulator) -> None:
    wrong = replace(plan, lift=smooth_motion(fetch.arm_names[:-1]))
    with pytest.raises(InputError, match="the lift moves"):
        plan_document(wrong, fetch)


@pytest.mark.parametrize(
    ("damage", "said"),
    (
        (lambda d: d.update(version=2), "version 1"),
        (lambda d: d.pop("grasp"), "lacks grasp"),
        (lambda d: d.update(ros="2"), "ros is '2'"),
        (lambda d: d["plan"].reverse(), "expected \\['open_hand', 'transfer'"),
        (lambda d: d.update(plan=3), "plan has the steps"),
        (lambda d: d["plan"][1].update(group="hand"), "step transfer is"),
        (lambda d: d["plan"][2]["message"].pop("points"), "step approach lacks points"),
        (lambda d: d["plan"][2].pop("message"), "step approach is empty"),
    ),
)
def test_damaged_files(
    damage: Callable[[dict[str, Any]], Any], said: str, plan: PickPlan, fetch: Manipulator, tmp_path: Path
) -> None:
    data = plan_document(plan, fetch)
    damage(data)
    path = tmp_path / "plan.yaml"
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(DataFormatError, match=said):
        load_pick_plan(path)
