"""Keep a library from taking the machine: threads stay at the priority they had.

SVT-AV1 puts the thread that opens an encoder, and with it all the encoder's own, at the highest
real-time priority wherever it may (as root, so in most containers). Such threads starve everything
else on the machine, other processes of the same job first.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator


@contextlib.contextmanager
def keep_priority() -> Iterator[None]:
    """Threads that turned real-time inside, or began so, go back to where the caller was."""
    if not hasattr(os, "sched_getscheduler"):  # not Linux
        yield
        return
    policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    before = set(_real_time())
    try:
        yield
    finally:
        for thread in set(_real_time()) - before:
            with contextlib.suppress(OSError):  # it has ended
                os.sched_setscheduler(thread, policy, parameter)


def _real_time() -> list[int]:
    """Numbers of this process's threads with a real-time policy."""
    found = []
    with contextlib.suppress(OSError):
        for name in os.listdir("/proc/self/task"):
            with contextlib.suppress(OSError):
                if os.sched_getscheduler(int(name)) in (os.SCHED_FIFO, os.SCHED_RR):
                    found.append(int(name))
    return found
