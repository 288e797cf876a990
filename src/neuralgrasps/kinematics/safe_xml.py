"""Reading XML files that may come from anywhere: no DTD, no entities, no external references."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element, ParseError

import defusedxml.ElementTree as SafeTree
from defusedxml.common import DefusedXmlException

from neuralgrasps.errors import RobotDescriptionError

MAX_BYTES = 64 * 1024 * 1024


def read_xml(path: Path, *, root_tag: str | None, kind: str) -> Element:
    """Root element of an XML file.

    Args:
        path: the file.
        root_tag: the tag the root element must have; None for any.
        kind: "URDF" or "MJCF", for messages.
    Raises:
        RobotDescriptionError: no such file, not XML, a DTD or entity declaration, or another root.
    """
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "does not exist"
        raise RobotDescriptionError(f"{kind} file '{path}' {what}; give the path of a {kind} file.")
    if path.stat().st_size > MAX_BYTES:
        raise RobotDescriptionError(f"{kind} file '{path}' is larger than {MAX_BYTES >> 20} MiB; robot files are not.")
    try:
        root: Element = SafeTree.fromstring(path.read_bytes(), forbid_dtd=True)
    except DefusedXmlException as error:
        raise RobotDescriptionError(
            f"{kind} file '{path}' declares a DTD or entities, which are refused for safety ({type(error).__name__}); "
            "remove the <!DOCTYPE ...> part."
        ) from None
    except (ParseError, ValueError, LookupError) as error:
        raise RobotDescriptionError(f"{kind} file '{path}' is not well-formed XML: {error}.") from None
    except OSError as error:
        raise RobotDescriptionError(f"{kind} file '{path}' cannot be read: {error.strerror}.") from None
    if root_tag is not None and root.tag != root_tag:
        raise RobotDescriptionError(_wrong_root(path, str(root.tag), root_tag, kind))
    return root


def _wrong_root(path: Path, got: str, expected: str, kind: str) -> str:
    hint = {
        "robot": "this looks like a URDF: read it with load_urdf.",
        "mujoco": "this looks like an MJCF: read it with load_mjcf.",
        "sdf": "this is an SDF file: convert it to URDF first.",
    }.get(got, f"a {kind} file starts with <{expected}>.")
    return f"{kind} file '{path}' has the root element <{got}>, expected <{expected}>; {hint}"
