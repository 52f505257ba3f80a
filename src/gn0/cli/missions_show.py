"""Draw an episode: its path over the map and the bird's-eye view, with its instruction.

A goal that is given by a picture is shown with it. Without an episode: one picture per scene of
all its paths or, with --coverage, of how many pass through each spot. For a third-party set whose
scenes are missing, numbers are printed, and its paths are drawn on white.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from gn0.config import Config
from gn0.counted import counted

if TYPE_CHECKING:
    from PIL import Image

    from gn0.missions.episode import Episode
    from gn0.scenes.scene import Scene
    from gn0.suites.suite import Suite

EXAMPLES = """  gn0 missions show out/suite
  gn0 missions show out/suite flat_0003 --out flat_0003.png
  gn0 missions show out/missions --coverage --out out/coverage
  gn0 missions show val_seen.json.gz"""


class Args(Config, frozen=True):
    """What to draw and where to.

    Attributes:
        path: a suite folder, a scene folder (the fifty goal episodes sampled in it), or an episode
            set in another format.
        episode: id of an episode; by default all of them, one picture per scene.
        out: the picture to write (.png, .jpg), or a folder for several; by default beside the
            suite.
        no_rooms: leave out the outlines of rooms.
        coverage: show how many paths pass through each spot, instead of the paths.
        split: only episodes of this split.
    """

    path: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SUITE")]
    episode: Annotated[
        str,
        tyro.conf.Positional,
        tyro.conf.arg(metavar="[EPISODE]", help_behavior_hint="(optional)"),
    ] = ""
    out: str = ""
    no_rooms: bool = False
    coverage: bool = False
    split: str = ""


def run(args: Args) -> int:
    """Draw and write."""
    from gn0.suites.suite import SUITE_FILE

    folder = Path(args.path)
    if (folder / SUITE_FILE).is_file() or (folder / "scene.json").is_file():
        return _show_suite(args)
    return _show_set(args)


def draw_episode(
    suite: Suite,
    episode: Episode | None,
    scene_id: str = "",
    rooms: bool = True,
    coverage: bool = False,
    split: str = "",
) -> Image.Image:
    """The overlay of one episode, with its goal picture, or of all of a scene."""
    from gn0.missions.episode import MissionGoal
    from gn0.render.open import build_renderer
    from gn0.suites.suite import load_suite_scene
    from gn0.viewer.overlay import render_overlay

    name = episode.scene_id if episode is not None else scene_id
    scene = load_suite_scene(suite.scene_folder(name), name, suite.scene_hash(name))
    chosen = [episode] if episode else [e for e in suite.episodes if e.scene_id == name]
    chosen = [e for e in chosen if not split or e.split == split]
    inside = [scene.grid.is_free(x, y) for e in chosen for x, y in (e.start[:2], *e.path, e.goal)]
    free = f"{sum(inside) / max(len(inside), 1):.1%} of {len(inside)} points on free cells"
    words = free if coverage else f"{free}   ·   {tell_legend(chosen)}"
    picture = render_overlay(
        scene,
        chosen,
        build_renderer(scene.gaussians),
        rooms=rooms,
        caption=[words],
        coverage=coverage,
    )
    if episode is not None and isinstance(episode.mission, MissionGoal) and episode.mission.picture:
        return _beside(picture, look_at_goal(suite, scene, episode))
    return picture


def tell_legend(episodes: Sequence[Episode]) -> str:
    """What the colours of episodes drawn together mean."""
    followed = sum(e.followed is not None for e in episodes)
    stars = ["goal"] * (followed < len(episodes) or not episodes)
    stars += ["where the person to follow ends"] * bool(followed)
    lines = [f"green: start, star: {', or '.join(stars)}, red: not on free cells"]
    people = ["purple: the person to follow"] * bool(followed)
    if any(len(e.people) > (e.followed is not None) for e in episodes):
        people.append("grey: other people" if followed else "grey: people")
    return "   ·   ".join([*lines, ", ".join(people)] if people else lines)


def look_at_goal(suite: Suite, scene: Scene, episode: Episode) -> Image.Image:
    """The goal picture of an episode, as the agent is shown it."""
    from PIL import Image

    from gn0.sim.open import open_simulator

    simulator = open_simulator(
        scene, suite.about.camera, sensors=("goal_picture",), agent=suite.about.agent
    )
    picture = simulator.reset(episode).goal_picture
    assert picture is not None
    return Image.fromarray(picture)


def _beside(left: Image.Image, right: Image.Image) -> Image.Image:
    """Two pictures next to each other, the right one half as wide."""
    from PIL import Image

    width = left.width // 2
    small = right.resize((width, round(right.height * width / right.width)))
    size = (left.width + width, max(left.height, small.height))
    both = Image.new("RGB", size, left.getpixel((0, left.height - 1)))
    both.paste(left, (0, 0))
    both.paste(small, (left.width, 0))
    return both


def _show_suite(args: Args) -> int:
    from gn0.cli.console import draw_progress
    from gn0.cli.picture_file import check_picture, is_picture, write_picture
    from gn0.errors import ConfigError, EpisodeError
    from gn0.suites.named_suites import open_named

    suite = open_named(args.path)
    home = Path(args.path).resolve()
    known = {episode.id: episode for episode in suite.episodes}
    if args.episode:
        if args.episode not in known:
            import difflib

            near = difflib.get_close_matches(args.episode, known, n=1)
            raise EpisodeError(
                f"no episode {args.episode!r}",
                where=args.path,
                remedy=f"did you mean {near[0]!r}?" if near else f"the first is {min(known)!r}",
            )
        name = "".join(c if c.isalnum() or c in "._-" else "_" for c in args.episode)
        jobs = [(args.episode, "", Path(args.out) if args.out else home.parent / f"{name}.png")]
    else:
        out = Path(args.out) if args.out else home.parent / f"{home.name}-overlays"
        many = len(suite.about.scenes) > 1
        several = not out.suffix or (many and not is_picture(args.out))
        if many and not several:
            raise ConfigError(
                f"{args.out[:80]!r} is one picture, and this suite has "
                f"{counted(len(suite.about.scenes), 'scene')}",
                where="--out",
                remedy="give a folder, or an episode",
            )
        jobs = [
            ("", scene.id, out / f"{scene.id}.png" if several else out)
            for scene in suite.about.scenes
        ]
    for _, _, path in jobs:
        check_picture(str(path))
    with draw_progress() as progress:
        for done, (episode, scene, path) in enumerate(jobs):
            progress("drawing", done, len(jobs))
            picture = draw_episode(
                suite, known.get(episode), scene, not args.no_rooms, args.coverage, args.split
            )
            write_picture(str(path), picture)
        progress("drawing", len(jobs), len(jobs))
    for _, _, path in jobs:
        print(f"written to {path}")
    return 0


def _show_set(args: Args) -> int:
    from gn0.cli.picture_file import check_picture, write_picture
    from gn0.missions.sets.episode_set import load_set
    from gn0.missions.sets.frame_check import summarise
    from gn0.viewer.overlay import render_paths

    if args.out:
        check_picture(args.out)
    found = load_set(args.path)
    tasks = [task for task in found.tasks if not args.episode or task.id == args.episode]
    told = summarise(tasks)
    print(
        f"{found.format}, {found.name}: {counted(told.episodes, 'episode')} in "
        f"{counted(told.scenes, 'scene')}"
    )
    for name, values, unit in (
        ("reference path", told.path_length, "m"),
        ("start to goal, straight", told.straight, "m"),
        ("instruction", told.words, "words"),
    ):
        low, middle, high = values
        print(f"  {name:<24} {low:8.1f} {middle:8.1f} {high:8.1f} {unit}  (least, median, most)")
    if told.no_goal:
        print(f"  {told.no_goal} have no goal: they cannot be scored")
    if told.storeys:
        print(f"  {told.storeys} change storey; maps here have one floor")
    for note in found.notes:
        print(f"  {note}")
    if args.out and tasks:
        scene = max(found.scenes, key=lambda s: sum(t.scene == s for t in tasks))
        write_picture(args.out, render_paths([t.points for t in tasks if t.scene == scene]))
        print(f"paths of {scene}: {args.out}")
    return 0
