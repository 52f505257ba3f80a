"""A connection to the drawing process: messages out, pictures back through shared memory."""

from __future__ import annotations

import mmap
import os
import tempfile
import weakref
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0 import errors
from gn0.errors import DeviceError, Gn0Error
from gn0.gaussians.cloud import GaussianCloud
from gn0.render.camera import Camera
from gn0.render.encoding import DrawnViews, Encode, MapPicture
from gn0.render.renderer import Colour, Output
from gn0.render.share.jpeg import join_files, read_tables
from gn0.render.share.messages import (
    WHO_OUTPUTS,
    Area,
    Draw,
    Drawn,
    DrawnBy,
    Failed,
    Floor,
    Inbox,
    Who,
    find_places,
    lay_files,
    open_socket,
    send_message,
)
from gn0.render.share.parts import Cloud, PartRows, Player
from gn0.render.who import WhoPictures

GOES_ON = "give the same command again: it goes on where it stopped"


class DrawConnection:
    """A connection to the drawing process; one request at a time, from one thread at a time.

    Args:
        address: as `DrawServer.address`.

    Raises:
        DeviceError: nobody listens there.
    """

    def __init__(self, address: str) -> None:
        self._socket = open_socket()
        try:
            self._socket.connect(address.replace("@", "\0", 1) if address[:1] == "@" else address)
        except OSError as error:
            self._socket.close()
            raise DeviceError(
                f"the drawing process cannot be reached: {error.strerror}",
                where=address,
                remedy=GOES_ON,
            ) from None
        weakref.finalize(self, self._socket.close)
        self._inbox = Inbox(self._socket)
        self._decoder = msgspec.msgpack.Decoder(Drawn | Failed | DrawnBy)
        self._area: NDArray[np.uint8] | None = None
        self._number = self._areas = 0
        self._floor = self._shown = ""  # that was sent last
        self._clouds: dict[str, str] = {}  # digest of what was sent last, by name
        self._players: dict[bytes, int] = {}

    @cached_property
    def drawn_by(self) -> DrawnBy:
        """Who draws, in a name that tells a card from its emulation, and what it can.

        Raises:
            DeviceError: the drawing process is gone.
        """
        answer = self._ask(Who())
        if not isinstance(answer, DrawnBy):
            raise DeviceError(f"unexpected answer: {type(answer).__name__}", where="drawing socket")
        return answer

    def close(self) -> None:
        """Let go of the socket; what was asked for is not answered any more."""
        self._socket.close()

    def draw(
        self,
        key: str,
        source: Mapping[str, Any],
        camera: Camera,
        views: NDArray[np.float64],
        outputs: tuple[Output, ...],
        background: Colour | None,
        encode: Encode | None = None,
        floor: Floor | None = None,
        *,
        millimetres: bool = False,
        shown: MapPicture | None = None,
        parts: PartRows | None = None,
    ) -> DrawnViews:
        """Pictures of views [V, 4, 4], and files of them: copies of one's own.

        `floor`: draw from the visible sets of this one. `millimetres`: depth as uint16, see
        `gn0.render.depth`. `shown`: the map that the dots of `encode` are on. `parts`: instances of
        clouds that were sent, by name.

        Raises:
            DeviceError: the device or the drawing process is lost.
            Gn0Error: what the process raised.
        """
        draw, area, answer = self._request(
            key, source, camera, views, outputs, background, parts, floor, shown,
            encode=encode, millimetres=millimetres,
        )  # fmt: skip
        _, coded, _ = lay_files(draw)
        spared = encode is not None and not encode.pixels
        if spared and not answer.files:
            return self.draw(  # nothing stands for the views: bring them after all
                key, source, camera, views, outputs, background, None, floor,
                millimetres=millimetres, parts=parts,
            )  # fmt: skip
        pictures = {
            name: array.copy()
            for name, array in find_places(draw, area).items()
            if name != "rgb" or not answer.files or not spared
        }
        if encode is None or not answer.files:
            return DrawnViews(pictures)
        sizes = answer.files + answer.mosaics + answer.maps
        starts = coded + np.concatenate([[0], np.cumsum(sizes)])
        count = len(answer.files)
        steps = count + len(answer.mosaics)
        head = read_tables(camera.width, camera.height, encode.quality).head
        files = join_files(head, area, starts[: count + 1])
        mosaics: list[bytes] = []
        if encode.tile is not None and answer.mosaics:
            rows = encode.cells // encode.columns
            width, height = encode.tile[0] * encode.columns, encode.tile[1] * rows
            head = read_tables(width, height, encode.quality).head
            mosaics = join_files(head, area, starts[count : steps + 1])
        maps: list[bytes] = []
        if shown is not None and answer.maps:
            head = read_tables(shown.shape[1], shown.shape[0], encode.quality).head
            maps = join_files(head, area, starts[steps:])
        hashes = [answer.digests[at : at + 16].hex() for at in range(0, len(answer.digests), 16)]
        last = len(hashes) - (0 if encode.dots is None else encode.dots.count)
        named = {
            "rgb": hashes[:count], "mosaics": hashes[count:steps], "depth": hashes[steps:last],
            "maps": hashes[last:],
        }  # fmt: skip
        return DrawnViews(pictures, files, mosaics, maps, named)

    def tell_who(
        self,
        key: str,
        source: Mapping[str, Any],
        camera: Camera,
        views: NDArray[np.float64],
        parts: PartRows | None,
        floor: Floor | None = None,
    ) -> WhoPictures:
        """Which of `parts` each pixel of views [V, 4, 4] shows; arguments as for `draw`.

        Raises:
            DeviceError: the device or the drawing process is lost.
            Gn0Error: what the process raised.
        """
        draw, area, answer = self._request(
            key, source, camera, views, WHO_OUTPUTS, None, parts, floor, who=True
        )
        numbers = find_places(draw, area)[WHO_OUTPUTS[0]].copy()
        return WhoPictures(numbers, list(map(list, answer.seen)))

    def _request(
        self,
        key: str,
        source: Mapping[str, Any],
        camera: Camera,
        views: NDArray[np.float64],
        outputs: tuple[Output, ...],
        background: Colour | None,
        parts: PartRows | None,
        floor: Floor | None,
        shown: MapPicture | None = None,
        **asked: Any,
    ) -> tuple[Draw, NDArray[np.uint8], Drawn]:
        """A request as it was sent, the room of its pictures, and the answer.

        `asked`: fields of `Draw` that only some requests have.

        Raises:
            DeviceError: the drawing process is lost, or answers something else.
            Gn0Error: what it answers.
        """
        self._number += 1
        draw = Draw(
            self._number, key, dict(source), camera, np.ascontiguousarray(views).tobytes(),
            outputs, background, self._areas, visible=floor is not None, parts=parts, **asked,
        )  # fmt: skip
        draw, area = self._prepare(draw, floor, shown)
        answer = self._ask(draw)
        if not isinstance(answer, Drawn) or (draw.who and len(answer.seen) != draw.count):
            raise DeviceError(f"unexpected answer: {type(answer).__name__}", where="drawing socket")
        return draw, area, answer

    def _prepare(
        self, draw: Draw, floor: Floor | None, shown: MapPicture | None
    ) -> tuple[Draw, NDArray[np.uint8]]:
        """A request with room for its pictures, after what it refers to was sent; and the room."""
        try:
            area = self._open_area(lay_files(draw)[2])
            if floor is not None and floor.name != self._floor:
                send_message(self._socket, floor)
                self._floor = floor.name
            if shown is not None and shown.name != self._shown:
                send_message(self._socket, shown)
                self._shown = shown.name
        except OSError:
            raise _lost() from None
        return msgspec.structs.replace(draw, area=self._areas), area

    def send_cloud(self, cloud: GaussianCloud, digest: str, name: str) -> None:
        """Bring a moving part's splats over, unless they are those sent last under that name.

        What the other process holds is bounded by the names, as those of `PosedBank` are.

        Raises:
            DeviceError: the drawing process is gone.
        """
        if self._clouds.get(name) == digest:
            return
        coefficients, normals = cloud.sh.shape[1], cloud.normal is not None
        labels = cloud.label is not None
        table = None if cloud.categories is None else cloud.categories.tobytes()
        message = Cloud(name, len(cloud), coefficients, normals, labels, table)
        descriptor = _open_memory()
        try:
            os.ftruncate(descriptor, max(message.size, 1))
            message.lay(cloud, np.frombuffer(mmap.mmap(descriptor, max(message.size, 1)), np.uint8))
            send_message(self._socket, message, [descriptor])
        except OSError:
            raise _lost() from None
        finally:
            os.close(descriptor)
        self._clouds[name] = digest

    def tell_player(self, source: Mapping[str, Any]) -> int:
        """The number of somebody whom the other process poses; it is told of them once.

        Raises:
            DeviceError: the drawing process is gone.
        """
        key = msgspec.json.encode(source)
        number = self._players.get(key)
        if number is None:
            number = len(self._players) + 1
            try:
                send_message(self._socket, Player(number, dict(source)))
            except OSError:
                raise _lost() from None
            self._players[key] = number
        return number

    def _ask(self, message: msgspec.Struct) -> Drawn | DrawnBy:
        """The answer to a message.

        Raises:
            DeviceError: the drawing process is gone.
            Gn0Error: what it answers.
        """
        try:
            send_message(self._socket, message)
        except OSError:
            raise _lost() from None
        answer = self._inbox.next(self._decoder)
        if answer is None:
            raise _lost()
        if isinstance(answer, Failed):
            raise error_of(answer.code, answer.what, answer.where, answer.remedy)
        return answer

    def _open_area(self, size: int) -> NDArray[np.uint8]:
        """Shared memory of at least so many bytes; grown when needed."""
        if self._area is None or len(self._area) < size:
            descriptor = _open_memory()
            try:
                os.ftruncate(descriptor, size)
                self._area = np.frombuffer(mmap.mmap(descriptor, size), np.uint8)
                self._areas += 1
                send_message(self._socket, Area(self._areas, size), [descriptor])
            finally:
                os.close(descriptor)
        return self._area


def _open_memory() -> int:
    """A file descriptor of memory without a name: it goes with those who hold it."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("gn0-pictures")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


def _lost() -> DeviceError:
    return DeviceError("the drawing process is gone", remedy=GOES_ON)


def error_of(code: str, what: str, where: str, remedy: str) -> Gn0Error:
    """An error that was raised in another process."""
    kinds = [k for k in vars(errors).values() if isinstance(k, type) and issubclass(k, Gn0Error)]
    kind = next((k for k in kinds if k.code == code), Gn0Error)
    return kind(what, where=where, remedy=remedy)
