"""Which object of a library is it, or none of them?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.pose import PoseConfig, PoseResult, observe, result_of
from neuralgrasps.perception.pose_model import pose_model
from neuralgrasps.perception.pose_search import NO_CONTACTS, search

SHARPNESS = 40.0  # of the probabilities: a cost lower by 1 / SHARPNESS makes an object e times as likely
NONE_COST = 0.40  # "none of these" is as likely as an object that explains the view at this cost


@dataclass(frozen=True, slots=True, kw_only=True)
class Identification:
    """Which object a view shows.

    Attributes:
        name: the most likely object; None when it is most likely none of the library.
        probability: of every object of the library; with `none_probability` they sum to 1.
        none_probability: that it is none of them.
        poses: the pose of every object, as if it were the one.
    """

    name: str | None
    probability: Mapping[str, float]
    none_probability: float
    poses: Mapping[str, PoseResult]


def identify_object(
    objects: Sequence[ObjectModel],
    points_C: np.ndarray | None = None,
    *,
    depth: np.ndarray | None = None,
    intrinsics: Intrinsics | None = None,
    mask: np.ndarray | None = None,
    table: Plane | None = None,
    config: PoseConfig | None = None,
    seed: int = 0,
) -> Identification:
    """Find out which object is seen, by how well each explains the view in its best pose.

    Args:
        objects: the library; names must differ. The rest as for `estimate_pose`.
    Raises:
        InputError: an empty library or a name that occurs twice; see `estimate_pose`.
    """
    names = [obj.name for obj in objects]
    if not names or len(set(names)) < len(names):
        raise InputError(f"the library holds {names or 'no objects'}; expected at least one, each name once.")
    config = config or PoseConfig()
    poses, cost = {}, []
    scene = observe(
        points_C, depth=depth, intrinsics=intrinsics, mask=mask, table=table,
        reach_m=max(pose_model(obj).diameter for obj in objects), seed=seed,
    )  # fmt: skip
    for obj in objects:
        model = pose_model(obj)
        found = search(model, scene, NO_CONTACTS, config)
        poses[obj.name] = result_of(model, scene, found, config, seed)
        cost.append(float(found.cost[0]))
    weight = np.exp(-SHARPNESS * (np.array([*cost, NONE_COST]) - min(*cost, NONE_COST)))
    weight /= weight.sum()
    best = int(weight.argmax())
    return Identification(
        name=names[best] if best < len(names) else None,
        probability=dict(zip(names, weight[:-1].tolist(), strict=True)),
        none_probability=float(weight[-1]),
        poses=poses,
    )
