"""Drive a run's recorded actions through the simulator again, and say where it parts, if it does.

Every line of results.jsonl and trajectories.jsonl is made again and compared byte for byte, and
the summary with the results. No policy is needed; with --policy the policy itself runs again.
"""

from __future__ import annotations

from typing import Annotated

import msgspec
import tyro

from gn0.config import Config

EXAMPLES = """  gn0 bench replay out/walls
  gn0 bench replay elsewhere/walls --suite out/suite
  gn0 bench replay out/walls --policy --workers 2"""


class Args(Config, frozen=True):
    """Which run, and what to run again.

    Attributes:
        run: a run folder, as written by `gn0 bench run`.
        suite: its suite, if that is no longer where it was.
        policy: ask the policy again instead of taking its recorded actions.
        workers: processes, with --policy.
    """

    run: Annotated[str, tyro.conf.Positional]
    suite: str = ""
    policy: bool = False
    workers: Annotated[int, msgspec.Meta(ge=1, le=256)] = 1


def run(args: Args) -> int:
    """Print what was found; 1 when anything parted."""
    from gn0.bench.replay import replay_run, rerun_policy
    from gn0.cli.console import draw_progress, plain_text

    with draw_progress() as progress:
        suite = args.suite or None
        if args.policy:
            replay = rerun_policy(args.run, suite, workers=args.workers, progress=progress)
        else:
            replay = replay_run(args.run, suite, progress=progress)
    print(plain_text(str(replay), lines=True))
    return 0 if replay.ok else 1
