"""The Fetch model against the vendor's files: frames, limits, camera, shapes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neuralgrasps.arms.arm import Arm
from neuralgrasps.arms.mount import mount
from neuralgrasps.arms.zoo import load_arm
from neuralgrasps.geometry.camera import project
from neuralgrasps.geometry.mesh_files import load_mesh
from neuralgrasps.hands.parts import part_distances, sample_part
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.kinematics.forward_kernels import forward_numpy
from neuralgrasps.kinematics.safe_xml import read_xml

ARM_LINKS = (
    "shoulder_pan_link",
    "shoulder_lift_link",
    "upperarm_roll_link",
    "elbow_flex_link",
    "forearm_roll_link",
    "wrist_flex_link",
    "wrist_roll_link",
)


@pytest.fixture(scope="module")
def arm() -> Arm:
    return load_arm("fetch")


@pytest.fixture(scope="module")
def folder(assets) -> Path:
    return assets / "robots" / "fetch"


def _urdf_frames(path: Path, values: dict[str, float]) -> dict[str, np.ndarray]:
    """Link frames in base_link, from the file's numbers alone: origins, axes, and scipy's rotations."""
    joints = {}
    for element in read_xml(path, root_tag="robot", kind="URDF").findall("joint"):
        numbers = {k: [float(v) for v in text.split()] for k, text in element.find("origin").attrib.items()}
        X = np.eye(4)
        X[:3, :3], X[:3, 3] = Rotation.from_euler("xyz", numbers["rpy"]).as_matrix(), numbers["xyz"]
        value, axis = values.get(element.get("name"), 0.0), element.find("axis")
        if value:
            way = value * np.array([float(v) for v in axis.get("xyz").split()])
            motion = np.eye(4)
            if element.get("type") == "prismatic":
                motion[:3, 3] = way
            else:
                motion[:3, :3] = Rotation.from_rotvec(way).as_matrix()
            X = X @ motion
        joints[element.find("child").get("link")] = element.find("parent").get("link"), X

    def frame(link: str) -> np.ndarray:
        if link == "base_link":
            return np.eye(4)
        parent, X = joints[link]
        return frame(parent) @ X

    return {link: frame(link) for link in joints}


def _random_postures(arm: Arm, count: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(arm.tree.lower, arm.tree.upper, (count, arm.tree.num_dofs))


def test_link_frames_equal_the_vendors(arm, folder):
    robot = mount(arm, load_hand("fetch"))
    for q in _random_postures(arm, 20):
        expected = _urdf_frames(folder / "fetch.urdf", dict(zip(arm.tree.dof_names, q, strict=True)))
        X_BL = forward_numpy(arm.tree, q)
        for name, X in zip(arm.tree.link_names[1:], X_BL[1:], strict=True):
            assert pytest.approx(expected[name], abs=1e-6) == X, name
        full = robot.q_home.copy()
        full[: arm.tree.num_dofs] = q
        gripper = forward_numpy(robot.tree, full)[robot.hand_link]
        assert gripper == pytest.approx(expected["gripper_link"], abs=1e-6)
        camera = X_BL[arm.camera.link] @ arm.camera.X_LC
        assert camera == pytest.approx(expected["head_camera_rgb_optical_frame"], abs=1e-6)


def test_the_vendors_file_loads_as_an_arm(arm, folder):
    read = load_arm(folder / "fetch.urdf", missing_meshes="skip")
    names = read.tree.link_names
    assert names[read.flange] == "wrist_roll_link"
    assert not any("finger" in n or n == "gripper_link" for n in names)
    assert [read.tree.dof_names[j] for j in read.joints] == [arm.tree.dof_names[j] for j in arm.joints]
    assert [n for n, c in zip(read.tree.dof_names, read.continuous, strict=True) if c and "wheel" not in n] == [
        "upperarm_roll_joint",
        "forearm_roll_joint",
        "wrist_roll_joint",
    ]
    ours = [arm.tree.dof_names.index(n) if n in arm.tree.dof_names else -1 for n in read.tree.dof_names]
    for j, k in enumerate(ours):
        if k >= 0:
            for name in ("lower", "upper", "effort"):
                assert getattr(read.tree, name)[j] == pytest.approx(getattr(arm.tree, name)[k], abs=1e-6)
            assert read.velocity[j] == pytest.approx(arm.velocity[k])
    assert pytest.approx(arm.X_FM, abs=1e-4) == read.X_FM
    hand = load_hand("fetch")
    q = arm.q_home[arm.joints]
    assert mount(read, hand).hand_pose(q) == pytest.approx(mount(arm, hand).hand_pose(q), abs=1e-6)
    assert "0.5 s" in read.extra["assumed"] and "-2 pi..2 pi" in read.extra["repairs"]


def _vendor_vertices(folder: Path, link: str) -> np.ndarray:
    """(V, 3) of the vendor's collision meshes of a link, and of what is fixed to it, in the link."""
    pieces = {"base_link": ("base_link", "torso_fixed_link"), "torso_lift_link": ("torso_lift_link", "bellows_link")}
    shift = {"torso_fixed_link": (-0.086875, 0.0, 0.377425)}
    found = []
    for name in pieces.get(link, (link,)):
        file = folder / "meshes" / f"{name}_collision.STL"
        mesh = load_mesh(file if file.is_file() else folder / "meshes" / f"{name}.STL").mesh
        found.append(mesh.vertices + np.array(shift.get(name, (0.0, 0.0, 0.0))))
    return np.concatenate(found)


def test_parts_cover_the_vendors_shapes(arm, folder):
    for link, name in enumerate(arm.tree.link_names):
        points = _vendor_vertices(folder, name)
        gap = np.min([part_distances(p, points) for p in arm.parts if p.link == link], axis=0)
        assert gap.max() < 0.003, (name, gap.max())


def test_arm_links_are_not_much_fatter_than_the_vendors(arm, folder):
    for name in ARM_LINKS:
        link, vertices = arm.tree.link_names.index(name), _vendor_vertices(folder, name)
        directions = np.random.default_rng(0).normal(size=(200, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        ours = np.concatenate([sample_part(p, 1e5)[0] for p in arm.parts if p.link == link])
        excess = (ours @ directions.T).max(axis=0) - (vertices @ directions.T).max(axis=0)
        assert excess.max() < 0.019 and np.median(excess) < 0.008, (name, excess.max(), np.median(excess))


def test_the_camera_sees_the_table_at_home_and_not_the_arm(arm):
    for name in ("fetch", "allegro", "barrett"):
        robot = mount(arm, load_hand(name))
        X_BL, camera = forward_numpy(robot.tree, robot.q_home), arm.camera.intrinsics
        X_CB = np.linalg.inv(robot.camera_pose(robot.q_home[robot.arm_dofs]))
        u, v = project((X_CB @ [0.7, 0.0, 0.7, 1.0])[:3], camera)
        assert 0.25 * camera.width < u < 0.75 * camera.width and 0.25 * camera.height < v < 0.75 * camera.height
        pan = robot.tree.link_names.index("shoulder_pan_link")
        for part in robot.parts:
            if part.link >= pan:  # the arm comes after the head
                points = np.column_stack([sample_part(part, 3000.0)[0], np.ones(len(sample_part(part, 3000.0)[0]))])
                u, v = project((points @ (X_CB @ X_BL[part.link]).T)[:, :3], camera).T
                seen = (u > 0) & (u < camera.width) & (v > 0) & (v < camera.height)
                assert not seen.any(), (name, robot.tree.link_names[part.link])
