"""Who is who in a picture: which instance each pixel shows, and how much of each is seen.

An instance goes by its place in a view's sequence of instances, from 1; 0 is all else. As for
labels, a pixel shows what has the greatest sum of blending weights there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SHOWN = 0.5  # opacity from which on a pixel belongs to what is drawn alone


@dataclass(frozen=True)
class SeenInstance:
    """How an instance shows in a picture.

    Attributes:
        number: its place among the view's instances, from 1.
        pixels: pixels that show it.
        whole: pixels that it would have if nothing stood before it.
        share: how much of it is seen, 0..1; 0 where it would have no pixel.
        box: (left, top, right, bottom) of the pixels that show it [px], right and bottom beyond
            the last; None if none does.
    """

    number: int
    pixels: int
    whole: int
    share: float
    box: tuple[int, int, int, int] | None


@dataclass(frozen=True, eq=False)
class WhoPictures:
    """Who is who in V views.

    Attributes:
        numbers: uint32 [V, H, W], number of the instance that each pixel shows; 0 none.
        seen: for each view, its instances in their order.
    """

    numbers: NDArray[np.uint32]
    seen: list[list[SeenInstance]]


def judge_seen(
    numbers: NDArray[np.uint32], alone: Sequence[NDArray[np.floating]]
) -> list[SeenInstance]:
    """What is seen of the instances of one view.

    Args:
        numbers: number of the instance that each pixel shows [H, W].
        alone: opacity [H, W] of each instance drawn without anything else.
    """
    found = []
    for number, opacity in enumerate(alone, start=1):
        mine = numbers == number
        whole = opacity >= SHOWN
        both, total = int((mine & whole).sum()), int(whole.sum())
        box = None
        if mine.any():
            rows, columns = np.flatnonzero(mine.any(axis=1)), np.flatnonzero(mine.any(axis=0))
            box = (int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1)
        share = both / total if total else 0.0
        found.append(SeenInstance(number, int(mine.sum()), total, share, box))
    return found
