"""A word from a command that computes and has said nothing for long."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator

SILENCE = 30.0  # s without a line, after which one says that it goes on; then twice as long


@contextlib.contextmanager
def break_silence(
    say: Callable[[str], None], silence: float = SILENCE
) -> Iterator[Callable[[str], None]]:
    """Lines as they are said, and one of our own where none came for long, until the block ends.

    Args:
        say: takes a line.
        silence: seconds without one; the next of ours comes after twice as many, and so on.

    Returns:
        What takes the lines of the command.
    """
    spoken, ended = [time.monotonic()], threading.Event()

    def pass_on(line: str) -> None:
        spoken[0] = time.monotonic()
        say(line)

    def watch() -> None:
        since, patience = spoken[0], silence
        while not ended.wait(max(since + patience - time.monotonic(), 0.0)):
            if spoken[0] != since:
                since, patience = spoken[0], silence
            elif (passed := time.monotonic() - since) >= patience:
                say(f"goes on, {passed:.0f} s since the last line")
                patience *= 2

    thread = threading.Thread(target=watch, daemon=True, name="gn0 reminder")
    thread.start()
    try:
        yield pass_on
    finally:
        ended.set()
        thread.join()
