"""Profile gn0-release: the official harness, quirk by quirk, beside numbers that are ours."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from gn0.bench.episode_worker import EpisodeWorker
from gn0.bench.protocol import protocol_card
from gn0.bench.release_score import PATIENCE, PolicyUnderRelease, ReleaseScore, score_release
from gn0.bench.report import write_report
from gn0.bench.results import EpisodeResult, PolicyCard, load_results, load_summary, report_release
from gn0.bench.runner import run_suite
from gn0.bench.worker_messages import Open
from gn0.errors import ConfigError
from gn0.geometry import Pose2D
from gn0.maps.grid import OccupancyGrid
from gn0.maps.release_map import ReleaseMap, ReleaseNavigation
from gn0.missions.episode import AgentSpec, Episode, MissionInstruction
from gn0.sim.open import open_simulator
from gn0.sim.rollout import run_episode
from gn0.sim.simulator import Simulator
from gn0.sim.state import Action, Observation, Trajectory
from gn0.suites.profiles import DIFFERENCES
from gn0.suites.suite import Suite
from gn0.testing.scenes import build_map_scene

pytestmark = pytest.mark.usefixtures("workers_here")

CELLS = np.zeros((120, 200), np.uint8)
CELLS[:, 100:102] = 1
CELLS[40:80, 100:102] = 0  # a door 2 m wide
PLAN = OccupancyGrid(CELLS, 0.05, (0.0, 0.0))


def episode(start: tuple[float, float, float], goal: tuple[float, float], id: str = "e") -> Episode:
    return Episode(
        id=id, scene_id="plan", start=start, path=(start[:2], goal),
        mission=MissionInstruction(goal=goal, instruction="Go."),
    )  # fmt: skip


class Scripted:
    """Plays a list of actions, then the last one for ever."""

    name, sensors = "scripted", frozenset()

    def __init__(self, *script: object) -> None:
        self.script = list(script)
        self.asked = 0

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        self.asked = 0

    def act(self, observation: Observation) -> object:
        self.asked += 1
        return self.script[min(self.asked, len(self.script)) - 1]


def open_release(grid: OccupancyGrid = PLAN) -> Simulator:
    return open_simulator(build_map_scene(grid), navigation=ReleaseNavigation(grid, 0.20))


def drive(policy: Scripted, task: Episode, grid: OccupancyGrid = PLAN):  # type: ignore[no-untyped-def]
    simulator = open_release(grid)
    driver = PolicyUnderRelease(policy, simulator.navigation.release)  # type: ignore[arg-type,attr-defined]
    trajectory = run_episode(simulator, driver, task)
    return (
        driver,
        trajectory,
        score_release(
            trajectory, task, driver.map, forced_at=driver.forced_at, invalid=driver.invalid
        ),
    )


def walk(*points: tuple[float, float], stopped: bool = True) -> Trajectory:
    poses = tuple(Pose2D(x, y, 0.0) for x, y in points)
    actions = (1,) * (len(points) - 1)
    return Trajectory(poses, actions, (False,) * len(actions), stopped)


# ---- what the harness does ----


def test_it_stops_an_agent_that_turns_on_the_spot() -> None:
    """The first check cannot be unchanged; 25 unchanged ones are allowed; the next one stops."""
    policy = Scripted(Action.LEFT)
    driver, trajectory, score = drive(policy, episode((1.0, 1.0, 0.0), (4.0, 4.0)))
    assert driver.forced_at == PATIENCE + 1 == 26 and policy.asked == 26
    assert trajectory.actions == (2,) * 26 + (0,) and trajectory.stopped
    assert score.forced_stop == 26 and not score.success


def test_its_stop_may_score_a_success_that_we_do_not_count() -> None:
    scene = build_map_scene(PLAN)
    task = episode((1.0, 1.0, 0.0), (3.0, 1.0))
    _, trajectory, score = drive(Scripted(Action.LEFT), task)
    assert trajectory.stopped and score.success and score.spl == pytest.approx(1.0)
    worker = EpisodeWorker(
        Open(policy="scripted", options={}, plugin_modules=(), camera="gn_bench", backend="cpu",
             agent=AgentSpec(), max_steps=500, success_radius=3.0, profile="gn0-release"),
        Scripted(Action.LEFT),  # type: ignore[arg-type]
    )  # fmt: skip
    navigation = ReleaseNavigation(PLAN, 0.20)
    simulator = open_simulator(scene, navigation=navigation)
    worker._release, worker._honest = navigation, open_simulator(scene).navigation
    result, trace = worker.run(simulator, task)
    assert result.release is not None and result.release.success
    assert result.metrics is not None and not result.metrics.success and not result.stopped
    assert trace.actions[-1] == 0


def test_a_moving_agent_is_left_alone() -> None:
    script = [Action.FORWARD] * 4 + [Action.LEFT] * 20 + [Action.FORWARD] + [Action.RIGHT] * 20
    driver, trajectory, _ = drive(
        Scripted(*script, Action.STOP), episode((1.0, 1.0, 0.0), (4.0, 4.0))
    )
    assert driver.forced_at is None and len(trajectory.actions) == 46


def test_what_is_no_action_becomes_stop() -> None:
    for answer in (7, "left", None, True, 1.5):
        driver, trajectory, score = drive(
            Scripted(Action.LEFT, answer), episode((1.0, 1.0, 0.0), (4.0, 4.0))
        )
        assert trajectory.actions == (2, 0) and driver.invalid == score.invalid_actions == 1


def test_an_unreachable_goal_is_run_and_becomes_zero() -> None:
    closed = CELLS.copy()
    closed[:, 100:102] = 1
    grid = OccupancyGrid(closed, 0.05, (0.0, 0.0))
    driver, _, score = drive(Scripted(Action.LEFT), episode((1.0, 1.0, 0.0), (8.0, 1.0)), grid)
    assert driver.forced_at == 25, "infinity equals infinity from the first check on"
    assert score.distance_to_goal is None and score.spl is None and not score.success
    report = report_release(
        [EpisodeResult(episode="e", scene="s", status="invalid", release=score)]
    )
    assert report is not None and report.NE == 0.0 and report.zeroed == 1 and report.SPL == 0.0


def test_a_blocked_start_and_goal_are_snapped_for_distances_only() -> None:
    cells = CELLS.copy()
    cells[16:24, 16:24] = 1  # round (1.0, 1.0)
    grid = OccupancyGrid(cells, 0.05, (0.0, 0.0))
    task = episode((1.0, 1.0, 0.0), (5.0, 1.0))
    _, trajectory, score = drive(Scripted(Action.FORWARD), task, grid)
    assert score.snapped == ("start", "goal") and score.forced_stop is not None
    assert math.hypot(trajectory.poses[-1].x - 1.0, trajectory.poses[-1].y - 1.0) < 0.05
    assert score.distance_to_goal is not None and 2.5 < score.distance_to_goal < 4.5


# ---- how it scores ----


def test_a_stop_in_the_goals_own_pixel_fails() -> None:
    map = ReleaseMap(PLAN)
    goal = map.centre_of((150, 60))
    task = episode((1.025, 3.025, 0.0), goal)
    exact = score_release(walk((1.025, 3.025), goal), task, map)
    assert exact.distance_to_goal == 0.0 and not exact.success and exact.spl == 0.0
    beside = (goal[0] + 0.05, goal[1])
    near = score_release(walk((1.025, 3.025), beside), task, map)
    assert near.success and near.distance_to_goal == pytest.approx(0.05)
    never = score_release(walk((1.025, 3.025), beside, stopped=False), task, map)
    assert not never.success and never.oracle_success


def test_the_goal_pixel_keeps_an_oracle_success() -> None:
    """TeleHuman/GN0 87ea953, VLN_CE/GN_Bench_extensions/measures.py, OracleSuccess.update_metric:

    `self._metric = float(bool(self._metric) or distance_to_goal < SUCCESS_DISTANCE)`; 76b13d7 set
    it to 0.0 where the distance is 0.
    """
    map = ReleaseMap(PLAN)
    goal = map.centre_of((150, 60))
    task = episode((1.025, 3.025, 0.0), goal)
    near = (goal[0] - 1.0, goal[1])
    assert score_release(walk((0.5, 3.0), near, (0.5, 3.0)), task, map).oracle_success
    assert score_release(walk((0.5, 5.0), near, goal), task, map).oracle_success
    far = (goal[0] + 3.5, goal[1])
    assert not score_release(walk(far, far), task, map).oracle_success
    assert score_release(walk(far, goal, far), task, map).oracle_success
    assert score_release(walk((0.5, 5.0), near, goal, near), task, map).oracle_success


def test_spl_divides_octile_lengths() -> None:
    map = ReleaseMap(PLAN)
    start, goal = map.centre_of((180, 20)), map.centre_of((150, 5 + 30))
    away = (goal[0] - 0.5, goal[1])
    task = episode((*start, 0.0), goal)
    score = score_release(walk(start, away), task, map)
    octile = (30 - 15 + 15 * math.sqrt(2)) * 0.05
    straight = math.hypot(start[0] - away[0], start[1] - away[1])
    assert score.path_length == pytest.approx(straight)
    assert score.spl == pytest.approx(octile / max(octile, straight)) and octile > 1.05 * straight


def test_the_report_divides_by_logs_and_zeroes_what_is_not_finite() -> None:
    def result(**values: object) -> EpisodeResult:
        base = {"path_length": 2.0, "distance_to_goal": 4.0, "success": False,
                "oracle_success": False, "spl": 0.0}  # fmt: skip
        score = ReleaseScore(**{**base, **values})  # type: ignore[arg-type]
        return EpisodeResult(episode="e", scene="s", status="valid", stopped=True, release=score)

    lost = EpisodeResult(episode="x", scene="s", status="failed", reason="died")
    report = report_release(
        [
            result(),
            result(distance_to_goal=None, spl=None),
            result(success=True, spl=0.5, distance_to_goal=1.0, oracle_success=True, forced_stop=9),
            result(distance_to_goal=0.0),
            lost,
        ]
    )
    assert report is not None and report.episodes == 4, "what has no log does not exist"
    assert (report.TL, report.NE, report.SR, report.SPL, report.OS) == (
        2.0,
        1.25,
        0.25,
        0.125,
        0.25,
    )
    assert report.zeroed == 1 and report.in_goal_pixel == 1
    assert report.forced_stops == report.forced_successes == 1
    assert report_release([lost]) is None


# ---- a run ----


def test_default_never_acts_for_the_agent(flats_suite: Suite, tmp_path: Path) -> None:
    """The same spinning agent: left alone by default and paper, stopped by gn0-release."""
    for profile in ("default", "paper"):
        suite = flats_suite.with_profile(profile)
        summary = run_suite(suite, "random", tmp_path / profile, max_episodes=2, backend="cpu")
        assert summary.release is None and summary.profile == profile
        assert all(r.release is None for r in load_results(tmp_path / profile))
        assert dict(summary.protocol)["the harness"].startswith("never acts for the agent")


def test_a_run_prints_both_and_its_card_names_every_difference(
    flats_suite: Suite, tmp_path: Path
) -> None:
    suite = flats_suite.with_profile("gn0-release")
    assert suite.hash != flats_suite.hash and suite.about.max_steps == 500
    summary = run_suite(suite, "straight", tmp_path / "run", max_episodes=4, backend="cpu")
    assert summary.release is not None and summary.release.episodes == 4
    assert load_summary(tmp_path / "run") == summary
    results = load_results(tmp_path / "run")
    assert all(r.release is not None for r in results)
    for r in results:
        if r.metrics and r.release and r.release.distance_to_goal is not None:
            ours, theirs = r.metrics.navigation_error_geodesic, r.release.distance_to_goal
            assert abs(theirs - ours) <= 0.09 * ours + 0.6
            assert r.metrics.trajectory_length == pytest.approx(r.release.path_length)
    page = write_report(tmp_path / "run", videos=0).read_text()
    import html

    text = html.unescape(page)
    assert "The official harness beside ours" in text
    for what, default, theirs, source in DIFFERENCES:
        assert all(part in text for part in (what, default, theirs, source)), what


def test_the_card_of_a_release_run_speaks_for_that_harness(flats_suite: Suite) -> None:
    card = PolicyCard(name="p", sensors=(), privileged=False)
    ours = dict(protocol_card(flats_suite, card, "c"))
    theirs = dict(protocol_card(flats_suite.with_profile("gn0-release"), card, "c"))
    assert theirs["profile"].startswith("gn0-release")
    for what in ("collision", "success", "oracle success", "distances", "the harness", "agent"):
        assert ours[what] != theirs[what]
    for rule in DIFFERENCES:
        name = "agent" if rule.what == "body" else rule.what
        told = f"({rule.source})" if rule.what == "moves" else rule.told
        assert theirs[name].endswith(told), rule.what
    assert "vfov 70.00°" in theirs["camera"]


def test_resuming_and_workers_change_no_byte(flats_suite: Suite, tmp_path: Path) -> None:
    suite = flats_suite.with_profile("gn0-release")
    run_suite(suite, "straight", tmp_path / "a", max_episodes=3, backend="cpu")
    run_suite(suite, "straight", tmp_path / "b", max_episodes=3, backend="cpu", workers=2,
              shuffle_seed=4)  # fmt: skip
    for name in ("results.jsonl", "trajectories.jsonl", "summary.json"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_order_is_by_row_number_as_text(flats_suite: Suite) -> None:
    rows = [msgspec.structs.replace(e, seed=i) for i, e in enumerate(flats_suite.episodes, 1)]
    suite = Suite(flats_suite.folder, flats_suite.about, tuple(rows)).with_profile("gn0-release")
    assert [e.seed for e in suite.episodes] == [1, 10, 11, 12, 2, 3, 4, 5, 6, 7, 8, 9]
    back = suite.with_profile("default")
    assert [e.id for e in back.episodes] == [e.id for e in flats_suite.episodes]
    with pytest.raises(ConfigError, match="known: default, paper, gn0-release"):
        suite.with_profile("official")


def test_the_docs_tell_every_difference() -> None:
    """The table of docs/episodes.md is the table of the code."""
    page = Path(__file__).resolve().parent.parent.parent / "docs" / "episodes.md"
    text = page.read_text()
    for what, default, theirs, source in DIFFERENCES:
        assert f"| {what} | {default} | {theirs} | {source} |" in text, what


def test_the_card_names_the_commit_of_every_rule(flats_suite: Suite) -> None:
    """And says where it is not the pinned code itself that was read."""
    card = PolicyCard(name="p", sensors=(), privileged=False)
    told = dict(protocol_card(flats_suite.with_profile("gn0-release"), card, "c"))
    for rule in DIFFERENCES:
        how = told["agent" if rule.what == "body" else rule.what]
        public = "GN0 87ea953" in how
        fork = "64a00cb" in how and "a public fork, the pinned submodule is not public" in how
        assert public or fork, rule.what
