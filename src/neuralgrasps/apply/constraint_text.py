"""Regions, approach cones and sides as people type them: "top:0.25", "box:0,0,0,.1,.1,.1", "-z" within "30deg"."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from neuralgrasps.apply.constraints import MARGIN_M, ApproachCone, GraspConstraints
from neuralgrasps.apply.regions import AXES, OUTER_THIRD, SIDES, Ball, Box, Points, Region, Side
from neuralgrasps.errors import InputError, unknown_name
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame_files import read_cloud

REGION_FORMS = "box:x0,y0,z0,x1,y1,z1, sphere:x,y,z,r (metres, object frame), file:points.ply"
_UNITS = {"deg": math.pi / 180, "°": math.pi / 180, "rad": 1.0}
_WORLD_WORDS = {"down": "world:-z", "up": "world:+z"}


def constraints_from_text(
    obj: ObjectModel,
    *,
    only_region: Sequence[str] = (),
    keep_free: Sequence[str] = (),
    approach: tuple[str, str] | None = None,
    up: str | None = None,
    margin_m: float = MARGIN_M,
) -> GraspConstraints:
    """Constraints on grasps of an object, as they are typed: keep_free=["top:0.25"], approach=("-z", "30deg"), up="+z".

    Args:
        only_region, keep_free: `parse_region` of each. approach: `parse_approach` of both.
        up: side that faces up on a table. margin_m: what the hand keeps from `keep_free`.
    Raises:
        InputError, UnknownNameError: a text that cannot be read, or constraints that no hand can meet.
    """
    fields = constraint_fields(
        only_region=only_region, keep_free=keep_free, approach=approach, up=up, margin_m=margin_m
    )
    return GraspConstraints(obj=obj, **fields)


def constraint_fields(
    *,
    only_region: Sequence[str],
    keep_free: Sequence[str],
    approach: tuple[str, str] | None,
    up: str | None,
    margin_m: float,
) -> dict[str, Any]:
    """What `GraspConstraints` takes besides the object, from texts; arguments as for `constraints_from_text`."""
    return {
        "only_region": parse_regions(only_region),
        "keep_free": parse_regions(keep_free),
        "approach": None if approach is None else parse_approach(*approach),
        "side_up": None if up is None else parse_side_up(up),
        "margin_m": margin_m,
    }


def parse_region(text: str) -> Region:
    """A region of an object's surface.

    Args:
        text: a side (+x -x +y -y +z -z top bottom side), with its share of the extent (`top:0.25`) if not the outer
            third; `box:x0,y0,z0,x1,y1,z1` or `sphere:x,y,z,r` in metres, object frame; `file:FILE`, points (.ply, .npy
            or text) with what lies within 5 mm of them.
    Raises:
        InputError, UnknownNameError: anything else, with what was expected.
    """
    word, _, rest = text.strip().partition(":")
    if word == "box":
        numbers = _numbers(text, rest, 6, "box:x0,y0,z0,x1,y1,z1")
        return Box((numbers[0], numbers[1], numbers[2]), (numbers[3], numbers[4], numbers[5]))
    if word in ("sphere", "ball"):
        numbers = _numbers(text, rest, 4, "sphere:x,y,z,r")
        return Ball((numbers[0], numbers[1], numbers[2]), numbers[3])
    if word == "file":
        if not rest:
            raise InputError(f"region '{text}' names no file; expected file:points.ply, points in the object's frame.")
        return Points(read_cloud(Path(rest)), name=text.strip())
    if word not in SIDES:
        error = unknown_name("region", text.strip(), SIDES)
        raise type(error)(f"{error} Or: {REGION_FORMS}.")
    if not rest and ":" not in text:
        return Side(word, OUTER_THIRD)
    return Side(word, _numbers(text, rest, 1, f"{word}:0.25, a share of the extent")[0])


def parse_regions(texts: Sequence[str]) -> tuple[Region, ...]:
    """`parse_region` of each.

    Raises:
        InputError: one text where a list of them is expected.
    """
    if isinstance(texts, str):
        raise InputError(f"regions are '{texts}'; expected a list of them, such as ['{texts}'].")
    return tuple(parse_region(text) for text in texts)


def parse_approach(axis: str, angle: str) -> ApproachCone:
    """An approach cone.

    Args:
        axis: +x -x +y -y +z -z or x,y,z in the object's frame; with `world:` before it in the world's; down is
            world:-z. It is the way the palm moves: -z comes from above.
        angle: half angle with its unit: 30deg, 0.5rad.
    """
    text = _WORLD_WORDS.get(axis.strip(), axis.strip())
    frame = "world" if text.startswith("world:") else "object"
    name = text.removeprefix("world:")
    if name in AXES:
        x, y, z = (float(v) for v in AXES[name])
    elif "," in name:
        x, y, z = _numbers(axis, name, 3, "an axis x,y,z such as 0,0.5,-1")
    else:
        known = (*AXES, *_WORLD_WORDS)
        error = unknown_name("approach axis", axis.strip(), known)
        raise type(error)(f"{error} Or x,y,z, and world: before any of them.")
    return ApproachCone(axis=(x, y, z), half_angle_rad=parse_angle(angle), frame=frame)


def parse_angle(text: str) -> float:
    """Radians of an angle with its unit, such as 30deg or 0.5rad."""
    for unit, factor in _UNITS.items():
        if text.strip().endswith(unit):
            return _numbers(text, text.strip().removesuffix(unit), 1, "an angle such as 30deg or 0.5rad")[0] * factor
    raise InputError(f"angle '{text}' has no unit; expected one such as 30deg or 0.5rad.")


def parse_side_up(text: str) -> str:
    """The axis of a side that faces up: +z for top."""
    name = {"top": "+z", "bottom": "-z"}.get(text.strip(), text.strip())
    if name not in AXES:
        raise unknown_name("side", text.strip(), (*AXES, "top", "bottom"))
    return name


def _numbers(text: str, values: str, count: int, expected: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(v) for v in values.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count:
        raise InputError(f"'{text.strip()}' cannot be read; expected {expected}.")
    return numbers
