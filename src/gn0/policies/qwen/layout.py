"""Where text and pictures of a prompt lie, and their rotary positions: the same for every sample.

A prompt of fixed shape is computed without padding, masks or loops over samples; what changes from
sample to sample are ids and pictures, never places.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.errors import CheckpointError
from gn0.policies.qwen.architecture import Architecture

I64 = NDArray[np.int64]


@dataclass(frozen=True)
class PictureSize:
    """A picture's width and height [px] in a prompt."""

    width: int
    height: int


@dataclass(frozen=True)
class PromptLayout:
    """Places and positions of a prompt.

    Attributes:
        ids: int64 [P]; of pictures' tokens, the id that stands for them.
        positions: int64 [3, P], time, height and width (`Qwen3VLModel.get_rope_index`).
        places: of each picture, its first token and how many there are.
        sizes: pixels of each picture.
        next: position of the first token behind the prompt.
    """

    ids: I64
    positions: I64
    places: tuple[tuple[int, int], ...]
    sizes: tuple[PictureSize, ...]
    next: int

    def __len__(self) -> int:
        return self.ids.size

    def positions_behind(self, count: int) -> I64:
        """Positions int64 [3, count] of the first tokens of an answer."""
        return np.broadcast_to(np.arange(self.next, self.next + count), (3, count))


def build_layout(architecture: Architecture, parts: Sequence[int | PictureSize]) -> PromptLayout:
    """Lay out a prompt of tokens and pictures, in order.

    Tokens that begin and end a picture are tokens like others and must be among `parts`.

    Raises:
        CheckpointError: a picture's sides are no multiples of a token's, or an id is outside the
            vocabulary.
    """
    ids: list[int] = []
    positions: list[I64] = []
    places, sizes, now = [], [], 0
    side = architecture.vision.token
    for part in parts:
        if isinstance(part, PictureSize):
            rows, columns = part.height // side, part.width // side
            if min(part.width, part.height) < side or part.width % side or part.height % side:
                what = f"a picture of {part.width}×{part.height} px is not a multiple of {side} px"
                raise CheckpointError(what, remedy="choose sides that are")
            row, column = np.divmod(np.arange(rows * columns), columns)
            positions.append(np.stack([np.full(row.size, now), now + row, now + column]))
            places.append((len(ids), rows * columns))
            sizes.append(part)
            ids += [architecture.image] * (rows * columns)
            now += max(rows, columns)
        elif not 0 <= part < architecture.text.vocabulary:
            raise CheckpointError(f"token {part} lies outside the vocabulary")
        else:
            positions.append(np.full((3, 1), now))
            ids.append(part)
            now += 1
    where = np.concatenate(positions, 1) if positions else np.empty((3, 0), np.int64)
    return PromptLayout(np.array(ids, np.int64), where, tuple(places), tuple(sizes), now)
