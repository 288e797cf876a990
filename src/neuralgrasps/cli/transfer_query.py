"""What `neuralgrasps transfer` is asked for, on which object, and what is known of the target hand."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from neuralgrasps.cli.terminal import counted
from neuralgrasps.errors import InputError, unknown_name

if TYPE_CHECKING:
    from neuralgrasps.apply.constraints import GraspConstraints
    from neuralgrasps.apply.transfer import TransferConfig
    from neuralgrasps.apply.transfer_query import TransferQuery
    from neuralgrasps.grasps.grasp_set import GraspSet
    from neuralgrasps.hands.hand import Hand
    from neuralgrasps.model.checkpoint import Run
    from neuralgrasps.objects.object_model import ObjectModel

NO_RUN = "-"
OFF_SURFACE_M = 0.005  # a drawn contact farther off the surface is put on it, and said
_LISTED = 8  # such points that are named


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Asked:
    """A query, its object, the words for it, and what is drawn of it: a posed hand, or points.

    Attributes:
        grasp: hand, X_OH (4, 4), q (J,); points_O: (M, 3); one of the two. note: a warning, or "".
    """

    query: TransferQuery
    obj: ObjectModel
    title: str
    grasp: tuple[Hand, np.ndarray, np.ndarray] | None = None
    points_O: np.ndarray | None = None
    note: str = ""

    @property
    def contacts_O(self) -> np.ndarray | None:
        """(M, 3) the points that are to be touched, where these are the query."""
        return self.points_O if self.query.source == "contacts" else None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TransferTask:
    """What is carried over, to which hand, and under which constraints."""

    asked: Asked
    hand: Hand
    config: TransferConfig
    constraints: GraspConstraints
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Known:
    """Hands, objects and grasps that are at hand: those of a run, and those given by file."""

    run: Run | None = None
    hands: Mapping[str, Hand] = field(default_factory=dict)
    objects: Mapping[str, ObjectModel] = field(default_factory=dict)

    def hand(self, name: str) -> Hand:
        """A hand given, of the run, built in, or a URDF or MJCF file."""
        from neuralgrasps.hands.zoo import load_hand

        if name in self.hands:
            return self.hands[name]
        return self.run.field.hands[name] if self.run and name in self.run.field.hands else load_hand(name)

    def object(self, name: str) -> ObjectModel:
        """An object given, of the run, built in, imported, or a mesh file."""
        from neuralgrasps.objects.zoo import load_object

        if name in self.objects:
            return self.objects[name]
        return self.run.field.objects[name] if self.run and name in self.run.field.objects else load_object(name)

    def grasps(self, hand: Hand, obj: ObjectModel) -> GraspSet | None:
        """The run's grasps of this hand on this object; None when it has none."""
        if self.run is None or obj.name not in self.run.field.objects:
            return None
        if self.run.field.objects[obj.name].content_hash != obj.content_hash:
            return None
        return self.run.grasps.get((hand.name, obj.name))


def open_known(run: Path, hands: tuple[str, ...], objects: tuple[str, ...]) -> Known:
    """The run, if one is named, with its hands and objects; `hands`, `objects`: files of others, or that have moved."""
    from neuralgrasps.cli.evaluate import open_run
    from neuralgrasps.cli.models import open_hands, open_objects

    if str(run) == NO_RUN:
        return Known(hands=open_hands(hands), objects=open_objects(objects))
    return Known(run=open_run(run, hands, objects))


def ask_grasp(known: Known, text: str, object_name: str | None) -> Asked:
    """A grasp of a file or, by its hand's name, of the run; `text` ends in :ROW unless it is row 0.

    Raises:
        InputError: no such file or grasp, or one of another object.
    """
    from neuralgrasps.apply.transfer_query import query_from_grasp

    spec, row = _split_row(text)
    of_run = known.run is not None and spec in known.run.field.hands and not Path(spec).is_file()
    grasps = _run_grasps(known, spec, object_name) if of_run else _file_grasps(spec, object_name)
    if not 0 <= row < len(grasps):
        raise InputError(f"--query asks for grasp {row}; '{spec}' holds {len(grasps)} grasps, numbered from 0.")
    hand = known.hand(grasps.config.get("hand_source", grasps.hand) if Path(spec).is_file() else grasps.hand)
    obj = known.object(object_name or grasps.config.get("object_source", grasps.object))
    if obj.name != grasps.object:
        raise InputError(f"the grasps of '{spec}' hold '{grasps.object}', --object is '{obj.name}'; expected the same.")
    hand.check_q(grasps.q)
    X_OH, q = np.array(grasps.X_OH[row]), np.array(grasps.q[row])
    query = query_from_grasp(hand, obj, X_OH, q)
    return Asked(query=query, obj=obj, title=f"grasp {row} of the {hand.name} hand", grasp=(hand, X_OH, q))


def ask_points(known: Known, path: Path, object_name: str | None, *, contacts: bool) -> Asked:
    """Points all over a hand, or the few points that are to be touched; .ply, .npy or text, metres, object frame."""
    from neuralgrasps.apply.transfer_query import query_from_contacts, query_from_points
    from neuralgrasps.perception.frame_files import read_cloud

    option = "--contacts" if contacts else "--query-cloud"
    if object_name is None:
        raise InputError(f"{option} does not say which object the points are on; name it with --object.")
    obj = known.object(object_name)
    points = read_cloud(path)
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        raise InputError(f"'{path}' holds no finite point; expected x y z in metres, in the object's frame.")
    try:
        query = query_from_contacts(obj, points) if contacts else query_from_points(obj, points)
        points, note = _moved_on(obj, points) if contacts else (points, "")
        query = query_from_contacts(obj, points) if note else query
    except InputError as error:
        raise InputError(f"'{path}': {error}") from error
    count = counted(len(points), "contact" if contacts else "point") + ("" if contacts else " of a hand")
    return Asked(query=query, obj=obj, title=f"{count} in '{path.name}'", points_O=points, note=note)


def _moved_on(obj: ObjectModel, points: np.ndarray) -> tuple[np.ndarray, str]:
    """Drawn points (M, 3), all put on the surface where one is too far off it, and the warning that says so, or ""."""
    from neuralgrasps.apply.drawn_contacts import on_surface

    nearest, off = on_surface(obj, points)
    far = np.flatnonzero(off > OFF_SURFACE_M)
    if not len(far):
        return points, ""
    listed = ", ".join(f"no. {k + 1}: {1e3 * off[k]:.0f} mm" for k in far[:_LISTED])
    more = f" and {len(far) - _LISTED} more" if len(far) > _LISTED else ""
    return nearest, (
        f"warning: {len(far)} of {len(points)} drawn points are more than {1e3 * OFF_SURFACE_M:.0f} mm off the surface "
        f"of '{obj.name}' ({listed}{more}); the nearest points of the surface are used instead. Is it the object's "
        "frame, in metres?"
    )


def _split_row(text: str) -> tuple[str, int]:
    """ "FILE:3" as (FILE, 3), "FILE" as (FILE, 0)."""
    match = re.fullmatch(r"(.+):(-?\d+)", text)
    return (match[1], int(match[2])) if match and not Path(text).exists() else (text, 0)


def _run_grasps(known: Known, hand: str, object_name: str | None) -> GraspSet:
    assert known.run is not None
    objects = [name for h, name in known.run.grasps if h == hand]
    if not objects:
        raise InputError(f"the run holds no grasps of hand '{hand}'; give a grasp file: --query FILE:ROW.")
    name = object_name or objects[0]
    if name not in objects:
        raise unknown_name("object", name, objects)
    return known.run.grasps[hand, name]


def _file_grasps(spec: str, object_name: str | None) -> GraspSet:
    from neuralgrasps.grasps.grasp_io import load_grasps

    if not Path(spec).exists():
        raise InputError(
            f"--query '{spec}' is neither a grasp file nor a hand of a run given; expected FILE[:ROW] or HAND[:ROW]."
        )
    grasps = load_grasps(Path(spec))
    if object_name is not None and object_name != grasps.object and not Path(object_name).exists():
        raise InputError(
            f"the grasps of '{spec}' hold '{grasps.object}', --object is '{object_name}': contacts on one object say "
            "nothing about another. Leave --object out, or give grasps of that object."
        )
    return grasps
