"""`StreamJittered`: other colours and another light for a stream's pictures, on its device."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gn0.errors import FormatError
from gn0.seeds import derive_seed
from gn0.sim.sensors import MapFrame
from gn0.training.streams.picture_jitter import DRAWS, PictureJitter
from gn0.training.streams.sample_reader import CAMERA
from gn0.training.streams.samples import LabelledStates, Stream, find_frames
from gn0.training.streams.step_ring import PicturesLazy

_EACH = 8  # numbers a sample: whole blocks of Philox, so that any sample's can be begun with


class StreamJittered:
    """The states of another stream; what a camera sees is jittered, a black picture stays black.

    A sample's jitter follows from the seed and the sample's number alone, and is one for all its
    pictures. The bytes are those of `PictureJitter.apply`.

    Args:
        stream: whose states; this one's alone.
        jitter: how far.
        seed: of the draws.
    """

    def __init__(self, stream: Stream, jitter: PictureJitter, seed: int) -> None:
        self.stream, self.jitter, self.drawn = stream, jitter, 0
        self._key = derive_seed(seed, "jitter")

    @property
    def texts(self) -> tuple[str, ...]:
        """Instructions by episode number."""
        return self.stream.texts

    @property
    def frames(self) -> tuple[MapFrame, ...]:
        """The whole map of each episode, by number."""
        return find_frames(self.stream)

    def draw(self, count: int) -> LabelledStates:
        """The next states."""
        states = self.stream.draw(count)
        bits = np.random.Philox(key=self._key, counter=self.drawn * (_EACH // 4))
        draws = np.random.Generator(bits).random((count, _EACH))[:, :DRAWS]
        self.drawn += count
        matrices, offsets = self.jitter.solve(draws)
        seen = states.pictures

        def look(name: str) -> Tensor:
            return jitter_pictures(seen[name], matrices, offsets) if name in CAMERA else seen[name]

        pictures = PicturesLazy({name: partial(look, name) for name in seen})
        if not isinstance(seen, PicturesLazy):
            return replace(states, pictures=dict(pictures))
        return replace(states, pictures=pictures)

    def state(self) -> dict[str, Any]:
        """Where it stands, as JSON: what `restore` takes."""
        return {"drawn": self.drawn, "stream": self.stream.state()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from there: the same states follow.

        Raises:
            FormatError: it is no state of ours.
        """
        drawn = state.get("drawn")
        if not isinstance(drawn, int) or drawn < 0 or "stream" not in state:
            raise FormatError(f"drawn is {drawn!r}", where="stream")
        self.stream.restore(state["stream"])
        self.drawn = drawn


def jitter_pictures(pictures: Tensor, matrices: np.ndarray, offsets: np.ndarray) -> Tensor:
    """Pictures uint8 [B, H, W, 3] by `PictureJitter.solve`'s [B, 3, 3] and [B]; waits for nothing.

    Channels are summed by hand: a matrix product may sum in another order elsewhere.
    """
    device = pictures.device
    mixed = torch.from_numpy(matrices).to(device, non_blocking=True)[:, :, :, None, None]
    added = torch.from_numpy(offsets).to(device, non_blocking=True)[:, None, None]
    red, green, blue = (pictures[..., k].float() for k in range(3))
    out = torch.empty_like(pictures)
    for k in range(3):
        a, b, c = mixed[:, k].unbind(1)
        out[..., k] = (a * red + b * green + c * blue + added).clamp(0, 255)
    seen = pictures.flatten(1).any(1)
    return out * seen[:, None, None, None]
