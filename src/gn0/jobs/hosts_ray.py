"""Workers on a Ray cluster: one actor a worker, on this machine or on many.

An actor is a thin host: it starts the very process that the executor `process` starts, passes its
lines on, and kills it when it hangs. So the bytes of a result cannot depend on the executor, and
work that never lets go of the interpreter cannot deafen its actor.

What crosses the network is bytes: our JSON messages, and folders as who sends them packs them. Ray
moves bytes as they are; it does serialise its own calls, and every machine of a Ray cluster can run
code on every other. A cluster is one trusted house: never expose its ports.
"""

from __future__ import annotations

import contextlib
import os
import queue
import sys
import time
from collections import deque
from pathlib import Path
from typing import Any

import msgspec

from gn0.errors import BenchError
from gn0.jobs.cluster import import_ray, join_cluster
from gn0.jobs.hosts import Goods
from gn0.jobs.process import Ended, WorkerProcess, count_cores
from gn0.jobs.worker import find_function

HEAR_SECONDS = 20.0  # how long one call waits for a worker to say something
ANSWER_SECONDS = 2.0  # how long a host may take to answer a plain question
GONE = b"gone"  # a host's line when its worker process has ended


class WorkerHost:
    """The actor: owns one worker process on the machine that Ray chose for it."""

    def __init__(self, module: bytes, code: bytes, paths: bytes, threads: int) -> None:
        self._lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        given = [path for path in msgspec.json.decode(paths, type=list[str]) if Path(path).exists()]
        self._process = WorkerProcess(
            module.decode(),
            lambda line: self._lines.put(GONE if line is None else line.rstrip(b"\n")),
            threads,
            list(dict.fromkeys([*given, *sys.path])),
        )
        self._code = name_code(code.decode()).encode()  # now: to import takes its time

    def code(self) -> bytes:
        """Which code would decide results here."""
        return self._code

    def pids(self) -> bytes:
        """Process ids of the host and of its worker, for those who watch them."""
        return msgspec.json.encode([os.getpid(), self._process.pid])

    def send(self, line: bytes) -> None:
        """Pass a message on."""
        self._process.send(line)

    def sees(self, marker: bytes) -> bytes:
        """Whether a file is there on this machine, too: 1 or nothing."""
        return b"1" if Path(os.fsdecode(marker)).is_file() else b""

    def send_goods(self, line: bytes, parcel: bytes, receive: bytes) -> None:
        """Pass a line on whose folder this machine cannot see: it comes along, packed."""
        self._process.send(find_function(receive.decode())(line, parcel))

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


def name_code(function: str) -> str:
    """What the function "module:name" calls the code of this machine."""
    return str(find_function(function)())


class HostsRay:
    """The executor `ray`: see `gn0.jobs.hosts.Hosts`.

    Args:
        module: what each worker runs, as `python -m`.
        size: how many at a time.
        code: "module:name" of a function that names the code that decides results.
        gpus: cards that Ray sets aside for each worker; a part of one shares it with others.
        address: of a running cluster ("auto" for the one of this machine, or host:port); empty
            starts one of this machine alone, without dashboard, that ends with the hosts.
        always_ship: send folders packed even to machines that see them.

    Raises:
        BenchError: Ray is not installed, no cluster answers, or it has too few CPUs.
    """

    def __init__(
        self,
        module: str,
        size: int,
        *,
        code: str,
        gpus: float = 0,
        address: str = "",
        always_ship: bool = False,
    ) -> None:
        self._ray = import_ray()
        self._module = module.encode()
        self._code = code
        self._always_ship = always_ship
        self._hosts: dict[int, Any] = {}
        self._asked: dict[Any, int] = {}  # pending `hear` -> worker
        self._lines: deque[tuple[int, bytes | None]] = deque()
        self._checked: set[int] = set()
        self._sees: dict[tuple[int, Path], bool] = {}
        self._parcels: dict[str, Any] = {}
        self._ours = not self._ray.is_initialized()
        if self._ours:
            join_cluster(self._ray, size, address, gpus=gpus * size)
        cores = int(self._ray.cluster_resources().get("CPU", 0))
        if cores < size:
            self._leave()
            raise BenchError(
                f"{size} workers, but the Ray cluster has {cores} CPUs",
                where="--workers",
                remedy=f"give at most {cores}, or add machines with `ray start`",
            )
        cards = float(self._ray.cluster_resources().get("GPU", 0))
        if cards < gpus * size:
            self._leave()
            raise BenchError(
                f"{size} workers of {gpus:g} GPUs each, but the Ray cluster has {cards:g} GPUs",
                where="--gpus",
                remedy="give fewer workers, or a part of a GPU to each",
            )
        self._threads = max(1, count_cores() // size) if self._ours else 1
        self._host = self._ray.remote(WorkerHost).options(
            num_cpus=1, num_gpus=gpus, max_restarts=0, max_concurrency=4
        )

    def start(self, number: int) -> None:
        """Start one on a machine that Ray chooses."""
        paths = msgspec.json.encode([path or os.getcwd() for path in sys.path])
        self._hosts[number] = self._host.remote(
            self._module, self._code.encode(), paths, self._threads
        )
        self._listen(number)

    def _listen(self, number: int) -> None:
        self._asked[self._hosts[number].hear.remote(HEAR_SECONDS)] = number

    def send(self, number: int, line: bytes, goods: Goods | None = None) -> None:
        """Send a line, and with it the folder that its machine does not see."""
        host = self._hosts[number]
        if goods is None or self._is_seen(number, goods.marker):
            host.send.remote(line)
            return
        if goods.name not in self._parcels:
            self._parcels[goods.name] = self._ray.put(goods.pack())
        host.send_goods.remote(line, self._parcels[goods.name], goods.receive.encode())

    def _is_seen(self, number: int, marker: Path) -> bool:
        if self._always_ship:
            return False
        if (number, marker) not in self._sees:
            answer = self._ask(self._hosts[number].sees.remote(os.fsencode(marker)), b"1")
            self._sees[number, marker] = bool(answer)
        return self._sees[number, marker]

    def _ask(self, reference: Any, otherwise: bytes) -> bytes:
        """The answer to a plain question, or `otherwise` of a host that is gone or stuck."""
        try:
            return bytes(self._ray.get(reference, timeout=ANSWER_SECONDS))
        except (self._ray.exceptions.RayError, TimeoutError):
            return otherwise

    def hear(self, timeout: float) -> tuple[int, bytes | None] | None:
        """The next line within `timeout` [s], or None.

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
        return self._lines.popleft()

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
        here = name_code(self._code)
        there = self._ask(self._hosts[number].code.remote(), b"").decode()
        if there and there != here:
            raise BenchError(
                f"a machine of the Ray cluster runs gn0 {there}, this one {here}",
                where="--executor ray",
                remedy="install the same gn0 on every machine",
            )
        if there:  # a host too busy to answer is asked again at its next word
            self._checked.add(number)

    def pids(self, number: int) -> tuple[int, int]:
        """Process ids of a worker's host and of the worker itself, on their machine."""
        host, process = msgspec.json.decode(
            self._ask(self._hosts[number].pids.remote(), b"[0,0]"), type=tuple[int, int]
        )
        return host, process

    def ask_where(self, number: int) -> str:
        """Where a hung worker is."""
        return self._ask(self._hosts[number].ask_where.remote(), b"").decode()

    def end(self, number: int) -> Ended:
        """End one with its host."""
        host = self._hosts.pop(number)
        said = self._ask(host.end.remote(), b"")
        with contextlib.suppress(self._ray.exceptions.RayError):
            self._ray.kill(host)
        if not said:
            return Ended("was lost with its Ray actor", "the Ray actor of the worker died")
        how, words = msgspec.json.decode(said, type=tuple[str, str])
        return Ended(how, words)

    def close(self) -> None:
        """End all of them, and the cluster if it was started here."""
        ending = [host.end.remote() for host in self._hosts.values()]
        with contextlib.suppress(self._ray.exceptions.RayError):
            if ending:
                self._ray.wait(ending, num_returns=len(ending), timeout=ANSWER_SECONDS)
        for host in self._hosts.values():
            with contextlib.suppress(self._ray.exceptions.RayError):
                self._ray.kill(host)
        self._hosts.clear()
        self._leave()

    def _leave(self) -> None:
        if self._ours:
            self._ray.shutdown()
