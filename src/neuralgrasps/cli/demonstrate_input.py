"""What `demonstrate` looks at: the frames of a video or a single one, and joints that another tool read in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from neuralgrasps.cli.options import OptionalFile, OptionalFloat
from neuralgrasps.cli.pose_input import Pending, PoseSource, list_sources
from neuralgrasps.cli.terminal import Terminal, counted
from neuralgrasps.errors import InputError

if TYPE_CHECKING:
    from neuralgrasps.human.seen import SeenJoints
    from neuralgrasps.perception.frame import Frame

OptionalSide = Annotated[
    Literal["right", "left"] | None, tyro.conf.arg(metavar="right|left", help_behavior_hint="(default: decided)")
]
_MOST_FRAMES = 600  # 3 MB each
_NAMED = 3  # of the frames that are left out


@dataclass(frozen=True, slots=True, kw_only=True)
class ShownSource:
    """What was filmed, as options of the command.

    Attributes:
        colour: picture for a single depth image, only to draw over: all comes from depth.
        every: take every n-th frame.
        fx: focal length, pixels.
        fy: focal length, pixels; default fx.
        cx: principal point, pixels; default the middle.
        cy: principal point, pixels; default the middle.
        camera: JSON file of the camera in place of fx to cy; default a camera.json beside the images.
        depth_scale: units of a depth image per metre; default 1000 for whole numbers, 1 for floating ones.
        joints: 21 joints of the hand in every frame, by another tool, in place of the library's own: a JSON file, or a
            folder with one for each frame.
        landmarker: hand landmarker model (.task) to read them with; needs its package.
        side: of the person's hand.
    """

    colour: OptionalFile = None
    every: int = 1
    fx: OptionalFloat = None
    fy: OptionalFloat = None
    cx: OptionalFloat = None
    cy: OptionalFloat = None
    camera: OptionalFile = None
    depth_scale: OptionalFloat = None
    joints: Annotated[Path | None, tyro.conf.arg(metavar="FILE|DIR", help_behavior_hint="(optional)")] = None
    landmarker: OptionalFile = None
    side: OptionalSide = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shown:
    """Frames in order of time, their places among all of the folder, and joints read by another tool, or None.

    named: messages call them by their files' names, since their numbers here are not those of the files.
    """

    frames: list[Frame]
    numbers: list[int]
    joints: list[SeenJoints | None] | None = None
    named: bool = False


ShownOptions = Annotated[ShownSource, tyro.conf.arg(name="")]


def check_shown(given: ShownSource) -> None:
    """Refuse options that contradict each other.

    Raises:
        InputError: says which, and what to give.
    """
    if given.every < 1:
        raise InputError(f"--every is {given.every}; expected 1 for all frames, 2 for every second one.")
    if given.joints is not None and given.landmarker is not None:
        raise InputError("--joints and --landmarker both give the joints; give one of them.")
    for option, path in (("--joints", given.joints), ("--landmarker", given.landmarker)):
        if path is not None and not path.exists():
            raise InputError(f"{option} is '{path}', which does not exist.")


def read_shown(terminal: Terminal, rgbd: Path, given: ShownSource) -> Shown:
    """The frames, and the joints of another tool; a frame without any depth is left out, and said.

    Raises:
        InputError: no frame can be read, or joints that do not fit the frames.
    """
    pending = list_sources(_as_pose_source(rgbd, given))
    # files of joints have a record for every frame of the folder
    numbers = range(0, len(pending), 1 if given.joints is not None else given.every)
    if len(numbers) > _MOST_FRAMES:
        every = -(-len(pending) // _MOST_FRAMES)
        raise InputError(
            f"'{rgbd}' holds {len(pending)} frames; expected at most {_MOST_FRAMES}. Take one in {every} with --every "
            f"{every}, or cut the video."
        )
    shown = _read_frames(terminal, pending, numbers)
    named = _say_missing(terminal, rgbd, len(pending)) or given.every > 1 or len(shown.numbers) < len(pending)
    return replace(_with_joints(terminal, shown, given), named=named)


def _say_missing(terminal: Terminal, rgbd: Path, count: int) -> bool:
    """Say which frames have a picture and no depth, so that they are not among the `count` frames; whether any."""
    from neuralgrasps.perception.frame_files import names_without_depth

    missing = names_without_depth(rgbd) if rgbd.is_dir() and not (rgbd / "scene_camera.json").exists() else []
    if missing:
        first = ", ".join(missing[:_NAMED]) + (", ..." if len(missing) > _NAMED else "")
        terminal.complain(
            f"warning: {len(missing)} of {counted(count + len(missing), 'frame')} have no depth and are left out "
            f"({first})."
        )
    return bool(missing)


def _with_joints(terminal: Terminal, shown: Shown, given: ShownSource) -> Shown:
    if given.joints is not None:
        from neuralgrasps.human.video.joint_files import read_joints

        shown = replace(shown, joints=read_joints(given.joints, shown.frames))
        keep = [k for k, number in enumerate(shown.numbers) if number % given.every == 0]
        return Shown(
            frames=[shown.frames[k] for k in keep],
            numbers=[shown.numbers[k] for k in keep],
            joints=None if shown.joints is None else [shown.joints[k] for k in keep],
        )
    if given.landmarker is not None:
        from neuralgrasps.human.video.landmarker import landmark_joints

        with terminal.progress("reading joints"):
            shown = replace(shown, joints=landmark_joints(shown.frames, given.landmarker, side=given.side))
    return shown


def _read_frames(terminal: Terminal, pending: Sequence[Pending], numbers: Sequence[int]) -> Shown:
    frames: list[Frame] = []
    kept: list[int] = []
    refused: list[InputError] = []
    with terminal.progress("reading frames", "frames") as bar:
        for done, number in enumerate(numbers, start=1):
            try:
                frame = pending[number].read().frame
            except InputError as error:
                refused.append(error)
                continue
            if frame is not None:
                frames.append(frame)
                kept.append(number)
            bar(done, len(numbers))
    if not frames:
        raise refused[0]
    if refused:
        terminal.complain(f"warning: {counted(len(refused), 'frame')} left out, the first because: {refused[0]}")
    return Shown(frames=frames, numbers=kept)


def _as_pose_source(rgbd: Path, given: ShownSource) -> PoseSource:
    """The same options for the reader of frames."""
    if rgbd.is_file():
        return PoseSource(
            depth=rgbd, colour=given.colour, fx=given.fx, fy=given.fy, cx=given.cx, cy=given.cy, camera=given.camera,
            depth_scale=given.depth_scale,
        )  # fmt: skip
    if not rgbd.is_dir():
        raise InputError(f"--rgbd is '{rgbd}', which does not exist; expected a folder of frames or a depth image.")
    if given.colour is not None:
        raise InputError("--colour goes with a single depth image; frames of a folder bring their own.")
    return PoseSource(
        frames=rgbd, fx=given.fx, fy=given.fy, cx=given.cx, cy=given.cy, camera=given.camera,
        depth_scale=given.depth_scale,
    )  # fmt: skip
