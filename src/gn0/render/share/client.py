"""Ask the drawing process for pictures: a `Renderer` that holds no splats, and its starter."""

from __future__ import annotations

import contextlib
import mmap
import os
import queue
import sys
import tempfile
import weakref
from collections import ChainMap, OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0 import errors
from gn0.errors import ConfigError, DeviceError, Gn0Error, RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.jobs.process import Ended, WorkerProcess
from gn0.maps.grid import OccupancyGrid
from gn0.render.camera import Camera
from gn0.render.encoding import DrawnViews, Encode, MapPicture
from gn0.render.instance import Parts, check_named, check_parts, digest_part
from gn0.render.open import name_drawing, visible_backend
from gn0.render.renderer import (
    ALL_OUTPUTS,
    ALONE,
    LABELS,
    OUTPUTS,
    VISIBLE_OF,
    Colour,
    DrawnScene,
    Output,
    RenderResult,
    Traits,
    VisibleScene,
    check_outputs,
    check_views,
)
from gn0.render.share.jpeg import join_files, read_tables
from gn0.render.share.messages import (
    Area,
    Draw,
    Drawn,
    DrawnBy,
    Failed,
    Floor,
    Inbox,
    Note,
    Ready,
    Refused,
    Tally,
    Who,
    find_places,
    lay_files,
    open_socket,
    send_message,
)
from gn0.render.share.parts import Cloud, PartRows, Player, Posed

VIEWS = 32  # of a request at most: one area holds their pictures
START_LIMIT = 120.0  # s: the first start compiles kernels
POSES = 4096  # names of posed people that are known at a time
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
        self._number += 1
        draw = Draw(
            self._number, key, dict(source), camera, np.ascontiguousarray(views).tobytes(),
            outputs, background, self._areas, encode, floor is not None, millimetres, parts,
        )  # fmt: skip
        _, coded, size = lay_files(draw)
        try:
            area = self._open_area(size)
            draw = msgspec.structs.replace(draw, area=self._areas)
            if floor is not None and floor.name != self._floor:
                send_message(self._socket, floor)
                self._floor = floor.name
            if shown is not None and shown.name != self._shown:
                send_message(self._socket, shown)
                self._shown = shown.name
        except OSError:
            raise _lost() from None
        answer = self._ask(draw)
        if not isinstance(answer, Drawn):
            raise DeviceError(f"unexpected answer: {type(answer).__name__}", where="drawing socket")
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


class RendererShared:
    """A `Renderer` whose pictures are drawn by another process; it holds no splats itself.

    Args:
        connection: to that process; of one thread.
        name: name of the backend that draws.

    Attributes:
        traits: what the other process can do.

    Raises:
        DeviceError: the drawing process is gone.
    """

    def __init__(self, connection: DrawConnection, name: str) -> None:
        self.name = name
        self._connection = connection
        self._sources: dict[str, dict[str, Any]] = {}
        self._floors: dict[str, Floor] = {}
        self._parts: dict[str, tuple[GaussianCloud, str]] = {}
        self._posed: OrderedDict[str, Posed] = OrderedDict()

    @property
    def poses(self) -> bool:
        """Whether the drawing process poses people itself.

        Raises:
            DeviceError: it is gone.
        """
        return self._connection.drawn_by.poses

    @property
    def _known(self) -> Mapping[str, object]:
        """By the names of clouds that instances may have."""
        return ChainMap[str, object](self._posed, self._parts)  # type: ignore[arg-type]

    @cached_property
    def traits(self) -> Traits:
        """What the drawing process is and can do.

        Raises:
            DeviceError: it is gone.
        """
        encodes = name_drawing(self.name) != "cpu"
        drawn_by = self._connection.drawn_by
        return Traits(
            drawn_by.name,
            visible_sets=name_drawing(self.name) in VISIBLE_OF,
            encoder=partial(SceneEncoder, self) if encodes else None,
            labels=drawn_by.labels,
        )

    def add_source(self, key: str, source: Mapping[str, Any]) -> DrawnScene:
        """Name a scene by how the other process loads its splats; equal keys mean equal splats."""
        if self._sources.get(key) != source:
            self._sources[key] = dict(source)
            self._floors.pop(key, None)
        return DrawnScene(self, key)

    def name_cloud(self, name: str, cloud: GaussianCloud) -> None:
        """Make a cloud known by a name; see `Renderer.name_cloud`. It is sent when first drawn.

        Raises:
            RenderError: the name or the cloud cannot be a part's.
        """
        known = self._parts.get(name)
        if known is None or known[0] is not cloud:
            check_named(name, cloud)
            self._parts[name] = (cloud, digest_part(cloud))

    def name_posed(self, source: Mapping[str, Any], how: tuple[str | int | float, ...]) -> str:
        """A name for instances of somebody in a pose, of whom no splats are sent.

        The latest `POSES` names are known.

        Args:
            source: who, and where the drawing process finds it, as its poser takes it.
            how: the pose, likewise.

        Raises:
            DeviceError: the drawing process is gone.
        """
        posed = Posed(self._connection.tell_player(source), how)
        name = f"posed {posed.player} {' '.join(map(str, how))}"
        self._posed[name] = posed
        self._posed.move_to_end(name)
        while len(self._posed) > POSES:
            self._posed.popitem(last=False)
        return name

    def add(self, key: str, load: Callable[[], Any], digest: str = "") -> None:
        """Name a scene by its splats.

        Raises:
            ConfigError: always: splats do not travel, see `add_source`.
        """
        raise ConfigError(
            "splats are not sent to the drawing process",
            remedy="say how it loads them: add_source(key, source)",
        )

    def keep(self, key: str, cloud: GaussianCloud, digest: str = "") -> None:
        """As `add`.

        Raises:
            ConfigError: always, see `add`.
        """
        self.add(key, lambda: cloud, digest)

    def remove(self, key: str) -> None:
        """Forget a scene here; the other process lets go of it as others need the room."""
        self._sources.pop(key, None)
        self._floors.pop(key, None)

    def holds(self, key: str) -> bool:
        """Whether a scene can be asked for."""
        return key in self._sources

    def prepare(self, cloud: GaussianCloud) -> GaussianCloud:
        """Nothing can be done beforehand here."""
        return cloud

    def limit_to_visible(
        self, key: str, cloud_hash: str, floor: OccupancyGrid, eye_height: float
    ) -> None:
        """Let `visible=True` draw a scene from visible sets; see `Renderer.limit_to_visible`.

        Raises:
            ConfigError: the backend has no visible sets.
        """
        visible_backend(self.name)
        self._floors[key] = Floor.of_grid(cloud_hash, floor, eye_height)

    def open_sets(self, key: str) -> VisibleScene:
        """The visible sets of a scene.

        Raises:
            RenderError: always: the other process has them.
        """
        raise RenderError("visible sets are kept by the drawing process", where=repr(key))

    def draw(
        self,
        camera: Camera,
        views: NDArray[np.floating],
        keys: Sequence[str] | str = ALONE,
        *,
        extra: GaussianCloud | None = None,
        outputs: tuple[Output, ...] = OUTPUTS,
        background: Colour | None = None,
        visible: bool = False,
        millimetres: bool = False,
        parts: Parts = (),
    ) -> RenderResult:
        """Draw views [V, 4, 4], `VIEWS` of a scene a request; see `Renderer.draw`.

        Raises:
            RenderError: a view is invalid, a scene is unknown, or `extra` splats are given: they do
                not travel.
            DeviceError: the device or the drawing process is lost.
        """
        if extra is not None and len(extra):
            raise RenderError("moving splats are not sent to another process")
        matrices = check_views(views)
        check_outputs(outputs)
        if not isinstance(keys, str) and len(keys) != len(matrices):
            raise RenderError(f"{len(keys)} keys for {len(matrices)} views", where="keys")
        moving = check_parts(parts, len(matrices), self._known) if parts else []
        some = [
            self.ask(
                key, camera, matrices[rows], outputs, background,
                visible=visible, millimetres=millimetres, parts=moving[rows],
            ).pictures
            for key, rows in _find_requests(keys, len(matrices) if outputs else 0)
        ]  # fmt: skip
        found: dict[str, Any] = {}
        for name in outputs:
            arrays = [pictures[name] for pictures in some]
            found[name] = (
                arrays[0] if len(arrays) == 1
                else np.concatenate(arrays) if arrays
                else _empty(name, camera, millimetres)
            )  # fmt: skip
        return RenderResult(*(found.get(name) for name in ALL_OUTPUTS))

    render = draw

    def ask(
        self,
        key: str,
        camera: Camera,
        views: NDArray[np.floating],
        outputs: tuple[Output, ...],
        background: Colour | None = None,
        *,
        visible: bool = False,
        millimetres: bool = False,
        encode: Encode | None = None,
        shown: MapPicture | None = None,
        parts: Parts = (),
    ) -> DrawnViews:
        """One request: at most `VIEWS` views [V, 4, 4] of a scene, and files of them.

        Raises:
            RenderError: a view is invalid, there are too many, the scene is unknown, or `parts`
                have no meaning.
            DeviceError: the device or the drawing process is lost.
        """
        matrices = check_views(views)
        if not 0 < len(matrices) <= VIEWS:
            raise RenderError(f"{len(matrices)} views in a request", remedy=f"give 1 to {VIEWS}")
        if key not in self._sources:
            raise RenderError(f"no scene {key!r} was added", remedy="call add_source first")
        rows: PartRows | None = None
        moving = check_parts(parts, len(matrices), self._known) if parts else []
        if any(moving):
            used = {one.cloud for instances in moving for one in instances}
            sent = sorted(used - self._posed.keys())
            for name in sent:
                self._connection.send_cloud(*self._parts[name], name)
            rows = PartRows.of_parts(moving, {name: name for name in sent}, self._posed)
        return self._connection.draw(
            key, self._sources[key], camera, matrices, outputs, background, encode,
            self._floors.get(key) if visible else None, millimetres=millimetres, shown=shown,
            parts=rows,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class SceneEncoder:
    """Asks the drawing process a scene for files of its pictures.

    Attributes:
        renderer: asks.
        key: key of the scene.
        visible: draw from visible sets.
    """

    renderer: RendererShared
    key: str
    visible: bool = False

    def render_files(
        self,
        camera: Camera,
        views: NDArray[np.floating],
        encode: Encode,
        background: Colour | None = None,
        outputs: tuple[Output, ...] = ("rgb",),
        shown: MapPicture | None = None,
        parts: Parts = (),
    ) -> DrawnViews:
        """Pictures of at most `VIEWS` views [V, 4, 4], and files of the colour ones.

        `shown` is the map that the dots of `encode` are on. Depth, where `outputs` name it, comes
        as uint16 millimetres, see `gn0.render.depth`.

        Raises:
            RenderError: a view is invalid, or there are too many.
            DeviceError: the device or the drawing process is lost.
        """
        return self.renderer.ask(
            self.key, camera, views, outputs, background, visible=self.visible,
            millimetres="depth" in outputs, encode=encode, shown=shown, parts=parts,
        )  # fmt: skip


def _find_requests(keys: Sequence[str] | str, count: int) -> Iterator[tuple[str, slice]]:
    """Neighbours of one scene, at most `VIEWS` at a time."""
    begin = 0
    while begin < count:
        key = keys if isinstance(keys, str) else keys[begin]
        end = begin + 1
        while end < count and end - begin < VIEWS and (isinstance(keys, str) or keys[end] == key):
            end += 1
        yield key, slice(begin, end)
        begin = end


def _empty(name: str, camera: Camera, millimetres: bool) -> NDArray[Any]:
    """Pictures of no views."""
    shape = (0, camera.height, camera.width)
    if name == "rgb":
        return np.zeros((*shape, 3), np.uint8)
    if name in LABELS:
        return np.zeros(shape, np.uint32)
    return np.zeros(shape, np.uint16 if name == "depth" and millimetres else np.float32)


@dataclass(eq=False)
class DrawServer:
    """The drawing process, from its start to its end: a context manager.

    Args:
        backend: "cuda" or "cpu".
        load: "module:function" that turns the source of a scene into its splats.
        pose: "module:function" that makes of its renderer what poses people; "": nobody does.
        batch: views a call at most; 0 takes the default.
        note: told once what people should hear, such as smaller batches.
        threads: compute threads that it may use.

    Attributes:
        address: for `DrawConnection`.
        card: name of the device.
        encodes: whether it makes JPEG files.
        tally: what it has drawn, as it said last.

    Raises:
        DeviceError: there is no usable device; says why.
    """

    backend: str
    load: str
    batch: int = 0
    note: Callable[[str], None] = lambda text: None
    threads: int = 1
    pose: str = ""
    address: str = ""
    card: str = ""
    encodes: bool = False
    tally: Tally = Tally()  # noqa: RUF009 (frozen)

    def __enter__(self) -> DrawServer:
        """Start it, and wait until it can draw."""
        heard: queue.SimpleQueue[Any] = queue.SimpleQueue()
        decoder = msgspec.json.Decoder(Ready | Refused | Note | Tally)

        def hear(line: bytes | None) -> None:
            if line is None:
                heard.put(None)
                return
            with contextlib.suppress(msgspec.MsgspecError):
                message = decoder.decode(line)
                if isinstance(message, Note):
                    self.note(message.text)
                elif isinstance(message, Tally):
                    self.tally = message
                else:
                    heard.put(message)

        command = ["--backend", self.backend, "--load", self.load]
        if self.pose:
            command += ["--pose", self.pose]
        if self.batch:
            command += ["--batch", str(self.batch)]
        self._process = WorkerProcess(
            "gn0.render.share.server", hear, self.threads, sys.path, arguments=command
        )
        try:
            try:
                first = heard.get(timeout=START_LIMIT)
            except queue.Empty:
                raise DeviceError(
                    f"the drawing process did not start within {START_LIMIT:g} s",
                    remedy="see `gn0 doctor`, or use --backend cpu",
                ) from None
            if isinstance(first, Refused):
                raise error_of(
                    first.code, first.what, first.where, first.remedy or "use --backend cpu"
                )
            if first is None:
                ended = self._process.end()
                raise DeviceError(
                    f"the drawing process {ended.how}\n{ended.last_words}".rstrip(),
                    remedy="see `gn0 doctor`, or use --backend cpu",
                )
        except BaseException:
            self._process.end()
            raise
        self.address, self.backend, self.card = first.address, first.backend, first.card
        self.encodes = first.encodes
        return self

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def __exit__(self, *_: object) -> None:
        """End it."""
        self.end()

    def end(self) -> Ended:
        """End it now, and say how it ended."""
        return self._process.end()
