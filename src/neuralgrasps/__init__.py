"""Grasping with any robot hand: synthesis proven in physics, one latent space for all hands, pose,
transfer, and a robot that picks the object up.

The names below are loaded when they are first used, so `import neuralgrasps` costs next to nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from neuralgrasps.errors import (
    DataFormatError,
    DownloadError,
    InputError,
    MeshError,
    NeuralGraspsError,
    RobotDescriptionError,
    ShapeError,
    StorageError,
    UnknownNameError,
)

if TYPE_CHECKING:
    from neuralgrasps.apply.constraints import GraspConstraints
    from neuralgrasps.apply.demonstrate import DemonstrateConfig, demonstrate
    from neuralgrasps.apply.novel import novel_grasps
    from neuralgrasps.apply.novel_trial import NovelConfig
    from neuralgrasps.apply.pick_up import PickUpConfig, carry_out, pick_up, propose_pick
    from neuralgrasps.apply.retrieve import retrieve
    from neuralgrasps.apply.robot import Robot, RobotState
    from neuralgrasps.apply.simulated_robot import SimulatedRobot
    from neuralgrasps.apply.table_scenes import draw_scene
    from neuralgrasps.apply.transfer import TransferConfig, transfer
    from neuralgrasps.apply.transfer_query import query_from_contacts, query_from_grasp, query_from_points
    from neuralgrasps.arms.arm import Arm
    from neuralgrasps.arms.manipulator import Manipulator
    from neuralgrasps.arms.mount import mount
    from neuralgrasps.arms.trajectory import Trajectory
    from neuralgrasps.arms.zoo import arm_names, load_arm
    from neuralgrasps.dataset.build import build_dataset
    from neuralgrasps.dataset.collect import collect_grasps
    from neuralgrasps.dataset.read import GraspDataset, read_dataset
    from neuralgrasps.dataset.schema import DatasetConfig
    from neuralgrasps.dataset.verify import verify_dataset
    from neuralgrasps.evaluate.demonstrate_execute import execute_demonstration
    from neuralgrasps.evaluate.execute import ExecuteConfig, execute_trial
    from neuralgrasps.evaluate.observe import observe_hand, view_hand
    from neuralgrasps.geometry.camera import Intrinsics
    from neuralgrasps.grasps.contact_map import contact_map
    from neuralgrasps.grasps.grasp_io import load_grasps, save_grasps
    from neuralgrasps.grasps.grasp_set import GraspSet
    from neuralgrasps.hands.hand import Hand
    from neuralgrasps.hands.variants import mirrored_hand, scaled_hand
    from neuralgrasps.hands.zoo import hand_names, load_hand
    from neuralgrasps.human.synthetic.demonstration import record_demonstration
    from neuralgrasps.human.video.watch import watch_hand
    from neuralgrasps.model.checkpoint import load_run, save_run
    from neuralgrasps.model.infer import InferConfig, encode_points, infer_grasps
    from neuralgrasps.model.infer_contacts import encode_contacts
    from neuralgrasps.model.kinematic_field import KinematicField
    from neuralgrasps.model.train import TrainConfig, train
    from neuralgrasps.objects.object_model import ObjectModel
    from neuralgrasps.objects.ycb import download_ycb, import_object
    from neuralgrasps.objects.zoo import load_object, object_names
    from neuralgrasps.perception.contact import ContactPoints
    from neuralgrasps.perception.find import find_objects
    from neuralgrasps.perception.frame import Frame
    from neuralgrasps.perception.frame_files import read_frame, read_frames
    from neuralgrasps.perception.identify import identify_object
    from neuralgrasps.perception.pose import PoseConfig, estimate_pose
    from neuralgrasps.perception.table import find_table
    from neuralgrasps.perception.track import track_pose
    from neuralgrasps.planning.collision import CollisionChecker
    from neuralgrasps.planning.ik import solve_ik
    from neuralgrasps.planning.path import plan_path
    from neuralgrasps.planning.pick import PickConfig, plan_pick
    from neuralgrasps.planning.table_grasps import grasps_on_table
    from neuralgrasps.planning.timing import time_path
    from neuralgrasps.planning.world import BoxObstacle, PlacedObject, PlanningWorld, table_box
    from neuralgrasps.report.page import write_report
    from neuralgrasps.sim.validate import validate_grasps
    from neuralgrasps.synthesis.synthesise import SynthesisConfig, synthesise

__version__ = "0.6.0"

_HOMES = {
    "Arm": "arms.arm",
    "BoxObstacle": "planning.world",
    "CollisionChecker": "planning.collision",
    "ContactPoints": "perception.contact",
    "DatasetConfig": "dataset.schema",
    "DemonstrateConfig": "apply.demonstrate",
    "ExecuteConfig": "evaluate.execute",
    "Frame": "perception.frame",
    "GraspConstraints": "apply.constraints",
    "GraspDataset": "dataset.read",
    "GraspSet": "grasps.grasp_set",
    "Hand": "hands.hand",
    "InferConfig": "model.infer",
    "Intrinsics": "geometry.camera",
    "KinematicField": "model.kinematic_field",
    "Manipulator": "arms.manipulator",
    "NovelConfig": "apply.novel_trial",
    "ObjectModel": "objects.object_model",
    "PickConfig": "planning.pick",
    "PickUpConfig": "apply.pick_up",
    "PlacedObject": "planning.world",
    "PlanningWorld": "planning.world",
    "PoseConfig": "perception.pose",
    "Robot": "apply.robot",
    "RobotState": "apply.robot",
    "SimulatedRobot": "apply.simulated_robot",
    "SynthesisConfig": "synthesis.synthesise",
    "TrainConfig": "model.train",
    "Trajectory": "arms.trajectory",
    "TransferConfig": "apply.transfer",
    "arm_names": "arms.zoo",
    "build_dataset": "dataset.build",
    "carry_out": "apply.pick_up",
    "collect_grasps": "dataset.collect",
    "contact_map": "grasps.contact_map",
    "demonstrate": "apply.demonstrate",
    "download_ycb": "objects.ycb",
    "draw_scene": "apply.table_scenes",
    "encode_contacts": "model.infer_contacts",
    "encode_points": "model.infer",
    "estimate_pose": "perception.pose",
    "execute_demonstration": "evaluate.demonstrate_execute",
    "execute_trial": "evaluate.execute",
    "find_objects": "perception.find",
    "find_table": "perception.table",
    "grasps_on_table": "planning.table_grasps",
    "hand_names": "hands.zoo",
    "identify_object": "perception.identify",
    "import_object": "objects.ycb",
    "infer_grasps": "model.infer",
    "load_arm": "arms.zoo",
    "load_grasps": "grasps.grasp_io",
    "load_hand": "hands.zoo",
    "load_object": "objects.zoo",
    "load_run": "model.checkpoint",
    "mirrored_hand": "hands.variants",
    "mount": "arms.mount",
    "novel_grasps": "apply.novel",
    "object_names": "objects.zoo",
    "observe_hand": "evaluate.observe",
    "pick_up": "apply.pick_up",
    "plan_path": "planning.path",
    "plan_pick": "planning.pick",
    "propose_pick": "apply.pick_up",
    "query_from_contacts": "apply.transfer_query",
    "query_from_grasp": "apply.transfer_query",
    "query_from_points": "apply.transfer_query",
    "read_dataset": "dataset.read",
    "read_frame": "perception.frame_files",
    "read_frames": "perception.frame_files",
    "record_demonstration": "human.synthetic.demonstration",
    "retrieve": "apply.retrieve",
    "save_grasps": "grasps.grasp_io",
    "save_run": "model.checkpoint",
    "scaled_hand": "hands.variants",
    "solve_ik": "planning.ik",
    "synthesise": "synthesis.synthesise",
    "table_box": "planning.world",
    "time_path": "planning.timing",
    "track_pose": "perception.track",
    "train": "model.train",
    "transfer": "apply.transfer",
    "validate_grasps": "sim.validate",
    "verify_dataset": "dataset.verify",
    "view_hand": "evaluate.observe",
    "watch_hand": "human.video.watch",
    "write_report": "report.page",
}

__all__ = [
    "Arm",
    "BoxObstacle",
    "CollisionChecker",
    "ContactPoints",
    "DataFormatError",
    "DatasetConfig",
    "DemonstrateConfig",
    "DownloadError",
    "ExecuteConfig",
    "Frame",
    "GraspConstraints",
    "GraspDataset",
    "GraspSet",
    "Hand",
    "InferConfig",
    "InputError",
    "Intrinsics",
    "KinematicField",
    "Manipulator",
    "MeshError",
    "NeuralGraspsError",
    "NovelConfig",
    "ObjectModel",
    "PickConfig",
    "PickUpConfig",
    "PlacedObject",
    "PlanningWorld",
    "PoseConfig",
    "Robot",
    "RobotDescriptionError",
    "RobotState",
    "ShapeError",
    "SimulatedRobot",
    "StorageError",
    "SynthesisConfig",
    "TrainConfig",
    "Trajectory",
    "TransferConfig",
    "UnknownNameError",
    "__version__",
    "arm_names",
    "build_dataset",
    "carry_out",
    "collect_grasps",
    "contact_map",
    "demonstrate",
    "download_ycb",
    "draw_scene",
    "encode_contacts",
    "encode_points",
    "estimate_pose",
    "execute_demonstration",
    "execute_trial",
    "find_objects",
    "find_table",
    "grasps_on_table",
    "hand_names",
    "identify_object",
    "import_object",
    "infer_grasps",
    "load_arm",
    "load_grasps",
    "load_hand",
    "load_object",
    "load_run",
    "mirrored_hand",
    "mount",
    "novel_grasps",
    "object_names",
    "observe_hand",
    "pick_up",
    "plan_path",
    "plan_pick",
    "propose_pick",
    "query_from_contacts",
    "query_from_grasp",
    "query_from_points",
    "read_dataset",
    "read_frame",
    "read_frames",
    "record_demonstration",
    "retrieve",
    "save_grasps",
    "save_run",
    "scaled_hand",
    "solve_ik",
    "synthesise",
    "table_box",
    "time_path",
    "track_pose",
    "train",
    "transfer",
    "validate_grasps",
    "verify_dataset",
    "view_hand",
    "watch_hand",
    "write_report",
]


def __getattr__(name: str) -> Any:
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module 'neuralgrasps' has no attribute '{name}'")
    value = getattr(importlib.import_module(f"neuralgrasps.{home}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
