"""Colours of the report: one per hand everywhere, and a perceptual scale for contact maps."""

from __future__ import annotations

import numpy as np

# Five hues chosen for their look, then moved in lightness and hue until every pair is at least 0.1 apart in OKLab for
# normal, protan, deutan and tritan vision (tests/report/test_palette.py simulates them); each reads on white and black.
HAND_COLOURS: dict[str, str] = {
    "fetch": "#397ece",
    "panda": "#ee9935",
    "barrett": "#37b59c",
    "allegro": "#6c3ba0",
    "human": "#c44f6b",
}
_OTHER_COLOURS = ("#6b7280", "#a3a020", "#4fb3d9", "#8c564b", "#c04bb0", "#345c32")

OBJECT_COLOUR = "#ddd7cb"
GRAPHITE = "#59616c"

# Light to dark in OKLab: bare object, sand, amber, vermilion, wine. Lightness falls steadily, so the order survives
# printing in grey and every colour-vision type.
_CONTACT_STOPS = ("#e4dfd5", "#f3cf8e", "#ee9a4d", "#d9562f", "#a31d3b", "#5d0f3f")


def hand_colour(name: str) -> str:
    """Hex colour of a hand: fixed for the five built-in hands, and for any other a fixed function of its name."""
    if name in HAND_COLOURS:
        return HAND_COLOURS[name]
    return _OTHER_COLOURS[sum(name.encode()) % len(_OTHER_COLOURS)]


def linear_rgb(colour: str) -> np.ndarray:
    """(3,) float64 linear-light RGB in [0, 1] of a "#rrggbb" colour."""
    srgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    return srgb_to_linear(srgb)


def hex_colour(linear: np.ndarray) -> str:
    """The "#rrggbb" of a (3,) linear-light colour."""
    levels = np.round(linear_to_srgb(np.clip(linear, 0, 1)) * 255).astype(int)
    return "#" + "".join(f"{level:02x}" for level in levels)


def srgb_to_linear(srgb: np.ndarray) -> np.ndarray:
    """Linear light of sRGB values in [0, 1] (IEC 61966-2-1)."""
    srgb = np.asarray(srgb, np.float64)
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(linear: np.ndarray) -> np.ndarray:
    """sRGB values of linear light in [0, 1] (IEC 61966-2-1)."""
    linear = np.asarray(linear, np.float64)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


# Ottosson 2020, "A perceptual color space for image processing": linear sRGB -> cone response -> Lab.
_TO_LMS = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
_TO_LAB = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)


def oklab(linear: np.ndarray) -> np.ndarray:
    """(..., 3) OKLab coordinates (lightness in [0, 1], a, b) of linear-light colours."""
    return np.cbrt(np.asarray(linear) @ _TO_LMS.T) @ _TO_LAB.T


def from_oklab(lab: np.ndarray) -> np.ndarray:
    """(..., 3) linear-light colours of OKLab coordinates, clipped to [0, 1]."""
    return np.clip((lab @ np.linalg.inv(_TO_LAB).T) ** 3 @ np.linalg.inv(_TO_LMS).T, 0.0, 1.0)


def mix(first: np.ndarray, second: np.ndarray, weight: float) -> np.ndarray:
    """(3,) linear colour between two linear colours, perceptually even: `weight` 0 is `first`, 1 is `second`."""
    return from_oklab((1 - weight) * oklab(first) + weight * oklab(second))


def contact_colours(values: np.ndarray) -> np.ndarray:
    """Colours of contact values.

    Args:
        values: (...,) in [0, 1]; 0 is no contact (the bare object's colour), 1 touches. NaN counts as 0.
    Returns:
        (..., 3) float64 linear-light RGB.
    """
    stops = oklab(np.stack([linear_rgb(stop) for stop in _CONTACT_STOPS]))
    at = np.clip(np.nan_to_num(values, nan=0.0), 0.0, 1.0) * (len(stops) - 1)
    low = np.minimum(at.astype(int), len(stops) - 2)
    weight = (at - low)[..., None]
    return from_oklab((1 - weight) * stops[low] + weight * stops[low + 1])


def contact_gradient(steps: int = 16) -> str:
    """CSS `linear-gradient` stops of the contact scale, low to high."""
    colours = contact_colours(np.linspace(0, 1, steps))
    return ", ".join(hex_colour(colour) for colour in colours)
