import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from neuralgrasps.dataset.samples import hand_distances
from neuralgrasps.errors import DataFormatError, DivergedError, InputError, ShapeError, UnknownNameError
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.rotation import matrix_from_6d
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.model import optimise as optimise_module
from neuralgrasps.model.checkpoint import load_run, restored_config, save_run
from neuralgrasps.model.codes import CELLS
from neuralgrasps.model.field import GraspField
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.model.losses import HandPoints, clamped_l1, point_distances, variable_margin_triplet
from neuralgrasps.model.optimise import add_noise, one_cycle
from neuralgrasps.model.train import TrainConfig, train
from neuralgrasps.model.train_data import Jitter


def test_field_is_exact_for_the_hand_and_the_grid_for_the_object(small_world) -> None:
    field = KinematicField(hands=small_world.hands, objects=small_world.objects)
    assert isinstance(field, GraspField)
    grasps = small_world.grasp_sets[1]
    book = field.encode(grasps.X_OH, grasps.q, hand=grasps.hand, object_name=grasps.object)
    points = np.random.default_rng(0).uniform(-0.05, 0.05, (300, 3))  # inside the grid
    out = field(torch.as_tensor(points), torch.as_tensor(book.values).double(), hand=grasps.hand, object_name="ball")
    assert out.sdf_hand.shape == out.sdf_object.shape == (12, 300)
    expected = hand_distances(field.packed[grasps.hand], grasps.X_OH, grasps.q, points)
    assert np.allclose(out.sdf_hand.numpy(), expected, atol=2e-6)
    assert np.allclose(out.sdf_object[0].numpy(), np.linalg.norm(points, axis=1) - 0.04, atol=1e-3)


def test_field_is_differentiable_in_the_code(small_world) -> None:
    field = KinematicField(hands=small_world.hands, objects=small_world.objects)
    grasps = small_world.grasp_sets[0]
    book = field.encode(grasps.X_OH[:1], grasps.q[:1], hand="allegro", object_name="brick")
    code = torch.as_tensor(book.values).double().requires_grad_()
    point = torch.tensor([[0.05, 0.06, 0.02]], dtype=torch.float64)
    field(point, code, hand="allegro", object_name="brick").sdf_hand.sum().backward()
    step = torch.zeros_like(code)
    step[0, CELLS : CELLS + 3] = torch.tensor([1.0, -2.0, 0.5])
    step[0, CELLS + 9 : CELLS + 12] = 0.3
    with torch.no_grad():
        values = [field(point, code + e * step, hand="allegro", object_name="brick").sdf_hand for e in (1e-6, -1e-6)]
    numeric = float((values[0] - values[1]) / 2e-6)
    assert float((code.grad * step).sum()) == pytest.approx(numeric, rel=1e-4)


def test_a_new_hand_needs_no_training(small_run, small_world) -> None:
    barrett = load_hand("barrett")
    field = small_run.field.with_hand(barrett)
    q = 0.5 * (barrett.tree.lower + barrett.tree.upper)[None]
    X_OH = np.eye(4)[None]
    book = field.encode(X_OH, q, hand="barrett", object_name="brick")
    back = field.decode(torch.as_tensor(book.values), hand="barrett", object_name="brick", noise_level=0.1)
    assert np.allclose(back.q.numpy(), q, atol=1e-6)
    assert field.hand_codecs["allegro"] is small_run.field.hand_codecs["allegro"]
    with pytest.raises(UnknownNameError, match="'barret' is not known"):
        small_run.field.hand("barret")


def test_wrong_codes_are_refused(small_world) -> None:
    field = KinematicField(hands=small_world.hands, objects=small_world.objects)
    with pytest.raises(ShapeError, match="128"):
        field.decode(torch.zeros(2, 100), hand="fetch", object_name="ball")
    with pytest.raises(InputError, match="noise_level"):
        field.decode(torch.zeros(2, 128), hand="fetch", object_name="ball", noise_level=-1.0)


def test_training_lowers_the_loss_and_repeats_exactly(small_world, small_dataset, small_run) -> None:
    again = train(small_dataset, hands=small_world.hands, objects=small_world.objects, config=small_run.config)
    assert np.array_equal(again.losses, small_run.losses)
    for a, b in zip(again.field.decoder.parameters(), small_run.field.decoder.parameters(), strict=True):
        assert torch.equal(a, b)
    assert small_run.losses[-8:].mean() < 0.9 * small_run.losses[:8].mean()


def test_weights_do_not_depend_on_the_threads_of_the_machine(small_world, small_dataset) -> None:
    before = torch.get_num_threads()
    config = TrainConfig(steps=3, batch=64, jitter=Jitter(copies=1))
    results = []
    try:
        for threads in (1, 4):
            torch.set_num_threads(threads)
            results.append(train(small_dataset, hands=small_world.hands, objects=small_world.objects, config=config))
            assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)
    a, b = (r.field.decoder.state_dict() for r in results)
    assert all(torch.equal(a[name], b[name]) for name in a)


def test_test_grasps_are_marked_and_not_trained_on(small_dataset, small_run) -> None:
    book = small_run.codebook
    assert len(book) == 48 and book.is_test.sum() == 8
    for hand, obj in small_dataset.pairs:
        rows = book[book.where(hand=hand, object_name=obj, is_test=True)]
        assert rows.grasp_index.tolist() == small_dataset.split(hand, obj).test.tolist()


def test_correction_vanishes_with_the_noise_level(small_run) -> None:
    codes = torch.as_tensor(small_run.codebook.values[small_run.codebook.where(hand="allegro", object_name="brick")])
    decode = small_run.field.decode
    exact = decode(codes, hand="allegro", object_name="brick").X_OH
    shifts = [
        float((decode(codes, hand="allegro", object_name="brick", noise_level=s).X_OH - exact).abs().max())
        for s in (1e-5, 1e-3, 0.1)
    ]
    assert shifts[0] < 1e-5 < shifts[2] and shifts[0] < shifts[1] < shifts[2]


def test_noise_keeps_rotations_and_unused_columns() -> None:
    codes = torch.zeros(50, 128)
    codes[:, CELLS + 3], codes[:, CELLS + 7] = 1.0, 1.0
    noisy = add_noise(
        codes, torch.full((50,), 0.2), joints=4, contact_noise=0.0, generator=torch.Generator().manual_seed(0)
    )
    columns = noisy[:, CELLS + 3 : CELLS + 9]
    R = matrix_from_6d(columns)
    assert torch.allclose(torch.cat([R[..., 0], R[..., 1]], dim=-1), columns, atol=1e-5)
    assert (noisy[:, :CELLS] == 0).all() and (noisy[:, CELLS + 13 :] == 0).all()
    assert float(noisy[:, CELLS + 9 : CELLS + 13].std()) == pytest.approx(0.2, rel=0.2)


def test_losses_by_hand(small_world) -> None:
    assert float(clamped_l1(torch.tensor([0.2, 0.0]), torch.tensor([0.5, -0.01]), clamp=0.1)) == pytest.approx(0.055)
    field = KinematicField(hands=small_world.hands, objects=small_world.objects)
    material = HandPoints(small_world.hands["allegro"], field.packed["allegro"], count=20)
    X = torch.eye(4).repeat(2, 1, 1)
    q = torch.zeros(2, 16)
    X[1, :3, 3] = torch.tensor([0.03, 0.0, 0.04])
    points = material.posed(X, q)
    assert point_distances(points[:1], points[1:])[0] == pytest.approx(0.05, rel=1e-4)
    codes, maps = torch.tensor([[0.0], [1.0], [3.0]]), torch.tensor([[0.0], [0.1], [0.6]])
    index = (torch.tensor([0]), torch.tensor([2]), torch.tensor([1]))  # the nearer map must become the positive
    assert float(variable_margin_triplet(codes, maps, *index)) == pytest.approx(0.0)
    assert float(variable_margin_triplet(codes * 0, maps, *index)) == pytest.approx(0.5)


def test_checkpoint_round_trip(small_world, small_run, tmp_path: Path) -> None:
    save_run(tmp_path, small_run)
    run = load_run(tmp_path, hands=small_world.hands, objects=small_world.objects)
    assert restored_config(run) == small_run.config
    assert np.array_equal(run.codebook.values, small_run.codebook.values)
    assert np.array_equal(run.losses, small_run.losses)
    codes = torch.as_tensor(run.codebook.values[run.codebook.where(hand="fetch", object_name="ball")])
    a, b = (
        f.decode(codes, hand="fetch", object_name="ball", noise_level=0.1).X_OH for f in (run.field, small_run.field)
    )
    assert torch.equal(a, b)
    assert {p.suffix for p in tmp_path.iterdir()} == {".json", ".safetensors"}


def test_damaged_and_missing_checkpoints_are_refused(small_world, small_run, tmp_path: Path) -> None:
    models = {"hands": small_world.hands, "objects": small_world.objects}
    with pytest.raises(DataFormatError, match=r"run\.json is missing"):
        load_run(tmp_path, **models)
    save_run(tmp_path, small_run)
    with pytest.raises(UnknownNameError, match="'allegro'"):
        load_run(tmp_path, hands={}, objects=small_world.objects)
    data = bytearray((tmp_path / "field.safetensors").read_bytes())
    data[-1] ^= 1
    (tmp_path / "field.safetensors").write_bytes(data)
    with pytest.raises(DataFormatError, match="sha256 differs"):
        load_run(tmp_path, **models)
    (tmp_path / "run.json").write_text("{")
    with pytest.raises(DataFormatError, match="damaged"):
        load_run(tmp_path, **models)


def test_bad_training_configs_are_refused() -> None:
    with pytest.raises(InputError, match="noise_min"):
        TrainConfig(noise_min=0.0)
    with pytest.raises(InputError, match="batch 0"):
        TrainConfig(batch=0)
    with pytest.raises(InputError, match="threads is 0"):
        TrainConfig(threads=0)


def test_a_run_keeps_its_grasps_and_compact_maps(small_run, small_world, small_dataset, tmp_path: Path) -> None:
    sets = [small_dataset.grasps(*pair) for pair in small_dataset.pairs]
    save_run(tmp_path, small_run, grasps=sets, compact_maps=True)
    run = load_run(tmp_path, hands=small_world.hands, objects=small_world.objects)
    assert set(run.grasps) == set(small_dataset.pairs)
    for pair, grasps in run.grasps.items():
        assert np.array_equal(grasps.X_OH, small_dataset.grasps(*pair).X_OH)
    assert np.abs(run.codebook.contact_maps - small_run.codebook.contact_maps).max() <= 0.5 / 255 + 1e-6
    file = next((tmp_path / "grasps").rglob("*.safetensors"))
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(DataFormatError, match=file.name):
        load_run(tmp_path, hands=small_world.hands, objects=small_world.objects)


def test_another_mesh_of_the_same_name_is_refused(small_run, small_world, make_object, tmp_path: Path) -> None:
    save_run(tmp_path, small_run)
    brick = small_world.objects["brick"]
    larger = make_object("brick", Mesh(brick.mesh.vertices * 1.2, brick.mesh.faces), cells=48, points=1024)
    with pytest.raises(InputError, match="not the one that the run was fitted with") as one:
        load_run(tmp_path, hands=small_world.hands, objects={**small_world.objects, "brick": larger})
    assert "--objects DIR_OR_FILES" in str(one.value) and "'ball'" not in str(one.value)
    ball = small_world.objects["ball"]
    smaller = make_object("ball", Mesh(ball.mesh.vertices * 0.8, ball.mesh.faces), cells=48, points=1024)
    smaller = replace(smaller, provenance={"source": "stand-in for YCB 055_baseball"})
    with pytest.raises(
        InputError, match=r"2 objects are not the ones .*'ball' \(a built-in stand-in, .* mm off\).*'brick' \("
    ) as both:
        load_run(tmp_path, hands=small_world.hands, objects={"brick": larger, "ball": smaller})
    assert "objects download ycb" in str(both.value)


def test_correction_turns_with_the_scene_and_serves_unknown_objects(small_run, make_object) -> None:
    """Object, hand and code turned together: the corrected palm turns along."""
    grasps = small_run.codebook[small_run.codebook.where(hand="allegro", object_name="brick")]
    brick = small_run.field.objects["brick"]
    S = np.eye(4)
    S[:3, :3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    turned_mesh = Mesh(brick.mesh.vertices @ S[:3, :3].T, brick.mesh.faces)
    codec = small_run.field.object_codecs["brick"]
    turned_codec = replace(
        codec, name="turned", points_O=codec.points_O @ S[:3, :3].T, centres_O=codec.centres_O @ S[:3, :3].T,
        offset_O=S[:3, :3] @ codec.offset_O,
    )  # fmt: skip
    other = make_object("turned", turned_mesh, cells=48, points=1024)
    base = small_run.field
    field = KinematicField(
        hands=base.hands, objects={**base.objects, "turned": other}, hand_codecs=base.hand_codecs,
        object_codecs={**base.object_codecs, "turned": turned_codec}, decoder=base.decoder,
    )  # fmt: skip
    codes = torch.as_tensor(grasps.values)
    known = base.decode(codes, hand="allegro", object_name="brick")
    moved = field.encode_with_maps(
        grasps.contact_maps, S @ known.X_OH.numpy(), known.q.numpy(), hand="allegro", object_name="turned"
    )
    here = base.decode(codes, hand="allegro", object_name="brick", noise_level=0.2)
    there = field.decode(torch.as_tensor(moved.values), hand="allegro", object_name="turned", noise_level=0.2)
    assert float((here.X_OH - known.X_OH).abs().max()) > 1e-4  # it does correct
    assert np.allclose(there.X_OH.numpy(), S @ here.X_OH.numpy(), atol=1e-4)
    assert np.allclose(there.q.numpy(), here.q.numpy(), atol=1e-4)


def test_killed_training_goes_on_to_the_same_weights(
    small_world, small_dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = TrainConfig(steps=12, batch=8, jitter=Jitter(copies=1), seed=3)
    models = {"hands": small_world.hands, "objects": small_world.objects}
    monkeypatch.setattr("neuralgrasps.model.optimise.CHECKPOINT_S", -1.0)  # after every step

    def killed(done: int, _: int, __: float) -> None:
        if done == 7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(small_dataset, **models, config=config, folder=tmp_path, progress=killed)
    assert (tmp_path / "training.safetensors").is_file()
    seen = []
    resumed = train(small_dataset, **models, config=config, folder=tmp_path, progress=lambda d, *_: seen.append(d))
    whole = train(small_dataset, **models, config=config)
    assert seen[0] == 8 and np.array_equal(resumed.losses, whole.losses)
    for a, b in zip(resumed.field.decoder.parameters(), whole.field.decoder.parameters(), strict=True):
        assert torch.equal(a, b)
    assert not (tmp_path / "training.safetensors").exists()


def test_interrupted_training_is_kept_at_once(
    small_world, small_dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C long before the first checkpoint, in the middle of a step: the steps before are kept."""
    config = TrainConfig(steps=6, batch=8, jitter=Jitter(copies=1), seed=4)
    models = {"hands": small_world.hands, "objects": small_world.objects}
    whole = train(small_dataset, **models, config=config)
    losses = iter(range(100))
    real = optimise_module.batch_loss

    def interrupted(*arguments):
        value = real(*arguments)  # random numbers of the step are drawn, its weights are not
        if next(losses) == 3:
            raise KeyboardInterrupt
        return value

    monkeypatch.setattr(optimise_module, "batch_loss", interrupted)
    with pytest.raises(KeyboardInterrupt):
        train(small_dataset, **models, config=config, folder=tmp_path)
    seen = []
    resumed = train(small_dataset, **models, config=config, folder=tmp_path, progress=lambda d, *_: seen.append(d))
    assert seen[0] == 4 and np.array_equal(resumed.losses, whole.losses)


def test_a_checkpoint_of_another_training_is_not_gone_on_from(
    small_world, small_dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    models = {"hands": small_world.hands, "objects": small_world.objects}
    monkeypatch.setattr("neuralgrasps.model.optimise.CHECKPOINT_S", -1.0)

    def killed(done: int, _: int, __: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        first = TrainConfig(steps=3, batch=8, jitter=Jitter(copies=1))
        train(small_dataset, **models, config=first, folder=tmp_path, progress=killed)
    seen = []
    other = TrainConfig(steps=3, batch=8, jitter=Jitter(copies=1), seed=1)
    train(small_dataset, **models, config=other, folder=tmp_path, progress=lambda d, *_: seen.append(d))
    assert seen[0] == 1


def test_a_loss_that_is_no_number_stops_training(small_world, small_dataset) -> None:
    config = TrainConfig(steps=40, batch=8, jitter=Jitter(copies=0), learning_rate=1e30)
    with pytest.raises(DivergedError, match="lower the learning rate"):
        train(small_dataset, hands=small_world.hands, objects=small_world.objects, config=config)


def test_the_learning_rate_rises_and_falls() -> None:
    rates = [one_cycle(k / 100) for k in range(101)]
    assert max(rates) == pytest.approx(1.0) and rates.index(max(rates)) == 10
    assert rates[0] < 0.05 and rates[100] == pytest.approx(0.0)
    assert np.all(np.diff(rates[:11]) > 0)
    assert np.all(np.diff(rates[10:]) < 0)


def test_another_hand_of_the_same_name_is_refused(small_run, small_world, tmp_path: Path) -> None:
    save_run(tmp_path, small_run)
    for imposter in ("fetch", "barrett"):  # another hand with as many joints, and one with fewer
        name = "allegro"
        hands = {**small_world.hands, name: load_hand(imposter)}
        with pytest.raises(InputError, match="hand 'allegro' given is not the one"):
            load_run(tmp_path, hands=hands, objects=small_world.objects)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("hands", None), ("objects", "brick"), ("radius_m", ["0.01", "0.02"]), ("radius_m", [0.01]), ("sha256", {}),
        ("codebook", None), ("decoder", {"hands": ["allegro"]}), ("config", 3), ("version", "mlp-1"),
    ],
)  # fmt: skip
def test_notes_that_cannot_be_right_are_refused(small_run, small_world, tmp_path: Path, key: str, value) -> None:
    save_run(tmp_path, small_run)
    notes = json.loads((tmp_path / "run.json").read_text())
    (tmp_path / "run.json").write_text(json.dumps({**notes, key: value}))
    with pytest.raises(DataFormatError, match="MlpField" if key == "version" else "damaged"):
        load_run(tmp_path, hands=small_world.hands, objects=small_world.objects)
    del notes[key]
    (tmp_path / "run.json").write_text(json.dumps(notes))
    with pytest.raises(DataFormatError):
        load_run(tmp_path, hands=small_world.hands, objects=small_world.objects)


def test_poses_that_are_no_numbers_are_refused(small_run, small_world) -> None:
    grasps = small_world.grasp_sets[0]
    X_OH = np.array(grasps.X_OH)
    X_OH[1, 0, 3] = np.nan
    with pytest.raises(InputError, match="not finite"):
        small_run.field.encode(X_OH, grasps.q, hand="allegro", object_name="brick")
