"""The folder of a training run: what it is, how it went, and the states that it goes on from.

`run.json` says what was asked for and when; `metrics.jsonl` and `events/` hold the curves, `log`
what was said, `checkpoints/` the last states; `page.html` shows it, once the run is done.
"""

from __future__ import annotations

import contextlib
import datetime
import math
import shutil
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from gn0.config import Config, load_json
from gn0.errors import TrainingError
from gn0.locked_folder import LOCK, check_room, holds_leftovers_only, lock_folder, sweep_folder
from gn0.storage import plain_path, storage_error, write_json, write_text
from gn0.training.runs.event_log import open_event_log
from gn0.training.runs.metrics_file import MetricsFile, read_metrics
from gn0.training.runs.recipe_text import list_recipe_differences
from gn0.training.runs.run_page import draw_run_page, name_devices
from gn0.training.runs.state_folder import (
    STATE,
    discard_states_after,
    find_latest,
    list_states,
    name_state,
    read_step,
)

if TYPE_CHECKING:
    from gn0.training.runs.training_state import TrainingState

RUN, METRICS, EVENTS, CHECKPOINTS, LOG = "run.json", "metrics.jsonl", "events", "checkpoints", "log"
PAGE = "page.html"
_ROOM = 64 << 20  # bytes, before any work; a state's own are asked for when it is saved


class RunSession(Config, frozen=True):
    """One process that trained.

    Attributes:
        began: UTC, ISO 8601.
        command: its words, as `describe_command` gives them.
        device: as `name_device` says it.
        versions: of packages.
        step: that it went on from; 0 at the beginning.
        processes: that trained together, each on a device of its own.
    """

    began: str
    command: list[str]
    device: str
    versions: dict[str, str]
    step: int
    processes: int = 1

    @property
    def devices(self) -> str:
        """The device, and how many of them."""
        return name_devices(self.device, self.processes)


class RunRecord(Config, frozen=True):
    """`run.json`.

    Attributes:
        stage: e.g. "sft".
        recipe: as `describe_recipe` gives it.
        hashes: of what decides the run, by name: corpus, weights that it began from, prompts.
        sessions: all that trained, in order.
        finished: the step at which it was done; None before.
        results: what came out, when finished.
    """

    stage: str
    recipe: dict[str, Any]
    hashes: dict[str, str]
    sessions: list[RunSession]
    finished: int | None = None
    results: dict[str, Any] = msgspec.field(default_factory=dict)

    @property
    def devices(self) -> str:
        """The devices of its sessions, each once."""
        return ", ".join(dict.fromkeys(session.devices for session in self.sessions))


class RunFolder:
    """The folder of a run that is being written; see `open_run`.

    Attributes:
        folder: where it lies.
        resumed: the state to go on from; None at the beginning.
        notes: what differs from the run so far and is allowed, in lines to be shown.
    """

    def __init__(
        self, folder: Path, record: RunRecord, resumed: Path | None, notes: tuple[str, ...]
    ) -> None:
        self.folder, self.resumed, self.notes = folder, resumed, notes
        self._record = record
        step = read_step(resumed) if resumed else 0
        told = step if resumed else -1  # step 0 is told anew where no state is of it
        write_json(folder / RUN, msgspec.to_builtins(record))  # first: by it a run is known
        self._metrics = MetricsFile(folder / METRICS, told)
        try:
            self._events = open_event_log(folder / EVENTS, told)
            self._log = (folder / LOG).open("a", encoding="utf-8")
        except OSError as error:
            raise storage_error(error, folder, "write") from error
        self.log(f"begins at step {step} on {record.sessions[-1].devices}")
        for note in notes:
            self.log(note)

    @property
    def checkpoints(self) -> Path:
        """Folder of the run's states."""
        return self.folder / CHECKPOINTS

    @property
    def finished(self) -> int | None:
        """The step at which the run was done; None before."""
        return self._record.finished

    def report(self, step: int, values: Mapping[str, float]) -> None:
        """Add a point to the curves; steps go up.

        Raises:
            TrainingError: the step is not after the last.
            StorageError: the disk is full or refuses.
        """
        self._metrics.add(step, values)
        if self._events is not None:
            try:
                self._events.add(step, values)
            except OSError as error:
                raise storage_error(error, self.folder / EVENTS, "write") from error

    def log(self, text: str) -> None:
        """Append a line to the log.

        Raises:
            StorageError: the disk is full or refuses.
        """
        try:
            self._log.write(f"{_now()} {text}\n")
            self._log.flush()
        except OSError as error:
            raise storage_error(error, self.folder / LOG, "write") from error

    def save(self, state: TrainingState, **options: Any) -> Path:
        """Save a state, with the metrics of its steps on the disk before it.

        Args:
            state: of a later step than the last.
            options: of `save_state`.

        Raises:
            StorageError: the disk is full or refuses.
        """
        from gn0.training.runs.training_state import save_state

        self._metrics.sync()
        return save_state(self.checkpoints, state, **options)

    def finish(self, step: int, results: Mapping[str, Any] | None = None) -> None:
        """Write down that the run is done, and what came out; after its last state is saved.

        What is no number (NaN, infinite) is written as null. The page of the run is written, too.

        Raises:
            StorageError: the disk is full or refuses.
        """
        self._metrics.sync()
        plain = {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in (results or {}).items()
        }
        self._record = msgspec.structs.replace(self._record, finished=step, results=plain)
        write_json(self.folder / RUN, msgspec.to_builtins(self._record))
        self.log(f"finished at step {step}")
        write_run_page(self.folder)

    def close(self) -> None:
        """Close all files."""
        self._metrics.close()
        self._log.close()
        if self._events is not None:
            self._events.close()


@contextlib.contextmanager
def open_run(
    folder: Path | str,
    *,
    stage: str,
    recipe: Mapping[str, Any],
    hashes: Mapping[str, str],
    command: list[str],
    device: str,
    versions: Mapping[str, str],
    processes: int = 1,
    free: Collection[str] = (),
    fresh: bool = False,
    from_step: int | None = None,
) -> Iterator[RunFolder]:
    """Begin a run in a folder, or go on with the one that is there; alone, until the block ends.

    What lies behind the state that is gone on from is cut off, so that each step is told once.

    Args:
        folder: made where it is not there.
        stage: e.g. "sft".
        recipe: as `describe_recipe` gives it.
        hashes: of what decides the run, by name.
        command: as `describe_command` gives it.
        device: as `name_device` says it.
        versions: of packages.
        processes: that train together.
        free: fields of the recipe that may differ from those of the run so far.
        fresh: forget what was trained there before.
        from_step: go on from the state of this step, and give up later ones; None: from the last.

    Raises:
        TrainingError: somebody else trains there, or it holds another run or something else, or no
            state of `from_step`.
        StorageError: the system refuses.
    """
    folder = plain_path(folder)
    check_room(folder, _ROOM)
    with lock_folder(folder, refuse=TrainingError, writer="training run"):
        sweep_folder(folder)
        if fresh:
            _forget(folder)
        before = _read_run(folder)
        notes: tuple[str, ...] = ()
        resumed: Path | None = None
        if before is not None:
            notes = _check_same(folder, before, stage, recipe, hashes, free)
            resumed = _find_state(folder / CHECKPOINTS, from_step)
            discard_states_after(folder / CHECKPOINTS, read_step(resumed) if resumed else 0)
        elif from_step is not None:
            raise TrainingError("no run to go on with", where=folder, remedy="check --out")
        session = RunSession(
            began=_now(),
            command=command,
            device=device,
            versions=dict(versions),
            step=read_step(resumed) if resumed else 0,
            processes=processes,
        )
        done = before.finished if before and before.finished == session.step else None
        record = RunRecord(
            stage=stage,
            recipe=dict(recipe),
            hashes=dict(hashes),
            sessions=[*(before.sessions if before else []), session],
            finished=done,
            results=before.results if before and done is not None else {},
        )
        run = RunFolder(folder, record, resumed, notes)
        try:
            yield run
        finally:
            run.close()


def read_run(folder: Path) -> RunRecord:
    """What `run.json` says.

    Raises:
        TrainingError: the folder holds no run.
        StorageError, FormatError: it cannot be read.
    """
    if not (folder / RUN).is_file():
        raise TrainingError(
            f"no training run: there is no {RUN}", where=folder, remedy="give the --out of a run"
        )
    return load_json(folder / RUN, RunRecord)


def count_card_seconds(folder: Path) -> float | None:
    """Seconds of training of a run, times the cards that it had then; None before its first report.

    Raises:
        TrainingError: the folder holds no run.
        StorageError, FormatError: a file cannot be read.
    """
    lines = [line for line in read_metrics(folder / METRICS) if line.get("seconds")]
    if not lines:
        return None
    sessions, total, before = read_run(folder).sessions, 0.0, 0.0
    for line in lines:
        begun = [one for one in sessions if one.step < line["step"]] or sessions[:1]
        total += (line["seconds"] - before) * begun[-1].processes
        before = line["seconds"]
    return total


def write_run_page(folder: Path | str) -> Path:
    """Write `page.html` of a run: curves, examinations, recipe and hashes.

    Returns:
        where it lies.

    Raises:
        TrainingError: the folder holds no run.
        StorageError, FormatError: a file cannot be read or written.
    """
    folder = plain_path(folder)
    record = msgspec.to_builtins(read_run(folder))
    page = folder / PAGE
    write_text(page, draw_run_page(folder.resolve().name, record, read_metrics(folder / METRICS)))
    return page


def _read_run(folder: Path) -> RunRecord | None:
    if (folder / RUN).is_file():
        return read_run(folder)
    if not holds_leftovers_only(folder):
        raise TrainingError(
            f"the folder holds something else: it has no {RUN}",
            where=folder,
            remedy="choose another --out",
        )
    return None


def _forget(folder: Path) -> None:
    if not (folder / RUN).is_file():
        return
    try:
        # run.json goes last: a folder that is half emptied can still be told
        for path in sorted(folder.iterdir(), key=lambda path: path.name == RUN):
            if path.name != LOCK:
                shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
    except OSError as error:
        raise storage_error(error, folder, "remove") from error


def _check_same(
    folder: Path,
    before: RunRecord,
    stage: str,
    recipe: Mapping[str, Any],
    hashes: Mapping[str, str],
    free: Collection[str],
) -> tuple[str, ...]:
    held, allowed = list_recipe_differences(before.recipe, recipe, free)
    held += list_recipe_differences(before.hashes, hashes)[0]
    if before.stage != stage:  # what else differs is all of it
        held = [f"it is {before.stage}, this is {stage}"]
    if held:
        raise TrainingError(
            f"the folder holds another run: {'; '.join(held)}",
            where=folder,
            remedy="choose another --out, or pass --fresh to forget that run",
        )
    return tuple(f"recipe: {text}" for text in allowed)


def _find_state(folder: Path, step: int | None) -> Path | None:
    if step is None:
        return find_latest(folder)
    path = folder / name_state(step)
    if not (path / STATE).is_file():
        there = list_states(folder)
        raise TrainingError(
            f"no checkpoint of step {step}",
            where=folder,
            remedy=f"those that are there: {', '.join(str(read_step(s)) for s in there)}",
        )
    return path


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
