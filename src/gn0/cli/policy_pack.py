"""Turn a run's policy into what is shipped: small bf16 shards, tokenizer, prompt and model card.

The card says from the run's own files what was trained, on what, by which commands and how well. A
folder of more than 36 MB is refused unless told otherwise. The core install runs what is written.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import tyro

from gn0.config import Config
from gn0.counted import counted

EXAMPLES = """  gn0 policy pack out/sft --out release/bae-tiny
  gn0 policy pack out/sft --walks out/sft-walks out/sft-seen --out out/packed --overwrite
  gn0 policy pack out/sft --tables out/study.md --out out/packed --overwrite
  gn0 policy pack out/every --default maps --out out/packed --overwrite
  gn0 policy pack out/sft-4b --limit-mb 9000 --shard-mb 2000 --out out/packed-4b"""


class Args(Config, frozen=True):
    """What to pack and where to.

    Attributes:
        run: the folder of a training run, or of a policy.
        out: the folder to write.
        dtype: of the weights: bfloat16, or float32, twice as large.
        shard_mb: megabytes of a file at most.
        limit_mb: megabytes of everything; more are refused.
        walks: folders of walks of this policy, as `gn0 policy examine` writes them: a table of the
            card, with intervals.
        tables: a file of Markdown that goes with the card's numbers.
        draw_after: actions without getting anywhere after which the packed policy's answers are
            drawn as probable as it holds them; 0: never, -1: as the run's policy has it.
        default: which of several inputs the packed policy is asked in where none is named.
        overwrite: replace an earlier packed policy there.
    """

    run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    out: str
    dtype: Literal["bfloat16", "float32"] = "bfloat16"
    shard_mb: Annotated[int, msgspec.Meta(ge=1)] = 15
    limit_mb: Annotated[int, msgspec.Meta(ge=1)] = 36
    walks: tuple[str, ...] = ()
    tables: str = ""
    draw_after: Annotated[int, msgspec.Meta(ge=-1, le=10_000)] = -1
    default: str = ""
    overwrite: bool = False


def run(args: Args) -> int:
    """Pack, and say what was written."""
    from gn0.cli.console import draw_progress
    from gn0.cli.train_packages import check_packages
    from gn0.policies.bae.shipped import find_checkpoint
    from gn0.storage import read_bytes

    find_checkpoint(args.run)  # packages are of no help against a wrong folder
    tables = read_bytes(args.tables, 2**24).decode("utf-8", "replace") if args.tables else ""
    check_packages()
    from gn0.training.packing import pack_policy

    with draw_progress("packing"):
        packed = pack_policy(
            args.run,
            args.out,
            dtype=args.dtype,
            shard_mb=args.shard_mb,
            limit_mb=args.limit_mb,
            tables=tables,
            walks=args.walks,
            draw_after=args.draw_after,
            default=args.default,
            overwrite=args.overwrite,
        )
    files = f"{counted(len(packed.files), 'file')}: {', '.join(packed.files)}"
    print(f"{packed.size / 1e6:.1f} MB in {files}")
    print(f"written to {args.out}; read its README.md, the model card")
    print(f"next: gn0 policy show {args.out} SUITE --out decision.png")
    return 0
