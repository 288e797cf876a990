"""MJCF files, compiled by MuJoCo, to a `RobotDescription`. Torch-free."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element

import mujoco
import numpy as np

from neuralgrasps.errors import RobotDescriptionError
from neuralgrasps.geometry.mesh import Mesh, sphere_mesh
from neuralgrasps.geometry.se3_numpy import make_transform_np, quaternion_matrix
from neuralgrasps.kinematics.assemble import JointSpec, Mimic, build_tree
from neuralgrasps.kinematics.description import GeometryKind, JointDrive, LinkGeometry, LinkInertial, RobotDescription
from neuralgrasps.kinematics.mjcf_couplings import joint_couplings
from neuralgrasps.kinematics.mjcf_effort import joint_efforts
from neuralgrasps.kinematics.safe_xml import read_xml
from neuralgrasps.kinematics.subtree import cut_limb
from neuralgrasps.kinematics.tree import FIXED, PRISMATIC, REVOLUTE

MAX_INCLUDES = 64
HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
FREE = int(mujoco.mjtJoint.mjJNT_FREE)
NUMBERS = ("body_pos", "body_quat", "body_ipos", "geom_pos", "geom_quat", "geom_size", "jnt_pos", "jnt_axis", "qpos0")


def load_mjcf(path: str | Path, *, link: str | None = None) -> RobotDescription:
    """Read an MJCF file through MuJoCo's compiler.

    Link 0 is the only body of the world, or the world itself when it has several. A link's frame is its body's
    frame moved to the position of the body's last joint (MuJoCo's `jnt_pos`, mostly zero). A body with several
    joints gets one virtual link per extra joint, named "body/joint". Linear equalities of joints and of fixed tendons
    become rows of `tree.coupling`; polynomial ones are replaced by the nearest line, with a sentence in `repairs`.

    Args:
        path: the file; includes and meshes are resolved as MuJoCo does.
        link: only this link and what hangs on it; the whole robot when None.
    Raises:
        RobotDescriptionError: not an MJCF, entities in it, MuJoCo cannot compile it, or ball joints.
    """
    path = Path(path)
    _check_safe(path)
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise RobotDescriptionError(f"MJCF '{path.name}' was refused by MuJoCo: {reason}") from None
    bad = [name for name in NUMBERS if not np.isfinite(getattr(model, name)).all()]
    if bad:
        raise RobotDescriptionError(f"MJCF '{path.name}' has numbers that are not finite ({', '.join(bad)}).")
    return _Reader(path=path, model=model, link=link).description()


def _check_safe(path: Path) -> None:
    """Parse the file and what it includes with entities refused, before MuJoCo sees them."""
    todo, seen, root_tag = [path], set[Path](), "mujoco"
    while todo:
        current = todo.pop()
        if current.resolve() in seen:
            continue
        seen.add(current.resolve())
        if len(seen) > MAX_INCLUDES:
            raise RobotDescriptionError(f"MJCF '{path.name}' includes more than {MAX_INCLUDES} files.")
        root = read_xml(current, root_tag=root_tag if current == path else None, kind="MJCF")
        _check_numbers(current, root)
        todo.extend(path.parent / name for e in root.iter("include") if (name := e.get("file")))


def _check_numbers(path: Path, root: Element) -> None:
    """Refuse NaN here: MuJoCo only warns about it, into a file in the working folder."""
    for element in root.iter():
        for key, text in element.attrib.items():
            if "nan" in text.lower().split():
                raise RobotDescriptionError(
                    f"MJCF '{path.name}': {key} of <{element.tag}> is '{text}'; expected finite numbers."
                )


@dataclass(slots=True, kw_only=True)
class _Reader:
    path: Path
    model: mujoco.MjModel
    link: str | None
    notes: list[str] = field(default_factory=list)
    drives: dict[str, JointDrive] = field(default_factory=dict)
    base: int = field(init=False)
    frames: dict[int, str] = field(init=False)  # body -> link that carries its shapes
    shift: dict[int, np.ndarray] = field(init=False)  # body -> link origin in the body frame

    @property
    def source(self) -> str:
        return f"MJCF '{self.path.name}'"

    def name(self, kind: int, index: int, fallback: str) -> str:
        return mujoco.mj_id2name(self.model, kind, index) or f"{fallback}_{index}"

    def body_name(self, body: int) -> str:
        return self.name(mujoco.mjtObj.mjOBJ_BODY, body, "body")

    def joint_name(self, joint: int) -> str:
        return self.name(mujoco.mjtObj.mjOBJ_JOINT, joint, "joint")

    def description(self) -> RobotDescription:
        model = self.model
        tops = [b for b in range(1, model.nbody) if model.body_parentid[b] == 0]
        if not tops:
            raise RobotDescriptionError(f"{self.source} has no bodies; expected a hand or arm.")
        self.base = tops[0] if len(tops) == 1 and not self._moving_joints(tops[0]) else 0
        if self.base and any(model.geom_bodyid == 0):
            self.notes.append("shapes fixed to the world were left out.")
        self.frames, self.shift = {}, {}
        bodies = [b for b in range(model.nbody) if b == self.base or (b and self.base != b)]
        links, joints = self._links_and_joints(bodies)
        if self.link is not None:
            links, joints = cut_limb(self.source, links, joints, self.link, self.notes)
            self.frames = {body: link for body, link in self.frames.items() if link in links}
        tree = build_tree(self.source, links, joints, self.notes)
        index = {name: i for i, name in enumerate(tree.link_names)}
        geometries = [g for k in range(model.ngeom) if (g := self._geometry(k, index)) is not None]
        inertials: list[LinkInertial | None] = [None] * tree.num_links
        for body, link in self.frames.items():
            if model.body_mass[body] > 0:
                com_L = model.body_ipos[body] - self.shift[body]
                inertials[index[link]] = LinkInertial(mass=float(model.body_mass[body]), com_L=com_L)
        return RobotDescription(
            name=bytes(model.names).split(b"\0", 1)[0].decode() or self.path.stem,
            tree=tree,
            geometries=tuple(sorted(geometries, key=lambda g: g.link)),
            inertials=tuple(inertials),
            repairs=tuple(dict.fromkeys(self.notes)),
            source=self.path,
            drives={name: self.drives[name] for name in tree.dof_names},
        )

    # -- tree ----------------------------------------------------------------

    def _moving_joints(self, body: int) -> list[int]:
        start, count = int(self.model.body_jntadr[body]), int(self.model.body_jntnum[body])
        return [j for j in range(start, start + count) if self.model.jnt_type[j] in (HINGE, SLIDE)]

    def _links_and_joints(self, bodies: list[int]) -> tuple[list[str], list[JointSpec]]:
        links, joints = [], []
        efforts = joint_efforts(self.model)
        mimics = joint_couplings(self.model, self.source, self.joint_name, self.notes)
        for body in bodies:
            self._check_joint_types(body)
            parent, link = int(self.model.body_parentid[body]), self.body_name(body)
            self.frames[body], self.shift[body] = link, np.zeros(3)
            if body == self.base:
                links.append(link)
                continue
            X = make_transform_np(quaternion_matrix(self.model.body_quat[body]), self.model.body_pos[body])
            X[:3, 3] -= self.shift[parent]
            above, moving = self.frames[parent], self._moving_joints(body)
            if not moving:
                joints.append(self._fixed(f"{link}_fixed", above, link, X))
            for k, j in enumerate(moving):
                child = link if j == moving[-1] else f"{link}/{self.joint_name(j)}"
                origin = self.model.jnt_pos[j] - self.shift[body]
                X_PJ = (X if k == 0 else np.eye(4)) @ make_transform_np(None, origin)
                joints.append(self._moving(j, above, child, X_PJ, efforts[j], mimics.get(j)))
                self.shift[body], above = self.model.jnt_pos[j].copy(), child
                links.append(child)
            if not moving:
                links.append(link)
        return links, joints

    def _check_joint_types(self, body: int) -> None:
        start, count = int(self.model.body_jntadr[body]), int(self.model.body_jntnum[body])
        for j in range(start, start + count):
            if self.model.jnt_type[j] == FREE:
                self.notes.append(f"the free joint of body '{self.body_name(body)}' was dropped: the body is fixed.")
            elif self.model.jnt_type[j] not in (HINGE, SLIDE):
                raise RobotDescriptionError(
                    f"{self.source}: joint '{self.joint_name(j)}' is a ball joint; replace it by three hinges."
                )

    def _fixed(self, name: str, parent: str, child: str, X_PJ: np.ndarray) -> JointSpec:
        return JointSpec(name=name, parent=parent, child=child, joint_type=FIXED, X_PJ=X_PJ, axis=np.zeros(3))

    def _moving(
        self, j: int, parent: str, child: str, X_PJ: np.ndarray, effort: float | None, coupled: Mimic | float | None
    ) -> JointSpec:
        model = self.model
        lower, upper = (float(v) for v in model.jnt_range[j])
        limited = bool(model.jnt_limited[j])
        mimic = coupled if isinstance(coupled, Mimic) else None
        endless = not limited and coupled is None and model.jnt_type[j] == HINGE
        self.drives[self.joint_name(j)] = JointDrive(effort=effort, continuous=bool(endless))
        if isinstance(coupled, float):
            lower, upper, limited = coupled, coupled, True
        return JointSpec(
            name=self.joint_name(j),
            parent=parent,
            child=child,
            joint_type=REVOLUTE if model.jnt_type[j] == HINGE else PRISMATIC,
            X_PJ=X_PJ,
            axis=model.jnt_axis[j] / np.linalg.norm(model.jnt_axis[j]),
            lower=lower if limited else None,
            upper=upper if limited else None,
            effort=effort,
            mimic=mimic,
            zero=float(model.qpos0[model.jnt_qposadr[j]]),
        )

    # -- shapes --------------------------------------------------------------

    def _geometry(self, k: int, index: dict[str, int]) -> LinkGeometry | None:
        model = self.model
        body, kind = int(model.geom_bodyid[k]), mujoco.mjtGeom(int(model.geom_type[k])).name
        kind = kind.removeprefix("mjGEOM_").lower()
        if body not in self.frames:
            return None
        shape = self._shape(kind, k)
        if shape is None:
            self.notes.append(f"a '{kind}' shape of body '{self.body_name(body)}' was left out.")
            return None
        geometry_kind, size, mesh = shape
        red, green, blue, alpha = (float(v) for v in self._rgba(k))
        rotation = quaternion_matrix(model.geom_quat[k])
        return LinkGeometry(
            link=index[self.frames[body]],
            kind=geometry_kind,
            size=size,
            X_LG=make_transform_np(rotation, model.geom_pos[k] - self.shift[body]),
            mesh=mesh,
            is_visual=not model.geom_contype[k] and not model.geom_conaffinity[k],
            colour=(red, green, blue, alpha),
        )

    def _rgba(self, k: int) -> np.ndarray:
        material = int(self.model.geom_matid[k])
        return self.model.mat_rgba[material] if material >= 0 else self.model.geom_rgba[k]

    def _shape(self, kind: str, k: int) -> tuple[GeometryKind, np.ndarray, Mesh | None] | None:
        model, size = self.model, np.array(self.model.geom_size[k], float)
        if kind == "box":
            return "box", size, None
        if kind == "sphere":
            return "sphere", size * (1.0, 0.0, 0.0), None
        if kind == "capsule":
            return "capsule", size * (1.0, 1.0, 0.0), None
        if kind == "cylinder":
            return "cylinder", size * (1.0, 1.0, 0.0), None
        if kind == "ellipsoid":
            ball = sphere_mesh(1.0)
            return "mesh", np.zeros(3), Mesh(ball.vertices * size, ball.faces)
        if kind not in ("mesh", "sdf") or model.geom_dataid[k] < 0:
            return None
        m = int(model.geom_dataid[k])
        start, faces = int(model.mesh_vertadr[m]), int(model.mesh_faceadr[m])
        vertices = np.array(model.mesh_vert[start : start + model.mesh_vertnum[m]], float)
        return "mesh", np.zeros(3), Mesh(vertices, model.mesh_face[faces : faces + model.mesh_facenum[m]])
