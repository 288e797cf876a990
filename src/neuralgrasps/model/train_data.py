"""What the correction network is trained on: the training grasps and many jittered copies, each with its own code."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from neuralgrasps.compiled import njit
from neuralgrasps.dataset.read import GraspDataset
from neuralgrasps.geometry.rotation import exp_so3
from neuralgrasps.hands.packed import hand_distance_many
from neuralgrasps.model.codes import CELLS, HandCodec, ObjectCodec, assemble_codes, contact_blocks
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.model.losses import HandPoints
from neuralgrasps.parallel import blocks, thread_map
from neuralgrasps.seeds import child_rng

POINTS_PER_CELL = 6
_CHUNKS = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Jitter:
    """Spread of the copies, at a scale drawn uniformly from [0.2, 2] for each.

    Attributes:
        copies: of each training grasp. m, rad: of the palm, metres and radians. joint: share of each joint's range.
    """

    copies: int = 24
    m: float = 0.01
    rad: float = 0.1
    joint: float = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class HandData:
    """Training tensors of one hand: codes (N, 128), the place of each object (N,), where the hand's points are.

    Attributes:
        points_O: (N, K, 3) object frame, metres. material: the points.
    """

    codes: Tensor
    object_index: Tensor
    points_O: Tensor
    material: HandPoints


def hand_data(
    field: KinematicField, dataset: GraspDataset, hand: str, *, jitter: Jitter, seed: int, threads: int
) -> HandData:
    """Training grasps of a hand on all objects of a dataset, and their copies; test grasps are not looked at."""
    codes, place, poses, joints = [], [], [], []
    for name, object_name in dataset.pairs:
        chosen = dataset.split(name, object_name).train
        if name != hand or not len(chosen):
            continue
        obj, codec = field.object_codecs[object_name], field.hand_codecs[hand]
        grasps = dataset.grasps(hand, object_name)[chosen]
        known = contact_blocks(dataset.contact_maps(hand, object_name)[chosen], obj)
        rng = child_rng(seed, "jitter", hand, object_name)
        X, q = jittered(grasps.X_OH, grasps.q, codec, jitter, rng)
        points_O = cell_points(obj, dataset.object(object_name).points_O, rng)
        sampled = sampled_blocks(field, hand, obj, points_O, X, q, threads=threads)
        X, q = np.concatenate([grasps.X_OH, X]), np.concatenate([grasps.q, q])
        codes.append(assemble_codes(np.concatenate([known, sampled]), X, q, hand=codec, obj=obj))
        place.append(np.full(len(X), dataset.objects.index(object_name)))
        poses.append(X)
        joints.append(q)
    material = HandPoints(field.hands[hand], field.packed[hand])
    X_OH, q_all = (torch.as_tensor(np.concatenate(a), dtype=torch.float32) for a in (poses, joints))
    return HandData(
        codes=torch.as_tensor(np.concatenate(codes)),
        object_index=torch.as_tensor(np.concatenate(place)),
        points_O=material.posed(X_OH, q_all),
        material=material,
    )


def jittered(
    X_OH: np.ndarray, q: np.ndarray, codec: HandCodec, jitter: Jitter, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Perturbed copies of each grasp: the palm is moved and turned about itself, joints stay in their limits."""
    X = np.repeat(np.array(X_OH), jitter.copies, axis=0)
    q = np.repeat(np.array(q), jitter.copies, axis=0)
    scale = rng.uniform(0.2, 2.0, (len(X), 1))
    X_OP = X @ codec.X_HP
    turn = exp_so3(torch.as_tensor(rng.normal(scale=jitter.rad, size=(len(X), 3)) * scale)).numpy()
    X_OP[:, :3, :3] = X_OP[:, :3, :3] @ turn
    X_OP[:, :3, 3] += rng.normal(scale=jitter.m, size=(len(X), 3)) * scale
    span = codec.upper - codec.lower
    q = np.clip(q + rng.normal(scale=jitter.joint, size=q.shape) * scale * span, codec.lower, codec.upper)
    return X_OP @ np.linalg.inv(codec.X_HP), q


def cell_points(obj: ObjectCodec, points_O: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(96 * 6, 3) random contact points, six of each cell (again where a cell has fewer)."""
    order = rng.permutation(len(points_O))
    chosen = [np.resize(order[obj.cell_of[order] == k], POINTS_PER_CELL) for k in range(CELLS)]
    return np.ascontiguousarray(points_O[np.concatenate(chosen)], np.float64)


def sampled_blocks(
    field: KinematicField,
    hand: str,
    obj: ObjectCodec,
    points_O: np.ndarray,
    X_OH: np.ndarray,
    q: np.ndarray,
    *,
    threads: int,
) -> np.ndarray:
    """Contact blocks (N, 96) estimated at six points a cell: as good as all for training, at a fifth of the cost."""
    packed, X, q = field.packed[hand], np.ascontiguousarray(X_OH), np.ascontiguousarray(q)
    distance = np.empty((len(X), len(points_O)))

    def fill(part: slice) -> None:
        _distances(packed, X[part], q[part], points_O, distance[part])

    thread_map(fill, blocks(len(X), _CHUNKS), threads=threads)
    near = np.exp(-np.maximum(distance, 0.0) / obj.radius_m).reshape(len(X), CELLS, POINTS_PER_CELL).mean(axis=2)
    return (near * obj.weights).astype(np.float32)


@njit(cache=True, error_model="numpy", nogil=True)
def _distances(packed, X_OH, q, points_O, out):  # type: ignore[no-untyped-def]
    for i in range(X_OH.shape[0]):
        hand_distance_many(packed, X_OH[i], q[i], points_O, out[i])


def collect_data(
    field: KinematicField, dataset: GraspDataset, *, jitter: Jitter, seed: int, threads: int
) -> Mapping[str, HandData]:
    """`hand_data` of every hand that has training grasps."""
    with_training = [
        hand for hand in dataset.hands
        if any(len(dataset.split(h, o).train) for h, o in dataset.pairs if h == hand)
    ]  # fmt: skip
    return {hand: hand_data(field, dataset, hand, jitter=jitter, seed=seed, threads=threads) for hand in with_training}
