"""Video files: decoded again, they show the frames that were given."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from neuralgrasps.errors import InputError, ShapeError
from neuralgrasps.report.video import FPS, animation, join_videos, write_video

H, W = 96, 128
COLOURS = ((200, 60, 30), (30, 90, 200), (240, 240, 235), (20, 20, 25))


def frames(count: int, *, start: int = 0, size: tuple[int, int] = (H, W)) -> Iterator[np.ndarray]:
    """A square that walks over a plain ground, four pixels a frame."""
    for i in range(start, start + count):
        frame = np.full((*size, 3), COLOURS[0], np.uint8)
        frame[24:56, 4 * i % 90 : 4 * i % 90 + 24] = COLOURS[1]
        yield frame


def decoded(path: Path) -> list[np.ndarray]:
    with av.open(str(path)) as container:
        return [f.to_ndarray(format="rgb24") for f in container.decode(video=0)]


def test_decoded_frames_are_those_that_were_written(tmp_path: Path):
    assert write_video(tmp_path / "a.mp4", frames(20)) == 20
    got = decoded(tmp_path / "a.mp4")
    assert len(got) == 20
    for wanted, shown in zip(frames(20), got, strict=True):
        off = np.abs(wanted.astype(int) - shown.astype(int))
        assert off.mean() < 4.0  # a shift of the square by one frame gives 10
        assert np.abs(shown[70:90].reshape(-1, 3).mean(axis=0) - COLOURS[0]).max() < 4.0


@pytest.mark.parametrize("colour", COLOURS)
def test_colours_are_kept(tmp_path: Path, colour: tuple[int, int, int]):
    write_video(tmp_path / "a.mp4", [np.full((H, W, 3), colour, np.uint8)] * 3)
    assert np.abs(decoded(tmp_path / "a.mp4")[1].astype(int) - colour).max() <= 4


def test_the_file_plays_everywhere_and_starts_at_once(tmp_path: Path):
    path = tmp_path / "deep" / "a.mp4"
    write_video(path, frames(5), fps=30)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        assert (stream.width, stream.height, stream.average_rate, stream.frames) == (W, H, 30, 5)
    data = path.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")


def test_equal_frames_give_equal_bytes(tmp_path: Path):
    for name in ("a", "b"):
        write_video(tmp_path / f"{name}.mp4", frames(12))
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()
    write_video(tmp_path / "c.mp4", frames(12, start=1))
    assert (tmp_path / "a.mp4").read_bytes() != (tmp_path / "c.mp4").read_bytes()


def test_joined_videos_show_one_after_the_other(tmp_path: Path):
    parts = []
    for k, (count, start) in enumerate(((20, 0), (13, 7), (4, 2))):
        parts.append(tmp_path / f"{k}.mp4")
        write_video(parts[-1], frames(count, start=start))
    join_videos(tmp_path / "all.mp4", parts)
    got, wanted = decoded(tmp_path / "all.mp4"), [f for part in parts for f in decoded(part)]
    assert len(got) == 37
    assert all((a == b).all() for a, b in zip(got, wanted, strict=True))
    with av.open(str(tmp_path / "all.mp4")) as container:
        times = sorted(float(p.pts * p.time_base) for p in container.demux(video=0) if p.pts is not None)
    np.testing.assert_allclose(times, np.arange(37) / FPS, atol=1e-4)


def test_videos_of_different_sizes_are_not_joined(tmp_path: Path):
    write_video(tmp_path / "a.mp4", frames(2))
    write_video(tmp_path / "b.mp4", frames(2, size=(64, 64)))
    with pytest.raises(InputError, match="64 x 64"):
        join_videos(tmp_path / "c.mp4", [tmp_path / "a.mp4", tmp_path / "b.mp4"])
    assert not (tmp_path / "c.mp4").exists()
    with pytest.raises(InputError, match="no video to join"):
        join_videos(tmp_path / "c.mp4", [])


def test_what_cannot_be_a_video_is_refused_and_leaves_the_old_one(tmp_path: Path):
    path = tmp_path / "a.mp4"
    path.write_bytes(b"old")
    with pytest.raises(InputError, match="at least one frame"):
        write_video(path, [])
    with pytest.raises(ShapeError, match="even sides"):
        write_video(path, [np.zeros((31, 40, 3), np.uint8)])
    with pytest.raises(ShapeError, match="frame 1 has shape"):
        write_video(path, [np.zeros((32, 40, 3), np.uint8), np.zeros((32, 42, 3), np.uint8)])
    with pytest.raises(InputError, match=r"\.mp4"):
        write_video(tmp_path / "a.avi", frames(2))
    assert path.read_bytes() == b"old"


def test_an_animation_moves_and_loops():
    data = animation(list(frames(6)), fps=8, size=(64, 48))
    picture = Image.open(io.BytesIO(data))
    assert (picture.format, picture.size, picture.n_frames, picture.info["loop"]) == ("WEBP", (64, 48), 6, 0)
    shown = []
    for k in range(6):
        picture.seek(k)
        shown.append(np.asarray(picture.convert("RGB"), int))
    wanted = np.asarray(Image.fromarray(list(frames(6))[5]).resize((64, 48)), int)
    assert np.abs(shown[5] - wanted).mean() < 6.0 < np.abs(shown[0] - wanted).mean()
