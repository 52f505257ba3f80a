"""The drawing process as its starter sees it: from its start to its end."""

from __future__ import annotations

import contextlib
import queue
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgspec

from gn0.errors import DeviceError
from gn0.jobs.process import Ended, WorkerProcess
from gn0.render.share.connection import error_of
from gn0.render.share.messages import Note, Ready, Refused, Tally

START_LIMIT = 120.0  # s: the first start compiles kernels


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
