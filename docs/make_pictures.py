"""Draw the README's picture from a finished demo: python docs/make_pictures.py out docs/images.

Also the previews of the built-in arms: python docs/make_pictures.py arms src/neuralgrasps/assets/arms,
the picture of picks: python docs/make_pictures.py picks docs/images,
and the moving one of a demonstration: python docs/make_pictures.py demonstrate docs/images.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from neuralgrasps import ExecuteConfig, draw_scene, execute_trial, load_hand, load_object
from neuralgrasps.apply.demonstrate import DemonstrateConfig, demonstrate
from neuralgrasps.arms.mount import mount
from neuralgrasps.arms.zoo import load_arm
from neuralgrasps.evaluate.demonstrate_execute import execute_demonstration
from neuralgrasps.grasps.grasp_io import load_grasps
from neuralgrasps.human.synthetic.demonstration import DemonstrationConfig, record_demonstration
from neuralgrasps.human.video.look import LookConfig
from neuralgrasps.human.video.watch import WatchConfig
from neuralgrasps.report.arm_figure import render_arm
from neuralgrasps.report.demonstration_page import drawn_frames
from neuralgrasps.report.demonstration_pictures import Demonstrated
from neuralgrasps.report.figures import render_grasp
from neuralgrasps.report.film import FilmConfig, film_indices, open_film
from neuralgrasps.report.hand_overlay import focus_window, render_hand_overlay
from neuralgrasps.report.trial_pictures import PICTURES, strip_pictures
from neuralgrasps.report.video import animation
from neuralgrasps.report.views import view_direction

HANDS = ("human", "allegro", "barrett", "panda", "fetch")
CHOICES = {"mustard_bottle": (2, 0, 0, 2, 0), "tomato_soup_can": (0, 1, 0, 0, 0), "cracker_box": (2, 0, 0, 1, 0)}
SIZE = (360, 280)
HALF, FPS, REST = (420, 315), 8, 4  # the moving picture: size of each half, frames a second, frames that it rests
NEAR = 10  # its left half shows where the hand is from so many frames before the grasp on
SHOWN = ("mustard_bottle", 1)  # object and seed of the demonstration
PICKS = (("fetch", "fetch", "mustard_bottle", 14), ("panda", "allegro", "potted_meat_can", 3))


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
    return on_paper(np.concatenate(rows, axis=0))


def arm_preview(arm_name: str, hands: tuple[str, str]) -> Image.Image:
    """An arm at home with one hand and with another, side by side."""
    views = (view_direction(-50, 16), view_direction(-28, 16))
    robots = [mount(load_arm(arm_name), load_hand(hand)) for hand in hands]
    row = [render_arm(robot, view=view, size=(300, 300)) for robot, view in zip(robots, views, strict=True)]
    return on_paper(np.concatenate(row, axis=1))


def picks() -> Image.Image:
    """One row per pick: what the camera saw, before the approach, the hand closed, the end."""
    rows = []
    for arm_name, hand_name, object_name, seed in PICKS:
        robot = mount(load_arm(arm_name), load_hand(hand_name))
        scene = draw_scene([load_object(object_name)], robot.arm, seed=seed)
        config = ExecuteConfig(retries=0, record_every_s=0.04)
        trial = execute_trial(scene, robot, config=config, seed=seed)
        pictures = strip_pictures(open_film(trial, robot))
        row = [Image.fromarray(pictures[name]).resize((480, 360), Image.Resampling.LANCZOS) for name in PICTURES]
        rows.append(np.concatenate([np.asarray(picture) for picture in row], axis=1))
    return Image.fromarray(np.concatenate(rows, axis=0))


def demonstration() -> bytes:
    """A person's grasp with the hand that was fitted to it, then the robot's, side by side and one after the other."""
    name, seed = SHOWN
    obj, robot = load_object(name), mount(load_arm("fetch"), load_hand("fetch"))
    video = DemonstrationConfig(side="right", still_frames=(6, 8), lift=True, wall=False)
    frames = record_demonstration(obj, seed=seed, config=video).frames
    every = DemonstrateConfig(watch=WatchConfig(look=LookConfig(frames=len(frames))))
    demo = demonstrate(frames, obj, robot.hand, side="right", config=every, seed=seed)
    trial = execute_demonstration(demo, obj, robot, config=ExecuteConfig(record_every_s=0.04), seed=seed)
    film = open_film(trial, robot)
    seen = _seen(drawn_frames(frames, demo, obj), HALF)
    lifted = [_sized(film.moment(k), HALF) for k in film_indices(trial, FilmConfig(speed=3.0, fps=FPS))]
    first, second = [(left, lifted[0]) for left in seen], [(seen[-1], right) for right in lifted]
    pairs = [*first, *first[-1:] * REST, *second, *second[-1:] * 2 * REST]
    pictures = [np.concatenate(pair, axis=1) for pair in pairs]
    return animation(pictures, fps=FPS, size=(2 * HALF[0], HALF[1]), quality=76)


def _seen(shown: Demonstrated, size: tuple[int, int]) -> list[np.ndarray]:
    """The frames of a video with the fitted hand and the object's lines over them."""
    near = shown.layers[max(shown.moment - NEAR, 0) :]
    window = focus_window([one for one in near if one.fitted is not None], shown.frames[0].intrinsics)
    pictures = []
    for index, (frame, layers) in enumerate(zip(shown.frames, shown.layers, strict=True)):
        # the object is followed for as long as it stands
        own = replace(layers, box=None, joints=None, mesh=layers.mesh if index <= shown.moment else None)
        drawn = render_hand_overlay(
            frame.colour, own, frame.intrinsics, depth=frame.depth, window=window, scale=2, labels=False
        )  # fmt: skip
        pictures.append(_sized(drawn, size))
    return pictures


def _sized(picture: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    return np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.LANCZOS))


def on_paper(picture: np.ndarray) -> Image.Image:
    """The picture (height, width, 4) uint8 RGBA on the paper of the pages."""
    image = Image.fromarray(picture)
    page = Image.new("RGBA", image.size, "#fafaf7")
    page.alpha_composite(image)
    return page.convert("RGB")


if __name__ == "__main__":
    source, target = Path(sys.argv[1]), Path(sys.argv[2])
    if source.name == "arms":
        for name, hands in (("fetch", ("fetch", "allegro")), ("panda", ("panda", "allegro"))):
            arm_preview(name, hands).save(target / name / "preview.png", optimize=True)
        sys.exit()
    if source.name == "picks":
        picks().save(target / "execute.webp", quality=86, method=6)
        sys.exit()
    if source.name == "demonstrate":
        (target / "demonstrate.webp").write_bytes(demonstration())
        sys.exit()
    hero(source).save(target / "hero.webp", quality=88, method=6)
