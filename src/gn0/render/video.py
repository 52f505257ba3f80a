"""Pictures as a video in memory: AV1 for datasets, VP9 for what a browser plays.

Each video is encoded by one thread with fixed settings: the same pictures are the same bytes.
"""

from __future__ import annotations

import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, cast

import numpy as np

from gn0.errors import RenderError
from gn0.geometry import U8
from gn0.jobs.priority import keep_priority


@dataclass(frozen=True)
class VideoCodec:
    """An encoder and its fixed settings.

    Attributes:
        name: for people.
        encoder: FFmpeg's name of it.
        options: options of the encoder, beside its quality.
        instead: what to do where PyAV was built without it.
    """

    name: str
    encoder: str
    options: Mapping[str, str]
    instead: str


AV1 = VideoCodec(
    "AV1",
    "libsvtav1",
    {"preset": "12", "g": "2", "svtav1-params": "lp=1"},  # every other picture stands alone
    "install PyAV from PyPI, or use webdataset",
)
AV1_STILL = VideoCodec("AV1", AV1.encoder, {**AV1.options, "g": "30"}, AV1.instead)
VP9 = VideoCodec(  # a stock Chromium or Firefox plays it without proprietary codecs
    "VP9",
    "libvpx-vp9",
    {"b": "0", "deadline": "realtime", "cpu-used": "7", "row-mt": "0"},
    "install PyAV from PyPI, which brings libvpx",
)


class VideoWriter:
    """Frames of one size as an MP4 video in memory.

    Args:
        size: (width, height) [px], both even.
        crf: constant rate factor, 0 (best) to 63.
        fps: frames a second.
        codec: how they are encoded.

    Raises:
        RenderError: this PyAV was built without the codec.
    """

    def __init__(
        self, size: tuple[int, int], crf: int, fps: int | Fraction, codec: VideoCodec = AV1
    ) -> None:
        os.environ.setdefault("SVT_LOG", "1")  # errors only
        import av

        self._stream = io.BytesIO()
        self._fps = fps
        options = {"crf": str(crf), **codec.options}
        self._size = size
        try:
            self._container = av.open(self._stream, "w", format="mp4")
            added = self._container.add_stream(codec.encoder, rate=fps, options=options)
            self._video = cast(av.VideoStream, added)
            self._video.width, self._video.height = size
            self._video.pix_fmt = "yuv420p"
            self._video.thread_count = 1
            with keep_priority():
                self._video.codec_context.open()
        except (av.codec.codec.UnknownCodecError, ValueError) as error:
            raise RenderError(
                f"cannot encode {codec.name}: {error}", remedy=codec.instead
            ) from None
        self._count = 0

    def add(self, rgb: U8) -> None:
        """The next frame [H, W, 3].

        Raises:
            RenderError: it is of another size.
        """
        import av

        if rgb.shape != (*self._size[::-1], 3):
            raise RenderError(
                f"a picture of {rgb.shape[1]}×{rgb.shape[0]} px in a video of "
                f"{self._size[0]}×{self._size[1]} px",
                remedy="give all pictures one size",
            )
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(rgb), format="rgb24")
        frame.pts, frame.time_base = self._count, 1 / Fraction(self._fps)
        self._container.mux(self._video.encode(frame))
        self._count += 1

    def finish(self) -> bytes:
        """The video's bytes."""
        if self._count:
            self._container.mux(self._video.encode())
        self._container.close()
        return self._stream.getvalue()


def encode_video(
    frames: Sequence[U8], crf: int, fps: int | Fraction, codec: VideoCodec = AV1
) -> bytes:
    """All of `frames` [H, W, 3] as one video: see `VideoWriter`."""
    height, width = frames[0].shape[:2]
    video = VideoWriter((width, height), crf, fps, codec)
    for picture in frames:
        video.add(picture)
    return video.finish()


def join_videos(
    clips: Sequence[bytes], fps: int | Fraction, take: Sequence[int] | None = None
) -> bytes:
    """One MP4 of clips one after another; packets are copied, times run on without a gap.

    Args:
        clips: MP4 files of one size and codec.
        fps: frames a second of all of them.
        take: frames to take of each; all by default.
    """
    import av

    stream, done = io.BytesIO(), 0
    # a second, as FFmpeg takes them for a stream that it encodes: enough, and whole
    ticks = Fraction(fps).numerator
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
                    packet.time_base = 1 / Fraction(fps)
                    packet.pts = packet.dts = done + taken
                    packet.duration = 1
                    out.mux(packet)
                    taken += 1
                done += taken
    return stream.getvalue()
