"""Sizes that the drawing kernels are compiled for."""

from __future__ import annotations

from dataclasses import dataclass, fields

from gn0.errors import ConfigError
from gn0.render.camera import Camera
from gn0.render.cuda.tables import TILE


@dataclass(frozen=True)
class Tuning:
    """What may be tried on a card. No value changes a byte of the pictures.

    Attributes:
        pixels: pixels a lane blends, side by side in a row: 1, 2 or 4. More of them share the
            loads of a splat.
        region_width, region_height: of the part of a tile whose lanes walk one list [px].
        capacity: entries that a tile sorts at a time.
        buckets: of that sort, a power of two.
        stage: splats projected into shared memory at a time.
        early: whether the splats of the next stage are fetched while one is blended; then a thread
            stages one.
        blocks: raster blocks a multiprocessor that registers must leave room for.
        cover_blocks: the same for the kernels that list splats.
        views: that a block of the listing kernels projects its chunks for.
        chunks: of such a block, at most.
        spread: listing blocks that there should be before one takes several chunks.
        large: tiles of a footprint's box above which they are dealt out among the lanes of a warp,
            and listed only where its ellipse reaches.
        puts: tiles that a lane lists into before it waits for its places.
        group: whether lanes that list into one tile share an atomic operation.
        predicate: whether colours are added under a predicate, in assembly, instead of times zero.
    """

    pixels: int = 2
    region_width: int = 8
    region_height: int = 4
    capacity: int = 512
    buckets: int = 512
    stage: int = 128
    early: bool = False
    blocks: int = 8
    cover_blocks: int = 4
    views: int = 32
    chunks: int = 8
    spread: int = 8192
    large: int = 6
    puts: int = 2
    group: bool = True
    predicate: bool = True

    def __post_init__(self) -> None:
        sound = (
            self.pixels in (1, 2, 4)
            and self.region_width in (4, 8, 16)
            and self.region_height in (2, 4, 8, 16)
            and self.pixels <= self.team <= 32
            and self.buckets & (self.buckets - 1) == 0
            and self.buckets % self.threads == 0
            and self.stage % 32 == 0
            and self.stage <= 1024
            and self.capacity % self.threads == 0
            and self.threads <= self.capacity <= 2**15
            and self.capacity & (self.capacity - 1) == 0
            and 0 < self.views <= 32
            and 0 < self.chunks <= 32
            and self.spread > 0
            and 0 < self.puts <= 4
            and (not self.early or self.stage == self.threads)
            and self.threads <= min(self.buckets, 1024)
        )
        if not sound:
            raise ConfigError(f"the kernels cannot be built for {self}")

    @property
    def team(self) -> int:
        """Lanes that walk one list."""
        return self.region_width * self.region_height // self.pixels

    @property
    def threads(self) -> int:
        """Threads of a raster block."""
        return 256 // self.pixels

    @property
    def shares(self) -> tuple[int, int, int]:
        """Views and most chunks of a listing block, and how many blocks there should be."""
        return self.views, self.chunks, self.spread

    @property
    def defines(self) -> tuple[tuple[str, int], ...]:
        """Macros of the kernels."""
        return tuple((f.name.upper(), int(getattr(self, f.name))) for f in fields(self))


MANY = Tuning()
FEW = Tuning(pixels=1, region_width=4, stage=256, early=True, blocks=3)
_MANY_TILES = 4500  # fewer do not fill a large card: the longest list decides


def choose_tuning(camera: Camera, views: int) -> Tuning:
    """Sizes for a call: more threads a tile where it has few of them."""
    tiles = -(-camera.width // TILE) * -(-camera.height // TILE) * views
    return MANY if tiles > _MANY_TILES else FEW
