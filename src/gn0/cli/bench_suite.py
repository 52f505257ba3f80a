"""Build a suite of goal episodes from one or more scene folders."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import tyro

from gn0.config import Config
from gn0.counted import counted

EXAMPLES = """  gn0 bench suite out/flat out/house --episodes 50 --minimum-length 5 --out out/suite
  gn0 bench suite out/flat --map-mode explored --out out/unknown-flat
  gn0 bench suite out/flat --track point+pose --out out/point-goals
  gn0 bench suite out/flat --people 3 --people-seed 1 --out out/lived-in
  gn0 bench suite out/flat --radius 0.35 --camera-height 0.8 --out out/wide-robot"""


class Args(Config, frozen=True):
    """Scenes and sampling.

    Attributes:
        scenes: scene folders.
        out: the suite folder to write.
        episodes: episodes per scene.
        seed: seed of the sampler.
        minimum_length: shortest geodesic from start to goal [m].
        camera: name of a camera preset.
        radius: radius of the agent's body [m], instead of the preset's.
        camera_height: of the agent's eye above the floor [m], instead of the preset's.
        map_mode: what the maps shown to a policy hold: the whole scene (prior), what the agent has
            seen (explored), or nothing (none).
        track: what a policy may be told: how the goal is given (object, instruction, image, point),
            and +pose where it may know its pose.
        people: who walk, stand and sit in each episode.
        people_seed: who they are and where they go.
        overwrite: replace an existing suite.
    """

    scenes: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="SCENE [SCENE ...]", help_behavior_hint="(required)"),
    ]
    out: str
    episodes: Annotated[int, msgspec.Meta(ge=1)] = 50
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**62)] = 0
    minimum_length: Annotated[float, msgspec.Meta(ge=0)] = 3.0
    camera: str = "gn_bench"
    radius: Annotated[float, msgspec.Meta(ge=0, le=5)] | None = None
    camera_height: Annotated[float, msgspec.Meta(gt=0, le=10)] | None = None
    map_mode: Literal["prior", "explored", "none"] = "prior"
    track: str = "object"
    people: Annotated[int, msgspec.Meta(ge=0, le=16)] = 0
    people_seed: Annotated[int, msgspec.Meta(ge=0, le=2**62)] = 0
    overwrite: bool = False


def run(args: Args) -> int:
    """Sample, write, and say what came out."""
    from gn0.cli.console import draw_progress
    from gn0.errors import ConfigError
    from gn0.people.settings import PeopleSettings
    from gn0.sim.presets import find_preset
    from gn0.suites.suite import build_suite
    from gn0.suites.track import read_track

    if not args.scenes:
        raise ConfigError("no scene folder given", remedy="gn0 bench suite SCENE [SCENE ...]")
    body = {"radius": args.radius, "camera_height": args.camera_height}
    agent = msgspec.structs.replace(
        find_preset(args.camera).agent, **{k: v for k, v in body.items() if v is not None}
    )
    crowd = PeopleSettings(count=args.people, seed=args.people_seed)
    with draw_progress() as progress:
        suite = build_suite(
            args.scenes,
            args.out,
            count=args.episodes,
            seed=args.seed,
            minimum_length=args.minimum_length,
            camera=args.camera,
            agent=agent,
            map_mode=args.map_mode,
            people=crowd if args.people else None,
            track=read_track(args.track),
            overwrite=args.overwrite,
            progress=progress,
        )
    episodes, scenes = counted(len(suite.episodes), "episode"), counted(len(args.scenes), "scene")
    print(f"{episodes} in {scenes}, written to {args.out}")
    return 0
