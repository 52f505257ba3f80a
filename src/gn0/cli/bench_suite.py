"""Build a suite of goal episodes from one or more scene folders."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import tyro

from gn0.config import Config

EXAMPLES = """  gn0 bench suite out/flat out/house --episodes 50 --minimum-length 5 --out out/suite
  gn0 bench suite out/flat --map-mode explored --out out/unknown-flat"""


class Args(Config, frozen=True):
    """Scenes and sampling.

    Attributes:
        scenes: scene folders.
        out: the suite folder to write.
        episodes: episodes a scene.
        seed: seed of the sampler.
        minimum_length: shortest geodesic from start to goal [m].
        camera: name of a camera preset.
        map_mode: what the maps shown to a policy hold: the whole scene (prior), what the agent has
            seen (explored), or nothing (none).
        overwrite: replace an existing suite.
    """

    scenes: Annotated[tuple[str, ...], tyro.conf.Positional]
    out: str
    episodes: Annotated[int, msgspec.Meta(ge=1)] = 50
    seed: int = 0
    minimum_length: Annotated[float, msgspec.Meta(ge=0)] = 3.0
    camera: str = "gn_bench"
    map_mode: Literal["prior", "explored", "none"] = "prior"
    overwrite: bool = False


def run(args: Args) -> int:
    """Sample, write, and say what came out."""
    from gn0.bench.suite import build_suite
    from gn0.cli.console import draw_progress
    from gn0.errors import ConfigError

    if not args.scenes:
        raise ConfigError("no scene folder given", remedy="gn0 bench suite SCENE [SCENE ...]")
    with draw_progress() as progress:
        suite = build_suite(
            args.scenes,
            args.out,
            count=args.episodes,
            seed=args.seed,
            minimum_length=args.minimum_length,
            camera=args.camera,
            map_mode=args.map_mode,
            overwrite=args.overwrite,
            progress=progress,
        )
    print(f"{len(suite.episodes)} episodes in {len(args.scenes)} scenes, written to {args.out}")
    return 0
