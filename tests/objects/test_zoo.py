from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from neuralgrasps.errors import InputError, MeshError, UnknownNameError
from neuralgrasps.geometry.mesh import Mesh, box_mesh, signed_distance
from neuralgrasps.geometry.sdf_grid import query_grid_numpy
from neuralgrasps.objects.build import object_from_mesh
from neuralgrasps.objects.builtin import STAND_INS
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.zoo import load_object, object_names, object_sources


def write_obj(path: Path, mesh: Mesh, scale: float = 1.0) -> Path:
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices * scale]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.faces]
    path.write_text("\n".join(lines))
    return path


def assert_consistent(obj: ObjectModel) -> None:
    """What every object must satisfy, measured against its mesh."""
    assert obj.points_O.shape == obj.normals_O.shape == (2048, 3)
    np.testing.assert_allclose(np.linalg.norm(obj.normals_O, axis=1), 1.0, atol=1e-9)
    assert np.abs(signed_distance(obj.mesh, obj.points_O)).max() < 1e-6
    step = 0.001
    outward = query_grid_numpy(obj.sdf, obj.points_O + step * obj.normals_O)
    inward = query_grid_numpy(obj.sdf, obj.points_O - step * obj.normals_O)
    assert (outward > inward).mean() > 0.99
    assert 1 <= len(obj.convex_parts) <= 24
    assert max(len(p) for p in obj.convex_parts) <= 64
    assert (obj.com_O > obj.mesh.bounds[0]).all() and (obj.com_O < obj.mesh.bounds[1]).all()
    assert obj.content_hash == obj.mesh.content_hash()


@pytest.mark.parametrize("name", STAND_INS)
def test_stand_ins_load(name: str):
    obj = load_object(name)
    assert obj.name == name
    assert_consistent(obj)
    assert obj.mass_kg == STAND_INS[name].mass_kg and obj.friction == 0.6
    assert float(obj.provenance["convex_protrusion_p95_mm"]) < 1.0
    assert float(obj.provenance["convex_gap_p95_mm"]) < 1.0
    assert "generated" in obj.provenance["source"]


@pytest.mark.parametrize(
    "name, size, continuous",
    [
        ("cracker_box", 4, False),
        ("pudding_box", 4, False),
        ("gelatin_box", 4, False),
        ("tomato_soup_can", 72, True),
        ("potted_meat_can", 4, False),
        ("mustard_bottle", 2, False),
        ("bleach_cleanser", 1, False),
    ],
)
def test_symmetry_of_the_stand_ins(name: str, size: int, continuous: bool):
    group = load_object(name).symmetry
    assert len(group) == size
    assert (group.continuous_axis is not None) == continuous
    if continuous:
        np.testing.assert_allclose(group.continuous_axis, [0, 0, 1])


def test_second_load_comes_from_the_cache_and_is_identical(fresh_home: Path):
    first = load_object("gelatin_box")
    files = list((fresh_home / "cache" / "objects").iterdir())
    assert len(files) == 1
    written = files[0].stat().st_mtime_ns
    second = load_object("gelatin_box")
    assert files[0].stat().st_mtime_ns == written
    np.testing.assert_array_equal(first.sdf.values, second.sdf.values)
    np.testing.assert_array_equal(first.points_O, second.points_O)
    np.testing.assert_array_equal(first.normals_O, second.normals_O)
    np.testing.assert_array_equal(first.symmetry.rotations, second.symmetry.rotations)
    assert first.sdf.spacing == second.sdf.spacing and len(first.convex_parts) == len(second.convex_parts)
    for a, b in zip(first.convex_parts, second.convex_parts, strict=True):
        np.testing.assert_array_equal(a, b)
    assert first.provenance == second.provenance


def test_a_damaged_cache_is_built_again(fresh_home: Path):
    first = load_object("gelatin_box")
    file = next((fresh_home / "cache" / "objects").iterdir())
    file.write_bytes(file.read_bytes()[:-1000])
    second = load_object("gelatin_box")
    np.testing.assert_array_equal(first.sdf.values, second.sdf.values)
    assert "cache" not in second.provenance


def test_an_unwritable_home_costs_only_the_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    monkeypatch.setenv("NEURALGRASPS_HOME", str(blocked))
    obj = load_object("gelatin_box")
    assert obj.provenance["cache"].startswith("not cached")
    assert object_names() == tuple(STAND_INS)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_home_costs_only_the_cache(fresh_home: Path):
    fresh_home.mkdir()
    fresh_home.chmod(0o555)
    assert load_object("gelatin_box").provenance["cache"].startswith("not cached")


def test_ycb_id_is_an_alias():
    assert load_object("009_gelatin_box").content_hash == load_object("gelatin_box").content_hash


@pytest.mark.parametrize("scale, unit", [(1.0, "auto"), (1000.0, "auto"), (100.0, "cm"), (1 / 0.0254, "inch")])
def test_files_of_any_unit_become_metres(tmp_path: Path, scale: float, unit: str):
    path = write_obj(tmp_path / "brick.obj", box_mesh((0.02, 0.03, 0.04)), scale)
    obj = load_object(path, unit=unit)  # type: ignore[arg-type]
    assert obj.name == "brick"
    np.testing.assert_allclose(obj.mesh.extents, (0.04, 0.06, 0.08), atol=1e-6)
    assert ("guessed" in obj.provenance["unit"]) == (unit == "auto")
    if scale == 1000.0:
        assert "mm" in obj.provenance["unit"]
    assert_consistent(obj)


def test_guessed_mass_follows_the_volume_and_is_said(tmp_path: Path):
    path = write_obj(tmp_path / "brick.obj", box_mesh((0.02, 0.03, 0.04)))
    obj = load_object(str(path))
    assert obj.mass_kg == pytest.approx(500 * 0.04 * 0.06 * 0.08)
    assert "guessed" in obj.provenance["mass"]
    assert load_object(path, mass_kg=0.3, friction=0.9).mass_kg == 0.3
    assert "mass" not in load_object(path, mass_kg=0.3).provenance


def test_unknown_names_get_a_hint():
    with pytest.raises(UnknownNameError, match="Did you mean 'cracker_box'"):
        load_object("craker_box")


def test_bad_files_are_plain_errors(tmp_path: Path):
    with pytest.raises(MeshError, match="does not exist"):
        load_object(tmp_path / "no.obj")
    (tmp_path / "empty.obj").write_text("")
    with pytest.raises(MeshError, match="empty"):
        load_object(tmp_path / "empty.obj")
    (tmp_path / "bad.stl").write_bytes(b"\x00\x01garbage")
    with pytest.raises(MeshError):
        load_object(tmp_path / "bad.stl")


def test_a_surface_without_volume_is_refused():
    flat = Mesh(np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    with pytest.raises(MeshError, match="expected a solid"):
        object_from_mesh("sheet", flat)


def test_a_folder_stands_for_its_meshes(tmp_path: Path):
    with pytest.raises(InputError, match="holds no mesh"):
        object_sources((str(tmp_path),))
    for name in ("b.stl", "a.ply", "notes.txt"):
        (tmp_path / name).write_text("x")
    found = object_sources(("cracker_box", str(tmp_path)))
    assert found == ("cracker_box", str(tmp_path / "a.ply"), str(tmp_path / "b.stl"))
    with pytest.raises(InputError, match="no object"):
        object_sources(())
    with pytest.raises(InputError, match="does not exist"):
        object_sources(("cracker_box", str(tmp_path / "c.ply")))


@pytest.mark.parametrize("key, value", [("mass_kg", 0.0), ("mass_kg", float("nan")), ("friction", -0.1)])
def test_impossible_physics_is_refused(key: str, value: float):
    with pytest.raises(InputError, match=key):
        load_object("gelatin_box", **{key: value})


def test_moving_the_mesh_moves_everything():
    mesh = box_mesh((0.02, 0.03, 0.04))
    X = np.eye(4)
    X[:3, 3] = (0.1, -0.2, 0.3)
    a, b = object_from_mesh("a", mesh), object_from_mesh("b", mesh.transformed(X))
    np.testing.assert_allclose(b.com_O, a.com_O + X[:3, 3], atol=1e-9)
    np.testing.assert_allclose(b.symmetry.centre, a.symmetry.centre + X[:3, 3], atol=1e-4)
    assert len(a.symmetry) == len(b.symmetry)
    assert a.content_hash != b.content_hash


@pytest.mark.parametrize(
    "name, symmetries, protrusion_mm",
    [("004_sugar_box", 4, 0.8), ("009_gelatin_box", 4, 1.0), ("036_wood_block", 8, 1)],
)
def test_scans_load(assets: Path, name: str, symmetries: int, protrusion_mm: float):
    obj = load_object(assets / "ycb" / f"{name}.ply")
    assert_consistent(obj)
    assert len(obj.symmetry) == symmetries
    assert float(obj.provenance["convex_protrusion_p95_mm"]) < protrusion_mm
    assert "published" in obj.provenance["mass"]
    if name == "009_gelatin_box":
        assert obj.provenance["repairs"]  # it has open seams
