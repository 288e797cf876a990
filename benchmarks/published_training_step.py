"""The published training step, stated again plainly, against the library's: samples per second.

Both sides train the published network on the same batch, 16 scenes x 1,024 points; the published one is 16 x 16,384.

    python benchmarks/published_training_step.py [--threads 2] [--seconds 20] [--json]

The plain step is what the published method describes: a module per layer in float32, the code repeated for every point
and joined to it, points of each scene drawn on the processor one scene after the other, one triplet per scene.
"""

from __future__ import annotations

import argparse
import json
import time

import numpy as np
import torch
from torch import Tensor, nn

from neuralgrasps.model.mlp_bench import MEASURED, made_up_scenes, training_rate
from neuralgrasps.model.mlp_data import ObjectScenes


def plain_network(layers: int, width: int, code_size: int, dropout: float) -> nn.Sequential:
    """Hidden layers with batch norm, ReLU and dropout, then two outputs through tanh."""
    parts: list[nn.Module] = []
    for i in range(layers):
        linear = nn.Linear(3 + code_size if i == 0 else width, width)
        parts += [linear, nn.BatchNorm1d(width), nn.ReLU(), nn.Dropout(dropout)]
    return nn.Sequential(*parts, nn.Linear(width, 2), nn.Tanh())


class PlainTraining:
    """One object's training, step by step."""

    def __init__(self, scenes: ObjectScenes) -> None:
        config = MEASURED
        shape = config.decoder
        self.points, self.clamp = config.step_points, config.clamp
        self.maps = torch.as_tensor(scenes.contact_maps)
        rows, outer = scenes.samples.rows, scenes.samples.positive
        inner = rows.shape[1] - scenes.samples.inside
        self.positive = [rows[i, : outer[i]].clone() for i in range(len(scenes))]
        self.inside = [rows[i, inner[i] :].clone() for i in range(len(scenes))]
        self.network = plain_network(shape.layers, shape.width, shape.code_size, shape.dropout)
        self.codes = nn.Embedding(len(scenes), shape.code_size)
        nn.init.normal_(self.codes.weight, 0.0, config.code_std)
        groups = [
            {"params": self.network.parameters(), "lr": config.net_rate},
            {"params": self.codes.parameters(), "lr": config.code_rate},
        ]
        self.optimiser = torch.optim.Adam(groups)

    def drawn(self, scene: int) -> Tensor:
        """Half of the points positive to either shape, half not."""
        parts = []
        for kind in (self.positive[scene], self.inside[scene]):
            parts.append(kind[(torch.rand(self.points // 2) * len(kind)).long()])
        return torch.cat(parts)

    def triplets(self) -> Tensor:
        """Loss of one triplet per scene."""
        total, count = torch.zeros(()), len(self.maps)
        for anchor in range(count):
            near, far = (int(k) for k in np.random.default_rng().choice(np.delete(np.arange(count), anchor), 2, False))
            d_near, d_far = ((self.maps[anchor] - self.maps[k]).norm() for k in (near, far))
            if d_far < d_near:
                near, far, d_near, d_far = far, near, d_far, d_near
            z = self.codes(torch.tensor([anchor, near, far]))
            total = total + ((z[0] - z[1]).norm() - (z[0] - z[2]).norm() + d_far - d_near).clamp(min=0)
        return total / count

    def step(self) -> int:
        """One update; the number of points it saw."""
        scenes = range(len(self.maps))
        rows = torch.cat([self.drawn(i) for i in scenes])
        which = torch.arange(len(self.maps)).repeat_interleave(self.points)
        codes = self.codes(which)
        self.optimiser.zero_grad()
        out = self.network(torch.cat([rows[:, :3], codes], dim=1))
        target = rows[:, 3:].clamp(-self.clamp, self.clamp)
        loss = sum(((out[:, k] - target[:, k]).abs().mean() for k in range(2)), self.triplets())
        loss = loss + 1e-4 * codes.norm(dim=1).mean()
        loss.backward()
        self.optimiser.step()
        return len(rows)


def plain_rate(scenes: ObjectScenes, seconds: float) -> tuple[float, float]:
    """Samples per second of wall and of processor time."""
    training = PlainTraining(scenes)
    training.step()
    wall, cpu, seen = time.perf_counter(), time.process_time(), 0
    while time.perf_counter() - wall < seconds:
        seen += training.step()
    return seen / (time.perf_counter() - wall), seen / (time.process_time() - cpu)


def main() -> None:
    """Measure both, one after the other, twice; say the better of each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    scenes = made_up_scenes(MEASURED.step_scenes)
    plain, ours = [], []
    for _ in range(2):
        plain.append(plain_rate(scenes, given.seconds / 4))
        rate = training_rate(seconds=given.seconds / 4, threads=given.threads, device="cpu")
        ours.append((rate.mlp_samples_per_s, rate.per_cpu_s))
    figures = {
        "threads": given.threads,
        "batch": MEASURED.step_scenes * MEASURED.step_points,
        "plain_samples_per_s": max(p[0] for p in plain),
        "plain_samples_per_cpu_s": max(p[1] for p in plain),
        "mlp_samples_per_s": max(p[0] for p in ours),
        "mlp_samples_per_cpu_s": max(p[1] for p in ours),
    }
    figures["ratio_per_cpu_s"] = figures["mlp_samples_per_cpu_s"] / figures["plain_samples_per_cpu_s"]
    print(json.dumps(figures, indent=1) if given.json else "\n".join(f"{k}: {v:.4g}" for k, v in figures.items()))


if __name__ == "__main__":
    main()
