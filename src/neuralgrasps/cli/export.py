"""`neuralgrasps export`: grasps in the formats of robot software."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from neuralgrasps.cli.options import File, OptionalInt, OptionalText, PositionalFile
from neuralgrasps.cli.outputs import check_writable
from neuralgrasps.cli.terminal import Outcome, Terminal, counted
from neuralgrasps.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from neuralgrasps.export.frames import Wrist
    from neuralgrasps.grasps.grasp_set import GraspSet
    from neuralgrasps.hands.hand import Hand

_START = 4096  # bytes in which a file's format stands
WORLD = "world"  # MoveIt's planning frame, where nothing else says which way is up

Pose = Annotated[
    tuple[float, float, float, float, float, float, float] | None,
    tyro.conf.arg(metavar="X Y Z QX QY QZ QW", help_behavior_hint="(default: at the origin of --frame)"),
]


def export(
    terminal: Terminal,
    grasps: PositionalFile,
    /,
    *,
    out: File,
    format: Literal["moveit", "isaac"],
    hand: OptionalText = None,
    arm: OptionalText = None,
    frame: OptionalText = None,
    pose: Pose = None,
    up_frame: OptionalText = None,
    count: OptionalInt = None,
    failed: bool = False,
    ros: Literal[1, 2] = 2,
) -> Outcome:
    """Write the grasps of a file in a format that robot software reads.

    moveit: a list of moveit_msgs/Grasp as YAML; each pose is that of the link before the hand. isaac: an isaac_grasp
    1.0 file; each pose is that of the hand base in the object's mesh frame. Motions are written by `execute`.

    Args:
        grasps: grasp file that `synthesise` or `novel` wrote.
        out: YAML file to write.
        format: moveit or isaac.
        hand: the hand's name or file, if it is not built in.
        arm: name or file of the arm that the hand is on: poses are then of its last link. Without it they are of the
            hand's base link.
        frame: frame of the poses; default the object's own, by the object's name.
        pose: of the object in --frame: position in metres, quaternion x y z w.
        up_frame: frame whose z axis is up, for the lift; default --frame, or "world" without it.
        count: only so many, of the best quality.
        failed: also grasps that dropped the object in their trial.
        ros: 1 or 2, for moveit.
    """
    from neuralgrasps.export.isaac_grasp import save_isaac_grasps
    from neuralgrasps.export.moveit_grasp import GraspMessageConfig, save_moveit_grasps
    from neuralgrasps.grasps.grasp_io import load_grasps
    from neuralgrasps.hands.zoo import load_hand

    check_writable(out)
    _check_options(format, {"--arm": arm, "--frame": frame, "--pose": pose, "--up-frame": up_frame}, frame, pose)
    _check_not_exported(grasps)
    loaded = load_grasps(grasps)
    model = load_hand(hand or loaded.hand)
    index = _chosen(loaded, count=count, failed=failed, path=grasps)
    chosen, names = loaded[index], [f"grasp_{i}" for i in index]
    if format == "isaac":
        save_isaac_grasps(out, chosen, model, names=names)
        link = model.tree.link_names[0]
        about = f"poses of link '{link}' in the frame of '{loaded.object}'"
    else:
        wrist = _wrist(model, arm)
        link, frame_id = wrist.link, frame or loaded.object
        config = GraspMessageConfig(up_frame=up_frame or ("" if frame else WORLD), ros=ros)
        save_moveit_grasps(
            out, chosen, model, frame_id=frame_id, X_frame_O=_matrix(pose), wrist=wrist, names=names, config=config
        )
        about = f"poses of link '{link}' in frame '{frame_id}'; up is z of '{config.up_frame or frame_id}'"
    terminal.say(f"{counted(len(chosen), 'grasp')} of {len(loaded)} by {loaded.hand} on {loaded.object}: {about}.")
    terminal.say(f"Written: {out}")
    result: dict[str, Any] = {
        "format": format,
        "out": str(out),
        "hand": loaded.hand,
        "object": loaded.object,
        "link": link,
        "grasps": len(chosen),
        "index": [int(i) for i in index],
    }
    return Outcome(result=result)


def _check_options(format: str, moveit_only: dict[str, object], frame: str | None, pose: object) -> None:
    given = [name for name, value in moveit_only.items() if value is not None]
    if format == "isaac" and given:
        are, them = ("is an option", "it") if len(given) == 1 else ("are options", "them")
        raise InputError(
            f"{', '.join(given)} {are} of --format moveit; an isaac_grasp file has no place for {them}. "
            f"Leave {them} out."
        )
    if pose is not None and frame is None:
        raise InputError("--pose is the object's pose in a frame; name that frame with --frame.")


def _check_not_exported(path: Path) -> None:
    """Say what a file is that we wrote as YAML, before it is read as a grasp file."""
    try:
        with path.open("rb") as file:
            start = file.read(_START)
    except OSError:
        return  # reading the grasps says why
    found = re.search(rb"^format: *['\"]?([\w./\[\]]+)", start, re.MULTILINE)
    kind = found[1].decode(errors="replace") if found else ""
    if kind == "neuralgrasps.pick_plan":
        raise InputError(
            f"'{path}' is the plan of one pick, not a grasp file, and is in its own format for robots already "
            "(docs/conventions.md). Give the grasp file that `synthesise` or `novel` wrote."
        )
    if kind in ("moveit_msgs/Grasp[]", "isaac_grasp"):
        raise InputError(
            f"'{path}' already holds exported grasps ({kind}). Give the grasp file that `synthesise` or `novel` wrote."
        )


def _chosen(grasps: GraspSet, *, count: int | None, failed: bool, path: Path) -> np.ndarray:
    """Places of the grasps to write, in the file's order."""
    import numpy as np

    if count is not None and count < 1:
        raise InputError(f"--count is {count}; expected 1 or more.")
    tried = grasps.protocol in grasps.verdicts
    index = np.arange(len(grasps)) if failed or not tried else np.flatnonzero(grasps.validated)
    if not len(index):
        more = " None held its trial; --failed writes them all the same." if len(grasps) else ""
        raise InputError(f"'{path}' holds {counted(len(grasps), 'grasp')}, none to export.{more}")
    best = np.argsort(-grasps.epsilon[index], kind="stable")[:count]
    return np.asarray(index[np.sort(best)])


def _wrist(hand: Hand, arm: str | None) -> Wrist:
    from neuralgrasps.export.frames import hand_base, wrist_of

    if arm is None:
        return hand_base(hand)
    from neuralgrasps.arms.mount import mount
    from neuralgrasps.arms.zoo import load_arm

    return wrist_of(mount(load_arm(arm), hand))


def _matrix(pose: tuple[float, ...] | None) -> np.ndarray:
    import numpy as np

    from neuralgrasps.geometry.se3_numpy import make_transform_np, quaternion_matrix

    if pose is None:
        return np.eye(4)
    x, y, z, qx, qy, qz, qw = pose
    length = float(np.linalg.norm(pose[3:]))
    if not abs(length - 1.0) < 0.01:
        raise InputError(f"--pose has a quaternion of length {length:.3g}; expected x y z w of length 1.")
    return make_transform_np(quaternion_matrix([qw, qx, qy, qz]), [x, y, z])
