"""Figures of the splat readers: speed, memory, loss of packing, and what mutants do to them."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np

from gn0.errors import FormatError
from gn0.gaussians.ply import save_ply
from gn0.gaussians.ply_packed import save_ply_packed
from gn0.gaussians.splat_files import load_cloud
from gn0.seeds import random_stream
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_figures.flat import build_flat
from gn0_trials.fuzz import TARGETS, FuzzReport, find_target, fuzz_reader
from gn0_trials.peak_memory import peak_memory_bytes
from gn0_trials.splat_corpus import (
    DIALECTS,
    build_ply,
    check_cloud_file,
    dialect_degree,
    ply_columns,
    small_cloud,
)
from gn0_trials.splat_transform import (
    find_splat_transform,
    round_trip_errors,
    run_splat_transform,
)

COUNT = 1_000_000
MUTANTS = 1_000_000
_PARTS = 16  # of them, each of a seed of its own
CUTS = 2000
ALLOWANCE = 64e6  # bytes beyond the multiple of the decoded cloud
FIELDS = ("means", "quats", "scales", "opacities", "sh")


def peak_of_reading(path: Path) -> tuple[int, int]:
    """(decoded bytes, growth of peak memory) of reading a file in a process of its own."""
    call = "import sys; from gn0_figures.gaussians import report_peak; report_peak(sys.argv[1])"
    out = subprocess.run(
        [sys.executable, "-c", call, str(path)], capture_output=True, text=True, check=True
    )
    decoded, growth = out.stdout.split()
    return int(decoded), int(growth)


def report_peak(path: str) -> None:
    """Read a file and write two numbers to standard output: see `peak_of_reading`."""
    before = peak_memory_bytes()
    try:
        cloud = load_cloud(path).cloud
        decoded = sum(getattr(cloud, name).nbytes for name in FIELDS)
    except FormatError:
        decoded = 0
    growth = peak_memory_bytes() - before
    sys.stdout.write(f"{decoded} {growth}")


def median_seconds(act: Callable[[], object], runs: int = 5) -> float:
    """Median wall time of a few runs [s]."""
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        act()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def _read_whole(path: Path) -> None:
    """Read a file's bytes and touch them all: the floor under any reader."""
    np.fromfile(path, np.uint8).sum(dtype=np.uint64)


def measure_reading(ctx: FigureContext) -> list[FigureRow]:
    """Time and peak memory of reading and writing a million Gaussians."""
    rows = []
    for degree in (0, 3):
        cloud = build_flat(COUNT, sh_degree=degree)
        for name, save in (("PLY", save_ply), ("compressed PLY", save_ply_packed)):
            ctx.progress("splat files", degree * 2 + (name != "PLY"), 8)
            path = ctx.work / f"flat-{degree}-{name.split()[0]}.ply"
            label = f"{name}, 1 M, SH {degree}"
            detail = f"standard flat, {COUNT} Gaussians, median of 5, one thread"
            written = median_seconds(partial(save, cloud, path), 3)
            size = path.stat().st_size / 1e6
            read = median_seconds(partial(load_cloud, path))
            floor = median_seconds(partial(_read_whole, path))
            rows.append(row_at_most(f"read {label}", read, 1.0, "s", f"{detail}; {size:.0f} MB"))
            rows.append(
                FigureRow(
                    name=f"read {label} / reading its bytes",
                    value=read / floor,
                    unit="×",
                    detail=detail,
                )
            )
            rows.append(FigureRow(name=f"write {label}", value=written, unit="s", detail=detail))
            decoded, growth = peak_of_reading(path)
            rows.append(
                row_at_most(
                    f"memory of reading {label}, less 64 MB",
                    max(0.0, growth - ALLOWANCE) / decoded,
                    2.5,
                    "× decoded",
                    f"growth of the peak {growth / 1e6:.0f} MB, decoded {decoded / 1e6:.0f} MB, "
                    "a process of its own",
                )
            )
            path.unlink()
    return rows


def measure_packing(ctx: FigureContext) -> list[FigureRow]:
    """Our compressed PLY against splat-transform's on real splats, both ways."""
    call = find_splat_transform()
    if call is None:
        raise FileNotFoundError("splat-transform (npm install -g @playcanvas/splat-transform)")
    guitar = ctx.need_data("splats/playcanvas/guitar.compressed.ply")
    leica = ctx.need_data("splats/leica-sofort/leica-sofort-top8192.ply")
    work = ctx.work
    theirs = load_cloud(run_splat_transform(call, guitar, work / "guitar.ply")).cloud
    ours = load_cloud(guitar).cloud
    worst = max(float(np.abs(getattr(ours, n) - getattr(theirs, n)).max()) for n in FIELDS)
    rows = [
        row_at_most(
            "we read theirs: largest difference of any value",
            worst,
            1e-6,
            "",
            f"guitar, {len(ours)} Gaussians, against splat-transform's own decoding",
        )
    ]
    source = load_cloud(leica).cloud
    order = save_ply_packed(source, work / "ours.compressed.ply")
    ours = load_cloud(work / "ours.compressed.ply").cloud
    back = run_splat_transform(call, work / "ours.compressed.ply", work / "ours.ply")
    judged = load_cloud(back).cloud
    worst = max(float(np.abs(getattr(ours, n) - getattr(judged, n)).max()) for n in FIELDS)
    detail = f"leica-sofort, {len(source)} Gaussians, SH 3"
    rows.append(row_at_most("they read ours: largest difference", worst, 1e-6, "", detail))
    packed = load_cloud(run_splat_transform(call, leica, work / "theirs.compressed.ply")).cloud
    ordered = load_cloud(run_splat_transform(call, leica, work / "order.ply", "-M")).cloud
    mine = round_trip_errors(source.select(order), judged)
    other = round_trip_errors(ordered, packed)
    for name, error in mine.items():
        rows.append(
            row_at_most(
                f"round-trip error, {name}: ours / theirs",
                error / other[name],
                1.01,
                "×",
                f"{detail}; root mean square {error:.3g} against {other[name]:.3g}",
            )
        )
    return rows


def measure_dialects(ctx: FigureContext) -> list[FigureRow]:
    """Dialects read to the same Gaussians; cuts of a file refused; forged counts in memory."""
    alike = 0
    path = ctx.work / "dialect.ply"
    for dialect in DIALECTS.values():
        cloud = small_cloud(50, dialect_degree(dialect))
        path.write_bytes(build_ply(dialect, ply_columns(cloud)))
        file = load_cloud(path)
        check_cloud_file(file)
        alike += all(
            np.allclose(getattr(file.cloud, n), getattr(cloud, n), rtol=2e-6, atol=2e-6)
            for n in FIELDS
        )
    sound = build_ply(DIALECTS["inria-sh3"], ply_columns(small_cloud(50, 3)))
    stream = random_stream(0, "figure cuts")
    refused = 0
    for end in stream.integers(0, len(sound), CUTS):
        path.write_bytes(sound[: int(end)])
        try:
            load_cloud(path)
        except FormatError as error:
            refused += error.offset is not None and bool(error.remedy)
    path.write_bytes(sound.replace(b"vertex 50", b"vertex 1000000000000"))
    _, growth = peak_of_reading(path)
    return [
        row_at_least(
            "dialects read to the same Gaussians",
            100 * alike / len(DIALECTS),
            100,
            "%",
            f"{len(DIALECTS)} property orders, types, byte orders and line ends (≥ 25 wanted)",
        ),
        row_at_least(
            "cut files refused with place and remedy", 100 * refused / CUTS, 100, "%",
            f"{CUTS} cuts of one SH 3 file",
        ),
        row_at_most(
            "memory of refusing a header of 10¹² Gaussians", growth / 1e6, 64, "MB",
            "growth of the peak, a process of its own",
        ),
    ]  # fmt: skip


def _fuzz(name: str, part: int) -> FuzzReport:
    return fuzz_reader(find_target(name), count=MUTANTS // _PARTS, seed=2026 + part)


def measure_fuzz(name: str, ctx: FigureContext) -> list[FigureRow]:
    """A million mutants for one reader, the same for any number of cores."""
    workers = min(os.cpu_count() or 1, _PARTS)
    parts: list[FuzzReport] = []
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        for part in pool.map(_fuzz, [name] * _PARTS, range(_PARTS)):
            parts.append(part)
            ctx.progress(f"mutants of {name}", len(parts), _PARTS)
    inputs, read, refused = (
        sum(getattr(part, field) for part in parts) for field in ("inputs", "accepted", "refused")
    )
    detail = f"{inputs} inputs, {read} read, {refused} refused"
    faults = [f"{fault.seed_name}: {fault.what}" for part in parts for fault in part.faults]
    if faults:
        detail += "; " + "; ".join(faults[:3])
    slowest = max(part.slowest_s for part in parts)
    growth = max(part.peak_growth_bytes for part in parts)
    return [
        row_at_most("foreign exceptions", sum(part.foreign for part in parts), 0, "", detail),
        row_at_most(
            "hangs (> 1 s a MB)", sum(part.hangs for part in parts), 0, "",
            f"slowest {slowest * 1e3:.0f} ms of processor time",
        ),
        row_at_most("growth of peak memory", growth / 1e6, 64, "MB", "inputs of 0.3 to 20 kB"),
    ]  # fmt: skip


FIGURES: list[Figure] = [
    Figure("gaussians.read", "Reading and writing splats", measure_reading, 1.0),
    Figure("gaussians.packed", "Compressed PLY against splat-transform", measure_packing, 0.2),
    Figure("gaussians.dialects", "Dialects, cuts and forged counts", measure_dialects, 0.2),
    *(
        Figure(f"fuzz.{name}", f"A million mutants of {name}", partial(measure_fuzz, name), 3.0)
        for name in sorted(TARGETS)
        if not name.startswith("wire")  # those are policies.fuzz
    ),
]
