"""Figures of every splat format but PLY: speed, memory, forged counts, and what the judge says."""

from __future__ import annotations

import gzip
import json
import struct
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from gn0.errors import FormatError
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.splat_files import load_cloud
from gn0.testing.splat_writers import (
    build_gltf,
    build_ksplat,
    build_sog,
    build_sog_streamed,
    build_splat,
    build_spz,
)
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_figures.flat import build_flat
from gn0_figures.gaussians import ALLOWANCE, COUNT, FIELDS, median_seconds, peak_of_reading
from gn0_trials.splat_corpus import small_cloud
from gn0_trials.splat_transform import find_splat_transform, run_splat_transform

WRITERS: dict[str, tuple[str, Callable[[GaussianCloud], bytes]]] = {  # name -> (suffix, writer)
    ".splat": (".splat", build_splat),
    "SPZ 2 (gzip)": (".spz", partial(build_spz, version=2)),
    "SPZ 4 (ZSTD)": (".spz", partial(build_spz, version=4)),
    "SOG 1": (".sog", partial(build_sog, version=1)),
    "SOG 2": (".sog", build_sog),
    "KSPLAT 0": (".ksplat", partial(build_ksplat, compression=0)),
    "KSPLAT 2": (".ksplat", partial(build_ksplat, compression=2)),
    "glTF (.glb)": (".glb", lambda cloud: build_gltf(cloud)["splats.glb"]),
    "glTF (text)": (".gltf", lambda cloud: build_gltf(cloud, "text")["splats.gltf"]),
}
JUDGED = (
    "statues/angel.sog",
    "playcanvas/playcanvas-logo/meta.json",
    "leica-sofort/leica-sofort-top8192.sog",
    "leica-sofort/leica-sofort-top8192.spz",
    "luma-seal/luma-seal.splat",
)


def _memory_row(path: Path, label: str) -> FigureRow:
    decoded, growth = peak_of_reading(path)
    return row_at_most(
        f"memory of reading {label}, less 64 MB",
        max(0.0, growth - ALLOWANCE) / decoded,
        2.5,
        "× decoded",
        f"growth of the peak {growth / 1e6:.0f} MB, decoded {decoded / 1e6:.0f} MB, "
        "a process of its own",
    )


def measure_formats(ctx: FigureContext) -> list[FigureRow]:
    """Time and peak memory of reading a million Gaussians of each format."""
    rows = []
    for degree in (0, 3):
        cloud = build_flat(COUNT, sh_degree=degree)
        for done, (name, (suffix, write)) in enumerate(WRITERS.items()):
            if degree and suffix == ".splat":  # it holds no SH
                continue
            ctx.progress(f"splat formats, SH {degree}", done, len(WRITERS))
            path = ctx.work / f"flat{suffix}"
            path.write_bytes(write(cloud))
            label = f"{name}, 1 M, SH {degree}"
            detail = (
                f"standard flat, {COUNT} Gaussians, {path.stat().st_size / 1e6:.0f} MB, "
                "median of 3, one thread"
            )
            seconds = median_seconds(partial(load_cloud, path), 3)
            rows.append(row_at_most(f"read {label}", seconds, 2.0, "s", detail))
            rows.append(_memory_row(path, label))
            path.unlink()
        if degree == 0:
            rows += _measure_streamed(ctx, cloud)
    return rows


def _measure_streamed(ctx: FigureContext, cloud: GaussianCloud) -> list[FigureRow]:
    """The finest of two levels in folders."""
    folder = ctx.work / "streamed"
    for name, data in build_sog_streamed([cloud, cloud.select(slice(None, None, 10))]).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    label = "streamed SOG, 1 M, SH 0"
    seconds = median_seconds(partial(load_cloud, folder), 3)
    detail = f"standard flat, {COUNT} Gaussians at level 0 of 2, median of 3, one thread"
    return [row_at_most(f"read {label}", seconds, 2.0, "s", detail), _memory_row(folder, label)]


def _forged() -> dict[str, bytes]:
    """Tiny files that claim a number of Gaussians which they cannot hold."""

    def put(data: bytes, offset: int, value: int) -> bytes:
        return data[:offset] + struct.pack("<I", value) + data[offset + 4 :]

    cloud = small_cloud(10, 1)
    spz, spz4 = build_spz(cloud, 2, packed=False), build_spz(cloud, 4)
    glb = build_gltf(cloud, "text")["splats.gltf"]
    document = json.loads(glb)
    for accessor in document["accessors"]:
        accessor["count"] = 10**12
    sog = build_sog(cloud).replace(b'"count": 10,', b'"count":10000000000,', 1)
    sections = put(build_ksplat(cloud), 16, 2**32 - 1)
    return {
        "SPZ": put(spz, 8, 2**32 - 1),
        "SPZ in gzip": gzip.compress(put(spz, 8, 2**32 - 1)),
        "SPZ 4": put(spz4, 8, 2**32 - 1),
        "SPZ, 200 MB of zeros in gzip": gzip.compress(spz + bytes(200_000_000), 1),
        "SOG": sog,
        "KSPLAT": put(put(sections, 4096, 2**32 - 1), 4100, 2**32 - 1),
        "glTF": json.dumps(document).encode(),
    }


def measure_forged(ctx: FigureContext) -> list[FigureRow]:
    """Memory of refusing counts that no file of this size can hold."""
    rows = []
    for name, data in _forged().items():
        path = ctx.work / "forged"
        path.write_bytes(data)
        try:
            load_cloud(path)
            refused = False
        except FormatError as error:
            refused = bool(error.remedy)
        _, growth = peak_of_reading(path)
        rows.append(
            row_at_most(
                f"memory of refusing {name}",
                growth / 1e6 if refused else float("inf"),
                64,
                "MB",
                f"growth of the peak, a process of its own; a file of {len(data)} bytes",
            )
        )
    return rows


def measure_judge(ctx: FigureContext) -> list[FigureRow]:
    """Real files decoded by us and by splat-transform, and its SPZ and glTF read back."""
    call = find_splat_transform()
    if call is None:
        raise FileNotFoundError("splat-transform (npm install -g @playcanvas/splat-transform)")
    rows = []
    for name in JUDGED:
        path = ctx.need_data(f"splats/{name}")
        ours = load_cloud(path)
        theirs = load_cloud(run_splat_transform(call, path, ctx.work / "theirs.ply")).cloud
        worst = max(
            float(np.abs(getattr(ours.cloud, n) - getattr(theirs, n)).max()) for n in FIELDS
        )
        rows.append(
            row_at_most(
                f"we read {Path(name).parts[-2]} ({ours.format}): largest difference of any value",
                worst,
                2e-5,
                "",
                f"{len(ours.cloud)} Gaussians, against splat-transform's own decoding",
            )
        )
    leica = ctx.need_data("splats/leica-sofort/leica-sofort-top8192.ply")
    source = load_cloud(leica).cloud
    for suffix, limit in ((".glb", 1e-5), (".spz", 1.3e-4)):
        target = run_splat_transform(call, leica, ctx.work / f"theirs{suffix}")
        error = float(np.abs(load_cloud(target).cloud.means - source.means).max())
        rows.append(
            row_at_most(
                f"their {suffix} of a PLY, read by us: largest difference of a position",
                error,
                limit,
                "",
                f"leica-sofort, {len(source)} Gaussians; the axes of the PLY come back",
            )
        )
    return rows


def measure_folder(ctx: FigureContext) -> list[FigureRow]:
    """Every file of the data folder: read, or refused with a place and a remedy."""
    root = ctx.need_data("splats")
    paths = [path for path in sorted(root.rglob("*")) if path.is_file()]
    read = refused = 0
    for path in paths:
        try:
            load_cloud(path)
            read += 1
        except FormatError as error:
            refused += bool(error.remedy and error.offset is not None)
    return [
        row_at_least(
            "files read, or refused with place and remedy",
            100 * (read + refused) / len(paths),
            100,
            "%",
            f"{len(paths)} files by others: {read} read, {refused} refused (malformed on purpose, "
            "or pictures and notes that lie beside them)",
        )
    ]


FIGURES: list[Figure] = [
    Figure("splats.read", "Reading every splat format", measure_formats, 3.0),
    Figure("splats.forged", "Forged counts and bombs", measure_forged, 0.3),
    Figure("splats.judge", "Splat formats against splat-transform", measure_judge, 0.3),
    Figure("splats.folder", "Every splat file of the data folder", measure_folder, 0.2),
]
