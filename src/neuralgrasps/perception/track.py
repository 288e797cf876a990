"""Follow an object from frame to frame: the last pose is the only start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import checked_pose
from neuralgrasps.perception.observation import MIN_POINTS, observe_around
from neuralgrasps.perception.pose import PoseConfig, PoseResult, observe, result_of
from neuralgrasps.perception.pose_model import pose_model
from neuralgrasps.perception.pose_search import NO_CONTACTS, polished

_GATES_M = (0.025, 0.008)  # pixels belong to the object when they lie so near to it, before and after the first polish


def track_pose(
    obj: ObjectModel,
    depth: np.ndarray,
    intrinsics: Intrinsics,
    X_CO_before: np.ndarray,
    *,
    table: Plane | None = None,
    mask: np.ndarray | None = None,
    config: PoseConfig | None = None,
    seed: int = 0,
) -> PoseResult:
    """The object's pose in a frame, starting at its pose in the frame before.

    For motions of up to about 2 cm and 15 degrees between frames. Look at `confidence`: when it drops the object is
    lost, and `estimate_pose` must find it again.

    Args:
        depth: (h, w) z-depth, metres; 0, inf or nan = nothing measured.
        X_CO_before: (4, 4) object in the camera frame, a frame ago.
        table: plane that the object rests on, if it does; keeps its points apart from the object's.
        mask: (h, w) bool, the object's pixels; without it, those near the object's last pose.
    Raises:
        InputError: a depth image of another size, or fewer than 20 measured points where the object was.
    """
    config = config or PoseConfig()
    model = pose_model(obj)
    before = checked_pose(X_CO_before, "X_CO_before")[None]
    X = before.copy()
    for stage, gate_m in enumerate(_GATES_M, start=1):
        if mask is None:
            scene = observe_around(depth, intrinsics, model, X[0], gate_m=gate_m, table=table, seed=seed)
        else:
            scene = observe(
                None, depth=depth, intrinsics=intrinsics, mask=mask, table=table, reach_m=model.diameter, seed=seed
            )
        if len(scene.points) < MIN_POINTS:
            raise InputError(
                f"{len(scene.points)} points were measured near the last pose of '{obj.name}'; expected at least "
                f"{MIN_POINTS}. It has left the view or is hidden: find it again with estimate_pose."
            )
        if stage == 1:
            X = polished(model, scene, NO_CONTACTS, X, config, 0).X_CO
        found = polished(model, scene, NO_CONTACTS, X, config, stage)
        X = found.X_CO
    stayed = polished(model, scene, NO_CONTACTS, before, replace(config, steps=(0, 0, 0)), 2)
    if stayed.cost[0] <= found.cost[0]:  # no drift on a still image
        found = stayed
    return result_of(model, scene, found, config, seed)
