"""The board: every figure of merit with its target, its command and the place it was measured."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from gn0.config import load_json
from gn0.progress import Progress, no_progress
from gn0.storage import write_json, write_text


class FigureSkipped(Exception):  # noqa: N818
    """This machine lacks what a figure needs; the text says what."""


@dataclass(frozen=True)
class FigureContext:
    """What a measurement may use.

    Attributes:
        data: folder of third-party test data (`$GN0_DATA`), or None.
        work: a scratch folder.
        progress: progress sink.
        device: the accelerator of figures that need one; its emulation asks for tiny sizes.
        scenes: folder of scenes made beforehand, or None.
        report: takes rows as soon as they are measured, so that they outlive what fails later.
    """

    data: Path | None
    work: Path
    progress: Progress = no_progress
    device: Any = None
    scenes: Path | None = None
    report: Callable[[FigureRow], None] = field(default=lambda row: None, repr=False)

    def need_data(self, relative: str) -> Path:
        """A path under the data folder.

        Raises:
            FileNotFoundError: no such data on this machine.
        """
        if self.data is None or not (self.data / relative).exists():
            raise FileNotFoundError(relative)
        return self.data / relative


class FigureRow(msgspec.Struct, frozen=True, kw_only=True):
    """One measured number.

    Attributes:
        name: what was measured, e.g. "A* mean, 400x400".
        value: the number; unit says of what.
        target: the target in words, e.g. "<= 2 ms".
        passed: whether the target is met; None where there is none.
        detail: scene and settings.
    """

    name: str
    value: float
    unit: str
    target: str = ""
    passed: bool | None = None
    detail: str = ""


@dataclass(frozen=True)
class Figure:
    """A measurement: `gn0 figures ID` runs it.

    Attributes:
        id: room and topic, e.g. "maps.astar".
        title: one line.
        measure: runs it and returns rows; raises FileNotFoundError when its data is absent,
            FigureSkipped when this machine lacks something else.
        minutes: rough length on two cores, or on the card where it needs one.
        backend: "cuda" where it needs a GPU.
    """

    id: str
    title: str
    measure: Callable[[FigureContext], list[FigureRow]] = field(repr=False)
    minutes: float = 1.0
    backend: str = ""


def row_at_most(name: str, value: float, limit: float, unit: str, detail: str = "") -> FigureRow:
    """A row that passes when value <= limit."""
    return FigureRow(
        name=name,
        value=float(value),
        unit=unit,
        target=f"≤ {limit:g} {unit}",
        passed=bool(value <= limit),
        detail=detail,
    )


def row_at_least(name: str, value: float, limit: float, unit: str, detail: str = "") -> FigureRow:
    """A row that passes when value >= limit."""
    return FigureRow(
        name=name,
        value=float(value),
        unit=unit,
        target=f"≥ {limit:g} {unit}",
        passed=bool(value >= limit),
        detail=detail,
    )


class BoardEntry(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One figure on the board with the rows of its last run; `note` says why there are few."""

    id: str
    title: str
    rows: list[FigureRow]
    hardware: str
    date: str
    version: str
    note: str = ""


def hardware_name() -> str:
    """CPU model and core count of this machine."""
    model = platform.processor() or platform.machine()
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                model = line.split(":", 1)[1].strip()
                break
    except OSError:
        pass
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{model}, {cores} cores, Python {platform.python_version()}"


def load_board(path: Path) -> dict[str, BoardEntry]:
    """The board's JSON side file; empty when absent."""
    if not path.exists():
        return {}
    return {entry.id: entry for entry in load_json(path, list[BoardEntry])}


def write_board(folder: Path, entries: Iterable[BoardEntry]) -> None:
    """Write `figures.json` and `figures.md` into `folder`."""
    ordered = sorted(entries, key=lambda entry: entry.id)
    write_json(folder / "figures.json", msgspec.to_builtins(ordered))
    write_text(folder / "figures.md", board_markdown(ordered))


def board_markdown(entries: list[BoardEntry]) -> str:
    """The board as Markdown: a table a figure."""
    lines = [
        "# Figures",
        "",
        "Written by `gn0 figures`; every row names the command that measures it again.",
        "Timings are medians on the hardware named; ratios are taken in one run.",
        "",
    ]
    rows = [row for entry in entries for row in entry.rows]
    met = sum(row.passed is True for row in rows)
    missed = sum(row.passed is False for row in rows)
    unmeasured = sum(not entry.rows for entry in entries)
    lines += [
        f"{met} targets met, {missed} missed, {len(rows) - met - missed} without a target"
        + (f"; {unmeasured} figures not measured yet." if unmeasured else "."),
        "",
    ]
    for entry in entries:
        lines += [f"## {entry.title}", ""]
        if not entry.rows:
            lines += [f"`gn0 figures {entry.id}` · not measured: {entry.note}", ""]
            continue
        place = f"{entry.hardware} · {entry.date} · gn0 {entry.version}"
        lines += [f"`gn0 figures {entry.id}` · {place}", ""]
        if entry.note:
            lines += [f"**Unfinished:** {entry.note}", ""]
        lines += [
            "| figure | value | target | met | scene and settings |",
            "| --- | --- | --- | --- | --- |",
        ]
        for row in entry.rows:
            mark = {True: "yes", False: "**no**", None: "–"}[row.passed]
            lines.append(
                f"| {row.name} | {row.value:.4g} {row.unit} | {row.target or '–'} | {mark} "
                f"| {row.detail or '–'} |"
            )
        lines.append("")
    return "\n".join(lines)
