"""Make dressed people from a seed: a bank of avatars for scenes, and a page of pictures of them.

Any two people of a bank differ in at least two things that can be seen. A run that was stopped goes
on where it was; the same seed and count give the same bytes for any number of workers.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from gn0.config import Config

EXAMPLES = """  gn0 avatar generate --count 8 --out out/bank
  gn0 avatar generate --count 200 --seed 3 --workers 2 --out out/bank200
  gn0 avatar generate --count 4 --density 0.25 --out out/coarse"""


class Args(Config, frozen=True):
    """How many, and where.

    Attributes:
        out: folder of the bank.
        count: number of people.
        seed: who they are.
        density: splats a person, relative to about 35,000.
        workers: people made at a time.
        executor: process on this machine, or ray.
        no_sheet: do not draw all of them, front and back, into people.jpg.
        fresh: forget what an earlier command left in the output folder, instead of going on.
    """

    out: str
    count: Annotated[int, msgspec.Meta(ge=1, le=100_000)] = 20
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**62)] = 0
    density: Annotated[float, msgspec.Meta(ge=0.02, le=4.0)] = 1.0
    workers: Annotated[int, msgspec.Meta(ge=1, le=1024)] = 1
    executor: Literal["process", "ray"] = "process"
    no_sheet: bool = False
    fresh: bool = False


def run(args: Args) -> int:
    """Make them, draw them, say who they are."""
    from collections import Counter
    from pathlib import Path

    from gn0.avatars.bank import AvatarBank
    from gn0.avatars.bank_build import JOURNAL_FILE, generate_bank
    from gn0.cli.console import draw_progress
    from gn0.locked_folder import forget_folder
    from gn0.storage import write_atomic
    from gn0.viewer.avatar_sheet import draw_avatars

    if args.fresh:
        forget_folder(args.out, JOURNAL_FILE)
    picture = Path(args.out) / "people.jpg"
    with draw_progress() as progress:
        listed = generate_bank(
            args.out, count=args.count, seed=args.seed, density=args.density, workers=args.workers,
            executor=args.executor, progress=progress,
        )  # fmt: skip
        if not args.no_sheet:
            bank = AvatarBank(args.out)
            sheet = draw_avatars([bank.load(name) for name in bank.names], progress=progress)
            write_atomic(picture, lambda stream: sheet.save(stream, "JPEG", quality=88))
    for key in ("sex", "age", "build"):
        counts = Counter(entry.record[key] for entry in listed.avatars)
        print(f"{key:<8}" + ", ".join(f"{n} {word}" for word, n in counts.most_common()))
    splats = [entry.splats for entry in listed.avatars]
    print(f"splats  {min(splats):,} to {max(splats):,}")
    print(f"written to {args.out}" + (f"; look at {picture}" if not args.no_sheet else ""))
    return 0
