"""What `demonstrate` prints and returns: the stages, the grasp that was seen, and the robot's grasps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from neuralgrasps.cli.terminal import Terminal
from neuralgrasps.cli.transfer_show import SCALE_TEXT, grasp_rows

if TYPE_CHECKING:
    from neuralgrasps.apply.demonstrate import Demonstration
    from neuralgrasps.report.demonstration_page import DemonstrationStory

_ROWS = 6  # grasps that are printed


def demonstration_record(story: DemonstrationStory, kept: Sequence[int]) -> dict[str, Any]:
    """The JSON object, units in the names.

    Args:
        kept: places of the frames among all of the folder.
    """
    from neuralgrasps.report.demonstration_stages import failed_stage

    demo = story.demo
    stage, reason = failed_stage(demo, story.trial, executed=story.executed)
    return {
        "object": demo.object,
        "hand": demo.hand,
        "stage": stage,
        "reason": reason,
        "stages": [
            {"name": s.name, "verdict": s.verdict, "text": s.text, "reason": s.reason} for s in story.stages
        ],
        "frames": len(story.frames),
        "frame_names": [frame.name for frame in story.frames],
        "frame_numbers": list(kept),
        "found_object": _object_record(demo),
        "person": _person_record(demo),
        "transfer": _transfer_record(demo),
        "execution": _execution_record(story),
        "seconds": dict(demo.seconds) | dict(story.seconds),
    }  # fmt: skip


def _object_record(demo: Demonstration) -> dict[str, Any] | None:
    followed = demo.followed
    if followed is None or followed.pose is None:
        return None
    table = demo.table_O
    return {
        "confidence": followed.pose.confidence,
        "found_in": followed.found_in,
        "X_CO": followed.X_CO,
        "seen_share": followed.seen,
        "moves_from": followed.moves_from,
        "lost_from": followed.lost_from,
        "table_normal_O": None if table is None else table.normal,
        "table_offset_m": None if table is None else table.offset_m,
    }


def _person_record(demo: Demonstration) -> dict[str, Any] | None:
    track = demo.track
    if track is None:
        return None
    grasp = track.grasp
    per_frame = [
        {
            "box": None if box is None else [box.u_min, box.v_min, box.u_max, box.v_max],
            "score": None if box is None else box.score,
            "joints_C": None if seen is None else seen.points_C,
            "joint_weight": None if seen is None else seen.weight,
            "fitted_joints_C": None if fitted is None else fitted.joints_C,
            "cloud_rms_mm": None if fitted is None else 1e3 * fitted.cloud_rms_m,
            "confidence": None if fitted is None else fitted.confidence,
        }
        for box, seen, fitted in zip(track.boxes, track.seen, track.frames, strict=True)
    ]
    return {
        "side": track.side,
        "scale": track.scale,
        "found_in": len(track.found),
        "looked_at": list(track.looked),
        "moment": track.moment,
        "still": list(track.still),
        "contacts": list(track.contacts),
        "visible_share": track.visible,
        "confidence": None if grasp is None else grasp.confidence,
        "cloud_rms_mm": None if grasp is None else 1e3 * grasp.cloud_rms_m,
        "joint_rms_mm": None if grasp is None else 1e3 * grasp.joint_rms_m,
        "penetration_mm": None if grasp is None else 1e3 * grasp.penetration_m,
        "X_OH": demo.X_OH,
        "q": demo.q,
        "doubts": list(track.reasons),
        "by_frame": per_frame,
    }


def _transfer_record(demo: Demonstration) -> dict[str, Any] | None:
    found = demo.transfer
    if found is None:
        return None
    grasps = found.grasps
    return {
        "grasps": [
            row | {"why": found.reasons[i], "X_OH": grasps.X_OH[i], "q": grasps.q[i]}
            for i, row in enumerate(grasp_rows(found))
        ],
        "oracle_similarity": found.oracle,
        "tried": found.tried,
        "reason": found.reason,
        "nearest_similarity": found.nearest_similarity,
    }


def _execution_record(story: DemonstrationStory) -> dict[str, Any] | None:
    from neuralgrasps.evaluate.demonstrate_execute import executed_place
    from neuralgrasps.report.trial_pictures import trial_record

    if story.trial is None:
        return None
    return trial_record(story.trial) | {"compiled": story.compiled, "place": executed_place(story.trial, story.demo)}


def show_demonstration(terminal: Terminal, record: Mapping[str, Any]) -> None:
    """Stages, grasps, and where it stopped."""
    words = {"ok": "OK", "doubtful": "doubtful", "failed": "FAILED", "not reached": "-"}
    terminal.table(
        ("stage", "", "what it came to"), [(s["name"], words[s["verdict"]], s["text"]) for s in record["stages"]]
    )
    transfer, person = record["transfer"], record["person"]
    if transfer is not None and transfer["grasps"]:
        terminal.say()
        _show_grasps(terminal, transfer["grasps"])
    if person is not None:
        terminal.notes(person["doubts"], title="Doubts about the hand:")
    if record["stage"]:
        terminal.say(f"Stopped at {_stage_title(record['stage'])}: {record['reason']}")
    if transfer is not None and not transfer["grasps"]:
        nearest = transfer["nearest_similarity"]
        if math.isfinite(nearest):
            terminal.say(f"The nearest grasp that does not hold has similarity {nearest:.3f}.")
    times = ", ".join(f"{name} {s:.1f} s" for name, s in record["seconds"].items())
    if times:
        terminal.say(f"Time: {times}.")


def _show_grasps(terminal: Terminal, grasps: Sequence[Mapping[str, Any]]) -> None:
    rows = [
        (g["rank"], f"{g['similarity']:.3f}", g["origin"], f"{g['epsilon']:.3f}", g["held"], short_why(g["why"]))
        for g in grasps[:_ROWS]
    ]
    terminal.table(("rank", "similarity", "from", "epsilon", "held", "why"), rows)
    if len(grasps) > _ROWS:
        terminal.say(f"... and {len(grasps) - _ROWS} more.")
    terminal.say(SCALE_TEXT)


def short_why(reason: str) -> str:
    """A grasp's reason without what other columns say: its place, its similarity, and that it held."""
    said = [part for whole in reason.split("; ") for part in whole.split(", ")]
    repeated = ("most alike", "number", "similarity", "held in")
    return ", ".join(part for part in said if not part.startswith(repeated)) or reason


def _stage_title(stage: str) -> str:
    from neuralgrasps.report.demonstration_stages import TITLES

    return TITLES.get(stage, stage)
