"""Compile the hot loops once, on several cores, before they are needed; later runs find them on disk.

Without this, every worker of the next stage would compile the same loops at the same time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from neuralgrasps.demo.execution import compile_pictures, compile_planning
from neuralgrasps.demo.measure import pose_trials
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.geometry.sdf_grid import SdfGrid
from neuralgrasps.grasps.contact import find_contacts
from neuralgrasps.grasps.epsilon import epsilon
from neuralgrasps.grasps.force_qp import contact_forces
from neuralgrasps.grasps.penetration import penetration_depths
from neuralgrasps.grasps.wrench_space import grasp_wrenches
from neuralgrasps.hands.packed import pack_hand
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.kinematics.forward_kernels import forward_fast
from neuralgrasps.model.infer import InferConfig, infer_grasps
from neuralgrasps.model.kinematic_field import KinematicField
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.zoo import load_object
from neuralgrasps.parallel import run_tasks
from neuralgrasps.report.figures import render_object
from neuralgrasps.synthesis.candidates import CONE_EDGES
from neuralgrasps.synthesis.synthesise import SynthesisConfig, synthesise


def load_and_compile(sources: Sequence[str], *, workers: int) -> Iterator[tuple[int, ObjectModel | None]]:
    """Yield (index of the source, object) as they load; the loops of later stages are compiled beside it.

    The index is -1, and the object None, for a piece of compilation.
    """
    first: ObjectModel | None = None
    for index, result in run_tasks(
        _call, [(load_object, sources[0]), (_quality,), (_contacts,), (_pictures,)], workers=workers
    ):
        if index == 0:
            first = result
            yield 0, first
        else:
            yield -1, None
    loading = [(load_object, source) for source in sources[1:]]
    longest = [(compile_planning, first), (_closing, first)]
    others = [(_pose, first), (_fit, first), (compile_pictures, first)]
    for index, result in run_tasks(_call, [*longest, *loading, *others], workers=workers):
        source = index - len(longest) + 1
        yield (source, result) if 1 <= source < len(sources) else (-1, None)


def _call(function: Callable[..., Any], *arguments: Any) -> Any:
    return function(*arguments)


def _cross() -> tuple[np.ndarray, np.ndarray]:
    """Six contacts on the axes of a 10 cm ball: points and outward normals."""
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    return 0.05 * normals, normals


def _quality() -> None:
    points, normals = _cross()
    wrenches = grasp_wrenches(points, normals, np.zeros(3), 0.6, CONE_EDGES, 0.02, 0.05)
    epsilon(wrenches)
    contact_forces(points, normals, np.zeros(3), 0.6)


def _contacts() -> None:
    hand = load_hand("barrett")
    packed = pack_hand(hand, spacing=0.009)
    sdf = SdfGrid(np.zeros((4, 4, 4), np.float32), np.zeros(3), 0.02)
    X_OH, q = np.eye(4)[None], hand.q_open[None].copy()
    penetration_depths(packed, sdf, _cross()[0], X_OH=X_OH, q=q)
    room = 3 * hand.tree.num_links
    find_contacts(
        sdf.values, sdf.origin, sdf.inv_spacing, packed, X_OH[0], forward_fast(hand.tree, q)[0], 0.002, 3,
        np.empty((room, 3)), np.empty((room, 3)), np.empty(room, np.int32),
    )  # fmt: skip


def _closing(obj: ObjectModel) -> None:
    for name in ("barrett", "fetch"):
        synthesise(load_hand(name), obj, config=SynthesisConfig(count=1, batch=128, draws=1, max_rounds=1, spare=0.1))


def _pictures() -> None:
    render_object(box_mesh([0.05, 0.05, 0.05]))


def _pose(obj: ObjectModel) -> None:
    pose_trials([obj], views=1, seed=0)


def _fit(obj: ObjectModel) -> None:
    hand = load_hand("fetch")
    field = KinematicField(hands={hand.name: hand}, objects={obj.name: obj})
    X_OH, q = np.eye(4)[None], hand.q_open[None].copy()
    gallery = field.encode(X_OH, q, hand=hand.name, object_name=obj.name)
    config = InferConfig(points=32, coarse_points=16, starts=1, finalists=1, coarse_iterations=2, fine_iterations=2)
    infer_grasps([_cross()[0].repeat(3, axis=0)], field, gallery, hand=hand.name, object_name=obj.name, config=config)
