"""The real hands and objects of the zoos."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.zoo import hand_names, load_hand
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.zoo import load_object
from neuralgrasps.sim.build import OBJECT_JOINT, grasp_model, joint_name
from neuralgrasps.sim.protocols import get_protocol
from neuralgrasps.sim.validate import validate_grasps

DEX = get_protocol("dexgraspbench")
JAWS = ("fetch", "panda")


@pytest.fixture(scope="module")
def carton() -> ObjectModel:
    return load_object("gelatin_box")


def _grasp_set(hand: Hand, obj: ObjectModel, X_OH: np.ndarray, q: np.ndarray, before: float, after: float) -> GraspSet:
    """Grasps with pre-grasp and squeeze reached by opening and closing for some time at unit speed."""
    count = len(X_OH)
    lower, upper = hand.tree.lower, hand.tree.upper
    return GraspSet(
        hand=hand.name,
        object=obj.name,
        X_OH=X_OH,
        q=q,
        q_pregrasp=np.clip(q - before * hand.closing_rate, lower, upper),
        q_squeeze=q + after * hand.closing_rate,
        contact_points_O=np.zeros((count, 0, 3)),
        contact_normals_O=np.zeros((count, 0, 3)),
        contact_links=np.zeros((count, 0), np.int32),
        epsilon=np.zeros(count),
        penetration_m=np.zeros(count),
    )


def antipodal_grasps(hand: Hand, obj: ObjectModel, offsets: np.ndarray) -> GraspSet:
    """Jaw grasps across the thinnest side, `offsets` (N,) metres along the middle axis from the middle of an end."""
    low, high = obj.mesh.vertices.min(axis=0), obj.mesh.vertices.max(axis=0)
    thin, middle, long = np.argsort(high - low)
    R_OP = np.zeros((3, 3))
    R_OP[thin, 0] = 1.0
    R_OP[long, 2] = -1.0  # the palm looks down the long axis
    R_OP[:, 1] = np.cross(R_OP[:, 2], R_OP[:, 0])
    pad_P = (np.linalg.inv(hand.X_HP) @ [*hand.jaw_pad_H, 1.0])[:3]
    X_OH = np.zeros((len(offsets), 4, 4))
    for i, offset in enumerate(offsets):
        pad_O = (low + high) / 2
        pad_O[long] = high[long] - 0.012
        pad_O[middle] += offset
        X_OP = np.eye(4)
        X_OP[:3, :3], X_OP[:3, 3] = R_OP, pad_O - R_OP @ pad_P
        X_OH[i] = X_OP @ np.linalg.inv(hand.X_HP)
    half = (high[thin] - low[thin]) / 2
    q = np.full((len(offsets), hand.num_dofs), half)  # both jaws of the zoo open by q on each side
    return _grasp_set(hand, obj, X_OH, q, before=0.005, after=0.01)


def power_grasps(hand: Hand, can: ObjectModel, shifts: np.ndarray) -> GraspSet:
    """A can lying across the fingers 3 mm off the palm, `shifts` (N,) metres along the palm's x; the hand wraps it."""
    X_OH = np.zeros((len(shifts), 4, 4))
    for i, shift in enumerate(shifts):
        X_PO = np.eye(4)
        X_PO[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]  # the can's axis along the palm's y
        X_PO[:3, 3] = [shift, 0.0, 0.033 + 0.003]
        X_OH[i] = np.linalg.inv(hand.X_HP @ X_PO)
    closing = hand.closing_rate / np.abs(hand.closing_rate).max()
    q = np.tile(np.clip(hand.q_open + 1.2 * closing, hand.tree.lower, hand.tree.upper), (len(shifts), 1))
    grasps = _grasp_set(hand, can, X_OH, q, before=0.0, after=0.4 / np.abs(hand.closing_rate).max())
    return replace(grasps, q_pregrasp=np.tile(hand.q_open, (len(shifts), 1)))


def _link_poses(data: mujoco.MjData, hand: Hand) -> np.ndarray:
    X_HL = np.tile(np.eye(4), (hand.tree.num_links, 1, 1))
    for link in range(hand.tree.num_links):
        X_HL[link, :3, :3] = data.body(f"link_{link}").xmat.reshape(3, 3)
        X_HL[link, :3, 3] = data.body(f"link_{link}").xpos
    return X_HL


def _place(model: mujoco.MjModel, hand: Hand, q: np.ndarray) -> mujoco.MjData:
    """The hand at `q`, the object 3 m away."""
    data = mujoco.MjData(model)
    data.joint(OBJECT_JOINT).qpos[2] = 3.0
    for link, position in enumerate(hand.tree.joint_positions(q)):
        if hand.tree.joint_types[link]:
            data.joint(joint_name(link)).qpos[0] = position
    mujoco.mj_forward(model, data)
    return data


@pytest.mark.parametrize("name", hand_names())
def test_links_stand_where_forward_kinematics_says(name: str, carton: ObjectModel) -> None:
    hand = load_hand(name)
    model = grasp_model(hand, carton, DEX)
    rng = np.random.default_rng(0)
    for q in rng.uniform(hand.tree.lower, hand.tree.upper, (5, hand.num_dofs)):
        data = _place(model, hand, q)
        np.testing.assert_allclose(_link_poses(data, hand), forward_numpy(hand.tree, q), atol=1e-9)


@pytest.mark.parametrize("name", hand_names())
def test_hand_reaches_its_targets_in_the_air_and_coupled_joints_follow(name: str, carton: ObjectModel) -> None:
    hand = load_hand(name)
    model = grasp_model(hand, carton, DEX)
    data = _place(model, hand, hand.q_open)
    target = (hand.tree.lower + hand.tree.upper) / 2
    data.ctrl[:] = target
    mujoco.mj_step(model, data, nstep=250)
    np.testing.assert_allclose(_link_poses(data, hand), forward_numpy(hand.tree, target), atol=2e-3)


@pytest.mark.parametrize("name", JAWS)
def test_jaws_hold_a_carton_across_its_thin_side_and_not_beside_it(name: str, carton: ObjectModel) -> None:
    hand = load_hand(name)
    grasps = antipodal_grasps(hand, carton, np.array([0.0, 0.01, -0.015, 0.08]))
    verdict = validate_grasps(hand, carton, grasps)
    assert verdict.success.tolist() == [True, True, True, False]
    assert verdict.displacement_m[:3].max() < 0.003
    slippery = replace(DEX, friction=0.0, torsional_friction=0.0)
    assert not validate_grasps(hand, carton, grasps, slippery).success.any()


def test_wrapped_can_holds_and_the_verdict_survives_half_the_timestep() -> None:
    hand, can = load_hand("barrett"), load_object("tomato_soup_can")
    grasps = power_grasps(hand, can, np.array([0.0, 0.2]))
    for protocol in (DEX, replace(DEX, timestep_s=0.002, check_every=20)):
        assert validate_grasps(hand, can, grasps, protocol).success.tolist() == [True, False]


def test_harder_protocols_hold_no_more_and_batches_do_not_matter() -> None:
    hand, can = load_hand("allegro"), load_object("tomato_soup_can")
    grasps = power_grasps(hand, can, np.linspace(-0.06, 0.0, 13))
    normal = validate_grasps(hand, can, grasps)
    hard = validate_grasps(hand, can, grasps, "dexgraspbench-hard")
    assert 0 < normal.success.sum() < len(grasps)
    assert hard.success.sum() < normal.success.sum()
    halves = [validate_grasps(hand, can, part) for part in (grasps[:5], grasps[5:])]
    for field in ("success", "displacement_m", "rotation_rad"):
        parts = np.concatenate([getattr(half, field) for half in halves])
        np.testing.assert_array_equal(getattr(normal, field), parts)


def test_scanned_object_of_many_parts_builds(carton: ObjectModel) -> None:
    """Hulls with thousands of vertices, many parts, and parts too thin to have a volume compile alike."""
    low, high = carton.mesh.vertices.min(axis=0), carton.mesh.vertices.max(axis=0)
    flat = np.array([[low[0], low[1], 0.0], [high[0], low[1], 0.0], [high[0], high[1], 0.0], [low[0], high[1], 1e-7]])
    many = replace(carton, convex_parts=(*(carton.convex_parts[0] * s for s in np.linspace(0.5, 1, 12)), flat))
    model = grasp_model(load_hand("panda"), many, DEX)
    assert model.body("object").geomnum[0] == 13
    assert model.body("object").mass[0] == 0.1
