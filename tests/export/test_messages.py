"""The table of message fields, and the check against it."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from neuralgrasps.errors import DataFormatError, InputError, UnknownNameError
from neuralgrasps.export.messages import MESSAGES, Ros, check_message, clock, header, message_table, seconds_of


def example(kind: str, ros: Ros = 2) -> Any:
    """A message of a kind with something in every field."""
    if kind.endswith("[]"):
        return [example(kind[:-2], ros)] * 2
    table = message_table(ros)
    if kind in table:
        return {field: example(inner, ros) for field, inner in table[kind].items()}
    return {"string": "a"}.get(kind, 1.5 if kind.startswith("float") else 3)


def paths(data: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The places of all fields, also nested ones."""
    if isinstance(data, list):
        return [p for i, part in enumerate(data) for p in paths(part, (*path, i))]
    if not isinstance(data, dict):
        return []
    return [p for key, part in data.items() for p in ((*path, key), *paths(part, (*path, key)))]


def holder(data: Any, path: tuple[Any, ...]) -> Any:
    for step in path[:-1]:
        data = data[step]
    return data


@pytest.mark.parametrize("ros", (1, 2))
@pytest.mark.parametrize("kind", MESSAGES)
def test_every_missing_extra_and_mistyped_field_is_named(kind: str, ros: Ros) -> None:
    whole = example(kind, ros)
    check_message(kind, whole, ros=ros)
    for path in paths(whole):
        damaged = copy.deepcopy(whole)
        del holder(damaged, path)[path[-1]]
        with pytest.raises(DataFormatError, match=f"lacks {path[-1]};"):
            check_message(kind, damaged, ros=ros)
        damaged = copy.deepcopy(whole)
        holder(damaged, path)["colour"] = 1
        with pytest.raises(DataFormatError, match="has colour, which"):
            check_message(kind, damaged, ros=ros)
        for wrong in (None, True, {"a": 1}, float("nan")):
            damaged = copy.deepcopy(whole)
            holder(damaged, path)[path[-1]] = wrong
            with pytest.raises(DataFormatError, match=rf"\.{path[-1]} "):
                check_message(kind, damaged, ros=ros)


@pytest.mark.parametrize(
    ("kind", "field", "value"),
    (
        ("builtin_interfaces/Duration", "sec", 2**31),
        ("builtin_interfaces/Duration", "sec", 1.0),
        ("builtin_interfaces/Duration", "nanosec", -1),
        ("moveit_msgs/Grasp", "max_contact_force", 1e39),
        ("moveit_msgs/Grasp", "grasp_quality", float("inf")),
        ("moveit_msgs/Grasp", "grasp_quality", "0.5"),
        ("moveit_msgs/Grasp", "id", 7),
        ("moveit_msgs/Grasp", "allowed_touch_objects", "table"),
        ("moveit_msgs/Grasp", "allowed_touch_objects", [1]),
    ),
)
def test_values_outside_their_type_are_refused(kind: str, field: str, value: Any) -> None:
    message = example(kind)
    message[field] = value
    with pytest.raises(DataFormatError, match=field):
        check_message(kind, message)


def test_a_message_of_the_other_ros_is_refused() -> None:
    with pytest.raises(DataFormatError, match="seq"):
        check_message("std_msgs/Header", header("base", ros=1))
    with pytest.raises(DataFormatError, match="lacks seq"):
        check_message("std_msgs/Header", header("base"), ros=1)


def test_unknown_kinds_and_versions() -> None:
    with pytest.raises(UnknownNameError, match="moveit_msgs/Grasp"):
        check_message("moveit_msgs/Grasps", {})
    with pytest.raises(InputError, match="expected 1 or 2"):
        message_table(3)  # type: ignore[arg-type]


def test_times_are_whole_nanoseconds() -> None:
    assert clock(1.9999999999) == {"sec": 2, "nanosec": 0}
    assert clock(0.1) == {"sec": 0, "nanosec": 100_000_000}
    assert clock(12.000000001, ros=1) == {"secs": 12, "nsecs": 1}
    for seconds in (0.0, 0.3, 1 / 3, 1234.56789):
        assert abs(seconds_of(clock(seconds)) - seconds) <= 0.5e-9
        assert seconds_of(clock(seconds)) == seconds_of(clock(seconds, ros=1))
    for bad in (-0.1, float("nan"), float("inf"), 2.0**31):
        with pytest.raises(InputError, match="cannot be written"):
            clock(bad)
