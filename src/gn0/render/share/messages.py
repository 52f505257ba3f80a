"""Messages between the drawing process and those who ask it for pictures.

A message is four bytes of length (little endian) and MessagePack, checked against its type. It
goes over a Unix socket; pictures go through areas of shared memory that the asking side makes and
whose file descriptors travel with the message `Area`.
"""

from __future__ import annotations

import socket
import struct
from typing import Any, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.errors import DeviceError, FormatError
from gn0.maps.grid import OccupancyGrid
from gn0.render.camera import Camera
from gn0.render.encoding import Encode
from gn0.render.renderer import LABELS, Output
from gn0.render.share.parts import PartRows
from gn0.render.who import SeenInstance
from gn0.storage import content_hash

LIMIT = 2**26  # bytes of a message: 500,000 views
WHO_OUTPUTS: tuple[Output, ...] = ("instance",)  # numbers lie where labels would
ALIGNMENT = 64  # bytes, of each output in an area
_LENGTH = struct.Struct("<I")
T = TypeVar("T")


def open_socket() -> socket.socket:
    """A Unix socket, not connected.

    Raises:
        DeviceError: this system (Windows) has none that Python can use.
    """
    if not hasattr(socket, "AF_UNIX"):
        raise DeviceError(
            "one drawing process for many needs Unix sockets, which this system lacks",
            remedy="use --backend cpu, or Linux (WSL)",
        )
    return socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)


class Area(msgspec.Struct, frozen=True, tag="area"):
    """Shared memory for pictures; its file descriptor comes along.

    Attributes:
        number: what `Draw` calls it.
        size: bytes.
    """

    number: int
    size: int


class Floor(msgspec.Struct, frozen=True, tag="floor"):
    """Where eyes can be in a scene, for its visible sets: of the draws that follow and want them.

    Attributes:
        name: equal names mean equal sets.
        cloud: content hash of the scene's splats; light does not matter.
        cells: of the map that is inflated for the agent, uint8 [H, W] as bytes.
        shape: H, W.
        resolution: cell size [m].
        origin: (x, y) [m] of the outer corner of cell (0, 0).
        eye_height: eye height of the cameras [m].
    """

    name: str
    cloud: str
    cells: bytes
    shape: tuple[int, int]
    resolution: float
    origin: tuple[float, float]
    eye_height: float

    @classmethod
    def of_grid(cls, cloud: str, grid: OccupancyGrid, eye_height: float) -> Floor:
        """The floor of a map that is inflated for the agent."""
        name = content_hash(cloud, grid.content_hash, float(eye_height))
        cells = grid.cells.tobytes()
        x, y = map(float, grid.origin)
        return cls(
            name, cloud, cells, grid.shape, float(grid.resolution), (x, y), float(eye_height)
        )

    @property
    def grid(self) -> OccupancyGrid:
        """The map.

        Raises:
            FormatError: it is not one.
        """
        if len(self.cells) != self.shape[0] * self.shape[1]:
            raise FormatError("a map whose size differs from what was announced", field="cells")
        cells = np.frombuffer(self.cells, np.uint8).reshape(self.shape)
        return OccupancyGrid(cells, self.resolution, self.origin)


class Draw(msgspec.Struct, frozen=True, tag="draw"):
    """Draw views of one scene into an area.

    Attributes:
        number: number of this request, for the answer.
        key: key of the scene in its light; equal keys mean equal splats.
        source: how the splats are loaded: what the server's loader takes.
        camera: for all views.
        views: world to camera, float64 [V, 4, 4] as bytes.
        outputs: which pictures; they lie in the area in this order, see `lay_out`.
        background: colour behind everything, 0..1; None takes the renderer's own.
        area: where they go.
        encode: files that are wanted as well.
        visible: draw from the visible sets of the `Floor` that was sent last.
        millimetres: depth as uint16, see `gn0.render.depth`.
        parts: instances of clouds that were sent before, or that are posed over there.
        who: which of `parts` each pixel shows, in place of `WHO_OUTPUTS`, and nothing else.
    """

    number: int
    key: str
    source: dict[str, Any]
    camera: Camera
    views: bytes
    outputs: tuple[Output, ...]
    background: tuple[float, float, float] | None
    area: int
    encode: Encode | None = None
    visible: bool = False
    millimetres: bool = False
    parts: PartRows | None = None
    who: bool = False

    @property
    def count(self) -> int:
        """How many views."""
        return len(self.views) // 128


class Who(msgspec.Struct, frozen=True, tag="who"):
    """Ask who draws."""


class DrawnBy(msgspec.Struct, frozen=True, tag="drawn by"):
    """Who draws: equal names, equal pictures; "cuda on host" is the emulation.

    `labels` says whether it draws "semantic" and "instance", `poses` whether it poses people,
    `tells` whether it tells who is who.
    """

    name: str
    labels: bool = False
    poses: bool = False
    tells: bool = False


class Drawn(msgspec.Struct, frozen=True, tag="drawn"):
    """The pictures of a request are in its area.

    Attributes:
        number: number of the request.
        files: bytes of each view's JPEG file without what all have in common; they follow each
            other behind the pictures. Empty where none were wanted, or they had no room.
        mosaics: one entry per step's mosaic; they follow the files.
        maps: of each occupancy picture; they follow the mosaics.
        digests: 16 bytes each, of the raw pixels: of the views, of the mosaics, of the views'
            depth in millimetres where it is drawn, and of the occupancy pictures. Empty without
            files.
        seen: of each view, how its instances show, where `Draw.who` asked.
    """

    number: int
    files: tuple[int, ...] = ()
    mosaics: tuple[int, ...] = ()
    maps: tuple[int, ...] = ()
    digests: bytes = b""
    seen: tuple[tuple[SeenInstance, ...], ...] = ()


class Failed(msgspec.Struct, frozen=True, tag="failed"):
    """A request came to nothing; the four parts of the error."""

    number: int
    code: str
    what: str
    where: str = ""
    remedy: str = ""


class Ready(msgspec.Struct, frozen=True, tag="ready"):
    """First line of the server to its starter: where it listens, what draws, on which card.

    `encodes` says whether it makes JPEG files.
    """

    address: str
    backend: str
    card: str
    encodes: bool = False


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
        drawing, encoding, copying, waiting: seconds in the renderer, in making files, in copies
            to shared memory (beside the others), and without anything to do.
    """

    views: int = 0
    calls: int = 0
    drawing: float = 0.0
    encoding: float = 0.0
    copying: float = 0.0
    waiting: float = 0.0


def lay_out(
    camera: Camera, outputs: tuple[Output, ...], count: int, *, millimetres: bool = False
) -> tuple[list[int], int]:
    """Offset of each output's pictures in an area, and the bytes of all.

    `millimetres`: depth takes two bytes a pixel. Tiles of the history [V, h, w, 3], where they are
    wanted, follow; then files.
    """
    places, end = [], 0
    pixels = count * camera.width * camera.height
    for output in outputs:
        places.append(end)
        size = pixels * (3 if output == "rgb" else 2 if output == "depth" and millimetres else 4)
        end += -(-size // ALIGNMENT) * ALIGNMENT
    return places, end


def lay_files(draw: Draw) -> tuple[int, int, int]:
    """Offset of the tiles and of the files of a request in its area, and the bytes of all."""
    end = lay_out(draw.camera, draw.outputs, draw.count, millimetres=draw.millimetres)[1]
    wish = draw.encode
    if wish is None:
        return end, end, end
    tiles = end
    if wish.tile is not None:
        end += -(-draw.count * wish.tile[0] * wish.tile[1] * 3 // ALIGNMENT) * ALIGNMENT
    return tiles, end, end + wish.room


def find_places(draw: Draw, area: NDArray[np.uint8]) -> dict[str, NDArray[Any]]:
    """Where in an area the pictures of a request are, by output: uint8 or float32 [V, H, W, …].

    Depth in millimetres is uint16, labels are uint32. With mosaics also "tiles" uint8 [V, h, w, 3].
    """
    places, _ = lay_out(draw.camera, draw.outputs, draw.count, millimetres=draw.millimetres)
    shape = (draw.count, draw.camera.height, draw.camera.width)
    pixels = draw.count * draw.camera.height * draw.camera.width
    found: dict[str, NDArray[Any]] = {}
    for name, place in zip(draw.outputs, places, strict=True):
        if name == "rgb":
            found[name] = area[place : place + pixels * 3].reshape(*shape, 3)
        elif name == "depth" and draw.millimetres:
            found[name] = area[place : place + pixels * 2].view(np.uint16).reshape(shape)
        else:
            kind = np.uint32 if name in LABELS else np.float32
            found[name] = area[place : place + pixels * 4].view(kind).reshape(shape)
    if draw.encode is not None and draw.encode.tile is not None:
        width, height = draw.encode.tile
        tiles = area[lay_files(draw)[0] :][: draw.count * height * width * 3]
        found["tiles"] = tiles.reshape(draw.count, height, width, 3)
    return found


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
            raise DeviceError(f"unexpected message: {error}", where="drawing socket") from None

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
