"""Let a policy drive through a suite and label every state it visits with the expert's actions.

DAgger collects the states that the policy really visits, mistakes included, with what would have
been right there. The result is a dataset like any other, whose samples also hold the policy's own
answers. People may be in the way, or be followed. A collection that was stopped goes on when the
same command is given again, and has the same bytes for any number of workers.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import tyro

from gn0.config import Config

EXAMPLES = """  gn0 data dagger out/suite --policy wall_follower --beta 0.5 --out out/dagger
  gn0 data dagger out/suite --policy random --beta 0.8 --schedule power --iteration 3 --out out/d3
  gn0 data dagger out/suite --policy remote --policy-option url=ws://127.0.0.1:8000 --beta 0 \\
      --workers 2 --pictures webdataset --out out/mine
  gn0 data dagger out/suite --policy mine --plugin mine.py --agents 32 --chunk 64 --out out/wide
  gn0 data dagger out/suite --policy mine --plugin mine.py --agents 64 --backend cuda --out out/card
  gn0 data dagger out/suite --policy mine --plugin mine.py --shard 2/8 --out out/shard-2
  gn0 data dagger out/suite --policy straight --halting gn0-release --out out/official
  gn0 data dagger out/suite --policy recorded --policy-option run=out/by_hand --labels own \\
      --beta 0 --halting none --out out/demonstrations"""


class Args(Config, frozen=True):
    """What to collect and where to write.

    Attributes:
        suite: a suite folder, as `gn0 missions generate` and `gn0 bench suite` write.
        out: the dataset folder; an interrupted collection there goes on.
        policy: name of the policy that drives, as in `gn0 bench run`.
        policy_option: an option of the policy as NAME=VALUE; may be given several times.
        beta: probability at each step that the expert acts instead of the policy.
        schedule: how beta changes with the iteration: constant; power, beta^(iteration-1); first,
            the expert alone in iteration 1 and the policy alone after it.
        iteration: number of this iteration, from 1.
        halting: what ends an episode near the goal: paper, ten steps within the success distance
            and then STOP; gn0-release, ten steps after leaving the goal zone; none.
        labels: how actions are labelled: exact, mpc, gn0-release, or field; by default exact, or
            gn0-release with that halting rule. own: with what the policy itself did next, so that
            its walks are demonstrations (--beta 0 --halting none).
        inside: where the goal is a room, metres behind its entrance where labels say STOP, and
            where the policy has arrived; 0: as soon as it is in it.
        tokens: what map tokens refer to: the whole map (global) or a square around the agent.
        answer_order: what comes first where the dataset's answers are written as text: the actions,
            or the waypoints, as in the paper's prompts (paper).
        pictures: the cache of pictures: webdataset, lerobot, or none (`gn0 data render` makes one
            later).
        map_mode: what the maps shown to the policy hold; by default what the suite says.
        max_steps: actions until an episode is cut off; by default what the suite says.
        seed: seed of the draws that decide who acts.
        chunk: episodes that a worker takes at a time.
        agents: episodes, out of a --chunk, that each worker drives side by side: a policy that
            takes many agents is asked once a step; never changes a byte.
        backend: what draws what the policy sees: cpu or cuda. Their pictures differ by rounding,
            so the policy may go another way. With cuda and one worker the agents of --agents are
            on the card, too.
        workers: processes; never changes a byte.
        executor: where the workers run: on this machine, or on a Ray cluster.
        ray_address: the cluster to join, e.g. auto; empty starts one on this machine alone.
        bank: folder of the bank of people whom episodes name; those named are copied into the
            dataset. Drawn people (drawn:0:7) need none.
        shard: i/n collects the i-th of n shards, on a machine of its own; `gn0 data merge` joins
            them into the same dataset that is collected without it. Empty collects all.
        plugin: modules to import first; they call `gn0.plugins.register` for your policies.
        fresh: forget what an earlier command left in the output folder, instead of going on.
    """

    suite: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SUITE")]
    out: str
    policy: str
    policy_option: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    beta: Annotated[float, msgspec.Meta(ge=0, le=1)] = 0.5
    schedule: Literal["constant", "power", "first"] = "constant"
    iteration: Annotated[int, msgspec.Meta(ge=1, le=1_000_000)] = 1
    halting: Literal["paper", "gn0-release", "none"] = "paper"
    labels: Literal["", "exact", "mpc", "gn0-release", "field", "own"] = ""
    inside: Annotated[float, msgspec.Meta(ge=0, le=5)] = 0
    tokens: Literal["global", "ego"] = "global"
    answer_order: Literal["paper", "actions_first"] = "actions_first"
    pictures: Literal["webdataset", "lerobot", "none"] = "none"
    map_mode: Literal["prior", "explored", "none"] | None = None
    max_steps: Annotated[int, msgspec.Meta(ge=0, le=1_000_000)] = 0
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**62)] = 0
    chunk: Annotated[int, msgspec.Meta(ge=1, le=100_000)] = 8
    agents: Annotated[int, msgspec.Meta(ge=1, le=4096)] = 1
    backend: Literal["cpu", "cuda"] = "cpu"
    workers: Annotated[int, msgspec.Meta(ge=1, le=256)] = 1
    executor: Literal["process", "ray"] = "process"
    ray_address: str = ""
    bank: str = ""
    shard: str = ""
    plugin: tuple[str, ...] = ()
    fresh: Annotated[bool, tyro.conf.arg(aliases=("--overwrite",))] = False


def run(args: Args) -> int:
    """Collect, and say what the policy did and what it should have done."""
    from gn0.cli.bench_run import read_options
    from gn0.cli.console import draw_progress
    from gn0.data.build import build_shard
    from gn0.data.collect import build_dagger, check_dagger, describe_summary, sum_up
    from gn0.data.dataset import DATASET_FILE
    from gn0.data.drawing_process import with_backend
    from gn0.data.expert_labels import LabelSettings
    from gn0.data.settings import BuildSettings, DaggerSettings, PictureSettings, TokenSettings
    from gn0.data.shard import ShardName, describe_shard
    from gn0.locked_folder import forget_folder
    from gn0.plugins import import_plugins
    from gn0.suites.suite import open_suite

    out = Path(args.out)
    name = ShardName.parse(args.shard) if args.shard else None
    if args.fresh:
        forget_folder(out, DATASET_FILE)
    with draw_progress() as progress:
        suite = open_suite(args.suite, beside=f"{args.out.rstrip('/')}-episodes")
        settings = BuildSettings(
            tokens=TokenSettings(frame=args.tokens, order=args.answer_order),
            labels=LabelSettings(variant=_label_variant(args), inside=args.inside),
            chunk=args.chunk,
            pictures=with_backend(PictureSettings(layout=args.pictures), args.backend),
            dagger=DaggerSettings(
                policy=args.policy,
                options=read_options(args.policy_option),
                beta=args.beta,
                schedule=args.schedule,
                iteration=args.iteration,
                halting=args.halting,
                success_radius=suite.about.success_radius,
                map_mode=args.map_mode or suite.map_mode,
                max_steps=args.max_steps or suite.about.max_steps,
                seed=args.seed,
                plugins=import_plugins(args.plugin),
                demonstrate=args.labels == "own",
            ),
        )
        work: dict[str, Any] = {
            "workers": args.workers,
            "executor": args.executor,
            "ray_address": args.ray_address,
            "agents": args.agents,
            "bank": args.bank or None,
            "progress": progress,
        }
        if name is not None:
            shard = build_shard(suite, out, name, check_dagger(settings), **work)
        else:
            dataset = build_dagger(suite, out, settings, **work)
    if name is not None:
        print(describe_shard(shard, args.out))
        return 0
    print(describe_summary(sum_up(dataset)))
    print(f"dataset: {out}")
    print(f"next:    gn0 data balance {out}    or train on it as it is")
    return 0


def _label_variant(args: Args) -> Literal["exact", "mpc", "gn0-release", "field"]:
    """How the expert labels; a demonstration needs him for the distance to the goal alone."""
    if args.labels and args.labels != "own":
        return args.labels
    return "gn0-release" if args.halting == "gn0-release" else "exact"
