"""Frames to video files: H.264 in MP4 that plays everywhere, and small looping pictures for pages."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from PIL import Image

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.files import write_whole

FPS = 25
_QUALITY = "20"  # x264's constant rate factor: 18 can hardly be told from the source, 23 is its default
_BT709 = 1  # how red, green and blue became luma and chroma, said in the file


def write_video(path: str | Path, frames: Iterable[np.ndarray], *, fps: int = FPS) -> int:
    """Encode frames as they come; the file appears when it is whole.

    The same frames give the same bytes. Videos made by this function with frames of one size can be joined by
    `join_videos`.

    Args:
        path: an .mp4 file; its folder is made.
        frames: (h, w, 3) uint8, all of one size, both sides even.
        fps: frames a second.
    Returns:
        How many frames were written.
    Raises:
        InputError: no frame, or the path does not end in .mp4. ShapeError: a frame of odd sides or another size.
        StorageError: the place cannot be written.
    """
    path = _checked(path)
    with tempfile.TemporaryDirectory() as folder:
        draft = Path(folder) / "video.mp4"
        count = _encode(draft, frames, fps)
        write_whole(path, draft.read_bytes())
    return count


def join_videos(path: str | Path, parts: Sequence[str | Path]) -> Path:
    """One video after the other, copied without encoding them again.

    Args:
        parts: made by `write_video`, of one size and rate.
    Raises:
        InputError: no part, or parts of different sizes. StorageError: the place cannot be written.
    """
    path = _checked(path)
    if not parts:
        raise InputError("there is no video to join; expected at least one part.")
    with tempfile.TemporaryDirectory() as folder:
        draft = Path(folder) / "video.mp4"
        _copy(draft, [str(part) for part in parts])
        return write_whole(path, draft.read_bytes())


def animation(frames: Sequence[np.ndarray], *, fps: float, size: tuple[int, int], quality: int = 72) -> bytes:
    """A looping WebP of frames (h, w, 3) uint8, scaled to `size` (width, height)."""
    if not frames:
        raise InputError("an animation needs at least one frame.")
    pictures = [Image.fromarray(frame).resize(size, Image.Resampling.LANCZOS) for frame in frames]
    stream = io.BytesIO()
    pictures[0].save(
        stream, "WEBP", save_all=True, append_images=pictures[1:], duration=round(1000 / fps), loop=0,
        quality=quality, method=3,
    )  # fmt: skip
    return stream.getvalue()


def _checked(path: str | Path) -> Path:
    path = Path(path)
    if path.suffix.lower() != ".mp4":
        raise InputError(f"video '{path}' does not end in .mp4, the only kind that is written; rename it.")
    return path


def _encode(draft: Path, frames: Iterable[np.ndarray], fps: int) -> int:
    count, shape = 0, (0, 0, 0)
    with av.open(str(draft), "w", options={"movflags": "+faststart", "fflags": "+bitexact"}) as container:
        stream = None
        for frame in frames:
            if stream is None:
                shape = frame.shape
                stream = _stream(container, shape, fps)
            if frame.shape != shape:
                raise ShapeError(f"frame {count} has shape {frame.shape}; the video's frames are {shape}.")
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
            picture = picture.reformat(format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG")
            picture.pts, picture.time_base = count, Fraction(1, fps)
            container.mux(stream.encode(picture))
            count += 1
        if stream is None:
            raise InputError("a video needs at least one frame.")
        container.mux(stream.encode(None))
    return count


def _stream(container: av.container.OutputContainer, shape: tuple[int, ...], fps: int) -> av.VideoStream:
    height, width = shape[:2]
    if len(shape) != 3 or shape[2] != 3 or height % 2 or width % 2:
        raise ShapeError(f"frames have shape {shape}; expected (height, width, 3) with even sides.")
    stream = container.add_stream("libx264", rate=fps, options={"crf": _QUALITY, "preset": "medium"})
    stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
    context = stream.codec_context
    context.thread_count = 1  # the bytes depend on it
    context.time_base = Fraction(1, fps)
    context.colorspace = context.color_primaries = context.color_trc = _BT709
    return stream


def _copy(draft: Path, parts: Sequence[str]) -> None:
    with av.open(str(draft), "w", options={"movflags": "+faststart", "fflags": "+bitexact"}) as container:
        target, size, shift = None, (0, 0), 0
        for part in parts:
            with av.open(part) as source:
                stream = source.streams.video[0]
                if target is None:
                    target, size = container.add_stream_from_template(stream), (stream.width, stream.height)
                if (stream.width, stream.height) != size:
                    raise InputError(f"video '{part}' is {stream.width} x {stream.height}; the first one is {size}.")
                end = shift
                for packet in source.demux(stream):
                    if packet.pts is None or packet.dts is None:
                        continue  # the empty packet at the end
                    end = max(end, shift + packet.pts + (packet.duration or 0))
                    packet.pts, packet.dts = packet.pts + shift, packet.dts + shift
                    packet.stream = target
                    container.mux(packet)
                shift = end
