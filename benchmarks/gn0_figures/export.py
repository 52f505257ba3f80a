"""Figures of exports: what comes back, what the checks find, and VLN-CE beside the real files."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import msgspec

from gn0.config import load_json
from gn0.data.build import build_dataset
from gn0.data.settings import BuildSettings, PictureSettings
from gn0.export.dataset_source import open_source
from gn0.export.export_run import check_export, run_export
from gn0.export.exporter import ExportSettings, dataset_exporter_names, get_dataset_exporter
from gn0.export.schema import describe_shape, shape_differences
from gn0.export.trips import ExportSource, Trip, differing_fields
from gn0.export.vlnce import MAPS, R2R_SHAPE, TRUTH_SHAPE
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.missions.sets.json_file import load_exact
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.suites.suite import save_suite
from gn0.testing.dataset_exporter_check import PICTURE_TOLERANCE, picture_difference
from gn0.testing.toy_trips import toy_source, toy_source_for
from gn0_figures.board import (
    Figure,
    FigureContext,
    FigureRow,
    FigureSkipped,
    row_at_least,
    row_at_most,
)

REAL = "vln/R2R_VLNCE_v1-2_preprocessed"
EPISODES = 4
READER_CHECKS = 14
TOY = "6 trips with two missions of a path, in 2 floor plans"


def _flat(ctx: FigureContext) -> ExportSource:
    """A dataset of the small flat: poses and labels, pictures drawn as they are asked for."""
    root = ctx.work / "flat-walks"
    if not (root / "data").is_dir():
        save_scene(build_example_scene(), root / "flat")
        scene = load_scene(root / "flat")
        episodes = sample_goal_episodes(scene, NavigationMap(scene.grid, 0.2), EPISODES, 0)
        suite = save_suite(root / "suite", [scene], episodes, name="flat")
        pictures = PictureSettings(layout="none")
        build_dataset(suite, root / "data", BuildSettings(pictures=pictures))
    return open_source(root / "data")


def _round_trip(
    source: ExportSource, name: str, out: Path, settings: ExportSettings
) -> tuple[int, int, int, int, float, float]:
    """(fields that differ, faults, files, frames or episodes, seconds, difference of pictures)."""
    exporter = get_dataset_exporter(name)
    begin = time.perf_counter()
    done = run_export(source, name, out, settings)
    seconds = time.perf_counter() - begin
    trips: dict[str, Trip] = {trip.episode.id: trip for trip in source.trips()}
    found = exporter.load(out)
    told = done.written + sum(done.skipped.values())
    differing = abs(len(found) - done.written) + abs(told - len(trips))
    colour = 0.0
    for recovered in found:
        trip = trips.get(recovered.id)
        if trip is None:
            differing += 1
            continue
        differing += len(differing_fields(trip, recovered, exporter.poses(trip, settings)))
        if exporter.pictures:
            off, _ = picture_difference(exporter, source, trip, recovered, settings)
            colour = max(colour, off)
    files = sum(path.is_file() for path in out.rglob("*"))
    amount = done.frames if exporter.pictures else done.written
    return differing, len(check_export(out)), files, amount, seconds, colour


def measure_round_trips(ctx: FigureContext) -> list[FigureRow]:
    """Each format written, checked, read back and compared field by field."""
    rows: list[FigureRow] = []
    flat, settings = _flat(ctx), ExportSettings(merge_turns=True)
    names = dataset_exporter_names()
    for done, name in enumerate(names):
        ctx.progress("formats", done, len(names))
        sums = [0, 0, 0, 0]
        seconds = colour = 0.0
        for kind, source in (("toy", toy_source_for(name)), ("flat", flat)):
            out = ctx.work / f"{kind}-{name}"
            *counts, spent, off = _round_trip(source, name, out, settings)
            sums = [a + b for a, b in zip(sums, counts, strict=True)]
            seconds += spent
            colour = max(colour, off)
        detail = f"{TOY}, and {EPISODES} rendered episodes of the small flat; {sums[2]} files"
        rows.append(row_at_most(f"{name}, fields that differ", sums[0], 0, "fields", detail))
        rows.append(row_at_most(f"{name}, faults found by its check", sums[1], 0, "faults", detail))
        if get_dataset_exporter(name).pictures:
            rows.append(
                row_at_most(
                    f"{name}, mean difference of a colour in the worst picture",
                    colour,
                    PICTURE_TOLERANCE,
                    "of 255",
                    f"{detail}; first, middle and last picture of each episode",
                )
            )
        what = "frames" if get_dataset_exporter(name).pictures else "episodes"
        rows.append(
            FigureRow(
                name=f"{name}, rate",
                value=sums[3] / seconds,
                unit=f"{what}/s",
                detail=f"{detail}; {sums[3]} {what} in {seconds:.2f} s: rendering, encoding, disk",
            )
        )
    return rows


class ReadersResult(msgspec.Struct):
    """What `make readers` wrote into docs/readers.json."""

    date: str
    versions: dict[str, str]
    passed: int
    failed: int
    skipped: int
    seconds: float


def measure_readers(ctx: FigureContext) -> list[FigureRow]:
    """The last result of `make readers`: the packages of others over what we write."""
    path = Path(__file__).parents[2] / "docs/readers.json"
    if not path.is_file():
        raise FigureSkipped("no docs/readers.json: run `make readers` in a checkout")
    last = load_json(path, ReadersResult)
    packages = ", ".join(f"{name} {version}" for name, version in last.versions.items() if version)
    detail = (
        f"`make readers` of {last.date}: {packages}; torchvision stubbed; every field of the "
        "LeRobot cache and export, of shards alone, of the card's head, of exported tables"
    )
    return [
        row_at_most("readers of others, checks that fail", last.failed, 0, "checks", detail),
        row_at_most("readers of others, checks not run", last.skipped, 0, "checks", detail),
        row_at_least("readers of others, checks that pass", last.passed, READER_CHECKS, "checks",
                     detail),
    ]  # fmt: skip


def measure_vlnce_shape(ctx: FigureContext) -> list[FigureRow]:
    """VLN-CE files of ours against the real ones: keys, their order, types."""
    folder = ctx.need_data(f"{REAL}/val_seen")
    real = _shapes(folder / "val_seen.json.gz", folder / "val_seen_gt.json.gz")
    train = describe_shape(load_exact(ctx.need_data(f"{REAL}/train/train.json.gz")), MAPS)
    out = ctx.work / "vlnce-shape"
    run_export(toy_source(), "vlnce-r2r", out, ExportSettings())
    wrong: list[str] = []
    for split in ("train", "test"):
        ours = _shapes(out / f"{split}/{split}.json.gz", out / f"{split}/{split}_gt.json.gz")
        for found, wanted in zip(ours, real, strict=True):
            wrong += shape_differences(found, wanted)
    known = shape_differences(real[0], R2R_SHAPE) + shape_differences(real[1], TRUTH_SHAPE)
    detail = "exports of 6 toy trips against R2R_VLNCE_v1-2 val_seen and its ground truth"
    return [
        row_at_most("VLN-CE export, differences in shape", len(wrong), 0, "fields", detail),
        row_at_most(
            "VLN-CE check, differences from the real val_seen and train",
            len(known) + len(shape_differences(train, R2R_SHAPE)),
            0,
            "fields",
            "the shape that `gn0 export check` holds files against",
        ),
    ]


def _shapes(document: Path, truth: Path) -> tuple[Any, Any]:
    return (
        describe_shape(load_exact(document), MAPS),
        describe_shape({"truth": load_exact(truth)}, MAPS)["truth"],
    )


FIGURES = [
    Figure("data.export.readers", "Exports in the packages of others", measure_readers, 0.1),
    Figure("data.export.roundtrip", "Exports: round trips and checks", measure_round_trips, 4.0),
    Figure("data.export.vlnce", "VLN-CE export beside the real files", measure_vlnce_shape, 0.5),
]
