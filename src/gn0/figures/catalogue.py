"""All figures, by id; each room's module is imported only when asked for."""

from __future__ import annotations

from importlib import import_module

from gn0.errors import ConfigError
from gn0.figures.board import Figure

_MODULES = (
    "install", "gaussians", "splat_formats", "maps", "render", "device_checks", "device_table",
    "device_rates", "scenes", "capture", "procedural",
    "scene_kinds", "sim", "mapping", "vector", "bench", "policies", "missions", "generate",
    "language", "samples", "labels", "export", "view", "trust",
)  # fmt: skip


def all_figures() -> dict[str, Figure]:
    """Every figure by id, in room order."""
    figures: dict[str, Figure] = {}
    for name in _MODULES:
        module = import_module(f"gn0.figures.{name}")
        for figure in module.FIGURES:
            figures[figure.id] = figure
    return figures


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
            raise ConfigError(f"no figure {pattern!r}", remedy="known: " + ", ".join(catalogue))
        found += [hit for hit in hits if hit not in found]
    return found
