"""URDF files, as found in the wild, to a `RobotDescription`. Torch-free."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal
from xml.etree.ElementTree import Element

import numpy as np

from neuralgrasps.errors import MeshError, RobotDescriptionError
from neuralgrasps.geometry.mesh import Mesh
from neuralgrasps.geometry.se3_numpy import make_transform_np, rpy_matrix
from neuralgrasps.kinematics.assemble import JointSpec, Mimic, build_tree
from neuralgrasps.kinematics.description import GeometryKind, JointDrive, LinkGeometry, LinkInertial, RobotDescription
from neuralgrasps.kinematics.safe_xml import read_xml
from neuralgrasps.kinematics.subtree import RobotOutline, cut_limb
from neuralgrasps.kinematics.tree import FIXED, PRISMATIC, REVOLUTE, KinematicTree
from neuralgrasps.kinematics.urdf_meshes import MeshFinder

JOINT_TYPES = {"fixed": FIXED, "revolute": REVOLUTE, "continuous": REVOLUTE, "prismatic": PRISMATIC}
UNSUPPORTED_TYPES = ("floating", "planar")
MAX_MASS = 1e3  # kg; heavier links are unit errors

Colour = tuple[float, float, float, float]


def load_urdf(
    path: str | Path,
    *,
    link: str | None = None,
    with_visuals: bool = True,
    missing_meshes: Literal["error", "skip"] = "error",
) -> RobotDescription:
    """Read a URDF file, mending what can be mended and saying so in `repairs`.

    Joints are ordered depth first, children in the order of the file; `tree.dof_names` is the order of `q`.
    Mimic joints become rows of `tree.coupling`. Fixed joints stay links. A link with no collision shape
    keeps its visual ones, so that the caller can use them.

    Args:
        path: the file. Meshes are searched near it (`package://`, `file://` and relative paths).
        link: only this link and what hangs on it; the whole robot when None.
        with_visuals: also read visual shapes of links that have collision shapes.
        missing_meshes: what to do about a collision mesh that is missing on a link with no visual shape:
            "error", or "skip" it with a sentence in `repairs` (for reading the kinematics alone).
    Raises:
        RobotDescriptionError: not a URDF, not one tree, numbers that are not, or a collision mesh that
            is missing with no visual shape to replace it. The message says where.
    """
    path = Path(path)
    root = read_xml(path, root_tag="robot", kind="URDF")
    reader = _Reader(path=path, root=root, with_visuals=with_visuals, skip_missing=missing_meshes == "skip")
    return reader.description(link)


def outline_urdf(path: str | Path) -> RobotOutline:
    """The tree of a URDF and which links have shapes; no mesh is read. Raises as `load_urdf` does."""
    path = Path(path)
    root = read_xml(path, root_tag="robot", kind="URDF")
    return _Reader(path=path, root=root, with_visuals=False, skip_missing=True).outline()


@dataclass(slots=True, kw_only=True)
class _Reader:
    path: Path
    root: Element
    with_visuals: bool
    skip_missing: bool
    notes: list[str] = field(default_factory=list)
    continuous: list[str] = field(default_factory=list)
    lost_visuals: list[str] = field(default_factory=list)
    drives: dict[str, JointDrive] = field(default_factory=dict)
    meshes: MeshFinder = field(init=False)
    colours: dict[str, Colour] = field(init=False)

    def __post_init__(self) -> None:
        self.meshes = MeshFinder(robot_file=self.path, notes=self.notes)
        self._refuse_xacro()
        self.colours = {}
        for material in self.root.findall("material"):
            colour = self._material_colour(material)
            if colour is not None:
                self.colours[material.get("name", "")] = colour

    @property
    def source(self) -> str:
        return f"URDF '{self.path.name}'"

    def fail(self, message: str) -> RobotDescriptionError:
        return RobotDescriptionError(f"{self.source}: {message}")

    def outline(self) -> RobotOutline:
        tree, elements = self._tree(None)
        shapes = [any(elements[n].find(kind) is not None for kind in ("collision", "visual")) for n in tree.link_names]
        return RobotOutline(tree=tree, has_shape=np.array(shapes, bool))

    def _tree(self, link: str | None) -> tuple[KinematicTree, dict[str, Element]]:
        """The tree, from `link` outwards or whole, and the elements of all links by name."""
        elements = {}
        for element in self.root.findall("link"):
            name = self._attribute(element, "name", "a link")
            if name in elements:
                raise self.fail(f"link name '{name}' is used more than once; rename one of them.")
            elements[name] = element
        joints = [self._joint(e) for e in self.root.findall("joint")]
        self._drop_loose_links(elements, joints)
        links = list(elements)
        if link is not None:
            links, joints = cut_limb(self.source, links, joints, link, self.notes)
            self.continuous = [n for n in self.continuous if any(j.name == n for j in joints)]
        return build_tree(self.source, links, joints, self.notes), elements

    def description(self, link: str | None) -> RobotDescription:
        tree, elements = self._tree(link)
        geometries = tuple(g for i, n in enumerate(tree.link_names) for g in self._geometries(i, elements[n]))
        inertials = tuple(self._inertial(n, elements[n]) for n in tree.link_names)
        self._note_groups(tree)
        return RobotDescription(
            name=self.root.get("name", "") or self.path.stem,
            tree=tree,
            geometries=geometries,
            inertials=inertials,
            repairs=tuple(dict.fromkeys(self.notes)),
            source=self.path,
            drives={name: self.drives[name] for name in tree.dof_names},
        )

    # -- links ---------------------------------------------------------------

    def _drop_loose_links(self, elements: dict[str, Element], joints: list[JointSpec]) -> None:
        """Drop links that no joint names and that have no shape, when there are others."""
        joined = {name for j in joints for name in (j.parent, j.child)}
        all_known = bool(joined) and joined <= elements.keys()
        loose = [n for n in elements if n not in joined] if all_known else []
        for name in loose:
            if elements[name].find("collision") is None and elements[name].find("visual") is None:
                self.notes.append(f"link '{name}' has neither joint nor shape: dropped.")
                del elements[name]

    def _note_groups(self, tree: KinematicTree) -> None:
        if self.continuous:
            self.notes.append(f"continuous joints were given the limits -pi..pi: {', '.join(self.continuous)}.")
        if self.lost_visuals:
            self.notes.append(f"visual meshes are missing or unreadable, left out: {', '.join(self.lost_visuals)}.")
        if not tree.num_dofs:
            self.notes.append("the robot has no movable joint.")

    def _geometries(self, link: int, element: Element) -> Iterator[LinkGeometry]:
        name = element.get("name", "")
        problems: list[str] = []
        collision = [g for e in element.findall("collision") for g in self._shape(link, name, e, False, problems)]
        if problems or not collision or self.with_visuals:
            lost: list[str] = []
            visual = [
                g for e in element.findall("visual") for g in self._shape(link, name, e, True, lost, tell=not collision)
            ]
            if lost:
                self.lost_visuals.append(name)
        else:
            visual = []
        if problems and not visual and not self.skip_missing:
            raise self.fail(
                f"link '{name}': {problems[0]} Put the mesh there, or read the robot without it: "
                "--missing-meshes skip, or missing_meshes='skip' in Python."
            )
        self.notes.extend(f"link '{name}': {p} The collision shape was left out." for p in problems)
        yield from collision
        yield from visual

    def _shape(
        self, link: int, name: str, element: Element, is_visual: bool, problems: list[str], *, tell: bool = True
    ) -> Iterator[LinkGeometry]:
        where = f"{element.tag} of link '{name}'"
        geometry = element.find("geometry")
        shape = None if geometry is None else next(iter(geometry), None)
        if shape is None:
            self.notes.append(f"{where} has no shape: left out.")
            return
        if shape.tag == "mesh":
            try:
                kind: GeometryKind = "mesh"
                size, mesh = np.zeros(3), self._mesh(shape, where, tell=tell)
            except MeshError as error:
                problems.append(str(error))
                return
        else:
            kind, size = self._primitive(shape, where)
            mesh = None
        yield LinkGeometry(
            link=link,
            kind=kind,
            size=size,
            X_LG=self._origin(element, where),
            mesh=mesh,
            is_visual=is_visual,
            colour=self._material_colour(element.find("material")),
        )

    def _mesh(self, shape: Element, where: str, *, tell: bool) -> Mesh:
        scale = None
        if shape.get("scale") is not None:
            x, y, z = self._numbers(shape, "scale", 3, f"mesh in {where}")
            scale = (x, y, z)
            if 0.0 in scale:
                raise self.fail(f"mesh in {where} has the scale '{shape.get('scale')}'; expected non-zero factors.")
        return self.meshes.load(self._attribute(shape, "filename", f"the mesh in {where}"), scale, tell=tell)

    def _primitive(self, shape: Element, where: str) -> tuple[GeometryKind, np.ndarray]:
        inside = f"{shape.tag} in {where}"
        if shape.tag == "box":
            size = np.array(self._numbers(shape, "size", 3, inside)) / 2
            kind: GeometryKind = "box"
        elif shape.tag == "sphere":
            size = np.array([*self._numbers(shape, "radius", 1, inside), 0.0, 0.0])
            kind = "sphere"
        elif shape.tag in ("cylinder", "capsule"):
            (radius,), (length,) = self._numbers(shape, "radius", 1, inside), self._numbers(shape, "length", 1, inside)
            size = np.array([radius, length / 2, 0.0])
            kind = "cylinder" if shape.tag == "cylinder" else "capsule"
        else:
            raise self.fail(f"{where} is a '{shape.tag}'; expected box, sphere, cylinder, capsule or mesh.")
        needed = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2}[kind]
        if not np.all(size[:needed] > 0):
            raise self.fail(f"{inside} has a size that is not positive; expected metres > 0.")
        return kind, size

    def _inertial(self, name: str, element: Element) -> LinkInertial | None:
        inertial = element.find("inertial")
        mass_element = None if inertial is None else inertial.find("mass")
        if inertial is None or mass_element is None:
            return None
        (mass,) = self._numbers(mass_element, "value", 1, f"mass of link '{name}'")
        if not 0.0 < mass < MAX_MASS:
            self.notes.append(f"link '{name}' has the mass {mass:g} kg: ignored.")
            return None
        return LinkInertial(mass=mass, com_L=self._origin(inertial, f"inertial of link '{name}'")[:3, 3])

    # -- joints --------------------------------------------------------------

    def _joint(self, element: Element) -> JointSpec:
        name = self._attribute(element, "name", "a joint")
        where = f"joint '{name}'"
        joint_type = self._joint_type(element, where)
        lower, upper, effort, velocity = self._limits(element, where)
        endless = element.get("type") == "continuous"
        self.drives[name] = JointDrive(lower=lower, upper=upper, velocity=velocity, effort=effort, continuous=endless)
        if endless:
            lower, upper = -math.pi, math.pi
            self.continuous.append(name)
        return JointSpec(
            name=name,
            parent=self._reference(element, "parent", where),
            child=self._reference(element, "child", where),
            joint_type=joint_type,
            X_PJ=self._origin(element, where),
            axis=self._axis(element, where) if joint_type != FIXED else np.zeros(3),
            lower=lower,
            upper=upper,
            effort=effort,
            mimic=self._mimic(element, where) if joint_type != FIXED else None,
        )

    def _joint_type(self, element: Element, where: str) -> int:
        given = self._attribute(element, "type", where)
        if given in UNSUPPORTED_TYPES:
            self.notes.append(f"{where} is {given}: treated as fixed at its origin.")
            return FIXED
        if given not in JOINT_TYPES:
            known = ", ".join([*JOINT_TYPES, *UNSUPPORTED_TYPES])
            raise self.fail(f"{where} has the type '{given}'; expected one of {known}.")
        return JOINT_TYPES[given]

    def _reference(self, element: Element, tag: str, where: str) -> str:
        found = element.find(tag)
        if found is None:
            raise self.fail(f'{where} has no <{tag}>; add <{tag} link="..."/>.')
        return self._attribute(found, "link", f"<{tag}> of {where}")

    def _axis(self, element: Element, where: str) -> np.ndarray:
        found = element.find("axis")
        if found is None or found.get("xyz") is None:
            self.notes.append(f"{where} has no axis: x assumed, as the format says.")
            return np.array([1.0, 0.0, 0.0])
        axis = np.array(self._numbers(found, "xyz", 3, f"axis of {where}"))
        length = float(np.linalg.norm(axis))
        if length < 1e-9:
            raise self.fail(f"{where} has the axis 0 0 0; expected a direction.")
        if abs(length - 1.0) > 1e-2:
            self.notes.append(
                f"{where} has an axis of length {length:.4g}: normalised. The length may hide a coupling or gear "
                "ratio; if so, state it as a mimic joint."
            )
        return axis / length

    def _limits(self, element: Element, where: str) -> tuple[float | None, ...]:
        """Lower, upper, effort and velocity."""
        limit = element.find("limit")
        if limit is None:
            return None, None, None, None
        lower, upper, effort, velocity = (
            self._limit(limit, key, where) for key in ("lower", "upper", "effort", "velocity")
        )
        if (lower is None) != (upper is None):  # the format's default for the absent one is 0
            self.notes.append(f"{where} gives only one of its two limits: the other is 0, as the format says.")
            lower, upper = lower or 0.0, upper or 0.0
        return lower, upper, effort, velocity

    def _limit(self, element: Element, key: str, where: str) -> float | None:
        if element.get(key) is None:
            return None
        return self._numbers(element, key, 1, f"limit of {where}", may_be_infinite=True)[0]

    def _mimic(self, element: Element, where: str) -> Mimic | None:
        found = element.find("mimic")
        if found is None:
            return None
        multiplier, offset = 1.0, 0.0
        if found.get("multiplier") is not None:
            (multiplier,) = self._numbers(found, "multiplier", 1, f"mimic of {where}")
        if found.get("offset") is not None:
            (offset,) = self._numbers(found, "offset", 1, f"mimic of {where}")
        return Mimic(joint=self._attribute(found, "joint", f"<mimic> of {where}"), multiplier=multiplier, offset=offset)

    # -- values --------------------------------------------------------------

    def _refuse_xacro(self) -> None:
        for element in self.root.iter():
            if "xacro" in str(element.tag) or any("${" in v or "$(" in v for v in element.attrib.values()):
                raise self.fail("contains xacro macros; expand it first: `xacro FILE.xacro > FILE.urdf`.")

    def _attribute(self, element: Element, key: str, what: str) -> str:
        value = (element.get(key) or "").strip()
        if not value:
            raise self.fail(f"{what} has no '{key}'.")
        return value

    def _numbers(
        self, element: Element, key: str, count: int, where: str, *, may_be_infinite: bool = False
    ) -> list[float]:
        text = self._attribute(element, key, where)
        try:
            values = [float(v) for v in text.split()]
        except ValueError:
            values = []
        bad = [v for v in values if math.isnan(v) or (math.isinf(v) and not may_be_infinite)]
        if len(values) != count or bad:
            expected = "one finite number" if count == 1 else f"{count} finite numbers separated by spaces"
            raise self.fail(f"{where}: {key} is '{text}'; expected {expected}.")
        return values

    def _origin(self, element: Element, where: str) -> np.ndarray:
        origin = element.find("origin")
        if origin is None:
            return np.eye(4)
        xyz = self._numbers(origin, "xyz", 3, f"origin of {where}") if origin.get("xyz") is not None else [0.0] * 3
        rpy = self._numbers(origin, "rpy", 3, f"origin of {where}") if origin.get("rpy") is not None else [0.0] * 3
        return make_transform_np(rpy_matrix(rpy), xyz)

    def _material_colour(self, material: Element | None) -> Colour | None:
        if material is None:
            return None
        colour = material.find("color")
        if colour is None or colour.get("rgba") is None:
            return self.colours.get(material.get("name", ""))
        red, green, blue, alpha = self._numbers(colour, "rgba", 4, "colour")
        return red, green, blue, alpha
