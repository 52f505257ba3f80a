"""The main job in one command: an apartment with people, its suite, its policies, one report.

It needs nothing but this package and takes about a minute and a half on two cores. Everything lands
in one folder; pictures of the apartment, the same as in the README, in `pictures`. Where a trained
policy is in the box, or $GN0_POLICY names one, it walks the first episodes, too: a minute more.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec

from gn0.config import Config
from gn0.progress import Progress

if TYPE_CHECKING:
    from gn0.policies.bae.questions import Questions

EXAMPLES = """  gn0 demo --out out/demo
  gn0 demo --seed 11 --out out/other --workers 2"""
MARKER = "demo.json"  # says that a folder is a demo's, and may be replaced by one
POLICIES = ("oracle", "straight", "wall_follower", "random")
STEPS = 150  # of an episode at most: twice what the longest way in a small apartment takes
PEOPLE = 2  # in each episode, drawn from as many: each is built in a few seconds
TRIED = 5  # episodes of the trained policy, which thinks for half a second


class Args(Config, frozen=True):
    """Where to write, and which apartment.

    Attributes:
        out: the folder to fill.
        seed: seed of the apartment and of its episodes.
        episodes: goal episodes in the suite.
        density: Gaussians per square metre of floor.
        workers: processes that run episodes; 0 means one per core, at most 4.
        overwrite: replace an earlier demo in that folder.
    """

    out: str
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**62)] = 12
    episodes: Annotated[int, msgspec.Meta(ge=1, le=10_000)] = 20
    density: Annotated[float, msgspec.Meta(ge=5_000, le=20_000)] = 10_000.0
    workers: Annotated[int, msgspec.Meta(ge=0, le=64)] = 0
    overwrite: bool = False


def run(args: Args) -> int:
    """Run the demo; 1 when an episode failed to run."""
    import os

    from gn0.bench.report import write_report
    from gn0.bench.runner import run_suite
    from gn0.cli.compile_ahead import compile_ahead
    from gn0.cli.console import draw_progress
    from gn0.cli.result_tables import print_summaries
    from gn0.people.settings import PeopleSettings
    from gn0.scenes.procedural.generate import GenerateSettings, generate_scene
    from gn0.suites.suite import build_suite

    trained = find_trained()
    started = time.monotonic()
    out = Path(args.out)
    workers = args.workers or min(4, os.cpu_count() or 1)
    claim_folder(out, args)
    with draw_progress() as progress:
        settings = GenerateSettings(seed=args.seed, size="small", density=args.density)
        with compile_ahead("missions", "walk", cores=2):
            generate_scene(settings, out / "apartment", progress=progress)
        _draw_pictures(out / "apartment", out / "pictures", args.seed, progress)
        suite = build_suite(
            [out / "apartment"],
            out / "suite",
            count=args.episodes,
            seed=args.seed,
            camera=choose_camera(trained),
            max_steps=STEPS,
            people=PeopleSettings(count=PEOPLE, seed=args.seed, variety=PEOPLE),
            progress=progress,
        )
        runs = [out / "runs" / name for name in POLICIES]
        summaries = [
            run_suite(suite, name, run_folder, workers=workers, progress=progress)
            for name, run_folder in zip(POLICIES, runs, strict=True)
        ]
        if trained is not None:
            runs.insert(1, out / "runs" / "bae")
            options = {"checkpoint": str(trained.folder.resolve()), "backend": "numpy"}
            summary = run_suite(
                suite, "bae", runs[1], workers=workers, policy_options=options,
                max_episodes=TRIED, progress=progress,
            )  # fmt: skip
            summaries.insert(1, summary)
        write_report(runs, out / "report.html", suite=suite, videos=2, progress=progress)
    print_summaries(summaries)
    if trained is None:
        print("this installation came without its trained policy: see release/README.md")
    else:
        few = min(TRIED, args.episodes)
        print(f"bae, the trained policy, walked the first {few} of {args.episodes} episodes")
    print(f"pictures: {out / 'pictures'}")
    print(f"report:   {(out / 'report.html').resolve()}   (open it in a browser)")
    print(f"took {time.monotonic() - started:.0f} s")
    return 1 if any(summary.failed for summary in summaries) else 0


def find_trained() -> Questions | None:
    """The trained policy of this installation, or that $GN0_POLICY names; None without one.

    Raises:
        CheckpointError: the named one is none, or the one that is here is damaged.
    """
    import os

    from gn0.errors import CheckpointError
    from gn0.policies.bae.questions import Questions
    from gn0.policies.bae.shipped import VARIABLE, find_checkpoint

    try:
        folder = find_checkpoint()
    except CheckpointError:
        if os.environ.get(VARIABLE):
            raise
        return None
    return Questions(folder)


def choose_camera(trained: Questions | None) -> str:
    """The camera of the suite: that of the trained policy where it is shown camera pictures."""
    if trained is None or not {"rgb", "history", "depth"} & set(trained.settings.pictures):
        return "gn_bench"
    return trained.settings.preset


def claim_folder(out: Path, args: Args) -> None:
    """Make `out` ours: empty or absent, or an earlier demo that may be replaced.

    Raises:
        StorageError: it holds something else.
    """
    import shutil

    from gn0.storage import check_replaceable, write_json

    check_replaceable(out, overwrite=args.overwrite, marker=MARKER)
    if out.exists():
        shutil.rmtree(out)
    write_json(out / MARKER, {name: getattr(args, name) for name in args.__struct_fields__})


def _draw_pictures(scene_folder: Path, pictures: Path, seed: int, progress: Progress) -> None:
    """The sheet, and its four views as files of their own, with people in some of them."""
    from gn0.render.open import build_renderer
    from gn0.render.renderer import DrawnScene
    from gn0.scenes.folder import load_scene
    from gn0.sim.people_eyes import PeopleEyes
    from gn0.viewer.bystanders import show_bystanders
    from gn0.viewer.scene_sheet import render_sheet, render_views
    from gn0.viewer.viewpoints import choose_viewpoints

    progress("drawing the apartment", 0, 1)
    scene = load_scene(scene_folder)
    renderer = build_renderer(scene.gaussians)
    pictures.mkdir(parents=True, exist_ok=True)
    poses = choose_viewpoints(scene, renderer=renderer)
    eyes = PeopleEyes(scene, DrawnScene(renderer))
    people = show_bystanders(eyes, poses, 800.0, seed=seed)
    render_sheet(scene, renderer, people=people).save(pictures / "sheet.jpg", quality=90)
    views = render_views(renderer, poses, 800, 600, people=people)
    for number, view in enumerate(views, 1):
        view.save(pictures / f"view_{number}.jpg", quality=90)
    progress("drawing the apartment", 1, 1)
