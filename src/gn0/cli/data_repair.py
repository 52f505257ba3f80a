"""Rebuild what is damaged in a dataset, and nothing else.

Sample tables are walked and labelled again, pictures drawn again; both must come out with the
digest they had. Episodes and scenes cannot be rebuilt from the dataset: give the suite for those.
"""

from __future__ import annotations

from typing import Annotated

import msgspec
import tyro

from gn0.config import Config

EXAMPLES = """  gn0 data repair out/data
  gn0 data repair out/data --suite out/suite --workers 2"""


class Args(Config, frozen=True):
    """What to repair.

    Attributes:
        dataset: the dataset folder.
        suite: the suite that it was built from, for damaged episodes and scenes.
        bank: the bank of people that it was built with, for damaged people.
        workers: processes that draw.
    """

    dataset: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="DATASET")]
    suite: str = ""
    bank: str = ""
    workers: Annotated[int, msgspec.Meta(ge=1, le=1024)] = 1


def run(args: Args) -> int:
    """Repair, and say what was done and what is left."""
    from gn0.cli.console import draw_progress
    from gn0.data.repair import repair_dataset

    with draw_progress() as progress:
        report = repair_dataset(
            args.dataset,
            suite=args.suite or None,
            bank=args.bank or None,
            workers=args.workers,
            progress=progress,
        )
    left = {damage.path for damage in report.left}
    for damage in report.found:
        if damage.path not in left:
            print(f"made again: {damage}")
    for damage in report.left:
        print(f"still damaged: {damage}")
        print(f"  → {report.reasons.get(damage.path, '')}")
    if not report.found:
        print("nothing is damaged")
    elif report.ok:
        print("everything is intact again, byte for byte")
    return 0 if report.ok else 1
