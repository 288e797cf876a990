"""What `pose --out` writes: a picture per frame, and in a folder also the numbers and a page."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from neuralgrasps.cli.outputs import make_parent
from neuralgrasps.cli.pose_find import Finding
from neuralgrasps.cli.pose_hints import LONE_NOTE
from neuralgrasps.cli.pose_show import frame_figure
from neuralgrasps.cli.terminal import Terminal, counted, write_json

_SHOWN = 40  # frames on the page
_PAGE_BYTES = 20_000_000


class PoseFiles:
    """Writes pictures as frames are done, and at the end the files about all of them.

    Args of the constructor: the picture or folder to write, the names looked for, and how many frames will come.
    """

    def __init__(self, out: Path, names: Sequence[str], *, frames: int) -> None:
        self._out, self._is_folder = out, out.suffix.lower() != ".png"
        self._names, self._colours = list(names), dict[str, str]()  # the first that are seen get the best colours
        self._on_page = set(np.linspace(0, frames - 1, min(frames, _SHOWN)).round().astype(int).tolist())
        self._frames, self._seen = frames, 0
        self._figures: list[Any] = []
        self._pictures: list[str] = []

    def add(self, finding: Finding, record: dict[str, Any]) -> None:
        """Draw one frame; its picture's name goes into the record."""
        from neuralgrasps.report.figures import save_picture
        from neuralgrasps.report.pose_overlay import model_colour, render_pose_overlay

        number, self._seen = self._seen, self._seen + 1
        frame = finding.frame
        if frame is None:
            return
        image = frame.depth if frame.colour is None else frame.colour
        for placed in finding.placed:
            self._colours.setdefault(placed.obj.name, model_colour(len(self._colours)))
        models = [self._drawn(p) for p in reversed(finding.placed)]  # the surest on top
        overlay = render_pose_overlay(image, models, frame.intrinsics, depth=frame.depth)
        path = self._out / f"{_file_name(finding.name)}.png" if self._is_folder else self._out
        make_parent(path)
        save_picture(path, overlay)
        record["picture"] = str(path)
        self._pictures.append(str(path))
        if self._is_folder and number in self._on_page:
            self._figures.append(frame_figure(finding, record, overlay, self._colours))

    def finish(self, terminal: Terminal, result: Mapping[str, Any]) -> dict[str, str]:
        """Write poses.json and index.html; returns what was written, by kind."""
        if not self._is_folder:
            terminal.say(f"Picture: {self._out}")
            return {"picture": str(self._out)}
        numbers, page = self._out / "poses.json", self._out / "index.html"
        write_json(str(numbers), result, terminal.out.file)
        self._write_page(page, terminal, result["seed"])
        terminal.say(f"{counted(len(self._pictures), 'picture')} and the numbers: {self._out}")
        terminal.say(f"Page: {page}")
        return {"folder": str(self._out), "numbers": str(numbers), "report": str(page)}

    def _write_page(self, page: Path, terminal: Terminal, seed: int) -> None:
        from neuralgrasps.cli.grasp_page import about_this_run
        from neuralgrasps.report.page import write_report
        from neuralgrasps.report.pose_page import pose_report

        left_out = self._frames - len(self._figures)
        notes = [f"{counted(left_out, 'frame')} of {self._frames} not shown here; see poses.json."] if left_out else []
        if len(self._names) == 1:
            notes.append(LONE_NOTE[:1].upper() + LONE_NOTE[1:])
        report = pose_report(self._figures, wanted=self._names, notes=notes, **about_this_run(terminal.command, seed))
        write_report(report, page, max_bytes=_PAGE_BYTES)

    def _drawn(self, placed: Any) -> Any:
        from neuralgrasps.report.pose_overlay import DrawnModel
        from neuralgrasps.report.pose_page import percent_text
        from neuralgrasps.report.sections import pretty_name

        doubt = "" if placed.is_found else "?"
        return DrawnModel(
            mesh=placed.obj.mesh,
            X_CO=placed.pose.X_CO,
            label=f"{pretty_name(placed.obj.name)}{doubt} {percent_text(placed.confidence)}",
            colour=self._colours[placed.obj.name],
            contour_only=not placed.is_found,
        )


def _file_name(name: str) -> str:
    """The frame's name without anything that leads out of the folder."""
    return re.sub(r"[^\w.-]+", "_", name).strip(".") or "frame"
