"""Names that other commands take: policies, presets, sensors, exports, formats and more."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Annotated, Literal, get_args

import tyro

from gn0.config import Config

EXAMPLES = """  gn0 list policies
  gn0 list policies --plugin my_policy.py
  gn0 list exports
  gn0 list presets"""
Kind = Literal[
    "policies", "presets", "sensors", "exports", "formats", "profiles", "renderers", "metrics",
    "prompts",
]  # fmt: skip


class Args(Config, frozen=True):
    """What to list.

    Attributes:
        kind: policies, presets (of `--camera` and `--agent`), sensors, exports (of `gn0 export`),
            formats (splats and episodes that are read), profiles, renderers (of `--backend`),
            metrics, or prompts (of `gn0 data prompt`).
        plugin: modules or .py files to import first.
    """

    kind: Annotated[Kind, tyro.conf.Positional, tyro.conf.arg(metavar="KIND")]
    plugin: tuple[str, ...] = ()


def run(args: Args) -> int:
    """Print a line a name."""
    from gn0.plugins import import_plugins

    import_plugins(args.plugin)
    rows = list(_KINDS[args.kind]())
    width = max(len(name) for name, _ in rows) + 2
    for name, what in rows:
        print(f"{name:<{width}}{what}".rstrip())
    return 0


def list_kinds() -> tuple[str, ...]:
    """What can be listed."""
    return get_args(Kind)


def _first_line(thing: object) -> str:
    return (getattr(thing, "__doc__", "") or "").strip().split("\n")[0]


def _policies() -> Iterator[tuple[str, str]]:
    from gn0.plugins import get_plugin, plugin_names

    for name in plugin_names("policy"):
        policy = get_plugin("policy", name)
        said = getattr(policy, "sensors", ())
        known = said if isinstance(said, Collection) else ()  # a property: once it is built
        reads = ", ".join(sorted(known)) or "what its options say, or nothing"
        if hasattr(policy, "reset_privileged"):
            reads = "the simulator itself: an oracle"
        yield name, f"{_first_line(policy)} [reads {reads}]"


def _presets() -> Iterator[tuple[str, str]]:
    from gn0.sim.presets import find_preset, preset_names

    for name in preset_names():
        preset = find_preset(name)
        agent = preset.agent
        width, height = preset.picture_size
        yield (
            name,
            f"{width}x{height} colour, {preset.depth.width}x{preset.depth.height} depth; body of "
            f"{agent.radius:g} m, eye {agent.camera_height:g} m, step {agent.forward_step:g} m, "
            f"turn {agent.turn_degrees:g}°, {agent.step_seconds:g} s an action",
        )


def _sensors() -> Iterator[tuple[str, str]]:
    import numpy as np

    from gn0.plugins import is_builtin
    from gn0.sim.sensor.sensor import MAP_SIDE
    from gn0.sim.sensor.table import carry_sensors, sensor_names
    from gn0.sim.sensors import SensorConfig
    from gn0.sim.words import TOKEN_LIMIT

    for sensor in carry_sensors(sensor_names()).sensors:
        space = sensor.find_space(SensorConfig())
        kind = np.dtype(space.dtype).name
        if MAP_SIDE in space.shape:
            sides = iter("HW")
            shape = [next(sides) if side == MAP_SIDE else str(side) for side in space.shape]
            what = f"{kind} [{', '.join(shape)}], H and W of the scene's map"
        else:
            what = f"{kind} {list(space.shape)} with preset gn_bench"
        yield sensor.name, what if is_builtin("sensor", sensor.name) else f"{what}: {sensor.doc}"
    yield "instruction", "text; in Gymnasium environments, policies always have it"
    yield (
        "instruction_tokens",
        f"int32 [{TOKEN_LIMIT}], its bytes; in Gymnasium environments only",
    )
    yield "instruction_index", "int32, a number in their `episodes`; in Gymnasium environments only"


def _exports() -> Iterator[tuple[str, str]]:
    from gn0.export.exporter import get_dataset_exporter
    from gn0.plugins import plugin_names

    for name in plugin_names("dataset_exporter"):
        exporter = get_dataset_exporter(name)
        yield name, f"{exporter.title} [read by {exporter.reader}]"


def _formats() -> Iterator[tuple[str, str]]:
    from gn0.gaussians.splat_files import READABLE
    from gn0.plugins import get_plugin, plugin_names

    yield "splats", READABLE
    for name in plugin_names("scene_source"):
        yield f"scenes: {name}", _first_line(get_plugin("scene_source", name))
    for name in plugin_names("exporter"):
        yield f"episodes: {name}", _first_line(get_plugin("exporter", name))


def _profiles() -> Iterator[tuple[str, str]]:
    from gn0.suites.profiles import PROFILES

    for name in PROFILES:
        yield name, ""


def _renderers() -> Iterator[tuple[str, str]]:
    from gn0.plugins import get_plugin, plugin_names
    from gn0.render.open import choose_backend

    for name in plugin_names("renderer"):
        yield name, _first_line(get_plugin("renderer", name))
    yield "auto", "here: {}: {}".format(*choose_backend("auto"))


def _metrics() -> Iterator[tuple[str, str]]:
    from gn0.bench.follow_metrics import FOLLOW_METRICS
    from gn0.bench.metrics import METRICS

    for info in METRICS:
        yield info.key, info.title
    for info in FOLLOW_METRICS:
        yield f"following: {info.key}", info.title


def _prompts() -> Iterator[tuple[str, str]]:
    from gn0.policies.bae.prompt_template import load_prompt, prompt_names

    for name in prompt_names():
        prompt = load_prompt(name)
        what = ", ".join(prompt.pictures)
        parts = f"; parts {', '.join(prompt.parts)}" if prompt.parts else ""
        yield name, f"{prompt.task} from {what}; {prompt.points} waypoints, {prompt.layout}{parts}"


_KINDS = {
    "policies": _policies,
    "presets": _presets,
    "sensors": _sensors,
    "exports": _exports,
    "formats": _formats,
    "profiles": _profiles,
    "renderers": _renderers,
    "metrics": _metrics,
    "prompts": _prompts,
}
