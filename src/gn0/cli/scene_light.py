"""See a scene in other light, and write a variant of it: brighter, warmer, at dusk, at night.

Geometry, depth and labels stay unchanged. Every picture of an episode, the bird's-eye view
included, is made in the one light that is recorded with it.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
import tyro

from gn0.config import Config

EXAMPLES = """  gn0 scene light out/flat
  gn0 scene light out/flat --seed 3 --count 12 --out lights.jpg
  gn0 scene light out/flat --mood dusk --count 4
  gn0 scene light out/flat --mood dusk --write out/flat-dusk
  gn0 scene light out/flat --mood custom --exposure -1 --kelvin 3200 --write out/flat-warm"""


class Args(Config, frozen=True):
    """The scene, the lights, and what to write.

    Attributes:
        folder: a scene folder.
        out: contact sheet to write, JPEG or PNG; default: NAME-light.jpg beside the scene.
        seed: seed of the conditions.
        count: conditions on the sheet; 6 when left out, of a named mood 1.
        mood: only this one, each time drawn anew; custom takes the numbers below, once.
        exposure: stops brighter or darker, -6 to 6.
        kelvin: colour temperature of the light, 1500 to 20000; 5500 leaves colours alone.
        contrast: contrast of light and shadow, 0 to 2, if the scene keeps them.
        saturation: saturation of colours, 0 to 2.
        write: also write the first condition's scene as a folder of its own.
        overwrite: replace that folder.
    """

    folder: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")]
    out: str = ""
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**62)] = 0
    count: Annotated[int, msgspec.Meta(ge=1, le=60)] | None = None
    mood: Literal[
        "bright day", "overcast", "warm lamps", "cool tubes", "dusk", "night", "any", "custom"
    ] = "any"
    exposure: Annotated[float, msgspec.Meta(ge=-6, le=6)] = 0.0
    kelvin: Annotated[float, msgspec.Meta(ge=1500, le=20000)] = 5500.0
    contrast: Annotated[float, msgspec.Meta(ge=0, le=2)] = 1.0
    saturation: Annotated[float, msgspec.Meta(ge=0, le=2)] = 1.0
    write: str = ""
    overwrite: bool = False


_NUMBERS = ("exposure", "kelvin", "contrast", "saturation")


def run(args: Args) -> int:
    """Draw the sheet, and write the variant that was asked for."""
    from dataclasses import replace
    from pathlib import Path

    from gn0.cli.console import draw_progress
    from gn0.cli.picture_file import check_picture, write_picture
    from gn0.cli.scene_import import print_scene
    from gn0.errors import StorageError
    from gn0.render.light import LightCondition, condition_names, draw_condition, relight_cloud
    from gn0.scenes.folder import load_scene, save_scene
    from gn0.storage import check_replaceable, plain_path
    from gn0.viewer.light_sheet import render_light

    _check_mood(args)
    folder = Path(args.folder)
    scene = load_scene(folder)
    out = folder.resolve().parent / f"{folder.resolve().name}-light.jpg"
    if args.out:
        check_picture(args.out)
        out = Path(args.out)
    if args.write:  # said now, not after the drawing
        target = plain_path(args.write)
        if target.resolve() == folder.resolve():
            raise StorageError(
                "the scene itself cannot be its variant", where=target, remedy="choose another name"
            )
        check_replaceable(target, overwrite=args.overwrite, marker="scene.json")
    moods = condition_names()
    if args.mood == "custom":
        conditions = [LightCondition(name="custom", **{k: getattr(args, k) for k in _NUMBERS})]
    elif args.mood == "any":  # each mood comes before any comes again
        conditions = [
            draw_condition(args.seed, scene.id, k, mood=moods[k % len(moods)])
            for k in range(args.count or 6)
        ]
    else:
        conditions = [
            draw_condition(args.seed, scene.id, k, mood=args.mood) for k in range(args.count or 1)
        ]
    with draw_progress() as progress:
        sheet = render_light(scene, conditions, progress=progress)
        write_picture(str(out), sheet)
        if args.write:
            lit = conditions[0]
            settings = {**scene.source.settings, "lit": lit.name}
            source = msgspec.structs.replace(scene.source, settings=settings)
            variant = replace(
                scene,
                id=Path(args.write).resolve().name,
                source=source,
                load_cloud=lambda: relight_cloud(scene.gaussians, lit),
                cloud_hash="",
            )
            written = save_scene(variant, args.write, overwrite=args.overwrite, progress=progress)
    print(f"written to {out}")
    if args.write:
        print_scene(written, args.write)
    return 0


def _check_mood(args: Args) -> None:
    """Refuse numbers that the named moods would not look at, and a light by numbers many times.

    Raises:
        ConfigError: names them.
    """
    from gn0.errors import ConfigError

    plain = Args(folder=args.folder)
    given = [f"--{k}" for k in _NUMBERS if getattr(args, k) != getattr(plain, k)]
    if given and args.mood != "custom":
        raise ConfigError(
            f"{' and '.join(given)} without effect: the mood is {args.mood!r}, not custom",
            where="gn0 scene light",
            remedy="add --mood custom, or leave them out",
        )
    if args.mood == "custom" and args.count not in (None, 1):
        raise ConfigError(
            f"--count {args.count}: a light by its numbers is one",
            where="gn0 scene light",
            remedy="leave --count out, or name another mood",
        )
