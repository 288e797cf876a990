"""Whose hand it is: left or right, how large, and whether the camera's focal length lets it be anybody's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from neuralgrasps.human.fit.hand_fit import fit_hand
from neuralgrasps.human.fit.hand_misfit import misfit
from neuralgrasps.human.fit.hand_size import fit_size
from neuralgrasps.human.seen import Side
from neuralgrasps.human.video.focal import (
    FocalCheck,
    beyond_sizes,
    hand_focal,
    object_focal,
    out_of_sizes,
    size_doubt,
    size_words,
)
from neuralgrasps.human.video.hand_video import HandVideo
from neuralgrasps.human.video.sighting import side_vote

_SURE_SIDE = 0.2  # mean vote of the frames, -0.5 to 0.5
_OTHER: dict[Side, Side] = {"right": "left", "left": "right"}
_SIZE_FRAMES = 8
_SAME_CAMERA, _OTHER_CAMERA = 0.08, 0.12  # log ratio of focal lengths that is none, and that is one
_CONTRADICTS = 0.15  # a focal length that makes the hand so much larger or smaller than people's is none
_MISFIT_M = 0.009  # median `misfit` of the best frames that speaks against the camera or the joints


def decide_side(video: HandVideo, side: Side | None) -> None:
    """By what the frames say; when they are unsure, and for joints from elsewhere, the side whose hand fits better."""
    if side is not None:
        video.side = side
        return
    if video.reader is not None:
        vote = side_vote(list(video.boxes.values()))
        video.side = "right" if vote >= 0 else "left"
        if abs(vote) >= _SURE_SIDE:
            return
    said, other = video.side, _OTHER[video.side]
    numbers = sorted(video.boxes, key=lambda n: (-video.boxes[n].score, n))[:: max(1, len(video.boxes) // 6)][:6]
    apart = {one: _misfit_of_side(video, numbers, one) for one in (said, other)}
    if apart[other] < 0.9 * apart[said]:
        video.side = other
        video.notes.append(f"taken for a {said} hand at first, but a {other} one fits better.")


def _misfit_of_side(video: HandVideo, numbers: Sequence[int], side: Side) -> float:
    """Median misfit over some frames of hands of one side, metres."""
    apart = []
    for n in numbers:
        seen = video.see(n, side=side)
        if seen is not None:
            fitted = fit_hand(seen, video.cloud(n, side=side), side=side, scale=video.scale)
            apart.append(misfit(fitted, video.cloud(n, side=side)) / max(float(np.mean(seen.weight)), 0.05))
    return float(np.median(apart)) if apart else np.inf


def measure_hand(video: HandVideo, coarse: Sequence[int]) -> str:
    """Decide the hand's size from its best frames; why that cannot be done, or "".

    Another focal length is named when the object fits better with it. Where the object cannot be asked, or does not
    clearly prefer the given one, the hand's own size and misfit decide; `doubt_of_size` says what they leave open.
    """
    best = _best_frames(video, coarse)
    shown, clouds = [s for n in best if (s := video.see(n)) is not None], [video.cloud(n) for n in best]
    measured = video.scale is None
    if video.scale is None:
        video.scale = fit_size(shown, clouds, side=video.side, objs=[video.held(n) for n in best])
    apart = float(np.median([misfit(f, video.cloud(n)) for n in best if (f := video.fit(n)) is not None]))
    strange, loose = measured and out_of_sizes(video.scale), apart >= _MISFIT_M
    by_object = _object_focal(video, hidden=strange or loose)
    if measured and by_object is not None and beyond_sizes(video.scale / by_object.factor) > _CONTRADICTS:
        by_object = None  # it is not where it is thought to be
    if by_object is not None and by_object.off > _OTHER_CAMERA:
        return _wrong_camera(video, by_object, "the object")
    fine = by_object is not None and by_object.off <= _SAME_CAMERA
    sure = by_object is not None and by_object.sure
    if (strange and not sure) or (loose and not fine):
        by_hand = hand_focal(shown[::2], clouds[::2], side=video.side)
        if by_hand.off > _OTHER_CAMERA:
            return _wrong_camera(video, by_hand, "a hand of any person's size")
    if loose:
        video.notes.append(f"the hand model fits its points and joints only to {1e3 * apart:.0f} mm.")
    return ""


def doubt_of_size(video: HandVideo) -> str:
    """What the decided size says of the focal length; "" for a size that people's hands have."""
    return "" if video.scale is None else size_doubt(video.scale, video.frames[0].intrinsics.fx)


def _best_frames(video: HandVideo, coarse: Sequence[int]) -> list[int]:
    """The frames that show most of the hand, ascending."""

    def worth(n: int) -> float:
        seen = video.see(n)
        return 0.0 if seen is None else float(np.nansum(seen.weight)) * min(len(video.cloud(n)), 300)

    return sorted(sorted(coarse, key=lambda n: (-worth(n), n))[:_SIZE_FRAMES])


def _object_focal(video: HandVideo, *, hidden: bool) -> FocalCheck | None:
    """By the object in the first frame in which its pose is known and no hand is seen.

    Args:
        hidden: a frame with a hand will do.
    """
    known = np.flatnonzero(np.isfinite(video.X_CO).all(axis=(1, 2)))
    first_hand = min(video.boxes, default=0)
    usable = known if hidden else known[known < first_hand]
    if video.obj is None or not len(usable):
        return None
    number = int(usable[0])
    return object_focal(video.frames[number], video.obj, video.X_CO[number])


def _wrong_camera(video: HandVideo, check: FocalCheck, what: str) -> str:
    k, size = video.frames[0].intrinsics, ""
    if video.scale is not None and out_of_sizes(video.scale):
        size = f"; {size_words(video.scale)}"
    return (
        f"the intrinsics do not fit: with fx = {k.fx:.0f} {what} fits to {1e3 * check.residual_m:.1f} mm, with about "
        f"{k.fx * check.factor:.0f} to {1e3 * check.best_m:.1f} mm{size}. Give the focal lengths of the depth "
        "images, at their size (were they of another resolution, or of the colour camera?); or is the object of "
        "another size?"
    )
