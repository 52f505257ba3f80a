"""What the command line draws: progress bars on a terminal, plain lines elsewhere."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from typing import Any, TextIO, cast

from gn0.cli.heartbeat import COMPILING, beating
from gn0.progress import Progress

# what a terminal obeys instead of showing: C0 but the line feed, DEL, C1, and marks that turn the
# direction of text or are not seen at all
_OBEYED = re.compile(
    "[\x00-\x09\x0b-\x1f\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff"
    "\U000e0000-\U000e007f]"
)
_QUIET_SECONDS = 5.0  # between two lines of one stage when not on a terminal


def plain_text(text: str, *, lines: bool = False) -> str:
    """Text from data as a terminal may have it: what it would obey is spelled out.

    Args:
        text: a name, an instruction, an error.
        lines: keep line feeds.
    """
    text = _OBEYED.sub(lambda m: m[0].encode("unicode_escape").decode(), text)
    return text if lines else text.replace("\n", "\\n")


class PlainStream:
    """A text stream on which names from data cannot command the terminal.

    On a terminal the few sequences that colour text and draw progress bars pass; whatever else a
    terminal would obey is spelled out: no name can set a title, fill a clipboard, hide a line or
    turn the direction of what follows.
    """

    _drawing = re.compile(r"(\x1b\[[0-9;]*m|\x1b\[[0-9]*[AK]|\x1b\[\?25[lh]|\r|\t)")

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._terminal = stream.isatty()

    def write(self, text: str) -> int:
        """Write text, spelled out where need be."""
        if _OBEYED.search(text):
            allowed = self._drawing if self._terminal else re.compile("(\t)")
            pieces = allowed.split(text)  # odd ones are what is allowed
            pieces[::2] = [plain_text(piece, lines=True) for piece in pieces[::2]]
            text = "".join(pieces)
        return self._stream.write(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write several texts."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def plain_streams() -> Iterator[None]:
    """Within the block, standard output and standard error are plain."""
    out, err = PlainStream(sys.stdout), PlainStream(sys.stderr)
    with redirect_stdout(cast("TextIO", out)), redirect_stderr(cast("TextIO", err)):
        yield


def say_aside(text: str) -> None:
    """A line beside what a command prints: on standard error, so that results stay alone."""
    print(plain_text(text), file=sys.stderr, flush=True)


def say_backend(backend: str) -> None:
    """Say aside that a renderer was asked for which this machine has not, though none may draw."""
    if backend != "cuda":
        return
    from gn0.device.open import find_device

    device, why = find_device()
    if device is None:
        say_aside(f"note: --backend cuda was asked for, but no card draws here: {why}")


@contextmanager
def draw_progress(begun: str = "") -> Iterator[Progress]:
    """A progress sink: rich bars on a terminal, a line every few seconds in a log.

    No step is silent: on a terminal a wheel turns and the seconds run, in a log a step that takes
    long is said to go on. That kernels are compiled, once, is a step of its own.

    Args:
        begun: names the work within the block, for verbs that mostly end at once: it is said only
            of work that takes long.
    """
    if sys.stderr.isatty():
        yield from _draw_bars(begun)
        return
    with beating(_lines(), _say_still, begun) as progress:
        yield progress


def _say_still(stage: str, where: str, seconds: float) -> None:
    step = f"{stage}: {where}, going on" if where else f"after {stage}: going on"
    print(f"{step} for {seconds:.0f} s", file=sys.stderr, flush=True)


def _draw_bars(begun: str) -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        ProgressColumn,
        SpinnerColumn,
        Task,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.progress import Progress as Bars
    from rich.text import Text

    class RateColumn(ProgressColumn):
        def render(self, task: Task) -> Text:
            speed = task.finished_speed or task.speed
            return Text("" if speed is None else f"{speed:.3g}/s")

    columns = (
        SpinnerColumn(finished_text=" "),
        TextColumn("{task.description:<28}"),
        BarColumn(),
        MofNCompleteColumn(),
        RateColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Bars(*columns, console=Console(stderr=True)) as bars:
        tasks: dict[str, object] = {}
        unnamed: list[Any] = []  # a row for what follows a step that has ended

        def show_still(stage: str, where: str, seconds: float) -> None:
            # the wheel and the seconds of an unfinished step move without being told
            if not where and not unnamed:
                unnamed.append(bars.add_task(f"after {stage}", total=None))
            if where and stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=None)

        def show(stage: str, done: int, total: int) -> None:
            while unnamed and stage != COMPILING:
                bars.remove_task(unnamed.pop())
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total or None)
            bars.update(tasks[stage], completed=done, total=total or None)  # type: ignore[arg-type]

        with beating(show, show_still, begun) as progress:
            yield progress
        while unnamed:
            bars.remove_task(unnamed.pop())


def _lines() -> Progress:
    last: dict[str, float] = {}
    first: dict[str, tuple[float, int]] = {}
    compiled = 0  # kernels, as was said last

    def show(stage: str, done: int, total: int) -> None:
        nonlocal compiled
        if stage == COMPILING and 0 < done == compiled:
            return  # no news: the step that waits says that it goes on
        now = time.monotonic()
        begin, before = first.setdefault(stage, (now, done))
        if done < before:  # the step begins again
            begin, before = first[stage] = now, done
        finished = total > 0 and done >= total and stage != COMPILING
        if finished or now - last.get(stage, -_QUIET_SECONDS) >= _QUIET_SECONDS:
            last[stage] = now
            line = f"{stage}: {done}/{total or '?'}"
            if stage == COMPILING:
                line = f"{stage}: {done} so far" if done else stage
                compiled = done
            if now > begin and done > before:
                line += f", {(done - before) / (now - begin):.3g}/s"
            print(line, file=sys.stderr, flush=True)

    return show
