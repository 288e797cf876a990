"""The five built-in hands against published facts and the vendors' URDFs, and in MuJoCo."""

from __future__ import annotations

import subprocess
import sys

import mujoco
import numpy as np
import pytest
import torch

from neuralgrasps.hands.loader import hand_from_description
from neuralgrasps.hands.surface import hand_link_meshes, hand_mesh
from neuralgrasps.hands.zoo import hand_folder, hand_names, load_hand, load_robot
from neuralgrasps.kinematics.forward import forward_kinematics
from neuralgrasps.kinematics.forward_kernels import forward_fast, forward_numpy
from neuralgrasps.kinematics.urdf import load_urdf

DOFS = {"fetch": 1, "panda": 1, "barrett": 7, "allegro": 16, "human": 20}
EFFORT = {"fetch": 60.0, "panda": 70.0, "barrett": 1.5, "allegro": 0.7, "human": 1.5}


def test_every_hand_is_complete(hand):
    tree = hand.tree
    assert hand.num_dofs == DOFS[hand.name]
    assert hand.extra["repairs"] == "" and hand.extra["annotated"] == ""  # nothing mended, nothing guessed
    assert tree.effort.min() == pytest.approx(EFFORT[hand.name])
    for q in (hand.q_open, hand.preshape_lower, hand.preshape_upper):
        assert np.all(q >= tree.lower - 1e-9) and np.all(q <= tree.upper + 1e-4)
    assert np.all(hand.preshape_lower <= hand.preshape_upper)
    R = hand.X_HP[:3, :3]
    assert np.allclose(R.T @ R, np.eye(3)) and np.linalg.det(R) == pytest.approx(1)
    assert all(p.colour is not None for p in hand.parts)
    solid = {p.link for p in hand.parts}
    assert solid == set(range(tree.num_links))
    assert hand.licence == "MIT" and (hand_folder(hand.name) / "LICENSE").is_file()


def test_fingers_own_their_joints(hand):
    if hand.is_jaw:
        assert all(f.dofs == () for f in hand.fingers)  # one joint moves both
        return
    owned = [d for f in hand.fingers for d in f.dofs]
    shared = {"barrett": [0]}.get(hand.name, [])
    assert sorted(owned + shared) == list(range(hand.num_dofs))
    assert sum(f.is_thumb for f in hand.fingers) == 1


@pytest.mark.parametrize(("name", "limits"), [("fetch", (0, 0.05)), ("panda", (0, 0.04))])
def test_jaw_pads_meet_when_closed_and_open_to_twice_the_travel(all_hands, name, limits):
    hand = all_hands[name]
    assert (hand.tree.lower[0], hand.tree.upper[0]) == pytest.approx(limits)
    assert hand.is_jaw and hand.closing_rate[0] == -1
    right, left = (f.links[-1] for f in hand.fingers)
    axis = hand.X_HP[:3, 0]
    for q in (0.0, limits[1]):
        X_HL = forward_numpy(hand.tree, np.array([q]))
        inner = []
        for link, side in ((right, 1.0), (left, -1.0)):
            corners = [_vertices(p, X_HL) @ axis * side for p in hand.parts if p.link == link]
            inner.append(min(c.min() for c in corners))
        assert inner == pytest.approx([q, q], abs=1e-6)


def _vertices(part, X_HL):
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    X = X_HL[part.link] @ part.X_LP
    return (signs * part.size) @ X[:3, :3].T + X[:3, 3]


BOUNDS_MM = {  # published boxes of the base, in H: lower and upper corner (HANDS: palm boxes, housings)
    "fetch": ([-154, -63, -39.8], [-32, 63, 39.8]),
    "panda": ([-31.5, -102, -26], [31.5, 102, 66]),
    "barrett": ([-44.5, -65, 0], [44.5, 44.5, 90.4]),
    "allegro": ([-29.7, -56.5, -95], [11.1, 56.5, 2]),
}


@pytest.mark.parametrize("name", BOUNDS_MM)
def test_base_fills_its_published_box(all_hands, name):
    hand = all_hands[name]
    lower, upper = BOUNDS_MM[name]
    bounds = hand_link_meshes(hand)[0].bounds * 1000
    assert bounds[0] == pytest.approx(lower, abs=1.5) and bounds[1] == pytest.approx(upper, abs=1.5)


def test_human_hand_has_published_lengths(all_hands):
    hand = all_hands["human"]
    mesh = hand_mesh(hand, np.zeros(20))
    assert -mesh.bounds[0, 0] == pytest.approx(0.252, abs=1e-3)  # wrist to middle fingertip
    X = forward_numpy(hand.tree, np.zeros(20))
    index = hand.tree.link_names.index("index_proximal")
    assert X[index, :3, 3] == pytest.approx([-0.14006, 0.0112, 0.03642])
    lengths = [np.linalg.norm(X[i + 1, :3, 3] - X[i, :3, 3]) for i in (index, index + 1)]
    assert lengths == pytest.approx([0.04319, 0.02956])
    palm = hand.tree.lower, hand.tree.upper
    assert np.degrees(palm[0][[0, 1, 16, 17]]) == pytest.approx([-20, -10, -10, -50], abs=0.01)
    assert np.degrees(palm[1][[0, 1, 16, 19]]) == pytest.approx([20, 90, 70, 100], abs=0.01)


def _tips(tree, q, points):
    X = forward_numpy(tree, q)
    return np.stack([X[:, tree.link_names.index(n)] @ np.append(p, 1.0) for n, p in points], axis=1)[..., :3]


def _worst_mm(ours, theirs):
    return float(np.linalg.norm(ours - theirs, axis=-1).max() * 1000)


def test_allegro_matches_the_vendors_urdf(all_hands, assets, random_postures):
    hand = all_hands["allegro"]
    real = load_urdf(assets / "hands/allegro_hand/allegro_hand_right.urdf", with_visuals=False).tree
    assert real.dof_names == tuple(f"{n.replace('_', '_')}.0" for n in hand.tree.dof_names)
    assert np.allclose(real.lower, hand.tree.lower) and np.allclose(real.upper, hand.tree.upper)
    q = random_postures(hand, 200)
    offset = {3: 0.0387, 7: 0.0387, 11: 0.0387, 15: 0.0543}
    ours = _tips(hand.tree, q, [(f"link_{i}", (0, 0, z)) for i, z in offset.items()])
    theirs = _tips(real, q, [(f"link_{i}.0_tip", (0, 0, 0)) for i in offset])
    assert _worst_mm(ours, theirs) < 0.01


def test_barrett_matches_the_vendors_urdf(all_hands, assets, random_postures):
    """The vendor counts flexion of all fingers and the spread of finger 1 negative, and has no coupling."""
    hand = all_hands["barrett"]
    real = load_urdf(assets / "hands/barrett_hand/bhand_model.urdf", with_visuals=False).tree
    q = random_postures(hand, 200)
    spread, *flexion = q.T
    joints = {"finger_1_prox_joint": -spread, "finger_2_prox_joint": spread}
    for finger in (1, 2, 3):
        joints[f"finger_{finger}_med_joint"] = -flexion[2 * finger - 2]
        joints[f"finger_{finger}_dist_joint"] = -flexion[2 * finger - 1]
    theirs_q = np.stack([joints[n] for n in real.dof_names], axis=1)
    tip = (-0.0429, 0.0393, 0.0)
    ours = _tips(hand.tree, q, [(f"finger_{i}_distal", tip) for i in (1, 2, 3)])
    theirs = _tips(real, theirs_q, [(f"finger_{i}_dist_link", tip) for i in (1, 2, 3)])
    assert _worst_mm(ours, theirs) < 0.5  # finger 2's distal origin differs by 0.4 mm in the vendor's file


def test_panda_matches_the_vendors_urdf(all_hands, assets, random_postures):
    hand = all_hands["panda"]
    real = load_urdf(assets / "hands/panda_gripper/panda_gripper_glb.urdf", with_visuals=False).tree
    q = random_postures(hand, 50)
    fingers = [(n, (0, 0, 0.0537)) for n in ("panda_leftfinger", "panda_rightfinger")]
    assert _worst_mm(_tips(hand.tree, q, fingers), _tips(real, q, fingers)) < 1e-6


def test_fetch_fingers_match_the_vendors_urdf(all_hands, assets, random_postures):
    hand = all_hands["fetch"]
    real = load_urdf(assets / "robots/fetch/fetch.urdf", with_visuals=False, missing_meshes="skip").tree
    q = random_postures(hand, 20)
    full = np.zeros((20, real.num_dofs))
    for name in ("r_gripper_finger_joint", "l_gripper_finger_joint"):
        full[:, real.dof_names.index(name)] = q[:, 0]
    X = forward_numpy(real, full)
    base = X[:, real.link_names.index("gripper_link")]
    for link in ("r_gripper_finger_link", "l_gripper_finger_link"):
        theirs = np.linalg.inv(base) @ X[:, real.link_names.index(link)]
        ours = forward_numpy(hand.tree, q)[:, hand.tree.link_names.index(link)]
        assert np.abs(theirs - ours).max() < 1e-6


def test_kinematics_agree_in_torch_numba_numpy_and_mujoco(hand, random_postures):
    q = random_postures(hand, 20)
    reference = forward_numpy(hand.tree, q)
    assert np.allclose(forward_fast(hand.tree, q), reference, atol=1e-12)
    assert np.allclose(forward_kinematics(hand.tree, torch.tensor(q)).numpy(), reference, atol=1e-12)
    model = mujoco.MjModel.from_xml_path(str(hand_folder(hand.name) / "hand.xml"))
    data = mujoco.MjData(model)
    for row, X_HL in zip(hand.tree.joint_positions(q), reference, strict=True):
        for joint, value in zip(hand.tree.joint_names, row, strict=True):
            if joint:
                data.joint(joint).qpos[0] = value
        mujoco.mj_kinematics(model, data)
        for name, X in zip(hand.tree.link_names, X_HL, strict=True):
            assert np.allclose(data.body(name).xpos, X[:3, 3], atol=1e-9)
            assert np.allclose(data.body(name).xmat.reshape(3, 3), X[:3, :3], atol=1e-9)


def test_steps_in_mujoco_and_reaches_its_closing_targets(hand):
    model = mujoco.MjModel.from_xml_path(str(hand_folder(hand.name) / "hand.xml"))
    model.opt.gravity[:] = 0
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    assert np.allclose(data.ctrl, hand.q_open)
    target = np.clip(hand.q_open + 0.5 * hand.closing_rate, hand.tree.lower, hand.tree.upper)
    data.ctrl[:] = target
    mujoco.mj_step(model, data, nstep=500)
    assert sum(w.number for w in data.warning) == 0
    reached = np.array([data.joint(n).qpos[0] for n in hand.tree.joint_names if n])
    moving = np.array([bool(n) for n in hand.tree.joint_names])
    scale = 1e-3 if hand.is_jaw else 0.1  # metres, rad
    assert np.allclose(reached, hand.tree.joint_positions(target)[moving], atol=scale)


def _tip_points(hand, q):
    model = mujoco.MjModel.from_xml_path(str(hand_folder(hand.name) / "hand.xml"))
    data = mujoco.MjData(model)
    for joint, value in zip(hand.tree.joint_names, hand.tree.joint_positions(q), strict=True):
        if joint:
            data.joint(joint).qpos[0] = value
    mujoco.mj_kinematics(model, data)
    return data.site_xpos.copy()


def test_fingers_come_together_when_closing(hand):
    """Tip sites approach each other (thumb and fingers of a dexterous hand to a pinch) on the palm's side."""
    start = 0.5 * (hand.preshape_lower + hand.preshape_upper)
    if hand.name == "barrett":
        start[0] = 0.0
    reach = 0.05 if hand.is_jaw else 1.0
    gaps = []
    for t in np.linspace(0, 1, 11):
        tips = _tip_points(hand, np.clip(start + t * reach * hand.closing_rate, hand.tree.lower, hand.tree.upper))
        height = (tips - hand.X_HP[:3, 3]) @ hand.X_HP[:3, 2]
        if t <= 0.6:
            assert np.all(height > 0.005), "a tip went behind the palm"
        thumb = next((i for i, f in enumerate(hand.fingers) if f.is_thumb), 1)
        others = np.delete(tips, thumb, axis=0)
        gaps.append(np.linalg.norm(others - tips[thumb], axis=1).min())
    assert min(gaps) < 0.35 * gaps[0]
    assert min(gaps) < 0.03  # a pinch: less than a fingertip apart


@pytest.mark.parametrize("guessed", [False, True])
@pytest.mark.parametrize("name", ["allegro", "human"])
def test_most_preshapes_let_the_thumb_meet_a_finger(all_hands, name, guessed):
    hand = all_hands[name]
    if guessed:
        hand = hand_from_description(load_robot(hand_folder(name) / "hand.xml"))
    rng = np.random.default_rng(3)
    met = 0
    for _ in range(40):
        u = np.empty(hand.num_dofs)
        for group in hand.preshape_groups:
            u[list(group)] = rng.random()
        start = hand.preshape_lower + u * (hand.preshape_upper - hand.preshape_lower)
        gaps = []
        for t in np.linspace(0, 1.2, 9):
            tips = _tip_points(hand, np.clip(start + t * hand.closing_rate, hand.tree.lower, hand.tree.upper))
            gaps.append(np.linalg.norm(tips[:-1] - tips[-1], axis=1).min())
        met += min(gaps) < 0.035
    assert met >= 28, met


def test_names_and_unknown_name():
    assert hand_names() == ("fetch", "panda", "barrett", "allegro", "human")
    with pytest.raises(KeyError, match=r"hand 'alegro' is not known. Did you mean 'allegro'\?.*barrett"):
        load_hand("alegro")


def test_loading_and_packing_does_not_import_torch():
    code = (
        "import sys; from neuralgrasps.hands.zoo import load_hand; from neuralgrasps.hands.packed import pack_hand;"
        "pack_hand(load_hand('panda'), spacing=0.01); sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
