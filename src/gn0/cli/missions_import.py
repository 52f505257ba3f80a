"""Make a suite from an episode set in another format, in the scenes that you have.

Reads GN-Matrix (a Parquet file, or a folder of <scene>/<digits>.json) and VLN-CE R2R
({split}.json.gz). Scenes are matched by their id. Says how many points of the set lie on free
cells, and what would fit better if they do not; writes a picture to look at.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from gn0.config import Config
from gn0.counted import counted

EXAMPLES = """  gn0 missions import InteriorGS_test_unseen.parquet --scenes scenes --out out/unseen
  gn0 missions import tasks --scenes out/flat out/house --out out/tasks
  gn0 missions import val_seen.json.gz --scenes mp3d --frame ce_occupancy --out out/seen
  gn0 missions import episodes.parquet --scenes out/flat --profile gn0-release --out out/official"""


class Args(Config, frozen=True):
    """What to read, where its scenes are, and what to make of it.

    Attributes:
        path: the episode set.
        scenes: scene folders, or folders of scene folders.
        out: the suite folder to write.
        format: gn-matrix, gn-matrix-json or vlnce; by default detected from the content.
        frame: how the file's frame lies in the scenes; by default as its format documents.
        camera: camera preset; by default the format's own.
        profile: default, paper, gn0-release, or vlnce (the body of VLN-CE's own task).
        split: written into the episodes; by default the file's own division.
        name: name of the suite.
        keep: keep episodes that do not fit the map; a run names each of them.
        no_picture: do not write overlay.png beside the suite.
        overwrite: replace an earlier suite.
    """

    path: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="EPISODES")]
    scenes: tuple[str, ...]
    out: str
    format: str = ""
    frame: str = ""
    camera: str = ""
    profile: Literal["default", "paper", "gn0-release", "vlnce"] = "default"
    split: str = ""
    name: str = ""
    keep: bool = False
    no_picture: bool = False
    overwrite: bool = False


def run(args: Args) -> int:
    """Import, and say what became of it; 1 when nothing could be kept."""
    from gn0.cli.console import draw_progress
    from gn0.suites.foreign_sets import import_set

    with draw_progress() as progress:
        report = import_set(
            args.path,
            args.scenes,
            args.out,
            format=args.format,
            frame=args.frame,
            camera=args.camera,
            profile=args.profile,
            split=args.split,
            name=args.name,
            keep=args.keep,
            overwrite=args.overwrite,
            progress=progress,
        )
    for check in report.checks:
        print(("" if check.ok else "warning: ") + str(check))
    if report.missing:
        print(f"not in --scenes: {counted(len(report.missing), 'scene')} of the set:")
        for scene, count in report.missing.items():
            print(f"  {scene} ({counted(count, 'episode')})")
    for word, counts in (("left out", report.skipped), ("kept anyway", report.unfit)):
        for reason, count in counts.items():
            print(f"{word}: {count} × {reason}")
    if report.suite is None:
        print("no episode is left; nothing was written")
        return 1
    scenes = counted(len(report.suite.about.scenes), "scene")
    print(f"{counted(report.kept, 'episode')} in {scenes}: {args.out}")
    if not args.no_picture:
        from gn0.cli.missions_show import draw_episode
        from gn0.storage import write_atomic

        picture = Path(args.out).with_name(f"{Path(args.out).name}-overlay.png")
        sheet = draw_episode(report.suite, report.suite.episodes[0])
        write_atomic(picture, lambda stream: sheet.save(stream, "PNG"))
        print(f"look at it: {picture}")
    print(f"next: gn0 bench run {args.out} --policy oracle --out {args.out}-oracle")
    return 0
