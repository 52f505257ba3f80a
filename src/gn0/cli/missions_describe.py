"""Describe the routes of a suite: steps, landmarks, the three texts and what the check says.

With `--out` a picture of each: the steps from above beside the views on the way.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import msgspec
import tyro

from gn0.config import Config

if TYPE_CHECKING:
    from gn0.missions.language.providers import TextProvider
    from gn0.missions.language.route import RouteDescription

EXAMPLES = """  gn0 missions describe out/suite flat_0003
  gn0 missions describe out/suite --limit 5 --seed 2
  gn0 missions describe out/suite flat_0003 --out out/routes
  gn0 missions describe out/suite --provider openai --model Qwen/Qwen3-8B \\
      --base-url http://localhost:8000/v1"""


class Args(Config, frozen=True):
    """Which routes, and who puts them into words.

    Attributes:
        suite: a suite folder, or a scene folder for the fifty goal episodes sampled in it.
        episodes: ids of episodes; by default the first ones.
        limit: how many, where none are named.
        provider: who writes: the grammar, a language server, or recorded answers.
        model: name of the model (openai, replay).
        base_url: address of the server up to "/v1" (openai); by default $OPENAI_BASE_URL. The
            key is taken from $OPENAI_API_KEY.
        recording: folder or file of recorded answers (replay).
        seed: seed of the choice of words.
        held_out: use only the skeletons that are kept for unseen splits.
        out: folder for pictures; by default none are drawn.
    """

    suite: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SUITE")]
    episodes: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="[EPISODE ...]", help_behavior_hint="(optional)"),
    ] = ()
    limit: Annotated[int, msgspec.Meta(ge=1, le=10_000), tyro.conf.arg(aliases=("--count",))] = 3
    provider: Literal["template", "openai", "replay"] = "template"
    model: str = ""
    base_url: str = ""
    recording: str = ""
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**62)] = 0
    held_out: bool = False
    out: str = ""


def run(args: Args) -> int:
    """Describe and print; 1 when a text of the provider was not accepted."""
    import numpy as np

    from gn0.cli.console import draw_progress
    from gn0.maps.navigation import NavigationMap
    from gn0.missions.episode import MissionFollow
    from gn0.missions.language.describe import describe_route
    from gn0.scenes.scene import SceneObject, SceneRoom
    from gn0.suites.suite import load_suite_scene, open_suite

    suite = open_suite(args.suite)
    chosen = _choose(suite.episodes, args)
    provider = open_named(args)
    refused = 0
    for name in dict.fromkeys(episode.scene_id for episode in chosen):
        scene = load_suite_scene(suite.scene_folder(name), name, suite.scene_hash(name))
        by_id: dict[str, SceneObject | SceneRoom] = {
            **{r.id: r for r in scene.rooms},
            **{t.id: t for t in scene.objects},
        }
        maps: dict[float, NavigationMap] = {}
        for episode in chosen:
            if episode.scene_id != name:
                continue
            if isinstance(episode.mission, MissionFollow):
                print(f"{episode.id}, scene {name}: “{episode.mission.instruction}”")
                print("  the person chooses the way: there is no route to describe\n")
                continue
            radius = episode.agent.radius
            with draw_progress("describing the route"):
                navigation = maps.setdefault(radius, NavigationMap(scene.grid, radius))
                path = np.array(episode.path or (episode.start[:2], episode.goal))
                target = by_id.get(getattr(episode.mission, "object_id", ""))
                route = describe_route(scene, navigation, path, episode.start[2], target)
            print(f"{episode.id}, {route.length:.1f} m, scene {name}")
            refused += _print_route(route, provider, args)
            if args.out:
                _draw(scene, route, path, episode.start[2], Path(args.out) / f"{episode.id}.png")
    return 1 if refused else 0


def open_named(args: Args) -> TextProvider:
    """The provider that the arguments name.

    Raises:
        ConfigError: an option is missing.
    """
    from gn0.missions.language.providers import open_provider

    if args.provider == "openai":
        return open_provider("openai", model=args.model, base_url=args.base_url)
    if args.provider == "replay":
        return open_provider("replay", path=args.recording, model=args.model)
    return open_provider("template")


def _choose(episodes, args: Args):  # type: ignore[no-untyped-def]
    from gn0.errors import EpisodeError

    if not args.episodes:
        return list(episodes)[: args.limit]
    known = {episode.id: episode for episode in episodes}
    for name in args.episodes:
        if name not in known:
            import difflib

            near = difflib.get_close_matches(name, known, n=1)
            raise EpisodeError(
                f"no episode {name!r}",
                where=args.suite,
                remedy=f"did you mean {near[0]!r}?" if near else f"the first is {min(known)!r}",
            )
    return [known[name] for name in args.episodes]


def _print_route(route: RouteDescription, provider: TextProvider, args: Args) -> int:
    """Print steps and texts; how many texts fell back to the grammar."""
    from gn0.missions.language.text_check import check_text
    from gn0.missions.language.write import write_texts
    from gn0.viewer.route_picture import landmark_words, segment_words

    for number, segment in enumerate(route.segments, 1):
        more = ", ".join(landmark_words(m) for m in segment.landmarks[1:])
        print(f"  {number:2d}  {segment_words(segment)}" + (f"   (also {more})" if more else ""))
    target = route.target
    print(f"      to the {target.name}" + (f", {target.room}" if target.room else ""))
    refused = 0
    texts = write_texts(route, provider, seed=args.seed, held_out=args.held_out)
    for style, text in texts.items():
        faults = check_text(text.text, route, style)
        verdict = "; ".join(faults) if faults else "passes"
        print(f"  {style:<9}  “{text.text}”")
        print(f"             {text.provider} {text.version}, check: {verdict}")
        if text.fallback:
            print(f"             not by {text.fallback}")
            refused += 1
    print()
    return refused


def _draw(scene, route, path, yaw: float, out: Path) -> None:  # type: ignore[no-untyped-def]
    from gn0.cli.console import draw_progress
    from gn0.render.open import build_renderer
    from gn0.storage import write_atomic
    from gn0.viewer.route_picture import render_route

    with draw_progress("drawing the route"):
        picture = render_route(scene, build_renderer(scene.gaussians), route, path, yaw)
    write_atomic(out, lambda stream: picture.save(stream, "PNG"))
    print(f"  drawn to {out}")
