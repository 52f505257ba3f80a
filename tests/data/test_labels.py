"""Labels: what they say, that they are safe to execute, and how they are filled up."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.data.expert_labels import (
    EXACT,
    LabelSettings,
    cut_at,
    is_arrived,
    label_along,
    label_states,
    plan_expert,
    plan_from,
    walk_actions,
    window_actions,
)
from gn0.data.waypoints import find_way, sample_way_points
from gn0.errors import PlanError
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.maps.pose_astar import plan_actions
from gn0.missions.episode import AgentSpec, Episode, MissionGoal
from gn0.missions.goal import sample_goal_episodes
from gn0.policies.oracle import PolicyOracle
from gn0.scenes.example import build_example_scene
from gn0.sim.rollout import run_episode
from gn0.sim.simulator import Simulator

AGENT = AgentSpec()
RELEASE = LabelSettings(variant="gn0-release")
TRACKING = LabelSettings(variant="mpc")
FIELD = LabelSettings(variant="field")


@pytest.fixture(scope="module")
def flat() -> tuple[NavigationMap, list[Episode]]:
    """The example flat and eight of its episodes."""
    scene = build_example_scene()
    navigation = NavigationMap(scene.grid, AGENT.radius)
    return navigation, sample_goal_episodes(scene, navigation, 8, 4)


def noise_map(seed: int, density: float = 0.12) -> NavigationMap:
    rng = np.random.default_rng(seed)
    cells = (rng.random((50, 50)) < density).astype(np.uint8)
    return NavigationMap(OccupancyGrid(cells, 0.1, (-2.0, 3.0)), 0.1)


def scatter(navigation: NavigationMap, count: int, seed: int) -> np.ndarray:
    """Poses [count, 3] in the largest region, off the centres of their cells."""
    rng = np.random.default_rng(seed)
    free = np.argwhere(navigation.regions == 0)
    places = navigation.grid.centres_of(free[rng.integers(len(free), size=count)])
    size = 0.49 * navigation.grid.resolution
    return np.column_stack(
        [places + rng.uniform(-size, size, places.shape), rng.uniform(-3.1, 3.1, count)]
    )


def has_plan(navigation: NavigationMap, goal: np.ndarray, pose: np.ndarray) -> bool:
    """Whether whole steps lead from a pose to a goal: not so in nooks narrower than a step."""
    yaws = [pose[2] + 2 * math.pi * k / 24 for k in range(24)]
    try:
        field = navigation.geodesic((goal[0], goal[1]))
        plan_actions(field, (pose[0], pose[1]), yaws, tolerance=0.249, weight=1.02, subcells=1)
    except PlanError:
        return False
    return True


def to_world(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x, y = points[:, 0].astype(float), points[:, 1].astype(float)
    return np.column_stack([pose[0] + c * x - s * y, pose[1] + s * x + c * y])


def execute(
    navigation: NavigationMap,
    goal: tuple[float, float],
    state: np.ndarray,
    rules: LabelSettings,
    at_once: int,
) -> tuple[np.ndarray, int]:
    """Carry out labels, so many actions of each, to the STOP: last pose, truncated moves."""
    hits = 0
    for _ in range(400):
        ahead = label_states(navigation, goal, state[None], rules).actions6[0][:at_once]
        stops = np.flatnonzero(ahead == 0)
        ahead = ahead[: stops[0]] if len(stops) else ahead
        poses, cut = walk_actions(navigation, AGENT, state, ahead)
        hits += int(cut.sum())
        state = poses[-1]
        if len(stops):
            return state, hits
    raise AssertionError("the labels never say STOP")


# --------------------------------------------------------------------------- the expert's walk


def test_the_expert_is_the_oracle(flat: tuple[NavigationMap, list[Episode]]) -> None:
    """The labelled walk is, action for action and bit for bit, what the policy `oracle` does."""
    navigation, episodes = flat
    simulator = Simulator(build_example_scene(), navigation=navigation)
    for episode in episodes:
        poses, actions = plan_expert(navigation, episode)
        run = run_episode(simulator, PolicyOracle(), episode)
        assert actions.tolist() == list(run.actions)
        np.testing.assert_array_equal(poses, np.array(run.poses))


def test_labels_along_a_walk_are_what_follows_in_it(
    flat: tuple[NavigationMap, list[Episode]],
) -> None:
    navigation, episodes = flat
    for episode in episodes:
        poses, actions = plan_expert(navigation, episode)
        labels = label_along(navigation, episode, poses, actions)
        assert len(labels) == len(actions)
        for t in range(len(actions)):
            rest = actions[t : t + 6].tolist()
            assert labels.actions6[t].tolist() == rest + [0] * (6 - len(rest))
        assert actions[-1] == 0 and (actions[:-1] != 0).all()
        assert navigation.geodesic(episode.goal).distance_at(*poses[-1, :2]) <= 0.25


def test_windows_of_actions_are_filled_up_with_stop() -> None:
    assert window_actions(np.array([1, 2, 0])).tolist() == [
        [1, 2, 0, 0, 0, 0], [2, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 0],
    ]  # fmt: skip


# ----------------------------------------------------------------------------- the way ahead


def test_waypoints_lie_on_the_shortest_way_at_quarter_metres(
    flat: tuple[NavigationMap, list[Episode]],
) -> None:
    """Against `GeodesicField.path`, sampled plainly."""
    navigation, episodes = flat
    for number, episode in enumerate(episodes):
        field = navigation.geodesic(episode.goal)
        poses = scatter(navigation, 25, number)
        waypoints, valid = sample_way_points(field, poses)
        for pose, points, count in zip(poses, waypoints, valid.tolist(), strict=True):
            path = field.path(pose[0], pose[1])
            arcs = np.r_[0.0, np.cumsum(np.hypot(*np.diff(path, axis=0).T))]
            at = np.minimum(0.25 * np.arange(13), arcs[-1])
            wanted = np.column_stack([np.interp(at, arcs, path[:, k]) for k in (0, 1)])
            np.testing.assert_allclose(to_world(pose, points), wanted, atol=0.08)
            assert abs(count - min(13, 1 + math.ceil(arcs[-1] / 0.25))) <= 1


def test_a_way_that_ends_early_repeats_the_goal(flat: tuple[NavigationMap, list[Episode]]) -> None:
    """As the paper's prompts say: pad with last if short."""
    navigation, episodes = flat
    poses, actions = plan_expert(navigation, episodes[0])
    labels = label_along(navigation, episodes[0], poses, actions)
    near = np.flatnonzero(labels.valid < 13)
    assert len(near) > 3
    for t in near:
        last = labels.waypoints[t, labels.valid[t] - 1]
        assert (labels.waypoints[t, labels.valid[t] :] == last).all()
        np.testing.assert_allclose(to_world(poses[t], last[None])[0], episodes[0].goal, atol=1e-5)
    assert (labels.waypoints[:, 0] == 0).all()


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32))
def test_no_label_leads_into_an_inflated_cell(seed: int) -> None:
    """Neither the points ahead, nor the straight lines between them, nor the actions."""
    navigation = noise_map(seed)
    poses = scatter(navigation, 8, seed)
    goal = scatter(navigation, 1, seed + 1)[0]
    labels = label_states(navigation, (goal[0], goal[1]), poses)
    for pose, points, ahead in zip(poses, labels.waypoints, labels.actions6, strict=True):
        world = to_world(pose, points)
        assert all(navigation.is_free(x, y) for x, y in world)
        if has_plan(navigation, goal, pose):
            assert not walk_actions(navigation, AGENT, pose, ahead)[1].any()


def test_the_way_is_never_longer_than_three_metres_and_starts_here(
    flat: tuple[NavigationMap, list[Episode]],
) -> None:
    navigation, episodes = flat
    labels = label_states(navigation, episodes[0], scatter(navigation, 60, 9))
    steps = np.linalg.norm(np.diff(labels.waypoints, axis=1), axis=2)
    assert (steps <= 0.25 + 1e-6).all()
    whole = labels.valid == 13
    straight = steps[whole][:, :11]  # shorter than a quarter only where the way bends
    assert whole.any() and np.median(straight) > 0.2499


def test_the_way_of_a_place_that_sees_no_bend_is_found_all_the_same() -> None:
    navigation = noise_map(3, 0.2)
    goal = scatter(navigation, 1, 5)[0]
    field = navigation.geodesic((goal[0], goal[1]))
    for pose in scatter(navigation, 30, 6):
        way = find_way(field, pose[:2])
        np.testing.assert_array_equal(way[0], pose[:2])
        np.testing.assert_array_equal(way[-1], goal[:2])
        legs = itertools.pairwise(way.tolist())
        assert not any(navigation.move(*a, *b)[2] for a, b in legs)


# ------------------------------------------------------------------------- arbitrary states


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from([1, 3, 6]))
def test_executing_the_labels_reaches_the_goal(seed: int, at_once: int) -> None:
    navigation = noise_map(seed, 0.06)
    start, end = scatter(navigation, 2, seed)
    goal = (end[0], end[1])
    whole = has_plan(navigation, end, start)
    state, hits = execute(navigation, goal, start, EXACT, at_once)
    assert hits == 0 or not whole
    assert navigation.geodesic(goal).distance_at(state[0], state[1]) <= 0.25
    assert is_arrived(navigation.geodesic(goal), state[0], state[1], 0.25)


def test_an_agent_in_a_nook_is_told_the_way_out() -> None:
    """Where every whole step is cut short, a step that is cut short leads out."""
    cells = np.ones((60, 60), np.uint8)
    cells[10:50, 10:50] = 0
    cells[30, 50:56], cells[31:34, 55] = 0, 0  # one cell wide, and its arms shorter than a step
    navigation = NavigationMap(OccupancyGrid(cells, 0.05, (0.0, 0.0)), 0.0)
    inside = np.array([55.5 * 0.05, 33.5 * 0.05, math.radians(7.0)])
    goal = np.array([0.6, 0.6, 0.0])
    assert not has_plan(navigation, goal, inside)
    ahead = label_states(navigation, (goal[0], goal[1]), inside[None]).actions6[0]
    assert (ahead != 0).all()
    state, _ = execute(navigation, (goal[0], goal[1]), inside, EXACT, 6)
    assert navigation.geodesic((goal[0], goal[1])).distance_at(state[0], state[1]) <= 0.25


def test_short_plans_are_as_cheap_as_the_best_of_all_sequences() -> None:
    """All 3⁶ sequences beside the plan: at most 2 % dearer, as `weight` promises, or merged."""
    navigation = NavigationMap(build_example_scene().grid, 0.2)
    goals = scatter(navigation, 12, 1)
    rng = np.random.default_rng(2)
    sequences = list(itertools.product((1, 2, 3), repeat=6))
    compared = cheaper = 0
    for goal in goals:
        field = navigation.geodesic((goal[0], goal[1]))
        for _ in range(6):
            pose = goal + np.r_[rng.uniform(-0.8, 0.8, 2), rng.uniform(-3, 3)]
            if not field.distance_at(pose[0], pose[1]) < 1.0:
                continue
            best = math.inf
            for sequence in sequences:
                poses, cut = walk_actions(navigation, AGENT, pose, np.array(sequence))
                for t in range(7):
                    if t and cut[t - 1]:
                        break
                    if is_arrived(field, poses[t, 0], poses[t, 1], 0.25):
                        spent = sequence[:t]
                        best = min(best, sum(0.25 if a == 1 else 0.02 for a in spent))
                        break
            if best == math.inf:
                continue
            plan = plan_from(field, pose)
            cost = sum(0.25 if a == 1 else 0.02 for a in plan.tolist())
            compared += 1
            cheaper += cost <= 1.02 * best + 1e-9
            assert cost <= 1.02 * best + 0.25 + 1e-9
    assert compared >= 15 and cheaper >= 0.95 * compared


def test_a_state_at_the_goal_is_labelled_stop(flat: tuple[NavigationMap, list[Episode]]) -> None:
    navigation, episodes = flat
    x, y = episodes[0].goal
    for rules in (EXACT, RELEASE, TRACKING, FIELD):
        labels = label_states(navigation, episodes[0], np.array([[x, y, 1.0]]), rules)
        assert labels.actions6.tolist() == [[0] * 6]
        assert labels.valid.tolist() == [1]
        assert not labels.waypoints.any()


def test_states_without_a_way_are_refused_by_row(flat: tuple[NavigationMap, list[Episode]]) -> None:
    navigation, episodes = flat
    good = scatter(navigation, 2, 0)
    for bad in ([-50.0, 0.0, 0.0], [math.nan, 0.0, 0.0], [0.0, 0.0, math.inf]):
        with pytest.raises(PlanError) as caught:
            label_states(navigation, episodes[0], np.vstack([good, bad]))
        assert caught.value.where == "state 2"


def test_labels_are_the_same_bytes_in_any_company(
    flat: tuple[NavigationMap, list[Episode]],
) -> None:
    navigation, episodes = flat
    poses = scatter(navigation, 12, 3)
    whole = label_states(navigation, episodes[1], poses)
    for i in (0, 5, 11):
        alone = label_states(NavigationMap(navigation.grid, 0.2), episodes[1], poses[i : i + 1])
        assert alone.actions6[0].tobytes() == whole.actions6[i].tobytes()
        assert alone.waypoints[0].tobytes() == whole.waypoints[i].tobytes()


# --------------------------------------------------------------------------------- variants


def test_release_labels_stop_a_metre_before_the_goal(
    flat: tuple[NavigationMap, list[Episode]],
) -> None:
    """Six STOPs within 1 m as the crow flies; before that, STOP from where the plan enters it."""
    navigation, episodes = flat
    for episode in episodes:
        poses, actions = plan_expert(navigation, episode)
        plain = label_along(navigation, episode, poses, actions)
        labels = label_along(navigation, episode, poses, actions, RELEASE)
        away = np.hypot(*(poses[:, :2] - episode.goal).T)
        first = int(np.argmax(away <= 1.0 + 1e-9))
        assert not labels.actions6[first:].any()
        for t in range(max(first - 8, 0), first):
            wanted = [a if t + k < first else 0 for k, a in enumerate(plain.actions6[t].tolist())]
            assert labels.actions6[t].tolist() == wanted
        np.testing.assert_array_equal(labels.waypoints, plain.waypoints)


def test_actions_are_cut_where_they_enter_a_disc() -> None:
    actions = np.array([[1, 1, 1, 1, 1, 1], [2, 2, 2, 1, 1, 1]], np.int8)
    states = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -math.pi / 4]])
    open_ground = NavigationMap(OccupancyGrid(np.zeros((300, 300), np.uint8), 0.1, (-15.0, -15.0)))
    cut = cut_at(actions, open_ground.geodesic((1.0, 0.0)), states, AGENT, 0.51)
    assert cut.tolist() == [[1, 1, 0, 0, 0, 0], [2, 2, 2, 1, 1, 0]]
    far = open_ground.geodesic((9.0, 9.0))
    assert cut_at(actions, far, states, AGENT, 0.5).tolist() == actions.tolist()


def test_the_agent_of_the_episode_decides_steps_and_turns() -> None:
    grid = OccupancyGrid(np.zeros((100, 100), np.uint8), 0.1, (0.0, 0.0))
    agent = AgentSpec(forward_step=0.5, turn_degrees=30.0)
    episode = Episode(
        id="a", scene_id="s", start=(2.0, 5.0, math.pi / 2), path=((2.0, 5.0), (8.0, 5.0)),
        mission=MissionGoal(goal=(8.0, 5.0), object_id="o", category="sofa", instruction="Go."),
        agent=agent,
    )  # fmt: skip
    navigation = NavigationMap(grid, agent.radius)
    poses, actions = plan_expert(navigation, episode)
    assert actions.tolist() == [3] * 3 + [1] * 12 + [0]
    labels = label_states(navigation, episode, poses[:1])
    assert labels.actions6[0].tolist() == [3, 3, 3, 1, 1, 1]
    np.testing.assert_allclose(labels.waypoints[0, 1], [0.0, -0.25], atol=1e-6)


# --------------------------------------------------------------------------- where it stops


def corner() -> NavigationMap:
    """Open ground of 2 m with one blocked cell of 5 cm in the middle."""
    cells = np.zeros((40, 40), np.uint8)
    cells[20, 20] = 1
    return NavigationMap(OccupancyGrid(cells, 0.05, (0.0, 0.0)), 0.0)


@pytest.mark.parametrize("rules", [EXACT, TRACKING, FIELD], ids=lambda rules: rules.variant)
def test_a_goal_that_is_near_but_out_of_sight_is_not_arrived_at(rules: LabelSettings) -> None:
    """Both sides of one blocked cell: 0.20 m apart, hardly more on foot, and no line between."""
    navigation = corner()
    goal, place = (0.925, 1.025), (1.125, 1.025)
    field = navigation.geodesic(goal)
    assert field.distance_at(*place) < 0.22
    assert not is_arrived(field, *place, 0.25)
    body = AgentSpec(radius=0.0, forward_step=0.1)
    labels = label_states(navigation, goal, np.array([[*place, 2.0]]), rules, agent=body)
    assert labels.actions6[0, 0] != 0
    beside = (1.125, 1.105)
    assert is_arrived(navigation.geodesic((0.925, 1.105)), *beside, 0.25)


@pytest.mark.parametrize("rules", [EXACT, TRACKING, FIELD], ids=lambda rules: rules.variant)
def test_labels_stop_a_hair_within_the_limit_and_never_on_it(rules: LabelSettings) -> None:
    """0.2495 m from the goal a metric may round to 0.25: one more step; 0.2485 m is near enough."""
    navigation = NavigationMap(OccupancyGrid(np.zeros((40, 40), np.uint8), 0.05, (0.0, 0.0)), 0.0)
    goal, body = (1.025, 1.025), AgentSpec(radius=0.0, forward_step=0.05)
    first = [
        label_states(navigation, goal, np.array([[1.025 - away, 1.025, 0.0]]), rules, agent=body)
        .actions6[0, 0]
        for away in (0.2495, 0.2485)
    ]  # fmt: skip
    assert first == [1, 0]
    field = navigation.geodesic(goal)
    assert not is_arrived(field, 1.025 - 0.2495, 1.025, 0.25)
    assert is_arrived(field, 1.025 - 0.2485, 1.025, 0.25)


def test_mpc_does_not_stop_where_its_window_ends() -> None:
    """A long-legged body is through the 3 m it sees in five actions; its goal is 9 m on."""
    grid = OccupancyGrid(np.zeros((20, 240), np.uint8), 0.05, (0.0, 0.0))
    navigation = NavigationMap(grid, 0.0)
    body = AgentSpec(radius=0.0, forward_step=0.7)
    pose = np.array([[1.025, 0.525, 0.0]])
    labels = label_states(navigation, (10.525, 0.525), pose, TRACKING, agent=body)
    assert labels.valid[0] == 13 and (labels.actions6 != 0).all()
    near = label_states(navigation, (3.025, 0.525), pose, TRACKING, agent=body)
    assert near.actions6[0].tolist() == [1, 1, 1, 0, 0, 0]


def test_each_column_of_the_window_is_an_action_later() -> None:
    assert window_actions(np.array([1, 2, 3, 1, 0], np.int8)).tolist() == [
        [1, 2, 3, 1, 0, 0], [2, 3, 1, 0, 0, 0], [3, 1, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0], [0] * 6,
    ]  # fmt: skip
