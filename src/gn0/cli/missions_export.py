"""Write the episodes of a suite in another format: GN-Matrix or VLN-CE.

A suite that was imported gives back the rows it came from, value for value, when it is exported in
their own format.
"""

from __future__ import annotations

from collections import Counter
from typing import Annotated

import tyro

from gn0.config import Config
from gn0.counted import counted

EXAMPLES = """  gn0 missions export out/suite --format gn-matrix --out episodes.parquet
  gn0 missions export out/suite --format gn-matrix-json --out tasks
  gn0 missions export out/suite --format vlnce --out val/val.json.gz
  gn0 missions export out/suite --format vlnce --vocabulary R2R/train.json.gz --out val.json.gz"""

SEVERAL = {"gn-matrix": False, "gn-matrix-json": False, "vlnce": True}  # takes several goals


class Args(Config, frozen=True):
    """The suite, the format and the place.

    Attributes:
        suite: a suite folder, or a scene folder for the fifty goal episodes sampled in it.
        format: gn-matrix (a Parquet file), gn-matrix-json (a folder), vlnce (a .json.gz file), or
            a plug-in's.
        out: what to write; must not exist.
        vocabulary: any {split}.json.gz of VLN-CE's R2R: tokens of vlnce are of its words, which the
            models of VLN-CE know.
    """

    suite: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SUITE")]
    format: str
    out: str
    vocabulary: str = ""


def run(args: Args) -> int:
    """Write, and say how much."""
    from gn0.export.vlnce import MISREAD
    from gn0.missions.sets.lost_goals import find_lost
    from gn0.missions.sets.vlnce import VlnceFile
    from gn0.missions.sets.vocabulary import are_r2r_words, count_unknown, tell_unknown
    from gn0.suites.foreign_sets import export_set
    from gn0.suites.named_suites import open_named

    suite = open_named(args.suite)
    written = export_set(suite, args.format, args.out, vocabulary=args.vocabulary)
    if isinstance(written.native, VlnceFile) and written.native.words:
        words = written.native.words
        if not are_r2r_words(words):
            print("note: " + MISREAD.format(count=len(words)))
        elif odd := count_unknown((task.instruction for task in written.tasks), words):
            print("note: " + tell_unknown(odd))
    lost = Counter[str]()
    if args.format in SEVERAL:
        for episode in suite.episodes:
            lost.update(find_lost(episode, several=SEVERAL[args.format]))
    for what, count in lost.items():
        print(f"note: {count:,} × {what}")
    episodes, scenes = counted(len(written.tasks), "episode"), counted(len(written.scenes), "scene")
    print(f"{episodes} of {scenes}: {args.out}")
    return 0
