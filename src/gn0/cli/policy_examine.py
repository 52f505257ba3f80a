"""Let a policy walk the episodes of a suite on a device, thousands at once, and keep every walk.

Success, steps and SPL are those of `gn0 bench run --policy bae`, or `cma` for a baseline of
`gn0 train baseline`, episode for episode; what the benchmark has beyond them (trajectories, report,
other policies) is left out, and it is faster. An examination that was stopped goes on when the same
command is given again; the folder is of one policy, one suite and one way of asking.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import msgspec
import tyro

from gn0.cli.comma_lists import split_words
from gn0.config import Config
from gn0.counted import counted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from gn0.training.exams.walks import Walk

EXAMPLES = """  gn0 policy examine out/sft/policy out/suite --out out/sft-walks
  gn0 policy examine out/sft/policy out/suite --split val_seen --out out/sft-seen
  gn0 policy examine out/sft/policy out/suite --control no_words --out out/sft-no-words
  gn0 policy examine out/cma/policy out/suite --out out/cma-walks
  gn0 policy examine out/sft/policy out/suite --executed 1 --confirm-stop --out out/sft-careful
  gn0 policy examine bae out/suite --split all --episodes 8 --device host --out out/tried"""


class Args(Config, frozen=True):
    """Which policy, where, and how it is asked.

    Attributes:
        checkpoint: the folder of a policy or a baseline, as training wrote it; `bae` for the one in
            the box.
        suite: a suite folder, as `gn0 missions generate` writes.
        out: the folder of the walks; an interrupted examination there goes on.
        split: splits of the suite, with commas between; all for all.
        control: take something away from the policy: its words (no_words: every text is "go"), its
            own words (shuffled: another episode's of the scene), or its pictures (no_pictures:
            black).
        inputs: in which of its ways the policy is asked, where it was trained in several; its
            default when left out.
        executed: actions of an answer that are carried out before the next question; 0: as the
            policy says.
        draw_after: actions without getting anywhere after which answers are drawn as probable as
            the policy holds them; 0: never, -1: as the policy says.
        confirm_stop: ask again before a STOP behind the first action is carried out.
        carried: carry out the actions of an answer, or follow its waypoints (and stop where its
            first action does).
        episodes: walk only so many, evenly over the suite; 0 for all.
        agents: that walk side by side, all asked in one batch; who has come to an end begins the
            next episode.
        dtype: of what is computed; auto: bfloat16 on a card, else float32.
        device: auto, cuda, or host (the emulation: slow, for trials).
        fresh: forget what an earlier examination left in the output folder.
    """

    checkpoint: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="CHECKPOINT")]
    suite: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SUITE")]
    out: str
    split: str = "val_unseen"
    control: Literal["none", "no_words", "shuffled", "no_pictures"] = "none"
    inputs: str = ""
    executed: Annotated[int, msgspec.Meta(ge=0)] = 0
    draw_after: Annotated[int, msgspec.Meta(ge=-1, le=10_000)] = -1
    confirm_stop: bool = False
    carried: Literal["actions", "waypoints"] = "actions"
    episodes: Annotated[int, msgspec.Meta(ge=0), tyro.conf.arg(aliases=("--limit",))] = 0
    agents: Annotated[int, msgspec.Meta(ge=1, le=65536)] = 1024
    dtype: Literal["auto", "float32", "bfloat16"] = "auto"
    device: str = "auto"
    fresh: Annotated[bool, tyro.conf.arg(aliases=("--overwrite",))] = False


def run(args: Args) -> int:
    """Walk, and print a row a mission kind."""
    from pathlib import Path

    from gn0.cli.console import draw_progress, plain_text
    from gn0.cli.train_packages import check_packages
    from gn0.policies.bae.shipped import find_checkpoint
    from gn0.suites.suite_kept import load_suite_kept

    # looked at first: packages are of no help against a folder that is broken or not there
    load_suite_kept(args.suite)
    if not Path(args.checkpoint).expanduser().is_dir():
        find_checkpoint(args.checkpoint)
    check_packages()
    from gn0.training.exams.policy_examination import WalkJob, examine_policy

    job = WalkJob(
        checkpoint=args.checkpoint,
        suite=args.suite,
        splits=() if args.split == "all" else split_words(args.split),
        control=args.control,
        inputs=args.inputs,
        executed=args.executed,
        draw_after=args.draw_after,
        confirm_stop=args.confirm_stop,
        carried=args.carried,
        episodes=args.episodes,
        agents=args.agents,
        dtype=args.dtype,
    )
    with draw_progress() as progress:
        walks = examine_policy(
            job,
            args.out,
            device=args.device,
            fresh=args.fresh,
            say=lambda text: print(plain_text(text)),
            progress=progress,
        )
    print_walks(walks)
    seconds = sum(walk.seconds for walk in walks)
    decisions = sum(walk.decisions for walk in walks)
    print(f"{counted(decisions, 'decision')} in {seconds:.1f} s")
    print(f"walks: {args.out}/walks.jsonl")
    print("next: gn0 policy study STUDY.yaml FOLDER --out page.md, for walks of several policies")
    return 0


# mean -> (title, factor, decimals)
_COLUMNS = {
    "SR": ("SR %", 100, 1),
    "SPL": ("SPL %", 100, 1),
    "OS": ("OS %", 100, 1),
    "SR_straight": ("SR straight", 100, 1),
    "SPL_straight": ("SPL straight", 100, 1),
    "SR_1m": ("SR 1 m", 100, 1),
    "SPL_1m": ("SPL 1 m", 100, 1),
    "NE": ("NE m", 1, 2),
    "NE_straight": ("NE straight", 1, 2),
    "TL": ("TL m", 1, 2),
    "cut_short": ("cut short %", 100, 1),
    "STOP": ("STOP %", 100, 1),
    "steps": ("steps", 1, 1),
    "decisions": ("decisions", 1, 1),
}


def print_walks(walks: Sequence[Walk]) -> None:
    """A row a mission kind, and one of the goals that are visible from above where some are."""
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from gn0.cli.console import plain_text
    from gn0.training.exams.walks import summarise_walks

    rows = summarise_walks(walks)
    visible = [walk for walk in walks if walk.tier]
    if visible:
        rows[visible[0].tier] = summarise_walks(visible)["all"]
    table = Table(box=box.SIMPLE_HEAD, header_style="bold", padding=(0, 1))
    table.add_column("missions")
    table.add_column("walks", justify="right")
    for title, _, _ in _COLUMNS.values():
        table.add_column(title, justify="right")
    for kind, means in rows.items():
        cells = [f"{f * means[name]:.{n}f}" for name, (_, f, n) in _COLUMNS.items()]
        table.add_row(escape(plain_text(kind)), f"{means['episodes']:.0f}", *cells)
    Console(width=max(150, Console().width), highlight=False).print(table)
