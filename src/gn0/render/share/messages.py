"""What those who want pictures and the process that draws them say to each other.

A message is four bytes of length (little endian) and MessagePack, checked against its type. It
goes over a Unix socket; pictures go through areas of shared memory that the asking side makes and
whose file descriptors travel with the message `Area`.
"""

from __future__ import annotations

import socket
import struct
from typing import Any, TypeVar

import msgspec

from gn0.errors import DeviceError
from gn0.render.camera import Camera
from gn0.render.renderer import Output

LIMIT = 2**26  # bytes of a message: 500,000 views
ALIGNMENT = 64  # bytes, of each output in an area
_LENGTH = struct.Struct("<I")
T = TypeVar("T")


class Area(msgspec.Struct, frozen=True, tag="area"):
    """Shared memory for pictures; its file descriptor comes along.

    Attributes:
        number: what `Draw` calls it.
        size: bytes.
    """

    number: int
    size: int


class Draw(msgspec.Struct, frozen=True, tag="draw"):
    """Draw views of one scene into an area.

    Attributes:
        number: of this request, for the answer.
        key: of the scene in its light; equal keys mean equal splats.
        source: how the splats are loaded: what the server's loader takes.
        camera: for all views.
        views: world to camera, float64 [V, 4, 4] as bytes.
        outputs: which pictures; they lie in the area in this order, see `lay_out`.
        background: colour behind everything, 0..1; None takes the renderer's own.
        area: where they go.
    """

    number: int
    key: str
    source: dict[str, Any]
    camera: Camera
    views: bytes
    outputs: tuple[Output, ...]
    background: tuple[float, float, float] | None
    area: int

    @property
    def count(self) -> int:
        """How many views."""
        return len(self.views) // 128


class Drawn(msgspec.Struct, frozen=True, tag="drawn"):
    """The pictures of a request are in its area."""

    number: int


class Failed(msgspec.Struct, frozen=True, tag="failed"):
    """A request came to nothing; the four parts of the error."""

    number: int
    code: str
    what: str
    where: str = ""
    remedy: str = ""


class Ready(msgspec.Struct, frozen=True, tag="ready"):
    """First line of the server to its starter: where it listens, what draws, on which card."""

    address: str
    backend: str
    card: str


class Refused(msgspec.Struct, frozen=True, tag="refused"):
    """The server cannot draw at all; the four parts of the error."""

    code: str
    what: str
    where: str = ""
    remedy: str = ""


class Note(msgspec.Struct, frozen=True, tag="note"):
    """Something that people should hear once."""

    text: str


class Tally(msgspec.Struct, frozen=True, kw_only=True, tag="tally"):
    """What the server has done so far.

    Attributes:
        views: drawn.
        calls: of the renderer.
        drawing, copying, waiting: seconds in the renderer, in copies to shared memory, and
            without anything to do.
    """

    views: int = 0
    calls: int = 0
    drawing: float = 0.0
    copying: float = 0.0
    waiting: float = 0.0


def lay_out(camera: Camera, outputs: tuple[Output, ...], count: int) -> tuple[list[int], int]:
    """Offset of each output's pictures in an area, and the bytes of all."""
    places, end = [], 0
    pixels = count * camera.width * camera.height
    for output in outputs:
        places.append(end)
        size = pixels * (3 if output == "rgb" else 4)
        end += -(-size // ALIGNMENT) * ALIGNMENT
    return places, end


def send_message(
    connection: socket.socket, message: msgspec.Struct, descriptors: list[int] | None = None
) -> None:
    """Send a message, whole.

    Raises:
        OSError: the other side is gone.
    """
    body = msgspec.msgpack.encode(message)
    data = _LENGTH.pack(len(body)) + body
    if descriptors:
        sent = socket.send_fds(connection, [data], descriptors)
        data = data[sent:]
    connection.sendall(data)


class Inbox:
    """Messages of one connection, as they come; file descriptors are kept in order."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._data = bytearray()
        self.descriptors: list[int] = []

    def next(self, decoder: msgspec.msgpack.Decoder[T]) -> T | None:
        """The next message; None when the other side is gone.

        Raises:
            DeviceError: what came is no message.
        """
        if not self._fill(_LENGTH.size):
            return None
        (length,) = _LENGTH.unpack_from(self._data)
        if length > LIMIT:
            raise DeviceError(f"a message of {length} bytes", where="drawing socket")
        if not self._fill(_LENGTH.size + length):
            return None
        body = bytes(self._data[_LENGTH.size : _LENGTH.size + length])
        del self._data[: _LENGTH.size + length]
        try:
            return decoder.decode(body)
        except msgspec.ValidationError as error:
            raise DeviceError(f"no message of ours: {error}", where="drawing socket") from None

    def _fill(self, size: int) -> bool:
        while len(self._data) < size:
            try:
                data, fds, _, _ = socket.recv_fds(self._connection, 1 << 16, 16)
            except OSError:
                return False
            self.descriptors += fds
            if not data:
                return False
            self._data += data
        return True
