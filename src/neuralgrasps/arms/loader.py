"""From a robot file's contents and notes on it to an `Arm`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from neuralgrasps.arms.arm import Arm, ArmCamera
from neuralgrasps.arms.flange import FLANGE_NAMES, MIN_JOINTS, find_face
from neuralgrasps.arms.home import free_posture, middle_posture
from neuralgrasps.arms.notes import ArmNotes, CameraNotes
from neuralgrasps.arms.ready import ReadyScene
from neuralgrasps.errors import RobotDescriptionError, unknown_name
from neuralgrasps.hands.hand import ConvexPart
from neuralgrasps.hands.loader import convex_parts
from neuralgrasps.kinematics.assemble import DEFAULT_FORCE, DEFAULT_TORQUE
from neuralgrasps.kinematics.description import RobotDescription
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.kinematics.subtree import without_links_beyond
from neuralgrasps.kinematics.tree import PRISMATIC, REVOLUTE, KinematicTree

TURN = 2 * np.pi  # a continuous joint may turn once to either side
DEFAULT_SPEED = 1.0  # rad/s, where a file gives none: below that of every arm in common use
DEFAULT_TRAVEL_SPEED = 0.1  # m/s, the Fetch torso's
_TABLE_BELOW_SHOULDER_M = 0.35
_ARM_NM, _WRIST_NM, _SLIDING_N = 150.0, 30.0, 2000.0  # carry an arm of 1 m and 5 kg
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
    tree = _with_efforts(description, tree, joints, assumed)
    X_FM = _face(tree, parts, link, assumed) if notes.X_FM is None else notes.X_FM
    table = _table_height(tree, link, joints, notes, assumed)
    q_home = _home(tree, parts, joints, notes, ReadyScene(flange=link, X_FM=X_FM, table_height_m=table), assumed)
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
        table_height_m=table,
        licence=notes.licence or "not stated",
        provenance=notes.provenance or description.source.name,
        extra={
            "repairs": "\n".join((*_repairs(description.repairs, endless), *repairs)),
            "assumed": "\n".join(assumed),
        },
    )


def _table_height(tree: KinematicTree, flange: int, joints: np.ndarray, notes: ArmNotes, lines: list[str]) -> float:
    """A table 35 cm below the second turning joint, the shoulder; at the base of an arm that stands on its table."""
    if notes.table_height_m is not None:
        return notes.table_height_m
    chain = [flange]
    while tree.parents[chain[-1]] >= 0:
        chain.append(int(tree.parents[chain[-1]]))
    turning = [i for i in reversed(chain) if tree.joint_types[i] == REVOLUTE]
    shoulder = turning[min(1, len(turning) - 1)] if turning else flange
    middle, _ = middle_posture(tree, joints, _stated(notes))
    height = max(0.0, float(forward_numpy(tree, middle)[shoulder, 2, 3]) - _TABLE_BELOW_SHOULDER_M)
    lines.append(f"table_height is not stated: {height:.2f} m above the base, from the height of the shoulder.")
    return height


def _face(tree: KinematicTree, parts: Sequence[ConvexPart], flange: int, lines: list[str]) -> np.ndarray:
    X_FM, name = find_face(tree, parts, flange), tree.link_names[flange]
    if not name.endswith(FLANGE_NAMES):
        x, y, z = 1e3 * X_FM[:3, 3]
        out = ", ".join(f"{v + 0.0:.2f}" for v in np.round(X_FM[:3, 2], 2))
        lines.append(
            f"no [face] is stated and '{name}' is no {FLANGE_NAMES[0]} or {FLANGE_NAMES[1]} frame: the mounting face "
            f"is at the end of its shape, ({x:.1f}, {y:.1f}, {z:.1f}) mm, out along ({out})."
        )
    return X_FM


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


def _stated(notes: ArmNotes) -> dict[str, float]:
    return {n: j.home for n, j in notes.joints.items() if j.home is not None}


def _home(
    tree: KinematicTree,
    parts: Sequence[ConvexPart],
    joints: np.ndarray,
    notes: ArmNotes,
    scene: ReadyScene,
    lines: list[str],
) -> np.ndarray:
    stated = _stated(notes)
    missing = [tree.dof_names[j] for j in joints if tree.dof_names[j] not in stated]
    if not missing:
        rest = np.clip(0.0, tree.lower, tree.upper)
        return np.array([stated.get(n, rest[j]) for j, n in enumerate(tree.dof_names)], float)
    lines.append(f"home is not stated for {', '.join(missing)}: a posture above the table was searched.")
    return free_posture(tree, parts, joints, stated, scene)


def _with_efforts(
    description: RobotDescription, tree: KinematicTree, joints: np.ndarray, lines: list[str]
) -> KinematicTree:
    """The tree with efforts that carry an arm where the file has none that can be used; `lines` says which."""
    slides = [tree.joint_types[tree.joint_names.index(n)] == PRISMATIC for n in tree.dof_names]
    turning = [int(j) for j in joints if not slides[j]]
    wrist = turning[max(3, len(turning) - 3) :]
    effort, assumed = tree.effort.copy(), []
    for j, name in enumerate(tree.dof_names):
        drive = description.drives.get(name)
        found = None if drive is None else drive.effort
        follower = tree.effort[j] != (DEFAULT_FORCE if slides[j] else DEFAULT_TORQUE)
        if _usable(found) or follower:
            continue
        effort[j] = _SLIDING_N if slides[j] else _WRIST_NM if j in wrist else _ARM_NM
        assumed.append(f"{name} ({_found(found)}): {effort[j]:g} {'N' if slides[j] else 'N m'}")
    if assumed:
        lines.append(f"no usable effort limit in the file; assumed for {', '.join(assumed)}.")
    return replace(tree, effort=effort)


def _usable(value: float | None) -> bool:
    return value is not None and 0 < value < np.inf


def _found(value: float | None) -> str:
    return "none" if value is None else f"found {value:g}"


def _camera(name: str, tree: KinematicTree, notes: CameraNotes) -> ArmCamera:
    if notes.link not in tree.link_names:
        raise RobotDescriptionError(f"arm '{name}': camera: {unknown_name('link', notes.link, tree.link_names)}")
    return ArmCamera(link=tree.link_names.index(notes.link), X_LC=notes.X_LC, intrinsics=notes.intrinsics)


def _repairs(lines: Sequence[str], endless: Sequence[str]) -> list[str]:
    """Remarks of the reader, with the limits that joints that turn without end get in an arm."""
    replaced = (
        "continuous joints were given",
        "effort is ",
        *(f"joint '{name}' has no lower and upper limit" for name in endless),
    )
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
        usable = [v for v in found if v is not None and _usable(v)]
        slides = tree.joint_types[tree.joint_names.index(name)] == PRISMATIC
        speeds[j] = usable[0] if usable else (DEFAULT_TRAVEL_SPEED if slides else DEFAULT_SPEED)
        assumed += [] if usable else [f"{name} ({_found(drive.velocity if drive else None)})"]
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
