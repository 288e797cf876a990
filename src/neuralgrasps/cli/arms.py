"""`neuralgrasps arms`: list the built-in arms, and show how any arm file is read."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from neuralgrasps.cli.options import NamePath, OptionalFile, OptionalText
from neuralgrasps.cli.outputs import check_writable, make_parent
from neuralgrasps.cli.terminal import Cell, Outcome, Terminal

if TYPE_CHECKING:
    import numpy as np

    from neuralgrasps.arms.arm import Arm
    from neuralgrasps.arms.manipulator import Manipulator


def list_arms(terminal: Terminal, /) -> Outcome:
    """List the arms that come with the library."""
    from neuralgrasps.arms.zoo import arm_names, load_arm

    arms = [load_arm(name) for name in arm_names()]
    rows = [(a.name, len(a.joints), "yes" if a.camera else "no", f"{a.table_height_m:.2f} m", a.licence) for a in arms]
    terminal.table(("arm", "joints", "camera", "table", "licence"), rows)
    terminal.say("Any URDF or MJCF file of an arm works too: neuralgrasps arms show my_arm.urdf")
    return Outcome(result={"arms": [arm_record(a) for a in arms]})


def show_arm(
    terminal: Terminal,
    name: NamePath,
    /,
    *,
    hand: OptionalText = None,
    flange: OptionalText = None,
    base: OptionalText = None,
    picture: OptionalFile = None,
    missing_meshes: Literal["error", "skip"] = "error",
) -> Outcome:
    """Show joints, limits, flange and camera of an arm, and where a hand goes on it.

    In a file the flange is found: tool0, flange, ee_link, or what the hand of a whole robot hangs on. An `arm.toml`
    or `<file>.toml` beside the file overrides whatever was derived.

    Args:
        name: built-in name, or a URDF or MJCF file of an arm or a whole robot.
        hand: hand to mount; the arm's own, or the Franka hand, when not given.
        flange: link that hands are mounted on.
        base: link to take for the base, with what hangs on it.
        picture: PNG file to draw the arm and the hand into.
        missing_meshes: skip leaves out link shapes whose mesh files are missing.
    """
    from neuralgrasps.arms.mount import mount
    from neuralgrasps.arms.zoo import load_arm
    from neuralgrasps.hands.zoo import hand_names, load_hand

    if picture is not None:
        check_writable(picture)
    source = Path(name) if Path(name).exists() else name
    arm = load_arm(source, flange=flange, base=base, missing_meshes=missing_meshes)
    robot = mount(arm, load_hand(hand or (arm.name if arm.name in hand_names() else "panda")))
    _describe(terminal, robot)
    repairs, assumed = (arm.extra.get(key, "").splitlines() for key in ("repairs", "assumed"))
    terminal.notes(repairs, title="\nMended:")
    terminal.notes(assumed, title="\nAssumed:")
    if picture is not None:
        save_arm_picture(robot, picture)
        terminal.say(f"Picture: {picture}")
    files = {"picture": str(picture)} if picture else {}
    mounted = {"hand": robot.hand.name, "X_FH_m": robot.tree.X_parent_joint[robot.hand_link]}
    return Outcome(result={**arm_record(arm), **mounted, "repairs": repairs, "assumed": assumed, **files})


def _describe(terminal: Terminal, robot: Manipulator) -> None:
    arm = robot.arm
    facts: list[tuple[str, Cell]] = [
        ("planned joints", len(arm.joints)),
        ("flange", arm.tree.link_names[arm.flange]),
        ("mounting face", f"{_millimetres(arm.X_FM)} of the flange, out along {_direction(arm.X_FM)}"),
        ("home", _home(arm)),
        ("camera", "none" if arm.camera is None else f"on {arm.tree.link_names[arm.camera.link]}"),
        ("table", f"{arm.table_height_m:.2f} m above the base"),
        ("convex parts", len(arm.parts)),
        ("hand", f"{robot.hand.name}, its base at {_place(robot)} of the flange"),
        ("licence", arm.licence),
        ("source", " ".join(arm.provenance.split())),
    ]
    terminal.say(arm.name)
    terminal.facts(facts)
    columns = ("joint", "unit", "lower", "upper", "home", "velocity", "acceleration", "effort", "use")
    terminal.table(columns, [_joint_row(arm, j) for j in range(arm.tree.num_dofs)])


def _place(robot: Manipulator) -> str:
    return _millimetres(robot.tree.X_parent_joint[robot.hand_link])


def _millimetres(X: np.ndarray) -> str:
    return "({:.1f}, {:.1f}, {:.1f}) mm".format(*(1e3 * float(v) + 0.0 for v in X[:3, 3]))


def _direction(X: np.ndarray) -> str:
    return "({:.2f}, {:.2f}, {:.2f})".format(*(round(float(v), 2) + 0.0 for v in X[:3, 2]))


def _home(arm: Arm) -> str:
    from neuralgrasps.kinematics.forward_kernels import forward_numpy

    X_BM = forward_numpy(arm.tree, arm.q_home)[arm.flange] @ arm.X_FM
    return f"mounting face at {_millimetres(X_BM)} of the base, looking along {_direction(X_BM)}"


def _slides(arm: Arm, joint: int) -> bool:
    from neuralgrasps.kinematics.tree import PRISMATIC

    tree = arm.tree
    return bool(tree.joint_types[tree.joint_names.index(tree.dof_names[joint])] == PRISMATIC)


def _joint_row(arm: Arm, joint: int) -> tuple[Any, ...]:
    slides = _slides(arm, joint)
    scale, unit = (1e3, "mm") if slides else (180 / math.pi, "deg")
    tree = arm.tree
    values = (tree.lower, tree.upper, arm.q_home, arm.velocity, arm.acceleration)
    lower, upper, *others = (f"{float(v[joint]) * scale:.1f}" for v in values)
    limits = ("none", "none") if arm.continuous[joint] else (lower, upper)
    effort = f"{tree.effort[joint]:.4g} {'N' if slides else 'N m'}"
    return (tree.dof_names[joint], unit, *limits, *others, effort, "planned" if joint in arm.joints else "at rest")


def arm_record(arm: Arm) -> dict[str, Any]:
    """An arm as JSON: angles in rad, lengths in m."""
    tree, joints = arm.tree, []
    for j, name in enumerate(tree.dof_names):
        slides = _slides(arm, j)
        unit = "m" if slides else "rad"
        joints.append(
            {
                "name": name,
                "type": "prismatic" if slides else "continuous" if arm.continuous[j] else "revolute",
                "planned": bool(j in arm.joints),
                f"lower_{unit}": float(tree.lower[j]),
                f"upper_{unit}": float(tree.upper[j]),
                f"home_{unit}": float(arm.q_home[j]),
                f"velocity_{unit}_s": float(arm.velocity[j]),
                f"acceleration_{unit}_s2": float(arm.acceleration[j]),
                f"effort_{'n' if slides else 'nm'}": float(tree.effort[j]),
            }
        )
    return {
        "name": arm.name,
        "joints": joints,
        "flange": tree.link_names[arm.flange],
        "X_FM_m": arm.X_FM,
        "camera": None if arm.camera is None else {"link": tree.link_names[arm.camera.link], "X_LC_m": arm.camera.X_LC},
        "table_height_m": arm.table_height_m,
        "convex_parts": len(arm.parts),
        "licence": arm.licence,
        "provenance": arm.provenance,
    }


def save_arm_picture(robot: Manipulator, path: Path) -> None:
    """Draw the robot at home from two sides, and its wrist, side by side."""
    import numpy as np

    from neuralgrasps.report.arm_figure import render_arm
    from neuralgrasps.report.figures import save_picture
    from neuralgrasps.report.views import view_direction

    make_parent(path)
    views = [render_arm(robot), render_arm(robot, view=view_direction(-90, 8)), render_arm(robot, close=True)]
    save_picture(path, np.concatenate(views, axis=1))
