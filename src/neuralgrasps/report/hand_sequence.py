"""What was derived of a hand, in pictures: palm frame, fingers by colour, the way it closes, its contact surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from neuralgrasps.geometry.mesh import Mesh, cylinder_mesh, merge_meshes, sphere_mesh
from neuralgrasps.geometry.raster import rasterise
from neuralgrasps.grasps.penetration import self_penetration
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.packed import pack_hand
from neuralgrasps.hands.surface import hand_part_meshes, sample_hand_surface
from neuralgrasps.kinematics.forward_kernels import forward_fast, forward_numpy
from neuralgrasps.report.palette import GRAPHITE, linear_rgb, mix
from neuralgrasps.report.shading import Style, Surface, shade
from neuralgrasps.report.views import frame_camera, view_direction

FRAME_SIZE = (440, 440)
FINGER_COLOURS = ("#397ece", "#ee9935", "#37b59c", "#6c3ba0", "#a3a020", "#4fb3d9", "#8c564b")
THUMB_COLOUR = "#c44f6b"
AXIS_COLOURS = ("#d62828", "#2a9d3a", "#2456d6")  # x, y, z
_MEETING_DEPTH = 1e-3  # metres of overlap at which links count as met
_SURFACE_SPACING = 0.006


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HandFrame:
    """One picture of the sequence: RGBA (h, w, 4), what it shows, and the joints (J,) drawn."""

    title: str
    image: np.ndarray
    q: np.ndarray


def closing_postures(hand: Hand) -> list[tuple[str, np.ndarray]]:
    """Open, both ends of the preshapes, half closed and closed; closed is where links meet, or the joints' limits."""
    end = np.where(
        hand.closing_rate > 0, hand.tree.upper, np.where(hand.closing_rate < 0, hand.tree.lower, hand.q_open)
    )
    narrow = np.where(hand.closing_rate > 0, hand.preshape_upper, hand.preshape_lower)
    narrow = np.where(hand.closing_rate == 0, hand.q_open, narrow)
    closed = hand.q_open + _room_to_close(hand, end) * (end - hand.q_open)
    middle = 0.5 * (hand.q_open + closed)
    found = [("open", hand.q_open), ("half closed", middle), ("closed: links meet or joints end", closed)]
    if not np.allclose(narrow, hand.q_open):
        found.insert(1, ("narrowest preshape", narrow))
    return found


def _room_to_close(hand: Hand, end: np.ndarray) -> float:
    """Share of the way from open to `end` after which links overlap."""
    packed = pack_hand(hand, spacing=0.004)
    shares = np.linspace(0.05, 1.0, 20)
    poses = forward_fast(hand.tree, hand.q_open + shares[:, None] * (end - hand.q_open))
    meets = [
        share for share, X_HL in zip(shares, poses, strict=True) if self_penetration(packed, X_HL) > _MEETING_DEPTH
    ]
    return float(min(meets, default=1.0))


def hand_sequence(hand: Hand, *, size: tuple[int, int] = FRAME_SIZE) -> list[HandFrame]:
    """The postures of `closing_postures` and the contact surface, all from the same place, the palm facing up.

    Each finger has its own colour (`finger_colour`), the palm is graphite; the palm frame's axes are red (x, where the
    fingers close), green (y) and blue (z, out of the palm).
    """
    postures = closing_postures(hand)
    X_PH = np.linalg.inv(hand.X_HP)
    scenes = [hand_surfaces(hand, X_PH, q) for _, q in postures]
    scenes.append(_contact_scene(hand, X_PH))
    postures.append(("contact surface", hand.q_open))
    axes = palm_axes(_axis_length(hand))
    beside = view_direction(-64, 20)  # two fingers move in one plane: seen from the side
    direction = beside if len(hand.fingers) <= 2 else _telling_direction(hand, scenes)
    points = np.concatenate([s.mesh.vertices for scene in scenes for s in [*scene, *axes]])
    X_WC, intrinsics = frame_camera(points, direction, size)
    frames = []
    for (title, q), scene in zip(postures, scenes, strict=True):
        image = shade([*scene, *axes], X_WC, intrinsics, style=Style(ground=False))
        frames.append(HandFrame(title=title, image=image, q=q))
    return frames


def finger_colour(hand: Hand, finger: int) -> str:
    """Hex colour of a finger in the pictures; a thumb is always rose."""
    if hand.fingers[finger].is_thumb:
        return THUMB_COLOUR
    before = sum(not f.is_thumb for f in hand.fingers[:finger])
    return FINGER_COLOURS[before % len(FINGER_COLOURS)]


def _link_colours(hand: Hand) -> list[np.ndarray]:
    colours = [linear_rgb(GRAPHITE)] * hand.tree.num_links
    for f, finger in enumerate(hand.fingers):
        for link in finger.links:
            colours[link] = linear_rgb(finger_colour(hand, f))
    return colours


def hand_surfaces(hand: Hand, X_PH: np.ndarray, q: np.ndarray, *, pale: float = 0.0) -> list[Surface]:
    """The hand's parts in the palm frame, fingers by colour; `pale` in [0, 1] fades them towards white."""
    colours = _link_colours(hand)
    return [
        Surface(mesh=mesh.transformed(X_PH), colour=mix(colours[part.link], np.ones(3), pale), gloss=0.25)
        for part, mesh in zip(hand.parts, hand_part_meshes(hand, q, segments=24), strict=True)
    ]


def _contact_scene(hand: Hand, X_PH: np.ndarray) -> list[Surface]:
    """The pale open hand with a dot at every sample of the surface that is used for contact."""
    surface = sample_hand_surface(hand, spacing=_SURFACE_SPACING)
    X_PL = X_PH @ forward_numpy(hand.tree, hand.q_open)
    dot, colours, scene = sphere_mesh(0.0011, segments=6), _link_colours(hand), []
    for link in np.unique(surface.links):
        X = X_PL[link]
        points = surface.points_L[surface.links == link] @ X[:3, :3].T + X[:3, 3]
        dots = merge_meshes([Mesh(dot.vertices + p, dot.faces) for p in points])
        scene.append(Surface(mesh=dots, colour=colours[link], gloss=0.0))
    return [*hand_surfaces(hand, X_PH, hand.q_open, pale=0.7), *scene]


def _axis_length(hand: Hand) -> float:
    """Half of the largest distance from the palm to the solids of a finger, metres."""
    X_HL = forward_numpy(hand.tree, hand.q_open)
    ends = [X_HL[p.link] @ p.X_LP[:, 3] for f in hand.fingers for p in hand.parts if p.link in f.links]
    return 0.6 * max((float(np.linalg.norm(e[:3] - hand.X_HP[:3, 3])) for e in ends), default=0.1)


def palm_axes(length: float) -> list[Surface]:
    """Three rods with round ends along the axes of the palm frame, metres."""
    axes = []
    for k, colour in enumerate(AXIS_COLOURS):
        rod = cylinder_mesh(0.022 * length, 0.5 * length, segments=12)
        X = np.eye(4)
        X[:3, :3] = np.roll(np.eye(3), k + 1, axis=0)  # turns z into the k-th axis
        X[k, 3] = 0.5 * length
        ball = sphere_mesh(0.055 * length, segments=16)
        X_end = np.eye(4)
        X_end[k, 3] = length
        mesh = merge_meshes([rod.transformed(X), ball.transformed(X_end)])
        axes.append(Surface(mesh=mesh, colour=linear_rgb(colour), gloss=0.1))
    return axes


def _telling_direction(hand: Hand, scenes: Sequence[Sequence[Surface]]) -> np.ndarray:
    """The direction towards the camera, a little above the palm's plane, from which all fingers are seen best."""
    owner = np.full(hand.tree.num_links, -1)
    for f, finger in enumerate(hand.fingers):
        owner[list(finger.links)] = f
    candidates = [view_direction(azimuth, e) for e in (16.0, 34.0) for azimuth in np.arange(22.5, 360.0, 45.0)]
    scores = []
    for direction in candidates:
        score = 0.0
        for scene in scenes[:-1]:
            meshes = [s.mesh for s in scene]
            X_WC, intrinsics = frame_camera(np.concatenate([m.vertices for m in meshes]), direction, (72, 72))
            image = rasterise(meshes, np.tile(np.linalg.inv(X_WC), (len(meshes), 1, 1)), intrinsics)
            seen = image.mesh_index[image.face_index >= 0]
            fingers = owner[[hand.parts[i].link for i in seen]] if len(seen) else np.zeros(0, int)
            score += sum(float(np.sqrt((fingers == f).sum())) for f in range(len(hand.fingers)))
        scores.append(score)
    return candidates[int(np.argmax(scores))]


def sequence_strip(frames: Sequence[HandFrame]) -> np.ndarray:
    """The frames side by side on white with their titles, (h, w, 3) uint8."""
    width, height, band = frames[0].image.shape[1], frames[0].image.shape[0], 34
    strip = Image.new("RGB", (width * len(frames), height + band), "#ffffff")
    draw, font = ImageDraw.Draw(strip), ImageFont.load_default(17)
    for k, frame in enumerate(frames):
        picture = Image.fromarray(frame.image)
        strip.paste(picture, (k * width, band), picture)
        draw.text(((k + 0.5) * width, band / 2), frame.title, fill="#333940", font=font, anchor="mm")
    return np.asarray(strip)
