"""Pictures of a human demonstration: a strip and a film with what was seen, the grasp from two sides, robot grasps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image

from neuralgrasps.grasps.contact_map import contact_map_packed
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import pack_shapes
from neuralgrasps.hands.surface import hand_part_meshes
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame
from neuralgrasps.report.demonstration_content import Picture
from neuralgrasps.report.figures import fine_mesh, render_grasp, render_object
from neuralgrasps.report.hand_overlay import HandLayers, Window, focus_window, render_hand_overlay
from neuralgrasps.report.video import animation
from neuralgrasps.report.views import best_direction, upright

STRIP = 6
_CLOSE_M = 0.015  # decay of the closeness that is drawn: sharper than the maps that are compared
_STRIP_SIZE, _CLOSE_SIZE, _VIEW_SIZE, _CARD_SIZE = (480, 360), (840, 630), (640, 480), (420, 315)
_LOOP_SIZE, _LOOP_FPS, _LOOP_FRAMES = (560, 420), 6, 26
_REST = 5  # frames that the film rests at its end
_TURN_RAD = 2.2  # from the first side of a grasp to the second


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Demonstrated:
    """What is drawn: the frames (T), what was seen in each, the grasp's (-1: none), those looked at for a hand."""

    frames: Sequence[Frame]
    layers: Sequence[HandLayers]
    moment: int
    looked: frozenset[int]

    @property
    def window(self) -> Window:
        """One part of the image for all frames, so that they look alike: around the hands and the object."""
        last = self.moment if self.moment >= 0 else len(self.frames) - 1
        shown = [layer for layer in self.layers[: last + 1] if layer.box is not None or layer.fitted is not None]
        shown = shown or [layer for layer in self.layers if layer.mesh is not None]
        return focus_window(shown, self.frames[0].intrinsics)


def strip_indices(has_hand: np.ndarray, moment: int, count: int = STRIP) -> list[int]:
    """Frames (at most `count`) from just before the hand comes to the grasp, the grasp last.

    Args:
        has_hand: (T,) bool. moment: frame of the grasp; -1: to the last frame with a hand.
    """
    seen = np.flatnonzero(has_hand)
    last = moment if moment >= 0 else int(seen[-1]) if len(seen) else len(has_hand) - 1
    first = max(int(seen[0]) - 1, 0) if len(seen) and seen[0] <= last else 0
    return sorted({int(i) for i in np.round(np.linspace(first, last, count))})


def strip_pictures(
    seen: Demonstrated, gap_mm: np.ndarray | None = None, *, count: int = STRIP, names: Sequence[str] | None = None
) -> tuple[Picture, ...]:
    """Frames from the hand's entry to the grasp, with box, skeleton, fitted hand and object drawn over them.

    Args:
        gap_mm: (T,) from the hand to the object, nan where not known, for the captions.
        count: frames, at most. names: (T,) what the frames are called; their numbers when None.
    """
    window = seen.window
    has_hand = np.array([layer.box is not None or layer.fitted is not None for layer in seen.layers])
    found = []
    for index in strip_indices(has_hand, seen.moment, count):
        layers = seen.layers[index]
        away = np.nan if gap_mm is None else float(gap_mm[index])
        words = "no hand found" if index in seen.looked else "not looked at"
        if has_hand[index]:
            words = "hand found" if layers.fitted is None else _distance_text(away)
        if index == seen.moment:
            words = "the grasp"
        found.append(
            (
                f"frame {names[index] if names else index}: {words}",
                _overlay(seen.frames[index], layers, window, _STRIP_SIZE, labels=False),
            )
        )
    return tuple(found)


def _distance_text(away_mm: float) -> str:
    if not np.isfinite(away_mm):
        return "hand fitted"
    return f"{away_mm:.0f} mm away" if away_mm >= 1.0 else "touching"


def moving_overlay(seen: Demonstrated) -> bytes:
    """The frames with the fitted hand as a looping WebP that rests on the grasp, which is also its first picture."""
    last = seen.moment if seen.moment >= 0 else len(seen.frames) - 1
    step = max(1, -(-(last + 1) // _LOOP_FRAMES))
    indices = [*range(last % step, last + 1, step)]
    window = seen.window
    frames = []
    for index in indices:
        layers = seen.layers[index]
        own = HandLayers(box=layers.box, fitted=layers.fitted, mesh=layers.mesh, X_CO=layers.X_CO)
        frames.append(_overlay(seen.frames[index], own, window, _LOOP_SIZE, labels=False))
    return animation([*frames[-1:] * _REST, *frames], fps=_LOOP_FPS, size=_LOOP_SIZE)


def close_ups(frame: Frame, layers: HandLayers) -> tuple[Picture, ...]:
    """The moment of the grasp in layers: as seen, with box and joints, and with the fitted hand."""
    window = focus_window([layers], frame.intrinsics)
    bare = HandLayers()
    joints = HandLayers(box=layers.box, joints=layers.joints)
    fitted = HandLayers(fitted=layers.fitted, mesh=layers.mesh, X_CO=layers.X_CO, name=layers.name)
    parts = [("what the camera saw", bare)]
    if layers.box is not None or layers.joints is not None:
        parts.append((_seen_text(layers), joints))
    if layers.fitted is not None or layers.X_CO is not None:
        found = "fitted hand and object" if layers.fitted is not None else "the object"
        parts.append((found, fitted))
    return tuple((words, _overlay(frame, part, window, _CLOSE_SIZE)) for words, part in parts)


def _seen_text(layers: HandLayers) -> str:
    found = [] if layers.box is None else ["its box"]
    if layers.joints is not None:
        found += [*(["its mask"] if layers.joints.mask is not None else []), "21 joints"]
    return f"the hand: {', '.join(found)}"


def grasp_direction(hand: Hand, obj: ObjectModel, X_OH: np.ndarray, q: np.ndarray, up_O: np.ndarray) -> np.ndarray:
    """(3,) direction towards the camera, in the upright frame (see `upright`), that shows most of a grasp."""
    X_UO = upright(up_O)
    parts = [part.transformed(X_UO @ X_OH) for part in hand_part_meshes(hand, q, segments=8)]
    return best_direction(parts, obj.mesh.transformed(X_UO))


def grasp_views(
    hand: Hand, obj: ObjectModel, X_OH: np.ndarray, q: np.ndarray, *, up_O: np.ndarray
) -> tuple[Picture, ...]:
    """A grasp from two sides, the object coloured by its closeness to the hand, and the object alone.

    Args:
        X_OH: (4, 4), q: (J,) the grasp. up_O: (3,) unit vector that points to the sky, object frame.
    """
    X_UO, first = upright(up_O), grasp_direction(hand, obj, X_OH, q, up_O)
    hand = as_person(hand)
    mesh, values = _touched(hand, obj, X_OH, q)
    turn = np.array([[np.cos(_TURN_RAD), -np.sin(_TURN_RAD), 0], [np.sin(_TURN_RAD), np.cos(_TURN_RAD), 0], [0, 0, 1]])
    sides = [("the fitted hand on the object", first), ("from the other side", turn @ first)]
    pictures = [
        (
            words,
            render_grasp(
                hand, mesh.transformed(X_UO), X_UO @ X_OH, q, size=_VIEW_SIZE, view=view, vertex_values=values
            ),
        )
        for words, view in sides
    ]
    alone = render_object(mesh.transformed(X_UO), vertex_values=values, size=_VIEW_SIZE, view=first)
    return (*pictures, ("what the first side hides", alone))


def as_person(hand: Hand) -> Hand:
    """A scaled or mirrored human hand under the name whose colour it gets; any other hand as it is."""
    return replace(hand, name="human") if hand.name.startswith("human") else hand


def _touched(hand: Hand, obj: ObjectModel, X_OH: np.ndarray, q: np.ndarray):  # type: ignore[no-untyped-def]
    """The object's mesh, fine enough for a contact map, and the closeness (V,) of its vertices to the hand."""
    mesh = fine_mesh(obj.mesh)
    return mesh, contact_map_packed(mesh.vertices, pack_shapes(hand), X_OH[None], q[None], radius=_CLOSE_M)[0]


def _overlay(
    frame: Frame, layers: HandLayers, window: Window, size: tuple[int, int], *, labels: bool = True
) -> np.ndarray:
    """A part of a frame with its layers, (h, w, 3) of a size."""
    scale = max(1, min(4, -(-size[0] // window[2])))
    image = frame.depth if frame.colour is None else frame.colour
    drawn = render_hand_overlay(
        image, layers, frame.intrinsics, depth=frame.depth, window=window, scale=scale, labels=labels
    )
    height = round(size[0] * drawn.shape[0] / drawn.shape[1])
    return np.asarray(Image.fromarray(drawn).resize((size[0], height), Image.Resampling.LANCZOS))
