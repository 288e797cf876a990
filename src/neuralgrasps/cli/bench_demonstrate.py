"""`neuralgrasps bench demonstrate`: synthetic RGB-D demonstrations, from frames to the object in the robot's hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from neuralgrasps.cli.bench_library import open_library, paper_objects
from neuralgrasps.cli.bench_result import absent_figures, conditions, with_options
from neuralgrasps.cli.terminal import Terminal

if TYPE_CHECKING:
    from neuralgrasps.evaluate.demonstrate_trials import VideoRecord

_NOTES = {
    "videos": "a person's hand of a random size and side comes to an object that rests on a table, makes a grasp that "
    "holds it in physics, keeps still and, in half of them, lifts it; 640 x 480 depth with the noise of a "
    "structured-light camera 0.5 to 1 m away. Hands are scaled copies of our own model, also in training: upper bounds",
    "hidden_": "the same of badly seen videos: 0.4 to 0.8 of the hand is seen at the grasp; the camera stands on the "
    "object's far side, low or behind the arm, or a box or can stands before the hand; the object is seen before the "
    "hand comes. _40_60, _60_80: of frames that show this share, and of videos whose grasp does",
    "joints_": "the joint net alone in the detector's box, in every other frame from the grasp on in which more than "
    "0.4 of the hand's outline is seen; root-relative: mean distance of the 20 joints with the wrists put together; "
    "Procrustes: of 21, after the best rotation, shift and scale; frames without a box are not in them (joints_found)",
    "fitted_": "the hand model fitted to each of these frames alone, its size measured once over the video; surface: "
    "root mean square distance of the true surface, all of it, to the fitted one, mean over the frames",
    "grasp_": "the one fit to all still frames of a video",
    "fps": "detector, two looks of the joint net, masked cloud and fit of one single frame, one thread, the other "
    "workers busy; video_fps: frames of the videos over the time of finding the object and watching the hand, where "
    "only some frames are looked at",
    "fit_rms_mm": "the fit alone: size and object's pose known, true mask off by up to a pixel with 5 % wrong ones, "
    "joints off by 10 mm in each coordinate; fit_sized_rms_mm: size measured over 6 frames",
    "trained_on": "the nets and the prior of postures know the built-in stand-ins (28 of the 160 training solids), not "
    "the scans; test grasps are others, by the same synthesis",
    "demonstrate_success": "the robot finds the object anew, before it at a random place of its table, and lifts it "
    "with a transferred grasp at the first attempt, as in `bench execute`; of all videos. The object stands there as "
    "it was seen to stand, so that a pose seen wrong costs nothing: demonstrate_success_right, lifted_right: lifted, "
    "and its pose at the moment of the grasp right (ADD-S < 1 cm)",
    "contact_map_difference": "mean |difference| of the contact map seen and the true one, in the best of the object's "
    "orientations; contact_similarity: as a similarity, on the scale of the transfer. Both, and "
    "demonstrate_similarity_minus_oracle (of known grasps that clear the table), of the videos that got so far",
}


def bench_demonstrate(
    terminal: Terminal,
    *,
    objects: Sequence[str],
    count: int | None,
    seed: int,
    workers: int | None,
    quick: bool,
) -> dict[str, Any]:
    """Config, figures, what is absent and why, notes and tables of the benchmark.

    Args:
        objects: names, files or folders; default the seven scans where they are, else the built-in seven.
        count: demonstrations per object, and as many badly seen ones; default 10, quick 2.
    """
    from neuralgrasps.evaluate.demonstrate_bench import QUICK, DemonstrateBenchConfig
    from neuralgrasps.evaluate.demonstrate_bench import bench_demonstrate as measure
    from neuralgrasps.evaluate.demonstrate_figures import demonstrate_figures, demonstrate_tables, figure_names

    config = with_options(QUICK if quick else DemonstrateBenchConfig(), seed=seed, videos=count, hidden=count)
    library, models = open_library(terminal, paper_objects(objects))
    with terminal.progress("demonstrations", "tasks") as bar:
        bench = measure(library, config=config, workers=workers, progress=bar)
    figures, tables = demonstrate_figures(bench), demonstrate_tables(bench)
    _show(terminal, tables)
    expected = figure_names(hidden=config.hidden > 0)
    return {
        "config": conditions(config, models, quick=quick, workers=workers, wall_s=bench.wall_s, run=library.run),
        "figures": figures,
        "absent": absent_figures(terminal, figures, expected, {}),
        "notes": _NOTES,
        "table": tables,
        "videos": _plain(bench.videos),
        "hidden_videos": _plain(bench.hidden),
    }


def _plain(videos: Sequence[VideoRecord]) -> list[dict[str, Any]]:
    """Records without their frames."""
    return [
        {k: v for k, v in asdict(video).items() if k != "frames"} | {"lifted_right": video.lifted_right}
        for video in videos
    ]


def _show(terminal: Terminal, tables: Mapping[str, Sequence[Mapping[str, Any]]]) -> None:
    for name, rows in tables.items():
        if rows:
            terminal.say(f"{name.replace('_', ' ')}:")
            columns = tuple(rows[0])
            terminal.table(columns, [[row[c] for c in columns] for row in rows])
