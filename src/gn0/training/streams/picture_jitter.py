"""Another colour and another light for pictures of a camera; never another side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gn0.errors import ConfigError
from gn0.geometry import F32, F64, U8

DRAWS = 6  # random numbers of a jitter
LUMA = (0.299, 0.587, 0.114)  # ITU-R BT.601


@dataclass(frozen=True)
class PictureJitter:
    """How far pictures may differ; 0 leaves a property alone.

    Attributes:
        exposure: brighter or darker by at most so many stops, before clipping.
        contrast: away from or towards mid grey by at most this share.
        saturation: away from or towards grey by at most this share.
        balance: each channel by at most this share.
    """

    exposure: float = 0.4
    contrast: float = 0.15
    saturation: float = 0.2
    balance: float = 0.06

    def __post_init__(self) -> None:
        shares = (self.contrast, self.saturation, self.balance)
        if not (0 <= self.exposure <= 4 and all(0 <= share < 1 for share in shares)):
            raise ConfigError(
                f"jitter of {self.exposure} stops and shares {shares}",
                where="jitter",
                remedy="give 0 to 4 stops, and shares of 0 to less than 1",
            )

    def solve(self, draws: F64) -> tuple[F32, F32]:
        """A matrix [B, 3, 3] and an offset [B] for the channels of each of B pictures.

        Channel gains, then saturation, then contrast about mid grey; and half, to round.
        """
        away = 2.0 * draws - 1.0
        contrast, saturation = 1 + self.contrast * away[:, 1], 1 + self.saturation * away[:, 2]
        gains = 2.0 ** (self.exposure * away[:, :1]) * (1 + self.balance * away[:, 3:6])
        colour = saturation[:, None, None]
        mixed = colour * np.eye(3) + (1 - colour) * np.array(LUMA)[None]
        matrix = contrast[:, None, None] * mixed * gains[:, None]
        return matrix.astype(np.float32), (127.5 * (1 - contrast) + 0.5).astype(np.float32)

    def apply(self, picture: U8, draws: F64) -> U8:
        """The picture [H, W, 3] as `draws` [6] in [0, 1) have it; 0.5 of all changes nothing."""
        (matrix,), (offset,) = self.solve(draws[None])
        red, green, blue = (picture[..., k].astype(np.float32) for k in range(3))
        out = np.empty_like(picture)
        for k, (a, b, c) in enumerate(matrix):
            # written out: a matrix product may sum in another order elsewhere
            out[..., k] = np.clip(a * red + b * green + c * blue + offset, 0, 255)
        return out
