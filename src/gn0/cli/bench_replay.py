"""Drive a run's recorded actions through the simulator again, and say where it differs.

Every line of results.jsonl and trajectories.jsonl is made again and compared byte for byte, and
the summary with the results. No policy is needed; with --policy NAME that policy runs again. What
the run folder itself names (modules, addresses, options, paths) is shown, never obeyed.
"""

from __future__ import annotations

from typing import Annotated

import msgspec
import tyro

from gn0.config import Config

EXAMPLES = """  gn0 bench replay out/walls
  gn0 bench replay elsewhere/walls --suite out/suite
  gn0 bench replay out/walls --policy wall_follower --workers 2
  gn0 bench replay out/far --policy remote --policy-option url=ws://127.0.0.1:8000"""


class Args(Config, frozen=True):
    """Which run, and what to run again.

    Attributes:
        run: a run folder, as written by `gn0 bench run`.
        suite: its suite, if it was not run from here.
        bank: folder of the bank of people whom episodes name; drawn people need none.
        policy: ask this policy again instead of taking the recorded actions.
        policy_option: an option of the policy as NAME=VALUE; may be given several times.
        plugin: modules to import first, with --policy.
        workers: processes, with --policy.
    """

    run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    suite: str = ""
    bank: str = ""
    policy: str = ""
    policy_option: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    plugin: tuple[str, ...] = ()
    workers: Annotated[int, msgspec.Meta(ge=1, le=256)] = 1


def run(args: Args) -> int:
    """Print what was found; 1 when anything parted."""
    from gn0.bench.replay import replay_run, rerun_policy
    from gn0.cli.bench_run import read_options
    from gn0.cli.console import draw_progress, plain_text
    from gn0.errors import ConfigError

    if not args.policy and (args.policy_option or args.plugin):
        raise ConfigError(
            "options or plug-ins without a policy", where="--policy", remedy="add --policy NAME"
        )
    with draw_progress() as progress:
        suite = args.suite or None
        if args.policy:
            replay = rerun_policy(
                args.run,
                args.policy,
                suite,
                workers=args.workers,
                policy_options=read_options(args.policy_option),
                plugin_modules=args.plugin,
                bank=args.bank or None,
                progress=progress,
            )
        else:
            replay = replay_run(args.run, suite, bank=args.bank or None, progress=progress)
    print(plain_text(str(replay), lines=True))
    return 0 if replay.ok else 1
