"""Videos of exports: VP9 in MP4, cut and joined without encoding again.

Frames are encoded without looking ahead, so the first k packets of a clip are the clip of its first
k frames: a model that is shown "all frames so far" gets a file for each step, and each frame is
encoded once. Joined clips keep their packets too.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from gn0.errors import FormatError, RenderError, StorageError
from gn0.geometry import U8
from gn0.render.video import VP9, VideoWriter, join_videos

QUALITY = 30  # crf
# a picture that stands alone every 10 frames: seeks stay short
VP9_CUT = dataclasses.replace(
    VP9, options={**VP9.options, "lag-in-frames": "0", "auto-alt-ref": "0", "g": "10"}
)


@dataclass(frozen=True, eq=False)
class Clip:
    """An encoded clip: packets that can be cut short and joined.

    Attributes:
        mp4: the whole of it.
        frames: how many.
        fps: frames a second.
    """

    mp4: bytes
    frames: int
    fps: int


def encode_frames(frames: Iterable[U8], fps: int) -> Clip:
    """Encode pictures [H, W, 3] of one even size; the same pixels give the same bytes.

    Raises:
        RenderError: this PyAV was built without VP9, or the pictures are of changing size.
    """
    video, count = None, 0
    for picture in frames:
        height, width = picture.shape[:2]
        if video is None:
            video = VideoWriter((width, height), QUALITY, fps, VP9_CUT)
        video.add(picture)
        count += 1
    if video is None:
        raise RenderError("a clip without frames")
    return Clip(video.finish(), count, fps)


def cut_clip(clip: Clip, frames: int) -> bytes:
    """The MP4 of a clip's first frames: its first packets, as they are."""
    if frames >= clip.frames:
        return clip.mp4
    return join_videos([clip.mp4], clip.fps, [frames])


@dataclass(frozen=True)
class ClipFacts:
    """What a video file holds: frames, frames a second, size [px], codec name."""

    frames: int
    fps: float
    width: int
    height: int
    codec: str


def read_clip(path: Path | str, first: int = 0, count: int | None = None) -> list[U8]:
    """Decoded frames [H, W, 3] of a video, in order.

    Raises:
        StorageError, FormatError: missing, or not a whole video.
    """
    import av

    found: list[U8] = []
    with _reading(path) as container:
        try:
            for number, frame in enumerate(container.decode(video=0)):
                if count is not None and number >= first + count:
                    break
                if number >= first:
                    found.append(np.asarray(frame.to_ndarray(format="rgb24"), np.uint8))
        except (av.error.FFmpegError, ValueError) as error:
            raise FormatError(f"cannot decode: {error}", file=path) from None
    return found


def inspect_clip(path: Path | str) -> ClipFacts:
    """What a video holds, every packet counted and its times checked.

    Raises:
        StorageError, FormatError: missing, not a whole video, or frames at uneven times.
    """
    import av

    with _reading(path) as container:
        try:
            stream = container.streams.video[0]
            fps = float(stream.average_rate or 0)
            times = sorted(
                float(p.pts * p.time_base)
                for p in container.demux(stream)
                if p.pts is not None and p.size and p.time_base is not None
            )
            facts = ClipFacts(
                len(times), fps, stream.width, stream.height, stream.codec_context.name
            )
        except (av.error.FFmpegError, ValueError, IndexError) as error:
            raise FormatError(f"not a whole video: {error}", file=path) from None
    wanted = np.arange(len(times)) / max(fps, 1e-9)
    if fps <= 0 or not np.allclose(times, wanted, rtol=0, atol=1e-4):
        raise FormatError(
            "frames are not evenly spaced from 0", file=path, remedy="export it again"
        )
    return facts


def _reading(path: Path | str) -> Any:
    import av

    if not Path(path).is_file():
        raise StorageError("the video is missing", where=path, remedy="export it again")
    try:
        return cast(Any, av.open(str(path)))
    except (av.error.FFmpegError, OSError, ValueError) as error:
        raise FormatError(f"not a video: {error}", file=path, remedy="export it again") from None
