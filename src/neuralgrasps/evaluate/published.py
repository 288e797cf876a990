"""Figures of Khargonkar et al. 2022 that ours are set beside, by object name without the YCB number."""

from __future__ import annotations

from collections.abc import Mapping

# Near Z, Near GT, Far Z, Far GT on unseen grasps: Khargonkar et al. 2022, Table 1.
PUBLISHED_RETRIEVAL: Mapping[str, tuple[float, float, float, float]] = {
    "cracker_box": (0.81, 0.88, 0.19, 0.15),
    "tomato_soup_can": (0.73, 0.84, 0.13, 0.09),
    "mustard_bottle": (0.80, 0.87, 0.14, 0.10),
    "pudding_box": (0.77, 0.84, 0.25, 0.16),
    "gelatin_box": (0.75, 0.81, 0.22, 0.14),
    "potted_meat_can": (0.76, 0.83, 0.21, 0.12),
    "bleach_cleanser": (0.86, 0.91, 0.16, 0.13),
}
# Chamfer x 1e-3 on unseen grasps: object, then hands; same source.
PUBLISHED_CHAMFER: Mapping[str, Mapping[str, float]] = {
    "cracker_box": {"object": 1.33, "fetch": 1.44, "barrett": 5.52, "human": 2.86, "allegro": 3.03, "panda": 2.48},
    "tomato_soup_can": {
        "object": 2.60,
        "fetch": 4.95,
        "barrett": 4.06,
        "human": 3.21,
        "allegro": 3.97,
        "panda": 4.20,
    },
    "mustard_bottle": {
        "object": 1.05,
        "fetch": 2.38,
        "barrett": 3.39,
        "human": 2.05,
        "allegro": 2.09,
        "panda": 4.14,
    },
    "pudding_box": {"object": 1.49, "fetch": 5.27, "barrett": 8.27, "human": 5.45, "allegro": 3.80, "panda": 5.40},
    "gelatin_box": {"object": 1.20, "fetch": 5.42, "barrett": 7.04, "human": 4.72, "allegro": 3.74, "panda": 3.72},
    "potted_meat_can": {
        "object": 2.13,
        "fetch": 3.63,
        "barrett": 3.78,
        "human": 3.06,
        "allegro": 4.45,
        "panda": 1.78,
    },
    "bleach_cleanser": {
        "object": 7.82,
        "fetch": 2.45,
        "barrett": 5.63,
        "human": 7.22,
        "allegro": 5.41,
        "panda": 14.08,
    },
}


def plain_name(name: str) -> str:
    """An object's name without its YCB number: "003_cracker_box" -> "cracker_box"."""
    head, _, rest = name.partition("_")
    return rest if head.isdigit() and rest else name
