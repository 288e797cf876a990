"""Which objects count as round and which as boxes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neuralgrasps.evaluate.synthesis_shapes import box_share, shape_kind
from neuralgrasps.geometry.mesh import Mesh, load_mesh
from neuralgrasps.geometry.primitives import box_mesh, cylinder_mesh, sphere_mesh
from neuralgrasps.objects.builtin import STAND_INS


def turned(mesh: Mesh, seed: int) -> Mesh:
    return Mesh(Rotation.random(random_state=seed).apply(np.array(mesh.vertices)), mesh.faces)


def open_frame() -> Mesh:
    """Three bars along the axes: most of its hull is empty."""
    bars = [box_mesh(0.004 + 0.05 * np.eye(3)[k]) for k in range(3)]
    corners = [bar.vertices + 0.05 * np.eye(3)[k] for k, bar in enumerate(bars)]
    faces = [bar.faces + sum(len(c) for c in corners[:k]) for k, bar in enumerate(bars)]
    return Mesh(np.concatenate(corners), np.concatenate(faces).astype(np.int32))


@pytest.mark.parametrize("seed", [0, 1])
def test_boxes_and_round_solids_by_shape_in_any_orientation(seed) -> None:
    box, can = turned(box_mesh([0.02, 0.05, 0.08]), seed), turned(cylinder_mesh(0.03, 0.05, segments=72), seed)
    assert box_share(box) == pytest.approx(1.0)
    # of a quarter of the side (45 degrees either way) 15 degrees either way lie on the face
    assert box_share(can) == pytest.approx(1 / 3, abs=0.03)
    assert shape_kind("thing", box) == "boxes"
    assert shape_kind("thing", can) == "round"
    assert shape_kind("thing", turned(cylinder_mesh(0.05, 0.005), seed)) == "round"  # flat ends make no box
    assert shape_kind("thing", sphere_mesh(0.03)) == "round"
    assert shape_kind("thing", open_frame()) == "other"


def test_the_name_decides_before_the_shape() -> None:
    box = box_mesh([0.02, 0.05, 0.08])
    expected = {
        "010_potted_meat_can": "round", "mustard_bottle": "round", "021_bleach_cleanser": "round", "soup-can": "round",
        "can_box": "boxes", "036_wood_block": "boxes", "Box": "boxes", "candle": "boxes", "watering_can": "round",
    }  # fmt: skip
    assert {name: shape_kind(name, box) for name in expected} == expected
    assert shape_kind("cracker_box", sphere_mesh(0.03)) == "boxes"


def test_shape_agrees_with_the_name_for_stand_ins_and_scans(assets: Path) -> None:
    meshes = {name: stand_in.build(stand_in.size_m) for name, stand_in in STAND_INS.items()}
    meshes |= {path.stem: load_mesh(path).mesh for path in sorted((assets / "ycb").glob("0*_*.ply"))}
    assert len(meshes) >= 20
    for name, mesh in meshes.items():
        assert shape_kind("thing", mesh) == shape_kind(name, mesh), name
