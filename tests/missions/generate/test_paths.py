"""Algorithms 2 and 3: paths that keep off obstacles, differ, and come again from the same seed."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.errors import FormatError
from gn0.geometry import polyline_length
from gn0.maps.inflate import inflate
from gn0.maps.navigation import NavigationMap
from gn0.missions.generate.judge import REASONS, PathJudge
from gn0.missions.generate.path_pool import load_paths, name_path, paths_table, save_table
from gn0.missions.generate.scene_paths import TOO_NEAR, ScenePaths, generate_paths
from gn0.missions.generate.settings import MissionSettings, load_settings
from gn0.missions.similarity import SimilaritySettings
from gn0.scenes.scene import Scene
from gn0.testing.scenes import build_floor_plan, build_map_scene
from gn0_trials.plain_paths import (
    count_blocked_points,
    plain_frechet,
    plain_resample,
    plain_verdict,
)


@pytest.mark.parametrize("planner", ["any-angle", "astar"])
@pytest.mark.parametrize("margin", [0.0, 0.05])
def test_no_path_enters_an_inflated_cell(planner: str, margin: float) -> None:
    grid = build_floor_plan(5)
    measures = MissionSettings(per_scene=25, planner=planner, safety_margin=margin)  # type: ignore[arg-type]
    found = generate_paths(build_map_scene(grid), measures, 0, radius=0.2)
    body = inflate(grid, 0.2)
    assert len(found.records) >= 20
    for record in found.records:
        assert count_blocked_points(body, record.array) == 0


def test_a_record_is_what_it_says(
    flat: Scene, flat_paths: ScenePaths, measures: MissionSettings
) -> None:
    ids = [record.path_id for record in flat_paths.records]
    assert len(set(ids)) == len(ids) == measures.per_scene
    for record, target in zip(flat_paths.records, flat_paths.targets, strict=True):
        points = record.array
        assert tuple(points[0]) == record.start[:2] and tuple(points[-1]) == record.goal
        assert target.goal == record.goal and target.object.id == record.target_id
        assert record.length == pytest.approx(polyline_length(points))
        assert measures.minimum_length <= record.length <= measures.maximum_length
        assert np.hypot(*np.diff(points, axis=0).T).max() <= 0.25 + 1e-9
        dx, dy = points[1] - points[0]
        off = math.remainder(record.start[2] - math.atan2(dy, dx), 2 * math.pi)
        assert off == pytest.approx(0.0, abs=1e-9), "it faces where it will go"
        assert record.scene_hash == flat.content_hash and record.split in ("train", "val_seen")
        assert record.path_id.startswith("example-flat_")


def test_keypoints_are_dense_in_bends_and_sparse_on_straights(
    flat_paths: ScenePaths, measures: MissionSettings
) -> None:
    for record in flat_paths.records:
        keys = np.array(record.keypoints)
        np.testing.assert_allclose(keys[[0, -1]], record.array[[0, -1]])
        assert np.hypot(*np.diff(keys, axis=0).T).max() <= measures.keypoint_spacing + 1e-9
        assert len(keys) < len(record.points)
        for point in record.array:  # and the path never strays from their polyline
            away = min(_distance(point, a, b) for a, b in itertools.pairwise(keys))
            assert away <= measures.keypoint_tolerance + 1e-9


def _distance(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    t = float(np.clip((p - a) @ (b - a) / max((b - a) @ (b - a), 1e-12), 0, 1))
    return float(np.hypot(*(p - a - t * (b - a))))


def test_no_two_paths_are_nearly_the_same_task(
    flat_paths: ScenePaths, measures: MissionSettings
) -> None:
    s = measures.similarity
    sampled = [plain_resample(r.points, s.samples) for r in flat_paths.records]
    for i, p in enumerate(sampled):
        for q in sampled[:i]:
            near = (
                math.dist(p[0], q[0]) <= s.start_radius and math.dist(p[-1], q[-1]) <= s.goal_radius
            )
            assert not near or plain_frechet(p, q) >= s.frechet - 1e-9


def test_the_same_seed_gives_the_same_paths_and_another_seed_others(
    flat: Scene, flat_paths: ScenePaths, measures: MissionSettings
) -> None:
    again = generate_paths(flat, measures, 3, radius=0.2, split="train", held_out=0.4)
    assert again.records == flat_paths.records and again.report == flat_paths.report
    other = generate_paths(flat, measures, 4, radius=0.2, split="train", held_out=0.4)
    assert {r.path_id for r in other.records}.isdisjoint(r.path_id for r in again.records)


def test_targets_take_turns(flat_paths: ScenePaths) -> None:
    report = flat_paths.report
    counts = [
        sum(r.target_id == name for r in flat_paths.records)
        for name in {r.target_id for r in flat_paths.records}
    ]
    assert report.targets_used == len(counts) == report.targets
    assert max(counts) - min(counts) <= 2


def test_everything_that_fell_is_in_the_report(flat_paths: ScenePaths) -> None:
    report = flat_paths.report
    assert report.candidates == report.paths + sum(report.fell.values())
    assert report.considered == report.targets + sum(report.targets_fell.values())
    assert set(report.fell) <= set(REASONS) and report.ended == "enough"
    assert len(report.unreachable) <= sum(report.targets_fell.values())


def test_a_scene_that_is_used_up_gives_less_and_says_why(flat: Scene) -> None:
    measures = MissionSettings(per_scene=60, minimum_length=5.0, attempts=4)
    found = generate_paths(flat, measures, 0, radius=0.2)
    assert 0 < found.report.paths < 60 and found.report.ended == "attempts used up"
    assert found.report.fell["similar"] > 0 and found.report.candidates >= 240
    none = generate_paths(flat, MissionSettings(minimum_length=50.0), 0, radius=0.2)
    assert none.report.paths == 0 and none.report.ended == "no targets"
    assert none.report.targets_fell[TOO_NEAR] == len(flat.objects) + len(flat.rooms)
    assert len(none.report.unreachable) == len(flat.objects) + len(flat.rooms)
    empty = generate_paths(replace(flat, objects=(), rooms=()), measures, 0, radius=3.0)
    assert (empty.report.paths, empty.report.ended) == (0, "no targets")


def test_paths_of_an_earlier_run_do_not_come_again(
    flat: Scene, flat_paths: ScenePaths, measures: MissionSettings
) -> None:
    earlier = [record.array for record in flat_paths.records]
    more = generate_paths(flat, measures, 3, radius=0.2, earlier=earlier)
    assert more.report.earlier == len(earlier) and more.report.fell_to_earlier > 0
    plain = [[tuple(point) for point in path.tolist()] for path in earlier]
    for record in more.records:
        assert plain_verdict(record.points, plain, measures) != {"similar"}
        assert plain_verdict(record.points, plain, measures) != {"duplicate"}


def test_some_paths_of_a_training_scene_are_held_out(
    flat: Scene, flat_paths: ScenePaths, measures: MissionSettings
) -> None:
    splits = [record.split for record in flat_paths.records]
    assert 2 <= splits.count("val_seen") <= 9
    whole = generate_paths(flat, measures, 3, radius=0.2, split="train")
    assert {r.split for r in whole.records} == {"train"}
    assert [r.path_id for r in whole.records] == [r.path_id for r in flat_paths.records]


def test_each_filter_names_itself() -> None:
    measures = MissionSettings(minimum_length=2.0, maximum_length=20.0, minimum_displacement=1.0)
    grid = build_floor_plan(1)
    safe = NavigationMap(grid, 0.2)
    judge = PathJudge(measures, [np.array([[0.0, 0.0], [4.0, 0.0]])])
    cases = {
        "malformed": [[0.0, 0.0]],
        "short": [[0.0, 0.0], [1.9, 0.0]],
        "long": [[0.0, 0.0], [21.0, 0.0]],
        "trivial": [[0.0, 0.0], [3.0, 0.0], [0.5, 0.0]],
        "duplicate": [[0.0, 0.0], [4.0, 0.0]],
        "similar": [[0.1, 0.0], [4.2, 0.1]],
        "accepted": [[0.1, 3.0], [4.2, 3.1]],
    }
    for verdict, points in cases.items():
        assert judge.judge(np.array(points)) == verdict
    assert judge.judge(np.array([[0.0, 0.0], [np.nan, 1.0], [5.0, 0.0]])) == "malformed"
    assert judge.judge(np.array(cases["accepted"])) == "duplicate"
    assert judge.against_earlier == 2 and judge.accepted == 1
    assert judge.judged == 9 == judge.accepted + sum(judge.fell.values())
    x0, y0, x1, y1 = grid.bounds
    through = np.array([[x0 + 1, y0 + 1], [x1 - 1, y1 - 1]])
    assert PathJudge(measures, grid=safe.inflated).judge(through) == "blocked"


@given(seed=st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_verdicts_are_those_of_the_paper_line_by_line(seed: int) -> None:
    rng = np.random.default_rng(seed)
    measures = MissionSettings(minimum_length=1.5, similarity=SimilaritySettings(samples=16))
    judge = PathJudge(measures)
    accepted: list[list[tuple[float, float]]] = []
    for _ in range(30):
        start = rng.choice([[0.0, 0.0], [2.0, 0.5], [0.4, 0.3]])
        path = np.round(np.cumsum(np.vstack([start, rng.normal(0.3, 0.4, (6, 2))]), axis=0), 3)
        if accepted and rng.random() < 0.4:
            path = np.array(accepted[rng.integers(len(accepted))]) + rng.normal(0, 0.15, 2)
        points = [(float(x), float(y)) for x, y in path]
        allowed = plain_verdict(points, accepted, measures)
        verdict = judge.judge(path)
        assert verdict in allowed
        if verdict == "accepted":
            accepted.append(points)


def test_the_pool_is_read_back_exactly(flat_paths: ScenePaths, tmp_path) -> None:
    save_table(tmp_path / "paths.parquet", paths_table(flat_paths.records))
    assert tuple(load_paths(tmp_path / "paths.parquet")) == flat_paths.records


def test_a_path_id_names_the_path_and_the_version_of_its_scene() -> None:
    line = np.array([[0.0, 0.0], [1.0, 2.0]])
    name = name_path("flat", 3, "hash", line)
    assert name == name_path("flat", 3, "hash", line) and name.startswith("flat_0003-")
    assert name_path("flat", 3, "other", line) != name != name_path("flat", 3, "hash", line + 0.01)


def test_settings_are_read_strictly(tmp_path) -> None:
    path = tmp_path / "measures.yaml"
    path.write_text("per_scene: 7\nsimilarity: {frechet: 0.5}\nmissions: [goal]\n")
    read = load_settings(path)
    assert (read.per_scene, read.similarity.frechet, read.missions) == (7, 0.5, ("goal",))
    path.write_text("")
    assert load_settings(path) == MissionSettings()
    path.write_bytes(msgspec.json.encode(read))
    assert load_settings(path) == read
    for wrong in ("per_scene: many", "speed: 3", "missions: [chase]", "[", "per_scene: 0"):
        path.write_text(wrong)
        with pytest.raises(FormatError, match=r"not settings of missions|not valid YAML"):
            load_settings(path)
