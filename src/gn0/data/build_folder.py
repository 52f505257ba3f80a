"""A dataset folder while it is written: its parts, and the journal that names them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from gn0.data.dataset import DatasetFile
from gn0.data.part import PartDone, PartPlan
from gn0.jobs import ExecutorName, run_jobs
from gn0.progress import Progress
from gn0.storage import (
    Journal,
    journal_line,
    read_bytes,
    write_bytes,
)


def write_journal(path: Path, data: bytes) -> None:
    """Replace a journal by these lines, unless it holds exactly them.

    Raises:
        StorageError: it cannot be written.
    """
    if not (path.is_file() and read_bytes(path) == data):
        write_bytes(path, data)


def parts_journal(about: DatasetFile) -> bytes:
    """The journal of a whole dataset: its parts in order, whatever order they were made in."""
    return b"".join(journal_line({"part": msgspec.to_builtins(part)}) for part in about.parts)


def run_parts(
    function: str,
    plans: Sequence[PartPlan],
    done: Mapping[str, PartDone],
    journal_path: Path,
    *,
    workers: int,
    executor: ExecutorName,
    ray_address: str,
    gpus: float = 0,
    progress: Progress,
    check: Callable[[PartPlan, PartDone], None],
) -> dict[str, PartDone]:
    """Run a function of `gn0.data.part` on each plan that is not done; the journal hears of each.

    Raises:
        Gn0Error: what a part raised.
    """
    parts = {plan.name: done[plan.name] for plan in plans if plan.name in done}
    left = [plan for plan in plans if plan.name not in parts]
    with Journal(journal_path) as journal:

        def take(index: int, answer: dict[str, Any]) -> None:
            made = msgspec.convert(answer, PartDone)
            check(left[index], made)
            journal.append(answer)
            parts[made.part.name] = made
            tell()

        def tell() -> None:
            progress("parts", len(parts), len(plans))
            progress("samples", sum(made.part.rows for made in parts.values()), 0)

        tell()
        run_jobs(
            f"gn0.data.part:{function}",
            [msgspec.to_builtins(plan) for plan in left],
            workers=workers,
            executor=executor,
            ray_address=ray_address,
            gpus=gpus,
            names=[f"part {plan.name}" for plan in left],
            done=take,
            steps=progress,
        )
    return parts


def read_done(path: Path) -> dict[str, PartDone]:
    """Parts that a journal names, by name; the last word counts.

    Raises:
        StorageError: it cannot be read.
    """
    found = {}
    for record in Journal(path).read():
        if isinstance(record, dict) and "part" in record:
            with contextlib.suppress(msgspec.ValidationError):
                made = msgspec.convert(record, PartDone)
                found[made.part.name] = made
    return found
