"""The near-duplicate decision: the same answer as the full distance, ties included."""

from __future__ import annotations

import itertools
import math

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.geometry import F64
from gn0.missions.filters import discrete_frechet
from gn0.missions.similarity import KnownPaths, SimilaritySettings, is_closer
from gn0_trials.plain_paths import plain_frechet, plain_resample

lattice = st.lists(st.tuples(st.integers(-4, 4), st.integers(-4, 4)), min_size=1, max_size=12)


@settings(deadline=None)  # the first call compiles
@given(p=lattice, q=lattice, squared=st.integers(0, 80))
def test_the_decision_is_the_comparison_of_the_distance(p, q, squared) -> None:
    """On a lattice half of the limits lie exactly on a distance."""
    limit = math.sqrt(squared)
    truth = plain_frechet(
        [(float(x), float(y)) for x, y in p], [(float(x), float(y)) for x, y in q]
    )
    a, b = np.array(p, np.float64), np.array(q, np.float64)
    assert is_closer(a, b, limit) == is_closer(b, a, limit) == (truth < limit)
    assert not is_closer(a, b, truth) and is_closer(a, b, np.nextafter(truth, np.inf))
    assert discrete_frechet(a, b) == truth


@settings(deadline=None)
@given(seed=st.integers(0, 10_000), noise=st.floats(0.0, 0.5), limit=st.floats(0.05, 3.0))
def test_the_decision_holds_for_paths_like_those_of_scenes(seed, noise, limit) -> None:
    rng = np.random.default_rng(seed)
    p = np.cumsum(rng.normal(0.1, 0.2, (48, 2)), axis=0)
    q = p + np.cumsum(rng.normal(0, noise / 5, (48, 2)), axis=0)
    assert is_closer(p, q, limit) == (plain_frechet(p.tolist(), q.tolist()) < limit)


def known_paths(paths: list[F64], samples: int) -> KnownPaths:
    known = KnownPaths(samples)
    for path in paths:
        known.add(path)
    return known


def test_known_paths_find_what_is_the_same_and_what_is_nearly_so() -> None:
    measures = SimilaritySettings()
    lines = [np.array([[0.0, 5.0 * k], [8.0, 5.0 * k]]) for k in range(40)]
    known = known_paths(lines, measures.samples)  # more than the room they begin with
    assert len(known) == 40
    for k, line in enumerate(lines):
        assert known.find_same(line) == k and known.find_similar(line, measures) == k
        assert known.find_same(line + 0.2) == -1 and known.find_similar(line + 0.2, measures) == k
    detour = np.array([[0.0, 10.0], [4.0, 12.0], [8.0, 10.0]])
    assert known.find_similar(detour, measures) == -1, "same ends, another way"
    assert known.find_similar(lines[3][::-1], measures) == -1, "the way back is another task"
    assert KnownPaths().find_similar(detour, measures) == -1


@pytest.mark.parametrize("end", [0, -1])
def test_paths_whose_ends_lie_apart_are_not_compared(end: int) -> None:
    measures = SimilaritySettings(start_radius=0.3, goal_radius=0.3, frechet=5.0)
    line = np.array([[0.0, 0.0], [8.0, 0.0]])
    known = known_paths([line], measures.samples)
    moved = line.copy()
    moved[end, 1] = 0.31
    assert known.find_similar(moved, measures) == -1
    moved[end, 1] = 0.29
    assert known.find_similar(moved, measures) == 0
    wide = msgspec.structs.replace(measures, start_radius=1.0, goal_radius=1.0)
    moved[end, 1] = 0.31
    assert known.find_similar(moved, wide) == 0


def test_the_plain_resampling_keeps_ends_and_spacing() -> None:
    points = plain_resample([(0.0, 0.0), (3.0, 0.0), (3.0, 1.0)], 9)
    assert points[0] == (0.0, 0.0) and points[-1] == (3.0, 1.0) and len(points) == 9
    gaps = [math.dist(a, b) for a, b in itertools.pairwise(points)]
    assert gaps == pytest.approx([0.5] * 8)


def test_each_end_has_a_radius_of_its_own() -> None:
    """Starts must be near, goals may lie apart, and the other way round."""
    line = np.array([[0.0, 0.0], [8.0, 0.0]])
    for end, start_radius, goal_radius in ((-1, 0.1, 2.0), (0, 2.0, 0.1)):
        measures = SimilaritySettings(
            start_radius=start_radius, goal_radius=goal_radius, frechet=5.0
        )
        known = known_paths([line], measures.samples)
        moved = line.copy()
        moved[end, 1] = 1.0
        assert known.find_similar(moved, measures) == 0
        other = line.copy()
        other[-1 - end, 1] = 1.0
        assert known.find_similar(other, measures) == -1


@pytest.mark.parametrize("end", [0, -1])
def test_ends_that_are_exactly_a_radius_apart_are_compared(end: int) -> None:
    measures = SimilaritySettings(start_radius=1.0, goal_radius=1.0, frechet=5.0)
    line = np.array([[0.0, 0.0], [8.0, 0.0]])
    known = known_paths([line], measures.samples)
    moved = line.copy()
    moved[end, 1] = 1.0
    assert known.find_similar(moved, measures) == 0


def test_paths_are_the_same_to_the_millimetre() -> None:
    line = np.array([[0.0, 0.0], [8.0, 0.0]])
    known = known_paths([line], 48)
    assert known.find_same(line + 0.0004) == 0
    assert known.find_same(line + 0.002) == -1 and known.find_same(line + 0.004) == -1
