"""Bootstrap intervals: right where theory knows the answer, equal on repeat, honest on clusters."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.bench.intervals import bootstrap_interval
from gn0.errors import BenchError


def test_the_interval_of_a_normal_mean_is_the_textbook_one() -> None:
    values = np.random.default_rng(1).normal(5.0, 2.0, 400)
    found = bootstrap_interval(values, name="x")
    half = 1.96 * values.std(ddof=1) / np.sqrt(400)
    assert found.mean == pytest.approx(values.mean())
    assert found.low == pytest.approx(values.mean() - half, abs=0.1 * half)
    assert found.high == pytest.approx(values.mean() + half, abs=0.1 * half)
    assert (found.count, found.clusters, found.level) == (400, 0, 0.95)


def test_it_covers_the_truth_about_as_often_as_it_says() -> None:
    rng = np.random.default_rng(2)
    hits = 0
    for trial in range(300):
        found = bootstrap_interval((rng.random(60) < 0.4).astype(float), seed=trial, resamples=600)
        hits += found.low <= 0.4 <= found.high
    assert 0.90 <= hits / 300 <= 0.98


def test_scenes_are_resampled_whole() -> None:
    """Episodes that are copies of each other within a scene carry no more than one value."""
    rng = np.random.default_rng(3)
    scenes = [f"s{i}" for i in range(8) for _ in range(50)]
    values = np.repeat(rng.random(8), 50)
    clustered = bootstrap_interval(values, clusters=scenes)
    naive = bootstrap_interval(values)
    assert clustered.clusters == 8
    assert clustered.high - clustered.low > 4 * (naive.high - naive.low)
    one_scene = bootstrap_interval(values, clusters=["only"] * 400)
    assert one_scene == naive


def test_clusters_of_unequal_size_weigh_by_their_episodes() -> None:
    found = bootstrap_interval([1.0] * 9 + [0.0], clusters=["a"] * 9 + ["b"])
    assert found.mean == 0.9 and found.low == 0.0 and found.high == 1.0


def test_the_same_seed_gives_the_same_interval_and_the_name_matters() -> None:
    values = np.random.default_rng(4).random(30)
    assert bootstrap_interval(values, name="SR") == bootstrap_interval(values, name="SR")
    assert bootstrap_interval(values, name="SR") != bootstrap_interval(values, name="SPL")


def test_a_single_value_has_a_point_for_an_interval() -> None:
    found = bootstrap_interval([0.5])
    assert (found.mean, found.low, found.high) == (0.5, 0.5, 0.5)


@pytest.mark.parametrize("values", [[], [1.0, np.nan], [np.inf]])
def test_nothing_and_nonsense_are_refused(values: list[float]) -> None:
    with pytest.raises(BenchError):
        bootstrap_interval(values, name="NE")
