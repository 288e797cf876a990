"""`neuralgrasps bench pose`: how far off, how sure and how fast pose estimates are, beside those of others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from neuralgrasps.cli.bench_library import open_library
from neuralgrasps.cli.bench_result import absent_figures, conditions, with_options
from neuralgrasps.cli.models import source_text
from neuralgrasps.cli.terminal import Terminal

OTHER_SCANS = (
    "002_master_chef_can", "004_sugar_box", "007_tuna_fish_can", "036_wood_block", "051_large_clamp", "061_foam_brick",
)  # fmt: skip
_PEER_PACKAGES = ("open3d", "small_gicp", "opencv-contrib-python-headless")
_NOTES = {
    "sets": "one object in a stable pose on a table, seen from 0.5 to 1.2 m; easy: nothing in front; occluded: 25 to "
    "80 % visible; hard: occluded, the mask spills over by 3 mm, depth 0.3 % too far with a smooth error of 3 mm and "
    "2.5 mm more noise. The same scenes for all methods; those that see fewer see the first ones",
    "pose_ms": "processor time of one estimate, one thread, median over all three sets; what is made once per object "
    "(clouds, features, tables of views) is not in it, for any method; of ours the table's fit is not in it (table_ms)",
    "given": "ours: depth image, camera, mask, and the table that find_table sees, none when it sees none; the others: "
    "the measured points of the mask",
    "adds_auc": "percent; ADD-S from the model's points to the true surface, area to 10 cm; no pose counts as 0",
    "mssd_01d": "share with an MSSD below a tenth of the diameter, modulo the object's symmetry",
    "low_visible_mssd_01d": "the same where 25 to 45 % are visible, occluded and hard together",
    "identity": "share named right among all objects here; none of these counts as wrong",
    "background_refused": "of things that no library has, the share named none; left_out_refused: of occluded scenes "
    "whose object is not among those asked",
    "calibration_at_90": "of our estimates with a confidence of at least 0.9 in all three sets, those with ADD-S below "
    "1 cm; _mssd: with MSSD below a tenth of the diameter",
    "_baseline, _contact": "Khargonkar et al. 2022, supplement, Eq. 1 and 2, on the exact distance of the object; "
    "_contact with the gripper at an unseen Fetch grasp of the shipped run, at its true pose; objects with grasps only",
    "_open3d": "FPFH, RANSAC and point-to-plane ICP, best of several runs",
    "_small_gicp": "generalised ICP from 64 starts; _ppf: OpenCV's point pair features, aligned by generalised ICP",
    "contact_": "ours, with and without the contacts of a hand that holds the object and is believed 2 mm and 1 degree "
    "off, in the air, sensor and mask as in hard; right: ADD-S < 1 cm and MSSD < 0.1 diameters; seen: at least half of "
    "the contacts are within 10 mm of an observed point; sign_p: two-sided sign test of better against worse; nearer, "
    "further_off: MSSD changed by more than 1 mm",
    "track_": "a camera that stands still, no mask; the object is pushed 5 to 10 mm and turned 2 to 3 degrees a frame; "
    "kept: share of frames that are right",
}


def bench_pose(
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
        objects: names, files or folders; default the YCB scans that are here, else the built-in seven.
        count: scenes per object and set; default 20, quick 10.
    """
    from neuralgrasps.evaluate.pose_bench import QUICK, PoseBenchConfig
    from neuralgrasps.evaluate.pose_bench import bench_pose as measure
    from neuralgrasps.evaluate.pose_bench_figures import expected_figures, figure_names, pose_figures, pose_table

    config = with_options(QUICK if quick else PoseBenchConfig(), seed=seed, scenes=count)
    library, models = open_library(terminal, pose_objects(objects))
    with terminal.progress("pose", "tasks") as bar:
        bench = measure(library, config=config, workers=workers, progress=bar)
    figures, table = pose_figures(bench), pose_table(bench)
    _show(terminal, table["methods"])
    reasons = {name: why for subject, why in bench.absent.items() for name in figure_names(subject)}
    return {
        "config": conditions(
            config, models, quick=quick, workers=workers, run=library.run, packages=_packages(), counts=_counts(table)
        ),
        "figures": figures,
        "absent": absent_figures(terminal, figures, expected_figures(), reasons),
        "notes": _NOTES,
        "table": table,
    }


def pose_objects(given: Sequence[str]) -> tuple[str, ...]:
    """Sources of the objects: as given, folders unfolded; else the scans when the seven are here; else the built-in."""
    from neuralgrasps.objects.builtin import STAND_INS
    from neuralgrasps.objects.store import imported_names
    from neuralgrasps.objects.zoo import OBJECT_GROUPS, object_sources

    if given:
        return tuple(source_text(source) for source in object_sources(given))
    here, seven = set(imported_names()), OBJECT_GROUPS["ycb7"]
    if not set(seven) <= here:
        return tuple(STAND_INS)
    return tuple(sorted({*seven, *here.intersection(OTHER_SCANS)}))


def _packages() -> dict[str, str | None]:
    """Versions of the peers' packages; None where one is not installed."""
    found: dict[str, str | None] = {}
    for name in _PEER_PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = None
    return found


def _counts(table: Mapping[str, Any]) -> dict[str, int]:
    """How many estimates every figure is made of, by method and set."""
    return {f"{row['method']}, {row['set']}": int(row["count"]) for row in table["methods"]}


def _show(terminal: Terminal, rows: Sequence[Mapping[str, Any]]) -> None:
    columns = (
        ("method", "method"), ("set", "set"), ("n", "count"), ("ADD-S AUC", "add_s_auc"), ("< 5 mm", "under_5mm"),
        ("< 1 cm", "under_1cm"), ("MSSD < 0.1 d", "mssd_01d"), ("AR MSSD", "ar_mssd"), ("deg", "rotation_median_deg"),
        ("mm", "translation_median_mm"), ("CPU ms", "cpu_ms_median"),
    )  # fmt: skip
    cells = [[int(row[key]) if key == "count" else row[key] for _, key in columns] for row in rows]
    terminal.table([title for title, _ in columns], cells)
