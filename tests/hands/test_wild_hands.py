"""Hands that nobody has seen: read without notes, and found to be what they are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from neuralgrasps.errors import RobotDescriptionError
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import pack_hand
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.kinematics.forward_kernels import forward_numpy

from .wild_hands import WILD_HANDS, Wild, jaw_on_arm
from .wild_urdf import new_robot


@pytest.fixture(params=list(WILD_HANDS))
def wild(request: pytest.FixtureRequest, tmp_path: Path) -> Wild:
    write: Callable[[Path], Wild] = WILD_HANDS[request.param]
    return write(tmp_path)


def test_everything_derived_is_right(wild):
    hand = load_hand(wild.path)
    said = hand.extra["repairs"] + "\n" + hand.extra["annotated"]
    assert hand.X_HP[:3, 2] @ wild.normal > np.cos(np.radians(15)), hand.X_HP[:3, 2]
    assert len(hand.fingers) == wild.fingers and hand.is_jaw == wild.is_jaw
    signs = dict(zip(hand.tree.dof_names, np.sign(hand.closing_rate).astype(int), strict=True))
    assert signs == wild.closing
    thumbs = [hand.tree.link_names[f.links[0]] for f in hand.fingers if f.is_thumb]
    assert thumbs == ([wild.thumb] if wild.thumb else [])
    for words in wild.said:
        assert words in said
    assert "looks wrong" not in said
    for name, effort in wild.efforts.items():
        assert hand.tree.effort[hand.tree.dof_names.index(name)] == pytest.approx(effort)
    _check_preshapes(hand)
    if wild.fingers > 1:
        _check_closing_brings_tips_together(hand)


def _check_preshapes(hand: Hand) -> None:
    tree = hand.tree
    for q in (hand.q_open, hand.preshape_lower, hand.preshape_upper):
        assert np.all(q >= tree.lower - 1e-9) and np.all(q <= tree.upper + 1e-9)
    sideways = (hand.closing_rate == 0) & (hand.preshape_upper - hand.preshape_lower > 1.6)
    assert not sideways.any()
    room = np.where(hand.closing_rate > 0, tree.upper - hand.preshape_upper, hand.preshape_lower - tree.lower)
    assert np.all(room[hand.closing_rate != 0] > 0.3 * (tree.upper - tree.lower)[hand.closing_rate != 0])


def _check_closing_brings_tips_together(hand: Hand) -> None:
    """And on the palm's side, with pairs of links of different fingers among those checked for collision."""
    links = [f.links[-1] for f in hand.fingers]
    part = {p.link: p for p in hand.parts}
    ends = [max((i for i in f.links if i in part), default=k) for f, k in zip(hand.fingers, links, strict=True)]
    end = np.where(
        hand.closing_rate > 0, hand.tree.upper, np.where(hand.closing_rate < 0, hand.tree.lower, hand.q_open)
    )
    gaps, heights = [], []
    for share in np.linspace(0, 0.9, 10):
        X = forward_numpy(hand.tree, hand.q_open + share * (end - hand.q_open))
        tips = np.array([X[i] @ part[i].X_LP @ [*part[i].vertices.mean(axis=0), 1] if len(part[i].vertices) else
                         X[i] @ part[i].X_LP[:, 3] for i in ends])[:, :3]  # fmt: skip
        gaps.append(np.linalg.norm(tips[:, None] - tips, axis=2).sum())
        heights.append(((tips - hand.X_HP[:3, 3]) @ hand.X_HP[:3, 2]).mean())
    assert max(heights) > 0.01
    assert min(gaps) < 0.9 * gaps[0]
    pairs = {tuple(sorted(p)) for p in pack_hand(hand, spacing=0.01).self_pairs.tolist()}
    first, second = sorted((ends[0], ends[-1]))
    assert (first, second) in pairs


def test_a_limb_can_be_named(tmp_path):
    wild = jaw_on_arm(tmp_path)
    named = load_hand(wild.path, link="tool")
    assert named.name == "jaw_on_arm" and named.tree.link_names[0] == "tool" and named.is_jaw
    assert "outwards were read, of 11" in named.extra["repairs"] and "gone" not in named.extra["repairs"]
    assert load_hand(wild.path).name == "jaw_on_arm_gripper_body"
    with pytest.raises(RobotDescriptionError, match=r"link 'tol' is not known. Did you mean 'tool'\?"):
        load_hand(wild.path, link="tol")


def test_of_several_hands_one_must_be_chosen(tmp_path):
    robot = new_robot(tmp_path, "two_arms")
    robot.link("torso", robot.box((0.3, 0.4, 0.6)))
    for side in ("left", "right"):
        robot.link(f"{side}_arm", robot.box((0.05, 0.05, 0.6), (0, 0, 0.3)))
        robot.joint(f"{side}_shoulder", "torso", f"{side}_arm", (0, 0.3 if side == "left" else -0.3, 0.2))
        robot.link(f"{side}_palm", robot.box((0.05, 0.1, 0.04)))
        robot.joint(f"{side}_wrist", f"{side}_arm", f"{side}_palm", (0, 0, 0.62))
        for sign in (1, -1):
            robot.chain(f"{side}_palm", f"{side}_{sign}", (0, 0.04 * sign, 0.02), (0, 0, 0), (0.05,), axis=(sign, 0, 0))
    path = robot.write()
    with pytest.raises(RobotDescriptionError, match=r"has 2 hands, on the links 'left_palm', 'right_palm'; choose one"):
        load_hand(path)
    assert len(load_hand(path, link="right_palm").fingers) == 2


def test_the_gripper_of_a_whole_robot_is_found(assets, all_hands):
    hand = load_hand(assets / "robots/fetch/fetch.urdf")
    ours = all_hands["fetch"]
    assert hand.name == "fetch_gripper_link" and hand.is_jaw and hand.tree.effort == pytest.approx([60.0])
    assert (hand.tree.lower, hand.tree.upper) == (pytest.approx([0.0]), pytest.approx([0.05]))
    assert hand.X_HP[:3, 2] == pytest.approx(ours.X_HP[:3, 2], abs=1e-6)
    assert "link 'gripper_link' and what hangs on it was taken" in hand.extra["repairs"]
    assert hand.jaw_pad_H == pytest.approx(ours.jaw_pad_H, abs=0.02)


def test_upright_opposing_fingers_open_wider_than_straight(tmp_path):
    """Straight up, the tips of this hand are 50 mm apart: too little for a can of 66 mm."""
    hand = load_hand(WILD_HANDS["three_adaptive"](tmp_path).path)
    X = forward_numpy(hand.tree, hand.q_open)
    tips = np.array([X[f.links[-1], :3, 3] for f in hand.fingers])
    thumb = next(i for i, f in enumerate(hand.fingers) if f.is_thumb)
    across = (tips[thumb] - np.delete(tips, thumb, axis=0)) @ hand.X_HP[:3, 0]
    assert np.abs(across).min() > 0.1
    assert hand.preshape_lower[hand.closing_rate > 0].max() < -0.2
