"""What benchmarks share: options over their defaults, the conditions they say, and figures that are absent."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any, TypeVar

from neuralgrasps.cli.terminal import Terminal

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from neuralgrasps.objects.object_model import ObjectModel

    Config = TypeVar("Config", bound=DataclassInstance)


def with_options(config: Config, **given: int | None) -> Config:
    """The configuration with the options that were given; None is not given."""
    return replace(config, **{name: value for name, value in given.items() if value is not None})


def conditions(
    config: DataclassInstance, objects: Mapping[str, ObjectModel], *, quick: bool, workers: int | None, **more: Any
) -> dict[str, Any]:
    """What was measured, as JSON: the configuration, the processes, where each object is from, and `more`."""
    from neuralgrasps.parallel import available_cpus

    return {
        **asdict(config),
        "quick": quick,
        "workers": workers or available_cpus(),
        "objects": object_origins(objects),
        **more,
    }


def object_origins(objects: Mapping[str, ObjectModel]) -> dict[str, str]:
    """Where each object is from, as its provenance says."""
    return {name: obj.provenance.get("source", "") for name, obj in objects.items()}


def absent_figures(
    terminal: Terminal, figures: Collection[str], expected: Iterable[str], reasons: Mapping[str, str]
) -> dict[str, str]:
    """Which figures are absent, and why, also printed: those of `reasons`, and what else was expected."""
    missing = [name for name in expected if name not in figures and name not in reasons]
    absent = dict(reasons) | dict.fromkeys(missing, "not measured")
    for why in dict.fromkeys(absent.values()):
        terminal.say(f"absent: {', '.join(name for name in absent if absent[name] == why)}: {why}")
    return absent
