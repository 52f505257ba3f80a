"""Generate missions in scenes: goals, starts, paths, filters, pictures and words.

Each accepted path becomes a goal mission (a goal picture and a short instruction) and route
instructions in two styles; they share the path, so that policies can be compared on it. With
--types follow a person walks the path, and the mission is to follow that person. Rejected
candidates are counted, with the reason, in manifest.json. If it is stopped half-way, give the
same command again: it goes on where it stopped.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import msgspec
import tyro

from gn0.config import Config
from gn0.counted import counted

if TYPE_CHECKING:
    from gn0.missions.generate.settings import MissionSettings
    from gn0.suites.generation_folder import Manifest

EXAMPLES = """  gn0 missions generate out/flat out/house --per-scene 100 --out out/missions
  gn0 missions generate out/corpus --workers 2 --lights 4 --out out/missions
  gn0 missions generate out/flat --missions goal --against out/missions --seed 1 --out out/more
  gn0 missions generate out/flat --goals categories --categories chair,bed --out out/search
  gn0 missions generate out/flat --agent navid --out out/turns-of-30
  gn0 missions generate out/flat --people 5 --agent follower --out out/crowd
  gn0 missions generate out/house --types follow --per-scene 40 --workers 2 --out out/follow
  gn0 missions generate out/house --types follow --levels single --out out/alone
  gn0 missions generate out/flat --spec measures.yaml --out out/strict"""


def _optional(metavar: str) -> Any:
    """A flag that has no default of its own."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint="")


_Int, _Float = _optional("INT"), _optional("FLOAT")
FOLLOW_LENGTH = 8.0  # m: the person walks at least 6 m, up to 2 m ahead of the agent
OWN = ("per_scene", "goals", "starts", "planner", "minimum_length", "maximum_length", "attempts",
       "goal_picture", "lights", "val_seen", "language", "phrasings", "safety_margin",
       "reach")  # fmt: skip


class Args(Config, frozen=True):
    """Scenes, counts and measures. What is not given comes from --spec, else from the defaults.

    Attributes:
        scenes: scene folders, folders of scene folders, or a folder of `gn0 scene corpus`.
        out: the folder to write: a suite, with paths, texts and manifest.
        seed: root seed; the same seed gives the same bytes.
        per_scene: paths per scene (50).
        missions: goal, instruction, follow, with a comma between (goal,instruction).
        levels: who else is there in follow missions: single, distractors, ambiguous, with a comma
            between (all three).
        judge: of the words of follow missions (none): pictures keeps those that pictures prove to
            fit one person in the first second in which the agent sees that person.
        styles: styles of instructions: detailed, benchmark, or both (both).
        goals: objects, rooms, or both (both); or categories, of which any object will do: "Find a
            chair."
        categories: those to search for, with a comma between (all of each scene).
        starts: how starts are drawn (zones): in zones where paths are sparse, far from earlier
            starts, evenly (uniform), or auto.
        planner: any-angle, or astar with lines of sight (any-angle).
        minimum_length: refuse shorter paths [m] (3; 8 where all that is made is follow missions).
        maximum_length: refuse longer paths [m] (200).
        minimum_displacement: refuse paths that end nearer to where they began [m] (1).
        start_radius: compare only paths whose starts are this close [m] (1).
        goal_radius: compare only paths whose goals are this close [m] (1).
        frechet: a smaller Fréchet distance means the same task [m] (0.75).
        safety_margin: inflate obstacles by this beyond the agent's radius [m] (0.05).
        reach: how near to an object the agent has to come [m] (1.5).
        attempts: candidates tried for each path asked for (40).
        goal_picture: view on arrival, crop of the target, or either (mixed).
        lights: lighting conditions per scene, of which each path gets one (0: the original light).
        people: people who walk, stand or sit in each episode, 0 to 16 (0).
        people_seed: who they are and where they go; the paths stay the same (0).
        split: split of scenes whose corpus does not name one.
        val_seen: share of the paths of training scenes held out as split val_seen (0.1).
        against: earlier generations or suites whose paths must not be repeated.
        language: who writes the texts: template, openai or replay (template).
        phrasings: known ones in training scenes and held-out ones elsewhere (by_split), or known or
            held_out ones everywhere; the paths stay the same.
        language_options: options of the language provider, as name=value: model=… base_url=… for
            openai, path=… for replay.
        spec: a YAML or JSON file of settings, with the keys of request.settings in manifest.json.
        agent: name of a preset whose body walks: navid for turns of 30°; its camera too, unless
            --camera names another.
        camera: name of a camera preset (gn_bench; follower where all that is made is follow
            missions); its body too, unless --agent names another.
        name: name of the suite; by default the folder's name.
        workers: processes.
        executor: processes on this machine, or a Ray cluster.
        ray_address: address of a running Ray cluster.
        overwrite: replace another generation in --out.
    """

    scenes: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="SCENE [SCENE ...]", help_behavior_hint="(required)"),
    ]
    out: str
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**62)] = 0
    per_scene: Annotated[int | None, _Int] = None
    missions: Annotated[
        str, tyro.conf.arg(metavar="KINDS", help_behavior_hint="", aliases=("--types",))
    ] = ""
    levels: Annotated[str, _optional("LEVELS")] = ""
    judge: Annotated[Literal["none", "pictures"] | None, _optional("{none,pictures}")] = None
    styles: Annotated[str, _optional("STYLES")] = ""
    goals: Annotated[
        Literal["objects", "rooms", "both", "categories"] | None,
        _optional("{objects,rooms,both,categories}"),
    ] = None
    categories: Annotated[str, _optional("NAMES")] = ""
    starts: Annotated[
        Literal["auto", "zones", "far", "uniform"] | None, _optional("{auto,zones,far,uniform}")
    ] = None
    planner: Annotated[Literal["any-angle", "astar"] | None, _optional("{any-angle,astar}")] = None
    minimum_length: Annotated[float | None, _Float] = None
    maximum_length: Annotated[float | None, _Float] = None
    minimum_displacement: Annotated[float | None, _Float] = None
    start_radius: Annotated[float | None, _Float] = None
    goal_radius: Annotated[float | None, _Float] = None
    frechet: Annotated[float | None, _Float] = None
    safety_margin: Annotated[float | None, _Float] = None
    reach: Annotated[float | None, _Float] = None
    attempts: Annotated[int | None, _Int] = None
    goal_picture: Annotated[
        Literal["mixed", "view", "crop"] | None, _optional("{mixed,view,crop}")
    ] = None
    lights: Annotated[int | None, _Int] = None
    people: Annotated[int | None, _Int] = None
    people_seed: Annotated[Annotated[int, msgspec.Meta(ge=0, le=2**62)] | None, _Int] = None
    split: str = "test"
    val_seen: Annotated[float | None, _Float] = None
    against: tuple[str, ...] = ()
    language: Annotated[str | None, _optional("NAME")] = None
    phrasings: Annotated[
        Literal["by_split", "known", "held_out"] | None, _optional("{by_split,known,held_out}")
    ] = None
    language_options: tuple[str, ...] = ()
    spec: str = ""
    agent: Annotated[str, _optional("NAME")] = ""
    camera: Annotated[str, _optional("NAME")] = ""
    name: str = ""
    workers: Annotated[int, msgspec.Meta(ge=1)] = 1
    executor: Literal["process", "ray"] = "process"
    ray_address: str = ""
    overwrite: Annotated[bool, tyro.conf.arg(aliases=("--fresh",))] = False


def read_settings(args: Args) -> MissionSettings:
    """The settings of --spec with what the command line says put over them.

    Raises:
        ConfigError: a value is out of range; names the flag.
        StorageError, FormatError: the spec cannot be read.
    """
    from gn0.errors import ConfigError
    from gn0.missions.generate.follow_settings import FollowLevelName
    from gn0.missions.generate.settings import (
        MissionKind,
        MissionSettings,
        RouteStyle,
        load_settings,
    )

    settings = load_settings(args.spec) if args.spec else MissionSettings()
    plain: dict[str, Any] = msgspec.to_builtins(settings)
    for name in (*OWN, "minimum_displacement"):
        if getattr(args, name) is not None:
            plain[name] = getattr(args, name)
    for name in ("start_radius", "goal_radius", "frechet"):
        if getattr(args, name) is not None:
            plain["similarity"][name] = getattr(args, name)
    for name in ("missions", "styles", "categories"):
        if getattr(args, name):
            plain[name] = [word.strip() for word in getattr(args, name).split(",")]
    crowd = {"count": args.people, "seed": args.people_seed}
    given = {name: value for name, value in crowd.items() if value is not None}
    if given:
        plain["people"] = {**plain.get("people", {"count": 0}), **given}
    if args.goals == "categories" and not args.missions and not args.spec:
        plain["missions"] = ["goal"]  # a search has no route to tell
    if args.levels:
        levels = [word.strip() for word in args.levels.split(",")]
        plain["follow"] = {**plain.get("follow", {}), "levels": levels}
    if args.judge is not None:
        plain["follow"] = {**plain.get("follow", {}), "judge": args.judge}
    if plain["missions"] == ["follow"] and args.minimum_length is None and not args.spec:
        plain["minimum_length"] = FOLLOW_LENGTH
    if "follow" not in plain["missions"]:
        flag = "--levels" if args.levels else "--judge" if args.judge else ""
        if flag:
            raise ConfigError(
                "is of missions to follow somebody, and none are made",
                where=flag,
                remedy="add --types follow, or goal,follow",
            )
    _check_people(plain, args)
    try:
        return msgspec.convert(plain, MissionSettings)
    except msgspec.ValidationError as error:
        what, _, field = str(error).partition(" - at `$.")
        name = field.rstrip("`").split("[")[0].split(".")[-1].replace("_", "-")
        flag = f"--{name}" if name else "settings"
        choices = {"--missions": MissionKind, "--levels": FollowLevelName, "--styles": RouteStyle}
        words = ", ".join(get_args(choices.get(flag)))
        flag = "--types, --missions" if flag == "--missions" else flag  # one flag of two names
        remedy = f"choose of {words}" if words else "see `gn0 missions generate --help`"
        raise ConfigError(what, where=flag, remedy=remedy) from None


def _check_people(plain: dict[str, Any], args: Args) -> None:
    """Refuse people who would be in no mission.

    Raises:
        ConfigError: names the flag.
    """
    from gn0.errors import ConfigError

    count = plain.get("people", {"count": 0}).get("count", 1)
    if args.people_seed is not None and count == 0:
        raise ConfigError(
            "says who people are, and none are asked for",
            where="--people-seed",
            remedy="add --people N",
        )
    if count != 0 and list(plain["missions"]) == ["follow"]:
        raise ConfigError(
            "is of missions to a goal or along a route; missions to follow bring their own people",
            where="--people" if args.people else "people of the settings",
            remedy="choose --levels, or give follow: {count: 5} in a --spec file; or make both "
            "kinds, --types goal,follow",
        )


def read_options(given: Sequence[str]) -> dict[str, Any]:
    """Options of a language provider from name=value: numbers as numbers, else text.

    Raises:
        ConfigError: one is not of that form.
    """
    import contextlib

    from gn0.errors import ConfigError

    options: dict[str, Any] = {}
    for option in given:
        key, equals, value = option.partition("=")
        if not equals or not key:
            raise ConfigError(
                f"{option!r} is not NAME=VALUE",
                where="--language-options",
                remedy="for example model=NAME",
            )
        options[key] = value
        for kind in (float, int):
            with contextlib.suppress(ValueError):
                options[key] = kind(value)
    return options


def run(args: Args) -> int:
    """Generate, write, and say what came out."""
    from gn0.cli.console import draw_progress
    from gn0.errors import ConfigError
    from gn0.suites.generation import generate_missions

    if not args.scenes:
        raise ConfigError("no scene given", remedy="gn0 missions generate SCENE [SCENE ...]")
    settings, options = read_settings(args), read_options(args.language_options)
    with draw_progress() as progress:
        _, manifest = generate_missions(
            args.scenes,
            args.out,
            settings,
            seed=args.seed,
            split=args.split,
            name=args.name,
            camera=args.camera,
            agent=args.agent,
            against=args.against,
            language_options=options,
            workers=args.workers,
            executor=args.executor,
            ray_address=args.ray_address,
            overwrite=args.overwrite,
            progress=progress,
        )
    print("\n".join(tell(manifest, Path(args.out))))
    return 0


def tell(manifest: Manifest, out: Path) -> list[str]:
    """What a generation did, in lines."""
    t = manifest.totals
    fell = sorted(t.fell.items(), key=lambda item: -item[1])
    missions = ", ".join(f"{n} {name}" for name, n in t.episodes.items())
    splits = ", ".join(f"{n} {name}" for name, n in t.splits.items())
    lines = [
        f"{t.paths} of {counted(t.asked, 'path')} in {counted(t.scenes, 'scene')}, "
        f"{counted(sum(t.episodes.values()), 'episode')}: {missions}",
        f"splits: {splits}",
        f"candidates: {t.candidates}; rejected: "
        + (", ".join(f"{n} {name}" for name, n in fell) or "none"),
        f"goals: {t.targets} of {t.targets + sum(t.targets_fell.values())}; unusable: "
        + (", ".join(f"{n} {why}" for why, n in t.targets_fell.items()) or "none"),
        "texts: " + ", ".join(f"{n} {name}" for name, n in t.texts.items()),
    ]
    if t.follow_candidates:
        fell = sorted(t.follow_fell.items(), key=lambda item: -item[1])
        lines.append(
            f"people to follow: {t.follow_candidates} drawn; rejected: "
            + (", ".join(f"{n} {name}" for name, n in fell) or "none")
        )
    if t.fallbacks:
        reasons = sorted(t.fallbacks.items(), key=lambda item: -item[1])
        shown = "; ".join(f"{n}× {why[:100]}" for why, n in reasons[:3])
        lines.append(f"fallbacks: {sum(t.fallbacks.values())}: {shown}")
    lines += [f"note: {note}" for note in manifest.notes[:6]]
    if len(manifest.notes) > 6:
        lines.append(f"note: {len(manifest.notes) - 6} more in manifest.json")
    lines += [
        f"written to {out}; everything rejected is in {out / 'manifest.json'}",
        f"next: gn0 missions show {out}, gn0 bench run {out} --policy oracle --out {out}-oracle",
    ]
    return lines
