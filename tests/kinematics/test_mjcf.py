"""MJCF files: kinematics against MuJoCo's own, couplings, efforts, shapes, refusals."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from neuralgrasps.errors import RobotDescriptionError
from neuralgrasps.geometry.mesh import mass_properties
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.kinematics.mjcf import load_mjcf

BALL = '<geom size="0.01"/>'
RADIANS = '<compiler angle="radian"/>'


def hand(inner: str, *, extra: str = "", joint: str = "") -> str:
    base = f'<body name="palm" pos="1 2 3">{joint}{BALL}{inner}</body>'
    return f'<mujoco model="claw">{RADIANS}<worldbody>{base}</worldbody>{extra}</mujoco>'


def finger(name: str, joints: str, inner: str = "", where: str = 'pos="0 0 0.1"') -> str:
    return f'<body name="{name}" {where}>{joints}{BALL}{inner}</body>'


def hinge(name: str, more: str = 'axis="0 1 0"') -> str:
    return f'<joint name="{name}" range="-1 1" limited="true" actuatorfrcrange="-2 2" {more}/>'


HARD = hand(
    finger(
        "a",
        hinge("a1", 'axis="0 1 1" pos="0.02 0 0.01"') + hinge("a2", 'axis="1 0 0" pos="0 0.03 0" ref="0.2"'),
        finger(
            "b",
            '<joint name="b1" type="slide" axis="1 0 2" range="0 0.1" ref="0.02" pos="0.1 0.1 0.1"/>',
            finger("c", "", finger("d", hinge("d1", 'axis="0 0 1" pos="-0.01 0 0"'))),
            where='pos="0.1 0 0" euler="0.3 0.1 -0.5"',
        ),
    )
    + finger("e", hinge("e1"), where='pos="0 0.1 0" quat="1 2 3 4"'),
    extra='<equality><joint joint1="d1" joint2="a2" polycoef="0.1 0.5 0 0 0"/></equality>',
)


def test_kinematics_match_mujoco(write):
    """Several joints per body, joint positions, references, slides, a coupling with an offset."""
    path = write("hard.xml", HARD)
    read = load_mjcf(path)
    tree = read.tree
    assert tree.link_names == ("palm", "a/a1", "a", "b", "c", "d", "e")
    assert tree.dof_names == ("a1", "a2", "b1", "e1")
    model = mujoco.MjModel.from_xml_path(str(path))
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    for _ in range(10):
        q = rng.uniform(tree.lower, tree.upper)
        for name, value in zip(tree.dof_names, q, strict=True):
            data.qpos[model.joint(name).qposadr[0]] = value
        data.qpos[model.joint("d1").qposadr[0]] = 0.1 + 0.5 * (q[1] - 0.2)
        mujoco.mj_kinematics(model, data)
        palm = data.body("palm")
        for name, X_HL in zip(tree.link_names, forward_numpy(tree, q), strict=True):
            if "/" in name:
                continue
            body = model.body(name)
            shift = model.jnt_pos[body.jntadr[0] + body.jntnum[0] - 1] if body.jntnum[0] else np.zeros(3)
            R_HL = palm.xmat.reshape(3, 3).T @ data.body(name).xmat.reshape(3, 3)
            origin = palm.xmat.reshape(3, 3).T @ (data.body(name).xpos - palm.xpos) + R_HL @ shift
            np.testing.assert_allclose(X_HL[:3, :3], R_HL, atol=1e-12)
            np.testing.assert_allclose(X_HL[:3, 3], origin, atol=1e-12)
        shapes = {g.link: g for g in read.geometries}
        for k in range(model.ngeom):  # every ball stays where MuJoCo puts it
            link = tree.link_names.index(model.body(model.geom_bodyid[k]).name)
            centre = (forward_numpy(tree, q)[link] @ shapes[link].X_LG)[:3, 3]
            expected = palm.xmat.reshape(3, 3).T @ (data.geom_xpos[k] - palm.xpos)
            np.testing.assert_allclose(centre, expected, atol=1e-12)


def test_limits_and_masses(write):
    read = load_mjcf(write("h.xml", HARD))
    np.testing.assert_allclose(read.tree.upper, [1, 1, 0.1, 1])
    mass = 1000 * 4 / 3 * np.pi * 0.01**3
    assert [i is None for i in read.inertials] == [name == "a/a1" for name in read.tree.link_names]
    assert read.inertials[0].mass == pytest.approx(mass)
    np.testing.assert_allclose(read.inertials[2].com_L, [0, -0.03, 0])  # the link lies at joint a2
    assert read.name == "claw"


def test_a_free_base_is_fixed_and_said(write):
    read = load_mjcf(write("h.xml", hand(finger("a", hinge("j")), joint="<freejoint/>")))
    assert read.tree.link_names == ("palm", "a") and "free joint of body 'palm'" in read.repairs[0]


def test_a_jointed_first_body_hangs_on_the_world(write):
    read = load_mjcf(write("h.xml", hand("", joint=hinge("turn"))))
    assert read.tree.link_names == ("world", "palm") and read.tree.dof_names == ("turn",)
    np.testing.assert_allclose(forward_numpy(read.tree, np.zeros(1))[1, :3, 3], [1, 2, 3])


def test_ball_joints_are_refused(write):
    with pytest.raises(RobotDescriptionError, match="'j' is a ball joint; replace it by three hinges"):
        load_mjcf(write("h.xml", hand(finger("a", '<joint name="j" type="ball"/>'))))


# -- couplings ---------------------------------------------------------------


def two_joints(equality: str) -> str:
    return hand(finger("a", hinge("j1"), finger("b", hinge("j2"))), extra=f"<equality>{equality}</equality>")


def test_a_constant_equality_fixes_the_joint(write):
    tree = load_mjcf(write("h.xml", two_joints('<joint joint1="j2" polycoef="0.4 0 0 0 0"/>'))).tree
    assert tree.dof_names == ("j1",)
    np.testing.assert_allclose(forward_numpy(tree, np.zeros(1))[2, :3, 0], [np.cos(0.4), 0, -np.sin(0.4)], atol=1e-15)


def test_a_constant_counts_from_the_reference(write):
    text = two_joints('<joint joint1="j2" polycoef="0.4 0 0 0 0"/>').replace('name="j2"', 'name="j2" ref="0.3"')
    tree = load_mjcf(write("h.xml", text)).tree  # j2 reads 0.7, which is 0.4 away from its zero posture
    np.testing.assert_allclose(forward_numpy(tree, np.zeros(1))[2, 0, 0], np.cos(0.4), atol=1e-15)


def test_a_curved_equality_becomes_a_line_and_says_how_far_off(write):
    read = load_mjcf(write("h.xml", two_joints('<joint joint1="j2" joint2="j1" polycoef="0 0.5 0.1 0 0"/>')))
    assert "curved" in read.repairs[0] and "off by up to" in read.repairs[0]
    assert read.tree.coupling[2, 0] == pytest.approx(0.5)


def test_inactive_and_other_equalities_are_said(write):
    text = '<joint joint1="j2" joint2="j1" active="false"/><connect body1="b" body2="palm" anchor="0 0 0"/>'
    read = load_mjcf(write("h.xml", two_joints(text)))
    assert read.tree.num_dofs == 2
    assert any("inactive" in r for r in read.repairs) and any("'connect'" in r for r in read.repairs)


def test_a_joint_set_twice_is_refused(write):
    text = '<joint joint1="j2" joint2="j1"/><joint joint1="j2" joint2="j1"/>'
    with pytest.raises(RobotDescriptionError, match="'j2' is set by two equalities"):
        load_mjcf(write("h.xml", two_joints(text)))


def test_joints_that_set_each_other_are_refused(write):
    text = '<joint joint1="j2" joint2="j1"/><joint joint1="j1" joint2="j2"/>'
    with pytest.raises(RobotDescriptionError, match="in a circle"):
        load_mjcf(write("h.xml", two_joints(text)))


# -- efforts -----------------------------------------------------------------


def efforts(write, actuators: str, joint: str = '<joint name="j" axis="0 1 0" range="-1 1"/>', tendon: str = ""):
    return load_mjcf(write("h.xml", hand(finger("a", joint), extra=f"{tendon}<actuator>{actuators}</actuator>")))


@pytest.mark.parametrize(
    ("actuators", "expected"),
    [
        ('<position joint="j" kp="9" forcerange="-3 2"/>', 3.0),
        ('<position joint="j" kp="9" forcerange="-3 3" gear="2"/>', 6.0),
        ('<motor joint="j" gear="5" ctrlrange="-1 1"/>', 5.0),
        ('<motor joint="j" forcerange="-1 1"/><motor joint="j" forcerange="-2 2"/>', 3.0),
        ('<position tendon="t" kp="9" forcerange="-4 4"/>', 2.0),
    ],
)
def test_effort_comes_from_the_actuators(write, actuators, expected):
    tendon = '<tendon><fixed name="t"><joint joint="j" coef="0.5"/></fixed></tendon>'
    read = efforts(write, actuators, tendon=tendon)
    assert read.tree.effort.tolist() == [expected] and not read.repairs


def test_the_joints_own_bound_counts_when_smaller(write):
    joint = '<joint name="j" axis="0 1 0" range="-1 1" actuatorfrcrange="-1.5 1.5"/>'
    assert efforts(write, '<motor joint="j" forcerange="-9 9"/>', joint).tree.effort[0] == 1.5
    assert efforts(write, '<motor joint="j"/>', joint).tree.effort[0] == 1.5


def test_an_unbounded_actuator_gives_the_default_and_says_so(write):
    read = efforts(write, '<position joint="j" kp="9"/>')
    assert read.tree.effort[0] == 1.0 and "effort is missing" in read.repairs[0]


# -- shapes ------------------------------------------------------------------


def test_shapes_are_read(write):
    shapes = (
        '<geom type="box" size="0.1 0.2 0.3" rgba="1 0 0 1"/><geom type="capsule" size="0.1 0.2"/>'
        '<geom type="cylinder" size="0.1 0.2" contype="0" conaffinity="0"/><geom type="ellipsoid" size="0.1 0.2 0.3"/>'
        '<geom type="mesh" mesh="m"/>'
    )
    points = "0 0 0  0.1 0 0  0 0.1 0  0 0 0.1"
    asset = f'<asset><mesh name="m" vertex="{points}" inertia="convex"/></asset>'
    text = hand("", extra=asset).replace(BALL, shapes)
    read = load_mjcf(write("h.xml", text))
    box, capsule, cylinder, ellipsoid, mesh = read.geometries
    assert box.kind == "box" and box.size.tolist() == [0.1, 0.2, 0.3] and box.colour == (1, 0, 0, 1)
    assert capsule.kind == "capsule" and capsule.size.tolist() == [0.1, 0.2, 0]
    assert cylinder.is_visual and not box.is_visual
    np.testing.assert_allclose(ellipsoid.mesh.extents, [0.2, 0.4, 0.6])
    corners = mesh.mesh.vertices @ mesh.X_LG[:3, :3].T + mesh.X_LG[:3, 3]
    np.testing.assert_allclose(sorted(corners.sum(axis=1)), [0, 0.1, 0.1, 0.1], atol=1e-7)
    assert mass_properties(mesh.mesh).volume == pytest.approx(1e-3 / 6, rel=1e-5)


# -- refusals ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('<!DOCTYPE x [<!ENTITY a "b">]><mujoco model="&a;"/>', "refused for safety"),
        ("<mujoco>", "not well-formed"),
        ("<robot/>", "read it with load_urdf"),
        ("<mujoco><worldbody/></mujoco>", "no bodies"),
        ("<mujoco><wordlbody/></mujoco>", "refused by MuJoCo"),
        ("<mujoco><worldbody><body><joint/></body></worldbody></mujoco>", "refused by MuJoCo"),
        ('<mujoco><include file="lost.xml"/></mujoco>', "does not exist"),
        (
            '<mujoco><worldbody><body pos="0 nan 0"><geom size="1"/></body></worldbody></mujoco>',
            "pos of <body> is '0 nan 0'",
        ),
        ('<mujoco><worldbody><body><geom size="1" pos="inf 0 0"/></body></worldbody></mujoco>', "not finite|refused"),
    ],
)
def test_bad_files_are_refused(write, tmp_path, monkeypatch, text, said):
    path = write("model/bad.xml", text)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RobotDescriptionError, match=said):
        load_mjcf(path)
    assert [p.name for p in tmp_path.iterdir()] == ["model"]  # no log file beside the user


def test_entities_in_an_included_file_are_refused(write):
    write("part.xml", '<!DOCTYPE x [<!ENTITY a "b">]><mujocoinclude/>')
    with pytest.raises(RobotDescriptionError, match=r"part\.xml.*refused for safety"):
        load_mjcf(write("h.xml", '<mujoco><include file="part.xml"/></mujoco>'))
