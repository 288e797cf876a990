"""What may be wrong with the frames of a demonstration, or with their camera, where the object is not as expected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.hands.hand import Hand
from neuralgrasps.human.video.focal import parabola_factor
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame
from neuralgrasps.perception.object_sighting import sight
from neuralgrasps.perception.object_video import FollowedObject, Hidden

_LEAST_MEASURED = 0.4  # share of the pixels in the middle of the image that should have a depth
_NEAREST_M, _FARTHEST_M = 0.25, 2.0  # where the object is expected
_FACTORS = (0.55, 0.65, 0.75, 0.87, 1.15, 1.33, 1.55, 1.8)  # focal lengths tried, times the given one
_WELL = 0.93  # an object that is explained so well needs no other camera
_SURE, _GAIN = 0.9, 0.1  # confidence, and how much better it is explained, from which another focal length is named


def check_given(frames: object, obj: object, hand: object) -> None:
    """Refuse names of things in place of the things.

    Raises:
        InputError: says which, and what makes the thing of the name.
    """
    few = frames[0] if isinstance(frames, Sequence) and frames and not isinstance(frames, str) else frames
    listed = isinstance(frames, Sequence) and not isinstance(frames, str)
    if not listed or not (isinstance(few, Frame) or few is frames):
        said = f"list of {type(few).__name__}" if listed else type(frames).__name__
        raise InputError(f"frames is a {said}; expected frames: ng.read_frames('video').")
    if not isinstance(obj, ObjectModel):
        raise InputError(f"obj is a {type(obj).__name__}; expected an object: ng.load_object('mustard_bottle').")
    if not isinstance(hand, Hand):
        raise InputError(f"hand is a {type(hand).__name__}; expected a hand: ng.load_hand('fetch').")


def depth_trouble(frames: Sequence[Frame]) -> str:
    """What speaks against the depth of the frames, as sentences after a blank; "" when nothing does.

    Both are of the middle half of the images, and the median over the frames.
    """
    middles = [_middle(frame.depth) for frame in frames]
    measured = float(np.median([(depth > 0).mean() for depth in middles]))
    medians = [np.median(depth[depth > 0]) for depth in middles if (depth > 0).any()]
    said = ""
    if measured < _LEAST_MEASURED:
        said += (
            f" Only {100 * measured:.0f} % of the pixels in the middle of the images have a depth (expected at least "
            f"{100 * _LEAST_MEASURED:.0f} %): is the camera too near, in sunlight, or looking at something shiny?"
        )
    if medians and not _NEAREST_M <= (z := float(np.median(medians))) <= _FARTHEST_M:
        said += (
            f" The median depth there is {z:.2f} m; expected {_NEAREST_M:g} to {_FARTHEST_M:g} m: check the depth "
            f"scale, or move the camera {'nearer' if z > _FARTHEST_M else 'away'}."
        )
    return said


def camera_trouble(
    frames: Sequence[Frame], obj: ObjectModel, followed: FollowedObject, hidden: Hidden, *, seed: int = 0
) -> str:
    """That another focal length would explain the object much better than the given one; "" when none does.

    The whole search is repeated with each: with a wrong camera the object may be far from where it was thought to be.
    """
    # A frame with the person is no witness where there is one without.
    number = 0 if hidden(0) is None else max(followed.found_in, 0)
    good = not followed.reason and followed.pose is not None and followed.pose.score >= _WELL
    if good and (hidden(number) is not None or hidden(followed.found_in) is None):
        return ""
    seen = {f: _explained(frames[number], number, obj, f, hidden(number), seed) for f in (1.0, *_FACTORS)}
    share = seen[1.0][0]
    best = max(seen, key=lambda f: seen[f][0] * (seen[f][1] >= _SURE))
    most, confidence = seen[best]
    if confidence < _SURE or most < share + _GAIN:
        return ""
    fx = frames[number].intrinsics.fx
    return (
        f"the intrinsics do not fit: with fx = {fx:.0f} '{obj.name}' explains {100 * share:.0f} % of what stands "
        f"there, with about {fx * parabola_factor({f: -s for f, (s, _) in seen.items()}, best):.0f} "
        f"{100 * most:.0f} %. Give the focal lengths of the depth images, at their size (were they of another "
        "resolution, or of the colour camera?); or is the object another one, or of another size?"
    )


def _explained(
    frame: Frame, number: int, obj: ObjectModel, factor: float, hidden: np.ndarray | None, seed: int
) -> tuple[float, float]:
    """Share of the view that the object explains when the focal lengths are `factor` times as long; the confidence."""
    k = frame.intrinsics
    camera = replace(k, fx=k.fx * factor, fy=k.fy * factor)
    found = sight(replace(frame, intrinsics=camera), number, obj, hidden=hidden, seed=seed)
    return (0.0, 0.0) if isinstance(found, str) else (found.pose.score, found.pose.confidence)


def _middle(depth: np.ndarray) -> np.ndarray:
    """The middle half of an image, both ways."""
    h, w = depth.shape
    return depth[h // 4 : h - h // 4, w // 4 : w - w // 4]
