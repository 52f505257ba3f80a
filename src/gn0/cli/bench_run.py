"""Run a policy over a suite, score it, and write the report.

A scene folder given as a suite means fifty goal episodes sampled with seed 0, written beside the
results. Results are the same bytes for any number of workers; a run that was stopped goes on
where it stopped when the same command is given again. Failed episodes are then tried again,
scored ones never.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import tyro

from gn0.config import Config
from gn0.errors import BenchError, ConfigError

EXAMPLES = """  gn0 bench run out/house --policy oracle --out out/house-oracle
  gn0 bench run out/suite --policy wall_follower --workers 2 --out out/walls
  gn0 bench run out/suite --policy explorer --map-mode explored --out out/explored
  gn0 bench run out/suite --policy explorer --agents 32 --out out/together
  gn0 bench run out/suite --policy random --limit 5 --no-report --out out/try
  gn0 bench run out/suite --executor ray --ray-address auto --workers 16 --out out/many
  gn0 bench run out/suite --policy bae --policy-option checkpoint=out/sft/policy \\
      --control shuffled --out out/shuffled
  gn0 bench run out/suite --policy straight --profile gn0-release --out out/official
  gn0 bench run follow-demo --policy oracle --out out/following
  gn0 bench run out/suite --policy remote --policy-option url=ws://127.0.0.1:8000 --out out/remote
  gn0 bench run out/suite --policy mine --plugin my_policies.py --name "mine, v2" --out out/v2"""


class Args(Config, frozen=True):
    """What to run and where to write.

    Attributes:
        suite: a suite folder, or a scene folder; or follow-demo: people to follow in two homes,
            made on first use.
        out: the results folder; an interrupted run there is resumed.
        policy: name of a policy (oracle, straight, wall_follower, random, remote, or a plug-in).
        name: what tables, reports and comparisons call this run; by default what the policy
            calls itself. Not part of the run's identity: another one later runs nothing again.
        policy_option: an option of the policy as NAME=VALUE; may be given several times.
        workers: processes; never changes a result.
        agents: episodes that each worker runs side by side: a policy that takes many agents is
            asked once a step, and pictures are drawn in one call; never changes a result.
        executor: where the workers run: on this machine, or on a Ray cluster.
        ray_address: the cluster to join, e.g. auto; empty starts one on this machine alone.
        gpus: GPUs that Ray sets aside for each worker: 1, or a part of one that several share.
        map_mode: what the maps shown to the policy hold: the whole scene (prior), what the agent
            has seen (explored), or nothing (none). By default what the suite says; part of the
            run's identity.
        track: what a policy may be told, e.g. object, instruction, image+pose, point+pose; by
            default what the suite says. A policy that asks for more gets a table of its own.
        isolate: run the policy in a process of its own: it shares no memory with the harness, gets
            no path to suite or scene, and starts in an empty folder.
        profile: default, paper, gn0-release (the official harness beside ours), vlnce (the body of
            VLN-CE's own task), or evt (following judged by EVT-Bench's numbers); by default what
            the suite says.
        control: take something away from the policy: its words (no_words: every text is "go"), its
            own words (shuffled: another episode's of the scene), or its pictures (no_pictures:
            black); part of the run's identity.
        bank: folder of the bank of people whom episodes name; drawn people need none.
        limit: run only the first so many episodes; 0 means all.
        visible_sets: draw only splats that can be seen near each place: quicker, nearly the same
            pictures. Off for scored runs; part of the run's identity and protocol card.
        backend: what draws pictures, if the policy sees any: cpu, cuda, or the best available
            (auto); part of the run's identity.
        time_limit: seconds an episode may take before it counts as failed.
        fresh: forget an earlier run in the output folder instead of resuming it.
        keep_failed: leave episodes that failed in an earlier run as they are, instead of trying
            them again.
        no_report: do not write report.html.
        videos: how many episodes the report shows as video.
        plugin: .py files or modules to import first; they call `gn0.plugins.register` for your
            policies.
    """

    suite: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SUITE")]
    out: str
    policy: str = "oracle"
    name: str = ""
    policy_option: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    workers: Annotated[int, msgspec.Meta(ge=1, le=256)] = 1
    agents: Annotated[int, msgspec.Meta(ge=1, le=4096)] = 1
    executor: Literal["process", "ray"] = "process"
    ray_address: str = ""
    gpus: Annotated[float, msgspec.Meta(ge=0, le=64)] = 0.0
    map_mode: Literal["prior", "explored", "none"] | None = None
    track: str = ""
    isolate: bool = False
    profile: Literal["", "default", "paper", "gn0-release", "vlnce", "evt"] = ""
    control: Literal["none", "no_words", "shuffled", "no_pictures"] = "none"
    bank: str = ""
    limit: Annotated[int, msgspec.Meta(ge=0), tyro.conf.arg(aliases=("--episodes",))] = 0
    visible_sets: bool = False
    backend: Literal["auto", "cpu", "cuda"] = "auto"
    time_limit: Annotated[float, msgspec.Meta(gt=0)] = 300.0
    fresh: Annotated[bool, tyro.conf.arg(aliases=("--overwrite",))] = False
    keep_failed: bool = False
    no_report: bool = False
    videos: Annotated[int, msgspec.Meta(ge=0, le=64)] = 4
    plugin: tuple[str, ...] = ()


def run(args: Args) -> int:
    """Run, print the table, write the report; 1 when an episode failed to run."""
    from gn0.bench.identity import digest_policy
    from gn0.bench.results import count_notes
    from gn0.bench.run_bank import check_clips
    from gn0.bench.run_folder import check_run_folder
    from gn0.bench.runner import choose_episodes, run_suite
    from gn0.cli.console import draw_progress, plain_text, say_backend
    from gn0.cli.result_tables import print_summaries
    from gn0.plugins import import_plugins
    from gn0.render.open import visible_backend
    from gn0.suites.named_suites import open_named
    from gn0.suites.track import read_track

    out = Path(args.out)
    check_run_folder(out)  # and the policy, before the suite of a scene is written into it
    modules = import_plugins(args.plugin, only_locate=args.isolate)
    digest_policy(args.policy, modules, isolated=args.isolate)
    if args.fresh:
        _forget_suite(Path(args.suite), out / "suite")
    say_backend(args.backend)
    with draw_progress() as progress:
        suite = open_named(args.suite, beside=out, progress=progress)
        suite = suite.with_profile(args.profile or suite.about.profile)
        suite = suite.with_map_mode(args.map_mode or suite.map_mode)
        suite = suite.with_track(read_track(args.track) or suite.track)
        if args.videos and not args.no_report:  # not when all is played, and a bank is too late
            check_clips(choose_episodes(suite, args.limit or None), args.bank or None)
        summary = run_suite(
            suite,
            args.policy,
            out,
            workers=args.workers,
            resume=not args.fresh,
            episode_time_limit=args.time_limit,
            max_episodes=args.limit or None,
            plugin_modules=args.plugin,
            policy_options=read_options(args.policy_option),
            backend=visible_backend(args.backend) if args.visible_sets else args.backend,
            progress=progress,
            executor=args.executor,
            ray_address=args.ray_address,
            gpus=args.gpus,
            keep_failed=args.keep_failed,
            name=args.name,
            isolate=args.isolate,
            agents=args.agents,
            control=args.control,
            bank=args.bank or None,
            tell=lambda text: print(plain_text(text)),
        )
        report = None
        if not args.no_report:
            from gn0.bench.report import write_report

            report = write_report(
                [out], out / "report.html", suite=suite, videos=args.videos,
                bank=args.bank or None, progress=progress,
            )  # fmt: skip
    print_summaries([summary])
    for line in _tell_notes(count_notes(out)):
        print(plain_text(line))
    print(f"results: {out / 'results.jsonl'}")
    if report is not None:
        print(f"report:  {report}")
    return 0 if not summary.failed else 1


def _tell_notes(notes: Mapping[str, tuple[int, int]]) -> list[str]:
    """What the policy said was odd, the first few of it, as a run ends."""
    lines = [
        f"note: the policy says: {name}, {often} in {episodes} of the episodes"
        for name, (often, episodes) in list(notes.items())[:6]
    ]
    more = len(notes) - len(lines)
    return [*lines, f"note: it says {more} other things, see results.jsonl"] if more else lines


def _forget_suite(scene: Path, suite: Path) -> None:
    """Remove the episodes that an earlier run sampled, where a scene is to be sampled again."""
    if suite.is_symlink() or not (suite / "suite.json").is_file():
        return
    from gn0.locked_folder import lock_folder

    inside = scene.resolve().is_relative_to(suite.resolve())
    if (scene / "scene.json").is_file() and not (scene / "suite.json").is_file() and not inside:
        with lock_folder(suite.parent, refuse=BenchError):
            shutil.rmtree(suite)


def read_options(options: Sequence[str]) -> dict[str, Any]:
    """NAME=VALUE texts as keyword arguments; a value that reads as JSON is one.

    Raises:
        ConfigError: no NAME=VALUE, or a name given twice.
    """
    found: dict[str, Any] = {}
    for option in options:
        name, equals, value = option.partition("=")
        name = name.strip().replace("-", "_")
        if not equals or not name.isidentifier() or name in found:
            raise ConfigError(
                f"policy option {option!r} "
                + ("is given twice" if name in found else "is not NAME=VALUE"),
                where="--policy-option",
                remedy="for example url=ws://127.0.0.1:8000",
            )
        try:
            found[name] = msgspec.json.decode(value)
        except msgspec.DecodeError:
            found[name] = value
    return found
