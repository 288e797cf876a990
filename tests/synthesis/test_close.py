"""Closing hands: known widths, centred, never through the object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.geometry.mesh import signed_distance
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.grasps.quality import link_distances
from neuralgrasps.hands.hand import ConvexPart, Finger, Hand, PartKind
from neuralgrasps.hands.packed import pack_hand
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.kinematics.forward_kernels import forward_fast, forward_numpy
from neuralgrasps.kinematics.tree import FIXED, PRISMATIC, REVOLUTE, KinematicTree
from neuralgrasps.synthesis.candidates import make_problem
from neuralgrasps.synthesis.close import CONTACT_M, close_fingers, close_jaw, make_closing
from neuralgrasps.synthesis.clusters import cluster_points, hand_clearance, least_distance, link_distance
from neuralgrasps.synthesis.propose import propose_approach, propose_jaw


def _surface_in_object(problem, X_OH, q) -> np.ndarray:
    packed = problem.packed
    X_OL = X_OH @ forward_numpy(problem.hand.tree, q)
    X = X_OL[packed.point_link]
    return np.einsum("kij,kj->ki", X[:, :3, :3], packed.point_L) + X[:, :3, 3]


def _close(problem, X_OH, q):
    X, joints, X_HL = X_OH.copy(), np.array(q, float), np.zeros((problem.hand.tree.num_links, 4, 4))
    close = close_jaw if problem.hand.is_jaw else close_fingers
    done = close(*problem.sdf_arrays, problem.packed, problem.clusters, problem.closing, X, joints, X_HL)
    return bool(done), X, joints, X_HL


# -- clusters ------------------------------------------------------------------


def test_clusters_hold_every_point_once_within_their_ball(hands):
    plain = pack_hand(hands["allegro"], spacing=0.005)
    packed, clusters = cluster_points(plain, size=10)
    assert clusters.start[-1] == len(plain.point_L) and (np.diff(clusters.start) > 0).all()
    np.testing.assert_array_equal(clusters.start[clusters.of_link], plain.link_point_start)
    for c in range(len(clusters.radius)):
        own = packed.point_L[clusters.start[c] : clusters.start[c + 1]]
        assert np.linalg.norm(own - own[0], axis=1).max() == pytest.approx(clusters.radius[c])
    for link in range(len(plain.link_radius)):
        part = slice(plain.link_point_start[link], plain.link_point_start[link + 1])
        assert set(map(tuple, plain.point_L[part])) == set(map(tuple, packed.point_L[part]))


def test_the_distance_by_clusters_is_that_of_the_nearest_point(problem_of):
    problem = problem_of("human", "box")
    rng = np.random.default_rng(0)
    X_HL = np.eye(4)[None].repeat(problem.hand.tree.num_links, 0)
    for _ in range(200):
        X = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        X = np.column_stack([X, rng.uniform(-0.08, 0.08, 3)])
        link = int(rng.choice(np.unique(problem.packed.point_link)))
        part = slice(problem.packed.link_point_start[link], problem.packed.link_point_start[link + 1])
        points = problem.packed.point_L[part] @ X[:, :3].T + X[:, 3]
        slow = min(least_distance(*problem.sdf_arrays, *p) for p in points)
        fast = link_distance(*problem.sdf_arrays, problem.packed, problem.clusters, X, link, 1.0)
        assert fast == pytest.approx(slow, abs=1e-4)  # the grid's slope may exceed 1 by a little
        assert link_distance(*problem.sdf_arrays, problem.packed, problem.clusters, X, link, slow - 0.01) == slow - 0.01
    assert X_HL.shape[0] == problem.hand.tree.num_links


def test_distances_outside_the_grid_never_exceed_the_true_ones(problem_of):
    problem = problem_of("panda", "box")
    points = np.random.default_rng(0).uniform(-0.4, 0.4, (400, 3))
    true = signed_distance(problem.obj.mesh, points)
    bound = np.array([least_distance(*problem.sdf_arrays, *p) for p in points])
    assert (bound <= true + 1e-4).all()
    assert (bound >= 0.7 * true - 1e-4).all()
    assert (query_grid_numpy(problem.obj.sdf, points) > true + 0.01).any()  # why the bound is needed


def test_hand_clearance_is_the_least_over_all_points(problem_of):
    problem = problem_of("allegro", "can")
    rng = np.random.default_rng(1)
    proposals = propose_approach(problem, count=20, rng=rng)
    X_HL = forward_fast(problem.hand.tree, proposals.q)
    for i in range(len(proposals.q)):
        points_O = _surface_in_object(problem, proposals.X_OH[i], proposals.q[i])
        slow = min(least_distance(*problem.sdf_arrays, *p) for p in points_O)
        fast = hand_clearance(*problem.sdf_arrays, problem.packed, problem.clusters, proposals.X_OH[i], X_HL[i])
        assert fast == pytest.approx(slow, abs=1e-4)


# -- jaws ----------------------------------------------------------------------


@pytest.mark.parametrize("name", ["panda", "fetch"])
@pytest.mark.parametrize(("solid", "width"), [("box", 0.04), ("ball", 0.06)])
def test_a_jaw_closes_to_the_width_of_the_object(hands, problem_of, jaw_on_axes, name, solid, width):
    problem, hand = problem_of(name, solid), hands[name]
    done, X, q, _ = _close(problem, jaw_on_axes(hand), hand.q_open)
    assert done
    gap = np.ptp(forward_numpy(hand.tree, np.stack([hand.tree.lower, q]))[..., :3, 3] @ problem.closing.axis_H, axis=1)
    opening = float(gap[1] - gap[0])
    assert opening == pytest.approx(width, abs=2 * CONTACT_M + 3e-4)
    np.testing.assert_allclose(X, jaw_on_axes(hand), atol=3e-4)


@pytest.mark.parametrize("name", ["panda", "fetch"])
@pytest.mark.parametrize("offset", [-0.008, 0.004, 0.008])
def test_a_jaw_that_stands_aside_is_centred(hands, problem_of, jaw_on_axes, name, offset):
    problem, hand = problem_of(name, "box"), hands[name]
    done, X, q, X_HL = _close(problem, jaw_on_axes(hand, (offset, 0.0, 0.0)), hand.q_open)
    assert done
    np.testing.assert_allclose(X, jaw_on_axes(hand), atol=4e-4)
    for side in (-1, 1):
        links = np.flatnonzero(problem.closing.side == side)
        nearest = min(
            link_distance(*problem.sdf_arrays, problem.packed, problem.clusters, (X @ X_HL[i])[:3], i, 1.0)
            for i in links
            if problem.clusters.of_link[i] < problem.clusters.of_link[i + 1]
        )
        assert 0.0 <= nearest <= CONTACT_M
    assert q[0] < hand.q_open[0]


def test_a_jaw_on_nothing_or_inside_the_object_does_not_close(hands, problem_of, jaw_on_axes):
    hand = hands["panda"]
    assert not _close(problem_of("panda", "box"), jaw_on_axes(hand, (0.0, 0.5, 0.0)), hand.q_open)[0]
    assert not _close(problem_of("panda", "cube"), jaw_on_axes(hand), hand.q_open)[0]


def _slide_jaw(*, rising: bool, joints: int) -> Hand:
    """Pads whose inner faces stand at x = +-(40 mm - q) or +-q: closing raises or lowers the joint(s)."""
    X = np.tile(np.eye(4), (3, 1, 1))
    X[1:, 2, 3] = 0.1
    X[1:, 0, 3] = [0.04, -0.04] if rising else [0.0, 0.0]
    sign = -1.0 if rising else 1.0
    coupling = np.zeros((3, joints))
    coupling[1, 0] = coupling[2, joints - 1] = 1.0
    tree = KinematicTree(
        link_names=("base", "right", "left"),
        parents=np.array([-1, 0, 0], np.int32),
        joint_names=("", "a", "b"),
        joint_types=np.array([FIXED, PRISMATIC, PRISMATIC], np.int8),
        X_parent_joint=X,
        axes=np.array([[0.0, 0, 0], [sign, 0, 0], [-sign, 0, 0]]),
        coupling=coupling,
        offset=np.zeros(3),
        dof_names=tuple(f"q{i}" for i in range(joints)),
        lower=np.zeros(joints),
        upper=np.full(joints, 0.04),
        effort=np.full(joints, 20.0),
    )
    parts = [ConvexPart(link=0, kind=PartKind.BOX, size=np.array([0.06, 0.02, 0.02]), X_LP=np.eye(4))]
    for link, side in ((1, 1.0), (2, -1.0)):
        X_LP = np.eye(4)
        X_LP[0, 3] = side * 0.005
        parts.append(ConvexPart(link=link, kind=PartKind.BOX, size=np.array([0.005, 0.01, 0.012]), X_LP=X_LP))
    opened = np.full(joints, 0.0 if rising else 0.04)
    return Hand(
        name="slide_jaw", tree=tree, parts=tuple(parts),
        fingers=(Finger(name="a", links=(1,), dofs=(0,)), Finger(name="b", links=(2,), dofs=(joints - 1,))),
        X_HP=np.eye(4), closing_rate=np.full(joints, 1.0 if rising else -1.0), q_open=opened, preshape_lower=opened,
        preshape_upper=opened, preshape_groups=(tuple(range(joints)),), is_jaw=True, jaw_pad_H=np.array([0.0, 0, 0.1]),
        licence="", provenance="",
    )  # fmt: skip


@pytest.mark.parametrize("rising", [False, True])
@pytest.mark.parametrize("joints", [1, 2])
def test_a_jaw_may_close_by_rising_joints_or_by_two(solids, jaw_on_axes, rising, joints):
    hand = _slide_jaw(rising=rising, joints=joints)
    problem = make_problem(
        hand, solids["box"], friction=0.6, torsion=0.02, contact_threshold_m=2.5e-3, max_penetration_m=1e-3
    )
    done, X, q, _ = _close(problem, jaw_on_axes(hand, (0.005, 0.0, 0.0)), hand.q_open)
    assert done
    np.testing.assert_allclose(q, 0.02, atol=CONTACT_M + 1e-4)
    np.testing.assert_allclose(X, jaw_on_axes(hand), atol=3e-4)
    assert len(propose_jaw(hand, solids["box"], count=200, friction=0.6, pad_depth_m=0.0,
                           rng=np.random.default_rng(0)).q) > 10  # fmt: skip


# -- fingers -------------------------------------------------------------------


@pytest.mark.parametrize("name", ["barrett", "allegro", "human"])
@pytest.mark.parametrize("solid", ["can", "box"])
def test_closing_never_passes_through_the_object(problem_of, name, solid):
    problem = problem_of(name, solid)
    hand = problem.hand
    proposals = propose_approach(problem, count=60, rng=np.random.default_rng(3))
    closed_any = 0
    for X_OH, q in zip(proposals.X_OH, proposals.q, strict=True):
        before = hand_clearance(
            *problem.sdf_arrays, problem.packed, problem.clusters, X_OH, forward_fast(hand.tree, q[None])[0]
        )
        done, X, end, X_HL = _close(problem, X_OH, q)
        assert done
        np.testing.assert_array_equal(X, X_OH)
        np.testing.assert_allclose(X_HL, forward_numpy(hand.tree, end), atol=1e-12)
        after = hand_clearance(*problem.sdf_arrays, problem.packed, problem.clusters, X, X_HL)
        assert after >= min(before, 0.0) - 1e-6
        assert (end >= hand.tree.lower - 1e-12).all() and (end <= hand.tree.upper + 1e-12).all()
        moved = (end - q) * hand.closing_rate
        assert (moved >= -1e-12).all()  # never opens
        np.testing.assert_array_equal(end[hand.closing_rate == 0], q[hand.closing_rate == 0])
        closed_any += after < CONTACT_M
    assert closed_any > 30


@pytest.mark.parametrize("name", ["barrett", "allegro", "human"])
def test_a_closed_finger_is_stopped_by_contact_or_by_its_limit(problem_of, name):
    """Every joint that still could close carries a link that touches; joints beyond the touching link went on."""
    problem = problem_of(name, "can")
    hand, tree = problem.hand, problem.hand.tree
    proposals = propose_approach(problem, count=30, rng=np.random.default_rng(5))
    for X_OH, q in zip(proposals.X_OH, proposals.q, strict=True):
        _, X, end, X_HL = _close(problem, X_OH, q)
        gap = np.full(tree.num_links, np.inf)
        for link in range(tree.num_links):
            if problem.clusters.of_link[link] < problem.clusters.of_link[link + 1]:
                gap[link] = link_distance(
                    *problem.sdf_arrays, problem.packed, problem.clusters, (X @ X_HL[link])[:3], link, 1.0
                )
        carries = _carried(tree)
        for j in np.flatnonzero(hand.closing_rate):
            room = tree.upper[j] - end[j] if hand.closing_rate[j] > 0 else end[j] - tree.lower[j]
            if room > 1e-5:
                assert gap[carries[:, j]].min() < CONTACT_M + 1e-9


def _carried(tree) -> np.ndarray:
    carried = tree.coupling != 0
    for i, parent in enumerate(tree.parents):
        if parent >= 0:
            carried[i] |= carried[parent]
    return carried


def test_fingers_without_an_object_in_reach_close_to_their_limits(problem_of):
    problem = problem_of("allegro", "ball")
    far = np.eye(4)
    far[0, 3] = 5.0
    done, _, q, _ = _close(problem, far, problem.hand.q_open)
    assert done
    closing = problem.hand.closing_rate > 0
    np.testing.assert_allclose(q[closing], problem.hand.tree.upper[closing], atol=1e-5)


def test_a_hand_that_starts_inside_the_object_does_not_close(problem_of):
    problem = problem_of("human", "cube")
    assert not _close(problem, np.eye(4), problem.hand.q_open)[0]


def test_a_finger_of_one_link_turns_to_the_angle_known_by_hand(make_object):
    """A 100 mm finger turns about its hinge until its tip meets a wall."""
    parents, names = np.array([-1, 0], np.int32), ("base", "finger")
    tree = KinematicTree(
        link_names=names, parents=parents, joint_names=("", "j"), joint_types=np.array([FIXED, REVOLUTE], np.int8),
        X_parent_joint=np.tile(np.eye(4), (2, 1, 1)), axes=np.array([[0.0, 0, 0], [0, 0, 1]]),
        coupling=np.array([[0.0], [1.0]]), offset=np.zeros(2), dof_names=("j",), lower=np.zeros(1),
        upper=np.full(1, 3.0), effort=np.ones(1),
    )  # fmt: skip
    X_LP = np.eye(4)
    X_LP[0, 3] = 0.06
    base = ConvexPart(link=0, kind=PartKind.SPHERE, size=np.array([0.005, 0, 0]), X_LP=np.eye(4))
    finger = ConvexPart(link=1, kind=PartKind.BOX, size=np.array([0.04, 0.004, 0.004]), X_LP=X_LP)
    hand = Hand(
        name="one", tree=tree, parts=(base, finger), fingers=(Finger(name="f", links=(1,), dofs=(0,)),), X_HP=np.eye(4),
        closing_rate=np.ones(1), q_open=np.zeros(1), preshape_lower=np.zeros(1), preshape_upper=np.ones(1) * 0.1,
        preshape_groups=((0,),), is_jaw=False, jaw_pad_H=np.zeros(3), licence="", provenance="",
    )  # fmt: skip
    wall = make_object("wall", box_mesh([0.05, 0.02, 0.05]))
    problem = make_problem(hand, wall, friction=0.6, torsion=0.0, contact_threshold_m=2.5e-3, max_penetration_m=1e-3)
    X_OH = np.eye(4)
    c = np.sqrt(0.5)
    X_OH[:3, :3] = np.array([[c, c, 0], [-c, c, 0], [0, 0, 1]])
    X_OH[:3, 3] = [-0.06, -0.034, 0.0]  # the hinge stands 14 mm off the wall's face y = -20 mm
    done, _, q, _ = _close(problem, X_OH, np.zeros(1))
    assert done
    # the tip's corner (100, 4) mm meets the face: r sin(angle + delta) = 14 mm
    touch = np.pi / 4 + np.arcsin(0.014 / np.hypot(0.1, 0.004)) - np.arctan(0.04)
    assert q[0] == pytest.approx(touch, abs=2 * CONTACT_M / 0.095)  # no surface point lies just at the corner


# -- groups --------------------------------------------------------------------


def test_fingers_close_on_their_own_and_coupled_ones_together(hands):
    closing = make_closing(hands["allegro"])
    assert closing.groups == 4
    for finger in hands["allegro"].fingers:
        used = [d for d in finger.dofs if hands["allegro"].closing_rate[d] != 0]
        assert len({closing.group[d] for d in used}) == 1
    hand = hands["allegro"]
    coupling = hand.tree.coupling.copy()
    coupling[6, 1] = 1.0  # the index's joint now moves a link of the middle finger too
    joined = make_closing(replace(hand, tree=replace(hand.tree, coupling=coupling)))
    assert joined.groups == 3
    assert joined.group[1] == joined.group[5]


def test_the_sides_of_a_jaw_are_opposite_and_its_fast_pad_moves_a_metre_per_unit(hands):
    for name in ("panda", "fetch"):
        hand, closing = hands[name], make_closing(hands[name])
        assert sorted(closing.side[closing.side != 0]) == [-1, 1]
        before, after = forward_numpy(hand.tree, np.stack([hand.q_open, hand.q_open + 0.01 * closing.unit]))
        moved = (after - before)[:, :3, 3] @ closing.axis_H
        assert np.abs(moved).max() == pytest.approx(0.01)


def _three_on_one_motor(folder):
    """Three upright fingers around z, 120 degrees apart, that tilt inwards together; a palm below."""
    shape = '<collision><origin xyz="{}"/><geometry><box size="{}"/></geometry></collision>'
    text = ['<robot name="three"><link name="palm">' + shape.format("0 0 0", "0.06 0.06 0.02") + "</link>"]
    for i in range(3):
        turn = 2 * np.pi * i / 3
        follow = "" if i == 0 else '<mimic joint="f0"/>'
        text.append(
            f'<link name="finger_{i}">{shape.format("0 0 0.05", "0.01 0.02 0.1")}</link>'
            f'<joint name="f{i}" type="revolute">'
            f'<parent link="palm"/><child link="finger_{i}"/><axis xyz="0 -1 0"/>'
            f'<origin xyz="{0.06 * np.cos(turn)} {0.06 * np.sin(turn)} 0.01" rpy="0 0 {turn}"/>'
            f'<limit lower="-0.3" upper="0.9" effort="3" velocity="1"/>{follow}</joint>'
        )
    path = folder / "three.urdf"
    path.write_text("".join([*text, "</robot>"]))
    return load_hand(path)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.012, 0.0), (-0.006, 0.015), (0.004, -0.012)])
def test_a_hand_on_one_motor_gives_way_until_all_fingers_touch(tmp_path, solids, offset):
    hand = _three_on_one_motor(tmp_path)
    assert not hand.is_jaw and len(hand.fingers) == 3
    problem = make_problem(
        hand, solids["ball"], friction=0.6, torsion=0.0, contact_threshold_m=2.5e-3, max_penetration_m=1e-3
    )
    assert sorted(set(problem.closing.branch.tolist())) == [-1, 0, 1, 2]
    X_OH = np.eye(4)
    X_OH[:3, 3] = *offset, -0.075
    start, q = X_OH.copy(), hand.q_open.copy()
    X_HL = np.zeros((hand.tree.num_links, 4, 4))
    assert close_fingers(*problem.sdf_arrays, problem.packed, problem.clusters, problem.closing, X_OH, q, X_HL)
    gaps = np.empty(hand.tree.num_links)
    link_distances(*problem.sdf_arrays, problem.packed, X_OH, X_HL, gaps)
    assert (gaps[1:] < 1.0e-3).all() and gaps.min() > -2e-4
    np.testing.assert_allclose(X_OH[:3, :3], start[:3, :3])
    assert np.abs(X_OH[:2, 3]).max() < 2.5e-3  # centred on the ball


def test_hands_with_a_motor_per_finger_do_not_move(hands):
    for name in ("barrett", "allegro", "human", "panda"):
        assert (make_closing(hands[name]).branch == -1).all() or hands[name].is_jaw
