"""Real meshes in the home folder: import of any file, download of the YCB object set."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from neuralgrasps.errors import DataFormatError, DownloadError, InputError, MeshError, unknown_name
from neuralgrasps.geometry.mesh import LengthUnit, load_mesh
from neuralgrasps.objects.build import check_size
from neuralgrasps.objects.builtin import STAND_INS, find_stand_in
from neuralgrasps.objects.cache import home_folder
from neuralgrasps.objects.download import Progress, check_sha256, fetch_file, record_sha256
from neuralgrasps.objects.store import check_object_name, store_mesh, stored_mesh_file
from neuralgrasps.objects.unpack import unpack_tar
from neuralgrasps.objects.ycb_facts import YCB_MASSES_KG

YCB_URL = "https://ycb-benchmarks.s3.amazonaws.com/data"
YCB_LICENCE = "CC BY 4.0, YCB object and model set (Calli et al. 2015)"
_MESH_FILES = ("google_16k/nontextured.ply", "google_16k/textured.obj")


def import_object(
    path: str | Path,
    name: str | None = None,
    unit: LengthUnit = "auto",
    *,
    licence: str = "unknown: the user's file",
    source: str | None = None,
    replace: bool = False,
) -> str:
    """Copy a mesh file, repaired and in metres, into the home folder, so that `load_object(name)` finds it.

    Args:
        path: the mesh file; its frame is kept.
        name: default the file's stem.
        unit: length unit of the file.
        licence, source: recorded as provenance.
        replace: whether an object of this name may be replaced.
    Returns:
        the name.
    Raises:
        MeshError: the file cannot be read or describes no surface.
        InputError: the name cannot be used or is taken.
        StorageError: the home folder cannot be written.
    """
    path = Path(path)
    name = check_object_name(path.stem if name is None else name)
    if name in STAND_INS:
        raise InputError(f"'{name}' is a built-in object; give the import another name.")
    if stored_mesh_file(name) is not None and not replace:
        raise InputError(
            f"an object '{name}' was imported before; give another name, or replace it "
            "(--replace on the command line, replace=True in Python)."
        )
    loaded = load_mesh(path, unit=unit)
    check_size(name, loaded.mesh)
    notes = {
        "source": source or f"imported from '{path.name}'",
        "licence": licence,
        "file_unit": _file_unit(unit, loaded.repairs),
    }
    if loaded.repairs:
        notes["repairs"] = "; ".join(loaded.repairs)
    store_mesh(name, loaded.mesh, notes)
    return name


def _file_unit(unit: LengthUnit, repairs: Sequence[str]) -> str:
    if unit != "auto":
        return unit
    return "mm (guessed from its size)" if any("unit" in line for line in repairs) else "m (guessed from its size)"


def download_ycb(
    names: Sequence[str] | None = None,
    *,
    url: str = YCB_URL,
    timeout_s: float = 30.0,
    progress: Progress | None = None,
) -> tuple[str, ...]:
    """Download scanned YCB meshes (the 16k-face scans) from the set's own host into the home folder.

    The host publishes no checksums: the first download of a file records its sha256, later ones must match it
    (`downloads/checksums.json` in the home folder); the provenance of each object says so. What is there already is
    kept; an interrupted download goes on where it stopped.

    Args:
        names: YCB ids ("003_cracker_box") or the stand-ins' short names; None for the seven stand-ins' originals.
        url: where the set's `google/` folder is.
        timeout_s: how long to wait for the server, each time.
        progress: called with file name, bytes so far, and bytes in all if known.
    Returns:
        the YCB ids, in the order asked for; `load_object` finds them.
    Raises:
        UnknownNameError: not a YCB id.
        DownloadError: no network, a wrong checksum, a damaged archive, or no room on disk.
    """
    wanted = [s.ycb_id for s in STAND_INS.values()] if names is None else [_ycb_id(n) for n in names]
    for ycb_id in wanted:
        if stored_mesh_file(ycb_id) is None:
            _download_one(ycb_id, url.rstrip("/"), timeout_s, progress)
    return tuple(wanted)


def _ycb_id(name: str) -> str:
    stand_in = find_stand_in(name)
    if stand_in is not None:
        return stand_in.ycb_id
    looks_like_one = name[:3].isdigit() and name[3:4] in ("_", "-")
    if name in YCB_MASSES_KG or looks_like_one:
        return check_object_name(name)
    raise unknown_name("YCB object", name, YCB_MASSES_KG)


def _download_one(ycb_id: str, url: str, timeout_s: float, progress: Progress | None) -> None:
    downloads = home_folder() / "downloads"
    archive = downloads / f"{ycb_id}_google_16k.tgz"
    address = f"{url}/google/{archive.name}"
    fetch_file(address, archive, timeout_s=timeout_s, progress=progress)
    manifest = downloads / "checksums.json"
    digest, known = check_sha256(archive, manifest, key=archive.name)
    trust = "as recorded" if known else "recorded on first use: the publisher gives none to compare with"
    try:
        with tempfile.TemporaryDirectory(dir=downloads, prefix=f".{ycb_id}.") as folder:
            mesh_file = _find_mesh(unpack_tar(archive, Path(folder)), archive)
            import_object(mesh_file, ycb_id, "m", licence=YCB_LICENCE, source=f"{address} (sha256 {digest}, {trust})")
        record_sha256(digest, manifest, key=archive.name)
    except (DataFormatError, MeshError) as error:
        raise DownloadError(f"{address} is not what was expected: {error}") from error
    finally:
        archive.unlink(missing_ok=True)


def _find_mesh(files: Sequence[Path], archive: Path) -> Path:
    for wanted in _MESH_FILES:
        for file in files:
            if file.as_posix().endswith("/" + wanted):
                return file
    raise DataFormatError(f"archive '{archive.name}' holds no mesh; expected a file {' or '.join(_MESH_FILES)}.")
