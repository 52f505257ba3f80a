"""The child's end of a worker process: lines in on stdin, lines out on the first stdout."""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import os
import queue
import signal
import sys
import threading
from collections.abc import Callable
from typing import IO


def open_channel() -> tuple[queue.SimpleQueue[bytes], Callable[[bytes], None]]:
    """(inbox of lines, send a line); from here on prints go to stderr.

    The process ends when its parent is gone, in the middle of its work if need be.
    """
    _die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides when we end
    if hasattr(signal, "SIGUSR1"):
        faulthandler.register(signal.SIGUSR1, all_threads=True)
    faulthandler.enable()
    channel = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what is printed must not look like a message
    sys.stdout = sys.stderr
    inbox: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    source = os.fdopen(os.dup(0), "rb")
    threading.Thread(target=_listen, args=(source, inbox), daemon=True).start()

    def send(line: bytes) -> None:
        channel.write(line + b"\n")
        channel.flush()

    return inbox, send


def _die_with_parent() -> None:
    """Linux: be killed when the parent dies, even inside code that never lets go of the GIL."""
    if sys.platform.startswith("linux"):
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None, use_errno=True).prctl(1, signal.SIGKILL)  # 1 = PR_SET_PDEATHSIG


def _listen(stream: IO[bytes], inbox: queue.SimpleQueue[bytes]) -> None:
    for line in stream:
        inbox.put(line)
    os._exit(0)  # the parent is gone: nothing we could still say would be heard
