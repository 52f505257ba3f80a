"""Build a dataset: walk the episodes of a suite with the expert, label and draw every step.

The dataset is poses, labels and hashes; pictures are a cache beside them that `gn0 data render`
makes again, bit for bit. The same episodes give the same bytes for any number of workers, and a
build that was stopped goes on when the same command is given again.
"""

from __future__ import annotations

import time
from typing import Annotated, Any, Literal

import msgspec
import tyro

from gn0.config import Config
from gn0.counted import counted

EXAMPLES = """  gn0 data build out/suite --out out/data
  gn0 data build out/suite --workers 2 --layout lerobot --out out/data
  gn0 data build out/suite --layout none --out out/labels
  gn0 data build out/suite --backend cuda --quality 85 --out out/data
  gn0 data build out/suite --depth --out out/rgbd
  gn0 data build out/suite --bank out/bank --out out/people
  gn0 data build out/suite --labels mpc --tokens ego --answer-order paper --out out/ego
  gn0 data build out/suite --executor ray --ray-address auto --workers 16 --out out/data
  gn0 data build out/suite --shard 2/8 --out out/shard-2    # then gn0 data merge"""


class Args(Config, frozen=True):
    """Episodes in, a dataset out.

    Attributes:
        episodes: a suite folder, as `gn0 missions generate` and `gn0 bench suite` write; or a scene
            folder, whose fifty goal episodes (seed 0) are then sampled beside `--out`.
        out: the dataset folder; an interrupted build there goes on.
        layout: how pictures are kept: tar shards (webdataset), Parquet and MP4 (lerobot), or not
            at all (none): poses and labels only, to be drawn later by `gn0 data render`.
        format: format of single pictures: jpg, or png, which is lossless.
        quality: quality of jpg.
        maps: BEV and occupancy picture in every sample, so that a shard stands alone, or, which is
            smaller, once per scene and light beside the shards.
        visible_sets: draw only splats that can be seen near each place: quicker, and nearly the
            same pictures; part of the dataset's identity.
        depth: store the depth of each view as well, in millimetres.
        depth_as: how shards keep it: npy, which every reader takes for what it is; png, a quarter
            of the size, with 16 bits that some readers cut to 8; or both.
        labels: next actions by the exact planner (exact), the paper's tracking objective (mpc), as
            the official release labels (gn0-release), or one step ahead on the distance field,
            quickly (field).
        inside: where the goal is a room, metres behind its entrance where labels say STOP; 0: as
            soon as one is in it.
        tokens: what map tokens refer to: the whole map, or a square around the agent.
        answer_order: what comes first where the dataset's answers are written as text: the actions,
            or the waypoints, as in the paper's prompts (paper).
        chunk: episodes per part, which is what a worker takes at a time and what a shard holds.
        backend: what draws: cpu, cuda, or the best available (auto). Their pictures differ by
            rounding, so the dataset says which it was, and goes on with the same.
        batch: views per call of the GPU's renderer; 0 takes its default; never changes a byte.
        workers: processes that walk, label and encode; never changes a byte. 0 means one, or one
            per core if a GPU draws.
        executor: where the workers run: on this machine, or on a Ray cluster.
        ray_address: the cluster to join, e.g. auto; empty starts one on this machine alone.
        gpus: GPUs that Ray sets aside for each worker, which then draws for itself: 1, or a part of
            one that several share, e.g. 0.25.
        bank: folder of the bank of people whom episodes name; those named are copied into the
            dataset. Drawn people (drawn:0:7) need none.
        shard: i/n builds the i-th of n shards, on a machine of its own; `gn0 data merge` joins
            them into the same dataset that is built without it. Empty builds all.
        fresh: forget what an earlier command left in the output folder, instead of going on.
    """

    episodes: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SUITE")]
    out: str
    layout: Literal["webdataset", "lerobot", "none"] = "webdataset"
    format: Literal["jpg", "png"] = "jpg"
    quality: Annotated[int, msgspec.Meta(ge=1, le=100)] = 90
    maps: Literal["once", "every"] = "every"
    visible_sets: bool = False
    depth: bool = False
    depth_as: Literal["png", "npy", "both"] = "npy"
    labels: Literal["exact", "mpc", "gn0-release", "field"] = "exact"
    inside: Annotated[float, msgspec.Meta(ge=0, le=5)] = 0
    tokens: Literal["global", "ego"] = "global"
    answer_order: Literal["paper", "actions_first"] = "actions_first"
    chunk: Annotated[int, msgspec.Meta(ge=1, le=100_000)] = 8
    backend: Literal["auto", "cpu", "cuda"] = "auto"
    batch: Annotated[int, msgspec.Meta(ge=0, le=4096)] = 0
    workers: Annotated[int, msgspec.Meta(ge=0, le=1024)] = 0
    executor: Literal["process", "ray"] = "process"
    ray_address: str = ""
    gpus: Annotated[float, msgspec.Meta(ge=0, le=64)] = 0.0
    bank: str = ""
    shard: str = ""
    fresh: Annotated[bool, tyro.conf.arg(aliases=("--overwrite",))] = False


def run(args: Args) -> int:
    """Build, and say what came out."""
    from gn0.cli.console import draw_progress, say_aside, say_backend
    from gn0.data.build import build_dataset, build_shard
    from gn0.data.dataset import DATASET_FILE
    from gn0.data.drawing_process import choose_drawing, count_workers, with_backend
    from gn0.data.expert_labels import LabelSettings
    from gn0.data.settings import BuildSettings, PictureSettings, TokenSettings
    from gn0.data.shard import ShardName, describe_shard
    from gn0.locked_folder import forget_folder
    from gn0.suites.suite import open_suite

    name = ShardName.parse(args.shard) if args.shard else None
    pictures = PictureSettings(
        layout=args.layout,
        format=args.format,
        quality=args.quality,
        maps=args.maps,
        visible_sets=args.visible_sets,
        depth=args.depth,
        depth_as=args.depth_as,
    )
    if args.layout != "none":
        backend, why = choose_drawing(args.backend, args.out)
        say_aside(f"pictures: drawn by backend {backend} ({why})")
        pictures = with_backend(pictures, backend)
    else:
        say_backend(args.backend)
    settings = BuildSettings(
        tokens=TokenSettings(frame=args.tokens, order=args.answer_order),
        labels=LabelSettings(variant=args.labels, inside=args.inside),
        chunk=args.chunk,
        pictures=pictures,
    )
    if args.fresh:
        forget_folder(args.out, DATASET_FILE)
    begin = time.perf_counter()
    with draw_progress() as progress:
        suite = open_suite(args.episodes, beside=f"{args.out.rstrip('/')}-episodes")
        work: dict[str, Any] = {
            "workers": count_workers(args.workers, pictures),
            "executor": args.executor,
            "ray_address": args.ray_address,
            "gpus": args.gpus,
            "batch": args.batch,
            "bank": args.bank or None,
            "progress": progress,
            "note": say_aside,
        }
        if name is not None:
            shard = build_shard(suite, args.out, name, settings, **work)
        else:
            dataset = build_dataset(suite, args.out, settings, **work)
    if name is not None:
        print(describe_shard(shard, args.out))
        return 0
    seconds = time.perf_counter() - begin
    about = dataset.about
    skipped = [own for part in about.parts for own in part.skipped]
    episodes = len(dataset.sampled)
    print(
        f"{counted(about.rows, 'sample')} of {counted(episodes, 'episode')} in "
        f"{counted(len(about.scenes), 'scene')}, written to {args.out} in {seconds:.1f} s"
    )
    for own in skipped[:5]:
        print(f"skipped {own.id}: {own.reason}")
    if skipped:
        asked = counted(episodes + len(skipped), "episode")
        print(f"{len(skipped)} of {asked} skipped; all in dataset.json")
    if not about.rows and skipped:
        return 1  # as in a run none of whose episodes was scored
    print(f"look at it: gn0 data show {args.out} --out {args.out.rstrip('/')}.png")
    return 0
