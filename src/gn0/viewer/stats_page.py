"""The statistics page of a dataset: one HTML file that opens from disk and runs no script."""

from __future__ import annotations

import base64
import hashlib
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import jinja2
import msgspec
import numpy as np
from markupsafe import Markup
from PIL import Image

from gn0.bench.report_maps import data_uri
from gn0.counted import counted
from gn0.data.dataset_stats import ACTION_NAMES, Coverage, DatasetStats, Spread
from gn0.data.people_stats import PeopleStats

TEMPLATES = Path(__file__).parent / "templates"
MAPS = 24  # coverage maps shown
CATEGORIES = 30  # categories shown
_WIDE, _HIGH = 520, 150  # of a chart [px]
_HOT = ((0.98, 0.90, 0.62), (0.95, 0.62, 0.24), (0.80, 0.24, 0.18), (0.42, 0.06, 0.22))


@dataclass(frozen=True)
class Bar:
    """A bar of a chart: place and size [px], and what it says when pointed at."""

    x: float
    y: float
    width: float
    height: float
    title: str


@dataclass(frozen=True)
class Chart:
    """A histogram: bars, marks below it [(x, text)], and its numbers in words."""

    title: str
    bars: tuple[Bar, ...]
    marks: tuple[tuple[float, str], ...]
    words: str


def render_stats(
    stats: DatasetStats,
    coverage: Sequence[Coverage],
    sheets: Sequence[tuple[str, bytes]] = (),
) -> str:
    """The page as HTML.

    Args:
        stats: the numbers.
        coverage: where samples lie in each scene.
        sheets: sample sheets to look at: a caption, and the bytes of a JPEG.
    """
    style = (TEMPLATES / "stats.css").read_text("utf-8")
    digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode()
    policy = (
        f"default-src 'none'; img-src data:; style-src 'sha256-{digest}'; "
        "base-uri 'none'; form-action 'none'"
    )
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    sources: dict[str, int] = {}
    for scene in stats.scenes:
        sources[scene.source] = sources.get(scene.source, 0) + 1
    return environment.get_template(
        "stats.html"
    ).render(
        style=Markup(style),  # noqa: S704 (our own file, byte for byte what the hash covers)
        content_policy=policy,
        stats=stats,
        counted=counted,
        total=sum(stats.samples.values()),
        sources=rank(sources),
        wide=_WIDE,
        high=_HIGH,
        charts=[
            draw_histogram("Path length", stats.length, "m"),
            draw_histogram("Actions in an episode", stats.steps, ""),
            draw_histogram("Turns of 30° and more in an episode", stats.turns, "", whole=True),
            draw_histogram("Words in an instruction", stats.words, "", whole=True),
        ],
        actions=[
            (name, stats.actions.get(name, 0.0), stats.balanced.get(name), stats.paper[name])
            for name in ("forward", "left", "right", "stop")
        ],
        categories=rank(stats.categories, CATEGORIES),
        hidden=max(len(stats.categories) - CATEGORIES, 0),
        frequent=rank(stats.frequent),
        funnel=rank(stats.candidates, keep_order=True),
        maps=[(c.scene, data_uri(draw_coverage(c), "image/png")) for c in coverage[:MAPS]],
        maps_hidden=max(len(coverage) - MAPS, 0),
        sheets=[(caption, data_uri(data, "image/jpeg")) for caption, data in sheets],
        static=_share(stats.missions, "goal", "instruction"),
        dynamic=_share(stats.missions, "follow"),
        action_names=ACTION_NAMES,
        people=None if stats.people is msgspec.UNSET else stats.people,
        people_tables=[] if stats.people is msgspec.UNSET else _people_tables(stats.people),
    )


def _people_tables(people: PeopleStats) -> list[tuple[str, list[tuple[str, int, float]]]]:
    """Titles and rows of what people are and do, those that say anything."""
    found = {
        "Samples by task": people.tasks,
        "Follow missions by walk": people.categories,
        "Follow missions by level": people.levels,
        "Moments by clip": people.clips,
        "Episodes by how many people": people.episodes,
        "Walkers by speed [m/s]": people.speeds,
    }
    return [(title, rank(counts, keep_order=True)) for title, counts in found.items() if counts]


def _share(counts: Mapping[str, int], *names: str) -> float:
    return 100 * sum(counts.get(n, 0) for n in names) / max(sum(counts.values()), 1)


def rank(
    counts: Mapping[str, int], most: int = 10**6, *, keep_order: bool = False
) -> list[tuple[str, int, float]]:
    """(name, count, share of the largest [%]), most first unless the order matters."""
    items = list(counts.items())
    if not keep_order:
        items.sort(key=lambda item: (-item[1], item[0]))
    largest = max((n for _, n in items), default=0) or 1
    return [(name, n, round(100 * n / largest, 2)) for name, n in items[:most]]


def draw_histogram(title: str, spread: Spread, unit: str, *, whole: bool = False) -> Chart:
    """A histogram as bars [px] in a box of 520 x 150."""
    most = max(spread.bins) or 1
    step = _WIDE / len(spread.bins)
    bars = []
    for k, n in enumerate(spread.bins):
        low, high = spread.edges[k], spread.edges[k + 1]
        if whole:
            last = int(high) - 1
            over = f"{int(low)}" if last <= low else f"{int(low)} to {last}"
        else:
            over = f"{low:.4g} to {high:.4g}"
        height = _HIGH * n / most
        bars.append(
            Bar(round(k * step, 2), round(_HIGH - height, 2), round(step - 1, 2), round(height, 2),
                f"{over}{unit and ' ' + unit}: {n:,}")
        )  # fmt: skip
    every = max(1, len(spread.bins) // 6)
    marks = tuple(
        (round(k * step, 2), f"{spread.edges[k]:.4g}") for k in range(0, len(spread.bins), every)
    )
    words = (
        f"mean {spread.mean:.3g}{unit and ' ' + unit}, median {spread.median:.3g}, 5 to 95 %: "
        f"{spread.low:.3g} to {spread.high:.3g}, {spread.smallest:.3g} to {spread.largest:.3g}"
    )
    return Chart(title, tuple(bars), marks, words)


def draw_coverage(coverage: Coverage, side: int = 420) -> bytes:
    """Where samples lie, as PNG: ground pale, the more samples the darker; north (+y) up."""
    ground = coverage.ground[..., None]
    paper, floor = np.array((0.96, 0.955, 0.94)), np.array((0.86, 0.87, 0.89))
    picture = paper * (1 - ground) + floor * ground
    visits = coverage.visits.astype(np.float64)
    if visits.max() > 0:
        level = np.log1p(visits) / np.log1p(visits.max()) * (len(_HOT) - 1)
        low = np.clip(level.astype(int), 0, len(_HOT) - 2)
        colours = np.array(_HOT)
        part = (level - low)[..., None]
        hot = colours[low] * (1 - part) + colours[low + 1] * part
        picture = np.where(visits[..., None] > 0, hot, picture)
    image = Image.fromarray((picture[::-1] * 255 + 0.5).astype(np.uint8))
    scale = max(1, side // max(image.size))
    image = image.resize((image.width * scale, image.height * scale), Image.Resampling.NEAREST)
    stream = io.BytesIO()
    image.save(stream, "PNG")
    return stream.getvalue()
