"""The benchmark of the joint net: its scenes, its errors, what is kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuralgrasps.errors import InputError
from neuralgrasps.evaluate import joint_bench
from neuralgrasps.evaluate.joint_bench import OBJECT_SET, SOLID_SET, STAND_IN_SET, JointBench, JointBenchConfig
from neuralgrasps.evaluate.joint_bench import bench_joints as run_bench
from neuralgrasps.evaluate.joint_figures import FIGURES, joint_figures, joint_tables
from neuralgrasps.evaluate.joint_scenes import JointErrors, joint_scene, measure_scene
from neuralgrasps.geometry.mesh import box_mesh, sphere_mesh
from neuralgrasps.human.nets.joint_reader import JointReader, box_of_joints
from neuralgrasps.human.scenes.grasp_bank import joined_banks, make_grasp_bank
from neuralgrasps.human.seen import HandBox, SeenJoints
from neuralgrasps.perception.frame import Frame
from tests.human.human_scenes import small_bank, small_kit

TINY = JointBenchConfig(scenes=3, solids=1, sizes=1, proposals=60)
BRICK = box_mesh([0.03, 0.04, 0.08])


class _Truth:
    """A reader that knows a scene, and is off by a shift of all joints and a stretch from the wrist."""

    def __init__(self, joints_C: np.ndarray, mask: np.ndarray, *, shift_m: float, stretch: float) -> None:
        self.points_C = joints_C[0] + stretch * (joints_C - joints_C[0]) + [shift_m, 0.0, 0.0]
        self.mask = mask

    def read(self, frame: Frame, box: HandBox) -> SeenJoints:
        return SeenJoints(points_C=self.points_C, weight=np.ones(21), mask=self.mask, side="right", source="truth")


def test_a_scene_shows_its_hand_in_its_box() -> None:
    off = []
    for index in range(8):
        scene = joint_scene(small_kit(), 0, "test", index)
        assert scene.frame is not None and 0.0 <= scene.visible <= 1.2
        true = box_of_joints(scene.frame, scene.joints_C, side=scene.box)
        longer = max(true.u_max - true.u_min, true.v_max - true.v_min)
        off.append(abs(scene.box.u_min + scene.box.u_max - true.u_min - true.u_max) / 2 / longer)
        wide = max(scene.box.u_max - scene.box.u_min, scene.box.v_max - scene.box.v_min)
        assert 0.75 < wide / longer < 1.3
    assert np.mean(off) > 0.02 and max(off) < 0.2
    again, other = (joint_scene(small_kit(), seed, "test", 3) for seed in (0, 1))
    same = joint_scene(small_kit(), 0, "test", 3)
    np.testing.assert_array_equal(again.joints_C, same.joints_C)
    assert again.frame is not None and same.frame is not None
    np.testing.assert_array_equal(again.frame.depth, same.frame.depth)
    assert not np.allclose(other.joints_C, same.joints_C)


def test_errors_are_those_of_the_reader() -> None:
    scene = next(s for s in (joint_scene(small_kit(), 0, "test", k) for k in range(9)) if s.visible > 0.6)
    far = float(np.linalg.norm(scene.joints_C[1:] - scene.joints_C[0], axis=1).mean())
    first = _Truth(scene.joints_C, scene.mask, shift_m=0.0, stretch=1.2)
    last = _Truth(scene.joints_C, scene.mask, shift_m=0.01, stretch=1.1)
    found = measure_scene(scene, first, last)  # type: ignore[arg-type]
    assert found.root == pytest.approx(0.1 * far) and found.first_root == pytest.approx(0.2 * far)
    assert found.procrustes == pytest.approx(0.0, abs=1e-9) and found.iou == 1.0 and found.visible == scene.visible
    assert found.found and 0.005 < found.absolute < 0.02 + 0.1 * far
    nothing = measure_scene(replace(scene, frame=None), first, last)  # type: ignore[arg-type]
    assert not nothing.found and nothing.visible == scene.visible


def test_figures_are_of_hands_in_view_and_of_unseen_solids() -> None:
    def errors(root: float, visible: float) -> JointErrors:
        return JointErrors(root=root, procrustes=root / 2, absolute=0.0, iou=0.9, first_root=2 * root,
                           first_procrustes=root, visible=visible, look_s=0.004, read_s=0.008)  # fmt: skip

    bench = JointBench(
        scenes={
            STAND_IN_SET: [errors(0.1, 0.9)], SOLID_SET: [errors(0.01, 0.5), errors(0.9, 0.3)],
            OBJECT_SET: [errors(0.03, 1.1), JointErrors(visible=0.9)],
        },
        solids=dict.fromkeys((STAND_IN_SET, SOLID_SET, OBJECT_SET), 1),
        grasps=dict.fromkeys((STAND_IN_SET, SOLID_SET, OBJECT_SET), 2),
    )  # fmt: skip
    figures = joint_figures(bench)
    assert set(FIGURES) <= set(figures)
    assert figures["scene_joints_n"] == 2 and figures["scene_joints_root_relative_mm"] == pytest.approx(20.0)
    assert figures["scene_joints_procrustes_mm"] == pytest.approx(10.0)
    assert figures["scene_joints_one_look_root_relative_mm"] == pytest.approx(40.0)
    assert figures["scene_joints_stand_ins_root_relative_mm"] == pytest.approx(100.0)
    assert figures["scene_joints_objects_n"] == 1 and figures["scene_joints_solids_n"] == 1
    assert figures["scene_joints_ms_per_look"] == pytest.approx(4.0)
    tables = joint_tables(bench)
    assert [row["set"] for row in tables["sets"]] == [STAND_IN_SET, SOLID_SET, OBJECT_SET]
    assert [(row["seen"], row["n"]) for row in tables["seen"]] == [("0.2-0.4", 1), ("0.4-0.6", 1), ("0.8-1.0", 2)]


def test_nothing_measured_is_no_figure() -> None:
    bench = JointBench(scenes={SOLID_SET: [JointErrors(visible=0.9)]}, solids={SOLID_SET: 1}, grasps={SOLID_SET: 1})
    assert joint_figures(bench) == {"scene_joints_n": 0.0, "scene_joints_solids_n": 0.0}


def test_all_sets_are_measured_whatever_the_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NEURALGRASPS_HOME", str(tmp_path))
    monkeypatch.setattr(joint_bench, "STAND_INS", {"gelatin_box": joint_bench.STAND_INS["gelatin_box"]})
    said: list[tuple[int, int, str]] = []
    objects = {"brick": BRICK}
    one = run_bench(objects, config=TINY, workers=1, progress=lambda *told: said.append(told))
    assert {name: len(errors) for name, errors in one.scenes.items()} == {STAND_IN_SET: 3, OBJECT_SET: 3, SOLID_SET: 3}
    assert one.solids[OBJECT_SET] == 1 and one.without == [] and said[-1] == (3, 3, "scenes")
    kept = sorted(file.name for file in (tmp_path / "cache" / "joint_bench").iterdir())
    assert len(kept) == 3
    monkeypatch.setattr(joint_bench, "make_grasp_bank", lambda *_, **__: pytest.fail("made again"))
    two = run_bench(objects, config=TINY, workers=2)
    for name, errors in one.scenes.items():
        for a, b in zip(errors, two.scenes[name], strict=True):
            assert (a.root, a.iou, a.visible) == pytest.approx((b.root, b.iou, b.visible), nan_ok=True)


def test_solids_that_no_hand_holds_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NEURALGRASPS_HOME", str(tmp_path))
    monkeypatch.setattr(joint_bench, "STAND_INS", {})
    few = replace(TINY, proposals=1)
    with pytest.raises(InputError, match="no hand could be closed on any of the objects"):
        run_bench({"globe": sphere_mesh(1.0)}, config=few, workers=1)
    with pytest.raises(InputError, match="scenes is 0"):
        JointBenchConfig(scenes=0)


def test_joined_banks_hold_what_each_holds() -> None:
    first, second = small_bank(), make_grasp_bank([BRICK], proposals=60)
    both = joined_banks([first, second])
    assert both.num_solids == 3 and len(both) == len(first) + len(second)
    np.testing.assert_array_equal(both.solid, [*first.solid, *(second.solid + 2)])
    points, faces = both.points_O[both.point_start[2] :], both.faces[both.face_start[2] :]
    np.testing.assert_array_equal(points, second.points_O)
    np.testing.assert_array_equal(faces, second.faces)
    assert both.point_start[-1] == len(both.points_O) and both.face_start[-1] == len(both.faces)


def test_the_shipped_net_reads_them() -> None:
    once, reader = JointReader.load(looks=1), JointReader.load()
    scenes = [joint_scene(small_kit(), 4, "test", k) for k in range(12)]
    clear = [measure_scene(scene, once, reader) for scene in scenes if scene.visible > 0.6]
    assert len(clear) > 4 and np.median([e.root for e in clear]) < 0.02
    assert all(e.read_s > 0.0 and e.look_s > 0.0 for e in clear)
