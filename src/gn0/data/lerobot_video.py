"""Videos of LeRobot datasets: encoded one walk at a time, joined without encoding again.

Two missions of one path share a walk's clip; a picture that stands still, the map from above or the
goal, is encoded once and shown to all who see it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gn0.data.lerobot_schema import Film, PixelSums
from gn0.geometry import U8
from gn0.render.video import AV1_STILL, VideoWriter, encode_video


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
    return encode_video([picture] * frames, crf, film.fps, AV1_STILL)
