"""Draw the README's picture from a finished demo: python docs/make_pictures.py out docs/images."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from neuralgrasps import load_hand, load_object
from neuralgrasps.grasps.grasp_io import load_grasps
from neuralgrasps.report.figures import render_grasp

HANDS = ("human", "allegro", "barrett", "panda", "fetch")
CHOICES = {"mustard_bottle": (2, 0, 0, 2, 0), "tomato_soup_can": (0, 1, 0, 0, 0), "cracker_box": (2, 0, 0, 1, 0)}
SIZE = (360, 280)


def hero(demo: Path) -> Image.Image:
    """A grid: one row per object, one column per hand."""
    rows = []
    for name, picks in CHOICES.items():
        obj = load_object(name)
        row = []
        for hand_name, pick in zip(HANDS, picks, strict=True):
            grasp = load_grasps(demo / "grasps" / name / f"{hand_name}.safetensors")[pick]
            row.append(render_grasp(load_hand(hand_name), obj, grasp.X_OH[0], grasp.q[0], size=SIZE))
        rows.append(np.concatenate(row, axis=1))
    picture = Image.fromarray(np.concatenate(rows, axis=0))
    page = Image.new("RGBA", picture.size, "#fafaf7")
    page.alpha_composite(picture)
    return page.convert("RGB")


if __name__ == "__main__":
    source, target = Path(sys.argv[1]), Path(sys.argv[2])
    hero(source).save(target / "hero.webp", quality=88, method=6)
