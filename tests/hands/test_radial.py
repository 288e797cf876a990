"""Hands of equal fingers around an axis, made up at random: opened, closed and faced alike whatever the file says."""

from __future__ import annotations

import numpy as np
import pytest

from neuralgrasps.grasps.penetration import self_penetration
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import pack_hand
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.kinematics.forward_kernels import forward_numpy

LIMITS = {"limits": (-0.6, 1.2), "none": None, "wide": (-3.1, 3.1), "one way": (0.0, 1.4)}


def _rpy(R: np.ndarray) -> str:
    pitch = -np.arcsin(np.clip(R[2, 0], -1, 1))
    return f"{np.arctan2(R[2, 1], R[2, 2])} {pitch} {np.arctan2(R[1, 0], R[0, 0])}"


def _box(size: str, centre: np.ndarray, rotation: str = "0 0 0") -> str:
    origin = " ".join(map(str, centre))
    return f'<collision><origin xyz="{origin}" rpy="{rotation}"/><geometry><box size="{size}"/></geometry></collision>'


def radial_urdf(
    *,
    count: int,
    joints: int = 2,
    limits: tuple[float, float] | None = (-0.6, 1.2),
    mimic: str = "none",
    seed: int = 0,
    base_z: float = -0.02,
    flat: bool = False,
) -> tuple[str, np.ndarray]:
    """Equal straight fingers on a base, the palm turned at random in the base frame; joints count either way.

    The fingers stand up or, if `flat`, lie around the base. `mimic`: "outer" joints follow the inner one of their
    finger; "all" joints follow the first.
    Returns the file's text and the true palm axis in the base frame.
    """
    rng = np.random.default_rng(seed)
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    Q *= np.sign(np.linalg.det(Q))  # X_HP's rotation
    radius = 0.045 if count < 5 else 0.055
    base = _box("0.08 0.08 0.04", Q @ [0, 0, base_z], _rpy(Q))
    text = f'<robot name="star"><link name="base">{base}</link>'
    signs = rng.choice([-1, 1], size=(count, joints))
    for f in range(count):
        c, s = np.cos(2 * np.pi * f / count + 0.3), np.sin(2 * np.pi * f / count + 0.3)
        R = Q @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        for k in range(joints):
            length = (0.06, 0.05, 0.03)[k]
            along = np.array([1, 0, 0]) if flat else np.array([0, 0, 1])
            xyz = R @ [radius, 0, 0] if k == 0 else along * (0.06, 0.05)[k - 1]
            size = np.where(along, length, (0.014, 0.016, 0.014))
            solid = _box(" ".join(map(str, size)), along * length / 2)
            rpy = _rpy(R) if k == 0 else "0 0 0"
            low, high = (0, 0) if limits is None else sorted(float(signs[f, k]) * v for v in limits)
            limit = "" if limits is None else f'<limit lower="{low}" upper="{high}" effort="5" velocity="1"/>'
            leader, gear = (f, 0), float(signs[f, k] * signs[f, 0])
            if mimic == "all":
                leader, gear = (0, 0), float(signs[f, k] * signs[0, 0])
            follows = (mimic == "outer" and k > 0) or (mimic == "all" and (f, k) != (0, 0))
            follow = f'<mimic joint="j{leader[0]}{leader[1]}" multiplier="{gear}"/>' if follows else ""
            text += (
                f'<link name="l{f}{k}">{solid}</link>'
                f'<joint name="j{f}{k}" type="revolute"><parent link="{"base" if k == 0 else f"l{f}{k - 1}"}"/>'
                f'<child link="l{f}{k}"/><origin xyz="{" ".join(map(str, xyz))}" rpy="{rpy}"/>'
                f'<axis xyz="0 {-signs[f, k]} 0"/>{limit}{follow}</joint>'
            )
    return text + "</robot>", Q[:, 2]


def _tips(hand: Hand, q: np.ndarray) -> np.ndarray:
    """(F, 3) middles of the last links' far ends in H."""
    X = forward_numpy(hand.tree, q)
    ends = []
    for finger in hand.fingers:
        part = next(p for p in hand.parts if p.link == finger.links[-1])
        ends.append(X[part.link] @ np.append(part.X_LP[:3, 3] * 2, 1))
    return np.array(ends)[:, :3]


def _check(hand: Hand, axis: np.ndarray) -> None:
    assert "looks wrong" not in hand.extra["annotated"], hand.extra["annotated"]
    assert hand.X_HP[:3, 2] @ axis > np.cos(np.radians(10))
    assert len(hand.preshape_groups[0]) == hand.num_dofs and not any(f.is_thumb for f in hand.fingers)
    packed = pack_hand(hand, spacing=0.004)
    widest, narrow = hand.q_open, np.where(hand.closing_rate > 0, hand.preshape_upper, hand.preshape_lower)
    reach = []
    for q in (widest, narrow):
        assert self_penetration(packed, forward_numpy(hand.tree, q)) < 0.003
        tips = _tips(hand, q)
        off_axis = np.linalg.norm(tips - np.outer(tips @ axis, axis), axis=1)
        assert np.ptp(off_axis) < 1e-4 and np.ptp(tips @ axis) < 1e-4  # all fingers alike
        reach.append(off_axis.mean())
    assert reach[1] < reach[0] - 0.005  # closes inwards
    straight = _tips(hand, np.zeros(hand.num_dofs))
    assert reach[0] >= np.linalg.norm(straight - np.outer(straight @ axis, axis), axis=1).mean() - 1e-4


@pytest.mark.parametrize("count", [2, 3, 4, 5])
@pytest.mark.parametrize("limits", list(LIMITS))
def test_equal_fingers_around_an_axis_are_treated_alike(write_robot, count, limits):
    for seed in range(2):
        joints = 2 + seed % 2
        text, axis = radial_urdf(count=count, joints=joints, limits=LIMITS[limits], seed=seed + 10 * count)
        _check(load_hand(write_robot(text, f"star{seed}.urdf")), axis)


@pytest.mark.parametrize("count", [2, 3, 4])
@pytest.mark.parametrize("mimic", ["outer", "all"])
@pytest.mark.parametrize("limits", ["limits", "none"])
def test_joints_that_follow_others(write_robot, count, mimic, limits):
    text, axis = radial_urdf(count=count, mimic=mimic, limits=LIMITS[limits], seed=count)
    hand = load_hand(write_robot(text))
    assert hand.num_dofs == (1 if mimic == "all" else count)
    _check(hand, axis)


def test_a_hand_that_lies_flat_bends_to_where_its_joints_go(write_robot):
    """Fingers laid out in the palm's plane: only the ranges tell the side; without ranges this is said."""
    text, axis = radial_urdf(count=3, limits=(-0.1, 1.5), base_z=0.0, flat=True, seed=4)
    hand = load_hand(write_robot(text))
    assert hand.X_HP[:3, 2] @ axis > 0.99 and "looks wrong" not in hand.extra["annotated"]
    free = load_hand(write_robot(text.replace("<limit ", "<unlimited "), "free.urdf"))
    assert "nothing in the file tells on which side" in free.extra["annotated"]
    assert "override it with hand.toml" in free.extra["annotated"]


def test_a_palm_that_is_given_decides_the_side(write_robot):
    text, axis = radial_urdf(count=3, limits=None, seed=1)
    path = write_robot(text)
    across = np.cross(axis, [1.0, 0.0, 0.0])
    path.with_suffix(".toml").write_text(
        f"[palm]\nposition = [0, 0, 0]\nx_axis = {across.tolist()}\nz_axis = {(-axis).tolist()}\n"
    )
    inward = load_hand(write_robot(text, "plain.urdf"))
    hand = load_hand(path)
    assert hand.X_HP[:3, 2] == pytest.approx(-axis)
    assert np.array_equal(np.sign(hand.closing_rate), -np.sign(inward.closing_rate))


def test_joints_that_open_when_said_to_close_are_reported(write_robot):
    text, _ = radial_urdf(count=3, seed=2)
    right = load_hand(write_robot(text, "right.urdf"))
    path = write_robot(text, "wrong.urdf")
    wrong = "".join(
        f"[joints.{n}]\nclose = {-r}\n" for n, r in zip(right.tree.dof_names, right.closing_rate, strict=True)
    )
    path.with_suffix(".toml").write_text(wrong)
    said = load_hand(path).extra["annotated"]
    assert "looks wrong" in said and "fingertips closer" in said


@pytest.mark.parametrize("limits", ["limits", "none"])
def test_one_longer_finger_does_not_change_how_the_hand_closes(write_robot, limits):
    text, axis = radial_urdf(count=3, limits=LIMITS[limits], seed=1)
    plain = load_hand(write_robot(text, "plain.urdf"))
    longer = _box("0.014 0.016 0.06", np.array([0, 0, 0.06]))
    hand = load_hand(write_robot(text.replace('<link name="l01">', f'<link name="l01">{longer}')))
    assert hand.X_HP[:3, 2] @ axis > np.cos(np.radians(10))
    assert np.array_equal(np.sign(hand.closing_rate), np.sign(plain.closing_rate))
    assert np.ptp(np.abs(hand.q_open[[0, 2, 4]])) < 1e-9 and "looks wrong" not in hand.extra["annotated"]
