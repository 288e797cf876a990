import json
import os
import socket
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from neuralgrasps.errors import DataFormatError, DivergedError, InputError
from neuralgrasps.model.checkpoint import load_run
from neuralgrasps.model.losses import variable_margin_triplet
from neuralgrasps.model.mlp_bench import made_up_scenes
from neuralgrasps.model.mlp_checkpoint import config_of, replay_dump, save_dump
from neuralgrasps.model.mlp_data import FAR, ObjectScenes, SceneSamples, object_scenes, scene_samples
from neuralgrasps.model.mlp_field import MlpConfig, MlpDecoder
from neuralgrasps.model.mlp_loss import triplet_of_distances
from neuralgrasps.model.mlp_parallel import Workers, workers_here
from neuralgrasps.model.mlp_run import free_codebook, load_mlp_run, run_kind, save_mlp_run
from neuralgrasps.model.mlp_schedule import PAPER, PAPER_FAST, PRESETS, MlpTrainConfig, shortened
from neuralgrasps.model.mlp_train import MlpTrainer, train_mlp
from neuralgrasps.model.train_state import STATE_FILE
from tests.model.plain_draw import balanced_draw, sign_lists

SMALL = MlpTrainConfig(
    epochs=8,
    points_per_scene=64,
    step_scenes=0,
    step_points=64,
    net_rate=5e-3,
    code_rate=1e-2,
    code_std=0.1,
    threads=1,
    decoder=MlpConfig(layers=3, width=32, code_size=8, dropout=0.1),
)
HERE = Workers(rank=0, count=1, device=torch.device("cpu"))


@pytest.fixture(scope="module")
def scenes() -> ObjectScenes:
    return made_up_scenes(6, 400)


def permuted(scenes: ObjectScenes, order: np.ndarray) -> ObjectScenes:
    index = torch.as_tensor(order)
    samples = scenes.samples
    return replace(
        scenes,
        samples=SceneSamples(
            rows=samples.rows[index],
            positive=samples.positive[index],
            inside=samples.inside[index],
            far=samples.far[index],
        ),
        contact_maps=scenes.contact_maps[order],
        hand_index=scenes.hand_index[order],
        grasp_index=scenes.grasp_index[order],
    )


def test_rows_are_the_samples_in_normalised_units(small_dataset) -> None:
    scenes = object_scenes(small_dataset, "brick")
    stored = small_dataset.samples("allegro", "brick", [small_dataset.split("allegro", "brick").train[1]])
    frame = small_dataset.object("brick").normalisation
    rows = scenes.samples.rows[1].numpy()
    assert (
        len(scenes) == 20 and scenes.hands == ("allegro", "fetch") and scenes.hand_index.tolist() == [0] * 10 + [1] * 10
    )
    assert scenes.grasp_index[:10].tolist() == small_dataset.split("allegro", "brick").train.tolist()
    metres = np.concatenate([frame.to_object(rows[:, :3]), rows[:, 3:] * frame.scale_m], axis=1)
    truth = np.concatenate([stored.points_O[0], stored.sdf_object[0][:, None], stored.sdf_hand[0][:, None]], axis=1)
    metres, truth = (a[np.lexsort(a.round(6).T)] for a in (metres, truth))
    assert np.allclose(metres, truth, atol=1e-6)


def test_draw_is_balanced_and_from_the_published_lists(small_dataset) -> None:
    stored = small_dataset.samples("fetch", "ball")
    stored.sdf_hand[0] = np.abs(stored.sdf_hand[0]) + 0.01  # one scene with nothing inside
    stored.sdf_object[0] = np.abs(stored.sdf_object[0]) + 0.01
    samples = scene_samples([stored], small_dataset.object("ball").normalisation)
    lists = sign_lists(stored.sdf_object, stored.sdf_hand)
    assert samples.positive.tolist() == lists.positive_count.tolist()
    assert samples.inside.tolist() == lists.non_positive_count.tolist()
    scenes = torch.arange(len(samples))
    places = samples.draw(scenes, 2001, torch.Generator().manual_seed(0))
    sdf = samples.gather(scenes, places)[..., 3:].numpy()
    assert (sdf[:, :1001] > 0).any(axis=2).all()
    assert (sdf[1:, 1001:] <= 0).any(axis=2).all() and (sdf[0] > 0).all()
    plain = balanced_draw(lists, np.random.default_rng(0).random((len(samples), 2001)))
    for i in range(1, len(samples)):  # the same points can be drawn, equally often
        kinds = [
            np.array([(o > 0) * 2 + (h > 0) for o, h in pair]).mean()
            for pair in (sdf[i, 1001:], np.stack([stored.sdf_object[i], stored.sdf_hand[i]], 1)[plain[i, 1001:]])
        ]
        assert kinds[0] == pytest.approx(kinds[1], abs=0.15)
        assert len(np.unique(places[i, 1001:])) == pytest.approx(len(np.unique(plain[i, 1001:])), rel=0.15)
    far = samples.gather(scenes, samples.draw(scenes, 100, torch.Generator().manual_seed(2), far_share=0.3))[..., 3:]
    assert (far[:, 70:] > FAR).all() and (far[1:, 35:70] <= 0).any(dim=2).all()
    shared = samples.draw(scenes, 100, torch.Generator().manual_seed(1), shared=True)
    alone = samples.draw(scenes[2:3], 100, torch.Generator().manual_seed(1), shared=True)
    assert torch.equal(shared[2:3], alone)


def test_triplet_of_distances_is_the_triplet_of_maps() -> None:
    generator = torch.Generator().manual_seed(0)
    codes, maps = torch.randn(7, 4, generator=generator), torch.rand(7, 30, generator=generator)
    index = [torch.randint(7, (50,), generator=generator) for _ in range(3)]
    distances = torch.cdist(maps, maps)
    ours = triplet_of_distances(codes, *index, distances[index[0], index[1]], distances[index[0], index[2]])
    assert float(ours) == pytest.approx(float(variable_margin_triplet(codes, maps, *index)), rel=1e-4)


def test_triplet_by_hand_on_three_maps() -> None:
    # maps at 0, 3 and 5 on a line; codes at 0, 4 and 1: |z0 z1| - |z0 z2| + (5 - 3) = 4 - 1 + 2
    codes = torch.tensor([[0.0], [4.0], [1.0]])
    one, two, zero = torch.tensor([1]), torch.tensor([2]), torch.tensor([0])
    for first, second, a, b in ((one, two, 3.0, 5.0), (two, one, 5.0, 3.0)):
        loss = triplet_of_distances(codes, zero, first, second, torch.tensor([a]), torch.tensor([b]))
        assert float(loss) == pytest.approx(5.0)
    fitting = torch.tensor([[0.0], [1.0], [4.0]])  # 1 - 4 + 2 < 0
    assert float(triplet_of_distances(fitting, zero, one, two, torch.tensor([3.0]), torch.tensor([5.0]))) == 0.0


def test_steps_draw_every_scene_alike_and_triplets_of_others(scenes: ObjectScenes) -> None:
    config = replace(SMALL, step_scenes=4, points_per_scene=128, triplets_per_anchor=50)
    trainer = MlpTrainer(scenes, config, HERE)
    assert trainer.per_epoch == 3
    for epoch in range(3):
        batches = [trainer.batch(3 * epoch + k) for k in range(3)]
        assert np.bincount(torch.cat([b.scenes for b in batches]), minlength=6).tolist() == [2] * 6
        for b in batches:
            assert (b.anchor != b.first).all() and (b.anchor != b.second).all()
            assert set(b.first.tolist()) | set(b.second.tolist()) == set(range(6))
            maps = torch.as_tensor(scenes.contact_maps)
            assert torch.allclose(b.map_first, (maps[b.anchor] - maps[b.first]).norm(dim=1), atol=1e-5)


def test_training_lowers_the_loss_and_repeats(scenes: ObjectScenes) -> None:
    config = replace(SMALL, epochs=120)
    a, b = (train_mlp(scenes, config=config, device="cpu") for _ in range(2))
    assert np.array_equal(a.losses, b.losses) and np.array_equal(a.codes, b.codes)
    assert a.losses[-10:, 1].mean() < 0.6 * a.losses[:10, 1].mean()
    assert a.finished and a.samples == 120 * 6 * 64


def test_large_batches_are_thinned_for_the_figures_of_batch_norm(scenes: ObjectScenes, monkeypatch) -> None:
    trainer = MlpTrainer(scenes, replace(SMALL, points_per_scene=4_096, step_points=4_096), HERE)
    trainer.one_step()
    seen = []
    forward = MlpDecoder.forward
    monkeypatch.setattr(MlpDecoder, "forward", lambda self, p, z: seen.append(tuple(p.shape)) or forward(self, p, z))
    trainer.result()
    assert set(seen) == {(6, 1_024, 3)}


def test_codes_permute_with_scenes(scenes: ObjectScenes) -> None:
    # full batch: all points of all scenes, all triplets, no noise; start codes follow their scenes
    config = replace(SMALL, decoder=replace(SMALL.decoder, dropout=0.0), precision="fp32")
    order = np.array([3, 0, 5, 1, 4, 2])
    codes = []
    for given in (scenes, permuted(scenes, order)):
        trainer = MlpTrainer(given, config, HERE)
        base = trainer.batch(0)
        everyone = torch.arange(6)
        a, b, c = (t.flatten() for t in torch.meshgrid(everyone, everyone, everyone, indexing="ij"))
        distances = trainer.map_distances
        batch = replace(
            base, scenes=everyone, rows=given.samples.rows, anchor=a, first=b, second=c,
            map_first=distances[a, b], map_second=distances[a, c],
        )  # fmt: skip
        trainer.batch = lambda step, batch=batch: batch  # type: ignore[method-assign]
        if given is not scenes:
            with torch.no_grad():
                trainer.model.codes.copy_(trainer.model.codes[torch.as_tensor(order)])
        for _ in range(12):
            trainer.one_step()
        codes.append(trainer.model.codes.detach())
    assert torch.allclose(codes[0][torch.as_tensor(order)], codes[1], atol=1e-4)
    assert not torch.allclose(codes[0], codes[1], atol=1e-2)


@pytest.mark.parametrize("precision", ["bf16", "fp32"])
def test_killed_training_resumes_to_the_same_weights(scenes: ObjectScenes, tmp_path: Path, precision) -> None:
    config = replace(SMALL, precision=precision, code_noise=0.05)
    whole = train_mlp(scenes, config=config, device="cpu")
    calls = []

    def killed(done: int, total: int, loss: float) -> None:
        calls.append(done)
        if len(calls) in (3, 6):
            raise KeyboardInterrupt

    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            train_mlp(
                scenes,
                config=config,
                folder=tmp_path,
                checkpoint_minutes=0.0,
                resume=True,
                device="cpu",
                progress=killed,
            )
    again = train_mlp(scenes, config=config, folder=tmp_path, resume=True, device="cpu")
    assert calls == [1, 2, 3, 3, 4, 5]  # the step after the last checkpoint was done again
    assert np.array_equal(again.codes, whole.codes) and np.array_equal(again.losses, whole.losses)
    for a, b in zip(again.field.decoder.state_dict().values(), whole.field.decoder.state_dict().values(), strict=True):
        assert torch.equal(a, b)


def test_a_checkpoint_of_another_training_is_refused(scenes: ObjectScenes, tmp_path: Path) -> None:
    train_mlp(scenes, config=replace(SMALL, epochs=1), folder=tmp_path, device="cpu")
    with pytest.raises(DataFormatError, match="another configuration"):
        train_mlp(scenes, config=replace(SMALL, epochs=2), folder=tmp_path, resume=True, device="cpu")
    other = permuted(scenes, np.array([1, 0, 2, 3, 4, 5]))
    with pytest.raises(DataFormatError, match="another scenes"):
        train_mlp(other, config=replace(SMALL, epochs=1), folder=tmp_path, resume=True, device="cpu")
    data = (tmp_path / STATE_FILE).read_bytes()
    (tmp_path / STATE_FILE).write_bytes(data[: len(data) // 2])
    with pytest.raises(DataFormatError, match="damaged"):
        train_mlp(scenes, config=replace(SMALL, epochs=1), folder=tmp_path, resume=True, device="cpu")


def test_a_checkpoint_of_more_processes_is_refused(scenes: ObjectScenes, tmp_path: Path) -> None:
    trainer = MlpTrainer(scenes, SMALL, HERE)
    trainer.one_step()
    trainer.save(tmp_path)
    trainer.workers = replace(HERE, count=2)
    with pytest.raises(DataFormatError, match="by 1 processes together, now there are 2"):
        trainer.restore(tmp_path)
    trainer.workers = HERE
    assert trainer.restore(tmp_path)


@pytest.mark.parametrize("count", [1, 2, 3, 8])
def test_rates_fall_to_the_end_however_many_processes(scenes: ObjectScenes, monkeypatch, count: int) -> None:
    # two steps an epoch: with more processes than that, each of their steps counts for several of one process
    config = replace(SMALL, epochs=20, points_per_scene=128, schedule="one-cycle")
    monkeypatch.setattr(Workers, "wrapped", lambda self, model: model)
    trainer = MlpTrainer(scenes, config, replace(HERE, count=count))
    rates = []
    for _ in range(trainer.steps):
        trainer.one_step()
        rates.append(trainer.optimiser.param_groups[0]["lr"] / config.net_rate)
    peak = int(np.argmax(rates))
    assert rates[peak] > 0.9 and rates[-1] < 0.05 and (np.diff(rates[peak:]) <= 0).all()
    assert 0.3 < rates[len(rates) // 2] < 0.7
    assert config.rate_factor(10**6, 6) == pytest.approx(1e-3)


def test_nan_stops_with_a_dump_that_replays(scenes: ObjectScenes, tmp_path: Path) -> None:
    trainer = MlpTrainer(scenes, SMALL, HERE)
    for _ in range(3):
        trainer.one_step(tmp_path)
    with torch.no_grad():
        trainer.model.codes[2, 1] = float("nan")
    before = trainer.model.decoder.last.weight.clone()
    with pytest.raises(DivergedError, match="loss of step 3 is not finite") as raised:
        trainer.one_step(tmp_path)
    dump = next(tmp_path.glob("bad_step_*.safetensors"))
    assert str(dump) in str(raised.value) and torch.equal(before, trainer.model.decoder.last.weight)
    assert not np.isfinite(float(replay_dump(dump)[0]))
    with pytest.raises(DataFormatError, match="not a dump"):
        trainer.save(tmp_path)
        replay_dump(tmp_path / STATE_FILE)


def test_a_dump_holds_all_that_the_loss_depends_on(scenes: ObjectScenes, tmp_path: Path) -> None:
    for precision in ("bf16", "fp32"):
        trainer = MlpTrainer(scenes, replace(SMALL, precision=precision, code_noise=0.1), HERE)
        for _ in range(2):
            trainer.one_step()
        batch = trainer.batch(2)
        path = save_dump(tmp_path, trainer.model, batch, step=2, rank=0, prior_weight=0.3)
        loss = trainer.model.train()(batch, 2, 0, 0.3).stacked()
        torch.manual_seed(99)
        assert torch.equal(replay_dump(path), loss)


def test_outputs_that_start_outside_the_clamp_still_learn(scenes: ObjectScenes) -> None:
    config = replace(SMALL, epochs=150, decoder=replace(SMALL.decoder, dropout=0.0))
    trainer = MlpTrainer(scenes, config, HERE)
    start = trainer.model(trainer.batch(0), 0, 0, 0.0)
    assert float(start.sdf.detach()) < 0.12  # the library's own start is inside
    with torch.no_grad():
        trainer.model.decoder.last.bias.fill_(0.6)
    first = float(trainer.one_step().sdf.detach())
    for _ in range(149):
        last = float(trainer.one_step().sdf.detach())
    assert first > 0.9 and last < 0.1 * first


def test_schedules() -> None:
    assert PAPER.samples(250) == pytest.approx(1e10, rel=0.01)
    assert (PAPER.step_scenes, PAPER.step_points) == (16, 16_384)  # the published batch
    assert PAPER_FAST.samples(250) <= PAPER.samples(250) / 10
    per_epoch = PAPER.steps_per_epoch(250)
    assert [PAPER.rate_factor(e * per_epoch, 250) for e in (0, 499, 500, 1999)] == [1.0, 1.0, 0.5, 0.125]
    assert PAPER.prior_factor(50 * per_epoch, 250) == pytest.approx(5e-5)
    assert PAPER.prior_factor(700 * per_epoch, 250) == pytest.approx(1e-4)
    total = PAPER_FAST.epochs * PAPER_FAST.steps_per_epoch(250)
    factors = [PAPER_FAST.rate_factor(s, 250) for s in range(0, total, max(1, total // 400))]
    assert max(factors) == pytest.approx(1.0, abs=0.02) and factors[0] < 0.1 and factors[-1] < 0.01
    for samples in (3e5, 4e6, 1.3e7, 7e7):
        less = shortened(PAPER_FAST, samples, 250)
        assert less.samples(250) == pytest.approx(samples, rel=0.01) and less.points_per_scene <= 20_000
    assert shortened(PAPER_FAST, 1e12, 250) == PAPER_FAST
    assert shortened(PAPER, 1e9, 250).halve_epochs == 50
    for samples in (6e5, 4e6, 1e8):  # the large batch does not keep a short schedule from being short
        assert shortened(PAPER, samples, 250).samples(250) == pytest.approx(samples, rel=0.3)
    assert set(PRESETS) == {"paper", "paper-fast", "paper-fast-codes"}
    for config in PRESETS.values():
        assert config_of(json.loads(json.dumps(asdict(config)))) == config
    with pytest.raises(InputError, match="epochs is 0"):
        MlpTrainConfig(epochs=0)


def test_run_round_trip(scenes: ObjectScenes, tmp_path: Path) -> None:
    config = replace(SMALL, epochs=2, decoder=replace(SMALL.decoder, code_size=128))
    result = train_mlp(scenes, config=config, device="cpu")
    book = free_codebook(scenes, result.codes)
    save_mlp_run(tmp_path, result, book, notes={"minutes": 3})
    run = load_mlp_run(tmp_path)
    assert run_kind(tmp_path) == "mlp" and run.config == config and run.notes == {"minutes": 3}
    assert np.array_equal(run.codebook.metric, result.codes) and run.samples == result.samples
    points, codes = torch.rand(20, 3) * 0.1, torch.as_tensor(result.codes)
    a, b = (f(points, codes, hand="ball", object_name="ball").sdf_hand for f in (run.field, result.field))
    assert torch.equal(a, b)
    with pytest.raises(DataFormatError, match="MlpField"):
        load_run(tmp_path, hands={}, objects={})
    (tmp_path / "codes.safetensors").write_bytes(b"x")
    with pytest.raises(DataFormatError, match="sha256"):
        load_mlp_run(tmp_path)
    with pytest.raises(InputError, match="codes of 128"):
        free_codebook(scenes, result.codes[:, :8])


WORKER = """
import json, sys, torch
from dataclasses import replace
from neuralgrasps.model.mlp_bench import made_up_scenes
from neuralgrasps.model.mlp_parallel import workers_here
from neuralgrasps.model.mlp_train import MlpTrainer
from neuralgrasps.model.mlp_checkpoint import config_of
config = config_of(json.loads(sys.argv[1]))
torch.set_num_threads(1)
with workers_here("cpu") as workers:
    trainer = MlpTrainer(made_up_scenes(6, 400), config, workers)
    batches = [float(trainer.batch(k).rows.sum()) for k in range(3)]
    for _ in range(4):
        trainer.one_step()
    weights = [float(p.detach().double().sum()) for p in trainer.model.parameters()]
    told = {"rank": workers.rank, "count": workers.count, "weights": weights, "batches": batches}
    print(json.dumps(told), flush=True)
"""


def test_two_processes_train_one_model_on_different_batches() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    together = {"WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "OMP_NUM_THREADS": "1"}
    environment = os.environ | together
    command = [sys.executable, "-c", WORKER, json.dumps(asdict(SMALL))]
    processes = [
        subprocess.Popen(command, env=environment | {"RANK": str(k), "LOCAL_RANK": str(k)}, stdout=subprocess.PIPE)
        for k in range(2)
    ]
    try:
        told = [json.loads(p.communicate(timeout=300)[0].splitlines()[-1]) for p in processes]
    finally:
        for process in processes:
            process.kill()
    a, b = sorted(told, key=lambda t: t["rank"])
    assert (a["rank"], b["rank"], a["count"]) == (0, 1, 2)
    assert np.isfinite(a["weights"]).all() and a["weights"] == b["weights"]
    assert all(x != y for x, y in zip(a["batches"], b["batches"], strict=True))
    with workers_here("cpu") as alone:
        trainer = MlpTrainer(made_up_scenes(6, 400), SMALL, alone)
    for _ in range(4):
        trainer.one_step()
    assert a["weights"] != [float(p.detach().double().sum()) for p in trainer.model.parameters()]
