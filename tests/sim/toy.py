"""A tiny parallel jaw and a box, small enough to know every answer by hand."""

from __future__ import annotations

import numpy as np

from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.sdf_grid import SdfGrid
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import ConvexPart, Hand, PartKind
from neuralgrasps.kinematics.tree import FIXED, PRISMATIC, KinematicTree
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.symmetry import SymmetryGroup

HALF = np.array([0.02, 0.03, 0.05])  # the box, metres
PAD_HALF = np.array([0.005, 0.01, 0.02])
CLOSED = 0.02  # jaw position at which the pads touch the box's x faces

_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_FACES = np.array(
    [
        *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5]),
        *([0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6]),
        *([0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
    ],
    np.int32,
)


def toy_hand(*, coupled: bool = False, effort: float = 20.0, gain: float = 1.0) -> Hand:
    """Two pads that slide along +-x, 10 cm in front of the base; pad inner faces at x = +-q.

    `coupled`: one independent joint drives both pads. `gain`: pad travel per unit of q.
    """
    X = np.tile(np.eye(4), (3, 1, 1))
    X[1:, 2, 3] = 0.1
    coupling = (
        np.array([[0.0], [1.0], [1.0]]) * gain if coupled else np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]) * gain
    )
    dofs = coupling.shape[1]
    tree = KinematicTree(
        link_names=("base", "left", "right"),
        parents=np.array([-1, 0, 0], np.int32),
        joint_names=("", "left_slide", "right_slide"),
        joint_types=np.array([FIXED, PRISMATIC, PRISMATIC], np.int8),
        X_parent_joint=X,
        axes=np.array([[0.0, 0, 0], [1.0, 0, 0], [-1.0, 0, 0]]),
        coupling=coupling,
        offset=np.zeros(3),
        dof_names=tuple(f"jaw_{i}" for i in range(dofs)),
        lower=np.zeros(dofs),
        upper=np.full(dofs, 0.04 / gain),
        effort=np.full(dofs, effort),
    )
    parts = [ConvexPart(link=0, kind=PartKind.BOX, size=np.array([0.05, 0.02, 0.02]), X_LP=np.eye(4))]
    for link, side in ((1, 1.0), (2, -1.0)):
        X_LP = np.eye(4)
        X_LP[0, 3] = side * PAD_HALF[0]
        parts.append(ConvexPart(link=link, kind=PartKind.BOX, size=PAD_HALF, X_LP=X_LP))
    X_HP = np.eye(4)
    X_HP[2, 3] = 0.02
    return Hand(
        name="toy",
        tree=tree,
        parts=tuple(parts),
        fingers=(),
        X_HP=X_HP,
        closing_rate=np.full(dofs, -1.0),
        q_open=np.full(dofs, 0.04 / gain),
        preshape_lower=np.full(dofs, 0.04 / gain),
        preshape_upper=np.full(dofs, 0.04 / gain),
        preshape_groups=(tuple(range(dofs)),),
        is_jaw=True,
        jaw_pad_H=np.array([0.0, 0.0, 0.1]),
        licence="MIT",
        provenance="tests",
    )


def toy_box(*, centre: tuple[float, float, float] = (0.0, 0.0, 0.0), mass_kg: float = 0.2) -> ObjectModel:
    """A box of half extents `HALF` around `centre` of its own frame."""
    vertices = _CORNERS * HALF + np.array(centre)
    return ObjectModel(
        name="box",
        mesh=Mesh(vertices=vertices, faces=_FACES),
        sdf=SdfGrid(values=np.zeros((2, 2, 2), np.float32), origin=np.zeros(3), spacing=1.0),
        points_O=vertices,
        normals_O=_CORNERS / np.sqrt(3.0),
        convex_parts=(vertices,),
        mass_kg=mass_kg,
        com_O=np.array(centre),
        friction=0.6,
        symmetry=SymmetryGroup(
            rotations=np.eye(4)[None], continuous_axis=None, centre=np.array(centre), tolerance_m=0.001
        ),
        content_hash="toy",
        provenance={"source": "tests"},
    )


def toy_grasps(hand: Hand, centres_H: np.ndarray, *, obj: ObjectModel, squeeze_m: float = 0.01) -> GraspSet:
    """Grasps of an upright box whose centre is at `centres_H` (N, 3) in the hand; (0, 0, 0.1) is central."""
    count, dofs = len(centres_H), hand.num_dofs
    gain = hand.tree.coupling.max()
    X_OH = np.tile(np.eye(4), (count, 1, 1))
    X_OH[:, :3, 3] = obj.com_O - centres_H
    q = np.full((count, dofs), CLOSED / gain)
    return GraspSet(
        hand=hand.name,
        object=obj.name,
        X_OH=X_OH,
        q=q,
        q_pregrasp=q + 0.01 / gain,
        q_squeeze=q - squeeze_m / gain,
        contact_points_O=np.zeros((count, 0, 3)),
        contact_normals_O=np.zeros((count, 0, 3)),
        contact_links=np.zeros((count, 0), np.int32),
        epsilon=np.zeros(count),
        penetration_m=np.zeros(count),
    )
