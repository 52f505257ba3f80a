"""The statistics page counts what is there, and no name in it becomes markup."""

from __future__ import annotations

import math
from collections import Counter
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gn0.data.build import build_dataset
from gn0.data.dataset import Dataset
from gn0.data.dataset_stats import Coverage, DatasetStats, count_turns, measure_dataset, spread_of
from gn0.data.settings import BuildSettings, PictureSettings
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.render.light import LightCondition
from gn0.scenes.folder import save_scene
from gn0.suites.suite import save_suite
from gn0.testing.scenes import build_room_scene
from gn0.viewer.stats_page import draw_coverage, render_stats


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Eight walks through one flat, labels alone; two at dusk, three of them for training."""
    root = tmp_path_factory.mktemp("stats")
    scene = save_scene(build_room_scene(), root / "flat")
    episodes = sample_goal_episodes(scene, NavigationMap(scene.grid), 8, minimum_length=1.5)
    dusk = LightCondition(name="dusk", exposure=-1)
    episodes = [
        msgspec.structs.replace(
            e, split="train" if k < 3 else "test", light=dusk if k < 2 else None,
            path_id=f"p{k // 2}",
        )
        for k, e in enumerate(episodes)
    ]  # fmt: skip
    suite = save_suite(root / "suite", [scene], episodes, name="walks")
    return build_dataset(
        suite, root / "data", BuildSettings(pictures=PictureSettings(layout="none"))
    )


@pytest.fixture(scope="module")
def measured(dataset: Dataset) -> tuple[DatasetStats, list[Coverage]]:
    return measure_dataset(dataset)


def test_counts_agree_with_the_episodes_and_tables(
    dataset: Dataset, measured: tuple[DatasetStats, list[Coverage]]
) -> None:
    stats, _ = measured
    assert stats.episodes == {"test": {"goal": 5}, "train": {"goal": 3}}
    assert stats.missions == {"goal": 8} and stats.lights == {"as made": 6, "dusk": 2}
    assert stats.paths == 4 and sum(stats.samples.values()) == dataset.about.rows
    labels = np.concatenate([np.stack(t["actions"].to_pylist()) for t in dataset.sample_tables()])
    counts = np.bincount(labels[:, 0], minlength=4) / len(labels) * 100
    for name, share in zip(("stop", "forward", "left", "right"), counts, strict=True):
        assert stats.actions[name] == pytest.approx(share)
    assert stats.steps.count == 8 and stats.steps.mean == pytest.approx(len(labels) / 8)
    assert sum(stats.categories.values()) == 8
    (scene,) = stats.scenes
    assert scene.episodes == 8 and scene.samples == len(labels) and 0 < scene.covered <= 1


def test_every_sample_lies_on_the_coverage_map(
    dataset: Dataset, measured: tuple[DatasetStats, list[Coverage]]
) -> None:
    (coverage,) = measured[1]
    assert coverage.visits.sum() == dataset.about.rows
    assert (coverage.ground[coverage.visits > 0] > 0).all()
    assert draw_coverage(coverage).startswith(b"\x89PNG")


def test_turns_on_the_spot_are_added_up() -> None:
    forward, left, right = 1, 2, 3
    assert count_turns(np.array([left, forward, left, left, forward, right, right, 0]), 15.0) == 2
    assert count_turns(np.array([left, right, forward, left]), 30.0) == 1
    assert count_turns(np.array([], np.int8), 15.0) == 0


@given(st.lists(st.floats(0, 1e4), max_size=60), st.booleans())
@example(values=[5e-324], whole=False)
@example(values=[0.0], whole=False)
def test_a_histogram_holds_every_value(values: list[float], whole: bool) -> None:
    values = [float(math.floor(v)) for v in values] if whole else values
    spread = spread_of(values, whole=whole)
    assert sum(spread.bins) == len(values) == spread.count
    assert len(spread.edges) == len(spread.bins) + 1
    assert all(b > a for a, b in zip(spread.edges, spread.edges[1:], strict=False))


class _Page(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.tags: Counter[str] = Counter()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags[tag] += 1


def test_the_page_runs_nothing_and_shows_names_as_text(
    measured: tuple[DatasetStats, list[Coverage]], tmp_path: Path
) -> None:
    stats, coverage = measured
    hostile = "<script>alert(1)</script><img src=x onerror=alert(2)>"
    scene = msgspec.structs.replace(stats.scenes[0], id=hostile, source=hostile)
    bad = msgspec.structs.replace(
        stats, name=hostile, scenes=(scene,), categories={hostile: 3}, frequent={hostile: 1},
        candidates={hostile: 1}, skipped={hostile: 1}, lights={hostile: 1},
    )  # fmt: skip
    page = _Page()
    page.feed(render_stats(bad, coverage, [(hostile, b"\xff\xd8")]))
    assert page.tags["script"] == 0
    assert page.tags["img"] == 2  # a coverage map and a sheet
    plain = unescape(render_stats(stats, coverage))
    assert "default-src 'none'" in plain and "walks" in plain and "not balanced" in plain.lower()
    many = render_stats(stats, coverage * 25)  # 24 are shown
    assert "and 1 more scene<" in many and "more scene" not in plain
