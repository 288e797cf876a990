"""Hands that nobody has seen, written by code, with what a reader of their files should find.

Each function writes one robot file into a folder. Palm normals are in the base frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh

from .wild_urdf import QUARTER, Vector, new_robot, turned


@dataclass(frozen=True, slots=True, kw_only=True)
class Wild:
    """A robot file and the truth about it.

    Attributes:
        normal: (3,) where the palm faces in the base frame; fingers: how many; dofs: independent joints.
        closing: sign of the closing rate of each joint, 0 for those that do not close; thumb: name of its first link.
        said: words that the repairs or derivations must hold.
    """

    path: Path
    normal: np.ndarray
    fingers: int
    closing: dict[str, int]
    is_jaw: bool = False
    thumb: str = ""
    said: tuple[str, ...] = ()
    efforts: dict[str, float] = field(default_factory=dict)

    @property
    def dofs(self) -> int:
        return len(self.closing)


def two_slides(folder: Path) -> Wild:
    """Parallel jaw, two sliders without coupling, effort 0, the palm facing +x of its base."""
    robot = new_robot(folder, "two_slides")
    robot.link("body", robot.box((0.1, 0.13, 0.06), (-0.05, 0, 0)))
    for name, side in (("left", 1.0), ("right", -1.0)):
        robot.link(f"{name}_pad", robot.box((0.06, 0.012, 0.024), (0.03, 0.006 * side, 0)))
        robot.joint(
            f"{name}_slide", "body", f"{name}_pad", kind="prismatic", axis=(0, side, 0), limits=(0, 0.045), effort=0
        )
    return Wild(
        path=robot.write(), normal=np.array([1.0, 0, 0]), fingers=2, closing={"left_slide": -1}, is_jaw=True,
        said=("were coupled", "effort is missing, 0"), efforts={"left_slide": 20.0},
    )  # fmt: skip


def rising_jaw(folder: Path) -> Wild:
    """Parallel jaw whose joint rises as it closes, meshes in millimetres, visual only, `package://`, facing -z."""
    robot = new_robot(
        folder, "rising_jaw", mesh_as="stl", millimetres=True, shapes_as=("visual",), prefix="package://somewhere/"
    )
    robot.link("body", robot.box((0.12, 0.05, 0.05), (0, 0, 0.025), rpy=(0, 0, np.pi)))
    for name, side in (("a", 1.0), ("b", -1.0)):
        robot.link(f"jaw_{name}", robot.box((0.06, 0.02, 0.01), (0, 0, -0.03), rpy=(0, QUARTER, 0)))
        mimic = None if name == "a" else ("jaw_a_joint", -1.0, 0.0)
        limits = (0, 0.04) if name == "a" else (-0.04, 0)
        robot.joint(
            f"jaw_{name}_joint", "body", f"jaw_{name}", (0.045 * side, 0, 0), kind="prismatic", axis=(-1, 0, 0),
            limits=limits, effort=40, mimic=mimic,
        )  # fmt: skip
    return Wild(
        path=robot.write(), normal=np.array([0, 0, -1.0]), fingers=2, closing={"jaw_a_joint": 1}, is_jaw=True,
        said=("no collision shape",),
    )  # fmt: skip


def linkage_jaw(folder: Path) -> Wild:
    """Gripper of rotary linkages: one driven knuckle, five followers, pads that stay parallel; on a flange."""
    robot = new_robot(folder, "linkage_jaw")
    rpy: Vector = (0.0, QUARTER, 0.0)
    robot.mount("body", rpy)
    robot.link("body", robot.cylinder(0.04, 0.06, (0, 0, 0.03)))
    for name, side in (("left", 1.0), ("right", -1.0)):
        yaw = (0.0, 0.0, 0.0) if side > 0 else (0.0, 0.0, np.pi)
        follow = None if side > 0 else ("left_knuckle_joint", 1.0, 0.0)
        robot.link(f"{name}_knuckle", robot.box((0.035, 0.02, 0.01), (0.016, 0, 0)))
        robot.joint(
            f"{name}_knuckle_joint", "body", f"{name}_knuckle", (0.03 * side, 0, 0.055), yaw, axis=(0, -1, 0),
            limits=(0, 0.8), effort=10, mimic=follow,
        )  # fmt: skip
        robot.link(f"{name}_outer", robot.box((0.01, 0.02, 0.045), (0, 0, 0.022)))
        robot.joint(f"{name}_outer_joint", f"{name}_knuckle", f"{name}_outer", (0.032, 0, 0), kind="fixed")
        robot.link(f"{name}_inner", robot.box((0.006, 0.02, 0.056), (0.018, 0, 0.0235), rpy=(0, 0.653, 0)))
        robot.joint(
            f"{name}_inner_joint", "body", f"{name}_inner", (0.013 * side, 0, 0.061), yaw, axis=(0, -1, 0),
            limits=(0, 0.88), effort=10, mimic=("left_knuckle_joint", 1.0, 0.0),
        )  # fmt: skip
        robot.link(f"{name}_tip", robot.box((0.012, 0.022, 0.05), (-0.012, 0, 0.03)))
        robot.joint(
            f"{name}_tip_joint", f"{name}_outer", f"{name}_tip", (0.004, 0, 0.047), axis=(0, -1, 0),
            limits=(-0.88, 0), effort=10, mimic=("left_knuckle_joint", -1.0, 0.0),
        )  # fmt: skip
    # seen along +y of its own frame a positive turn about -y raises x towards z: it opens the knuckles inwards
    return Wild(
        path=robot.write(), normal=turned(rpy, (0, 0, 1)), fingers=2, closing={"left_knuckle_joint": 1}, is_jaw=True,
        said=("jaw",),
    )  # fmt: skip


def three_adaptive(folder: Path) -> Wild:
    """Two fingers and an opposing one, three joints each in mimic chains, GLB meshes, a scissor joint, facing +y."""
    robot = new_robot(folder, "three_adaptive", mesh_as="glb", shapes_as=("visual", "collision"))
    rpy: Vector = (-QUARTER, 0.0, 0.0)
    robot.mount("palm", rpy)
    robot.link("palm", robot.box((0.09, 0.1, 0.05), (0, 0, -0.025)))
    closing: dict[str, int] = {}
    for name, x, y, yaw in (("a", 0.035, 0.035, 0.0), ("b", 0.035, -0.035, 0.0), ("middle", -0.035, 0.0, np.pi)):
        root, place = "palm", (x, y, 0.0)
        if name != "middle":
            root = f"{name}_scissor"
            robot.link(root)
            mimic = None if name == "a" else ("scissor_a", -1.0, 0.0)
            robot.joint(f"scissor_{name}", "palm", root, place, axis=(0, 0, 1), limits=(-0.2, 0.2), mimic=mimic)
            place = (0.0, 0.0, 0.0)
        robot.chain(
            root, name, place, (0, 0, yaw), (0.045, 0.035, 0.03), axis=(0, -1, 0), limits=(-0.3, 1.2),
            width=0.02, follow={1: (0, 0.8), 2: (1, 0.5)}, effort=2,
        )  # fmt: skip
        closing |= ({"scissor_a": 0} if name == "a" else {}) | {f"{name}_joint_0": 1}
    return Wild(path=robot.write(), normal=turned(rpy, (0, 0, 1)), fingers=3, closing=closing, thumb="middle_0")


def four_dexterous(folder: Path) -> Wild:
    """Three fingers and a thumb of OBJ meshes, four joints each; the thumb's zero is outside its limits."""
    robot = new_robot(folder, "four_dexterous", mesh_as="obj")
    robot.link("palm", robot.box((0.03, 0.11, 0.095), (0, 0, -0.05)))
    closing: dict[str, int] = {}
    for name, y in (("f", 0.042), ("g", 0.0), ("h", -0.042)):
        robot.link(f"{name}_side")
        robot.joint(f"{name}_splay", "palm", f"{name}_side", (0, y, 0), axis=(1, 0, 0), limits=(-0.3, 0.3), effort=0.7)
        robot.chain(
            f"{name}_side", name, (0, 0, 0.004), (0, 0, 0), (0.05, 0.038, 0.028), limits=(-0.2, 1.6), effort=0.7
        )
        closing |= {f"{name}_splay": 0} | {f"{name}_joint_{k}": 1 for k in range(3)}
    robot.link("thumb_base", robot.box((0.03, 0.025, 0.03), (0.01, 0, 0)))
    robot.joint("thumb_swing", "palm", "thumb_base", (0.012, 0.05, -0.075), (0, 0, 0), axis=(0, 0, -1),
                limits=(0.3, 1.5), effort=0.7)  # fmt: skip
    robot.chain("thumb_base", "thumb", (0.03, 0.012, 0.01), (-0.9, 0.5, 0), (0.045, 0.035, 0.03), axis=(1, 0, 0),
                limits=(-0.3, 1.5), effort=0.7)  # fmt: skip
    closing |= {"thumb_swing": 0} | {f"thumb_joint_{k}": 1 for k in range(3)}
    return Wild(path=robot.write(), normal=np.array([1.0, 0, 0]), fingers=4, closing=closing, thumb="thumb_base")


def five_fingers(folder: Path) -> Wild:
    """Anthropomorphic: forearm, two wrist joints, coupled outer joints, thumb abduction, facing its base's -y."""
    robot = new_robot(folder, "five_fingers", shapes_as=("visual", "collision"))
    robot.link("forearm", robot.cylinder(0.035, 0.2, (0, 0, -0.13)))
    robot.link("wrist")
    robot.joint("wrist_nod", "forearm", "wrist", axis=(1, 0, 0), limits=(-0.7, 0.5), effort=10)
    robot.link("palm", robot.box((0.085, 0.026, 0.09), (0, 0, 0.05)))
    robot.joint("wrist_turn", "wrist", "palm", axis=(0, 1, 0), limits=(-0.5, 0.2), effort=10)
    closing: dict[str, int] = {"wrist_nod": 0, "wrist_turn": 0}
    for name, x, lengths in (
        ("index", 0.033, (0.045, 0.027, 0.022)), ("middle", 0.011, (0.05, 0.03, 0.024)),
        ("ring", -0.011, (0.046, 0.028, 0.022)), ("little", -0.033, (0.036, 0.022, 0.02)),
    ):  # fmt: skip
        robot.link(f"{name}_knuckle")
        robot.joint(f"{name}_splay", "palm", f"{name}_knuckle", (x, 0, 0.097), axis=(0, -1, 0), limits=(-0.35, 0.35))
        robot.chain(f"{name}_knuckle", name, (0, 0, 0.002), (0, 0, 0), lengths, axis=(1, 0, 0), limits=(0, 1.57),
                    follow={2: (1, 0.9)}, effort=1.2)  # fmt: skip
        closing |= {f"{name}_splay": 0, f"{name}_joint_0": 1, f"{name}_joint_1": 1}
    robot.link("thumb_root")
    robot.joint("thumb_abduction", "palm", "thumb_root", (0.035, -0.012, 0.025), axis=(0, 0, -1), limits=(-0.2, 1.2))
    robot.chain("thumb_root", "thumb", (0, 0, 0), (0, 0.9, 0), (0.045, 0.032, 0.026), axis=(0, -1, 0),
                limits=(-0.2, 1.2),                 follow={2: (1, 0.8)}, effort=1.2, width=0.018)  # fmt: skip
    closing |= {"thumb_abduction": 0, "thumb_joint_0": 1, "thumb_joint_1": 1}
    return Wild(path=robot.write(), normal=np.array([0, -1.0, 0]), fingers=5, closing=closing, thumb="thumb_root")


def one_motor(folder: Path) -> Wild:
    """Prosthesis: every joint of five fingers follows one motor; facing +z, fingers along x."""
    robot = new_robot(folder, "one_motor", mesh_as="stl")
    robot.link("palm", robot.box((0.09, 0.085, 0.025), (-0.045, 0, 0), inside_out=True))
    closing = {"index_joint_0": 1}
    for name, y, lengths in (
        ("index", 0.033, (0.05, 0.035)), ("middle", 0.011, (0.055, 0.037)), ("ring", -0.011, (0.05, 0.036)),
        ("little", -0.033, (0.04, 0.03)),
    ):  # fmt: skip
        for k, length in enumerate(lengths):
            robot.link(f"{name}_{k}", robot.box((length - 0.002, 0.015, 0.015), (length / 2, 0, 0)))
            robot.joint(
                f"{name}_joint_{k}", "palm" if k == 0 else f"{name}_0", f"{name}_{k}",
                (0.002, y, 0) if k == 0 else (lengths[0], 0, 0), axis=(0, -1, 0), limits=(0, 1.4), effort=3,
                mimic=None if (name, k) == ("index", 0) else ("index_joint_0", 1.0, 0.0),
            )  # fmt: skip
    for k in range(2):
        robot.link(f"thumb_{k}", robot.box((0.016, 0.018, 0.04), (0, 0, 0.021)))
        robot.joint(
            f"thumb_joint_{k}", "palm" if k == 0 else "thumb_0", f"thumb_{k}",
            (-0.06, 0.015, 0.0125) if k == 0 else (0, 0, 0.042), (0, -0.5 if k == 0 else 0.0, 0), axis=(0, 1, 0),
            limits=(0, 1.0), effort=3, mimic=("index_joint_0", 0.6, 0.0),
        )  # fmt: skip
    return Wild(path=robot.write(), normal=np.array([0, 0, 1.0]), fingers=5, closing=closing, thumb="thumb_0",
                said=("turned 1 inside-out",))  # fmt: skip


def untidy_claw(folder: Path) -> Wild:
    """Three fingers; limits in degrees, swapped, missing and 0..0, an axis of length 2, names that differ in case."""
    robot = new_robot(folder, "untidy_claw", mesh_as="stl")
    robot.link("base", robot.cylinder(0.05, 0.04, (0, 0, -0.02)))
    limits = {"a": (-20.0, 80.0), "b": (1.4, -0.35), "c": None}
    for k, name in enumerate("abc"):
        angle = 2 * np.pi * k / 3
        x, y = 0.042 * np.cos(angle), 0.042 * np.sin(angle)
        axis = (0.0, -2.0, 0.0) if name == "b" else (0.0, -1.0, 0.0)
        robot.chain("base", name, (x, y, 0), (0, 0, angle), (0.055, 0.045), axis=axis, limits=limits[name])
        robot.link(f"{name}_nail", robot.box((0.01, 0.012, 0.006), (-0.004, 0, 0.003)))
        robot.joint(f"{name}_nail_joint", f"{name}_1", f"{name}_nail", (0, 0, 0.045), limits=(0.0, 0.0))
    plain, upper = folder / "meshes" / "pad.stl", folder / "meshes" / "PAD.stl"
    trimesh.creation.box((0.5, 0.5, 0.5)).export(upper)
    trimesh.creation.box((0.02, 0.02, 0.004)).export(plain)
    robot.parts.append(
        '<link name="pad"><collision><origin xyz="0 0 0.002"/><geometry><mesh filename="meshes/pad.stl"/></geometry>'
        "</collision></link>"
    )
    robot.joint("pad_joint", "base", "pad", kind="fixed")
    closing = {f"{n}_joint_{k}": 1 for n in "abc" for k in range(2)}
    return Wild(
        path=robot.write(), normal=np.array([0, 0, 1.0]), fingers=3, closing=closing,
        said=(
            "read as degrees", "reversed: swapped", "axis of length 2", "no lower and upper limit", "treated as fixed",
        ),
    )  # fmt: skip


def two_claws(folder: Path) -> Wild:
    """Two fingers of two continuous joints each, facing +z; collision shapes only on the outer links' visuals."""
    robot = new_robot(folder, "two_claws", shapes_as=("visual",))
    robot.link("base", robot.box((0.08, 0.04, 0.04), (0, 0, -0.02)))
    for name, side in (("left", 1.0), ("right", -1.0)):
        yaw = (0.0, 0.0, 0.0) if side > 0 else (0.0, 0.0, np.pi)
        for k, parent in enumerate(("base", f"{name}_0")):
            robot.link(f"{name}_{k}", robot.box((0.014, 0.024, 0.06), (0, 0, 0.032)))
            robot.joint(f"{name}_joint_{k}", parent, f"{name}_{k}", (0.035 * side, 0, 0) if k == 0 else (0, 0, 0.065),
                        yaw if k == 0 else (0, 0, 0), kind="continuous", axis=(0, -1, 0), limits=None)  # fmt: skip
    closing = {f"{n}_joint_{k}": 1 for n in ("left", "right") for k in range(2)}
    return Wild(path=robot.write(), normal=np.array([0, 0, 1.0]), fingers=2, closing=closing,
                said=("continuous joints", "no collision shape"))  # fmt: skip


TENDON_MJCF = """<mujoco model="tendon_hand"><compiler angle="radian" autolimits="true"/>
<default><geom type="capsule" size="0.009"/><joint axis="0 -1 0" range="-0.2 1.4"/></default>
<worldbody><body name="palm" quat="0.7071068 0 0.7071068 0">
 <geom type="box" size="0.045 0.045 0.015" pos="0 0 -0.015"/>{fingers}</body></worldbody>
<tendon>{tendons}</tendon><equality>{equalities}</equality><actuator>{actuators}</actuator></mujoco>"""


def tendon_hand(folder: Path) -> Wild:
    """MJCF: four fingers around a palm facing +x, outer joints tied by joint and tendon equalities, tendon drives."""
    fingers = tendons = equalities = actuators = ""
    for k, name in enumerate("abcd"):
        angle = 2 * np.pi * k / 4 + 0.4
        x, y = 0.04 * np.cos(angle), 0.04 * np.sin(angle)
        fingers += (
            f'<body name="{name}_0" pos="{x} {y} 0" euler="0 0 {angle}"><joint name="{name}0"/>'
            f'<geom fromto="0 0 0.01 0 0 0.05"/><body name="{name}_1" pos="0 0 0.06"><joint name="{name}1"/>'
            '<geom fromto="0 0 0 0 0 0.035"/></body></body>'
        )
        tendons += (
            f'<fixed name="{name}"><joint joint="{name}0" coef="0.01"/><joint joint="{name}1" coef="0.008"/></fixed>'
        )
        if name in "ab":
            equalities += f'<joint joint1="{name}1" joint2="{name}0" polycoef="0 0.8 0 0 0"/>'
        else:
            tendons += f'<fixed name="{name}_tie"><joint joint="{name}0" coef="0.8"/>'
            tendons += f'<joint joint="{name}1" coef="-1"/></fixed>'
            equalities += f'<tendon tendon1="{name}_tie" polycoef="0 0 0 0 0"/>'
        actuators += f'<position name="{name}" tendon="{name}" kp="1000" forcerange="-80 80"/>'
    path = folder / "tendon_hand.xml"
    path.write_text(
        TENDON_MJCF.format(fingers=fingers, tendons=tendons, equalities=equalities, actuators=actuators), "utf-8"
    )
    return Wild(
        path=path, normal=np.array([0.0, 0, 1.0]), fingers=4, closing={f"{n}0": 1 for n in "abcd"},
        efforts=dict.fromkeys(("a0", "b0", "c0", "d0"), 0.8),
    )  # fmt: skip


def jaw_on_arm(folder: Path) -> Wild:
    """A six-joint arm with a coupled jaw: the gripper is to be found, whatever is wrong with the arm's meshes."""
    robot = new_robot(folder, "jaw_on_arm")
    robot.parts.append(
        '<link name="base"><collision><geometry><mesh filename="package://gone/base.stl"/></geometry></collision></link>'
    )
    parent = "base"
    for k in range(6):
        robot.link(f"arm_{k}", robot.cylinder(0.04, 0.2, (0, 0, 0.1)))
        axis = (0.0, 0.0, 1.0) if k % 2 else (0.0, 1.0, 0.0)
        robot.joint(f"arm_joint_{k}", parent, f"arm_{k}", (0, 0, 0.2), axis=axis, limits=(-3, 3), effort=100)
        parent = f"arm_{k}"
    robot.link("tool")
    robot.joint("tool_joint", parent, "tool", (0, 0, 0.2), kind="fixed")
    robot.link("gripper_body", robot.box((0.06, 0.14, 0.08), (0, 0, 0.04)))
    robot.joint("gripper_mount", "tool", "gripper_body", (0, 0, 0.01), kind="fixed")
    for name, side in (("left", 1.0), ("right", -1.0)):
        robot.link(f"{name}_finger", robot.box((0.02, 0.012, 0.06), (0, 0.006 * side, 0.03)))
        robot.joint(f"{name}_finger_joint", "gripper_body", f"{name}_finger", (0, 0, 0.08), kind="prismatic",
                    axis=(0, side, 0), limits=(0, 0.04), effort=50,
                    mimic=None if side > 0 else ("left_finger_joint", 1.0, 0.0))  # fmt: skip
    return Wild(
        path=robot.write(), normal=np.array([0, 0, 1.0]), fingers=2, closing={"left_finger_joint": -1}, is_jaw=True,
        said=("gripper_body", "whole robot"), efforts={"left_finger_joint": 50.0},
    )  # fmt: skip


def wristed_jaw(folder: Path) -> Wild:
    """A wrist that rolls, then two sliders without coupling, OBJ meshes, collision only, facing -x."""
    robot = new_robot(folder, "wristed_jaw", mesh_as="obj")
    robot.link("stand", robot.cylinder(0.03, 0.05, (0.1, 0, 0), rpy=(0, QUARTER, 0)))
    robot.link("body", robot.box((0.06, 0.12, 0.05), (0.03, 0, 0)))
    robot.joint("roll", "stand", "body", axis=(1, 0, 0), limits=(-3.1, 3.1), effort=5)
    for name, side in (("left", 1.0), ("right", -1.0)):
        robot.link(f"{name}_pad", robot.box((0.06, 0.01, 0.02), (-0.03, 0.005 * side, 0)))
        robot.joint(f"{name}_slide", "body", f"{name}_pad", kind="prismatic", axis=(0, 1, 0),
                    limits=(0, 0.04) if side > 0 else (-0.04, 0), effort=25)  # fmt: skip
    return Wild(
        path=robot.write(), normal=np.array([-1.0, 0, 0]), fingers=2, closing={"roll": 0, "left_slide": -1},
        is_jaw=True, said=("were coupled",), efforts={"left_slide": 25.0},
    )  # fmt: skip


def vise(folder: Path) -> Wild:
    """One jaw that swings against one that is part of the base, as on small table-top arms; facing +z."""
    robot = new_robot(folder, "vise", mesh_as="stl", millimetres=True)
    robot.link("body", robot.box((0.05, 0.06, 0.05), (0, 0, -0.025)), robot.box((0.01, 0.03, 0.09), (0.025, 0, 0.045)))
    robot.link("jaw", robot.box((0.01, 0.03, 0.09), (0, 0, 0.045)))
    robot.joint("jaw_joint", "body", "jaw", (-0.015, 0, 0.0), axis=(0, 1, 0), limits=(-1.2, 0.2), effort=2)
    return Wild(path=robot.write(), normal=np.array([0, 0, 1.0]), fingers=1, closing={"jaw_joint": 1})


WILD_HANDS: dict[str, Callable[[Path], Wild]] = {
    f.__name__: f
    for f in (
        two_slides, rising_jaw, linkage_jaw, three_adaptive, four_dexterous, five_fingers, one_motor, untidy_claw,
        two_claws, tendon_hand, jaw_on_arm, wristed_jaw, vise,
    )
}  # fmt: skip
