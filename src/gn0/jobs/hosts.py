"""Hosts: where workers live. All of them speak the same words, and so does who gives them work.

A host only carries lines: what a worker does, and so every byte of a result, is the same on each.
"""

from __future__ import annotations

import queue
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from gn0.jobs.process import Ended, WorkerProcess, count_cores


@dataclass(frozen=True)
class Goods:
    """A folder that a line speaks of, for a machine that does not see it.

    Attributes:
        name: of this content; it is packed once.
        marker: the file whose presence shows that the folder is there.
        pack: the folder as bytes.
        receive: "module:name" of a function of (line, bytes) that unpacks them on the machine of
            the worker and gives the line that the worker is to hear.
    """

    name: str
    marker: Path
    pack: Callable[[], bytes]
    receive: str


class Hosts(Protocol):
    """Starts, hears and ends worker processes, each known by a number."""

    def start(self, number: int) -> None:
        """Start one."""
        ...

    def send(self, number: int, line: bytes, goods: Goods | None = None) -> None:
        """Send a line; a worker that is gone is noticed by `hear`, not here."""
        ...

    def hear(self, timeout: float) -> tuple[int, bytes | None] | None:
        """(number, line) of the next to speak within `timeout` [s]; a line of None: it is gone."""
        ...

    def ask_where(self, number: int) -> str:
        """Where a hung worker is: its Python stacks, as far as it can still tell them."""
        ...

    def end(self, number: int) -> Ended:
        """End one with whatever it started, however stuck it is."""
        ...

    def close(self) -> None:
        """End all of them."""
        ...


class HostsProcess:
    """Workers as child processes of this machine, which share its cores.

    Args:
        module: what each runs, as `python -m`.
        size: how many at a time.
    """

    def __init__(self, module: str, size: int) -> None:
        self._module = module
        self._threads = max(1, count_cores() // size)
        self._processes: dict[int, WorkerProcess] = {}
        self._heard: queue.Queue[tuple[int, bytes | None]] = queue.Queue()

    def start(self, number: int) -> None:
        """Start one."""
        self._processes[number] = WorkerProcess(
            self._module, lambda line: self._heard.put((number, line)), self._threads, sys.path
        )

    def send(self, number: int, line: bytes, goods: Goods | None = None) -> None:
        """Send a line; this machine sees all folders."""
        self._processes[number].send(line)

    def hear(self, timeout: float) -> tuple[int, bytes | None] | None:
        """The next line within `timeout` [s], or None."""
        try:
            return self._heard.get(timeout=max(0.0, timeout))
        except queue.Empty:
            return None

    def ask_where(self, number: int) -> str:
        """Where a hung worker is."""
        return self._processes[number].ask_where()

    def end(self, number: int) -> Ended:
        """End one."""
        return self._processes.pop(number).end()

    def close(self) -> None:
        """End all of them."""
        for process in self._processes.values():
            process.kill()
        for number in list(self._processes):
            self.end(number)
