"""Figures of Khargonkar et al. 2022 that ours are set beside, by object name without the YCB number.

The comparison is one of protocol, not of data: hands, grasps and the sampling of the object differ from the paper's.
"""

from __future__ import annotations

from collections.abc import Mapping

from neuralgrasps.errors import InputError

HANDS = ("fetch", "barrett", "human", "allegro", "panda")
"""The hands in the order of the paper's columns."""

Similarities = tuple[float, float, float, float]
"""Near Z, Near GT, Far Z, Far GT."""


def _chamfer_rows(*rows: tuple[str, tuple[float, ...]]) -> dict[str, dict[str, float]]:
    return {name: dict(zip(("object", *HANDS), values, strict=True)) for name, values in rows}


# Table 1, unseen grasps.
PUBLISHED_RETRIEVAL: Mapping[str, Similarities] = {
    "cracker_box": (0.81, 0.88, 0.19, 0.15),
    "tomato_soup_can": (0.73, 0.84, 0.13, 0.09),
    "mustard_bottle": (0.80, 0.87, 0.14, 0.10),
    "pudding_box": (0.77, 0.84, 0.25, 0.16),
    "gelatin_box": (0.75, 0.81, 0.22, 0.14),
    "potted_meat_can": (0.76, 0.83, 0.21, 0.12),
    "bleach_cleanser": (0.86, 0.91, 0.16, 0.13),
}
# Chamfer x 1e-3: object, then the hands in the order of `HANDS`; same table.
PUBLISHED_CHAMFER: Mapping[str, Mapping[str, float]] = _chamfer_rows(
    ("cracker_box", (1.33, 1.44, 5.52, 2.86, 3.03, 2.48)),
    ("tomato_soup_can", (2.60, 4.95, 4.06, 3.21, 3.97, 4.20)),
    ("mustard_bottle", (1.05, 2.38, 3.39, 2.05, 2.09, 4.14)),
    ("pudding_box", (1.49, 5.27, 8.27, 5.45, 3.80, 5.40)),
    ("gelatin_box", (1.20, 5.42, 7.04, 4.72, 3.74, 3.72)),
    ("potted_meat_can", (2.13, 3.63, 3.78, 3.06, 4.45, 1.78)),
    ("bleach_cleanser", (7.82, 2.45, 5.63, 7.22, 5.41, 14.08)),
)
# The table of training grasps.
PUBLISHED_TRAIN_RETRIEVAL: Mapping[str, Similarities] = {
    "cracker_box": (0.87, 0.88, 0.26, 0.24),
    "tomato_soup_can": (0.78, 0.79, 0.12, 0.10),
    "mustard_bottle": (0.83, 0.84, 0.19, 0.16),
    "pudding_box": (0.83, 0.84, 0.24, 0.23),
    "gelatin_box": (0.80, 0.81, 0.23, 0.21),
    "potted_meat_can": (0.79, 0.80, 0.14, 0.10),
    "bleach_cleanser": (0.72, 0.73, 0.18, 0.17),
}
PUBLISHED_TRAIN_CHAMFER: Mapping[str, Mapping[str, float]] = _chamfer_rows(
    ("cracker_box", (1.28, 4.06, 5.89, 6.36, 4.11, 7.84)),
    ("tomato_soup_can", (1.29, 3.77, 4.84, 2.91, 3.30, 3.12)),
    ("mustard_bottle", (0.99, 1.91, 3.22, 2.14, 1.98, 2.48)),
    ("pudding_box", (1.22, 5.14, 8.16, 6.55, 5.25, 6.11)),
    ("gelatin_box", (1.12, 5.53, 7.73, 4.66, 4.99, 4.73)),
    ("potted_meat_can", (1.96, 3.90, 5.23, 3.78, 3.77, 3.05)),
    ("bleach_cleanser", (7.09, 4.87, 6.12, 7.52, 5.50, 8.85)),
)


def published_chamfer_of(object_name: str, column: str, *, part: str = "test") -> float | None:
    """The paper's Chamfer, x 1e-3, of "object" or of a hand; None where it has none.

    Raises:
        InputError: part is neither "test" nor "train".
    """
    check_part(part)
    table = PUBLISHED_CHAMFER if part == "test" else PUBLISHED_TRAIN_CHAMFER
    return table.get(plain_name(object_name), {}).get(column)


def published_similarities(object_name: str, *, part: str = "test") -> Similarities | None:
    """The paper's Near Z, Near GT, Far Z, Far GT; None where it has none.

    Raises:
        InputError: part is neither "test" nor "train".
    """
    check_part(part)
    table = PUBLISHED_RETRIEVAL if part == "test" else PUBLISHED_TRAIN_RETRIEVAL
    return table.get(plain_name(object_name))


def check_part(part: str) -> None:
    """Refuse what is not a part of the data.

    Raises:
        InputError: it is neither "test" (unseen grasps) nor "train".
    """
    if part not in ("test", "train"):
        raise InputError(f"part is '{part}'; expected 'test' or 'train'.")


def plain_name(name: str) -> str:
    """An object's name without its YCB number: "003_cracker_box" -> "cracker_box"."""
    head, _, rest = name.partition("_")
    return rest if head.isdigit() and rest else name
