"""Balance the actions of a dataset to the paper's table, by weights or by leaving samples out.

Walks are mostly straight. This writes which samples to draw, and how often, to selection.parquet
and balance.json beside the samples, which stay unchanged.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import tyro

from gn0.config import Config

EXAMPLES = """  gn0 data balance out/data
  gn0 data balance out/data --method selection --tolerance 0.3
  gn0 data balance out/data --forward 55 --left 20 --right 20 --stop 5
  gn0 data balance out/data --tracking 30"""


class Args(Config, frozen=True):
    """What the shares should be.

    Attributes:
        dataset: a dataset folder.
        method: weights, which keeps every sample and says how often to draw it; or selection,
            which leaves samples of the common actions out.
        forward: wanted share of FORWARD [percent].
        left: wanted share of LEFT [percent].
        right: wanted share of RIGHT [percent].
        stop: wanted share of STOP [percent]; those of following stand still and keep theirs.
        tolerance: how far off a share may be [percentage points]; a selection keeps more with it.
        seed: seed of the choice of samples that are left out.
        tracking: wanted share of TRACKING samples [percent], by weights; by default as many as
            there are.
    """

    dataset: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="DATASET")]
    method: Literal["weights", "selection"] = "weights"
    forward: Annotated[float, msgspec.Meta(ge=0, le=100)] = 67.0
    left: Annotated[float, msgspec.Meta(ge=0, le=100)] = 15.0
    right: Annotated[float, msgspec.Meta(ge=0, le=100)] = 15.0
    stop: Annotated[float, msgspec.Meta(ge=0, le=100)] = 3.0
    tolerance: Annotated[float, msgspec.Meta(ge=0, le=50)] = 0.5
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**62)] = 0
    tracking: Annotated[float, msgspec.Meta(ge=0, le=100)] | None = None


def run(args: Args) -> int:
    """Balance, and print the shares before and after."""
    from gn0.cli.console import draw_progress
    from gn0.data.balance import BalanceSettings, balance_dataset, describe_balance
    from gn0.data.dataset import open_dataset

    settings = BalanceSettings(
        method=args.method, forward=args.forward, left=args.left, right=args.right,
        stop=args.stop, tolerance=args.tolerance, seed=args.seed,
        tracking=msgspec.UNSET if args.tracking is None else args.tracking,
    )  # fmt: skip
    with draw_progress() as progress:
        about = balance_dataset(open_dataset(args.dataset), settings, progress=progress)
    print(describe_balance(about))
    print(f"written: {args.dataset}/balance.json, {args.dataset}/selection.parquet")
    return 0
