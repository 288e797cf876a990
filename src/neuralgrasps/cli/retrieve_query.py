"""What `neuralgrasps retrieve` is asked about: a grasp of the run, of a file, or points of a hand that was seen."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from neuralgrasps.cli.terminal import Terminal
from neuralgrasps.errors import InputError, unknown_name

if TYPE_CHECKING:
    from neuralgrasps.model.checkpoint import Run
    from neuralgrasps.model.codes import CodeBook

FAR_M = 0.1  # points all farther than this from the object are of no hand that holds it


@dataclass(frozen=True, slots=True, kw_only=True)
class Query:
    """A code to search with and its object, in words, where to search, and the run, which may know one hand more."""

    code: CodeBook
    object: str
    text: str
    gallery: CodeBook
    run: Run


def of_run(run: Run, object_name: str | None, hand: str | None, index: int) -> Query:
    """A grasp of the run; it does not find itself."""
    import numpy as np

    book = run.codebook
    name = object_of(book, object_name)
    if hand is None:
        hand = next(h for h in book.hands if book.where(hand=h, object_name=name).any())
    of_pair = np.flatnonzero(book.where(hand=hand, object_name=name))
    if not len(of_pair):
        raise InputError(f"the run holds no grasps of hand '{hand}' on '{name}'.")
    row = of_pair[book.grasp_index[of_pair] == index]
    if not len(row):
        numbers = np.sort(book.grasp_index[of_pair])
        raise InputError(
            f"--query-index is {index}; the run holds {len(numbers)} grasps of '{hand}' on '{name}', numbered "
            f"{numbers[0]} to {numbers[-1]} with gaps for grasps in neither part."
        )
    others = book[np.flatnonzero(np.arange(len(book)) != row[0])]
    return Query(code=book[int(row[0])], object=name, text=f"grasp {index} of {hand}", gallery=others, run=run)


def of_file(run: Run, path: Path, index: int, object_name: str | None) -> Query:
    """A grasp of a file; a hand that the run does not know is added to its field."""
    from neuralgrasps.grasps.grasp_io import load_grasps
    from neuralgrasps.hands.zoo import load_hand

    grasps = load_grasps(path)
    if object_name is not None and object_name != grasps.object:
        raise InputError(
            f"the grasps of '{path}' hold '{grasps.object}', --object is '{object_name}': contacts on one object say "
            "nothing about another. Leave --object out, or give grasps of that object."
        )
    name = object_of(run.codebook, grasps.object)
    if not 0 <= index < len(grasps):
        raise InputError(f"--query-index is {index}; '{path}' holds {len(grasps)} grasps, numbered from 0.")
    field = run.field
    if grasps.hand not in field.hands:
        field = field.with_hand(load_hand(grasps.config.get("hand_source", grasps.hand)))
    field.hand(grasps.hand).check_q(grasps.q)
    one = grasps[index]
    code = field.encode(one.X_OH, one.q, hand=one.hand, object_name=name)
    return Query(
        code=code, object=name, text=f"grasp {index} of {one.hand}", gallery=run.codebook, run=replace(run, field=field)
    )


def of_cloud(
    terminal: Terminal,
    run: Run,
    path: Path,
    object_name: str | None,
    *,
    hand: str | None,
    viewpoint_O: tuple[float, float, float] | None,
) -> Query:
    """Points of a hand, in the object's frame: its pose and joints are inferred if the hand is known, else none."""
    import numpy as np

    from neuralgrasps.model.infer import encode_points, infer_grasps
    from neuralgrasps.model.infer import one_view_config as one_view
    from neuralgrasps.perception.frame_files import read_cloud

    book = run.codebook
    name = object_of(book, object_name)
    points = read_cloud(path)
    points = points[np.isfinite(points).all(axis=1)]
    check_near(run, name, points, path)
    if hand is None:
        code = encode_points([points], run.field, object_name=name)
        return Query(code=code, object=name, text=f"the {len(points)} points of '{path}'", gallery=book, run=run)
    run.field.hand(hand)
    config = None if viewpoint_O is None else one_view()
    eyes = None if viewpoint_O is None else np.array([viewpoint_O])
    with terminal.progress("finding the hand in the points"):
        found = infer_grasps([points], run.field, book, hand=hand, object_name=name, config=config, viewpoints_O=eyes)
    for reason in found.reasons[0]:
        terminal.complain(f"warning: the fitted {hand} hand may be wrong: {reason}")
    terminal.say(
        f"{hand} hand fitted to {len(points)} points: {1e3 * found.residual_m[0]:.1f} mm off on average, noise "
        f"{1e3 * found.noise_m[0]:.1f} mm"
    )
    return Query(code=found.codes, object=name, text=f"the {hand} hand seen in '{path}'", gallery=book, run=run)


def check_near(run: Run, object_name: str, points, path: Path) -> None:  # type: ignore[no-untyped-def]
    """Refuse points that are of no hand at the object, before a search that would always find something.

    Raises:
        InputError: fewer than 10 points, or all far from the object.
    """
    from neuralgrasps.geometry.sdf_grid import query_grid_numpy

    if len(points) < 10:
        raise InputError(f"'{path}' holds {len(points)} finite points; expected at least 10 of a hand.")
    nearest = float(query_grid_numpy(run.field.object(object_name).sdf, points).min())
    if nearest > FAR_M:
        raise InputError(
            f"the nearest point of '{path}' is {1e3 * nearest:.0f} mm from '{object_name}'. Points must be in metres, "
            "in the object's frame: move them there with the object's pose (X_CO of `neuralgrasps pose`)."
        )


def object_of(book: CodeBook, name: str | None) -> str:
    """The object asked for, or the book's first."""
    if name is None:
        return book.objects[0]
    if name not in book.objects:
        raise unknown_name("object", name, book.objects)
    return name
