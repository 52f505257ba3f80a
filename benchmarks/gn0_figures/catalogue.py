"""All figures, by id, of the rooms whose packages are installed."""

from __future__ import annotations

from importlib import import_module

from gn0.errors import ConfigError
from gn0_figures.board import Figure

_MODULES = (
    "install", "gaussians", "splat_formats", "maps", "render", "device_checks", "device_table",
    "device_parts", "device_labels",
    "device_rates", "device_people", "device_suite", "device_sanitizers", "scenes", "capture",
    "procedural",
    "scene_kinds", "sim", "ppo", "mapping", "vector", "bench", "crowd", "policies", "missions",
    "targets", "generate", "language", "samples", "data_gpu", "labels", "export", "view", "trust",
    "proof", "ego", "field_labels", "bae", "closed_loop", "sft", "speeds", "scaling", "sharded",
    "dagger", "dapo", "episode_rl", "training_state", "people_dress", "people_looks", "people_sim",
    "people_words", "people_follow", "people_bench", "people_render", "people_render_cuda",
    "people_mesh", "people_motion",
)  # fmt: skip


def all_figures() -> dict[str, Figure]:
    """Every figure by id, in room order; see `left_out`."""
    figures: dict[str, Figure] = {}
    for name in _MODULES:
        try:
            module = import_module(f"gn0_figures.{name}")
        except ModuleNotFoundError as error:
            if (error.name or "gn0").split(".")[0] == "gn0":
                raise
            continue
        for figure in module.FIGURES:
            figures[figure.id] = figure
    return figures


def left_out() -> dict[str, str]:
    """Rooms whose figures need a package that is not installed here, and which."""
    missing: dict[str, str] = {}
    for name in _MODULES:
        try:
            import_module(f"gn0_figures.{name}")
        except ModuleNotFoundError as error:
            missing[name] = str(error.name)
    return missing


def find_figures(patterns: list[str]) -> list[Figure]:
    """Figures whose id equals a pattern or starts with it plus a dot.

    Raises:
        ConfigError: a pattern matches nothing.
    """
    catalogue = all_figures()
    found: list[Figure] = []
    for pattern in patterns:
        hits = [f for i, f in catalogue.items() if i == pattern or i.startswith(pattern + ".")]
        if not hits:
            lacking = "".join(f"; {room} needs {package}" for room, package in left_out().items())
            raise ConfigError(
                f"no figure {pattern!r}", remedy="known: " + ", ".join(catalogue) + lacking
            )
        found += [hit for hit in hits if hit not in found]
    return found
