"""Mesh files of a URDF: where they are found, their units, and what happens without them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from neuralgrasps.errors import RobotDescriptionError
from neuralgrasps.geometry.mesh import box_mesh, mass_properties
from neuralgrasps.kinematics.urdf import load_urdf


def save_box(path: Path, *, half: tuple[float, float, float] = (0.01, 0.02, 0.03), cut: int = 0) -> None:
    """An OBJ box, optionally without its last `cut` triangles."""
    mesh = box_mesh(half)
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.faces[: len(mesh.faces) - cut]]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines))


def urdf(reference: str, *, attributes: str = "", visual: str = "") -> str:
    collision = f'<collision><geometry><mesh filename="{reference}" {attributes}/></geometry></collision>'
    return f'<robot name="r"><link name="a">{collision}{visual}</link></robot>'


@pytest.mark.parametrize(
    ("reference", "stored", "remark"),
    [
        ("meshes/box.obj", "robot/urdf/meshes/box.obj", None),
        ("../meshes/box.obj", "robot/meshes/box.obj", None),
        ("package://robot/meshes/box.obj", "robot/meshes/box.obj", None),
        ("package://other/meshes/box.obj", "other/meshes/box.obj", None),
        ("package://gone/meshes/box.obj", "robot/meshes/box.obj", None),
        ("model://robot/meshes/box.obj", "robot/meshes/box.obj", None),
        ("package://robot/Meshes/BOX.obj", "robot/meshes/box.OBJ", "differs in case"),
        ("meshes\\box.obj", "robot/urdf/meshes/box.obj", None),
        ("/home/somebody/ws/robot/meshes/box.obj", "robot/meshes/box.obj", "was taken instead"),
        ("file:///home/somebody/my%20ws/robot/meshes/box.obj", "robot/meshes/box.obj", "was taken instead"),
    ],
)
def test_meshes_are_found_near_the_file(tmp_path, write, reference, stored, remark):
    save_box(tmp_path / stored)
    read = load_urdf(write("robot/urdf/r.urdf", urdf(reference)))
    np.testing.assert_allclose(read.geometries[0].mesh.extents, [0.02, 0.04, 0.06])
    assert len(read.repairs) == 1 + (remark is not None)  # one says that nothing moves
    assert remark is None or remark in read.repairs[0]


def test_a_full_file_path_is_taken(tmp_path, write):
    save_box(tmp_path / "far away" / "box.obj")
    uri = (tmp_path / "far away" / "box.obj").as_uri()
    assert load_urdf(write("near/r.urdf", urdf(uri))).geometries[0].mesh is not None


def test_an_exact_name_wins_over_one_that_differs_in_case(tmp_path, write):
    save_box(tmp_path / "Tip.obj", half=(0.01, 0.01, 0.01))
    save_box(tmp_path / "tip.obj", half=(0.02, 0.02, 0.02))
    read = load_urdf(write("r.urdf", urdf("tip.obj")))
    np.testing.assert_allclose(read.geometries[0].mesh.extents, 0.04)


@pytest.mark.parametrize(
    ("half", "attributes", "extent", "said"),
    [
        ((10, 20, 30), 'scale="0.001 0.001 0.001"', 0.06, None),
        ((10, 20, 30), "", 0.06, "read as millimetres"),
        ((10, 20, 30), 'scale="1 1 1"', 60.0, "suspicious"),
        ((1e-5, 2e-5, 3e-5), "", 6e-5, "suspicious"),
    ],
)
def test_units_of_meshes(tmp_path, write, half, attributes, extent, said):
    save_box(tmp_path / "box.obj", half=half)
    read = load_urdf(write("r.urdf", urdf("box.obj", attributes=attributes)))
    assert read.geometries[0].mesh.extents.max() == pytest.approx(extent)
    assert (len(read.repairs) == 1) if said is None else (said in read.repairs[0])


def test_a_mirrored_mesh_keeps_its_faces_outward(tmp_path, write):
    save_box(tmp_path / "box.obj")
    read = load_urdf(write("r.urdf", urdf("box.obj", attributes='scale="1 -1 1"')))
    assert mass_properties(read.geometries[0].mesh).volume == pytest.approx(0.02 * 0.04 * 0.06)
    assert "mirrored" in read.repairs[0]


def test_an_open_mesh_is_said(tmp_path, write):
    save_box(tmp_path / "box.obj", cut=1)
    assert "not closed" in load_urdf(write("r.urdf", urdf("box.obj"))).repairs[0]


def test_without_its_collision_mesh_a_link_needs_a_visual_one(tmp_path, write):
    save_box(tmp_path / "box.obj")
    visual = '<visual><geometry><mesh filename="box.obj"/></geometry></visual>'
    read = load_urdf(write("r.urdf", urdf("lost.stl", visual=visual)), with_visuals=False)
    assert [g.is_visual for g in read.geometries] == [True]
    assert "'lost.stl' was not found" in read.repairs[0] and "collision shape was left out" in read.repairs[0]
    with pytest.raises(RobotDescriptionError, match="put the mesh beside the URDF"):
        load_urdf(write("r.urdf", urdf("lost.stl")))
    skipped = load_urdf(write("r.urdf", urdf("lost.stl")), missing_meshes="skip")
    assert skipped.geometries == () and "'lost.stl' was not found" in skipped.repairs[0]


def test_a_broken_mesh_file_is_named(write):
    write("box.obj", "this is no mesh")
    with pytest.raises(RobotDescriptionError, match=r"link 'a'.*box\.obj"):
        load_urdf(write("r.urdf", urdf("box.obj")))


def test_a_missing_visual_mesh_is_only_said(write):
    text = '<robot><link name="a"><visual><geometry><mesh filename="x.dae"/></geometry></visual></link></robot>'
    read = load_urdf(write("r.urdf", text))
    assert read.geometries == () and "visual meshes are missing" in read.repairs[0]
