"""Sizes that the drawing kernels are compiled for."""

from __future__ import annotations

from dataclasses import dataclass, fields

from gn0.errors import ConfigError
from gn0.render.camera import Camera
from gn0.render.cuda.tables import TILE

_OF_HOST = ("sample", "spread")


@dataclass(frozen=True)
class Tuning:
    """What may be tried on a card. No value changes a byte of the pictures.

    Attributes:
        threads: of a raster block; 128 have two pixels each, what more there are sort and stage.
        capacity: entries that a tile sorts at a time.
        buckets: of that sort, a power of two.
        stage: splats projected into shared memory at a time.
        turns: of blending between two votes whether to go on.
        split: tiles with the longest lists, of which four blocks draw a quarter each where lists
            have equal room.
        blocks: raster blocks a multiprocessor that registers must leave room for.
        cover_blocks: the same for the kernels that list splats.
        sample: one splat of so many is counted where there are many lists: 1, 2 or 4.
        views: that a block of the listing kernels projects its chunks for.
        chunks: of such a block, at most.
        spread: listing blocks that there should be before one takes several chunks.
        large: tiles of a footprint's box above which they are dealt out among the lanes of a warp,
            and listed only where its ellipse reaches.
        puts: tiles that a lane lists into before it waits for its places.
        group: whether lanes that list into one tile share an atomic operation.
        predicate: whether colours are added under a predicate, in assembly, instead of times zero.
    """

    threads: int = 128
    capacity: int = 512
    buckets: int = 512
    stage: int = 256
    turns: int = 4
    split: int = 0
    blocks: int = 7
    cover_blocks: int = 4
    sample: int = 4
    views: int = 32
    chunks: int = 8
    spread: int = 8192
    large: int = 6
    puts: int = 2
    group: bool = True
    predicate: bool = True

    def __post_init__(self) -> None:
        sound = (
            self.buckets & (self.buckets - 1) == 0
            and self.buckets % self.threads == 0
            and self.stage % 32 == 0
            and self.threads % 32 == 0
            and self.stage <= 1024
            and self.capacity % self.threads == 0
            and self.threads <= self.capacity <= 2**15
            and self.capacity & (self.capacity - 1) == 0
            and self.sample in (1, 2, 4)
            and 0 < self.views <= 32
            and 0 < self.chunks <= 32
            and self.spread > 0
            and 0 < self.puts <= 4
            and 0 < self.turns <= 8
            and self.split >= 0
            and 128 <= self.threads <= min(self.buckets, 1024)
        )
        if not sound:
            raise ConfigError(f"the kernels cannot be built for {self}")

    @property
    def shares(self) -> tuple[int, int, int]:
        """Views and most chunks of a listing block, and how many blocks there should be."""
        return self.views, self.chunks, self.spread

    @property
    def defines(self) -> tuple[tuple[str, int], ...]:
        """Macros of the kernels: not what the host alone asks, or each value had its own code."""
        own = {f.name: int(getattr(self, f.name)) for f in fields(self)}
        own |= {"split": int(self.split > 0)}
        return tuple((name.upper(), own[name]) for name in own if name not in _OF_HOST)


MANY = Tuning()
FEW = Tuning(threads=256, blocks=4, split=128)
_MANY_TILES = 2400  # fewer do not fill a large card: the longest list decides


def choose_tuning(camera: Camera, views: int) -> Tuning:
    """Sizes for a call: more threads a tile where it has few of them."""
    tiles = -(-camera.width // TILE) * -(-camera.height // TILE) * views
    return MANY if tiles > _MANY_TILES else FEW
