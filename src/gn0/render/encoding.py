"""Files of pictures, made where they are drawn: what was requested, and what was made."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.errors import FormatError
from gn0.storage import content_hash


class MapPicture(msgspec.Struct, frozen=True, tag="map"):
    """The bare occupancy picture of a scene: of the draws that follow and want dots on it.

    Attributes:
        name: equal names mean equal pixels.
        grey: of its pixels, uint8 [H, W] as bytes.
        shape: H, W.
    """

    name: str
    grey: bytes
    shape: tuple[int, int]

    @classmethod
    def of_pixels(cls, grey: NDArray[np.uint8]) -> MapPicture:
        """The map with these pixels [H, W]."""
        height, width = grey.shape
        return cls(content_hash(grey), grey.tobytes(), (height, width))

    @property
    def pixels(self) -> NDArray[np.uint8]:
        """Its pixels [H, W].

        Raises:
            FormatError: they are of another size than said.
        """
        if min(self.shape) < 1 or len(self.grey) != self.shape[0] * self.shape[1]:
            raise FormatError(
                "a map picture whose size differs from what was announced", field="grey"
            )
        return np.frombuffer(self.grey, np.uint8).reshape(self.shape)


class Dots(msgspec.Struct, frozen=True):
    """Occupancy pictures that are wanted: the last `MapPicture` with start and agent.

    Attributes:
        places: row and column of the start, then of the agent, of each picture
            int32 [P, 2, 2] as bytes.
        radius: radius of both discs [px].
        encode: make files of them; else their digests alone.
    """

    places: bytes
    radius: int
    encode: bool

    @property
    def count(self) -> int:
        """How many pictures."""
        return len(self.places) // 16


class Encode(msgspec.Struct, frozen=True):
    """Make JPEG files of the views of a request too, and of the history at each step.

    Attributes:
        quality: 1 to 100.
        room: bytes of the area, behind the pictures, that files may take.
        tile: width and height [px] that a view has in the history mosaic; None makes no mosaics.
        cells: tiles of a mosaic, in rows of `columns`: the views before a step, newest first.
        columns: columns of a mosaic.
        steps: number of each step's view int32 [T] as bytes; a mosaic a step.
        begin: forget the views of earlier requests: a new walk begins.
        dots: occupancy pictures that are wanted, too.
        pixels: whether views are wanted as they are, too; else files and digests stand for them,
            and their place in the area is left alone. Without files it is as well.
    """

    quality: int
    room: int
    tile: tuple[int, int] | None = None
    cells: int = 16
    columns: int = 4
    steps: bytes = b""
    begin: bool = True
    dots: Dots | None = None
    pixels: bool = True


@dataclass(frozen=True, eq=False)
class DrawnViews:
    """What came of a request.

    Attributes:
        pictures: by output, and "tiles" uint8 [V, h, w, 3] where mosaics were wanted; without
            "rgb" where files stand for it.
        files: JPEG file of each view; empty where the server made none.
        mosaics: JPEG file of each step's mosaic; empty where the server made none.
        maps: JPEG file of each occupancy picture; empty where the server made none.
        hashes: `content_hash` of each view ("rgb"), mosaic ("mosaics"), depth in millimetres
            ("depth") and occupancy picture ("maps"); without a name, or empty, where the server
            made none.
    """

    pictures: dict[str, NDArray[Any]]
    files: list[bytes] = field(default_factory=list)
    mosaics: list[bytes] = field(default_factory=list)
    maps: list[bytes] = field(default_factory=list)
    hashes: dict[str, list[str]] = field(default_factory=dict)
