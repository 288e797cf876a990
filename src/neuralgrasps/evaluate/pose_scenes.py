"""Simulated depth images of one thing in a room, with the truth that its pose estimate is measured against."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from scipy import ndimage

from neuralgrasps.errors import InputError, unknown_name
from neuralgrasps.evaluate.held_scenes import HeldScene, held_scene
from neuralgrasps.evaluate.pose_occluders import Body, Placed, body_of, body_of_mesh, hide, turn_z
from neuralgrasps.evaluate.pose_room import CAMERA, random_room, random_view
from neuralgrasps.evaluate.pose_views import HARD_NOISE, see
from neuralgrasps.evaluate.unknown_shapes import SHAPES, unknown_shape
from neuralgrasps.geometry.camera import Intrinsics, pixel_rays
from neuralgrasps.geometry.mesh import Mesh, face_areas_normals
from neuralgrasps.geometry.plane import Plane, horizontal_plane
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.resting import resting_poses
from neuralgrasps.perception.frame import Frame
from neuralgrasps.seeds import child_rng, child_seed
from neuralgrasps.sim.camera import STRUCTURED_LIGHT, render_depth_view

__all__ = [
    "CONDITIONS", "PATCHES", "UNKNOWN_KINDS", "VISIBLE", "Condition", "HeldScene", "PoseScene", "background_scene",
    "held_scene", "pose_scene",
]  # fmt: skip

Condition = Literal["easy", "occluded", "hard"]
CONDITIONS: tuple[Condition, ...] = get_args(Condition)
VISIBLE = (0.25, 0.80)
"""Between these shares of the object's own pixels stay visible in the occluded and hard scenes."""
PATCHES = ("table edge", "wall")
UNKNOWN_KINDS: tuple[str, ...] = (*SHAPES, *PATCHES)
"""What `background_scene` shows."""
_REDRAWS = 300
_MIN_PIXELS = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseScene:
    """One depth image of an object on a table.

    Attributes:
        object: its name; "" for a thing that no library has.
        condition: "easy", "occluded" or "hard".
        depth: (h, w) float32 z-depth, metres; 0 = nothing measured.
        intrinsics: the camera; X_WC: (4, 4) its pose, world z up, the table's top at z = 0.
        mask: (h, w) bool, what an instance segmentation gives the estimator: pixels with a measurement.
        true_mask: (h, w) bool, pixels on the object, measured or not.
        X_CO_true: (4, 4) the object's pose in the camera; nan for an unknown thing.
        table: the true table in the camera's frame.
        visible_share: share of the pixels it would have alone that the object has, and that the sensor's projector
            sees too: nothing is measured in the shadow that a thing in front throws beside itself.
        seed: the scene's.
    """

    object: str
    condition: Condition
    depth: np.ndarray
    intrinsics: Intrinsics
    mask: np.ndarray
    true_mask: np.ndarray
    X_WC: np.ndarray
    X_CO_true: np.ndarray
    table: Plane
    visible_share: float
    seed: int

    @property
    def frame(self) -> Frame:
        """The scene as perception reads it, without colour."""
        return Frame(depth=self.depth, intrinsics=self.intrinsics, X_WC=self.X_WC)


def pose_scene(
    obj: ObjectModel,
    condition: Condition,
    *,
    seed: int,
    distractors: Sequence[ObjectModel] = (),
    intrinsics: Intrinsics = CAMERA,
) -> PoseScene:
    """An object in a random stable pose on a table, seen from 0.5 to 1.2 m at 25 to 65 degrees elevation.

    "easy": nothing in front, exact mask. "occluded": one to three things leave 25 to 80 % (uniform) of its pixels
    visible. "hard": as occluded, and the mask spills over its edge by 3 mm, depths are 0.3 % too large, with a smooth
    error of 3 mm and 2.5 mm more noise. The sensor is `STRUCTURED_LIGHT`. One seed gives the object the same pose,
    view and room in all three, and occluded and hard the same things in front.

    Args:
        obj: the object.
        distractors: library objects that may stand in front; `obj` itself is never among them. Boxes and cylinders
            when there are none.
    Raises:
        UnknownNameError: no such condition.
        InputError: no scene could be made, as of an object too small to be seen.
    """
    _check_names(condition)
    others = [other for other in distractors if other.name != obj.name]
    body, (poses, shares) = body_of(obj), resting_poses(obj.mesh.vertices, obj.com_O)
    share = _share(child_rng(seed, "visible share", obj.name))
    for attempt in range(_REDRAWS):
        rng = child_rng(seed, "pose scene", obj.name, attempt)
        target = _stand(body, poses, shares, rng)
        scene = _scene_of(target, obj.name, condition, share, seed=seed, rng=rng, others=others, intrinsics=intrinsics)
        if scene is not None:
            return scene
    raise InputError(
        f"'{obj.name}' gave no {condition} scene in {_REDRAWS} draws; expected an object 3 to 50 cm large."
    )


def background_scene(
    seed: int,
    *,
    kind: str | None = None,
    distractors: Sequence[ObjectModel] = (),
    condition: Condition | None = None,
    intrinsics: Intrinsics = CAMERA,
) -> PoseScene:
    """A scene whose mask holds something that is in no library; its `object` is "" and its pose nan.

    Kinds: the `SHAPES` (frames of bars and plates, bowls and half shells, mugs with a handle, rings, cones, wedges,
    L, T and U profiles, balls and eggs, bunches of solids, slabs far larger and blocks far smaller than household
    boxes, bananas, lumps) on the table, and `PATCHES`: a round piece of the table's edge with what lies behind it, or
    of the wall and floor, as a bad segmentation cuts out.

    Args:
        kind: one of `UNKNOWN_KINDS`; drawn by the seed when None.
        distractors: as in `pose_scene`.
        condition: as in `pose_scene`; when None, "occluded" for half of the seeds, else "easy". Patches are not
            occluded.
    Raises:
        UnknownNameError: no such kind or condition.
    """
    rng = child_rng(seed, "background")
    draw, occluded = str(rng.choice(UNKNOWN_KINDS)), bool(rng.random() < 0.5)
    kind = draw if kind is None else kind
    condition = ("occluded" if occluded else "easy") if condition is None else condition
    _check_names(condition, kind)
    for attempt in range(_REDRAWS):
        rng = child_rng(seed, "background", kind, attempt)
        if kind in PATCHES:
            scene = _patch(kind, "hard" if condition == "hard" else "easy", seed=seed, rng=rng, intrinsics=intrinsics)
        else:
            mesh = unknown_shape(kind, rng)
            target = _stand(body_of_mesh(mesh, seed=seed), *resting_poses(mesh.vertices, _middle(mesh)), rng)
            scene = _scene_of(
                target, "", condition, _share(rng), seed=seed, rng=rng, others=distractors, intrinsics=intrinsics
            )
        if scene is not None:
            return replace(scene, X_CO_true=np.full((4, 4), np.nan))
    raise InputError(f"seed {seed} gave no {condition} scene of a {kind} in {_REDRAWS} draws; expected another seed.")


def _share(rng: np.random.Generator) -> float:
    margin = 0.015  # `hide` is that exact
    return float(rng.uniform(VISIBLE[0] + margin, VISIBLE[1] - margin))


def _check_names(condition: str, kind: str | None = None) -> None:
    if condition not in CONDITIONS:
        raise unknown_name("condition", condition, CONDITIONS)
    if kind is not None and kind not in UNKNOWN_KINDS:
        raise unknown_name("kind", kind, UNKNOWN_KINDS)


def _middle(mesh: Mesh) -> np.ndarray:
    """(3,) centre of the surface, the centre of mass of a thing of sheet."""
    areas, _ = face_areas_normals(mesh)
    return np.asarray(np.average(mesh.vertices[mesh.faces].mean(axis=1), axis=0, weights=areas))


def _stand(body: Body, poses: np.ndarray, shares: np.ndarray, rng: np.random.Generator) -> Placed:
    """A body in one of its stable poses, turned at random about the vertical."""
    pose = poses[rng.choice(len(poses), p=shares)]
    return Placed(body=body, X_WB=turn_z(rng.uniform(0.0, 2.0 * np.pi)) @ pose)


def _scene_of(
    target: Placed,
    name: str,
    condition: Condition,
    share: float,
    *,
    seed: int,
    rng: np.random.Generator,
    others: Sequence[ObjectModel],
    intrinsics: Intrinsics,
) -> PoseScene | None:
    """One draw of a scene that leaves `share` visible; None when it did not come out so."""
    X_WC = random_view(target.centre_W, target.body.radius_m, intrinsics, rng)
    room = random_room(rng, X_WC)
    things: tuple[Placed, ...] | None = ()
    if condition != "easy":
        things = hide(target, share=share, X_WC=X_WC, intrinsics=intrinsics, rng=rng, distractors=others)
    if things is None:
        return None
    sight = see(
        target, things, room, X_WC=X_WC, intrinsics=intrinsics, hard=condition == "hard",
        seed=child_seed(seed, "sensor", name),
    )  # fmt: skip
    inside = condition == "easy" or VISIBLE[0] <= sight.visible_share <= VISIBLE[1]
    if not inside or sight.mask.sum() < _MIN_PIXELS:
        return None
    return PoseScene(
        object=name, condition=condition, depth=sight.depth, intrinsics=intrinsics, mask=sight.mask,
        true_mask=sight.true_mask, X_WC=X_WC, X_CO_true=np.linalg.inv(X_WC) @ target.X_WB,
        table=horizontal_plane(0.0, X_WC), visible_share=sight.visible_share, seed=seed,
    )  # fmt: skip


def _patch(
    kind: str, condition: Condition, *, seed: int, rng: np.random.Generator, intrinsics: Intrinsics
) -> PoseScene | None:
    """A disc of 4 to 12 cm radius about a random pixel of the table's edge or of what is behind; None if too small."""
    X_WC = random_view(rng.uniform([-0.4, -0.4, 0.0], [0.4, 0.4, 0.1]), 0.0, intrinsics, rng)
    view = render_depth_view(
        [random_room(rng, X_WC)], np.eye(4)[None], X_WC=X_WC, intrinsics=intrinsics,
        noise=HARD_NOISE if condition == "hard" else STRUCTURED_LIGHT, seed=seed,
    )  # fmt: skip
    table = horizontal_plane(0.0, X_WC)
    measured = view.depth > 0
    on_table = (np.abs(table.height(pixel_rays(intrinsics) * view.depth[..., None])) < 0.02) & measured
    behind = ndimage.binary_opening(measured & ~on_table, iterations=2)
    places = np.argwhere(ndimage.binary_dilation(behind, iterations=6) & on_table if kind == "table edge" else behind)
    if not len(places):
        return None
    row, column = places[rng.integers(len(places))]
    radius = rng.uniform(0.04, 0.12) * intrinsics.fx / view.depth[row, column]
    v, u = np.indices(measured.shape)
    mask = ((v - row) ** 2 + (u - column) ** 2 < radius**2) & measured
    if mask.sum() < _MIN_PIXELS:
        return None
    return PoseScene(
        object="", condition=condition, depth=view.depth, intrinsics=intrinsics, mask=mask, true_mask=mask, X_WC=X_WC,
        X_CO_true=np.full((4, 4), np.nan), table=table, visible_share=1.0, seed=seed,
    )  # fmt: skip
