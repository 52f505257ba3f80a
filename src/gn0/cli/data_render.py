"""Draw the pictures of a dataset, again or for the first time.

Every picture is checked against the hash of its raw pixels in the dataset, so what comes out is
what was there before, bit for bit. An interrupted run goes on when the same command is given again.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import tyro

from gn0.config import Config
from gn0.counted import counted

EXAMPLES = """  gn0 data render out/data
  gn0 data render out/data --layout lerobot --workers 2
  gn0 data render out/data --layout webdataset --format png --maps every"""


class Args(Config, frozen=True):
    """Which cache to make.

    Attributes:
        dataset: the dataset folder.
        layout: tar shards (webdataset) or Parquet and MP4 (lerobot); by default what the dataset
            was built with.
        format: format of single pictures: jpg or png; by default as built.
        quality: quality of jpg; by default as built.
        maps: BEV and occupancy picture in every sample, or once per scene and light; as built.
        depth: store depth as well, in millimetres, if the dataset has only poses and labels;
            otherwise as built.
        depth_as: how shards keep it: npy, png or both; by default as built, and npy for new depth.
        backend: what draws: cpu or cuda. A dataset that has pictures is drawn by what drew them
            first; one of poses and labels alone by the best available (auto).
        batch: views per call of the GPU's renderer; 0 takes its default; never changes a byte.
        workers: processes that encode; never changes a byte. 0 means one, or one per core
            if a GPU draws.
        executor: where the workers run: on this machine, or on a Ray cluster.
        ray_address: the cluster to join, e.g. auto; empty starts one on this machine alone.
    """

    dataset: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="DATASET")]
    layout: Literal["webdataset", "lerobot"] | None = None
    format: Literal["jpg", "png"] | None = None
    quality: Annotated[int, msgspec.Meta(ge=1, le=100)] | None = None
    maps: Literal["once", "every"] | None = None
    depth: bool = False
    depth_as: Literal["png", "npy", "both"] | None = None
    backend: Literal["auto", "cpu", "cuda"] = "auto"
    batch: Annotated[int, msgspec.Meta(ge=0, le=4096)] = 0
    workers: Annotated[int, msgspec.Meta(ge=0, le=1024)] = 0
    executor: Literal["process", "ray"] = "process"
    ray_address: str = ""


def run(args: Args) -> int:
    """Draw, and say what came out."""
    from gn0.cli.console import draw_progress, say_aside
    from gn0.data.dataset import open_dataset
    from gn0.data.drawing_process import choose_drawing, count_workers, with_backend
    from gn0.data.picture_build import choose_cache, render_dataset

    dataset = open_dataset(args.dataset)
    wanted = choose_cache(dataset, None)
    chosen = {
        name: value
        for name in ("layout", "format", "quality", "maps", "depth_as")
        if (value := getattr(args, name)) is not None
    }
    if args.depth:
        chosen["depth"] = True
        if not wanted.depth:
            chosen.setdefault("depth_as", "npy")
    if args.backend != "auto" or not dataset.about.rendered:
        backend, why = choose_drawing(args.backend, args.dataset)
        say_aside(f"pictures: drawn by backend {backend} ({why})")
        wanted = with_backend(wanted, backend)
    wanted = msgspec.structs.replace(wanted, **chosen)
    with draw_progress() as progress:
        manifest = render_dataset(
            args.dataset,
            wanted,
            workers=count_workers(args.workers, wanted),
            executor=args.executor,
            ray_address=args.ray_address,
            batch=args.batch,
            progress=progress,
            note=say_aside,
        )
    size = sum(record.size for record in manifest.files)
    layout = manifest.settings.layout
    print(
        f"{counted(len(manifest.files), 'file')}, {size / 1e6:.1f} MB, in {args.dataset}/pictures/"
        f"{layout}; every picture matches its hash"
    )
    return 0
