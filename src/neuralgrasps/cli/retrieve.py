"""`neuralgrasps retrieve`: grasps of any hand that hold an object as a given grasp does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from neuralgrasps.cli.evaluate import open_run
from neuralgrasps.cli.options import Names, OptionalFile, OptionalText, PositionalFolder
from neuralgrasps.cli.outputs import check_writable, make_parent
from neuralgrasps.cli.retrieve_query import of_cloud, of_file, of_run
from neuralgrasps.cli.terminal import Outcome, Terminal
from neuralgrasps.errors import InputError

if TYPE_CHECKING:
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
    query_cloud: OptionalFile = None,
    viewpoint: Annotated[
        tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z", help_behavior_hint="(optional)")
    ] = None,
    hand: OptionalText = None,
    count: int = 5,
    farthest: bool = False,
    picture: OptionalFile = None,
    hands: Names = (),
    objects: Names = (),
) -> Outcome:
    """Find the grasps of a run that touch an object most like a given grasp does.

    The query is a grasp of the run (--query-hand, --query-index), of a grasp file (--query FILE, --query-index), or a
    hand that was only seen (--query-cloud FILE): its points, in metres, in the object's frame. The nearest by code are
    put in order by contact map.

    Args:
        run: folder that `train` wrote, or the name of a shipped run.
        object_name: object held; default the run's first, or the query file's.
        query_hand: hand of the query; default the run's first. With --query-cloud: the hand that was seen, whose pose
            and joints are then found; without it only where it touches is used.
        query_index: which grasp of the dataset or the file.
        query: grasp file, of any hand.
        query_cloud: points of a hand: .ply, .npy or x y z text.
        viewpoint: where the camera stood, object frame, metres, for a cloud of one view.
        hand: only grasps of this hand; default of all.
        count: how many.
        farthest: the least similar instead.
        picture: PNG file, the query on the left and the results beside it.
        hands: files of hands that are not built in and have moved.
        objects: the same for objects.
    """
    import numpy as np

    from neuralgrasps.apply.retrieve import retrieve as find

    if picture is not None:
        check_writable(picture)
    _check_query(query, query_hand, query_cloud, viewed=viewpoint is not None)
    with terminal.progress("reading the run"):
        model = open_run(run, hands, objects)
    if query_cloud is not None:
        asked = of_cloud(terminal, model, query_cloud, object_name, hand=query_hand, viewpoint_O=viewpoint)
    elif query is not None:
        asked = of_file(model, query, query_index, object_name)
    else:
        asked = of_run(model, object_name, query_hand, query_index)
    gallery, name, model = asked.gallery, asked.object, asked.run
    found = find(asked.code, gallery, object_name=name, hand=hand, count=count, farthest=farthest, include_test=True)
    rows = _rows(gallery, found, range(int((found.index[0] >= 0).sum())))
    query_name = asked.code.hands[int(asked.code.hand_index[0])]
    terminal.say(f"{name}: grasps that hold it {'least' if farthest else 'most'} like {asked.text}")
    _show(terminal, rows)
    result: dict[str, Any] = {"object": name, "query": asked.text, "query_hand": query_name, "results": rows}
    if query_cloud is None:
        result["query_index"] = query_index
    if picture is not None:
        shown = [asked.code] if np.isfinite(asked.code.values).all() else []  # points alone have no hand to draw
        _draw(model, [*shown, *(gallery[int(i)] for i in found.index[0] if i >= 0)], name, picture)
        terminal.say(f"Picture: {picture}")
        result["picture"] = str(picture)
    return Outcome(result=result)


def _check_query(query: Path | None, query_hand: str | None, query_cloud: Path | None, *, viewed: bool) -> None:
    if query is not None and (query_hand is not None or query_cloud is not None):
        raise InputError("--query, --query-cloud and --query-hand each name a query; with --query give neither other.")
    if viewed and (query_cloud is None or query_hand is None):
        raise InputError("--viewpoint is of a --query-cloud whose hand is named with --query-hand.")


def _show(terminal: Terminal, rows: Sequence[Mapping[str, Any]]) -> None:
    cells = [
        (r["rank"], r["hand"], r["grasp_index"], r["part"], f"{r['code_distance']:.4f}", f"{r['contact_distance']:.4f}")
        for r in rows
    ]
    terminal.table(("rank", "hand", "grasp", "part", "code distance", "contact distance"), cells)
    terminal.say(
        "Distances: mean absolute difference of the contact part of the codes, and of the contact maps, by which the "
        "first 20 are put in order; 0 = same."
    )


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
