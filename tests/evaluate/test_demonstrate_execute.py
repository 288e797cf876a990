"""A demonstrated object before a robot, and the figures of demonstrations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuralgrasps.apply.demonstrate import Demonstration
from neuralgrasps.arms.zoo import load_arm
from neuralgrasps.errors import InputError
from neuralgrasps.evaluate.demonstrate_bench import DemonstrateBench, DemonstrateBenchConfig
from neuralgrasps.evaluate.demonstrate_execute import demonstrated_scene, execute_demonstration
from neuralgrasps.evaluate.demonstrate_figures import FIGURES, demonstrate_figures, demonstrate_tables, figure_names
from neuralgrasps.evaluate.demonstrate_trials import FrameErrors, VideoRecord
from neuralgrasps.evaluate.hand_surface import posed_surface, surface_rms
from neuralgrasps.geometry.camera import Intrinsics, look_at
from neuralgrasps.geometry.primitives import box_mesh
from neuralgrasps.geometry.se3_numpy import inverse_np, make_transform_np, rpy_matrix
from neuralgrasps.human.seen import FittedHand
from neuralgrasps.human.skeleton import human_hand, joint_points
from neuralgrasps.objects.resting import resting_poses
from neuralgrasps.objects.zoo import load_object
from neuralgrasps.perception.frame import Frame
from neuralgrasps.perception.object_video import follow_object
from neuralgrasps.planning.world import box_top
from neuralgrasps.sim.camera import render_depth_view

CAMERA = Intrinsics.from_fov(np.deg2rad(45.0), 320, 240)


def seen_object(name, *, rest, yaw, eye):
    """An object at rest on a table before a camera, found there; as far as a demonstration gets without a hand."""
    obj = load_object(name)
    X_WO = make_transform_np(rpy_matrix([0.0, 0.0, yaw])) @ resting_poses(obj.mesh.vertices, obj.com_O)[0][rest]
    X_WC = look_at(np.array(eye), np.array([0.0, 0.0, 0.05]))
    floor = np.eye(4)
    floor[2, 3] = -0.01
    view = render_depth_view(
        [obj.mesh, box_mesh([0.6, 0.6, 0.01])], np.stack([X_WO, floor]), X_WC=X_WC, intrinsics=CAMERA
    )
    followed = follow_object([Frame(view.depth, CAMERA)], obj)
    assert followed.reason == ""
    demonstration = Demonstration(
        object=obj.name, hand="fetch", seed=0, stage="", reason="", followed=followed, table_O=followed.table_O
    )
    return obj, X_WC, demonstration


@pytest.mark.parametrize(("name", "rest"), [("mustard_bottle", 0), ("mustard_bottle", 1), ("cracker_box", 0)])
def test_the_object_stands_before_the_robot_as_it_stood_before_the_camera(name, rest):
    obj, X_WC, demonstration = seen_object(name, rest=rest, yaw=0.7, eye=(0.5, 0.4, 0.5))
    arm = load_arm("fetch")
    scene = demonstrated_scene(demonstration, obj, arm, at=(0.7, -0.1))
    X_BO = scene.objects[0].X_BO
    points_B = obj.mesh.vertices @ X_BO[:3, :3].T + X_BO[:3, 3]
    assert points_B[:, 2].min() == pytest.approx(arm.table_height_m, abs=1e-9)
    assert ((points_B.min(axis=0) + points_B.max(axis=0)) / 2)[:2] == pytest.approx([0.7, -0.1], abs=1e-9)
    # the robot's x is the camera's view along the table: both see the same side
    X_WO_seen = X_WC @ demonstration.followed.pose.X_CO  # of a box perhaps its other end up
    X_BW = X_BO @ inverse_np(X_WO_seen)
    ahead = X_BW[:3, :3] @ X_WC[:3, 2]
    assert X_BW[2, 2] == pytest.approx(1.0, abs=2e-3)
    assert np.arctan2(ahead[1], ahead[0]) == pytest.approx(0.0, abs=0.03)
    assert box_top(scene.table).height(points_B).min() == pytest.approx(0.0, abs=1e-9)


def test_seen_from_straight_above_some_side_faces_the_robot():
    obj, _, demonstration = seen_object("cracker_box", rest=0, yaw=0.0, eye=(1e-4, 0.0, 0.7))
    X_BO = demonstrated_scene(demonstration, obj, load_arm("fetch")).objects[0].X_BO
    assert np.linalg.det(X_BO[:3, :3]) == pytest.approx(1.0)


def test_nothing_transferred_or_seen_is_an_error():
    empty = Demonstration(object="x", hand="fetch", seed=0, stage="hand", reason="no hand was found.")
    with pytest.raises(InputError, match="no hand was found"):
        execute_demonstration(empty, load_object("cracker_box"), None)
    with pytest.raises(InputError, match="no pose of 'cracker_box'"):
        demonstrated_scene(empty, load_object("cracker_box"), load_arm("fetch"))


def fitted(hand, X_CH, q):
    return FittedHand(
        X_CH=X_CH, q=q, scale=0.8, side="right", joints_C=0.8 * joint_points(hand, X_CH, q), cloud_rms_m=0.0,
        joint_rms_m=0.0, penetration_m=0.0, confidence=1.0,
    )  # fmt: skip


def test_a_hand_pushed_along_is_as_far_off_as_points_say():
    hand = human_hand()
    q = 0.3 * (hand.tree.lower + hand.tree.upper)
    X = make_transform_np(rpy_matrix([0.3, -0.2, 0.9]))
    X[:3, 3] = [0.02, -0.05, 0.6]
    points_C = posed_surface("right", 0.8, X, q)
    assert surface_rms(fitted(hand, X, q), points_C) < 2e-5
    off = X.copy()
    off[:3, 3] += [0.0, 0.0, 0.006]
    assert (
        0.002 < surface_rms(fitted(hand, off, q), points_C) < 0.006
    )  # surfaces along the shift do not leave themselves
    bent = q.copy()
    bent[5] += 0.5
    assert surface_rms(fitted(hand, X, bent), points_C) > 1e-3


def video(**more):
    frames = (
        FrameErrors(found=True, visible=0.9, net_root=0.010, net_procrustes=0.006, fit_root=0.004, fit_surface=0.002,
                    seconds=0.05),
        FrameErrors(found=True, visible=0.5, net_root=0.020, net_procrustes=0.010, fit_root=0.008, fit_surface=0.004,
                    seconds=0.05),
        FrameErrors(found=False, visible=0.7),
    )  # fmt: skip
    record = VideoRecord(
        object="box", index=0, side="left", scale=0.8, kind="power", length=30, stage="", reason="", side_right=True,
        moment_off=0, object_add_s=0.001, grasp_root=0.003, grasp_surface=0.001, map_difference=0.02,
        contact_similarity=0.9, similarity=0.9, oracle=0.8, lifted=True, lifted_retry=True, place=0,
        seconds={"object": 1.0, "hand": 2.0}, frames=frames,
    )  # fmt: skip
    return replace(record, **more)


def test_figures_are_means_of_what_was_seen():
    failed = VideoRecord(
        object="can", index=0, side="left", scale=0.8, kind="power", length=30, stage="detect", reason="no hand"
    )
    bench = DemonstrateBench(videos=[video(), failed], fit={"fit_rms_mm": 1.5})
    figures = demonstrate_figures(bench)
    assert figures["joints_root_relative_mm"] == pytest.approx(15.0)
    assert figures["joints_procrustes_mm"] == pytest.approx(8.0)
    assert figures["fitted_root_relative_mm"] == pytest.approx(6.0)
    assert figures["fitted_surface_mm"] == pytest.approx(3.0)
    assert figures["joints_found"] == pytest.approx(2 / 3)
    assert figures["fps"] == pytest.approx(20.0)
    assert figures["demonstrate_success"] == 0.5 and figures["grasps_found"] == 0.5 and figures["side_right"] == 0.5
    assert figures["moment_right"] == 0.5 and figures["object_pose_right"] == 0.5
    assert figures["demonstrate_similarity_minus_oracle"] == pytest.approx(0.1)
    assert figures["contact_map_difference"] == pytest.approx(0.02)
    assert figures["contact_similarity"] == pytest.approx(0.9)
    assert figures["video_fps"] == pytest.approx(10.0)
    assert figures["fit_rms_mm"] == 1.5


def test_what_is_lifted_counts_as_right_only_where_the_object_was_seen_right():
    """A robot finds the object anew: it also lifts what was seen wrong."""
    videos = [
        video(), video(object_add_s=0.0099), video(object_add_s=0.011), video(object_add_s=float("nan")),
        video(lifted=False, lifted_retry=True),
    ]  # fmt: skip
    assert [v.lifted_right for v in videos] == [True, True, False, False, False]
    bench = DemonstrateBench(videos=videos, hidden=[video(visible=0.5, object_add_s=0.02), video(visible=0.7)])
    figures = demonstrate_figures(bench)
    assert figures["demonstrate_success"] == 0.8 and figures["demonstrate_success_right"] == 0.4
    assert figures["hidden_demonstrate_success"] == 1.0 and figures["hidden_demonstrate_success_right"] == 0.5
    assert figures["hidden_demonstrate_success_right_40_60"] == 0.0
    assert figures["hidden_demonstrate_success_right_60_80"] == 1.0
    assert {name for name in figures if "right_" in name} < set(figure_names(hidden=True))
    tables = demonstrate_tables(bench)
    assert (tables["objects"][0]["lifted"], tables["objects"][0]["lifted_right"]) == (0.8, 0.4)
    assert [row["lifted_right"] for row in tables["hidden_visible"][:2]] == [0.0, 1.0]


def test_badly_seen_videos_have_figures_of_their_own_by_what_is_seen():
    bad = [video(visible=0.5, lifted=False), video(visible=0.7), video(visible=0.95)]
    figures = demonstrate_figures(DemonstrateBench(videos=[video()], hidden=bad, fit={"fit_rms_mm": 1.5}))
    assert figures["demonstrate_success"] == 1.0 and figures["hidden_demonstrate_success"] == pytest.approx(2 / 3)
    assert figures["hidden_demonstrate_success_40_60"] == 0.0 and figures["hidden_demonstrate_success_60_80"] == 1.0
    assert figures["hidden_joints_root_relative_mm"] == pytest.approx(15.0)
    assert figures["hidden_joints_root_relative_mm_40_60"] == pytest.approx(20.0)  # of the frames that show so much
    assert figures["hidden_fitted_surface_mm_40_60"] == pytest.approx(4.0)
    assert "hidden_fitted_surface_mm_60_80" not in figures and figures["hidden_joints_found_60_80"] == 0.0
    assert figures["hidden_fitted_root_relative_mm"] == pytest.approx(6.0) and "hidden_fit_rms_mm" not in figures
    names = figure_names(hidden=True)
    assert set(FIGURES) < set(names) and set(figures) - set(names) == {
        "joints_root_relative_median_mm", "fitted_surface_median_mm", "hidden_joints_root_relative_median_mm",
        "hidden_fitted_surface_median_mm",
    }  # fmt: skip
    assert not any(name.startswith("hidden") for name in figure_names(hidden=False))


def test_badly_seen_videos_have_tables_of_their_own():
    bench = DemonstrateBench(videos=[video()], hidden=[video(visible=0.5, lifted=False, grasp_root=0.007)])
    tables = demonstrate_tables(bench)
    assert tables["objects"][0]["lifted"] == 1.0 and tables["hidden_objects"][0]["lifted"] == 0.0
    rows = tables["hidden_visible"]
    assert [row["videos"] for row in rows] == [1, 0, 0] and rows[0]["lifted"] == 0.0
    assert rows[0]["grasp_root_mm"] == pytest.approx(7.0) and rows[0]["fit_root_mm"] == pytest.approx(8.0)
    assert "hidden_objects" not in demonstrate_tables(DemonstrateBench(videos=[video()]))


def test_tables_count_failures_and_part_frames_by_what_is_seen():
    bench = DemonstrateBench(videos=[video(), video(object="can", lifted=False, stage="execute", reason="it slipped.")])
    tables = demonstrate_tables(bench)
    assert [row["object"] for row in tables["objects"]] == ["box", "can", "all"]
    assert tables["objects"][-1]["lifted"] == 0.5 and tables["objects"][-1]["with_retry"] == 1.0
    assert [row["frames"] for row in tables["visible"]] == [2, 2, 2]
    assert tables["visible"][1]["found"] == 0.0 and np.isnan(tables["visible"][1]["net_root_mm"])
    assert {(row["stage"], row["count"]) for row in tables["stages"]} == {("none", 1), ("execute", 1)}


def test_amounts_are_checked():
    with pytest.raises(InputError, match="at least 1"):
        DemonstrateBenchConfig(videos=0)
    with pytest.raises(InputError, match="none badly seen"):
        DemonstrateBenchConfig(hidden=-1)
