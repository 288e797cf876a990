"""Synthetic demonstrations: a person's hand comes to an object on a table, grasps it and lifts it, seen by a camera."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from neuralgrasps.errors import InputError
from neuralgrasps.geometry.camera import Intrinsics
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.human.seen import Side
from neuralgrasps.human.skeleton import joint_points
from neuralgrasps.human.synthetic.hidden_view import Acted, HiddenView, choose_hidden_view
from neuralgrasps.human.synthetic.motion import Motion, demonstration_motion
from neuralgrasps.human.synthetic.occluder import swept
from neuralgrasps.human.synthetic.recording import UNITS_PER_METRE, DemonstrationTruth, RecordedDemonstration
from neuralgrasps.human.synthetic.scene import (
    Looks,
    PosedMesh,
    alone_mask,
    arm_meshes,
    choose_camera,
    surroundings,
    visible_share,
)
from neuralgrasps.human.synthetic.shaded_scene import Picture, ShadedScene, Thing
from neuralgrasps.human.synthetic.staging import Act, GraspKind, NoPersonGraspError, stage
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.seeds import child_rng, child_seed
from neuralgrasps.sim.camera import STRUCTURED_LIGHT, DepthNoise, sense_depth

__all__ = [
    "SIZES",
    "DemonstrationConfig",
    "DemonstrationTruth",
    "NoPersonGraspError",
    "RecordedDemonstration",
    "record_demonstration",
]

SIZES = (0.70, 0.74, 0.78, 0.82, 0.86, 0.90)
"""Scales of hands that are drawn where none is given: few, so that their grasps are made once."""
_SIZES_TRIED = 3


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
        share: least and most of the hand that is to be visible at the grasp, in place of `least_share`, such as
            (0.4, 0.75): a badly seen grasp, by where the camera stands, else by a thing that stands before the hand.
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
    share: tuple[float, float] | None = None

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
        if self.share is not None and not 0.0 < self.share[0] < self.share[1] <= 1.0:
            raise InputError(
                f"share is {self.share}; expected least and most of the hand that is seen, such as (0.4, 0.75)."
            )


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
    side: Side = config.side or ("right" if rng.random() < 0.5 else "left")
    drawn = [SIZES[i] for i in rng.permutation(len(SIZES))[:_SIZES_TRIED]]
    sizes = drawn if config.scale is None else [config.scale]
    act = stage(obj, side=side, sizes=sizes, kind=config.kind, rng=rng)
    lift = bool(rng.random() < 0.5) if config.lift is None else config.lift
    motion = demonstration_motion(act.path, act.X_WO, still_frames=config.still_frames, lift=lift, rng=rng)
    film = _Film(obj, act, motion, config, rng)
    count, shape = len(motion.q), (config.height, config.width)
    units, colour = np.empty((count, *shape), np.uint16), np.empty((count, *shape, 3), np.uint8)
    mask, visible = np.empty((count, *shape), bool), np.empty(count)
    for t, (picture, mask[t], visible[t]) in enumerate(film.pictures()):
        depth, _ = sense_depth(
            picture.depth.astype(np.float64), film.intrinsics, config.noise, child_seed(seed, "frame", t)
        )  # fmt: skip
        units[t] = np.clip(np.rint(depth * UNITS_PER_METRE), 0, 65535)
        colour[t] = picture.colour
    X_CW = np.linalg.inv(film.X_WC)
    X_CH = X_CW @ motion.X_WH
    truth = DemonstrationTruth(
        object=obj.name, side=act.side, scale=act.scale, kind="precision" if act.precision else "power",
        X_CO=X_CW @ motion.X_WO, X_CH=X_CH, q=motion.q, joints_C=joint_points(act.hand, X_CH, motion.q),
        hand_mask=mask, visible=visible, still=motion.still, grasp_frame=motion.grasp_frame,
        X_OH=np.linalg.inv(act.X_WO) @ act.path.X_WH, notes=(*act.notes, *film.notes),
    )  # fmt: skip
    return RecordedDemonstration(
        depth_units=units, colour=colour, intrinsics=film.intrinsics, X_WC=film.X_WC, rate_hz=config.rate_hz,
        seed=seed, truth=truth,
    )  # fmt: skip


class _Film:
    """A camera that was chosen for an act, and what it sees, exactly."""

    def __init__(
        self, obj: ObjectModel, act: Act, motion: Motion, config: DemonstrationConfig, rng: np.random.Generator
    ) -> None:
        self._obj, self._motion, self._body = obj, motion, PosedMesh(act.hand)
        self._arm = arm_meshes(act.hand, act.forearm_H, act.path.X_WH[2, :3], scale=act.scale)
        looks, moving = Looks.drawn(rng), (self._body.mesh, obj.mesh, *self._arm)
        self.intrinsics = _intrinsics(config.width, config.height, rng)
        view = self._view(act, moving, config, rng)
        self.X_WC, self.notes = view.X_WC, (view.note,) if view.note else ()
        wall = bool(rng.random() < 0.5) if config.wall is None else config.wall
        stay = surroundings(
            rng, X_WC=self.X_WC, person=act.person, clutter=config.clutter, wall=wall, occluder=view.occluder
        )  # fmt: skip
        colours = (looks.skin, looks.obj, looks.skin, looks.sleeve)
        self._hand_index = len(stay)
        self._scene = ShadedScene(
            intrinsics=self.intrinsics, X_WC=self.X_WC, stay=stay,
            light_W=np.array([rng.uniform(-0.8, 0.8), rng.uniform(-0.8, 0.8), rng.uniform(1.5, 2.2)]),
            move=[Thing(mesh=m, colour=c) for m, c in zip(moving, colours, strict=True)],
        )  # fmt: skip

    def _view(
        self, act: Act, moving: Sequence[Mesh], config: DemonstrationConfig, rng: np.random.Generator
    ) -> HiddenView:
        """The camera, and what stands before it."""
        middle_W = joint_points(act.hand, act.path.X_WH, act.path.q).mean(axis=0)
        grasp, last = (self._vertices(t) for t in (self._motion.grasp_frame, len(self._motion.q) - 1))
        if config.share is None:
            X_WC = choose_camera(
                rng, intrinsics=self.intrinsics, person=act.person, hand_W=middle_W, meshes=moving,
                moments=[grasp, last], least_share=config.least_share,
            )  # fmt: skip
            return HiddenView(X_WC=X_WC)
        every = (self._vertices(t) for t in range(len(self._motion.q)))
        acted = Acted(
            person=act.person, hand_W=middle_W, meshes=moving, moments=[self._vertices(0), grasp, last],
            swept_W=cache(lambda: swept(moving, every)),
        )  # fmt: skip
        return choose_hidden_view(rng, acted, intrinsics=self.intrinsics, share=config.share)

    def pictures(self) -> Iterator[tuple[Picture, np.ndarray, float]]:
        """Each frame's picture, the hand's pixels (h, w) bool, and the share of the hand that is seen."""
        shown: tuple[Picture, np.ndarray, float] | None = None
        for t in range(len(self._motion.q)):
            if shown is None or not self._motion.keeps(t):
                vertices = self._vertices(t)
                picture = self._scene.draw(vertices)
                mask = picture.index == self._hand_index
                alone = alone_mask(vertices[0], self._body.mesh.faces, self.X_WC, self.intrinsics)
                shown = picture, mask, visible_share(mask, alone)
            yield shown

    def _vertices(self, t: int) -> list[np.ndarray]:
        """Vertices in W of hand, object and arm at frame t."""
        X_WH = self._motion.X_WH[t]
        placed = ((self._obj.mesh, self._motion.X_WO[t]), *((mesh, X_WH) for mesh in self._arm))
        return [self._body.vertices(X_WH, self._motion.q[t]), *(_placed(mesh, X) for mesh, X in placed)]


def _placed(mesh: Mesh, X: np.ndarray) -> np.ndarray:
    return mesh.vertices @ X[:3, :3].T + X[:3, 3]


def _intrinsics(width: int, height: int, rng: np.random.Generator) -> Intrinsics:
    """A camera with a field of view of 53 to 59 degrees across, its principal point a little off the middle."""
    focal = rng.uniform(560.0, 640.0) * width / 640.0
    cx, cy = 0.5 * (width - 1) + rng.uniform(-6, 6), 0.5 * (height - 1) + rng.uniform(-6, 6)
    return Intrinsics(focal, focal, cx, cy, width, height)
