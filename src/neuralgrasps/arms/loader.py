"""From a robot file's contents and notes on it to an `Arm`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from neuralgrasps.arms.arm import Arm, ArmCamera
from neuralgrasps.arms.flange import MIN_JOINTS, find_face
from neuralgrasps.arms.home import free_posture
from neuralgrasps.arms.notes import ArmNotes, CameraNotes
from neuralgrasps.errors import RobotDescriptionError, unknown_name
from neuralgrasps.hands.hand import ConvexPart
from neuralgrasps.hands.loader import convex_parts
from neuralgrasps.kinematics.description import RobotDescription
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.kinematics.subtree import without_links_beyond
from neuralgrasps.kinematics.tree import PRISMATIC, REVOLUTE, KinematicTree

TURN = 2 * np.pi  # a continuous joint may turn once to either side
DEFAULT_SPEED = 1.0  # rad/s, where a file gives none: below that of every arm in common use
DEFAULT_TRAVEL_SPEED = 0.1  # m/s, the Fetch torso's
_TABLE_BELOW_SHOULDER_M = 0.35
RISE_TIME = 0.5  # s to reach the largest speed, where nothing states the acceleration


def arm_from_description(description: RobotDescription, notes: ArmNotes, *, flange: str) -> Arm:
    """Build an arm up to the link `flange`; what hangs beyond it is cut off.

    Joints that do not move the flange stay, at rest.

    Returns:
        the arm; `extra["repairs"]` says what was mended, `extra["assumed"]` what was guessed, one sentence a line.
    Raises:
        RobotDescriptionError: no geometry, too few joints, contradictory limits, or names the robot does not have.
    """
    full, name = description.tree, notes.name or description.name
    if flange not in full.link_names:
        raise RobotDescriptionError(f"arm '{name}': {unknown_name('link', flange, full.link_names)}")
    _check_limits(name, description)
    tree, kept = without_links_beyond(full, full.link_names.index(flange))
    _check_names(name, tree, notes)
    continuous = np.array([n in description.drives and description.drives[n].continuous for n in tree.dof_names], bool)
    endless = [n for n, c in zip(tree.dof_names, continuous, strict=True) if c]
    tree = replace(tree, lower=np.where(continuous, -TURN, tree.lower), upper=np.where(continuous, TURN, tree.upper))
    parts, repairs = _parts(description, kept)
    link = tree.link_names.index(flange)
    assumed: list[str] = []
    velocity = _speeds(description, tree, notes, assumed)
    acceleration = _accelerations(tree, notes, velocity, assumed)
    joints = _planned(name, tree, link, notes)
    X_FM = find_face(tree, parts, link) if notes.X_FM is None else notes.X_FM
    q_home = _home(tree, parts, joints, notes)
    return Arm(
        name=name,
        tree=tree,
        parts=parts,
        flange=link,
        X_FM=X_FM,
        joints=joints,
        continuous=continuous,
        q_home=q_home,
        velocity=velocity,
        acceleration=acceleration,
        camera=None if notes.camera is None else _camera(name, tree, notes.camera),
        table_height_m=_table_height(tree, link, q_home) if notes.table_height_m is None else notes.table_height_m,
        licence=notes.licence or "not stated",
        provenance=notes.provenance or description.source.name,
        extra={
            "repairs": "\n".join((*_repairs(description.repairs, endless), *repairs)),
            "assumed": "\n".join(assumed),
        },
    )


def _table_height(tree: KinematicTree, flange: int, q_home: np.ndarray) -> float:
    """A table 35 cm below the second turning joint, the shoulder; at the base of an arm that stands on its table."""
    chain = [flange]
    while tree.parents[chain[-1]] >= 0:
        chain.append(int(tree.parents[chain[-1]]))
    turning = [i for i in reversed(chain) if tree.joint_types[i] == REVOLUTE]
    return max(0.0, float(forward_numpy(tree, q_home)[turning[1], 2, 3]) - _TABLE_BELOW_SHOULDER_M)


def _check_limits(name: str, description: RobotDescription) -> None:
    for joint, drive in description.drives.items():
        if drive.lower is not None and drive.upper is not None and drive.lower > drive.upper:
            raise RobotDescriptionError(
                f"arm '{name}': joint '{joint}' has the lower limit {drive.lower:g} above the upper one "
                f"{drive.upper:g}; a hand's are swapped, an arm would move where it must not: correct the file."
            )


def _check_names(name: str, tree: KinematicTree, notes: ArmNotes) -> None:
    for joint in notes.joints:
        if joint not in tree.dof_names:
            raise RobotDescriptionError(f"arm '{name}': {unknown_name('joint', joint, tree.dof_names)}")


def _parts(description: RobotDescription, kept: np.ndarray) -> tuple[tuple[ConvexPart, ...], tuple[str, ...]]:
    new_index = {int(old): new for new, old in enumerate(kept)}
    shapes = tuple(g for g in description.geometries if g.link in new_index)
    parts, repairs = convex_parts(replace(description, geometries=shapes))
    if not parts:
        raise RobotDescriptionError(
            f"arm '{description.name}' has no geometry; add a collision or visual shape to its links."
        )
    return tuple(replace(p, link=new_index[p.link]) for p in parts), repairs


def _planned(name: str, tree: KinematicTree, flange: int, notes: ArmNotes) -> np.ndarray:
    """Indices of the joints that move the flange, unless the notes say otherwise."""
    moves, link = np.zeros(tree.num_dofs, bool), flange
    while link > 0:
        moves |= tree.coupling[link] != 0
        link = int(tree.parents[link])
    resting = {n for n, j in notes.joints.items() if j.planned is False}
    chain = [j for j in np.flatnonzero(moves) if tree.dof_names[j] not in resting]
    if len(chain) < MIN_JOINTS:
        raise RobotDescriptionError(
            f"arm '{name}' moves the link '{tree.link_names[flange]}' with {len(chain)} joints; expected at least "
            f"{MIN_JOINTS}. Name another flange."
        )
    return np.array(chain, np.int64)


def _home(tree: KinematicTree, parts: Sequence[ConvexPart], joints: np.ndarray, notes: ArmNotes) -> np.ndarray:
    stated = {n: j.home for n, j in notes.joints.items() if j.home is not None}
    if all(tree.dof_names[j] in stated for j in joints):
        rest = np.clip(0.0, tree.lower, tree.upper)
        return np.array([stated.get(n, rest[j]) for j, n in enumerate(tree.dof_names)], float)
    return free_posture(tree, parts, joints, stated)


def _camera(name: str, tree: KinematicTree, notes: CameraNotes) -> ArmCamera:
    if notes.link not in tree.link_names:
        raise RobotDescriptionError(f"arm '{name}': camera: {unknown_name('link', notes.link, tree.link_names)}")
    return ArmCamera(link=tree.link_names.index(notes.link), X_LC=notes.X_LC, intrinsics=notes.intrinsics)


def _repairs(lines: Sequence[str], endless: Sequence[str]) -> list[str]:
    """Remarks of the reader, with the limits that joints that turn without end get in an arm."""
    replaced = ("continuous joints were given", *(f"joint '{name}' has no lower and upper limit" for name in endless))
    found = [line for line in lines if not line.startswith(replaced)]
    return (
        [*found, f"joints that turn without end have the limits -2 pi..2 pi: {', '.join(endless)}."]
        if endless
        else found
    )


def _speeds(description: RobotDescription, tree: KinematicTree, notes: ArmNotes, lines: list[str]) -> np.ndarray:
    """(Q,) largest speeds: from the notes, else the file, else a default that is added to `lines`."""
    speeds, assumed = np.zeros(tree.num_dofs), []
    for j, name in enumerate(tree.dof_names):
        drive, given = description.drives.get(name), notes.joints.get(name)
        found = [given.velocity if given else None, drive.velocity if drive else None]
        usable = [v for v in found if v is not None and 0 < v < np.inf]
        slides = tree.joint_types[tree.joint_names.index(name)] == PRISMATIC
        speeds[j] = usable[0] if usable else (DEFAULT_TRAVEL_SPEED if slides else DEFAULT_SPEED)
        assumed += [] if usable else [name]
    if assumed:
        lines.append(
            f"no usable speed limit for {', '.join(assumed)}: {DEFAULT_SPEED:g} rad/s or "
            f"{DEFAULT_TRAVEL_SPEED:g} m/s assumed."
        )
    return speeds


def _accelerations(tree: KinematicTree, notes: ArmNotes, speeds: np.ndarray, lines: list[str]) -> np.ndarray:
    """(Q,) largest accelerations: from the notes, else those that reach the largest speed in `RISE_TIME`."""
    given = [j.acceleration if (j := notes.joints.get(n)) else None for n in tree.dof_names]
    assumed = [n for n, a in zip(tree.dof_names, given, strict=True) if a is None]
    if assumed:
        lines.append(
            f"no acceleration limit for {', '.join(assumed)}: such that the largest speed is reached in "
            f"{RISE_TIME:g} s."
        )
    return np.array([v / RISE_TIME if a is None else a for a, v in zip(given, speeds, strict=True)], float)
