"""Who asks the drawing process, and for what."""

from __future__ import annotations

import contextlib
import mmap
import os
import socket
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.errors import DeviceError, Gn0Error, RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.render.encoding import MapPicture
from gn0.render.share.messages import Area, Draw, Failed, Floor, find_places, send_message


class Poser(Protocol):
    """Poses people for the one that draws: `gn0.people.poser.PeoplePoser`.

    Attributes:
        at_once: how many clouds fit into a call.
    """

    at_once: int

    def prepare(self, source: Mapping[str, Any]) -> None:
        """Get somebody ready to be posed, in any thread; raises where nobody is to be found."""

    def pose(
        self, wanted: Sequence[tuple[Mapping[str, Any], tuple[str | int | float, ...]]]
    ) -> list[str]:
        """Names of clouds for one call of the renderer; of the thread that draws."""
        ...


@dataclass(eq=False)
class Connection:
    """One that asks: its socket, the area, the moving parts and the people it has told of.

    `number` is its own, `closed` whether it is gone.
    """

    socket: socket.socket
    areas: dict[int, NDArray[np.uint8]] = field(default_factory=dict)
    sending: threading.Lock = field(default_factory=threading.Lock)
    closed: bool = False
    parts: dict[str, GaussianCloud] = field(default_factory=dict)
    number: int = 0
    players: dict[int, dict[str, Any]] = field(default_factory=dict)

    @property
    def prefix(self) -> str:
        """How names of its parts begin where they are drawn."""
        return f"{self.number}/"

    def send(self, message: msgspec.Struct) -> None:
        """Tell it something; one that is gone is not missed."""
        with self.sending, contextlib.suppress(OSError):
            send_message(self.socket, message)

    def take_area(self, area: Area, descriptor: int) -> None:
        """Map an area into this process.

        Raises:
            DeviceError: it is smaller than said.
        """
        try:
            if os.fstat(descriptor).st_size < area.size:
                raise DeviceError("an area is smaller than said", where="drawing socket")
            mapped = mmap.mmap(descriptor, area.size)
        finally:
            os.close(descriptor)
        self.areas = {area.number: np.frombuffer(mapped, np.uint8)}  # the last one grew


@dataclass(frozen=True, eq=False)
class Request:
    """A `Draw` and who asked for it; with the floor whose visible sets it wants, if any.

    `shown`: the map that its dots are on.
    """

    connection: Connection
    draw: Draw
    floor: Floor | None = None
    shown: MapPicture | None = None

    @property
    def posed(self) -> list[tuple[dict[str, Any], tuple[str | int | float, ...]]]:
        """Who is to be posed, and how, in the order of `PartRows.posed`.

        Raises:
            RenderError: somebody of whom the connection has not told.
        """
        players = self.connection.players
        wanted = () if self.draw.parts is None else self.draw.parts.posed
        if any(each.player not in players for each in wanted):
            raise RenderError("a person of whom nobody told", where="drawing socket")
        return [(players[each.player], each.how) for each in wanted]

    @property
    def alike(self) -> tuple[Any, ...]:
        """What must be equal for one call of the renderer."""
        draw, wish = self.draw, self.draw.encode
        files = None
        if wish is not None:
            files = wish.quality, wish.tile, wish.cells, wish.columns, wish.pixels
        visible = self.floor is not None
        camera = msgspec.json.encode(draw.camera)
        return camera, draw.outputs, draw.background, files, visible, draw.millimetres, draw.who

    def fail(self, error: Gn0Error) -> None:
        """Tell who asked what went wrong."""
        number = self.draw.number
        self.connection.send(Failed(number, error.code, error.what, error.where, error.remedy))

    def targets(self) -> dict[str, NDArray[Any]]:
        """The arrays in its area that the pictures go to; see `find_places`."""
        return find_places(self.draw, self.connection.areas[self.draw.area])
