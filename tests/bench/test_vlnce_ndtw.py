"""nDTW of an imported VLN-CE set is VLN-CE's: scored on the dense ground truth, not on its nodes.

Upstream's rule (jacobkrantz/VLN-CE 729d141, habitat_extensions/measures.py, NDTW): positions
without repeats against `gt_json[id]["locations"]`, exp(-d / (len(locations) * 3.0)), d by fastdtw
with radius 1 (config/default.py: FDTW = True).
"""

from __future__ import annotations

import gzip
import json
import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from gn0.bench.metrics import compute_metrics
from gn0.bench.protocol import describe_paths
from gn0.geometry import Pose2D
from gn0.missions.coordinate_frames import Placement
from gn0.missions.episode import AgentSpec, Episode
from gn0.missions.episode_files import load_episodes, save_episodes
from gn0.missions.sets.episode_set import load_set, place_task
from gn0.missions.sets.json_file import save_exact
from gn0.missions.sets.vlnce import ExporterVlnce
from gn0.sim.state import Trajectory
from gn0.testing.scenes import build_floor_plan
from gn0_trials.judge_metrics import judge_dtw

Point = tuple[float, float]
Paths = dict[str, list[Point]]


def fast_dtw(x: list[Point], y: list[Point], radius: int = 1) -> tuple[float, list[Any]]:
    """Salvador and Chan's approximation as PyPI's fastdtw 0.3.4 has it: cost and warping path."""
    if len(x) < radius + 2 or len(y) < radius + 2:
        return _windowed(x, y, [(0, len(y))] * len(x))
    _, path = fast_dtw(_halved(x), _halved(y), radius)
    low, high = [len(y)] * len(x), [0] * len(x)
    for i, j in path:  # the coarse path, widened by the radius, at twice the resolution
        for row in range(max(0, 2 * (i - radius)), min(len(x), 2 * (i + radius) + 2)):
            low[row] = min(low[row], max(0, 2 * (j - radius)))
            high[row] = max(high[row], min(len(y), 2 * (j + radius) + 2))
    return _windowed(x, y, list(zip(low, high, strict=True)))


def _halved(x: list[Point]) -> list[Point]:
    return [((x[i][0] + x[i + 1][0]) / 2, (x[i][1] + x[i + 1][1]) / 2)
            for i in range(0, len(x) - len(x) % 2, 2)]  # fmt: skip


def _windowed(
    x: list[Point], y: list[Point], window: Sequence[tuple[int, int]]
) -> tuple[float, list[Any]]:
    cost = {(-1, -1): 0.0}
    came = {}
    infinite = math.inf
    for i, (low, high) in enumerate(window):
        for j in range(low, high):
            step = math.hypot(x[i][0] - y[j][0], x[i][1] - y[j][1])
            best, source = infinite, (-1, -1)
            for before in ((i - 1, j), (i, j - 1), (i - 1, j - 1)):
                found = cost.get(before, infinite)
                if found < best:
                    best, source = found, before
            cost[i, j], came[i, j] = best + step, source
    here = (len(x) - 1, len(y) - 1)
    path = [here]
    while (here := came[here]) != (-1, -1):
        path.append(here)
    return cost[len(x) - 1, len(y) - 1], path[::-1]


@pytest.fixture(scope="module")
def split(shared_data: Path) -> tuple[list[Episode], Paths]:
    """The 778 episodes as an import makes them, and upstream's dense truth read without us."""
    folder = shared_data / "vln" / "R2R_VLNCE_v1-2_preprocessed" / "val_seen"
    truth = json.loads(gzip.decompress((folder / "val_seen_gt.json.gz").read_bytes()))
    tasks = load_set(folder / "val_seen.json.gz").tasks
    episodes = [place_task(task, Placement(), AgentSpec()) for task in tasks]
    assert len(episodes) == 778
    # Habitat (x right, y up, z back), seen from above
    return episodes, {key: [(x, -z) for x, _, z in v["locations"]] for key, v in truth.items()}


def score(points: Sequence[Point], episode: Episode) -> tuple[float, float]:
    """nDTW and SDTW of a walk that ends with STOP in the goal."""
    poses = tuple(Pose2D(x, y, 0.0) for x, y in points)
    n = len(poses) - 1
    walk = Trajectory(poses=poses, actions=(1,) * n, collided=(False,) * n, stopped=True)
    found = compute_metrics(walk, episode, lambda p: np.zeros(len(p)))
    return found.ndtw, found.sdtw


def test_the_ground_truth_scores_one_on_every_episode(split: tuple[list[Episode], Paths]) -> None:
    """It got 0.29 when the sparse nodes were scored."""
    episodes, truth = split
    assert {e.path_source for e in episodes} == {"truth"}
    for episode in episodes:
        assert list(episode.path) == truth[episode.id]
        assert score(truth[episode.id], episode) == (1.0, 1.0)


@cache
def strayed(points: tuple[Point, ...], number: int) -> list[Point]:
    """A walk that follows the truth for a while, drifts off it and ends somewhere."""
    rng = np.random.default_rng(number)
    path = np.array(points)[: max(3, int(len(points) * rng.uniform(0.3, 1.0)))]
    drift = np.cumsum(rng.normal(0, 0.15, path.shape), axis=0)
    tail = path[-1] + np.cumsum(rng.normal(0, 0.2, (int(rng.integers(0, 25)), 2)), axis=0)
    return [tuple(p) for p in np.vstack([path + drift - drift[0], tail + drift[-1]]).tolist()]


def test_scores_are_exact_dtw_on_the_dense_truth_and_fastdtws_in_the_mean(
    split: tuple[list[Episode], Paths],
) -> None:
    episodes, truth = split
    ours, exact, fast = [], [], []
    for number, episode in enumerate(episodes):
        reference = truth[episode.id]
        walk = strayed(tuple(reference), number)
        ours.append(score(walk, episode)[0])
        scale = len(reference) * 3.0
        exact.append(math.exp(-judge_dtw(walk, reference) / scale))
        fast.append(math.exp(-fast_dtw(walk, reference)[0] / scale))
    assert np.abs(np.array(ours) - exact).max() <= 1e-9
    assert all(a >= b - 1e-12 for a, b in zip(ours, fast, strict=True)), "it is never cheaper"
    assert abs(np.mean(ours) - np.mean(fast)) <= 1e-3
    assert 0.3 < np.mean(ours) < 0.9, "the walks must leave the path for this to say anything"


def test_half_the_way_scores_as_half_the_way(split: tuple[list[Episode], Paths]) -> None:
    """On the sparse nodes half the truth got more (0.39) than the whole (0.29)."""
    episodes, truth = split
    for episode in episodes[::40]:
        way = truth[episode.id]
        assert score(way[: len(way) // 2], episode)[0] < score(way, episode)[0]


def test_without_ground_truth_the_nodes_are_joined_and_the_card_says_so(tmp_path: Path) -> None:
    grid = build_floor_plan(4, width=8.0, depth=6.0, clutter=4)
    nodes = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 0.0, -1.1]]
    record = {
        "episode_id": 1, "scene_id": "mp3d/plan/plan.glb", "start_position": nodes[0],
        "start_rotation": [0.0, 0.0, 0.0, 1.0], "goals": [{"position": nodes[-1]}],
        "instruction": {"instruction_text": "Go."}, "reference_path": nodes,
    }  # fmt: skip
    other = {**record, "episode_id": 2}
    truth = {"2": {"locations": nodes[:2], "forward_steps": 1, "actions": [1, 0]}}
    save_exact(tmp_path / "val.json.gz", {"episodes": [record, other]})
    save_exact(tmp_path / "val_gt.json.gz", truth)
    read = ExporterVlnce().load(tmp_path / "val.json.gz")
    one, two = (place_task(task, Placement(), AgentSpec()) for task in read.tasks)
    gaps = np.hypot(*np.diff(np.array(one.path), axis=0).T)
    assert one.path_source == "resampled" and gaps.max() <= 0.25 and len(one.path) == 14
    assert {(0.0, 0.0), (2.0, 0.0), (2.0, 1.1)} <= set(one.path), "every node is still there"
    assert (two.path_source, two.path) == ("truth", ((0.0, 0.0), (2.0, 0.0)))

    save_episodes(tmp_path / "e.parquet", [one, two], {"plan": grid})
    assert load_episodes(tmp_path / "e.parquet") == [one, two]
    told = describe_paths((one, two))
    assert "in 1 episode the set's dense ground truth" in told and "joined by straight" in told
    ours = msgspec.structs.replace(one, path_source="")
    assert describe_paths((ours,)).endswith("as the suite has it")
