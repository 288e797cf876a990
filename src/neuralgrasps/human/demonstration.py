"""Synthetic demonstrations: a person's hand comes to an object on a table, grasps it and lifts it, seen by a camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.geometry.plane import Plane
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.human.demonstration_motion import Motion, demonstration_motion
from neuralgrasps.human.demonstration_scene import (
    Looks,
    PosedMesh,
    alone_mask,
    arm_meshes,
    choose_camera,
    surroundings,
    visible_share,
)
from neuralgrasps.human.forearm import WristAxes
from neuralgrasps.human.hand_path import HandPath, find_path
from neuralgrasps.human.person_grasps import PersonGrasps, person_grasps, table_frame
from neuralgrasps.human.seen import Side
from neuralgrasps.human.shaded_scene import ShadedScene, Thing
from neuralgrasps.human.skeleton import joint_points
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.perception.frame import Frame
from neuralgrasps.planning.resting_plane import resting_planes
from neuralgrasps.seeds import child_rng, child_seed
from neuralgrasps.sim.camera import STRUCTURED_LIGHT, DepthNoise, sense_depth

UNITS_PER_METRE = 10000
"""Of the stored depth: whole tenths of a millimetre."""
SIZES = (0.70, 0.74, 0.78, 0.82, 0.86, 0.90)
"""Scales of hands that are drawn where none is given: few, so that their grasps are made once."""

_SAME_HEIGHT_M = 0.008  # resting poses whose centres of mass are this near in height count as alike

GraspKind = Literal["any", "power", "precision"]


class NoPersonGraspError(InputError):
    """No hand of the sizes tried grasps the object in any resting pose."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DemonstrationConfig:
    """What a recorded demonstration shows.

    Attributes:
        side, scale: of the hand; None draws them (`SIZES`).
        kind: of the grasp.
        rate_hz: frames per second. still_frames: fewest and most frames that the closed hand keeps still.
        lift: the hand lifts the object after that; None: half of the time.
        wall: something is behind the table; None: half of the time. clutter: other things on the table.
        noise: of the depth; None: exact. width, height: of the images, pixels.
        least_share: of the hand that is wanted to be visible at the grasp.
    """

    side: Side | None = None
    scale: float | None = None
    kind: GraspKind = "any"
    rate_hz: float = 15.0
    still_frames: tuple[int, int] = (8, 15)
    lift: bool | None = None
    wall: bool | None = None
    clutter: int = 0
    noise: DepthNoise | None = STRUCTURED_LIGHT
    width: int = 640
    height: int = 480
    least_share: float = 0.45

    def __post_init__(self) -> None:
        if self.side not in (None, "right", "left"):
            raise InputError(f"side is '{self.side}'; expected 'right' or 'left', or None for either.")
        if self.kind not in ("any", "power", "precision"):
            raise InputError(f"kind of grasp is '{self.kind}'; expected 'any', 'power' or 'precision'.")
        if not (self.rate_hz > 0 and 1 <= self.still_frames[0] <= self.still_frames[1] and self.clutter >= 0):
            raise InputError(
                f"rate_hz is {self.rate_hz}, still_frames {self.still_frames}, clutter {self.clutter}; expected a rate "
                "above 0, a range from 1 up, and 0 or more things."
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DemonstrationTruth:
    """What is exactly so in the T frames of a demonstration; C is the camera of all of them.

    Attributes:
        object: its name. side, scale: of the hand. kind: "power" or "precision".
        X_CO: (T, 4, 4) the object. X_CH: (T, 4, 4) the hand's base (wrist); q: (T, 20) joints, rad.
        joints_C: (T, 21, 3) joints of the hand, metres.
        hand_mask: (T, h, w) bool, pixels that show the hand (not the arm).
        visible: (T,) share of the hand's outline, parts outside the image included, that is seen in the image.
        still: first frame of the closed hand that keeps still, and the first after these; grasp_frame: their middle.
        X_OH: (4, 4) the grasp.
        notes: sizes and resting poses that were drawn first, and why they gave no grasp.
    """

    object: str
    side: Side
    scale: float
    kind: str
    X_CO: np.ndarray
    X_CH: np.ndarray
    q: np.ndarray
    joints_C: np.ndarray
    hand_mask: np.ndarray
    visible: np.ndarray
    still: tuple[int, int]
    grasp_frame: int
    X_OH: np.ndarray
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedDemonstration:
    """A demonstration as a camera recorded it, and the truth.

    Attributes:
        depth_units: (T, h, w) uint16 z-depth in tenths of a millimetre, 0 = nothing measured.
        colour: (T, h, w, 3) uint8.
        intrinsics: the camera; X_WC: (4, 4) its pose, world z up, the table at z = 0.
        rate_hz: frames per second. seed: what it was made with.
    """

    depth_units: np.ndarray
    colour: np.ndarray
    intrinsics: Intrinsics
    X_WC: np.ndarray
    rate_hz: float
    seed: int
    truth: DemonstrationTruth

    def __len__(self) -> int:
        return len(self.depth_units)

    def frame(self, index: int) -> Frame:
        """One frame, as read from files."""
        return Frame(
            depth=self.depth_units[index] / float(UNITS_PER_METRE), intrinsics=self.intrinsics,
            colour=self.colour[index], X_WC=self.X_WC, name=f"{index:06d}",
        )  # fmt: skip

    @property
    def frames(self) -> list[Frame]:
        """All frames; each holds its depth in float64, 2.4 MB at 640 x 480."""
        return [self.frame(i) for i in range(len(self))]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Act:
    """Who grasps what how, in W."""

    hand: Hand
    side: Side
    scale: float
    X_WO: np.ndarray
    forearm_H: np.ndarray
    path: HandPath
    precision: bool


def record_demonstration(
    obj: ObjectModel, *, seed: int = 0, config: DemonstrationConfig | None = None
) -> RecordedDemonstration:
    """A person's hand comes to an object that rests on a table, closes, keeps still, and perhaps lifts it.

    The grasp is one that held in physics (`person_grasps`). Equal arguments give equal arrays.

    Args:
        seed: of everything drawn: size, side, resting pose, grasp, path, camera, colours, noise. Grasps themselves do
            not depend on it, so that they are made once.
    Raises:
        NoPersonGraspError: no hand of the size asked for, or of those drawn, grasps the object in any resting pose;
            says why.
    """
    config = config or DemonstrationConfig()
    rng = child_rng(seed, "demonstration", obj.content_hash)
    act, notes = _staged(obj, config, rng)
    lift = bool(rng.random() < 0.5) if config.lift is None else config.lift
    motion = demonstration_motion(act.path, act.X_WO, still_frames=config.still_frames, lift=lift, rng=rng)
    return _filmed(obj, act, motion, config, rng, seed=seed, notes=notes)


def _staged(obj: ObjectModel, config: DemonstrationConfig, rng: np.random.Generator) -> tuple[_Act, tuple[str, ...]]:
    """A grasp with a way to it; where the drawn size and pose give none, others are tried."""
    side: Side = config.side or ("right" if rng.random() < 0.5 else "left")
    planes = resting_planes(obj)
    sizes = [config.scale] if config.scale is not None else [SIZES[i] for i in rng.permutation(len(SIZES))[:3]]
    notes: list[str] = []
    for scale in sizes:
        for k in _poses_in_turn(obj, planes, rng):
            people = person_grasps(obj, scale=scale, side=side, plane_O=planes[k])
            act = _with_path(obj, people, planes[k], side, scale, config.kind, rng)
            if act is not None:
                return act, tuple(notes)
            why = people.reason or "no grasp of that kind has a clear way to it"
            notes.append(f"hand of scale {scale:g}, resting pose {k}: {why}")
    raise NoPersonGraspError(
        f"no person's grasp of '{obj.name}' was found for a {side} hand: {'; '.join(notes)}. Choose another object, "
        "size, side or kind of grasp."
    )


def _poses_in_turn(obj: ObjectModel, planes: Sequence[Plane], rng: np.random.Generator) -> list[int]:
    """Resting poses in the order they are tried: one of each height, in random order, then others of the same heights.

    A bottle that stands is as likely as one that lies, however many sides it can lie on.
    """
    heights: dict[int, list[int]] = {}
    for k, plane in enumerate(planes):
        heights.setdefault(round(plane.height(obj.com_O) / _SAME_HEIGHT_M), []).append(k)
    groups = [list(rng.permutation(ks)[:2]) for ks in heights.values()]
    order = rng.permutation(len(groups))
    return [int(groups[g][n]) for n in range(2) for g in order if n < len(groups[g])]


def _with_path(
    obj: ObjectModel, people: PersonGrasps, plane_O: Plane, side: Side, scale: float, kind: GraspKind,
    rng: np.random.Generator,
) -> _Act | None:  # fmt: skip
    chosen = np.flatnonzero(_of_kind(people.grasps, kind))
    X_WO = _put_down(obj, table_frame(plane_O), rng.uniform(0.0, 2.0 * np.pi))
    for i in rng.permutation(chosen)[:6]:
        grasp, forearm_H = people.grasps[int(i)], people.forearm_H[int(i)]
        path = find_path(
            people.hand, obj, X_WO, X_WO @ grasp.X_OH[0], grasp.q[0], forearm_H, scale=scale, rng=rng
        )  # fmt: skip
        if path is not None:
            return _Act(
                hand=people.hand, side=side, scale=scale, X_WO=X_WO, forearm_H=forearm_H, path=path,
                precision=bool(grasp.precision[0]),
            )  # fmt: skip
    return None


def _of_kind(grasps: GraspSet, kind: GraspKind) -> np.ndarray:
    return np.ones(len(grasps), bool) if kind == "any" else grasps.precision == (kind == "precision")


def _put_down(obj: ObjectModel, X_TO: np.ndarray, yaw: float) -> np.ndarray:
    """(4, 4) X_WO: resting as in X_TO, turned by `yaw`, its centre of mass above the origin."""
    X = np.eye(4)
    X[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    X_WO = X @ X_TO
    X_WO[:2, 3] -= (X_WO[:3, :3] @ obj.com_O + X_WO[:3, 3])[:2]
    return X_WO


def _filmed(
    obj: ObjectModel, act: _Act, motion: Motion, config: DemonstrationConfig, rng: np.random.Generator, *, seed: int,
    notes: tuple[str, ...],
) -> RecordedDemonstration:  # fmt: skip
    body, looks = PosedMesh(act.hand), Looks.drawn(rng)
    up_H = act.path.X_WH[2, :3]
    skin, sleeve = arm_meshes(act.hand, act.forearm_H, up_H, scale=act.scale)
    joints_W = joint_points(act.hand, motion.X_WH, motion.q)

    def posed(t: int) -> list[np.ndarray]:
        X = motion.X_WH[t]
        return [
            body.vertices(X, motion.q[t]),
            *(m.vertices @ Y[:3, :3].T + Y[:3, 3] for m, Y in ((obj.mesh, motion.X_WO[t]), (skin, X), (sleeve, X))),
        ]

    out_W = act.path.X_WH[:3, :3] @ act.forearm_H
    if np.hypot(out_W[0], out_W[1]) < 0.3:
        out_W = act.path.X_WH[:3, :3] @ WristAxes.of(act.hand).out
    person = float(np.arctan2(out_W[1], out_W[0]))
    focal = rng.uniform(560.0, 640.0) * config.width / 640.0
    intrinsics = Intrinsics(
        focal, focal, 0.5 * (config.width - 1) + rng.uniform(-6, 6), 0.5 * (config.height - 1) + rng.uniform(-6, 6),
        config.width, config.height,
    )  # fmt: skip
    moving = (body.mesh, obj.mesh, skin, sleeve)
    X_WC = choose_camera(
        rng, intrinsics=intrinsics, person=person, hand_W=joints_W[motion.grasp_frame].mean(axis=0), meshes=moving,
        moments=[posed(motion.grasp_frame), posed(len(motion.q) - 1)], least_share=config.least_share,
    )  # fmt: skip
    wall = bool(rng.random() < 0.5) if config.wall is None else config.wall
    stay = surroundings(rng, X_WC=X_WC, person=person, clutter=config.clutter, wall=wall)
    light_W = np.array([rng.uniform(-0.8, 0.8), rng.uniform(-0.8, 0.8), rng.uniform(1.5, 2.2)])
    colours = (looks.skin, looks.obj, looks.skin, looks.sleeve)
    scene = ShadedScene(
        intrinsics=intrinsics, X_WC=X_WC, light_W=light_W, stay=stay,
        move=[Thing(mesh=m, colour=c) for m, c in zip(moving, colours, strict=True)],
    )  # fmt: skip
    count, shape = len(motion.q), (config.height, config.width)
    units, colour = np.empty((count, *shape), np.uint16), np.empty((count, *shape, 3), np.uint8)
    mask, visible = np.empty((count, *shape), bool), np.empty(count)
    for t in range(count):
        vertices = posed(t)
        picture = scene.draw(vertices)
        depth, _ = sense_depth(
            picture.depth.astype(np.float64), intrinsics, config.noise, child_seed(seed, "frame", t)
        )  # fmt: skip
        units[t] = np.clip(np.rint(depth * UNITS_PER_METRE), 0, 65535)
        colour[t], mask[t] = picture.colour, picture.index == len(stay)
        visible[t] = visible_share(mask[t], alone_mask(vertices[0], body.mesh.faces, X_WC, intrinsics))
    X_CW = np.linalg.inv(X_WC)
    truth = DemonstrationTruth(
        object=obj.name, side=act.side, scale=act.scale, kind="precision" if act.precision else "power",
        X_CO=X_CW @ motion.X_WO, X_CH=X_CW @ motion.X_WH, q=motion.q,
        joints_C=joints_W @ X_CW[:3, :3].T + X_CW[:3, 3], hand_mask=mask, visible=visible, still=motion.still,
        grasp_frame=motion.grasp_frame, X_OH=np.linalg.inv(act.X_WO) @ act.path.X_WH, notes=notes,
    )  # fmt: skip
    return RecordedDemonstration(
        depth_units=units, colour=colour, intrinsics=intrinsics, X_WC=X_WC, rate_hz=config.rate_hz, seed=seed,
        truth=truth,
    )  # fmt: skip
