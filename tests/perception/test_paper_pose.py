"""The published pose estimator against known poses, plain torch and finite differences; exact and learned fields."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from neuralgrasps.dataset.samples import Normalisation
from neuralgrasps.errors import InputError, ShapeError, UnknownNameError
from neuralgrasps.evaluate.pose import pose_errors
from neuralgrasps.geometry.mesh import merge_meshes
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.geometry.rotation import exp_so3, log_so3
from neuralgrasps.geometry.sdf_grid import query_grid
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.signed_distance import hand_signed_distance
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.model.codes import CODE_SIZE, CodeBook
from neuralgrasps.model.field import FieldOutput, GraspField
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.model.mlp_field import MlpConfig, MlpDecoder, MlpField
from neuralgrasps.perception.paper_descent import (
    GridShape,
    NetworkShape,
    Term,
    descend,
    euler_rotations,
    hand_shape,
    loss_gradient,
    object_centre,
    object_shape,
    rotation_losses,
)
from neuralgrasps.perception.paper_pose import PaperPoseConfig, baseline_pose, contact_pose, nearest_grasp

QUICK = PaperPoseConfig(points=300, steps=400)
FAR_O = np.array([0.05, -0.03, 0.08])  # the object's middle in its own frame: centimetres, as of a scan


@dataclass(frozen=True)
class FakeRun:
    """What of a run is used."""

    field: GraspField
    codebook: CodeBook
    grasps: dict[tuple[str, str], GraspSet]


def shifted(mesh, shift):
    X = np.eye(4)
    X[:3, 3] = shift
    return mesh.transformed(X)


@pytest.fixture(scope="module")
def corner(make_object):
    parts = [([0.05, 0.02, 0.015], [0.0, 0.0, 0.0]), ([0.012, 0.02, 0.04], [0.038, 0.0, 0.025]),
             ([0.015, 0.03, 0.01], [-0.03, 0.03, 0.004])]  # fmt: skip
    return make_object("corner", merge_meshes([shifted(box_mesh(h), FAR_O + s) for h, s in parts]))


@pytest.fixture(scope="module")
def fetch():
    return load_hand("fetch")


@pytest.fixture(scope="module")
def field(corner, fetch):
    return KinematicField(hands={"fetch": fetch}, objects={"corner": corner})


@pytest.fixture(scope="module")
def run(field, corner, fetch):
    """Six placed Fetch grasps from different sides, palms 1 cm off the surface; the last is a test grasp."""
    X_OH = np.tile(np.eye(4), (6, 1, 1))
    rng = np.random.default_rng(2)
    for k, point in enumerate(np.linspace(0, len(corner.points_O) - 1, 6).astype(int)):
        z = -corner.normals_O[point]
        x = np.cross(z, rng.normal(size=3))
        x /= np.linalg.norm(x)
        X_OP = np.eye(4)
        X_OP[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
        X_OP[:3, 3] = corner.points_O[point] - 0.01 * z
        X_OH[k] = X_OP @ np.linalg.inv(fetch.X_HP)
        left, _, right = np.linalg.svd(X_OH[k, :3, :3])
        X_OH[k, :3, :3] = left @ right
    q = np.tile(0.5 * (fetch.tree.lower + fetch.tree.upper), (6, 1))
    book = field.encode(X_OH, q, hand="fetch", object_name="corner")
    book = replace(book, grasp_index=np.arange(6, dtype=np.int32), is_test=np.arange(6) == 5)
    none = np.zeros((6, 0, 3))
    grasps = GraspSet(
        hand="fetch", object="corner", X_OH=X_OH, q=q, q_pregrasp=q, q_squeeze=q, contact_points_O=none,
        contact_normals_O=none, contact_links=np.zeros((6, 0), np.int32), epsilon=np.zeros(6),
        penetration_m=np.zeros(6), seed=0,
    )  # fmt: skip
    return FakeRun(field, book, {("fetch", "corner"): grasps})


def placed(obj, rotvec, shift=(0.05, -0.1, 0.8)):
    """A true pose, and the object's surface all over in the camera."""
    X_CO = np.eye(4)
    X_CO[:3, :3] = Rotation.from_rotvec(rotvec).as_matrix()
    X_CO[:3, 3] = shift
    return X_CO, obj.points_O @ X_CO[:3, :3].T + X_CO[:3, 3]


def test_the_grid_is_every_triple_of_45_degrees() -> None:
    R = euler_rotations()
    assert R.shape == (512, 3, 3)
    k = 0
    for a in range(8):
        for b in range(8):
            for c in range(8):
                expected = Rotation.from_euler("XYZ", [45 * a, 45 * b, 45 * c], degrees=True).as_matrix()
                np.testing.assert_allclose(R[k], expected, atol=1e-12)
                k += 1
    assert len(np.unique(np.round(R.reshape(-1, 9), 6), axis=0)) == 208


def test_losses_of_the_grid_are_those_of_every_rotation(corner) -> None:
    shape, R = GridShape(corner.sdf), euler_rotations()
    points = corner.points_O[::40] - FAR_O
    t = FAR_O + 0.01 * R[:, 0]
    expected = [np.abs(shape.distances(points @ r.T + s)).mean() for r, s in zip(R, t, strict=True)]
    found = rotation_losses(shape, points, R, t)
    same = [
        np.abs(R - r).max(axis=(1, 2)).argmin() for r in R
    ]  # of equal rotations, the first one's translation counts
    np.testing.assert_allclose(found, np.array(expected)[same], atol=1e-12)


@pytest.mark.parametrize("rotvec", [[0.2, -0.1, 0.15], [1.4, 0.2, -0.3], [0.3, 2.9, 0.4]])
@pytest.mark.parametrize(("about", "off_m"), [("cloud", 3e-3), ("camera", 1e-2)])
def test_a_surface_seen_all_over_is_found(field, corner, rotvec, about, off_m) -> None:
    X_CO, points_C = placed(corner, rotvec)
    config = PaperPoseConfig(points=300, turn_about=about, accept_m=1e-3)
    found = baseline_pose(field, None, points_C, object_name="corner", config=config, seed=1)
    errors = pose_errors(corner, found.X_CO, X_CO)
    assert errors.mssd_m < off_m and found.loss_m < 3e-3  # at a constant rate Adam keeps moving about the truth
    assert found.accepted == (found.loss_m < config.accept_m)
    assert 1 <= found.runs <= 5 and found.seed == 1 and found.contact_points == 0 and found.grasp_index is None


def test_the_start_is_the_middle_of_the_cloud(field, corner) -> None:
    _, points_C = placed(corner, [0.3, 0.2, 0.1])
    found = baseline_pose(
        field, None, points_C, object_name="corner", config=PaperPoseConfig(steps=1, rate=1e-9, max_runs=1)
    )
    np.testing.assert_allclose((found.X_CO @ np.append(corner.points_O.mean(0), 1))[:3], points_C.mean(0), atol=1e-6)
    turn = found.X_CO[:3, :3].T
    assert np.abs(euler_rotations() - turn).max(axis=(1, 2)).min() < 1e-6
    np.testing.assert_allclose(object_centre(field, "corner"), corner.points_O.mean(0), atol=1e-12)


def test_the_best_run_is_kept_and_the_first_accepted_one_taken(field, corner) -> None:
    # half of the surface: not every start ends at the truth
    X_CO, points_C = placed(corner, [0.5, 0.8, -0.4])
    points_C = points_C[corner.normals_O @ X_CO[2, :3] < 0.0]
    none = replace(QUICK, accept_m=1e-9)
    runs = [
        baseline_pose(field, None, points_C, object_name="corner", config=replace(none, max_runs=k), seed=1)
        for k in range(1, 6)
    ]
    losses = np.array([r.loss_m for r in runs])
    assert (np.diff(losses) <= 0).all() and losses[-1] < losses[0]
    assert not any(r.accepted for r in runs) and [r.runs for r in runs[:2]] == [1, 2]
    just = replace(QUICK, accept_m=float(losses[0]) + 1e-6)
    first = baseline_pose(field, None, points_C, object_name="corner", config=just, seed=1)
    assert first.accepted and first.runs == 1
    np.testing.assert_array_equal(first.X_CO, runs[0].X_CO)


def test_no_start_is_tried_twice(field, corner) -> None:
    _, points_C = placed(corner, [0.5, 0.8, -0.4])
    config = replace(QUICK, best=12, max_runs=50, accept_m=1e-9, steps=1, rate=1e-9)
    found = baseline_pose(field, None, points_C, object_name="corner", config=config)
    assert 3 <= found.runs < 12  # most rotations are on the grid twice


def test_one_seed_one_pose(field, corner) -> None:
    _, points_C = placed(corner, [0.5, 0.8, -0.4])
    config = replace(QUICK, max_runs=1, steps=50)
    once = [baseline_pose(field, None, points_C, object_name="corner", config=config, seed=s) for s in (0, 0, 1, 2, 3)]
    np.testing.assert_array_equal(once[0].X_CO, once[1].X_CO)
    assert len({r.X_CO.tobytes() for r in once[1:]}) > 1


def test_the_gradient_of_both_terms_matches_finite_differences(field, run, corner) -> None:
    rng = np.random.default_rng(0)
    shapes = [GridShape(corner.sdf), hand_shape(field, run.codebook.values[1], hand="fetch", object_name="corner")]
    for w in np.array([[1e-3, -2e-3, 1e-3], [0.4, -0.9, 1.3], [1.7, 2.0, -1.2]]):
        R = Rotation.from_rotvec(w).as_matrix()
        # far enough from the surfaces and the edges of their nearest regions to be smooth within the steps
        terms = [
            Term(shape=s, points=(corner.points_O[rng.choice(1024, 30)] + rng.normal(0, 0.02, (30, 3)) - FAR_O) @ R,
                 weights=rng.uniform(0.5, 2.0, 30))
            for s in shapes
        ]  # fmt: skip
        for some in (terms[:1], terms[1:], terms):
            loss, gradient = loss_gradient(some, w, FAR_O)
            assert loss == pytest.approx(
                sum(t.weights @ np.abs(t.shape.distances(t.points @ R.T + FAR_O)) for t in some), rel=1e-12
            )
            numeric = np.empty(6)
            for k in range(6):
                step = np.zeros(6)
                step[k] = 1e-7
                ends = [loss_gradient(some, w + s * step[:3], FAR_O + s * step[3:])[0] for s in (1.0, -1.0)]
                numeric[k] = (ends[0] - ends[1]) / 2e-7
            np.testing.assert_allclose(gradient, numeric, rtol=1e-4, atol=1e-4 * np.abs(gradient).max())


def test_the_hand_term_is_the_distance_to_the_decoded_grasp(field, run, corner, fetch) -> None:
    grasps = run.grasps["fetch", "corner"]
    points = corner.points_O[::30] + np.random.default_rng(1).normal(0, 0.03, (len(corner.points_O[::30]), 3))
    for k in (0, 3):
        shape = hand_shape(field, run.codebook.values[k], hand="fetch", object_name="corner")
        exact = hand_signed_distance(
            fetch, torch.tensor(grasps.X_OH[k : k + 1]), torch.tensor(grasps.q[k : k + 1]), torch.from_numpy(points)
        )
        np.testing.assert_allclose(shape.distances(points), exact[0].numpy(), atol=1e-6)


def test_adam_on_both_terms_goes_where_torch_goes(field, run, corner, fetch) -> None:
    rng = np.random.default_rng(4)
    code = run.codebook.values[2]
    points = [corner.points_O[rng.choice(1024, n)] - FAR_O for n in (60, 12)]
    R, t = Rotation.from_rotvec([0.2, -0.3, 0.1]).as_matrix(), FAR_O + 0.01
    weights = [np.full(60, 1.7), np.arange(1.0, 13.0)]
    terms = [
        Term(shape=GridShape(corner.sdf), points=points[0], weights=weights[0]),
        Term(shape=hand_shape(field, code, hand="fetch", object_name="corner"), points=points[1], weights=weights[1]),
    ]
    found_R, found_t, loss = descend(terms, R, t, steps=40, rate=0.01)

    grasp = field.decode(torch.from_numpy(code).double()[None], hand="fetch", object_name="corner")
    w = log_so3(torch.from_numpy(R)).requires_grad_()
    s = torch.tensor(t).requires_grad_()
    optimiser = torch.optim.Adam([w, s], lr=0.01)

    def total() -> torch.Tensor:
        at = [torch.from_numpy(p) @ exp_so3(w).T + s for p in points]
        hand = hand_signed_distance(fetch, grasp.X_OH, grasp.q, at[1])[0]
        return (query_grid(corner.sdf, at[0]).abs() @ torch.from_numpy(weights[0])) + hand.abs() @ torch.from_numpy(
            weights[1]
        )

    for _ in range(40):
        optimiser.zero_grad()
        total().backward()
        optimiser.step()
    np.testing.assert_allclose(found_R, exp_so3(w.detach()).numpy(), atol=1e-6)
    np.testing.assert_allclose(found_t, s.detach().numpy(), atol=1e-7)
    assert loss == pytest.approx(float(total().detach()), rel=1e-5)
    assert np.linalg.norm(found_t - t) > 5e-3


def test_the_nearest_grasp_is_by_position_and_turn(fetch) -> None:
    X = np.tile(np.eye(4), (3, 1, 1))
    X[0, 0, 3] = 0.02
    X[1, :3, :3] = Rotation.from_rotvec([0.0, 0.0, 0.2]).as_matrix()  # 10 to 14 mm where the palm stays
    palm = np.asarray(fetch.X_HP)[:3, 3]
    X[1, :3, 3] = palm - X[1, :3, :3] @ palm
    X[2, 0, 3] = 0.03
    assert nearest_grasp(fetch, X, np.eye(4)) == 1
    assert nearest_grasp(fetch, X[[0, 2]], np.eye(4)) == 0
    turned = np.eye(4)  # the jaw half a turn about its approach is the same grasp
    turned[:3, :3] = Rotation.from_rotvec(np.pi * np.asarray(fetch.X_HP)[:3, 2]).as_matrix()
    turned[:3, 3] = palm - turned[:3, :3] @ palm
    assert nearest_grasp(fetch, np.stack([X[0], turned]), np.eye(4)) == 1


def test_contact_takes_the_grasp_at_the_gripper_and_its_contact_points(run, corner) -> None:
    X_CO, points_C = placed(corner, [0.2, -0.1, 0.15])
    grasps, maps = run.grasps["fetch", "corner"], run.codebook.contact_maps
    for k in (1, 4):
        X_CH = X_CO @ grasps.X_OH[k]
        found = contact_pose(run, points_C, X_CH, hand="fetch", object_name="corner", config=QUICK, seed=1)
        assert found.grasp_index == k and not found.note
        assert found.contact_points == (maps[k] > 0.6).sum() > 0
        errors = pose_errors(corner, found.X_CO, X_CO)
        assert errors.mssd_m < 0.01  # the term draws: points above the threshold are not on the hand
    unseen = contact_pose(
        run, points_C, X_CO @ grasps.X_OH[5], hand="fetch", object_name="corner", config=QUICK, seed=1
    )
    assert unseen.grasp_index != 5


def test_contact_lowers_the_sum_of_both_terms(run, corner, field) -> None:
    X_CO, points_C = placed(corner, [0.2, -0.1, 0.15])
    points_C = points_C[::5]  # so that some are the nearest of several contact points, and count as often
    config = replace(QUICK, points=len(points_C), max_runs=1)
    X_CH = X_CO @ run.grasps["fetch", "corner"].X_OH[1]
    first = baseline_pose(field, None, points_C, object_name="corner", config=config, seed=1)
    second = contact_pose(run, points_C, X_CH, hand="fetch", object_name="corner", config=config, seed=1)
    touched_C = corner.points_O[run.codebook.contact_maps[1] > 0.6] @ first.X_CO[:3, :3].T + first.X_CO[:3, 3]
    nearest = np.linalg.norm(touched_C[:, None] - points_C, axis=2).argmin(axis=1)
    assert len(np.unique(nearest)) < len(nearest)
    hand = hand_shape(field, run.codebook.values[1], hand="fetch", object_name="corner")

    def mean_loss(X_CO: np.ndarray) -> float:
        at = (points_C - X_CO[:3, 3]) @ X_CO[:3, :3]
        terms = [np.abs(GridShape(corner.sdf).distances(at)), np.abs(hand.distances(at[nearest]))]
        return float(np.concatenate(terms).mean())

    assert second.loss_m == pytest.approx(mean_loss(second.X_CO), rel=1e-6)
    assert second.loss_m < mean_loss(first.X_CO)
    again = contact_pose(run, points_C, X_CH, hand="fetch", object_name="corner", config=config, seed=1)
    np.testing.assert_array_equal(second.X_CO, again.X_CO)
    # a draw of the observed points stands for all of them: the shares of the two terms stay
    drawn = replace(config, points=60)
    third = contact_pose(run, points_C, X_CH, hand="fetch", object_name="corner", config=drawn, seed=1)
    assert third.loss_m == pytest.approx(second.loss_m, rel=0.2)


def test_without_contact_points_it_is_the_baseline_and_says_so(run, corner, field) -> None:
    X_CO, points_C = placed(corner, [0.2, -0.1, 0.15])
    config = replace(QUICK, contact_threshold=0.99999, accept_m=1e-9)
    bare = replace(run.codebook, contact_maps=np.minimum(run.codebook.contact_maps, 0.9))
    X_CH = X_CO @ run.grasps["fetch", "corner"].X_OH[1]
    found = contact_pose(
        replace(run, codebook=bare), points_C, X_CH, hand="fetch", object_name="corner", config=config, seed=1
    )
    expected = baseline_pose(field, None, points_C, object_name="corner", config=config, seed=1)
    assert found.contact_points == 0 and "no point of the nearest grasp's contact map is above 0.99999" in found.note
    np.testing.assert_array_equal(found.X_CO, expected.X_CO)
    assert (found.loss_m, found.accepted, found.runs) == (expected.loss_m, expected.accepted, expected.runs)


def test_wrong_input_is_named(run, corner, field) -> None:
    X_CO, points_C = placed(corner, [0.2, -0.1, 0.15])
    dirty = np.concatenate([points_C[:19], np.full((5, 3), np.nan)])
    with pytest.raises(InputError, match="19 finite points"):
        baseline_pose(field, None, dirty, object_name="corner")
    with pytest.raises(InputError, match="19 finite points"):
        contact_pose(run, dirty, np.eye(4), hand="fetch", object_name="corner")
    with pytest.raises(ShapeError, match="points_C has shape"):
        baseline_pose(field, None, points_C[:, :2], object_name="corner")
    with pytest.raises(UnknownNameError, match=r"'corners' is not known\. Did you mean 'corner'"):
        baseline_pose(field, None, points_C, object_name="corners")
    with pytest.raises(UnknownNameError, match="hand 'fetsch'"):
        contact_pose(run, points_C, np.eye(4), hand="fetsch", object_name="corner")
    with pytest.raises(ShapeError, match=r"X_CH has shape \(3, 3\)"):
        contact_pose(run, points_C, np.eye(3), hand="fetch", object_name="corner")
    with pytest.raises(InputError, match="X_CH is not finite"):
        contact_pose(run, points_C, np.full((4, 4), np.nan), hand="fetch", object_name="corner")
    all_test = replace(run, codebook=replace(run.codebook, is_test=np.ones(6, bool)))
    for broken in (all_test, replace(run, grasps={})):
        with pytest.raises(InputError, match="no training grasps of hand 'fetch' on object 'corner'"):
            contact_pose(broken, points_C, X_CO, hand="fetch", object_name="corner")
    with pytest.raises(ShapeError, match="surface_O has shape"):
        contact_pose(run, points_C, X_CO, hand="fetch", object_name="corner", surface_O=np.zeros((7, 3)))
    for wrong in ({"steps": 0}, {"rate": 0.0}, {"contact_threshold": 1.0}, {"turn_about": "table"}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            PaperPoseConfig(**wrong)


@pytest.fixture(scope="module")
def learned(corner, fetch, run):
    """A small network taught the distances of the corner and of one grasp's hand, for a few hundred steps."""
    grasps = run.grasps["fetch", "corner"]
    frame = Normalisation(offset_O=corner.points_O.mean(0), scale_m=0.2)
    decoder = MlpDecoder(
        MlpConfig(layers=4, width=64, code_size=CODE_SIZE, norm="none", dropout=0.2),
        generator=torch.Generator().manual_seed(0),
    )
    decoder.dropout = 0.0
    rng = np.random.default_rng(0)
    points = corner.points_O[rng.choice(1024, 6000)] + rng.normal(0, 0.02, (6000, 3))
    X_OH, q, at = (torch.tensor(a) for a in (grasps.X_OH[1:2], grasps.q[1:2], points))
    hand = hand_signed_distance(fetch, X_OH, q, at)[0]
    target = torch.stack([query_grid(corner.sdf, at), hand], dim=1).float() / frame.scale_m
    unit = torch.from_numpy(frame.to_unit(points)).float()
    code = torch.from_numpy(run.codebook.values[1])[None]
    optimiser = torch.optim.Adam(decoder.parameters(), lr=3e-3)
    decoder.train()
    for step in range(500):
        rows = torch.from_numpy(rng.choice(6000, 500))
        loss = (decoder(unit[rows][None], code)[0] - target[rows]).abs().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        if step == 350:
            optimiser.param_groups[0]["lr"] = 5e-4
    decoder.dropout = 0.2  # as trained in earnest: it must not act here
    decoder.requires_grad_(False)
    return MlpField(decoder, object_name="corner", normalisation=frame)


def test_a_learned_field_finds_the_pose_too(learned, corner, run) -> None:
    X_CO, points_C = placed(corner, [0.2, -0.1, 0.15])
    code = run.codebook.values[1]
    config = PaperPoseConfig(points=200, steps=150, accept_m=3e-3)
    found = baseline_pose(learned, code, points_C, object_name="corner", config=config, seed=0)
    errors = pose_errors(corner, found.X_CO, X_CO)
    assert errors.translation_m < 0.01 and np.rad2deg(errors.rotation_rad) < 8.0 and found.accepted
    again = baseline_pose(learned, code, points_C, object_name="corner", config=config, seed=0)
    np.testing.assert_array_equal(found.X_CO, again.X_CO)
    np.testing.assert_allclose(object_centre(learned, "corner"), corner.points_O.mean(0))


def test_contact_works_with_a_learned_field(learned, corner, run) -> None:
    X_CO, points_C = placed(corner, [0.2, -0.1, 0.15])
    own = replace(run, field=learned, codebook=run.codebook[[1]])
    X_CH = X_CO @ run.grasps["fetch", "corner"].X_OH[1]
    config = PaperPoseConfig(points=200, steps=100, max_runs=2)
    found = contact_pose(
        own, points_C, X_CH, hand="fetch", object_name="corner", surface_O=corner.points_O, config=config
    )
    assert found.contact_points > 0 and found.grasp_index == 1
    assert pose_errors(corner, found.X_CO, X_CO).translation_m < 0.02
    with pytest.raises(InputError, match="surface_O is None"):
        contact_pose(own, points_C, X_CH, hand="fetch", object_name="corner")
    with pytest.raises(InputError, match="code is None"):
        baseline_pose(learned, None, points_C, object_name="corner")


def test_a_learned_fields_gradient_matches_finite_differences(learned, run, corner) -> None:
    points = (corner.points_O[::40] + 0.01).astype(np.float64)
    for which in ("object", "hand"):
        shape = NetworkShape(learned, run.codebook.values[1], which, hand="fetch", object_name="corner")
        distance, gradient = shape.gradients(points)
        np.testing.assert_allclose(distance, shape.distances(points), atol=1e-7)
        numeric = np.stack(
            [(shape.distances(points + e) - shape.distances(points - e)) / 2e-3 for e in 1e-3 * np.eye(3)], axis=1
        )
        assert np.abs(gradient - numeric).mean() < 0.03  # the network bends within the steps


def test_any_other_field_is_asked_as_it_is(corner) -> None:
    class Ball:
        """A ball of 5 cm about the frame's origin, and a hand that is never near."""

        def __call__(self, points_O, codes, *, hand, object_name):
            distance = points_O.norm(dim=-1)[None].expand(len(codes), -1) - 0.05
            return FieldOutput(sdf_object=distance, sdf_hand=distance + 1.0)

    points = np.random.default_rng(0).normal(size=(200, 3))
    points_C = 0.05 * points / np.linalg.norm(points, axis=1, keepdims=True) + [0.1, 0.0, 0.7]
    shape = object_shape(Ball(), np.zeros(2), object_name="ball")
    np.testing.assert_allclose(shape.distances(np.array([[0.0, 0.0, 0.06]])), 0.01, atol=1e-7)
    found = baseline_pose(Ball(), np.zeros(2), points_C, object_name="ball", config=replace(QUICK, steps=200))
    np.testing.assert_allclose(found.X_CO[:3, 3], [0.1, 0.0, 0.7], atol=4e-3)
    assert found.accepted
