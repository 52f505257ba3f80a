"""Figures of datasets: samples a second, what 47 million would take, crashes, reading again."""

from __future__ import annotations

import shutil
import time
from functools import cache
from pathlib import Path

import numpy as np

from gn0.data.build import build_dataset
from gn0.data.dataset import Dataset, FileRecord, open_dataset
from gn0.data.picture_build import render_dataset
from gn0.data.picture_cache import load_manifest
from gn0.data.settings import BuildSettings, PictureSettings
from gn0.data.verify import verify_dataset
from gn0.jobs.process import count_cores
from gn0.scenes.folder import load_scene, save_scene
from gn0.scenes.procedural.finish import floor_area
from gn0.scenes.procedural.generate import GenerateSettings, build_generated
from gn0.scenes.procedural.kinds import KINDS
from gn0.suites.suite import Suite, build_suite, load_suite
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_trials.crash_data import read_files, run_data_crashes

GAUSSIANS = 300_000
SAMPLES = 47_000_000  # of the paper
LEAST = 15.0  # samples/s on two cores
EPISODES = 24
ROUNDS = 3
KILLS = 200
LAYOUTS = {
    "webdataset": "tar shards with maps and goals, jpg quality 90",
    "lerobot": "AV1 crf 30, five videos",
}
SIZE = "FPV 480x360, mosaic 640x480"


@cache
def _apartment(work: Path) -> tuple[Suite, str]:
    """A generated apartment of 300 k Gaussians, its suite, and both in words."""
    folder = work / "apartment"
    if not (folder / "suite" / "suite.json").is_file():
        area = floor_area(KINDS["apartment"].draft(7, size="medium", style=None))
        settings = GenerateSettings(
            kind="apartment", seed=7, density=GAUSSIANS / area, light="draft"
        )
        save_scene(build_generated(settings, "apartment"), folder / "scene")
        build_suite([folder / "scene"], folder / "suite", EPISODES, 0, minimum_length=5.0)
    suite = load_suite(folder / "suite")
    count = len(load_scene(folder / "scene").gaussians)
    return suite, f"generated apartment, seed 7, {count:,} Gaussians, {len(suite.episodes)} goals"


def _settings(layout: str, *, visible_sets: bool = False) -> BuildSettings:
    pictures = PictureSettings(layout=layout, visible_sets=visible_sets)  # type: ignore[arg-type]
    return BuildSettings(chunk=4, pictures=pictures)


def _timed_build(suite: Suite, out: Path, settings: BuildSettings, workers: int) -> float:
    shutil.rmtree(out, ignore_errors=True)
    start = time.perf_counter()
    build_dataset(suite, out, settings, workers=workers)
    return time.perf_counter() - start


def _built(
    ctx: FigureContext, layout: str, workers: int = 2, tag: str = ""
) -> tuple[Dataset, float]:
    """A dataset of the apartment and the median of how long it took to build [s]."""
    suite, _ = _apartment(ctx.work)
    build_dataset(suite, ctx.work / "warm", _settings("none"))  # kernels and their cache
    spent = []
    for number in range(ROUNDS):
        out = ctx.work / f"{layout}{tag}-{number}"
        ctx.progress(f"building {layout}", number, ROUNDS)
        settings = _settings(layout, visible_sets=tag == "-visible")
        spent.append(_timed_build(suite, out, settings, workers))
    return open_dataset(out), float(np.median(spent))


def measure_samples(ctx: FigureContext) -> list[FigureRow]:
    """Whole builds with pictures by two workers: walks, labels, drawing, hashing, encoding."""
    rows = []
    _, scene = _apartment(ctx.work)
    for layout, encoding in LAYOUTS.items():
        dataset, seconds = _built(ctx, layout)
        detail = (
            f"{scene}; {dataset.about.rows} samples, {SIZE}, {encoding}, exact pictures; from the "
            f"start of two workers to the last byte, median of {ROUNDS}"
        )
        rows.append(
            row_at_least(
                f"full samples, {layout}, two cores", dataset.about.rows / seconds, LEAST,
                "samples/s", detail,
            )
        )  # fmt: skip
    dataset, seconds = _built(ctx, "webdataset", tag="-visible")
    rows.append(
        FigureRow(
            name="full samples from visible sets, webdataset, two cores",
            value=dataset.about.rows / seconds,
            unit="samples/s",
            detail=f"{scene}; as above, but the approximate pictures that dataset.json records",
        )
    )
    dataset, seconds = _built(ctx, "none", workers=1)
    rows.append(
        FigureRow(
            name="poses and labels alone, one process",
            value=dataset.about.rows / seconds,
            unit="samples/s",
            detail=f"{scene}; {dataset.about.rows} samples, scene and maps loaded, tables written",
        )
    )
    return rows


def measure_scale(ctx: FigureContext) -> list[FigureRow]:
    """Core-hours and bytes of 47 million samples, from the rates and sizes of whole builds."""
    _, scene = _apartment(ctx.work)
    rows = []
    for layout, encoding in LAYOUTS.items():
        dataset, seconds = _built(ctx, layout)
        share = dataset.about.rows
        rate = share / seconds
        detail = (
            f"from {rate:.1f} samples/s measured on two cores, CPU renderer; {scene}, {SIZE}, "
            f"{encoding}; no GPU rate was measured, so no GPU-hours are stated"
        )
        rows.append(
            FigureRow(
                name=f"47 M samples, CPU, {layout}",
                value=2 * SAMPLES / rate / 3600,
                unit="core-hours",
                detail=detail,
            )
        )
        manifest = load_manifest(dataset.folder, layout)
        assert manifest is not None
        size = sum(record.size for record in manifest.files if not _is_shared(record))
        rows.append(
            FigureRow(
                name=f"47 M samples, pictures as {layout}",
                value=size / share * SAMPLES / 1e12,
                unit="TB",
                detail=f"from {size / share / 1e3:.1f} kB a sample; {scene}, {SIZE}, {encoding}",
            )
        )
        table = sum(part.size for part in dataset.about.parts)
    rows.append(
        FigureRow(
            name="47 M samples, poses, labels and hashes",
            value=table / share * SAMPLES / 1e9,
            unit="GB",
            detail=f"from {table / share:.0f} bytes a sample of Parquet: the dataset itself",
        )
    )
    return rows


def _is_shared(record: FileRecord) -> bool:
    """Whether a file is there once a scene and light, however many samples there are."""
    return record.path.startswith("maps/")


def measure_crashes(ctx: FigureContext) -> list[FigureRow]:
    """Builds and renderings killed with -9 at random moments."""
    report = run_data_crashes(KILLS, ctx.work / "crash", progress=ctx.progress)
    detail = (
        f"{report.kills} kills at random moments of {report.runs} datasets: WebDataset, LeRobot, "
        "and labels drawn later; one or two workers"
    )
    if report.broken:
        detail += "; broke off: " + " | ".join(report.broken)
    rows = [
        row_at_most(f"samples {name} after resume", value, 0, "", detail)
        for name, value in (("lost", report.lost), ("twice", report.twice))
    ]
    rows += [
        row_at_most("unreadable files after resume", report.unreadable, 0, "", detail),
        row_at_most("parts forgotten by the journal", report.forgotten, 0, "", detail),
        row_at_most("temporary files left", report.leftovers, 0, "", detail),
        row_at_most(
            "datasets that differ from an unbroken one", report.runs - report.same, 0, "",
            detail + "; every byte compared",
        ),
    ]  # fmt: skip
    return rows


def measure_same(ctx: FigureContext) -> list[FigureRow]:
    """One or two workers, processes or Ray, labels first or not: the same bytes."""
    suite, scene = _apartment(ctx.work)
    few = Suite(suite.folder, suite.about, suite.episodes[:8])
    one = build_dataset(few, ctx.work / "same-1", _settings("webdataset"))
    expected = read_files(one.folder)
    rows = []

    def judge(name: str, folder: Path) -> None:
        found = read_files(folder)
        differ = [k for k in expected.keys() | found.keys() if expected.get(k) != found.get(k)]
        rows.append(
            row_at_most(
                f"files that differ, {name}", len(differ), 0, "",
                f"against one process; {scene}, {len(few.episodes)} of them, {len(expected)} files",
            )
        )  # fmt: skip

    build_dataset(few, ctx.work / "same-2", _settings("webdataset"), workers=2)
    judge("two workers", ctx.work / "same-2")
    try:
        import ray  # noqa: F401
    except ImportError:
        pass
    else:
        build_dataset(
            few, ctx.work / "same-ray", _settings("webdataset"), workers=2, executor="ray"
        )
        judge("two workers on Ray", ctx.work / "same-ray")
    again = ctx.work / "same-1"
    for path in sorted((again / "pictures").rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    render_dataset(again, workers=2)
    judge("pictures thrown away and rendered again", again)
    return rows


def measure_verify(ctx: FigureContext) -> list[FigureRow]:
    """How quickly a dataset is read again, from the page cache."""
    dataset, _ = _built(ctx, "webdataset")
    big = dataset.folder / "pictures" / "webdataset"
    rates = []
    for _ in range(5):
        start = time.perf_counter()
        report = verify_dataset(dataset.folder)
        rates.append(report.size / (time.perf_counter() - start) / 1e9)
        assert report.ok
    size = sum(path.stat().st_size for path in big.rglob("*") if path.is_file())
    detail = (
        f"{report.files} files, {report.size / 1e6:.0f} MB of which {size / 1e6:.0f} MB pictures, "
        f"in memory; blake2b, {count_cores()} threads, median of 5"
    )
    return [row_at_least("data verify", float(np.median(rates)), 1.0, "GB/s", detail)]


FIGURES = [
    Figure("data.samples", "Full samples a second", measure_samples, 3.0),
    Figure("data.scale", "What 47 million samples would take", measure_scale, 2.0),
    Figure("data.crash", "Datasets killed at random moments", measure_crashes, 12.0),
    Figure("data.same", "The same bytes however a dataset is built", measure_same, 1.0),
    Figure("data.verify", "Reading a dataset again", measure_verify, 1.0),
]
