"""A whole pick as one document."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from neuralgrasps.arms.manipulator import Manipulator
from neuralgrasps.errors import DataFormatError, InputError
from neuralgrasps.export.frames import Wrist
from neuralgrasps.export.messages import check_message
from neuralgrasps.export.moveit_grasp import GraspMessageConfig, grasps_of
from neuralgrasps.export.pick_plan import STEPS, load_pick_plan, plan_document, save_pick_plan
from neuralgrasps.grasps.grasp_set import GraspSet
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
