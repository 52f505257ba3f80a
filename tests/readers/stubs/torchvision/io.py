"""`VideoReader` as torchvision's PyAV backend has it: seeks to a key frame, then frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import av
import torch


class VideoReader:
    """Frames as uint8 [3, H, W] with their time in seconds."""

    def __init__(self, path: str, stream: str = "video") -> None:
        assert stream == "video"
        self.container = av.open(path)

    def seek(self, time_s: float, keyframes_only: bool = False) -> VideoReader:
        """Go to the key frame at or before a time."""
        self.container.seek(int(time_s * av.time_base), any_frame=False, backward=True)
        return self

    def __iter__(self) -> Iterator[dict[str, Any]]:
        for frame in self.container.decode(video=0):
            data = torch.from_numpy(frame.to_ndarray(format="rgb24")).permute(2, 0, 1)
            yield {"data": data, "pts": float(frame.pts * frame.time_base)}
