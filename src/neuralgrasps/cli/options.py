"""Option types of the commands, with the words their help shows."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from neuralgrasps.errors import InputError

_NO_DEFAULT = "(optional)"

File = Annotated[Path, tyro.conf.arg(metavar="FILE")]
Folder = Annotated[Path, tyro.conf.arg(metavar="DIR")]
OptionalFile = Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint=_NO_DEFAULT)]
OptionalFolder = Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint=_NO_DEFAULT)]
OptionalText = Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint=_NO_DEFAULT)]
OptionalInt = Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint=_NO_DEFAULT)]
OptionalFloat = Annotated[float | None, tyro.conf.arg(metavar="FLOAT", help_behavior_hint=_NO_DEFAULT)]
Workers = Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="(default: all cores)")]
Names = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME|FILE ...", help_behavior_hint="(default: none)")]
Protocols = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")]
AllNames = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME|FILE ...", help_behavior_hint="(default: all)")]
NamePath = Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="NAME|FILE")]
PositionalFile = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
PositionalFolder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
Cone = Annotated[
    tuple[str, ...], tyro.conf.arg(metavar="AXIS ANGLE", help_behavior_hint="(optional), such as down 30deg")
]
Unit = Literal["auto", "m", "mm", "cm", "inch"]


def check_seed(seed: int) -> None:
    """Refuse negative seeds, which not every generator takes.

    Raises:
        InputError: the seed is negative.
    """
    if seed < 0:
        raise InputError(f"--seed is {seed}; expected 0 or more.")


def read_cone(texts: tuple[str, ...]) -> tuple[str, str] | None:
    """The axis and the angle of --approach; None when it is not given.

    Raises:
        InputError: not two words.
    """
    if not texts:
        return None
    if len(texts) != 2:
        raise InputError(f"--approach is '{' '.join(texts)}'; it takes an axis and an angle, such as: down 30deg.")
    return texts[0], texts[1]
