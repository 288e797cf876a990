"""`neuralgrasps retrieve`: grasps of any hand that hold an object as a given grasp does."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from neuralgrasps.cli.evaluate import open_run
from neuralgrasps.cli.options import Names, OptionalFile, OptionalText, PositionalFolder
from neuralgrasps.cli.outputs import check_writable, make_parent
from neuralgrasps.cli.terminal import Outcome, Terminal
from neuralgrasps.errors import InputError, unknown_name

if TYPE_CHECKING:
    import numpy as np

    from neuralgrasps.model.checkpoint import Run
    from neuralgrasps.model.codes import CodeBook


def retrieve(
    terminal: Terminal,
    run: PositionalFolder,
    /,
    *,
    object_name: Annotated[OptionalText, tyro.conf.arg(name="object")] = None,
    query_hand: OptionalText = None,
    query_index: int = 0,
    query: OptionalFile = None,
    hand: OptionalText = None,
    count: int = 5,
    farthest: bool = False,
    picture: OptionalFile = None,
    hands: Names = (),
    objects: Names = (),
) -> Outcome:
    """Find the grasps of a run that touch an object most like a given grasp does.

    The query is a grasp of the run (--query-hand, --query-index) or of a grasp file (--query FILE, --query-index).

    Args:
        run: folder that `train` wrote.
        object_name: object held; default the run's first, or the query file's.
        query_hand: hand of the query; default the run's first.
        query_index: which grasp of the dataset or the file.
        query: grasp file, of any hand.
        hand: only grasps of this hand; default of all.
        count: how many.
        farthest: the least similar instead.
        picture: PNG file, the query on the left and the results beside it.
        hands: files of hands that are not built in and have moved.
        objects: the same for objects.
    """
    from neuralgrasps.apply.retrieve import retrieve as find

    if picture is not None:
        check_writable(picture)
    if query is not None and query_hand is not None:
        raise InputError("--query FILE and --query-hand both name the query; give one of them.")
    with terminal.progress("reading the run"):
        model = open_run(run, hands, objects)
    book = model.codebook
    if query is not None:
        asked, name, model = _query_from_file(model, query, query_index, object_name)
        gallery = book
    else:
        name = _object(book, object_name)
        row = _query_row(book, name, query_hand, query_index)
        asked, gallery = book[row], _without(book, row)
    found = find(asked, gallery, object_name=name, hand=hand, count=count, farthest=farthest, include_test=True)
    rows = _rows(gallery, found, range(int((found.index[0] >= 0).sum())))
    query_name = asked.hands[int(asked.hand_index[0])]
    which = "least" if farthest else "most"
    terminal.say(f"{name}: grasps that hold it {which} like grasp {query_index} of {query_name}")
    terminal.table(
        ("rank", "hand", "grasp", "part", "code distance", "contact distance"),
        [
            (
                r["rank"],
                r["hand"],
                r["grasp_index"],
                r["part"],
                f"{r['code_distance']:.4f}",
                f"{r['contact_distance']:.4f}",
            )
            for r in rows
        ],
    )
    terminal.say(
        "Distances: mean absolute difference of the contact part of the codes, and of the contact maps; 0 = same."
    )
    result: dict[str, Any] = {"object": name, "query_hand": query_name, "query_index": query_index, "results": rows}
    if picture is not None:
        _draw(model, [asked, *(gallery[int(i)] for i in found.index[0] if i >= 0)], name, picture)
        terminal.say(f"Picture: {picture}")
        result["picture"] = str(picture)
    return Outcome(result=result)


def _object(book: CodeBook, name: str | None) -> str:
    if name is None:
        return book.objects[0]
    if name not in book.objects:
        raise unknown_name("object", name, book.objects)
    return name


def _query_row(book: CodeBook, object_name: str, hand: str | None, index: int) -> int:
    import numpy as np

    if hand is None:
        hand = next(h for h in book.hands if book.where(hand=h, object_name=object_name).any())
    of_pair = np.flatnonzero(book.where(hand=hand, object_name=object_name))
    if not len(of_pair):
        raise InputError(f"the run holds no grasps of hand '{hand}' on '{object_name}'.")
    row = of_pair[book.grasp_index[of_pair] == index]
    if not len(row):
        numbers = np.sort(book.grasp_index[of_pair])
        raise InputError(
            f"--query-index is {index}; the run holds {len(numbers)} grasps of '{hand}' on '{object_name}', numbered "
            f"{numbers[0]} to {numbers[-1]} with gaps for grasps in neither part."
        )
    return int(row[0])


def _without(book: CodeBook, row: int) -> CodeBook:
    import numpy as np

    return book[np.flatnonzero(np.arange(len(book)) != row)]


def _query_from_file(run: Run, path: Path, index: int, object_name: str | None) -> tuple[CodeBook, str, Run]:
    """The code of a grasp from a file; hands that the run does not know are added to its field."""
    from dataclasses import replace

    from neuralgrasps.grasps.grasp_io import load_grasps
    from neuralgrasps.hands.zoo import load_hand

    grasps = load_grasps(path)
    name = _object(run.codebook, object_name or grasps.object)
    if not 0 <= index < len(grasps):
        raise InputError(f"--query-index is {index}; '{path}' holds {len(grasps)} grasps, numbered from 0.")
    field = run.field
    if grasps.hand not in field.hands:
        field = field.with_hand(load_hand(grasps.config.get("hand_source", grasps.hand)))
    field.hand(grasps.hand).check_q(grasps.q)
    one = grasps[index]
    code = field.encode(one.X_OH, one.q, hand=one.hand, object_name=name)
    return code, name, replace(run, field=field)


def _rows(gallery: CodeBook, found: Any, ranks: range) -> list[dict[str, Any]]:
    rows = []
    for k in ranks:
        i = int(found.index[0, k])
        rows.append(
            {
                "rank": k + 1,
                "hand": gallery.hands[int(gallery.hand_index[i])],
                "grasp_index": int(gallery.grasp_index[i]),
                "part": "test" if gallery.is_test[i] else "train",
                "code_distance": float(found.code_distance[0, k]),
                "contact_distance": float(found.map_distance[0, k]),
            }
        )
    return rows


def _draw(run: Run, codes: list[CodeBook], object_name: str, path: Path) -> None:
    """Query and results side by side."""
    import numpy as np
    import torch

    from neuralgrasps.report.figures import render_grasp, save_picture

    pictures: list[np.ndarray] = []
    for one in codes:
        hand = one.hands[int(one.hand_index[0])]
        grasp = run.field.decode(torch.as_tensor(one.values, dtype=torch.float64), hand=hand, object_name=object_name)
        pictures.append(
            render_grasp(run.field.hand(hand), run.field.object(object_name), grasp.X_OH[0].numpy(), grasp.q[0].numpy(),
                         size=(400, 400))
        )  # fmt: skip
    make_parent(path)
    save_picture(path, np.concatenate(pictures, axis=1), background="#ffffff")
