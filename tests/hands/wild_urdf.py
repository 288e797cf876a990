"""A small writer of robot files with the oddities of files from the wild; shapes are made by code."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh

Vector = tuple[float, float, float]


def numbers(values: object) -> str:
    return " ".join(f"{v:.9g}" for v in np.ravel(values))


def turned(rpy: Vector, vector: Vector) -> np.ndarray:
    """`vector` in the parent of a frame with these roll, pitch and yaw."""
    return trimesh.transformations.euler_matrix(*rpy)[:3, :3] @ np.array(vector)


@dataclass(slots=True)
class Robot:
    """URDF text, link by link. `mesh_as` turns boxes into mesh files: "stl", "obj", "glb"."""

    folder: Path
    name: str
    mesh_as: str = ""
    millimetres: bool = False
    shapes_as: tuple[str, ...] = ("collision",)
    prefix: str = ""
    parts: list[str] = field(default_factory=list)

    def box(
        self, size: Vector, centre: Vector = (0, 0, 0), *, rpy: Vector = (0, 0, 0), inside_out: bool = False
    ) -> str:
        origin = f'<origin xyz="{numbers(centre)}" rpy="{numbers(rpy)}"/>'
        if not self.mesh_as:
            return f'{origin}<geometry><box size="{numbers(size)}"/></geometry>'
        mesh = trimesh.creation.box(np.array(size) * (1000 if self.millimetres else 1))
        if inside_out:
            mesh.invert()
        file = f"meshes/box_{len(list((self.folder / 'meshes').glob('*')))}.{self.mesh_as}"
        mesh.export(self.folder / file)
        scale = ' scale="0.001 0.001 0.001"' if self.millimetres else ""
        return f'{origin}<geometry><mesh filename="{self.prefix}{file}"{scale}/></geometry>'

    def cylinder(self, radius: float, length: float, centre: Vector = (0, 0, 0), rpy: Vector = (0, 0, 0)) -> str:
        origin = f'<origin xyz="{numbers(centre)}" rpy="{numbers(rpy)}"/>'
        return f'{origin}<geometry><cylinder radius="{radius}" length="{length}"/></geometry>'

    def link(self, name: str, *shapes: str) -> None:
        inner = "".join(f"<{kind}>{shape}</{kind}>" for shape in shapes for kind in self.shapes_as)
        self.parts.append(f'<link name="{name}">{inner}</link>')

    def joint(
        self, name: str, parent: str, child: str, xyz: Vector = (0, 0, 0), rpy: Vector = (0, 0, 0), *,
        kind: str = "revolute", axis: Vector = (0, 1, 0), limits: tuple[float, float] | None = (0.0, 1.5),
        effort: float = 1.0, mimic: tuple[str, float, float] | None = None,
    ) -> None:  # fmt: skip
        text = f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        text += f'<origin xyz="{numbers(xyz)}" rpy="{numbers(rpy)}"/>'
        if kind != "fixed":
            text += f'<axis xyz="{numbers(axis)}"/>'
            if limits is not None:
                text += f'<limit lower="{limits[0]}" upper="{limits[1]}" effort="{effort}" velocity="1"/>'
        if mimic is not None:
            text += f'<mimic joint="{mimic[0]}" multiplier="{mimic[1]}" offset="{mimic[2]}"/>'
        self.parts.append(text + "</joint>")

    def mount(self, child: str, rpy: Vector) -> None:
        """A base link without shape, and a flange, both fixed, that turn the hand in its base frame."""
        self.parts.append('<link name="mount"/>')
        self.link("flange", self.cylinder(0.03, 0.01, (0, 0, -0.005)))
        self.joint("mount_to_flange", "mount", "flange", kind="fixed")
        self.joint("flange_to_hand", "flange", child, rpy=rpy, kind="fixed")

    def chain(
        self, root: str, name: str, xyz: Vector, rpy: Vector, lengths: tuple[float, ...], *, axis: Vector = (0, 1, 0),
        limits: tuple[float, float] | None = (-0.1, 1.5), width: float = 0.016, effort: float = 1.0,
        follow: dict[int, tuple[int, float]] | None = None,
    ) -> None:  # fmt: skip
        """A finger of boxes along its own z that bends about `axis`; `follow`: joint k mimics (joint, multiplier)."""
        for k, length in enumerate(lengths):
            self.link(f"{name}_{k}", self.box((width, width, length - 0.002), (0, 0, length / 2)))
            origin = xyz if k == 0 else (0.0, 0.0, lengths[k - 1])
            leader = (follow or {}).get(k)
            self.joint(
                f"{name}_joint_{k}", root if k == 0 else f"{name}_{k - 1}", f"{name}_{k}", origin,
                rpy if k == 0 else (0, 0, 0), axis=axis, limits=limits, effort=effort,
                mimic=None if leader is None else (f"{name}_joint_{leader[0]}", leader[1], 0.0),
            )  # fmt: skip

    def write(self) -> Path:
        path = self.folder / f"{self.name}.urdf"
        path.write_text(f'<robot name="{self.name}">{"".join(self.parts)}</robot>', encoding="utf-8")
        return path


def new_robot(folder: Path, name: str, **options: object) -> Robot:
    (folder / "meshes").mkdir(parents=True, exist_ok=True)
    return Robot(folder, name, **options)  # type: ignore[arg-type]


QUARTER = math.pi / 2
