"""Processes that read samples ahead, into memory that they share with who asked for them.

A batch is divided by parts: each worker reads the samples of its own parts, so that no table, shard
or drawn episode is opened twice, and writes them where they belong. Who read what decides nothing.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import tempfile
import weakref
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from gn0.data.dataset import open_dataset
from gn0.errors import JobError
from gn0.jobs.hosts import HostsProcess
from gn0.jobs.run import error_of
from gn0.jobs.worker import Answer, Told, Unit
from gn0.storage import storage_error
from gn0.training.streams.sample_order import Rows, SampleOrder
from gn0.training.streams.sample_reader import PictureWish, SampleReaders

Layout = Mapping[str, tuple[tuple[int, ...], str]]
_ALIGNED = 64  # bytes
FUNCTION = f"{__name__}:fill_rows"


class FillOrder(msgspec.Struct, frozen=True):
    """What a worker is told.

    Attributes:
        folders: of the datasets.
        wish: which pictures, as JSON.
        area: file of the shared memory.
        layout: shapes and types of a sample.
        count: samples of a batch.
        begin: first byte of the batch.
        at, rows, epochs, places: which samples, see `SampleReader.read`.
    """

    folders: tuple[str, ...]
    wish: bytes
    area: str
    layout: dict[str, tuple[tuple[int, ...], str]]
    count: int
    begin: int
    at: tuple[int, ...]
    rows: tuple[int, ...]
    epochs: tuple[int, ...]
    places: tuple[int, ...]


def measure_batch(layout: Layout, count: int) -> tuple[dict[str, int], int]:
    """Offset of each array of a batch, and bytes of all."""
    offsets, end = {}, 0
    for name, (shape, kind) in layout.items():
        offsets[name] = end
        size = count * int(np.prod(shape, dtype=np.int64)) * np.dtype(kind).itemsize
        end += -(-size // _ALIGNED) * _ALIGNED
    return offsets, end


def view_batch(memory: Any, begin: int, layout: Layout, count: int) -> dict[str, NDArray[Any]]:
    """The arrays of a batch in shared memory."""
    offsets, _ = measure_batch(layout, count)
    return {
        name: np.ndarray((count, *shape), kind, memory, begin + offsets[name])
        for name, (shape, kind) in layout.items()
    }


@lru_cache(maxsize=1)
def _open_reader(folders: tuple[str, ...], wish: bytes) -> SampleReaders:
    datasets = [open_dataset(folder) for folder in folders]
    return SampleReaders(datasets, msgspec.json.decode(wish, type=PictureWish))


@lru_cache(maxsize=1)
def _open_area(path: str) -> mmap.mmap:
    with open(path, "r+b") as file:
        return mmap.mmap(file.fileno(), 0)


def fill_rows(payload: dict[str, Any]) -> dict[str, Any]:
    """Read samples into shared memory; runs in a worker. Without samples it only opens all.

    Raises:
        Gn0Error: as `SampleReader.read`.
    """
    order = msgspec.convert(payload, FillOrder)
    reader, memory = _open_reader(order.folders, order.wish), _open_area(order.area)
    out = view_batch(memory, order.begin, order.layout, order.count)
    lists = (order.rows, order.epochs, order.places)
    reader.read(Rows(*(np.array(one, np.int64) for one in lists)), out, order.at)
    return {}


def _make_area(size: int) -> tuple[Path, mmap.mmap]:
    """A file of that size, in memory where the system has such a folder, and its mapping."""
    folder = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None  # noqa: S108 (made safely)
    descriptor, name = tempfile.mkstemp(prefix="gn0-samples-", dir=folder)
    try:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(descriptor, 0, size)  # says now that memory is short, not later
        else:
            os.truncate(descriptor, size)
        return Path(name), mmap.mmap(descriptor, size)
    except OSError as error:
        os.unlink(name)
        raise storage_error(error, name, f"reserve {size:,} bytes of shared memory") from error
    finally:
        os.close(descriptor)


class SampleWorkers:
    """Workers of some datasets, and room for some batches.

    Args:
        folders: of the datasets.
        wish: which pictures.
        order: which part holds a row.
        layout: of a sample.
        count: samples of a batch.
        slabs: batches that there is room for.
        workers: how many.

    Raises:
        StorageError: there is not so much shared memory.
        JobError: a worker does not start.
    """

    def __init__(
        self,
        folders: Sequence[Path],
        wish: PictureWish,
        order: SampleOrder,
        layout: Layout,
        count: int,
        slabs: int,
        workers: int,
    ) -> None:
        self.count, self.slabs, self._layout, self._order = count, slabs, dict(layout), order
        self._folders = tuple(str(folder.resolve()) for folder in folders)
        self._wish = msgspec.json.encode(wish)
        self._size = measure_batch(layout, count)[1]
        self._workers, self._waits = workers, [0] * slabs
        self._hosts = HostsProcess("gn0.jobs.worker", workers)
        self._end = weakref.finalize(self, self._hosts.close)  # nobody has to think of it
        self._area, self._memory = _make_area(self._size * slabs)
        try:
            for number in range(workers):
                self._hosts.start(number)
                self._send(number, 0, np.empty(0, np.int64), Rows(*[np.empty(0, np.int64)] * 3))
            self.wait(0)
        except BaseException:
            self.close()
            raise
        finally:
            with contextlib.suppress(OSError):
                self._area.unlink()  # all have it open: it goes away with the last of us

    def ask(self, slab: int, rows: Rows) -> None:
        """Let samples be read into a slab."""
        who = self._order.part_of(rows.rows) % self._workers
        for number in range(self._workers):
            at = np.flatnonzero(who == number)
            if len(at):
                mine = Rows(rows.rows[at], rows.epochs[at], rows.places[at])
                self._send(number, slab, at, mine)

    def _send(self, number: int, slab: int, at: NDArray[np.int64], rows: Rows) -> None:
        told = FillOrder(
            self._folders,
            self._wish,
            str(self._area),
            self._layout,
            self.count,
            slab * self._size,
            tuple(at.tolist()),
            tuple(rows.rows.tolist()),
            tuple(rows.epochs.tolist()),
            tuple(rows.places.tolist()),
        )
        unit = Unit(slab, FUNCTION, msgspec.to_builtins(told))
        self._waits[slab] += 1
        self._hosts.send(number, msgspec.json.encode(unit))

    def wait(self, slab: int) -> dict[str, NDArray[Any]]:
        """A slab's arrays once all of its samples are there; views, until it is asked for again.

        Raises:
            JobError: a worker died.
            Gn0Error: what a worker met.
        """
        decoder = msgspec.json.Decoder(Answer | Told)
        while self._waits[slab]:
            heard = self._hosts.hear(60.0)
            if heard is None:
                continue
            number, line = heard
            if line is None:
                ended = self._hosts.end(number)
                raise JobError(
                    f"the process that reads samples {ended.how}",
                    where=f"worker {number}",
                    remedy="is there enough memory? its last words:\n" + ended.last_words,
                )
            answer = decoder.decode(line)
            if isinstance(answer, Answer):
                if answer.value is None:
                    raise error_of(answer, f"worker {number}")
                self._waits[answer.index] -= 1
        return view_batch(self._memory, slab * self._size, self._layout, self.count)

    def close(self) -> None:
        """End the workers."""
        self._end()
