"""Join the shards of a dataset, each built by itself with `gn0 data build --shard i/n`.

The result is the dataset that one machine would have built, byte for byte: one set of tables, one
set of statistics, and, if asked for, one balance over all samples. Every file is checked on the
way; a merge that was stopped goes on when the same command is given again.
"""

from __future__ import annotations

from typing import Annotated, Literal

import tyro

from gn0.config import Config
from gn0.counted import counted

EXAMPLES = """  gn0 data merge out/shard-1 out/shard-2 out/shard-3 --out out/data
  gn0 data merge out/shard-* --balance weights --out out/data"""


class Args(Config, frozen=True):
    """What to join, and where to write.

    Attributes:
        shards: the folders of all shards, in any order.
        out: the dataset folder; an interrupted merge there goes on.
        balance: balance the actions of all samples to the paper's shares, by weights or by leaving
            samples out, as `gn0 data balance` does; none leaves that for later.
        fresh: forget what an earlier command left in the output folder, instead of going on.
    """

    shards: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="SHARD", help_behavior_hint="(required)"),
    ]
    out: str
    balance: Literal["none", "weights", "selection"] = "none"
    fresh: Annotated[bool, tyro.conf.arg(aliases=("--overwrite",))] = False


def run(args: Args) -> int:
    """Join, and say what came out."""
    from gn0.cli.console import draw_progress
    from gn0.data.balance import BalanceSettings, balance_dataset, describe_balance
    from gn0.data.dataset import DATASET_FILE
    from gn0.data.merge import merge_shards
    from gn0.locked_folder import forget_folder

    if args.fresh:
        forget_folder(args.out, DATASET_FILE)
    with draw_progress() as progress:
        dataset = merge_shards(args.shards, args.out, progress=progress)
        balanced = None
        if args.balance != "none":
            settings = BalanceSettings(method=args.balance)
            balanced = balance_dataset(dataset, settings, progress=progress)
    about = dataset.about
    print(
        f"{counted(about.rows, 'sample')} of {counted(len(dataset.sampled), 'episode')} in "
        f"{counted(len(about.scenes), 'scene')}, joined from "
        f"{counted(len(args.shards), 'shard')} in {args.out}"
    )
    if balanced is not None:
        print(describe_balance(balanced))
    print(f"look at it: gn0 data show {args.out} --out {args.out.rstrip('/')}.png")
    return 0
