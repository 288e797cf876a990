"""URDF files that cannot be read: each gives one clear RobotDescriptionError."""

from __future__ import annotations

import pytest

from neuralgrasps.errors import RobotDescriptionError
from neuralgrasps.kinematics.urdf import load_urdf

LINKS = '<link name="a"/><link name="b"/>'
ENDS = '<parent link="a"/><child link="b"/>'
LIMIT = '<limit lower="0" upper="1" effort="1"/>'


def joint(inner: str = ENDS + LIMIT, kind: str = 'type="revolute"', name: str = 'name="j"') -> str:
    return f"<joint {name} {kind}>{inner}</joint>"


def shape(text: str) -> str:
    return f'<link name="a"><collision><geometry>{text}</geometry></collision></link>'


LAUGHS = '<!DOCTYPE x [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;">]><robot name="&b;"><link name="a"/></robot>'
OUTSIDE = '<!DOCTYPE x [<!ENTITY f SYSTEM "file:///etc/hostname">]><robot><link name="&f;"/></robot>'
DTD = '<!DOCTYPE robot SYSTEM "http://127.0.0.1/robot.dtd"><robot><link name="a"/></robot>'

WHOLE_FILES = {
    "empty": ("", "not well-formed XML"),
    "not xml": ("solid ascii", "not well-formed XML"),
    "cut off": ('<robot name="r"><link name="a"', "not well-formed XML"),
    "unknown encoding": ('<?xml version="1.0" encoding="klingon"?><robot/>', "not well-formed XML"),
    "entity bomb": (LAUGHS, "refused for safety"),
    "outside entity": (OUTSIDE, "refused for safety"),
    "outside DTD": (DTD, "refused for safety"),
    "an MJCF": ("<mujoco><worldbody/></mujoco>", "read it with load_mjcf"),
    "an SDF": ("<sdf/>", "convert it to URDF"),
    "other XML": ("<html/>", "starts with <robot>"),
}

ROBOTS = {
    "no links": ("", "has no links"),
    "link without name": ("<link/>", "a link has no 'name'"),
    "same link twice": ('<link name="a"/><link name="a"/>', "link name 'a' is used more than once"),
    "same joint twice": (
        LINKS + '<link name="c"/>' + joint() + joint('<parent link="a"/><child link="c"/>' + LIMIT),
        "joint name 'j' is used more than once",
    ),
    "two roots": (
        shape('<sphere radius="1"/>')
        + '<link name="b"/><link name="c"/>'
        + joint('<parent link="b"/><child link="c"/>' + LIMIT),
        "has 2 root links",
    ),
    "no joints": (LINKS, "has 2 root links ('a', 'b')"),
    "cycle": (
        LINKS + joint() + joint('<parent link="b"/><child link="a"/>' + LIMIT, name='name="k"'),
        "form a cycle",
    ),
    "cycle beside a root": (
        LINKS + '<link name="base"/>' + joint() + joint('<parent link="b"/><child link="a"/>' + LIMIT, name='name="k"'),
        "form a cycle",
    ),
    "its own parent": (LINKS + joint('<parent link="b"/><child link="b"/>' + LIMIT), "form a cycle"),
    "two parents": (LINKS + joint() + joint(name='name="k"'), "child of several joints ('j', 'k')"),
    "unknown parent": (
        LINKS + '<link name="palm"/>' + joint('<parent link="plam"/><child link="b"/>' + LIMIT),
        "parent link 'plam', which is not defined. Did you mean 'palm'?",
    ),
    "unknown child": (
        LINKS + joint('<parent link="a"/><child link="z"/>' + LIMIT),
        "child link 'z', which is not defined",
    ),
    "no parent": (LINKS + joint('<child link="b"/>' + LIMIT), "joint 'j' has no <parent>"),
    "no child": (LINKS + joint('<parent link="a"/>' + LIMIT), "joint 'j' has no <child>"),
    "empty parent": (LINKS + joint('<parent/><child link="b"/>' + LIMIT), "has no 'link'"),
    "joint without name": (LINKS + joint(name=""), "a joint has no 'name'"),
    "joint without type": (LINKS + joint(kind=""), "joint 'j' has no 'type'"),
    "unknown type": (LINKS + joint(kind='type="ball"'), "type 'ball'; expected one of fixed, revolute"),
    "prismatic without limits": (LINKS + joint(ENDS, kind='type="prismatic"'), "state its travel in metres"),
    "zero axis": (LINKS + joint(ENDS + LIMIT + '<axis xyz="0 0 0"/>'), "axis 0 0 0"),
    "NaN axis": (LINKS + joint(ENDS + LIMIT + '<axis xyz="nan 0 1"/>'), "xyz is 'nan 0 1'; expected 3 finite"),
    "NaN limit": (LINKS + joint(ENDS + '<limit lower="nan" upper="1"/>'), "lower is 'nan'"),
    "NaN origin": (LINKS + joint(ENDS + LIMIT + '<origin xyz="0 0 nan"/>'), "origin of joint 'j': xyz"),
    "infinite origin": (LINKS + joint(ENDS + LIMIT + '<origin rpy="0 0 inf"/>'), "rpy is '0 0 inf'"),
    "two numbers": (
        LINKS + joint(ENDS + LIMIT + '<origin xyz="0 0"/>'),
        "expected 3 finite numbers separated by spaces",
    ),
    "commas": (LINKS + joint(ENDS + LIMIT + '<origin xyz="0,0,1"/>'), "separated by spaces"),
    "a word": (LINKS + joint(ENDS + '<limit lower="low" upper="1"/>'), "lower is 'low'; expected one finite number"),
    "mimic of nobody": (LINKS + joint(ENDS + LIMIT + '<mimic joint="jj"/>'), "mimics 'jj', which is not defined"),
    "mimic of itself": (LINKS + joint(ENDS + LIMIT + '<mimic joint="j"/>'), "in a circle (j -> j)"),
    "NaN multiplier": (LINKS + joint(ENDS + LIMIT + '<mimic joint="j" multiplier="nan"/>'), "multiplier is 'nan'"),
    "box without size": (shape("<box/>"), "has no 'size'"),
    "negative box": (shape('<box size="1 -1 1"/>'), "not positive"),
    "zero radius": (shape('<cylinder radius="0" length="1"/>'), "not positive"),
    "NaN radius": (shape('<sphere radius="nan"/>'), "radius is 'nan'"),
    "unknown shape": (shape('<cone radius="1"/>'), "expected box, sphere, cylinder, capsule or mesh"),
    "mesh without file": (shape("<mesh/>"), "has no 'filename'"),
    "zero scale": (shape('<mesh filename="x.stl" scale="0 1 1"/>'), "expected non-zero factors"),
    "missing mesh": (shape('<mesh filename="package://p/x.stl"/>'), "'package://p/x.stl' was not found"),
    "xacro tag": ('<xacro:include xmlns:xacro="http://www.ros.org/wiki/xacro" filename="x"/>', "expand it first"),
    "xacro value": ('<link name="${prefix}a"/>', "expand it first"),
    "NaN mass": ('<link name="a"><inertial><mass value="nan"/></inertial></link>', "mass of link 'a': value is 'nan'"),
}


@pytest.mark.parametrize("case", WHOLE_FILES)
def test_unreadable_files_are_refused(write, case):
    text, said = WHOLE_FILES[case]
    with pytest.raises(RobotDescriptionError) as error:
        load_urdf(write("bad.urdf", text))
    assert said in str(error.value) and "bad.urdf" in str(error.value)


@pytest.mark.parametrize("case", ROBOTS)
def test_impossible_robots_are_refused(write, case):
    inner, said = ROBOTS[case]
    with pytest.raises(RobotDescriptionError) as error:
        load_urdf(write("bad.urdf", f'<robot name="r">{inner}</robot>'))
    assert said in str(error.value) and "bad.urdf" in str(error.value)


def test_mimic_circles_are_refused(write):
    text = "".join(f'<link name="{n}"/>' for n in "abc")
    text += f'<joint name="j" type="revolute">{ENDS}{LIMIT}<mimic joint="k"/></joint>'
    text += f'<joint name="k" type="revolute"><parent link="b"/><child link="c"/>{LIMIT}<mimic joint="j"/></joint>'
    with pytest.raises(RobotDescriptionError, match=r"circle \(j -> k -> j\)"):
        load_urdf(write("bad.urdf", f"<robot>{text}</robot>"))


def test_a_missing_file_and_a_folder_are_named(tmp_path):
    with pytest.raises(RobotDescriptionError, match="does not exist"):
        load_urdf(tmp_path / "none.urdf")
    with pytest.raises(RobotDescriptionError, match="is a folder"):
        load_urdf(tmp_path)


def test_binary_rubbish_is_refused(tmp_path):
    path = tmp_path / "x.urdf"
    path.write_bytes(bytes(range(256)) * 8)
    with pytest.raises(RobotDescriptionError, match="not well-formed"):
        load_urdf(path)


def test_a_very_deep_chain_is_read(write):
    links = "".join(f'<link name="l{i}"/>' for i in range(3000))
    joints = "".join(
        f'<joint name="j{i}" type="fixed"><parent link="l{i}"/><child link="l{i + 1}"/></joint>' for i in range(2999)
    )
    assert load_urdf(write("deep.urdf", f"<robot>{links}{joints}</robot>")).tree.num_links == 3000
