"""Which object of a library is it, or none of them?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.pose import PoseConfig, PoseResult, observe, result_of
from neuralgrasps.perception.pose_model import pose_model
from neuralgrasps.perception.pose_search import NO_CONTACTS, search

_SUREST = 1.0e-6  # confidences are not taken closer to 0 or 1
_NAMED = 0.35  # least probability of an object to be named
_SEARCHED_WIDELY = 3  # so many objects, where none explains the view well


@dataclass(frozen=True, slots=True, kw_only=True)
class Identification:
    """Which object a view shows.

    Attributes:
        name: the likeliest object, when its probability is at least 0.35 and above that of none; else None.
        probability: of every object of the library, that it is there in the pose found; with `none_probability`, that
            nothing of the library is, they sum to 1.
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
    """Find out which object is seen: each is placed as well as it can be, and the confidences of the poses decide.

    Args:
        objects: the library; names must differ. The rest as for `estimate_pose`.
    Raises:
        InputError: an empty library or a name that occurs twice; see `estimate_pose`.
    """
    names = checked_names(objects)
    config = config or PoseConfig()
    poses = {}
    scene = observe(
        points_C, depth=depth, intrinsics=intrinsics, mask=mask, table=table,
        reach_m=max(pose_model(obj).diameter for obj in objects), seed=seed,
    )  # fmt: skip
    narrow, cost = replace(config, wide=1), {}
    for obj in objects:
        model = pose_model(obj)
        found = search(model, scene, NO_CONTACTS, narrow)
        poses[obj.name], cost[obj.name] = (
            result_of(model, scene, found, config, seed, present=False),
            float(found.cost[0]),
        )
    for obj in sorted(objects, key=lambda one: cost[one.name])[:_SEARCHED_WIDELY]:
        if config.wide > 1 and cost[obj.name] > config.wide_cost and min(cost.values()) > config.wide_cost:
            model = pose_model(obj)
            wide = search(model, scene, NO_CONTACTS, config)
            poses[obj.name] = result_of(model, scene, wide, config, seed, present=False)
    confidence = np.clip([poses[name].confidence for name in names], _SUREST, 1.0 - _SUREST)
    odds = confidence / (1.0 - confidence)  # of each object against none of the library
    none = 1.0 / (1.0 + odds.sum())
    best = int(odds.argmax())
    return Identification(
        name=names[best] if odds[best] > 1.0 and odds[best] * none >= _NAMED else None,
        probability=dict(zip(names, (odds * none).tolist(), strict=True)),
        none_probability=float(none),
        poses=poses,
    )


def checked_names(objects: Sequence[ObjectModel]) -> list[str]:
    """Names of a library.

    Raises:
        InputError: not objects, none, or a name that occurs twice.
    """
    if isinstance(objects, ObjectModel) or not all(isinstance(obj, ObjectModel) for obj in objects):
        raise InputError("the library is a list of objects; load each with load_object(name or mesh file).")
    names = [obj.name for obj in objects]
    if not names or len(set(names)) < len(names):
        raise InputError(f"the library holds {names or 'no objects'}; expected at least one, each name once.")
    return names
