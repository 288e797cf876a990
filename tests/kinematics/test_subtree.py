"""A limb cut out of a robot, and joints tied by tendons: known answers."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.errors import RobotDescriptionError
from neuralgrasps.kinematics.mjcf import load_mjcf
from neuralgrasps.kinematics.subtree import without_links_beyond
from neuralgrasps.kinematics.urdf import load_urdf, outline_urdf

LINK = '<link name="{}"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>'


def _joint(name: str, parent: str, child: str, extra: str = "") -> str:
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/><origin xyz="0 0 0.2"/>'
        f'<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="3"/>{extra}</joint>'
    )


ROBOT = (
    '<robot name="r"><link name="base"><collision><geometry><mesh filename="lost.stl"/></geometry></collision></link>'
    + "".join(LINK.format(n) for n in ("arm", "hand", "a", "b", "leg"))
    + _joint("shoulder", "base", "arm")
    + _joint("wrist", "arm", "hand")
    + _joint("ja", "hand", "a", '<mimic joint="shoulder" multiplier="2"/>')
    + _joint("jb", "hand", "b", '<mimic joint="ja" multiplier="-1"/>')
    + '<joint name="hip" type="revolute"><parent link="base"/><child link="leg"/></joint></robot>'
)


def test_a_limb_stands_alone(write):
    path = write("r.urdf", ROBOT)
    limb = load_urdf(path, link="hand")
    assert limb.tree.link_names == ("hand", "a", "b") and limb.tree.dof_names == ("ja",)
    assert limb.tree.coupling[:, 0] == pytest.approx([0, 1, -1])
    assert limb.tree.X_parent_joint[0] == pytest.approx(np.eye(4))  # the limb's base is at the identity
    assert "joint 'ja' follows 'shoulder', which was cut off: it moves by itself now." in limb.repairs
    assert "only the 3 links from 'hand' outwards were read, of 6." in limb.repairs
    assert not any("hip" in r or "lost" in r for r in limb.repairs)  # remarks on the rest are taken back
    with pytest.raises(RobotDescriptionError, match=r"link 'hnad' is not known. Did you mean 'hand'\?"):
        load_urdf(path, link="hnad")


def test_an_outline_needs_no_meshes(write):
    outline = outline_urdf(write("r.urdf", ROBOT.replace('<link name="a">', '<link name="a"><x/>')))
    assert outline.has_shape.all() and outline.tree.num_links == 6


TIED = """<mujoco model="t"><compiler angle="radian"/><worldbody><body name="palm"><geom size="0.01"/>
 <body name="a" pos="0 0 0.1"><joint name="a" axis="0 1 0" range="-1 1" limited="true"/><geom size="0.01"/>
  <body name="b" pos="0 0 0.1"><joint name="b" axis="0 1 0" range="-2 2" limited="true" {ref}/><geom size="0.01"/>
   <body name="c" pos="0 0 0.1"><joint name="c" axis="0 1 0" range="-9 9" limited="true"/><geom size="0.01"/>
 </body></body></body></body></worldbody>
<tendon><fixed name="t1"><joint joint="a" coef="3"/><joint joint="b" coef="-2"/></fixed>
 <fixed name="t2"><joint joint="c" coef="4"/></fixed><fixed name="t3"><joint joint="a" coef="1"/></fixed></tendon>
<equality>{equality}</equality></mujoco>"""


@pytest.mark.parametrize(
    ("equality", "expected"),
    [
        ('<tendon tendon1="t1" polycoef="0.5 0 0 0 0"/>', ("b", 1.5, -0.25)),  # 3 a - 2 b = 0.5
        ('<tendon tendon1="t2" tendon2="t3" polycoef="0.2 2 0 0 0"/>', ("c", 0.5, 0.05)),  # 4 c = 0.2 + 2 a
        ('<tendon tendon1="t2" polycoef="0.8 0 0 0 0"/>', ("c", 0.0, 0.2)),  # 4 c = 0.8
    ],
)
def test_an_equality_of_fixed_tendons_is_a_line_between_joints(write, equality, expected):
    tree = load_mjcf(write("t.xml", TIED.format(equality=equality, ref=""))).tree
    link, slope, offset = expected
    i = tree.link_names.index(link)
    assert link not in tree.dof_names and tree.dof_names[0] == "a"
    if slope:
        assert (tree.coupling[i, 0], tree.offset[i]) == pytest.approx((slope, offset))
    else:  # held where it is: part of the rigid body, turned by 0.2
        assert tree.coupling[i].any() == 0


def test_tendons_over_three_joints_and_curves_are_left_out_and_said(write):
    curved = '<tendon tendon1="t2" tendon2="t3" polycoef="0 1 2 0 0"/>'
    read = load_mjcf(write("t.xml", TIED.format(equality=curved, ref="")))
    assert "tendon 't2' was ignored" in read.repairs[0] and read.tree.num_dofs == 3
    three = '<tendon tendon1="t1" tendon2="t2" polycoef="0 1 0 0 0"/>'
    read = load_mjcf(write("u.xml", TIED.format(equality=three, ref="")))
    assert "tendon 't1' was ignored" in read.repairs[0] and read.tree.num_dofs == 3


def test_a_tree_ends_at_a_link(write):
    tree = outline_urdf(write("r.urdf", ROBOT)).tree
    cut, kept = without_links_beyond(tree, tree.link_names.index("arm"))
    assert cut.link_names == ("base", "arm", "leg") and cut.dof_names == ("shoulder", "hip")
    assert [tree.link_names[i] for i in kept] == list(cut.link_names)
    assert cut.parents.tolist() == [-1, 0, 0]
    assert cut.coupling == pytest.approx(np.array([[0, 0], [1, 0], [0, 1]]))
    assert cut.X_parent_joint[1] == pytest.approx(tree.X_parent_joint[tree.link_names.index("arm")])
    whole, _ = without_links_beyond(tree, tree.link_names.index("leg"))
    assert whole.link_names == tree.link_names
