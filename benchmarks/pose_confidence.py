"""Fit the weights of the pose confidence: python benchmarks/pose_confidence.py FOLDER_OF_MESHES [--workers N].

Simulated scenes of seeds that the benchmark does not use (1000 and 2000) show every object; estimates of the right
object and of wrong ones, and of all objects on things that no library has, are labelled right or wrong. Prints the
weights for `perception/pose_confidence.py`, and how a fit on the first half of the scenes does on the second.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from sklearn.linear_model import LogisticRegression

from neuralgrasps.evaluate.pose import diameter_m, pose_errors
from neuralgrasps.evaluate.pose_scenes import PoseScene, background_scene, pose_scene
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.zoo import load_object, object_sources
from neuralgrasps.parallel import available_cpus, run_tasks
from neuralgrasps.perception.observation import observe_depth
from neuralgrasps.perception.pose import merged_shares
from neuralgrasps.perception.pose_confidence import confidence_features, pose_covariance
from neuralgrasps.perception.pose_model import pose_model
from neuralgrasps.perception.pose_search import NO_CONTACTS, PoseConfig, search
from neuralgrasps.perception.table import find_table
from neuralgrasps.seeds import child_rng, child_seed

ROOTS = (1000, 2000)
COUNTS = {"easy": 4, "occluded": 12, "hard": 12}
BACKGROUNDS = 60
WRONG_OBJECTS = 2
WRONG_WEIGHT, BACKGROUND_WEIGHT = 0.1, 1.5


@dataclass(frozen=True, slots=True)
class Sample:
    """Features of one estimate and whether it is right; kind: own, wrong (object) or background."""

    root: int
    kind: str
    features: np.ndarray
    right: bool


def samples_of(scene: PoseScene, objects: Sequence[ObjectModel], root: int) -> list[Sample]:
    """Estimates of a scene: the right object and some wrong ones, with and without its table."""
    table = find_table(scene.frame).plane
    names = [obj.name for obj in objects]
    out, others = [], []
    drawn = child_rng(scene.seed, "wrong objects").choice(
        [n for n in names if n != scene.object], min(WRONG_OBJECTS, len(names) - 1), replace=False
    )
    for obj in objects:
        kind = "own" if obj.name == scene.object else ("wrong" if scene.object else "background")
        sample, cost = _estimate(scene, obj, table, kind, root)
        if kind == "own" or obj.name in drawn:
            out.append(sample)
            out.append(_estimate(scene, obj, None, kind, root)[0])
        if kind != "own":
            others.append((cost, sample))
    out.append(min(others, key=lambda pair: pair[0])[1])  # the wrong object that explains the view best
    return out


def _estimate(scene: PoseScene, obj: ObjectModel, table, kind: str, root: int) -> tuple[Sample, float]:  # type: ignore[no-untyped-def]
    # wrong objects are not searched for widely, as when objects are told apart
    config, model = PoseConfig() if kind == "own" else PoseConfig(wide=1), pose_model(obj)
    seen = observe_depth(
        scene.depth, scene.intrinsics, scene.mask, reach_m=model.diameter, table=table, seed=scene.seed
    )
    found = search(model, seen, NO_CONTACTS, config)
    covariance, _ = pose_covariance(model, seen, found.X_CO[0], config)
    _, shares = merged_shares(model, found)
    right = False
    if kind == "own":
        errors = pose_errors(obj, found.X_CO[0], scene.X_CO_true)
        right = errors.add_s_m < 0.01 and errors.mssd_m < 0.1 * diameter_m(obj)
    features = confidence_features(model, seen, found, float(shares[0]), covariance)
    return Sample(root, kind, features, right), float(found.cost[0])


@cache
def _library(sources: tuple[str, ...]) -> list[ObjectModel]:
    return [load_object(source) for source in sources]


def _scene_task(sources: tuple[str, ...], index: int, condition: str, number: int, root: int) -> list[Sample]:
    objects = _library(sources)
    obj = objects[index]
    others = [o for o in objects if o is not obj]
    scene = pose_scene(obj, condition, seed=child_seed(root, obj.name, condition, number), distractors=others)  # type: ignore[arg-type]
    return samples_of(scene, objects, root)


def _background_task(sources: tuple[str, ...], number: int, root: int) -> list[Sample]:
    objects = _library(sources)
    return samples_of(background_scene(child_seed(root, "background", number), distractors=objects), objects, root)


def _task(kind: str, *args) -> list[Sample]:  # type: ignore[no-untyped-def]
    return _background_task(*args) if kind == "background" else _scene_task(*args)


def fit(samples: Sequence[Sample], length: int) -> np.ndarray:
    """Logistic weights (length,) of the samples with so many features; the first is the constant."""
    used = [s for s in samples if len(s.features) == length]
    X, y = np.array([s.features[1:] for s in used]), np.array([s.right for s in used])
    weight = {"own": 1.0, "wrong": WRONG_WEIGHT, "background": BACKGROUND_WEIGHT}
    model = LogisticRegression(C=3.0, max_iter=10000)
    model.fit(X, y, sample_weight=np.array([weight[s.kind] for s in used]))
    return np.concatenate([model.intercept_, model.coef_[0]])


def report(weights: np.ndarray, samples: Sequence[Sample]) -> None:
    """Reliability of the weights on samples, by kind."""
    for kind in ("own", "wrong", "background"):
        used = [s for s in samples if len(s.features) == len(weights) and s.kind == kind]
        if not used:
            continue
        p = 1.0 / (1.0 + np.exp(-np.array([s.features for s in used]) @ weights))
        y = np.array([s.right for s in used])
        place = np.digitize(p, [0.2, 0.5, 0.8, 0.9, 0.97])
        bins = [f"{(place == b).sum()}: {y[place == b].mean():.2f}" if (place == b).any() else "-" for b in range(6)]
        print(f"  {kind:10} n {len(y)}, right {y.mean():.3f}; said < .2 .5 .8 .9 .97 1: n and right {', '.join(bins)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("meshes", help="folder of meshes, or a name that `neuralgrasps objects list` shows")
    parser.add_argument("--workers", type=int, default=available_cpus())
    args = parser.parse_args()
    objects = tuple(str(source) for source in object_sources([args.meshes]))
    tasks = [
        ("scene", objects, k, condition, i, root)
        for root in ROOTS for k in range(len(objects)) for condition, n in COUNTS.items() for i in range(n)
    ] + [("background", objects, i, root) for root in ROOTS for i in range(BACKGROUNDS)]  # fmt: skip
    found = dict(run_tasks(_task, tasks, workers=args.workers))
    samples = [s for k in range(len(tasks)) for s in found[k]]
    for length, name in ((6, "WEIGHTS"), (8, "TABLE_WEIGHTS")):
        print(f"{name}: fitted on seed {ROOTS[0]}, tested on {ROOTS[1]}")
        report(fit([s for s in samples if s.root == ROOTS[0]], length), [s for s in samples if s.root == ROOTS[1]])
        print(f"{name} = np.array({np.round(fit(samples, length), 3).tolist()})  # both")


if __name__ == "__main__":
    main()
