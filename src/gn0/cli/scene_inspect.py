"""What a splat file holds: format, count, SH degree, axes, size, dropped splats, oddities."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Annotated, Any

import tyro

from gn0.config import Config

EXAMPLES = """  gn0 scene inspect point_cloud.ply
  gn0 scene inspect capture.spz
  gn0 scene inspect streamed_sog_folder --level 2
  gn0 scene inspect capture.sog --json"""


class Args(Config, frozen=True):
    """The file.

    Attributes:
        file: a splat file of any format, or the folder of an unbundled SOG.
        level: level of detail of a streamed SOG, 0 the finest.
        json: print plain JSON for scripts.
    """

    file: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SPLATS")]
    level: int | None = None
    json: bool = False


def run(args: Args) -> int:
    """Print what the file holds."""
    from gn0.cli.console import draw_progress, plain_text
    from gn0.gaussians.splat_files import describe_cloud_file

    with draw_progress("reading the file"):
        facts = describe_cloud_file(args.file, level=args.level)
    if args.json:
        print(json.dumps(facts, indent=1))
        return 0
    for name, text in _lines(facts):
        print(f"{name:<12}{plain_text(text)}")
    return 0


def _lines(facts: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """(name, text) of what a person wants to know, in that order."""
    yield "file", facts["file"]
    kind = f"{facts['format']}, {facts['encoding']}" if facts["encoding"] else facts["format"]
    yield (
        "format",
        f"{kind}; {facts['bytes'] / 1e6:,.2f} MB, {facts['bytes_per_gaussian']} bytes per Gaussian",
    )
    dropped = facts["dropped_non_finite"]
    left_out = f"; {dropped:,} more left out as non-finite" if dropped else ""
    yield "Gaussians", f"{facts['gaussians']:,}{left_out}"
    if facts["levels"] > 1:
        yield (
            "detail",
            f"level {facts['level']} of 0 (finest) to {facts['levels'] - 1}: --level chooses",
        )
    degree = facts["sh_degree"]
    yield (
        "colour",
        (
            f"spherical harmonics of degree {degree}: it changes with the view"
            if degree
            else "plain: it does not change with the view (SH degree 0)"
        ),
    )
    yield "axes", facts["axes"]
    (low, high), (inner_low, inner_high) = facts["bounds_m"], facts["bounds_98_percent_m"]
    yield (
        "size",
        f"{_extent(low, high)} in file units; 98 % within {_extent(inner_low, inner_high)}",
    )
    yield "from … to", f"{_point(low)} … {_point(high)}"
    scales, opacities = facts["scale_m_at_1_50_99_percent"], facts["opacity_at_1_50_99_percent"]
    yield (
        "scales",
        f"{scales[1]:.3g} in the middle, 98 % between {scales[0]:.3g} and {scales[2]:.3g}",
    )
    yield (
        "opacities",
        (
            f"{opacities[1]:.2f} in the middle, "
            f"98 % between {opacities[0]:.2f} and {opacities[2]:.2f}"
        ),
    )
    if facts["extra_properties"]:
        yield "unused", "properties " + _some(facts["extra_properties"])
    if facts["extra_elements"]:
        yield (
            "unused",
            "elements " + _some([f"{n} ({c})" for n, c in facts["extra_elements"].items()]),
        )
    for comment in facts["comments"][:20]:
        yield "comment", comment
    for note in facts["notes"]:
        yield "note", note
    yield "hash", facts["content_hash"]


def _extent(low: list[float], high: list[float]) -> str:
    return " x ".join(f"{b - a + 0.0:.3g}" for a, b in zip(low, high, strict=True))


def _point(values: list[float]) -> str:
    return "(" + ", ".join(f"{v + 0.0:.3g}" for v in values) + ")"


def _some(names: list[str]) -> str:
    more = f" and {len(names) - 8} more" if len(names) > 8 else ""
    return ", ".join(names[:8]) + more
