"""AV1 videos of LeRobot datasets: encoded a walk at a time, joined without encoding again.

Each video is encoded by one thread with fixed settings: the same pictures are the same bytes. Two
missions of one path share a walk's clip; a picture that stands still, the map from above or the
goal, is encoded once and shown to all who see it.
"""

from __future__ import annotations

import io
import os
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any, cast

import numpy as np

from gn0.data.lerobot_schema import FPS, Film, PixelSums
from gn0.errors import RenderError
from gn0.geometry import U8
from gn0.jobs.priority import keep_priority

CODEC, PRESET = "libsvtav1", "12"
KEY_FRAMES, KEY_FRAMES_STILL = "2", "30"  # frames between pictures that stand alone


class VideoWriter:
    """Frames of one size as an AV1 video in memory.

    Args:
        size: (width, height) [px].
        crf: constant rate factor, 0 (best) to 63.
        fps: frames a second.
        key_frames: frames between pictures that stand alone.

    Raises:
        RenderError: this PyAV was built without AV1.
    """

    def __init__(
        self, size: tuple[int, int], crf: int, fps: int = FPS, key_frames: str = KEY_FRAMES
    ) -> None:
        os.environ.setdefault("SVT_LOG", "1")  # errors only
        import av

        self._stream = io.BytesIO()
        self._fps = fps
        options = {"crf": str(crf), "preset": PRESET, "g": key_frames, "svtav1-params": "lp=1"}
        try:
            self._container = av.open(self._stream, "w", format="mp4")
            added = self._container.add_stream(CODEC, rate=fps, options=options)
        except (av.codec.codec.UnknownCodecError, ValueError) as error:
            raise RenderError(
                f"cannot encode AV1: {error}", remedy="install PyAV from PyPI, or use webdataset"
            ) from None
        self._video = cast(av.VideoStream, added)
        self._video.width, self._video.height = size
        self._video.pix_fmt = "yuv420p"
        self._video.thread_count = 1
        with keep_priority():
            self._video.codec_context.open()
        self._count = 0

    def add(self, rgb: U8) -> None:
        """The next frame [H, W, 3]."""
        import av

        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(rgb), format="rgb24")
        frame.pts, frame.time_base = self._count, Fraction(1, self._fps)
        self._container.mux(self._video.encode(frame))
        self._count += 1

    def finish(self) -> bytes:
        """The video's bytes."""
        if self._count:
            self._container.mux(self._video.encode())
        self._container.close()
        return self._stream.getvalue()


class WalkWriter:
    """The moving pictures of one walk: a clip a video, and their statistics.

    Args:
        film: sizes and frames a second.
        names: which of its videos.
        crf: constant rate factor.
    """

    def __init__(self, film: Film, names: Sequence[str], crf: int) -> None:
        self._clips = {name: VideoWriter(film.sizes[name], crf, film.fps) for name in names}
        self.sums = {name: PixelSums() for name in names}

    def add(self, pictures: Mapping[str, U8]) -> None:
        """The pictures [H, W, 3] of the next step."""
        for name, clip in self._clips.items():
            clip.add(pictures[name])
            self.sums[name].add(pictures[name])

    def finish(self) -> dict[str, bytes]:
        """The clips by name."""
        return {name: clip.finish() for name, clip in self._clips.items()}


def encode_still(picture: U8, frames: int, film: Film, crf: int) -> bytes:
    """A clip that shows one picture [H, W, 3] for so many frames."""
    height, width = picture.shape[:2]
    clip = VideoWriter((width, height), crf, film.fps, KEY_FRAMES_STILL)
    for _ in range(frames):
        clip.add(picture)
    return clip.finish()


def join_clips(clips: Sequence[bytes], fps: int, take: Sequence[int] | None = None) -> bytes:
    """One MP4 of clips one after another; packets are copied, times run on without a gap.

    Args:
        clips: MP4 files of one size and codec.
        fps: frames a second of all of them.
        take: frames to take of each; all by default.
    """
    import av

    stream, done = io.BytesIO(), 0
    ticks = fps  # a second, as FFmpeg takes them for a stream that it encodes: enough, and whole
    while ticks < 10_000:
        ticks *= 2
    options = {"video_track_timescale": str(ticks)}
    with av.open(stream, "w", format="mp4", options=options) as out:
        target: Any = None
        for number, data in enumerate(clips):
            with av.open(io.BytesIO(data), "r") as clip:
                source = clip.streams.video[0]
                if target is None:
                    # opaque: the packets are copied, so no encoder of that name is needed
                    target = out.add_stream_from_template(source, opaque=True)
                taken = 0
                for packet in clip.demux(source):
                    if packet.dts is None or (take is not None and taken >= take[number]):
                        continue
                    packet.stream = target
                    packet.time_base = Fraction(1, fps)
                    packet.pts = packet.dts = done + taken
                    packet.duration = 1
                    out.mux(packet)
                    taken += 1
                done += taken
    return stream.getvalue()
