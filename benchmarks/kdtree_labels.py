"""Signed distances from rendered point clouds and a KD-tree, against the library's exact ones: error and CPU-seconds.

    python benchmarks/kdtree_labels.py --objects FOLDER [--hands fetch allegro] [--scenes 1] [--json FILE]

A plain statement, written here, of how the published data were labelled (Khargonkar et al. 2022): 128 depth images of
each scene, back-projected into one dense cloud with normals for the object and one for the hand; these thinned to the
number of surface samples by farthest point sampling; the distance to the nearest point of a KD-tree, its sign by vote
of the 200 nearest normals. The cameras are the library's own, and the thinning is its compiled one, which is
many times faster than the same in numpy: what is measured is the method and not its implementation. Labels are taken
from the dense and from the thinned cloud, at the very points that the library labels; one process, one thread.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from neuralgrasps.dataset.build import HAND_POINT_SPACING_M
from neuralgrasps.dataset.camera_ring import ring_intrinsics, ring_level, ring_poses
from neuralgrasps.dataset.clouds import scene_clouds
from neuralgrasps.dataset.samples import Normalisation, contact_maps, normalisation_of, sample_scenes
from neuralgrasps.dataset.scene_views import hand_reach
from neuralgrasps.dataset.schema import DatasetConfig
from neuralgrasps.evaluate.label_error import (
    exact_hand_distance,
    exact_object_distance,
    hand_depth_bound,
    label_error,
)
from neuralgrasps.geometry.camera import back_project
from neuralgrasps.geometry.mesh import Mesh, face_areas_normals
from neuralgrasps.geometry.raster import rasterise
from neuralgrasps.geometry.sampling import farthest_points
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import PackedHand, pack_hand
from neuralgrasps.hands.surface import hand_mesh
from neuralgrasps.hands.zoo import hand_sources, load_hand
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.zoo import load_object, object_sources
from neuralgrasps.synthesis.synthesise import SynthesisConfig, synthesise

VOTES = 200
SHAPES = ("object", "hand")
BAND_M = 0.05  # a wrong sign far from a surface costs twice that distance: means are also given without these


@dataclass(frozen=True, slots=True, kw_only=True)
class Cloud:
    """(K, 3) points and normals, object frame, metres."""

    points: np.ndarray
    normals: np.ndarray

    def thinned(self, count: int) -> Cloud:
        chosen = farthest_points(self.points, min(count, len(self.points)))
        return Cloud(points=self.points[chosen], normals=self.normals[chosen])


def dense_clouds(meshes: list[Mesh], X_OC: np.ndarray) -> list[Cloud]:
    """Every pixel of every view, by the mesh that it shows; normals of its faces."""
    intrinsics = ring_intrinsics()
    face_normals = [face_areas_normals(mesh)[1] for mesh in meshes]
    points: list[list[np.ndarray]] = [[] for _ in meshes]
    normals: list[list[np.ndarray]] = [[] for _ in meshes]
    for X in X_OC:
        image = rasterise(meshes, np.stack([np.linalg.inv(X)] * len(meshes)), intrinsics)
        for k in range(len(meshes)):
            mask = image.mesh_index == k
            points[k].append(back_project(image.depth, intrinsics, mask=mask) @ X[:3, :3].T + X[:3, 3])
            normals[k].append(face_normals[k][image.face_index[mask]])
    return [Cloud(points=np.concatenate(p), normals=np.concatenate(n)) for p, n in zip(points, normals, strict=True)]


def voted_distance(cloud: Cloud, points: np.ndarray) -> np.ndarray:
    """Distance to the nearest point of the cloud; negative where most of the 200 nearest have the point behind them."""
    votes = min(VOTES, len(cloud.points))
    distance, nearest = cKDTree(cloud.points).query(points, k=votes)
    behind = np.empty(len(points))
    for block in np.array_split(np.arange(len(points)), max(1, len(points) // 5000)):
        offset = points[block, None] - cloud.points[nearest[block]]
        behind[block] = ((offset * cloud.normals[nearest[block]]).sum(axis=2) < 0).mean(axis=1)
    return np.where(behind > 0.5, -1.0, 1.0) * distance[:, 0]


class Clock:
    """CPU-seconds of this process by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def __call__(self, name: str, work: Callable[[], Any]) -> Any:
        start = time.process_time()
        result = work()
        self.seconds[name] = self.seconds.get(name, 0.0) + time.process_time() - start
        return result


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """One grasp, and all that labels are made from."""

    hand: Hand
    packed: PackedHand
    obj: ObjectModel
    frame: Normalisation
    X_OH: np.ndarray
    q: np.ndarray


def ours(scenes: list[Scene], config: DatasetConfig, clock: Clock) -> list[dict[str, np.ndarray]]:
    """The library's whole data stage of scenes of one pair: (M, 3) points and labels of each."""
    first = scenes[0]
    X_OH, q = np.stack([s.X_OH for s in scenes]), np.stack([s.q for s in scenes])
    names = {"hand": first.hand.name, "object_name": first.obj.name, "normalisation": first.frame, "config": config}
    mesh, packed = first.obj.mesh, first.packed
    samples = clock("samples", lambda: sample_scenes(mesh, packed, X_OH, q, **names))
    radius = config.contact_decay * first.frame.scale_m
    clock("contact maps", lambda: contact_maps(packed, X_OH, q, first.obj.points_O, radius_m=radius))
    clock("rendered clouds", lambda: scene_clouds(mesh, packed, X_OH, q, **names))
    return [
        {"points": samples.points_O[i].astype(np.float64), "object": samples.sdf_object[i], "hand": samples.sdf_hand[i]}
        for i in range(len(scenes))
    ]


def plain(scene: Scene, points: np.ndarray, thin: int, clock: Clock) -> dict[str, dict[str, np.ndarray]]:
    """The labels of the plain method, from the dense and from the thinned clouds."""
    mesh, centre = scene.obj.mesh, scene.frame.offset_O
    base = float(np.linalg.norm(mesh.vertices - centre, axis=1).max())
    ring = ring_poses(centre, base, ring_level(hand_reach(scene.packed, scene.X_OH, scene.q, centre), base))
    posed = hand_mesh(scene.hand, scene.q).transformed(scene.X_OH)
    dense = clock("128 views", lambda: dense_clouds([mesh, posed], ring))
    thinned = clock("farthest points", lambda: [cloud.thinned(thin) for cloud in dense])
    labels = clock("KD-tree", lambda: [voted_distance(cloud, points) for cloud in dense])
    sparse = [voted_distance(cloud, points) for cloud in thinned]  # not in the time: one of the two is enough
    return {
        "dense": dict(zip(SHAPES, labels, strict=True)),
        "thinned": dict(zip(SHAPES, sparse, strict=True)),
    }


def exact(scene: Scene, points: np.ndarray) -> dict[str, np.ndarray]:
    """Exact distances by libraries that neither method uses."""
    return {
        "object": exact_object_distance(scene.obj.mesh, points),
        "hand": exact_hand_distance(scene.hand, scene.X_OH, scene.q, points),
    }


def errors(labels: np.ndarray, right: np.ndarray) -> dict[str, float]:
    """`LabelError` of all samples, and the mean of those within 5 cm of the surface."""
    near = np.abs(right) <= BAND_M
    return {**asdict(label_error(labels, right)), "mean_near_mm": label_error(labels[near], right[near]).mean_mm}


def measure(pairs: list[list[Scene]], config: DatasetConfig, thin: int) -> dict[str, Any]:
    """CPU-seconds a scene and label errors of both methods, at the same points of the same scenes."""
    clocks = {"exact library": Clock(), "KD-tree of views": Clock()}
    found: dict[str, dict[str, list[np.ndarray]]] = {}
    truth: dict[str, list[np.ndarray]] = {shape: [] for shape in SHAPES}
    bounds = []
    for scenes in pairs:
        ours(scenes[:1], config, Clock())  # loads compiled code
        for scene, own in zip(scenes, ours(scenes, config, clocks["exact library"]), strict=True):
            labels = {"exact library": own}
            made = plain(scene, own["points"], thin, clocks["KD-tree of views"])
            labels |= {f"KD-tree, {kind} cloud": made[kind] for kind in made}
            right = exact(scene, own["points"])
            bounds.append(hand_depth_bound(scene.packed, scene.X_OH, scene.q, own["points"]))
            for shape in SHAPES:
                truth[shape].append(right[shape])
                for method, values in labels.items():
                    found.setdefault(method, {s: [] for s in SHAPES})[shape].append(values[shape])
    count = sum(map(len, pairs))
    return {
        "scenes": count,
        "points_per_scene": config.queries_per_scene,
        "thinned_to": thin,
        "cpu_s_per_scene": {
            name: {**{k: v / count for k, v in clock.seconds.items()}, "all": sum(clock.seconds.values()) / count}
            for name, clock in clocks.items()
        },
        "errors": {
            method: {shape: errors(np.concatenate(values[shape]), np.concatenate(truth[shape])) for shape in SHAPES}
            for method, values in found.items()
        },
        "hand_depth": {
            "inside": sum(b.inside for b in bounds),
            "lower_bound_only": sum(b.short for b in bounds),
            "short_by_p95_mm": max(b.p95_mm for b in bounds),
            "short_by_max_mm": max(b.max_mm for b in bounds),
        },
    }


def scenes_of(hands: list[str], objects: list[str], grasps: Mapping[tuple[str, str], GraspSet]) -> list[list[Scene]]:
    """Scenes by pair."""
    loaded = [load_hand(name) for name in hands]
    models = [load_object(source) for source in objects]
    frames = {obj.name: normalisation_of(obj.points_O) for obj in models}
    packed = {hand.name: pack_hand(hand, spacing=HAND_POINT_SPACING_M) for hand in loaded}
    return [
        [
            Scene(hand=h, packed=packed[h.name], obj=o, frame=frames[o.name], X_OH=np.array(X), q=np.array(q))
            for X, q in zip(grasps[h.name, o.name].X_OH, grasps[h.name, o.name].q, strict=True)
        ]
        for h in loaded
        for o in models
        if len(grasps[h.name, o.name])
    ]


def show(result: dict[str, Any]) -> None:
    print(f"{result['scenes']} scenes, {result['points_per_scene']} points each\n")
    print(f"{'labels':<26}{'shape':<8}{'mean mm':>9}{'in 5 cm':>9}{'p95 mm':>9}{'max mm':>10}{'wrong signs':>13}")
    for method, shapes in result["errors"].items():
        for shape, e in shapes.items():
            print(
                f"{method:<26}{shape:<8}{e['mean_mm']:>9.5f}{e['mean_near_mm']:>9.5f}{e['p95_mm']:>9.4f}{e['max_mm']:>10.4f}"
                f"{e['wrong_signs']:>13.4%}"
            )
    print()
    for method, parts in result["cpu_s_per_scene"].items():
        print(f"{method}: " + ", ".join(f"{name} {seconds:.3f}" for name, seconds in parts.items()) + " CPU-s a scene")
    depth = result["hand_depth"]
    print(
        f"\nOf {depth['inside']} points inside a hand the depth of {depth['lower_bound_only']} is a lower bound of the "
        f"union's: at most {depth['short_by_max_mm']:.1f} mm short."
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--objects", nargs="+", default=["ycb7"], help="names, mesh files or folders of them")
    parser.add_argument("--hands", nargs="+", default=["fetch", "allegro"], help="names or files, or all")
    parser.add_argument("--scenes", type=int, default=1, help="of each pair")
    parser.add_argument("--thin", type=int, default=18_900, help="points of a thinned cloud")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    options = parser.parse_args()
    hands, objects = list(hand_sources(options.hands)), list(object_sources(options.objects))
    config = SynthesisConfig(count=options.scenes)
    grasps = {}
    for hand in map(load_hand, hands):
        for obj in map(load_object, objects):
            grasps[hand.name, obj.name] = synthesise(hand, obj, config=config, seed=options.seed).grasps
    result = measure(
        scenes_of(hands, objects, grasps), DatasetConfig(seed=options.seed, clouds="rendered"), options.thin
    )
    show(result)
    if options.json is not None:
        options.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
