"""Whether a dataset exporter keeps the protocol: run a plug-in's class against it.

from gn0.testing.dataset_exporter_check import check_dataset_exporter
check_dataset_exporter(MyExporter)
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gn0.errors import Gn0Error, StorageError
from gn0.export.export_card import CARD
from gn0.export.export_file import EXPORT_FILE
from gn0.export.export_run import JOURNAL, run_export
from gn0.export.exporter import DatasetExporter, ExportSettings
from gn0.export.trips import RGBD, ExportSource, Recovered, Trip, differing_fields
from gn0.testing.toy_trips import toy_source

PICTURE_TOLERANCE = 8.0  # mean difference of a colour value after JPEG or video, of 255
DEPTH_TOLERANCE = 0.01  # m, below DEPTH_REACH
DEPTH_REACH = 6.0  # m: formats cut depth off somewhere beyond
DAMAGED = 6  # files of an export that are damaged one after the other


class _StoppedError(Exception):
    """A run that is interrupted on purpose."""


def check_dataset_exporter(
    factory: Callable[[], DatasetExporter],
    source: ExportSource | None = None,
    settings: ExportSettings | None = None,
) -> None:
    """Check an exporter: round trip, same bytes, going on after a stop, damage, strangers.

    Args:
        factory: builds the exporter (a class without required arguments will do).
        source: the dataset; a small one of floor plans by default.
        settings: how to export.

    Raises:
        AssertionError: the first rule that is broken, in plain words.
    """
    exporter = factory()
    source = source or toy_source()
    settings = settings or ExportSettings()
    for name in ("name", "title", "reader", "frame"):
        assert getattr(exporter, name), f"the exporter has no {name}"
    with tempfile.TemporaryDirectory() as scratch:
        first = Path(scratch) / "first"
        check_round_trip(exporter, source, first, settings)
        _same_bytes(exporter, source, first, settings)
        _goes_on(exporter, source, first, settings)
        _refuses_others(exporter, source, first, settings)
        _finds_damage(exporter, first)
        _refuses_strangers(exporter, Path(scratch))


def check_round_trip(
    exporter: DatasetExporter, source: ExportSource, folder: Path, settings: ExportSettings
) -> list[tuple[Trip, Recovered]]:
    """Export, check, read back and compare; the trips with what was read.

    Raises:
        AssertionError: a fault, or a field that differs.
    """
    done = run_export(source, exporter, folder, settings)
    faults = exporter.check(folder)
    assert not faults, f"it finds faults in what it wrote: {faults[0]}"
    found = exporter.load(folder)
    assert len(found) == done.written, f"{done.written} episodes go in, {len(found)} come out"
    told = done.written + sum(done.skipped.values())
    trips = {trip.episode.id: trip for trip in source.trips()}
    assert told == len(trips), f"{len(trips) - told} episodes are neither written nor left out"
    pairs = []
    for recovered in found:
        assert recovered.id in trips, f"episode {recovered.id!r} comes out of nowhere"
        trip = trips[recovered.id]
        wrong = differing_fields(trip, recovered, exporter.poses(trip, settings))
        assert not wrong, f"episode {recovered.id!r}: {', '.join(wrong)} changes on the way"
        pairs.append((trip, recovered))
    if exporter.pictures:
        for trip, recovered in pairs[:2]:
            colour, far = picture_difference(exporter, source, trip, recovered, settings)
            assert colour < PICTURE_TOLERANCE, f"a picture differs by {colour:.1f} of 255"
            assert far < DEPTH_TOLERANCE, f"a depth differs by {far:.3f} m"
    return pairs


def picture_difference(
    exporter: DatasetExporter,
    source: ExportSource,
    trip: Trip,
    found: Recovered,
    settings: ExportSettings,
) -> tuple[float, float]:
    """How far first, middle and last picture are from what was seen, the worst of each.

    Returns:
        (mean difference of a colour value, of 255; greatest difference of depths below 6 m [m]).

    Raises:
        AssertionError: a picture is missing or changes its size.
    """
    assert found.picture is not None, "it holds pictures and does not read them"
    poses = exporter.poses(trip, settings)
    rows = sorted({0, len(poses) // 2, len(poses) - 1})
    camera = exporter.cameras(source, settings)[0]
    colour = far = 0.0
    look = source.eyes.look(trip, poses[rows], camera, RGBD)
    for row, seen in zip(rows, look, strict=True):
        back = found.picture(row)
        assert seen.rgb is not None and seen.depth is not None
        assert back.rgb is not None, "it reads no colours"
        assert back.rgb.shape == seen.rgb.shape, f"picture {row} changes its size"
        colour = max(colour, float(np.abs(back.rgb.astype(np.int64) - seen.rgb).mean()))
        if back.depth is not None:
            near = seen.depth < DEPTH_REACH
            far = max(far, float(np.abs(back.depth - seen.depth)[near].max(initial=0.0)))
    return colour, far


def read_tree(folder: Path) -> dict[str, bytes]:
    """The bytes of every file, by its path."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def _same_bytes(
    exporter: DatasetExporter, source: ExportSource, first: Path, settings: ExportSettings
) -> None:
    again = first.with_name("again") / first.name
    run_export(source, exporter, again, settings)
    one, two = read_tree(first), read_tree(again)
    wrong = sorted(k for k in one.keys() | two.keys() if one.get(k) != two.get(k))
    assert not wrong, f"a second export differs: {wrong[0]}"
    assert not any(name.endswith(JOURNAL) for name in one), "the journal is left behind"
    assert {EXPORT_FILE, CARD} <= set(one), "export.json or README.md is missing"


def _goes_on(
    exporter: DatasetExporter, source: ExportSource, first: Path, settings: ExportSettings
) -> None:
    stopped = first.with_name("stopped") / first.name

    def stop(stage: str, done: int, total: int) -> None:
        if stage == "episodes" and done == 1:
            raise _StoppedError

    try:
        run_export(source, exporter, stopped, settings, progress=stop)
        raise AssertionError("it swallows what progress raises")
    except _StoppedError:
        pass
    assert exporter.check(stopped) != [], "it calls a half export good"
    run_export(source, exporter, stopped, settings)
    same = read_tree(stopped) == read_tree(first)
    assert same, "an export that went on after a stop differs from one that did not"
    before = {path: path.stat().st_mtime_ns for path in stopped.rglob("*")}
    run_export(source, exporter, stopped, settings)
    assert before == {path: path.stat().st_mtime_ns for path in stopped.rglob("*")}, (
        "a finished export is written again"
    )


def _refuses_others(
    exporter: DatasetExporter, source: ExportSource, first: Path, settings: ExportSettings
) -> None:
    from msgspec.structs import replace

    other = replace(settings, name=f"{settings.name}2")
    try:
        run_export(source, exporter, first, other)
        raise AssertionError("it writes another export over the first")
    except StorageError:
        pass


def _finds_damage(exporter: DatasetExporter, first: Path) -> None:
    files = [
        path
        for path in sorted(first.rglob("*"))
        if path.is_file() and path.name not in (EXPORT_FILE, CARD)
    ]
    chosen = {files[n * (len(files) - 1) // max(DAMAGED - 1, 1)] for n in range(DAMAGED)}
    damaged = first.with_name("damaged")
    shutil.copytree(first, damaged)
    for path in sorted(chosen):
        target = damaged / path.relative_to(first)
        whole = path.read_bytes()
        for what, data in (
            ("missing", None),
            ("cut short", whole[: len(whole) // 2]),
            ("scrambled", bytes(reversed(whole))),
        ):
            target.unlink(missing_ok=True)
            if data is not None:
                target.write_bytes(data)
            told = _told(exporter, damaged)
            assert told, f"it does not notice that {path.relative_to(first)} is {what}"
        target.unlink(missing_ok=True)
        target.write_bytes(whole)


def _told(exporter: DatasetExporter, folder: Path) -> bool:
    """Whether an exporter tells of a fault, in checking or in reading."""
    faults = exporter.check(folder)
    try:
        exporter.load(folder)
    except Gn0Error:
        return True
    return bool(faults)


def _refuses_strangers(exporter: DatasetExporter, scratch: Path) -> None:
    for name in ("absent", "empty"):
        path = scratch / name
        if name == "empty":
            path.mkdir()
        assert exporter.check(path), f"it finds no fault in a folder that is {name}"
        try:
            exporter.load(path)
        except Gn0Error:
            continue
        except Exception as error:
            raise AssertionError(
                f"reading a folder that is {name} raised {type(error).__name__}"
            ) from error
        raise AssertionError(f"reading a folder that is {name} did not fail")
