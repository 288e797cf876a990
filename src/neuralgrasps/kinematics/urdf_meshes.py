"""Finding and loading the mesh files that a URDF names: package://, file://, other machines' paths, odd units."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from urllib.parse import unquote

import numpy as np

from neuralgrasps.errors import MeshError
from neuralgrasps.geometry.mesh import LoadedMesh, Mesh, load_mesh

MAX_LEVELS = 6  # folders above the URDF that are searched
MAX_SIZE = 5.0  # m; no link of a hand or arm is longer, so a longer one is in millimetres
MIN_SIZE = 5e-4  # m


class MeshNotFoundError(MeshError):
    """A mesh file named by a URDF is nowhere near it."""


@dataclass(slots=True, kw_only=True)
class MeshFinder:
    """Loads meshes for one robot file; each file is read once, each remark is made once.

    Attributes:
        robot_file: the URDF; paths are resolved near it.
        notes: receives one sentence for each thing that was guessed or mended.
    """

    robot_file: Path
    notes: list[str]
    _loaded: dict[tuple[str, tuple[float, ...] | None], Mesh] = field(default_factory=dict)

    def load(self, reference: str, scale: tuple[float, float, float] | None, *, tell: bool) -> Mesh:
        """The mesh in metres, scale applied.

        Args:
            reference: the path as the URDF writes it.
            scale: the `scale` attribute; None when absent.
            tell: whether defects of the mesh are noted (collision shapes) or not (visual ones).
        Raises:
            MeshNotFoundError: no such file near the URDF.
            MeshError: the file cannot be read.
        """
        key = (reference, scale)
        if key not in self._loaded:
            path = self.find(reference)
            loaded = load_mesh(path, unit="m")
            if tell:
                self._tell(path.name, loaded)
            self._loaded[key] = self._in_metres(loaded.mesh, path.name, scale)
        return self._loaded[key]

    def _tell(self, name: str, loaded: LoadedMesh) -> None:
        if not loaded.closed:
            self.notes.append(f"mesh '{name}' is not closed: only its convex hull is reliable.")
        # a seam welded is how files are written; a body turned or a corner lost is a fault of this one
        self.notes.extend(f"mesh '{name}': {r}." for r in loaded.repairs if r.startswith(("turned", "dropped")))

    def _in_metres(self, mesh: Mesh, name: str, scale: tuple[float, float, float] | None) -> Mesh:
        factors = np.array(scale if scale is not None else (1.0, 1.0, 1.0))
        size = float(np.max(np.abs(mesh.extents * factors)))
        if size > MAX_SIZE and scale is None:
            self.notes.append(f"mesh '{name}' is {size:.4g} m long and has no scale: read as millimetres.")
            factors = factors * 1e-3
        elif not MIN_SIZE < size <= MAX_SIZE:
            self.notes.append(f"mesh '{name}' is {size:.3g} m long after scaling, which is suspicious; kept.")
        if np.all(factors == 1.0):
            return mesh
        faces = mesh.faces
        if np.prod(factors) < 0:
            self.notes.append(f"mesh '{name}' is mirrored by a negative scale; its faces were turned to point outward.")
            faces = np.ascontiguousarray(faces[:, ::-1])
        return Mesh(mesh.vertices * factors, faces)

    def find(self, reference: str) -> Path:
        """Path of the file that `reference` means; raises `MeshNotFoundError`."""
        plain, package = _split_reference(reference)
        for candidate in self._candidates(plain, package):
            if candidate.is_file():
                return candidate
        for candidate in self._candidates(plain, package):
            found = _ignoring_case(candidate)
            if found is not None:
                self.notes.append(f"mesh '{reference}' was found as '{found.name}', whose path differs in case.")
                return found
        for folder in self._folders():
            for k in range(len(plain.parts) - 1, 0, -1):
                candidate = folder.joinpath(*plain.parts[-k:])
                if candidate.is_file():
                    self.notes.append(f"mesh '{reference}' is not there; '{candidate}' was taken instead.")
                    return candidate
        raise MeshNotFoundError(
            f"mesh '{reference}' was not found in or above the folder '{self.robot_file.parent}'; "
            "put the mesh beside the URDF, in the sub-folder that the reference names."
        )

    def _folders(self) -> list[Path]:
        parent = self.robot_file.resolve().parent
        return [parent, *parent.parents][:MAX_LEVELS]

    def _candidates(self, plain: PurePosixPath, package: str) -> list[Path]:
        if plain.is_absolute():
            return [Path(plain)]
        if not package:
            return [self._folders()[0] / plain]
        named = [f / plain for f in self._folders() if f.name == package]
        inside = [f / package / plain for f in self._folders()]
        return [*named, *inside, *(f / plain for f in self._folders())]


def _split_reference(reference: str) -> tuple[PurePosixPath, str]:
    """(path, package name or "") of `package://p/x`, `model://p/x`, `file:///x` or a plain path."""
    text = reference.strip().replace("\\", "/")
    scheme, separator, rest = text.partition("://")
    if not separator:
        return PurePosixPath(text.removeprefix("file:")), ""
    if scheme.lower() == "file":
        return PurePosixPath(unquote(rest)), ""
    package, _, inside = rest.partition("/")
    return PurePosixPath(inside), package


def _ignoring_case(path: Path) -> Path | None:
    """An existing file whose path equals `path` but for case; the first in sorted order, or None."""
    found = Path(path.anchor)
    for part in path.parts[1:] if path.anchor else path.parts:
        step = found / part
        if not step.exists():
            try:
                near = sorted(p for p in found.iterdir() if p.name.lower() == part.lower())
            except OSError:
                return None
            if not near:
                return None
            step = near[0]
        found = step
    return found if found.is_file() else None
