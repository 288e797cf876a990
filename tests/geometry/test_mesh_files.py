"""Every kind of bad mesh file: repaired and said so, or refused with one clear message."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from neuralgrasps.errors import InputError, MeshError
from neuralgrasps.geometry.mesh import (
    Mesh,
    box_mesh,
    is_closed,
    is_manifold,
    load_mesh,
    mass_properties,
    merge_meshes,
    repair_mesh,
    signed_distance,
    sphere_mesh,
)
from neuralgrasps.geometry.se3_numpy import make_transform_np, rpy_matrix

HALF = np.array([0.03, 0.05, 0.02])
VOLUME = 8 * HALF.prod()
BOX = box_mesh(HALF)


def write(mesh: Mesh, path: Path) -> Path:
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(path)
    return path


def moved(mesh: Mesh, *offset: float) -> Mesh:
    return mesh.transformed(make_transform_np(None, offset))


@pytest.mark.parametrize("kind", ["obj", "ply", "stl", "off", "glb"])
def test_every_format_gives_the_same_solid(tmp_path: Path, kind: str) -> None:
    loaded = load_mesh(write(BOX, tmp_path / f"box.{kind}"))
    np.testing.assert_allclose(loaded.mesh.bounds, BOX.bounds, atol=1e-7)
    assert is_manifold(loaded.mesh) and loaded.closed and loaded.bodies == 1
    assert mass_properties(loaded.mesh).volume == pytest.approx(VOLUME, rel=1e-5)
    if kind in ("obj", "ply", "off"):
        assert loaded.repairs == ()


def test_units_are_guessed_and_said_or_given(tmp_path: Path) -> None:
    path = write(Mesh(BOX.vertices * 1000, BOX.faces), tmp_path / "mm.ply")
    guessed = load_mesh(path)
    np.testing.assert_allclose(guessed.mesh.extents, 2 * HALF, rtol=1e-6)
    assert "took the file's unit for mm, since its largest extent is 100" in guessed.repairs[0]
    given = load_mesh(path, unit="m")
    np.testing.assert_allclose(given.mesh.extents, 2000 * HALF, rtol=1e-6)
    assert given.repairs == ()
    np.testing.assert_allclose(load_mesh(path, unit="inch").mesh.extents, 2000 * HALF * 0.0254, rtol=1e-6)
    np.testing.assert_allclose(load_mesh(path, unit="cm").mesh.extents, 20 * HALF, rtol=1e-6)
    with pytest.raises(InputError, match="unit 'feet' is not known; expected one of auto, m, mm"):
        load_mesh(path, unit="feet")  # type: ignore[arg-type]


@pytest.mark.parametrize("gap", [0.0, 5e-7, 5e-6, 5e-5])
def test_open_seams_are_closed(gap: float) -> None:
    ball = sphere_mesh(0.05)
    rng = np.random.default_rng(0)
    vertices = ball.vertices[ball.faces].reshape(-1, 3)
    noisy = vertices + gap * rng.uniform(-0.5, 0.5, vertices.shape)
    loaded = repair_mesh(noisy, np.arange(len(noisy)).reshape(-1, 3))
    assert loaded.closed and is_manifold(loaded.mesh)
    assert len(loaded.mesh.vertices) == len(ball.vertices)
    assert any("merged" in r if gap == 0 else "open seams" in r for r in loaded.repairs)
    assert np.abs(signed_distance(loaded.mesh, ball.vertices)).max() <= 2 * gap + 1e-12


def test_a_hole_stays_and_is_said() -> None:
    loaded = repair_mesh(BOX.vertices, BOX.faces[:-1])
    assert not loaded.closed and not is_closed(loaded.mesh)
    assert any("still open at 3 edges" in r for r in loaded.repairs)
    assert signed_distance(loaded.mesh, [[0, 0, 0], [0.1, 0, 0]]) == pytest.approx([-0.02, 0.07])


def test_small_features_are_not_welded_away() -> None:
    thin = box_mesh([0.1, 0.1, 2e-5])  # 40 um thick, closed: welding would crush it
    loaded = repair_mesh(thin.vertices, thin.faces)
    assert loaded.repairs == () and len(loaded.mesh.vertices) == 8


def test_useless_faces_and_vertices_are_dropped() -> None:
    vertices = np.concatenate([BOX.vertices, [[np.nan, 0, 0], [9, 9, 9]]])
    extra = [[0, 0, 1], BOX.faces[0], np.roll(BOX.faces[1], 1), [0, 1, 8], [0, 1, 77], [-1, 2, 3]]
    loaded = repair_mesh(vertices, np.concatenate([BOX.faces, extra]))
    assert len(loaded.mesh.faces) == 12 and len(loaded.mesh.vertices) == 8 and loaded.closed
    text = "; ".join(loaded.repairs)
    for expected in ("1 vertices that are not finite", "3 faces with a missing", "1 faces without area", "2 repeated"):
        assert expected in text


def test_a_sliver_that_holds_the_surface_together_stays_and_does_no_harm() -> None:
    # A vertex on the diagonal of one side, on one triangle only: the sliver (a, b, middle) closes the gap.
    a, b, c = BOX.faces[0]
    middle = 0.5 * (BOX.vertices[a] + BOX.vertices[c])
    faces = np.concatenate([BOX.faces[1:], [[a, b, 8], [8, b, c], [a, 8, c]]])
    loaded = repair_mesh(np.concatenate([BOX.vertices, [middle]]), faces)
    assert loaded.closed and len(loaded.mesh.faces) == 14
    points = np.random.default_rng(1).uniform(-0.1, 0.1, (500, 3))
    np.testing.assert_allclose(signed_distance(loaded.mesh, points), signed_distance(BOX, points), atol=1e-15)


def test_inverted_and_mixed_winding_are_fixed() -> None:
    inverted = repair_mesh(BOX.vertices, BOX.faces[:, ::-1])
    assert mass_properties(inverted.mesh).volume == pytest.approx(VOLUME)
    assert "turned 1 inside-out bodies (12 faces)" in inverted.repairs
    ball = sphere_mesh(0.05)
    rng = np.random.default_rng(3)
    mixed = np.where(rng.random((len(ball.faces), 1)) < 0.3, ball.faces[:, ::-1], ball.faces)
    loaded = repair_mesh(ball.vertices, mixed)
    assert is_manifold(loaded.mesh)
    assert mass_properties(loaded.mesh).volume == pytest.approx(mass_properties(ball).volume)
    assert any("against their neighbours" in r for r in loaded.repairs)


def test_bodies_are_kept_and_each_is_turned_by_itself() -> None:
    far = moved(BOX, 0.2, 0, 0)
    two = merge_meshes([Mesh(BOX.vertices, BOX.faces[:, ::-1]), far])
    loaded = repair_mesh(two.vertices, two.faces)
    assert loaded.bodies == 2 and "kept 2 separate bodies as one object" in loaded.repairs
    assert mass_properties(loaded.mesh).volume == pytest.approx(2 * VOLUME)


@pytest.mark.parametrize("inside_out", [False, True])
def test_a_cavity_stays_a_cavity(inside_out: bool) -> None:
    inner = box_mesh(0.5 * HALF)
    shell = merge_meshes([BOX, Mesh(inner.vertices, inner.faces[:, ::-1])])
    faces = shell.faces[:, ::-1] if inside_out else shell.faces
    loaded = repair_mesh(shell.vertices, faces)
    assert mass_properties(loaded.mesh).volume == pytest.approx(VOLUME * 7 / 8)
    assert signed_distance(loaded.mesh, [[0, 0, 0], [0, 0, 0.015]]) == pytest.approx([0.01, -0.005])


def test_scenes_are_joined_with_their_node_transforms(tmp_path: Path) -> None:
    X = make_transform_np(rpy_matrix([0, 0, np.pi / 2]), [0.3, 0, 0])
    scene = trimesh.Scene()
    part = trimesh.Trimesh(BOX.vertices, BOX.faces, process=False)
    scene.add_geometry(part, node_name="here")
    scene.add_geometry(part, node_name="there", transform=X)
    scene.export(tmp_path / "two.glb")
    loaded = load_mesh(tmp_path / "two.glb")
    assert loaded.bodies == 2
    np.testing.assert_allclose(loaded.mesh.bounds, [[-0.03, -0.05, -0.02], [0.35, 0.05, 0.02]], atol=1e-6)


def _point_cloud(path: Path) -> None:
    trimesh.PointCloud(BOX.vertices).export(path)


def _truncated(path: Path) -> None:
    write(sphere_mesh(0.05), path)
    path.write_bytes(path.read_bytes()[:400])


BAD_FILES: list[tuple[str, Callable[[Path], object], str]] = [
    ("missing.ply", lambda p: None, "does not exist"),
    ("folder.ply", lambda p: p.mkdir(), "does not exist|is a folder"),
    ("empty.stl", lambda p: p.write_bytes(b""), "is empty"),
    ("text.txt", lambda p: p.write_text("hello"), r"kind '\.txt'; expected one of obj, ply"),
    ("noise.ply", lambda p: p.write_bytes(bytes(range(256)) * 4), "cannot be read as PLY"),
    ("noise.glb", lambda p: p.write_bytes(bytes(range(256)) * 4), "cannot be read as GLB"),
    ("noise.obj", lambda p: p.write_text("hello\nworld\n"), "cannot be read as OBJ|holds no vertices|0 vertices"),
    ("noise.stl", lambda p: p.write_bytes(b"\x00" * 300), "cannot be read|no vertices|without area|faces"),
    ("truncated.ply", _truncated, "cannot be read as PLY|no face"),
    ("truncated.glb", _truncated, "cannot be read as GLB"),
    ("points.ply", _point_cloud, "8 points but no faces .a point cloud"),
    ("points.obj", lambda p: p.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n"), "no faces|cannot be read"),
    ("flat.ply", lambda p: write(Mesh(BOX.vertices[:4], [[0, 1, 3], [0, 3, 2]]), p), "is flat"),  # type: ignore[arg-type]
    ("dot.ply", lambda p: write(Mesh(BOX.vertices * 0, BOX.faces), p), "only faces without area"),
    (
        "nan.ply",
        lambda p: trimesh.Trimesh(BOX.vertices * np.nan, BOX.faces, process=False).export(p),
        "finite vertices",
    ),
]


@pytest.mark.parametrize(("name", "make", "text"), BAD_FILES, ids=[n for n, _, _ in BAD_FILES])
def test_bad_files_give_one_clear_message(tmp_path: Path, name: str, make: Callable[[Path], object], text: str) -> None:
    make(tmp_path / name)
    with pytest.raises(MeshError, match=text) as caught:
        load_mesh(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_real_scans_load_nearly_as_they_are(assets: Path) -> None:
    files = sorted((assets / "ycb").glob("*.ply"))
    assert len(files) == 13
    for path in files:
        loaded = load_mesh(path)
        assert loaded.closed and loaded.bodies == 1 and 0.05 < loaded.mesh.extents.max() < 0.3, path
        assert all(r.endswith("faces without area") for r in loaded.repairs), path


def test_real_robot_meshes_load(assets: Path) -> None:
    kinds = {".stl", ".obj", ".dae", ".ply"}
    files = [
        p for folder in ("hands", "robots") for p in sorted((assets / folder).rglob("*")) if p.suffix.lower() in kinds
    ]
    assert files
    for path in files[:: max(1, len(files) // 12)]:
        assert 1e-3 < load_mesh(path).mesh.extents.max() < 3.0, path
