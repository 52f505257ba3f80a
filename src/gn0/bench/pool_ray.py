"""Workers on a Ray cluster: one actor a worker, on this machine or on many.

An actor is a thin host: it starts the very `gn0.bench.episode_worker` process that the executor
`process` starts, passes its lines on, and kills it when it hangs. So the bytes of a result cannot
depend on the executor, and a policy that never lets go of the interpreter cannot deafen its actor.

What crosses the network is bytes: our JSON messages, and scenes as `gn0.bench.scene_archive` packs
them. Ray moves bytes as they are; it does serialise its own calls, and every machine of a Ray
cluster can run code on every other. A cluster is one trusted house: never expose its ports.
"""

from __future__ import annotations

import contextlib
import os
import queue
import sys
import time
from collections import deque
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgspec

from gn0.bench.executors import Heard, Worker, next_worker
from gn0.bench.pool_process import decode_line
from gn0.bench.protocol import code_version
from gn0.bench.scene_archive import pack_folder, unpack_scene
from gn0.bench.worker_messages import FromWorker, Lease, Open
from gn0.errors import BenchError
from gn0.jobs.cluster import import_ray, join_cluster
from gn0.jobs.process import Ended, WorkerProcess, count_cores

HEAR_SECONDS = 20.0  # how long one call waits for a worker to say something
ANSWER_SECONDS = 2.0  # how long a host may take to answer a plain question
GONE = b"gone"  # a host's line when its worker process has ended


class WorkerHost:
    """The actor: owns one worker process on the machine that Ray chose for it."""

    def __init__(self, paths: bytes, threads: int) -> None:
        self._lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        given = [path for path in msgspec.json.decode(paths, type=list[str]) if Path(path).exists()]
        self._process = WorkerProcess(
            "gn0.bench.episode_worker",
            lambda line: self._lines.put(GONE if line is None else line.rstrip(b"\n")),
            threads,
            list(dict.fromkeys([*given, *sys.path])),
        )

    def code(self) -> bytes:
        """Which code would decide results here."""
        return code_version().encode()

    def pids(self) -> bytes:
        """Process ids of the host and of its worker, for those who watch them."""
        return msgspec.json.encode([os.getpid(), self._process.pid])

    def send(self, line: bytes) -> None:
        """Pass a message on."""
        self._process.send(line)

    def sees(self, folder: bytes) -> bytes:
        """Whether a scene folder is there on this machine, too: 1 or nothing."""
        return b"1" if (Path(os.fsdecode(folder)) / "scene.json").is_file() else b""

    def send_parcel(self, line: bytes, parcel: bytes) -> None:
        """Pass a lease on whose scene this machine cannot see: it comes along, packed."""
        lease = msgspec.json.decode(line, type=Lease)
        folder = unpack_scene(parcel, lease.hash)
        self._process.send(msgspec.json.encode(msgspec.structs.replace(lease, folder=str(folder))))

    def hear(self, seconds: float) -> bytes:
        """All lines said since the last call; waits for one, but no longer than `seconds`."""
        lines = []
        with contextlib.suppress(queue.Empty):
            lines.append(self._lines.get(timeout=seconds))
            while True:
                lines.append(self._lines.get_nowait())
        return b"\n".join(lines)

    def ask_where(self) -> bytes:
        """Stacks and last words of the worker."""
        return self._process.ask_where().encode()

    def end(self) -> bytes:
        """Kill the worker, and say how it ended: two JSON strings."""
        ended = self._process.end()
        return msgspec.json.encode((ended.how, ended.last_words))


class PoolRay:
    """The executor `ray`: see `gn0.bench.executors.Pool`.

    Args:
        settings: first message to each worker.
        workers: how many at a time.
        address: of a running cluster ("auto" for the one of this machine, or host:port); empty
            starts one of this machine alone, without dashboard, that ends with the pool.
        always_ship: send scenes packed even to hosts that see their folder.

    Raises:
        BenchError: Ray is not installed, no cluster answers, or it has too few CPUs.
    """

    def __init__(
        self, settings: Open, workers: int, *, address: str = "", always_ship: bool = False
    ) -> None:
        self._ray = import_ray()
        self.size = workers
        self.workers: dict[int, Worker] = {}
        self._settings = settings
        self._always_ship = always_ship
        self._decoder = msgspec.json.Decoder(FromWorker)
        self._hosts: dict[int, Any] = {}
        self._asked: dict[Any, int] = {}  # pending `hear` -> worker
        self._lines: deque[tuple[int, bytes | None]] = deque()
        self._checked: set[int] = set()
        self._sees: dict[tuple[int, str], bool] = {}
        self._parcels: dict[str, Any] = {}
        self._next = 0
        self._ours = not self._ray.is_initialized()
        if self._ours:
            join_cluster(self._ray, workers, address)
        cores = int(self._ray.cluster_resources().get("CPU", 0))
        if cores < workers:
            self._leave()
            raise BenchError(
                f"{workers} workers, but the Ray cluster has {cores} CPUs",
                where="--workers",
                remedy=f"give at most {cores}, or add machines with `ray start`",
            )
        self._host = self._ray.remote(WorkerHost).options(
            num_cpus=1, max_restarts=0, max_concurrency=4
        )

    def start(self) -> Worker:
        """Start one worker and tell it which policy to build."""
        worker = next_worker(self._next, self.workers)
        self._next += 1
        paths = msgspec.json.encode([path or os.getcwd() for path in sys.path])
        host = self._host.remote(paths, 1 if not self._ours else max(1, count_cores() // self.size))
        self._hosts[worker.number] = host
        self.workers[worker.number] = worker
        self.send(worker, msgspec.structs.replace(self._settings, slot=worker.slot))
        self._listen(worker.number)
        return worker

    def _listen(self, number: int) -> None:
        self._asked[self._hosts[number].hear.remote(HEAR_SECONDS)] = number

    def send(self, worker: Worker, message: Any) -> None:
        """Send a message, and the scene of a lease where the machine does not see its folder."""
        host, line = self._hosts[worker.number], msgspec.json.encode(message)
        if isinstance(message, Lease) and not self._is_seen(worker.number, message.folder):
            if message.hash not in self._parcels:
                self._parcels[message.hash] = self._ray.put(pack_folder(Path(message.folder)))
            host.send_parcel.remote(line, self._parcels[message.hash])
        else:
            host.send.remote(line)

    def _is_seen(self, number: int, folder: str) -> bool:
        if self._always_ship:
            return False
        if (number, folder) not in self._sees:
            answer = self._ask(self._hosts[number].sees.remote(os.fsencode(folder)), b"1")
            self._sees[number, folder] = bool(answer)
        return self._sees[number, folder]

    def _ask(self, reference: Any, otherwise: bytes) -> bytes:
        """The answer to a plain question, or `otherwise` of a host that is gone or stuck."""
        try:
            return bytes(self._ray.get(reference, timeout=ANSWER_SECONDS))
        except (self._ray.exceptions.RayError, TimeoutError):
            return otherwise

    def hear(self, timeout: float) -> Heard | None:
        """The next message within `timeout` [s], or None.

        Raises:
            BenchError: a machine of the cluster runs other code than this one.
        """
        until = time.monotonic() + max(0.0, timeout)
        while not self._lines:
            left = until - time.monotonic()
            if not self._asked:
                time.sleep(max(0.0, min(left, 0.05)))
            else:
                spoken, _ = self._ray.wait(list(self._asked), num_returns=1, timeout=max(0.0, left))
                for reference in spoken:
                    self._receive(reference)
            if not self._lines and time.monotonic() >= until:
                return None
        number, line = self._lines.popleft()
        return Heard(number, decode_line(self._decoder, line))

    def _receive(self, reference: Any) -> None:
        number = self._asked.pop(reference)
        if number not in self._hosts:
            return
        try:
            said = bytes(self._ray.get(reference))
        except self._ray.exceptions.RayError:
            self._lines.append((number, None))
            return
        if said and number not in self._checked:
            self._check_code(number)
        lines = said.split(b"\n") if said else []
        self._lines.extend((number, None if line == GONE else line) for line in lines)
        if GONE not in lines:
            self._listen(number)

    def _check_code(self, number: int) -> None:
        """A result of other code is another result: such a machine is not worked with."""
        here = code_version()
        there = self._ask(self._hosts[number].code.remote(), b"").decode()
        if there and there != here:
            raise BenchError(
                f"a machine of the Ray cluster runs gn0 {there}, this one {here}",
                where="--executor ray",
                remedy="install the same gn0 on every machine",
            )
        if there:  # a host too busy to answer is asked again at its next word
            self._checked.add(number)

    def pids(self, worker: Worker) -> tuple[int, int]:
        """Process ids of a worker's host and of the worker itself, on their machine."""
        host, process = msgspec.json.decode(
            self._ask(self._hosts[worker.number].pids.remote(), b"[0,0]"), type=tuple[int, int]
        )
        return host, process

    def ask_where(self, worker: Worker) -> str:
        """Where a hung worker is."""
        return self._ask(self._hosts[worker.number].ask_where.remote(), b"").decode()

    def end(self, worker: Worker) -> Ended:
        """End one worker and its host."""
        self.workers.pop(worker.number, None)
        host = self._hosts.pop(worker.number)
        said = self._ask(host.end.remote(), b"")
        with contextlib.suppress(self._ray.exceptions.RayError):
            self._ray.kill(host)
        if not said:
            return Ended("was lost with its Ray actor", "the Ray actor of the worker died")
        how, words = msgspec.json.decode(said, type=tuple[str, str])
        return Ended(how, words)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        ending = [host.end.remote() for host in self._hosts.values()]
        with contextlib.suppress(self._ray.exceptions.RayError):
            if ending:
                self._ray.wait(ending, num_returns=len(ending), timeout=ANSWER_SECONDS)
        for host in self._hosts.values():
            with contextlib.suppress(self._ray.exceptions.RayError):
                self._ray.kill(host)
        self._hosts.clear()
        self.workers.clear()
        self._leave()

    def _leave(self) -> None:
        if self._ours:
            self._ray.shutdown()
