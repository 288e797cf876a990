"""Fixtures shared by all tests; and how a run of all tests starts."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from neuralgrasps.dataset.build import build_dataset
from neuralgrasps.dataset.read import GraspDataset, read_dataset
from neuralgrasps.dataset.schema import DatasetConfig
from neuralgrasps.geometry.mesh import Mesh, mass_properties
from neuralgrasps.geometry.primitives import box_mesh, convex_hull, sphere_mesh
from neuralgrasps.geometry.sdf_grid import build_sdf_grid
from neuralgrasps.grasps.grasp_set import GraspSet
from neuralgrasps.hands.hand import Hand
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.objects.build import surface_points
from neuralgrasps.objects.object_model import ObjectModel
from neuralgrasps.objects.symmetry import find_symmetry, trivial_symmetry

if TYPE_CHECKING:
    from neuralgrasps.apply.table_scenes import TableScene
    from neuralgrasps.arms.manipulator import Manipulator
    from neuralgrasps.model.train import TrainResult
    from neuralgrasps.planning.pick import PickPlan
    from neuralgrasps.planning.world import PlanningWorld

ASSETS = Path(__file__).resolve().parents[1].parent / "shared" / "assets"


def pytest_configure(config: pytest.Config) -> None:
    """Give the run a home folder of its own; before all tests on many processes, compile the kernels once."""
    if hasattr(config, "workerinput"):
        return  # a worker process uses its parent's folder
    home = tempfile.mkdtemp(prefix="neuralgrasps-tests-")
    config.add_cleanup(lambda: shutil.rmtree(home, ignore_errors=True))
    os.environ["NEURALGRASPS_HOME"] = home
    processes = config.getoption("numprocesses", default=None) or 0
    if processes > 1 and config.args_source is pytest.Config.ArgsSource.TESTPATHS and not config.option.collectonly:
        from neuralgrasps.demo.compile import load_and_compile  # noqa: PLC0415 - single tests need not load it

        # else every process would compile each of them, four times the work
        for _ in load_and_compile(["gelatin_box"], workers=min(4, processes)):
            pass


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest test first, so that no process ends with it while the others wait."""
    items.sort(key=lambda item: "tests/demo/" not in item.path.as_posix())


@pytest.fixture(scope="session")
def assets() -> Path:
    """The folder of real meshes, URDFs and scans; tests that need it are skipped without it."""
    if not ASSETS.is_dir():
        pytest.skip(f"real data not found at {ASSETS}")
    return ASSETS


def _make_object(name: str, mesh: Mesh, *, cells: int = 64, points: int = 1024, symmetry: bool = False) -> ObjectModel:
    """An object without the disk cache; its only convex part is its hull."""
    points_O, normals_O = surface_points(mesh, points)
    sdf = build_sdf_grid(mesh, cells=cells, padding=0.02)
    return ObjectModel(
        name=name,
        mesh=mesh,
        sdf=sdf,
        points_O=points_O,
        normals_O=normals_O,
        convex_parts=(convex_hull(mesh.vertices)[0],),
        mass_kg=0.1,
        com_O=np.asarray(mass_properties(mesh).centre),
        friction=0.6,
        symmetry=find_symmetry(points_O, sdf) if symmetry else trivial_symmetry(np.zeros(3), 0.001),
        content_hash=mesh.content_hash(),
        provenance={"source": "tests"},
    )


@pytest.fixture(scope="session")
def make_object() -> Callable[..., ObjectModel]:
    """`make_object(name, mesh, cells=64, points=1024, symmetry=False)`: an object made in a moment, nothing cached."""
    return _make_object


def _placed_grasps(hand: Hand, obj: ObjectModel, count: int, seed: int) -> GraspSet:
    """Open hands whose palm faces the object from a random side, 3 cm off: scenes to learn from, not valid grasps."""
    rng = np.random.default_rng(seed)
    X_OH, q = np.tile(np.eye(4), (count, 1, 1)), np.empty((count, hand.num_dofs))
    for i in range(count):
        k = int(rng.integers(len(obj.points_O)))
        z = -obj.normals_O[k]
        x = np.cross(z, rng.normal(size=3))
        x /= np.linalg.norm(x)
        X_OP = np.eye(4)
        X_OP[:3, :3], X_OP[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), obj.points_O[k] - 0.03 * z
        X_OH[i] = X_OP @ np.linalg.inv(hand.X_HP)
        q[i] = rng.uniform(hand.preshape_lower, hand.preshape_upper)
    left, _, right = np.linalg.svd(X_OH[:, :3, :3])
    X_OH[:, :3, :3] = left @ right  # the palm frames of the hands are rotations to 1e-6 only
    none = np.zeros((count, 0, 3))
    return GraspSet(
        hand=hand.name, object=obj.name, X_OH=X_OH, q=q, q_pregrasp=q, q_squeeze=q, contact_points_O=none,
        contact_normals_O=none, contact_links=np.zeros((count, 0), np.int32), epsilon=np.zeros(count),
        penetration_m=np.zeros(count), seed=seed,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class SmallWorld:
    """Two hands, two objects and 12 placed grasps of each pair: what a small dataset is built from."""

    hands: dict[str, Hand]
    objects: dict[str, ObjectModel]
    grasp_sets: tuple[GraspSet, ...]
    config: DatasetConfig


@pytest.fixture(scope="session")
def small_world() -> SmallWorld:
    hands = {name: load_hand(name) for name in ("allegro", "fetch")}
    meshes = {"brick": box_mesh([0.03, 0.05, 0.08]), "ball": sphere_mesh(0.04)}
    objects = {name: _make_object(name, mesh, cells=48, points=512) for name, mesh in meshes.items()}
    sets = tuple(
        _placed_grasps(h, o, 12, seed=7 * i + j)
        for i, h in enumerate(hands.values())
        for j, o in enumerate(objects.values())
    )
    return SmallWorld(
        hands=hands, objects=objects, grasp_sets=sets, config=DatasetConfig(queries_per_scene=600, seed=3)
    )


@pytest.fixture(scope="session")
def small_dataset(small_world: SmallWorld, tmp_path_factory: pytest.TempPathFactory) -> GraspDataset:
    """The small world as a built dataset; do not change its files."""
    folder = tmp_path_factory.mktemp("small") / "dataset"
    world = small_world
    build_dataset(folder, world.grasp_sets, hands=world.hands, objects=world.objects, config=world.config)
    return read_dataset(folder)


@pytest.fixture(scope="session")
def small_run(small_world: SmallWorld, small_dataset: GraspDataset) -> TrainResult:
    """A field fitted to the small dataset in few steps."""
    from neuralgrasps.model.train import TrainConfig, train  # noqa: PLC0415 - imports torch
    from neuralgrasps.model.train_data import Jitter  # noqa: PLC0415

    config = TrainConfig(steps=60, batch=16, jitter=Jitter(copies=1), noise_min=0.4, seed=1)
    return train(small_dataset, hands=small_world.hands, objects=small_world.objects, config=config)


@dataclass(frozen=True, slots=True, kw_only=True)
class PickScene:
    """The Fetch before a table with one upright box on it, stored grasps of the box, and the plan to pick it up.

    Attributes:
        q_start: (D,) the arm at home. world: what is there, the box as the target.
    """

    robot: Manipulator
    obj: ObjectModel
    grasps: GraspSet
    scene: TableScene
    world: PlanningWorld
    q_start: np.ndarray
    plan: PickPlan


@pytest.fixture(scope="session")
def pick_scene() -> PickScene:
    from neuralgrasps.apply.table_scenes import TableScene, scene_table, scene_world  # noqa: PLC0415 - OMPL, toppra
    from neuralgrasps.arms.mount import mount  # noqa: PLC0415
    from neuralgrasps.arms.zoo import load_arm  # noqa: PLC0415
    from neuralgrasps.grasps.grasp_io import load_grasps  # noqa: PLC0415
    from neuralgrasps.model.run_notes import run_folder  # noqa: PLC0415
    from neuralgrasps.objects.zoo import load_object  # noqa: PLC0415
    from neuralgrasps.planning.pick import plan_pick  # noqa: PLC0415
    from neuralgrasps.planning.world import PlacedObject  # noqa: PLC0415

    robot, obj = mount(load_arm("fetch"), load_hand("fetch")), load_object("gelatin_box")
    grasps = load_grasps(run_folder("standins7") / "grasps" / obj.name / f"{robot.hand.name}.safetensors")
    X_BO = np.eye(4)
    X_BO[:3, 3] = [0.75, 0.1, robot.arm.table_height_m - obj.mesh.bounds[0, 2]]
    scene = TableScene(table=scene_table(robot.arm), objects=(PlacedObject(obj=obj, X_BO=X_BO),), seed=0)
    world, q_start = scene_world(scene, 0), robot.q_home[robot.arm_dofs]
    result = plan_pick(robot, grasps, world, q_start, seed=3)
    assert result.plan is not None, result.reason
    return PickScene(
        robot=robot, obj=obj, grasps=grasps, scene=scene, world=world, q_start=q_start, plan=result.plan
    )  # fmt: skip
