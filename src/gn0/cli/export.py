"""Write a dataset in another project's format, to train or evaluate with.

Formats: gn-matrix, gn-matrix-json, vlnce-r2r, vlnce-rxr (episodes); vln-pe, interndata-n1, navdp,
lerobot-v3, navid, uninavid, streamvln, navila (with pictures). Stopped runs go on with the same
command. What a format cannot hold is left out, counted and reported.
"""

from __future__ import annotations

from typing import Annotated

import msgspec
import tyro

from gn0.config import Config
from gn0.counted import counted

EXAMPLES = """  gn0 export vlnce-r2r out/data --out out/vlnce
  gn0 export vlnce-r2r out/data --vocabulary R2R/train/train.json.gz --out out/vlnce
  gn0 export streamvln out/data --out out/streamvln --camera streamvln --split train
  gn0 export navdp out/data --out out/navdp --limit 50
  gn0 export lerobot-v3 out/data --out out/lerobot --fps 5
  gn0 export check out/vlnce"""


class Args(Config, frozen=True):
    """The format, the dataset, the place, and what to write.

    Attributes:
        format: name of the format.
        dataset: a folder that `gn0 data build` wrote.
        out: the folder to write.
        camera: preset to render through again; by default the dataset's own pictures.
        split: only episodes of this split.
        limit: at most so many episodes; 0 means all.
        quality: quality of JPEG pictures, 1 to 100.
        fps: frames a second in videos and time stamps; by default the format's own, in LeRobot a
            frame an action.
        every: ask at every so-many-th decision (navid, uninavid, navila).
        spacing: metres between frames of a navdp trajectory; 0 means the dataset's own poses.
        views: camera presets of an interndata-n1 export.
        merge_turns: merge finer turns into the 30° of navid and uninavid; leftovers are dropped
            and counted.
        vocabulary: any {split}.json.gz of VLN-CE's R2R: vlnce-r2r and vln-pe then take their
            tokens from its words, which VLN-CE's models know.
        depth: depth pictures even if the dataset stores none (lerobot-v3).
        name: name of the data in ids and paths of the format.
        exact: render pictures again, even if the dataset's cache has them.
        fresh: forget what an earlier command left in the output folder, instead of going on.
    """

    format: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FORMAT")]
    dataset: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="DATASET")]
    out: str
    camera: str = ""
    split: str = ""
    limit: Annotated[int, msgspec.Meta(ge=0)] = 0
    quality: Annotated[int, msgspec.Meta(ge=1, le=100)] = 92
    fps: Annotated[int, msgspec.Meta(ge=0, le=240)] = 0
    every: Annotated[int, msgspec.Meta(ge=1, le=10_000)] = 1
    spacing: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.0625
    views: tuple[str, ...] = ("n1_125cm_0deg", "n1_125cm_30deg")
    merge_turns: bool = False
    vocabulary: str = ""
    depth: bool = False
    name: str = "gn0"
    exact: bool = False
    fresh: Annotated[bool, tyro.conf.arg(aliases=("--overwrite",))] = False


def run(args: Args) -> int:
    """Export, and say what was written and what was not."""
    from gn0.cli.console import draw_progress
    from gn0.config import check_config
    from gn0.export.dataset_source import open_source
    from gn0.export.export_file import EXPORT_FILE
    from gn0.export.export_run import remark_export, run_export
    from gn0.export.exporter import ExportSettings, get_dataset_exporter
    from gn0.locked_folder import forget_folder

    exporter = get_dataset_exporter(args.format)
    fields = {name: getattr(args, name) for name in ExportSettings.__struct_fields__}
    settings = check_config(ExportSettings(**fields))
    if args.fresh:
        forget_folder(args.out, EXPORT_FILE)
    with draw_progress() as progress:
        source = open_source(args.dataset, exact=args.exact)
        done = run_export(source, exporter, args.out, settings, progress=progress)
    splits = ", ".join(f"{split} {count:,}" for split, count in done.splits.items())
    frames = f", {done.frames:,} frames" if done.frames else ""
    print(f"{counted(done.written, 'episode')} ({splits}){frames}: {args.out}")
    for why, count in done.skipped.items():
        print(f"left out: {count:,} × {why}")
    for what, count in done.notes.items():
        print(f"counted: {count:,} × {what}")
    if len(done.splits) > 1 and not exporter.has_splits:
        print("note: this format does not keep splits apart; give --split to export one at a time")
    for remark in remark_export(args.out):
        print(f"note: {remark}")
    print(f"read by: {exporter.reader}")
    print(f"next: gn0 export check {args.out}")
    return 0
