"""Copies pictures from the device to the processes that asked, while the next are drawn."""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import DeviceArray, Download
from gn0.errors import Gn0Error, RenderError
from gn0.render.renderer import Output
from gn0.render.share.files import Files
from gn0.render.share.messages import Drawn, lay_files
from gn0.render.share.request import Request

NOTHING = np.zeros(0, np.uint8)
IN_FLIGHT = 2  # batches between the renderer and their last byte in an area


@dataclass(frozen=True, eq=False)
class Piece:
    """Rows of a batch that belong to a request.

    Attributes:
        request: whose.
        rows: in the batch.
        places: of them in the request.
        last: the request is whole with these.
    """

    request: Request
    rows: slice
    places: slice
    last: bool


@dataclass(frozen=True, eq=False)
class Batch:
    """Pictures of one call of the renderer, and whose they are.

    Attributes:
        pictures: with fields rgb, depth, alpha on a device, or with `numpy()`.
        outputs: which of them go to the areas.
        pieces: in the order of their rows.
        files: files of the pictures, where they are wanted.
        copies: under way to pinned memory, by output.
        blocks: of pinned memory that they go to, whole, by output.
    """

    pictures: Any
    outputs: tuple[Output, ...]
    pieces: Sequence[Piece]
    files: Files | None = None
    copies: dict[str, Download] = field(default_factory=dict)
    blocks: dict[str, NDArray[np.uint8]] = field(default_factory=dict)


class Handing:
    """A thread of its own that waits for copies, fills areas and answers.

    The device is used, and its arrays are let go of, in the thread that draws alone; this one
    only waits for copies into pinned memory, of which at most `IN_FLIGHT` batches exist.
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self._todo: queue.SimpleQueue[Batch] = queue.SimpleQueue()
        self._done: queue.SimpleQueue[Gn0Error | None] = queue.SimpleQueue()
        self._flying: deque[Batch] = deque()
        self._blocks: dict[str, list[NDArray[np.uint8]]] = {}
        self._coded: dict[int, Coded] = {}
        threading.Thread(target=self._work, name="hand pictures out", daemon=True).start()

    def make_room(self) -> None:
        """Wait until another batch may be drawn.

        Raises:
            Gn0Error: a copy of an earlier batch failed; those who wait for it have been told.
        """
        while self._flying:
            try:
                error = self._done.get(block=len(self._flying) >= IN_FLIGHT)
            except queue.Empty:
                return
            batch = self._flying.popleft()
            if error is not None:
                raise error
            for name, block in batch.blocks.items():
                self._blocks.setdefault(name, []).append(block)

    def take(self, batch: Batch) -> None:
        """Bring the pictures of a batch to those who asked; returns at once."""
        sources: dict[str, Any] = {
            name: getattr(batch.pictures, name, None) for name in batch.outputs
        }
        if (files := batch.files) is not None:
            sources |= {"files": files.views.data, "tiles": files.tiles}
            sources["digests"] = files.digests
            sources["mosaics"] = None if files.mosaics is None else files.mosaics.data
            for group, shown in enumerate(files.maps):
                sources[f"maps {group}"] = None if shown.coded is None else shown.coded.data
        for name, source in sources.items():
            if isinstance(source, DeviceArray) and source.nbytes:
                kept = self._blocks.get(name)
                block = kept.pop() if kept else None
                if block is None or len(block) < source.nbytes:
                    block = source.device.pinned(source.nbytes * 5 // 4, np.uint8)
                target = block[: source.nbytes].view(source.dtype).reshape(source.shape)
                batch.blocks[name] = block
                batch.copies[name] = source.device.download_async(source, target, beside=True)
        self._flying.append(batch)
        self._todo.put(batch)

    def _work(self) -> None:
        while True:
            batch: Batch | None = self._todo.get()
            assert batch is not None
            error: Gn0Error | None = None
            begin = time.perf_counter()
            try:
                self._hand_out(batch)
            except Exception as raised:  # those who wait must hear of anything
                error = (
                    raised
                    if isinstance(raised, Gn0Error)
                    else RenderError(
                        f"pictures cannot be handed out: {type(raised).__name__}: {raised}"
                    )
                )
                for piece in batch.pieces:
                    self._coded.pop(id(piece.request), None)
                    piece.request.fail(error)
            self.seconds += time.perf_counter() - begin
            batch = None  # its arrays are the other thread's to let go of
            self._done.put(error)

    def _hand_out(self, batch: Batch) -> None:
        arrays: dict[str, NDArray[Any]] = {
            name: copy.numpy() for name, copy in batch.copies.items()
        }
        for output in batch.outputs:
            if output not in arrays:
                arrays[output] = getattr(batch.pictures.numpy(), output)
            if arrays[output] is None:
                raise RenderError(f"the renderer gave no {output}")
        mosaics = 0
        for piece in batch.pieces:
            for wanted, target in piece.request.targets().items():
                if wanted in ("tiles", "rgb") and wanted not in arrays:
                    continue  # none are made, or nobody looks at them
                if target.dtype != arrays[wanted].dtype:
                    raise RenderError(f"the renderer gave {wanted} of {arrays[wanted].dtype}")
                np.copyto(target[piece.places], arrays[wanted][piece.rows])
            coded = Coded(piece.request)
            if (files := batch.files) is not None:
                coded = self._coded.pop(id(piece.request), coded)
                hashes = {name: arrays["digests"][rows] for name, rows in files.hashed.items()}
                coded.add("files", arrays.get("files", NOTHING), files.views.starts, piece.rows)
                coded.add_digests("files", hashes["files"][piece.rows])
                if "depth" in hashes:
                    coded.add_digests("depth", hashes["depth"][piece.rows])
                if piece.last and files.mosaics is not None:
                    steps = slice(mosaics, mosaics + files.steps[id(piece.request)])
                    coded.add(
                        "mosaics", arrays.get("mosaics", NOTHING), files.mosaics.starts, steps
                    )
                    coded.add_digests("mosaics", hashes["mosaics"][steps])
                    mosaics = steps.stop
                for group, shown in enumerate(files.maps):
                    if (own := shown.rows.get(id(piece.request))) is None:
                        continue
                    name = f"maps {group}"
                    if shown.coded is not None:
                        coded.add("maps", arrays.get(name, NOTHING), shown.coded.starts, own)
                    coded.add_digests("maps", hashes[name][own])
                if not piece.last:
                    self._coded[id(piece.request)] = coded
            if piece.last:
                piece.request.connection.send(coded.answer())


class Coded:
    """The files of a request as they come into its area, one behind the other, and digests."""

    def __init__(self, request: Request) -> None:
        self._request = request
        _, self._at, self._end = lay_files(request.draw)
        self._sizes: dict[str, list[int]] = {"files": [], "mosaics": [], "maps": []}
        self._digests = {"files": b"", "mosaics": b"", "depth": b"", "maps": b""}
        self._fits = True

    def add(
        self, kind: str, data: NDArray[np.uint8], starts: NDArray[np.int64], rows: slice
    ) -> None:
        """Copy files `rows` of a batch; without room for all, the request gets none."""
        begin, end = int(starts[rows.start]), int(starts[rows.stop])
        self._fits &= self._at + end - begin <= self._end
        if self._fits:
            draw = self._request.draw
            area = self._request.connection.areas[draw.area]
            area[self._at : self._at + end - begin] = data[begin:end]
            self._at += end - begin
            self._sizes[kind] += np.diff(starts[rows.start : rows.stop + 1]).tolist()

    def add_digests(self, kind: str, digests: NDArray[np.uint8]) -> None:
        """Take digests [n, 16]."""
        self._digests[kind] += digests.tobytes()

    def answer(self) -> Drawn:
        """What the request is told."""
        number = self._request.draw.number
        if not self._fits:
            return Drawn(number)
        files, mosaics, maps = (tuple(self._sizes[name]) for name in ("files", "mosaics", "maps"))
        return Drawn(number, files, mosaics, maps, b"".join(self._digests.values()))
