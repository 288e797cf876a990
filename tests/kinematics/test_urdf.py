"""URDF files that can be read, some after mending."""

from __future__ import annotations

import xml.etree.ElementTree as Tree

import mujoco
import numpy as np
import pytest

from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.kinematics.tree import FIXED, PRISMATIC, REVOLUTE
from neuralgrasps.kinematics.urdf import load_urdf

HANDS = {
    "allegro": "hands/allegro_hand/allegro_hand_right.urdf",
    "barrett": "hands/barrett_hand/bhand_model.urdf",
    "panda": "hands/panda_gripper/panda_gripper_glb.urdf",
    "fetch": "robots/fetch/fetch.urdf",
}


def robot(*joints: str, links: str = "abcd") -> str:
    """A chain a - b - c - d; `joints` are the inner texts, or whole elements when they start with <joint."""
    body = "".join(f'<link name="{n}"/>' for n in links)
    for k, text in enumerate(joints):
        parent, child = links[k], links[k + 1]
        body += (
            f'<joint name="j{k}" {text.replace("PC", f"""<parent link="{parent}"/><child link="{child}"/>""")}</joint>'
        )
    return f'<robot name="r">{body}</robot>'


def hinge(inner: str = "", limit: str = 'lower="-1" upper="1" effort="2"', axis: str = "0 0 1") -> str:
    return f'type="revolute">PC<axis xyz="{axis}"/><limit {limit}/>{inner}'


SHORT = {"links": "ab"}


def test_everything_plain_is_read(write):
    text = """<robot name="claw">
      <material name="red"><color rgba="1 0 0 1"/></material>
      <link name="tip"/>
      <link name="palm">
        <inertial><origin xyz="0.1 0 0"/><mass value="0.5"/></inertial>
        <collision><origin xyz="0 0 0.1" rpy="0 0 1.5707963267948966"/>
          <geometry><box size="0.2 0.4 0.6"/></geometry></collision>
        <visual><geometry><sphere radius="0.3"/></geometry><material name="red"/></visual>
      </link>
      <link name="rod"><collision><geometry><cylinder radius="0.01" length="0.2"/></geometry></collision></link>
      <joint name="slide" type="prismatic"><origin xyz="0 1 0"/><parent link="palm"/><child link="rod"/>
        <axis xyz="0 -1 0"/><limit lower="0" upper="0.05" effort="60"/></joint>
      <joint name="weld" type="fixed"><parent link="rod"/><child link="tip"/></joint>
    </robot>"""
    robot = load_urdf(write("claw.urdf", text))
    tree = robot.tree
    assert (robot.name, tree.link_names, tree.dof_names) == ("claw", ("palm", "rod", "tip"), ("slide",))
    assert tree.joint_types.tolist() == [FIXED, PRISMATIC, FIXED] and tree.parents.tolist() == [-1, 0, 1]
    assert (tree.lower[0], tree.upper[0], tree.effort[0]) == (0.0, 0.05, 60.0)
    assert robot.repairs == ()
    np.testing.assert_allclose(forward_numpy(tree, np.array([0.05]))[2, :3, 3], [0, 0.95, 0])
    (box,), (ball,), (rod,) = robot.collision_of(0), robot.visual_of(0), robot.collision_of(1)
    np.testing.assert_allclose(box.size, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(box.X_LG @ [1, 0, 0, 1], [0, 1, 0.1, 1], atol=1e-15)
    assert ball.size[0] == 0.3 and ball.colour == (1.0, 0.0, 0.0, 1.0)
    assert rod.kind == "cylinder" and rod.size.tolist() == [0.01, 0.1, 0.0]
    assert robot.inertials[0].mass == 0.5 and robot.inertials[0].com_L.tolist() == [0.1, 0, 0]
    assert robot.inertials[1] is None


@pytest.mark.parametrize("name", HANDS)
def test_real_robots_match_mujoco(assets, name):
    """Kinematics against MuJoCo's own URDF reader, on random postures."""
    path = assets / HANDS[name]
    ours = load_urdf(path, missing_meshes="skip").tree
    root = Tree.parse(path).getroot()
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision"), *link.findall("inertial")]:
            link.remove(shape)
    options = Tree.fromstring('<mujoco><compiler fusestatic="false" boundmass="1" boundinertia="1"/></mujoco>')
    root.append(options)
    model = mujoco.MjModel.from_xml_string(Tree.tostring(root, encoding="unicode"))
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    compared = 0
    for _ in range(5):
        q = rng.uniform(ours.lower, ours.upper)
        for joint, value in zip(ours.joint_names, ours.joint_positions(q), strict=True):
            j = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint)
            if j >= 0:
                data.qpos[model.jnt_qposadr[j]] = value
        mujoco.mj_kinematics(model, data)
        for i, X_HL in enumerate(forward_numpy(ours, q)):
            b = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, ours.link_names[i])
            if b >= 0:
                compared += 1
                np.testing.assert_allclose(X_HL[:3, 3], data.xpos[b], atol=1e-9)
                np.testing.assert_allclose(X_HL[:3, :3], data.xmat[b].reshape(3, 3), atol=1e-9)
    assert compared >= 5 * (ours.num_links - 1)


def test_real_hands_are_complete(assets):
    allegro = load_urdf(assets / HANDS["allegro"])
    assert allegro.tree.num_dofs == 16 and allegro.tree.dof_names[:2] == ("joint_0.0", "joint_1.0")
    assert allegro.tree.lower[12] == 0.263 and not allegro.repairs
    panda = load_urdf(assets / HANDS["panda"])
    assert panda.tree.dof_names == ("panda_finger_joint1",) and panda.tree.coupling.sum() == 2
    barrett = load_urdf(assets / HANDS["barrett"], with_visuals=False)
    assert barrett.tree.num_dofs == 8 and not any(g.is_visual for g in barrett.geometries)
    assert any("effort is missing" in r and "finger_1_prox_joint" in r for r in barrett.repairs)
    for hand in (allegro, panda, barrett):
        assert all(g.mesh.extents.max() < 0.3 for g in hand.geometries if g.mesh is not None)
        assert hand.collision_of(0)


def test_fetch_as_found_in_the_wild(assets):
    fetch = load_urdf(assets / HANDS["fetch"], missing_meshes="skip")
    text = " ".join(fetch.repairs)
    assert "continuous joints" in text and "upperarm_roll_joint" in text
    assert "visual meshes are missing" in text and "estop_link" in text
    gripper = fetch.tree.link_names.index("gripper_link")
    # 0.4 m: the palm mesh lies in its link's frame in metres, found through package://
    assert 0.05 < fetch.collision_of(gripper)[0].mesh.extents.max() < 0.4


# -- mending -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "limits", "said"),
    [
        (hinge(limit='lower="1" upper="-0.5" effort="1"'), (-0.5, 1.0), "reversed"),
        (hinge(limit='effort="1"'), (-np.pi, np.pi), "no lower and upper limit"),
        (hinge(limit='lower="-inf" upper="inf" effort="1"'), (-np.pi, np.pi), "no lower and upper limit"),
        (hinge(limit='lower="-90" upper="90" effort="1"'), (-np.pi / 2, np.pi / 2), "read as degrees"),
        (hinge(limit='lower="-1e16" upper="1e16" effort="1"'), (-np.pi, np.pi), "mean no limit"),
        (hinge(limit='upper="1.5" effort="1"'), (0.0, 1.5), "only one of its two limits"),
        ('type="continuous">PC<axis xyz="0 0 1"/><limit effort="1"/>', (-np.pi, np.pi), "continuous joints"),
        ('type="prismatic">PC<axis xyz="0 0 1"/><limit lower="0" upper="-0.3" effort="1"/>', (-0.3, 0.0), "reversed"),
        ('type="prismatic">PC<axis xyz="0 0 1"/><limit lower="0" upper="50" effort="1"/>', (0, 50), "another unit"),
    ],
)
def test_limits_are_mended_and_said(write, text, limits, said):
    read = load_urdf(write("r.urdf", robot(text, **SHORT)))
    np.testing.assert_allclose([read.tree.lower[0], read.tree.upper[0]], limits)
    assert len(read.repairs) == 1 and said in read.repairs[0] and "j0" in read.repairs[0]


def test_equal_limits_fix_the_joint_there(write):
    read = load_urdf(write("r.urdf", robot(hinge(limit='lower="0.5" upper="0.5"'), **SHORT)))
    assert read.tree.num_dofs == 0 and "treated as fixed" in read.repairs[0]
    np.testing.assert_allclose(forward_numpy(read.tree, np.zeros(0))[1, :2, 0], [np.cos(0.5), np.sin(0.5)])


@pytest.mark.parametrize("effort", ["0", "-3", "inf"])
def test_a_useless_effort_gets_a_default(write, effort):
    read = load_urdf(write("r.urdf", robot(hinge(limit=f'lower="0" upper="1" effort="{effort}"'), **SHORT)))
    what = "negative" if effort.startswith("-") else "missing, 0 or not finite"
    assert read.tree.effort[0] == 1.0 and f"effort is {what} for j0" in read.repairs[0]


def test_effort_may_come_from_a_follower(write):
    leader = hinge(limit='lower="-1" upper="1" effort="0"')
    follower = hinge('<mimic joint="j0" multiplier="-3"/>', limit='lower="-3" upper="3" effort="2"')
    read = load_urdf(write("r.urdf", robot(leader, follower, links="abc")))
    assert read.tree.effort.tolist() == [6.0] and not read.repairs  # power: 2 N m at three times the speed


def test_a_long_axis_is_normalised_and_said(write):
    read = load_urdf(write("r.urdf", robot(hinge(axis="0 0 -2"), **SHORT)))
    np.testing.assert_allclose(read.tree.axes[1], [0, 0, -1])
    assert "length 2" in read.repairs[0] and "coupling" in read.repairs[0]


def test_a_missing_axis_is_x(write):
    read = load_urdf(write("r.urdf", robot('type="revolute">PC<limit lower="0" upper="1" effort="1"/>', **SHORT)))
    assert read.tree.axes[1].tolist() == [1, 0, 0] and "no axis" in read.repairs[0]


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_floating_joints_become_fixed(write, kind):
    read = load_urdf(write("r.urdf", robot(f'type="{kind}">PC', **SHORT)))
    assert read.tree.joint_types.tolist() == [FIXED, FIXED] and kind in read.repairs[0]


def test_an_unjoined_empty_link_is_dropped(write):
    text = robot(hinge(), **SHORT).replace("</robot>", '<link name="lonely"/></robot>')
    read = load_urdf(write("r.urdf", text))
    assert read.tree.link_names == ("a", "b") and "'lonely'" in read.repairs[0]


def test_absurd_masses_are_ignored(write):
    text = robot(hinge(), **SHORT).replace(
        '<link name="a"/>', '<link name="a"><inertial><mass value="0"/></inertial></link>'
    )
    read = load_urdf(write("r.urdf", text))
    assert read.inertials[0] is None and "mass 0 kg" in read.repairs[0]


def test_mimic_chains_are_followed(write):
    second = hinge('<mimic joint="j0" multiplier="0.5" offset="0.1"/>', limit='lower="-3" upper="3"')
    third = hinge('<mimic joint="j1" multiplier="-2"/>', limit='lower="-3" upper="3"')
    tree = load_urdf(write("r.urdf", robot(hinge(), second, third))).tree
    assert tree.dof_names == ("j0",) and tree.joint_types.tolist() == [FIXED, REVOLUTE, REVOLUTE, REVOLUTE]
    np.testing.assert_allclose(tree.joint_positions(np.array([0.4])), [0, 0.4, 0.3, -0.6])


def test_a_follower_narrows_its_leader(write):
    follower = hinge('<mimic joint="j0" multiplier="-2"/>', limit='lower="-1" upper="1"')
    read = load_urdf(write("r.urdf", robot(hinge(), follower, links="abc")))
    np.testing.assert_allclose([read.tree.lower[0], read.tree.upper[0]], [-0.5, 0.5])
    assert "narrowed to -0.5..0.5" in read.repairs[0]


def test_limits_of_a_follower_that_never_fit_are_ignored(write):
    follower = hinge('<mimic joint="j0"/>', limit='lower="5" upper="6"')
    read = load_urdf(write("r.urdf", robot(hinge(), follower, links="abc")))
    assert (read.tree.lower[0], read.tree.upper[0]) == (-1, 1) and "hardly meet" in read.repairs[0]


def test_mimicking_a_fixed_joint_is_a_constant(write):
    follower = hinge('<mimic joint="j0" offset="0.3"/>')
    tree = load_urdf(write("r.urdf", robot('type="fixed">PC', follower, links="abc"))).tree
    assert tree.num_dofs == 0
    np.testing.assert_allclose(tree.joint_positions(np.zeros(0)), [0, 0, 0.3])


def test_order_of_elements_does_not_matter(write):
    text = robot(hinge(), hinge(), hinge())
    root = Tree.fromstring(text)
    root[:] = reversed(list(root))
    a, b = (
        load_urdf(write("a.urdf", text)).tree,
        load_urdf(write("b.urdf", Tree.tostring(root, encoding="unicode"))).tree,
    )
    assert a.link_names == b.link_names and a.dof_names == b.dof_names


def test_drives_tell_limits_as_written_speeds_and_endless_turns(write):
    text = robot(
        hinge(limit='lower="1" upper="-1" effort="2" velocity="0.7"'),
        'type="continuous">PC<axis xyz="0 0 1"/>',
        'type="fixed">PC',
    )
    drives = load_urdf(write("r.urdf", text)).drives
    assert set(drives) == {"j0", "j1"}
    assert (drives["j0"].lower, drives["j0"].upper, drives["j0"].velocity) == (1.0, -1.0, 0.7)
    assert drives["j1"].continuous and drives["j1"].velocity is None and not drives["j0"].continuous
