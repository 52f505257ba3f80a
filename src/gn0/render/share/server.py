"""The process that owns the device and draws for all others on this machine.

Started as `python -m gn0.render.share.server` by `gn0.render.share.server_process`. Requests of
all connections wait in one queue; as many as fit are drawn in one call, views of one scene side by
side. A request is drawn whole or answered with an error, and no picture depends on what else was
in its batch. When stdin ends the starter is gone, and so is this process.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import logging
import mmap
import os
import queue
import secrets
import socket
import struct
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.device.device import DeviceArray
from gn0.errors import DeviceError, DeviceMemoryError, Gn0Error, RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.jobs.child import open_channel
from gn0.jobs.worker import find_function
from gn0.render.encoding import MapPicture
from gn0.render.instance import Instance, check_parts
from gn0.render.open import open_renderer
from gn0.render.renderer import Pictures, Renderer
from gn0.render.share.files import FileMaker, Files
from gn0.render.share.handing import Batch, Handing, Piece
from gn0.render.share.messages import (
    WHO_OUTPUTS,
    Area,
    Draw,
    Drawn,
    DrawnBy,
    Floor,
    Inbox,
    Note,
    Ready,
    Refused,
    Tally,
    Who,
    lay_files,
    open_socket,
)
from gn0.render.share.parts import Cloud, Player
from gn0.render.share.request import Connection, Poser, Request
from gn0.render.who import WhoPictures

BATCH = 256  # views a call
SWITCH = 0.0005  # s that a thread may keep the interpreter
_TALLY_EVERY = 2.0  # s
_log = logging.getLogger(__name__)
Loader = Callable[[dict[str, Any]], GaussianCloud]


class Server:
    """Draws what connections ask for.

    Args:
        batch: what draws.
        load: turns the `source` of a request into splats.
        views: at most so many a call; halved when the device has too little memory.
        note: told what people should hear, once.
        poser: poses people, who are then not sent as splats; None: nobody does.
    """

    def __init__(
        self,
        batch: Renderer,
        load: Loader,
        views: int = BATCH,
        note: Callable[[str], None] = _log.warning,
        poser: Poser | None = None,
    ) -> None:
        self._batch, self._load, self._views, self._note = batch, load, views, note
        self._poser = poser
        self._known: set[str] = set()
        self._limited: dict[str, str] = {}  # floor whose visible sets a scene has
        self._loading: dict[str, Future[Any]] = {}
        self._lock = threading.Lock()
        self._numbers = itertools.count(1)  # of connections
        self._waiting: queue.SimpleQueue[Request] = queue.SimpleQueue()
        self._held: Request | None = None  # did not fit into the last batch
        self._said = False
        self._handing = Handing()
        device = batch.traits.device
        self._files = None if device is None else FileMaker(device)
        self._drawn_by = DrawnBy(
            batch.traits.drawn_by,
            batch.traits.labels,
            poses=poser is not None,
            tells=hasattr(batch, "render_who"),
        )
        self.tally = Tally()

    @property
    def encodes(self) -> bool:
        """Whether it makes files."""
        return self._files is not None

    def listen(self, listener: socket.socket) -> None:
        """Accept connections for ever; each has a thread that reads it."""
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            if not is_ours(connection):
                connection.close()
                continue
            asks = Connection(connection, number=next(self._numbers))
            threading.Thread(target=self.hear, args=(asks,), daemon=True).start()

    def hear(self, connection: Connection) -> None:
        """Read a connection to its end."""
        inbox = Inbox(connection.socket)
        decoder = msgspec.msgpack.Decoder(Area | Cloud | Draw | Floor | MapPicture | Player | Who)
        floor: Floor | None = None
        shown: MapPicture | None = None
        try:
            while (message := inbox.next(decoder)) is not None:
                if isinstance(message, Area):
                    connection.take_area(message, inbox.descriptors.pop(0))
                elif isinstance(message, Cloud):
                    self._take_part(connection, message, inbox.descriptors.pop(0))
                elif isinstance(message, Floor):
                    floor = message
                elif isinstance(message, MapPicture):
                    shown = message
                elif isinstance(message, Player):
                    connection.players[message.number] = message.source
                    if self._poser is not None:  # what is wrong is said when it is drawn
                        with contextlib.suppress(Gn0Error):
                            self._poser.prepare(message.source)
                elif isinstance(message, Who):
                    connection.send(self._drawn_by)
                else:
                    self._load_ahead(message)
                    wanted = floor if message.visible else None
                    self._waiting.put(Request(connection, message, wanted, shown))
        except (Gn0Error, OSError, ValueError, IndexError) as error:
            _log.warning("a connection ends: %s", error)
        finally:
            connection.closed = True
            connection.socket.close()

    def _take_part(self, connection: Connection, cloud: Cloud, descriptor: int) -> None:
        """Keep the splats of a moving part, in place of those sent under its name before."""
        try:
            if os.fstat(descriptor).st_size < max(cloud.size, 1):
                raise DeviceError("an area is smaller than said", where="drawing socket")
            with mmap.mmap(descriptor, max(cloud.size, 1)) as area:
                found = cloud.read(np.frombuffer(bytes(area), np.uint8))
            connection.parts[cloud.name] = found  # nothing of it is being drawn: it waits for us
        finally:
            os.close(descriptor)

    def _load_ahead(self, draw: Draw) -> None:
        """Make a scene that is not there ready in this thread, while others are drawn."""
        if self._batch.holds(draw.key):
            return
        with self._lock:
            loading = self._loading.get(draw.key)
            mine = loading is None and not self._batch.holds(draw.key)
            if mine:
                loading = self._loading[draw.key] = Future()
        if loading is None:
            return
        if not mine:
            loading.exception()  # waits for the one who reads them
            return
        try:
            loading.set_result(self._read(draw))
        except Gn0Error as error:
            loading.set_exception(error)

    def _read(self, draw: Draw) -> Any:
        try:
            return self._batch.prepare(self._load(draw.source))
        except Gn0Error:
            raise
        except Exception as error:  # whatever a file does to its reader
            raise RenderError(
                f"a scene cannot be read: {type(error).__name__}: {error}", where=str(draw.source)
            ) from None

    def _take_cloud(self, draw: Draw) -> Any:
        """The splats of a scene: read ahead, or now where they gave way since somebody looked."""
        with self._lock:
            loading = self._loading.get(draw.key)
        return self._read(draw) if loading is None else loading.result()

    def _forget_read(self, group: Sequence[Request]) -> None:
        """Let go of what was read ahead: by now it is on the device, or of no use."""
        with self._lock:
            for request in group:
                self._loading.pop(request.draw.key, None)

    def serve(self, told: Callable[[Tally], None] = lambda tally: None) -> None:
        """Draw for ever; `told` hears now and then what was done.

        Raises:
            DeviceError: the device is lost; those who wait have been told.
        """
        last = time.monotonic()
        while True:
            self.serve_once()
            if time.monotonic() - last > _TALLY_EVERY:
                last = time.monotonic()
                told(self.tally)

    def serve_once(self) -> None:
        """Wait for requests, and draw those that fit into one batch.

        Raises:
            DeviceError: the device is lost; those who wait have been told.
        """
        begin = time.perf_counter()
        taken = [self._held or self._waiting.get()]
        self._held = None
        self._count(waiting=time.perf_counter() - begin)
        count = taken[0].draw.count
        while count < self._views:
            try:
                request = self._waiting.get_nowait()
            except queue.Empty:
                break
            if count + request.draw.count > self._views:
                self._held = request
                break
            taken.append(request)
            count += request.draw.count
        groups: dict[Any, list[Request]] = {}
        floors: dict[str, list[str]] = {}  # a scene has the sets of one floor at a time
        for request in taken:
            turn = 0
            if request.floor is not None:
                known = floors.setdefault(request.draw.key, [])
                if request.floor.name not in known:
                    known.append(request.floor.name)
                turn = known.index(request.floor.name)
            groups.setdefault((*request.alike, turn), []).append(request)
        for group in groups.values():
            group.sort(key=lambda request: request.draw.key)
            for some in self._cut(group):
                self._serve_group(some)

    def _cut(self, group: list[Request]) -> Iterator[list[Request]]:
        """Runs of requests whose posed people fit into one call together."""
        begin, clouds = 0, 0
        for end, request in enumerate(group):
            own = 0 if request.draw.parts is None else len(request.draw.parts.posed)
            if end > begin and self._poser is not None and clouds + own > self._poser.at_once:
                yield group[begin:end]
                begin, clouds = end, 0
            clouds += own
        yield group[begin:]

    def _serve_group(self, group: list[Request]) -> None:
        good = []
        for request in group:
            try:
                self._check(request)
                good.append(request)
            except Gn0Error as error:
                request.fail(error)
        if not good:
            return
        try:
            self._draw(good)
        except DeviceMemoryError as error:
            self._shrink(good, error)
        except DeviceError as error:  # nothing that follows would work
            for request in good:
                request.fail(error)
            raise
        except Gn0Error as error:
            if len(good) == 1:
                good[0].fail(error)
                self._forget_read(good)
                return
            for request in good:  # find the one at fault
                self._serve_group([request])
            return
        self._forget_read(good)

    def _shrink(self, group: list[Request], error: DeviceMemoryError) -> None:
        """Go on with smaller batches; give up on a single view only."""
        count = sum(request.draw.count for request in group)
        if min(count, self._views) == 1:
            for request in group:
                request.fail(error)
            return
        self._views = max(min(count, self._views) // 2, 1)
        if not self._said:
            self._said = True
            self._note(f"too little device memory: {self._views} views a call or fewer from now on")
        for request in group:  # `_draw` cuts each into pieces of the new size
            self._serve_group([request])

    def _check(self, request: Request) -> None:
        draw = request.draw
        area = request.connection.areas.get(draw.area)
        needed = lay_files(draw)[2]
        if area is None or len(area) < needed or not draw.outputs or not draw.count:
            raise RenderError("a request without room for its pictures", where="drawing socket")
        if draw.visible and request.floor is None:
            raise RenderError("a request for visible sets without a floor", where="drawing socket")
        if draw.who and (draw.outputs != WHO_OUTPUTS or draw.encode is not None):
            raise RenderError("who is who is asked for without pictures", where="drawing socket")
        if draw.who and not self._drawn_by.tells:
            raise RenderError(
                f"renderer {self._batch.name!r} cannot tell who is who",
                remedy="use backend 'cpu' or 'cuda'",
            )
        dots = None if draw.encode is None else draw.encode.dots
        if dots is not None:
            if request.shown is None or len(dots.places) % 16 or not 0 <= dots.radius <= 100:
                raise RenderError("a request for dots without a map", where="drawing socket")
            _ = request.shown.pixels  # raises where they are none
        if draw.key not in self._known:
            self._batch.add(draw.key, lambda: self._take_cloud(draw))
            self._known.add(draw.key)
        if draw.parts is not None:
            for name in draw.parts.clouds:
                cloud = request.connection.parts.get(name)
                if cloud is None:
                    raise RenderError("a moving part that was not sent", where="drawing socket")
                self._batch.name_cloud(f"{request.connection.prefix}{name}", cloud)
            if draw.parts.posed and self._poser is None:
                raise RenderError("nobody poses people here", where="drawing socket")
            for source, _ in request.posed:
                assert self._poser is not None
                self._poser.prepare(source)
            names = [f"posed {n}" for n in range(len(draw.parts.posed))]
            rows = draw.parts.read(draw.count, posed=names)
            check_parts(rows, draw.count, [*draw.parts.clouds, *names])
        floor = request.floor
        if floor is not None and self._limited.get(draw.key) != floor.name:
            self._batch.limit_to_visible(draw.key, floor.cloud, floor.grid, floor.eye_height)
            self._limited[draw.key] = floor.name

    def _draw(self, group: list[Request]) -> None:
        """Draw requests that are alike; another thread puts the pictures into their areas."""
        first = group[0].draw
        views = np.concatenate(
            [np.frombuffer(r.draw.views, np.float64).reshape(-1, 4, 4) for r in group]
        )
        keys = [r.draw.key for r in group for _ in range(r.draw.count)]
        moving: list[tuple[Instance, ...]] = []
        if any(r.draw.parts is not None for r in group):
            wanted = [each for r in group for each in r.posed]
            posed = [] if self._poser is None or not wanted else self._poser.pose(wanted)
            for r in group:
                sent, count = r.draw.parts, r.draw.count
                if sent is None:
                    moving += [()] * count
                    continue
                own, posed = posed[: len(sent.posed)], posed[len(sent.posed) :]
                moving += sent.read(count, r.connection.prefix, own)
        if first.who:
            self._tell(group, views, keys, moving)
            return
        for begin in range(0, len(views), self._views):
            end = min(begin + self._views, len(views))
            self._handing.make_room()
            if not begin and self._files is not None:
                self._files.forget(group)
            start = time.perf_counter()
            pictures = self._batch.draw(
                first.camera,
                views[begin:end],
                keys[begin:end],
                outputs=first.outputs,
                background=first.background,
                visible=first.visible,
                millimetres=first.millimetres,
                parts=moving[begin:end],
            )
            pieces, at = [], 0
            for request in group:
                size = request.draw.count
                low, high = max(at, begin), min(at + size, end)
                if low < high:
                    rows = slice(low - begin, high - begin)
                    pieces.append(
                        Piece(request, rows, slice(low - at, high - at), at + size <= end)
                    )
                at += size
            middle = time.perf_counter()
            files = self._make_files(pictures, first, pieces)
            outputs = first.outputs
            if files is not None and first.encode is not None and not first.encode.pixels:
                outputs = tuple(output for output in outputs if output != "rgb")
            self._handing.take(Batch(pictures, outputs, pieces, files))
            self._count(
                views=end - begin,
                calls=1,
                drawing=middle - start,
                encoding=time.perf_counter() - middle,
            )

    def _tell(
        self,
        group: list[Request],
        views: NDArray[np.float64],
        keys: list[str],
        moving: list[tuple[Instance, ...]],
    ) -> None:
        """Tell who is who in requests that are alike; measures and truth, so nothing flies."""
        tell: Callable[..., WhoPictures] = self._batch.render_who  # type: ignore[attr-defined]
        camera, visible = group[0].draw.camera, group[0].draw.visible
        numbers, seen, calls = [], [], 0
        start = time.perf_counter()
        for begin in range(0, len(views), self._views):
            some = slice(begin, begin + self._views)
            parts = moving[some] or [()] * len(views[some])
            found = tell(camera, views[some], keys[some], parts=parts, visible=visible)
            numbers.append(found.numbers)
            seen += found.seen
            calls += 1
        whole, at = np.concatenate(numbers), 0
        for request in group:
            rows = slice(at, at + request.draw.count)
            np.copyto(request.targets()[WHO_OUTPUTS[0]], whole[rows])
            told = tuple(map(tuple, seen[rows]))
            request.connection.send(Drawn(request.draw.number, seen=told))
            at = rows.stop
        self._count(views=len(views), calls=calls, drawing=time.perf_counter() - start)

    def _make_files(self, pictures: Pictures, draw: Draw, pieces: list[Piece]) -> Files | None:
        """Files of a batch, where they are wanted and its pictures are on a device."""
        rgb, encode = pictures.rgb, draw.encode
        if encode is None or self._files is None or not isinstance(rgb, DeviceArray):
            return None
        owners = [(piece.request, piece.rows, piece.last) for piece in pieces]
        depth = pictures.depth if draw.millimetres else None
        return self._files.make(rgb, encode, owners, depth)

    def _count(self, **more: float) -> None:
        more["copying"] = self._handing.seconds - self.tally.copying
        self.tally = msgspec.structs.replace(
            self.tally, **{name: getattr(self.tally, name) + value for name, value in more.items()}
        )


def is_ours(connection: socket.socket) -> bool:
    """Whether the other end belongs to the same user, as far as the system can tell."""
    if not hasattr(socket, "SO_PEERCRED"):
        return True  # the socket's folder is ours alone
    size = struct.calcsize("3i")
    data = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, size)
    _, user, _ = struct.unpack("3i", data)
    return bool(user == os.getuid())


def open_listener() -> tuple[socket.socket, str]:
    """A socket that listens, and its address for `connect_address`."""
    listener = open_socket()
    if sys.platform.startswith("linux"):  # abstract: leaves nothing behind, however we end
        address = f"@gn0-draw-{secrets.token_hex(8)}"
    else:
        address = str(Path(tempfile.mkdtemp(prefix="gn0-draw-")) / "socket")
    listener.bind(address.replace("@", "\0", 1) if address.startswith("@") else address)
    listener.listen(1024)
    return listener, address


def main() -> int:
    """Open the device, say where we listen, and draw until the starter is gone."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--backend", required=True)
    parser.add_argument("--load", required=True)
    parser.add_argument("--pose", default="")
    parser.add_argument("--batch", type=int, default=BATCH)
    args = parser.parse_args()
    _, send = open_channel()
    sys.setswitchinterval(SWITCH)  # else a thread that copies makes the one that draws wait

    def say(message: msgspec.Struct) -> None:
        with contextlib.suppress(OSError, ValueError):
            send(msgspec.json.encode(message))

    try:
        batch = open_renderer(args.backend)
        device = batch.traits.device
        card = "CPU" if device is None else device.name
        load: Any = find_function(args.load)
        pose: Any = find_function(args.pose) if args.pose else None
        poser = None if pose is None else pose(batch)
        listener, address = open_listener()
    except Gn0Error as error:
        say(Refused(error.code, error.what, error.where, error.remedy))
        return 1
    except Exception as error:  # whatever a driver does
        say(Refused(DeviceError.code, f"{type(error).__name__}: {error}"))
        return 1
    server = Server(batch, load, args.batch, lambda text: say(Note(text)), poser)
    threading.Thread(target=server.listen, args=(listener,), daemon=True).start()
    say(Ready(address, args.backend, card, encodes=server.encodes))
    try:
        server.serve(say)
    except DeviceError as error:
        _log.error("the device is lost: %s", error)
        sys.stderr.flush()
        os._exit(1)  # a driver in that state may not let us go otherwise
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
