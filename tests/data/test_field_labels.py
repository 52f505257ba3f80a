"""Label variant `field`: where it leads, that it never dithers, and how a dataset holds it."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.data.build import build_dataset
from gn0.data.dataset import Dataset, open_dataset
from gn0.data.expert_labels import (
    LabelSettings,
    label_along,
    label_states,
    plan_expert,
    plan_from,
    walk_actions,
)
from gn0.data.settings import BuildSettings, PictureSettings
from gn0.data.verify import verify_dataset
from gn0.errors import PlanError
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec
from gn0.suites.suite import Suite
from gn0.testing.scenes import build_floor_plan

AGENT = AgentSpec()
FIELD = LabelSettings(variant="field")


def scatter(navigation: NavigationMap, count: int, seed: int) -> np.ndarray:
    """Poses [count, 3] in the largest region, off the centres of their cells."""
    rng = np.random.default_rng(seed)
    free = np.argwhere(navigation.regions == 0)
    places = navigation.grid.centres_of(free[rng.integers(len(free), size=count)])
    size = 0.49 * navigation.grid.resolution
    return np.column_stack(
        [places + rng.uniform(-size, size, places.shape), rng.uniform(-3.1, 3.1, count)]
    )


@pytest.fixture(scope="module")
def plan() -> NavigationMap:
    return NavigationMap(build_floor_plan(0), AGENT.radius)


def noise_map(seed: int, density: float) -> NavigationMap:
    rng = np.random.default_rng(seed)
    cells = (rng.random((50, 50)) < density).astype(np.uint8)
    return NavigationMap(OccupancyGrid(cells, 0.1, (-2.0, 3.0)), 0.1)


def test_one_action_a_decision_arrives_nearly_as_shortly_as_the_plan(plan: NavigationMap) -> None:
    """The figures asked of the label, on a floor plan: `gn0 figures train.labels` has more."""
    metres = best = actions = fewest = alike = 0.0
    poses = scatter(plan, 40, 1)
    for number, goal in enumerate(scatter(plan, 4, 2)):
        field = plan.geodesic((goal[0], goal[1]))
        for pose in poses[number::4]:
            walk = []
            state = pose
            for _ in range(400):
                said = label_states(plan, (goal[0], goal[1]), state[None], FIELD).actions6[0]
                if said[0] == 0:
                    break
                walk.append(int(said[0]))
                after, cut = walk_actions(plan, AGENT, state, said[:1])
                assert not cut.any()
                state = after[-1]
            assert said[0] == 0 and field.distance_at(state[0], state[1]) <= 0.25
            exact = plan_from(field, pose).tolist()
            metres, best = metres + walk.count(1), best + exact.count(1)
            actions, fewest = actions + len(walk), fewest + len(exact)
            alike += (walk[:1] or [0]) == (exact[:1] or [0])
    assert metres <= 1.01 * best
    assert actions <= 1.12 * fewest
    assert alike >= 0.93 * len(poses)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from([0.04, 0.1]))
def test_walks_end_at_the_goal_and_never_turn_back_and_forth(seed: int, density: float) -> None:
    """Also where it is narrow, from any state, and for all six actions of each label."""
    navigation = noise_map(seed, density)
    goal = scatter(navigation, 1, seed + 1)[0]
    field = navigation.geodesic((goal[0], goal[1]))
    poses = scatter(navigation, 6, seed)
    labels = label_states(navigation, (goal[0], goal[1]), poses, FIELD)
    for pose, six in zip(poses, labels.actions6, strict=True):
        walk = plan_from(field, pose, FIELD)
        assert six.tolist() == [*walk[:6].tolist(), *[0] * (6 - len(walk[:6]))]
        poses_there, _ = walk_actions(navigation, AGENT, pose, walk)
        assert field.distance_at(*poses_there[-1, :2]) <= 0.25
        turns = "".join(map(str, walk.tolist()))
        assert "23" not in turns and "32" not in turns
        assert all(len(run) <= 12 for run in turns.split("1"))


def test_a_label_is_what_labels_made_anew_at_every_step_do(plan: NavigationMap) -> None:
    """Whoever carries out one action, three or six of each goes the same way."""
    goal = scatter(plan, 1, 5)[0]
    for pose in scatter(plan, 12, 6):
        six = label_states(plan, (goal[0], goal[1]), pose[None], FIELD).actions6[0]
        state, anew = pose, []
        for _ in range(6):
            said = label_states(plan, (goal[0], goal[1]), state[None], FIELD).actions6[0]
            anew.append(int(said[0]))
            state = walk_actions(plan, AGENT, state, said[:1])[0][-1]
        assert six.tolist() == anew


def test_waypoints_are_those_of_the_other_variants(plan: NavigationMap) -> None:
    goal = scatter(plan, 1, 7)[0]
    poses = scatter(plan, 200, 8)
    mine = label_states(plan, (goal[0], goal[1]), poses, FIELD)
    exact = label_states(plan, (goal[0], goal[1]), poses)
    same = (mine.waypoints == exact.waypoints).all(axis=(1, 2))
    assert same.mean() > 0.98  # a place that does not quite see its first bend has another way
    np.testing.assert_array_equal(mine.valid[same], exact.valid[same])
    np.testing.assert_allclose(mine.waypoints, exact.waypoints, atol=0.05)


def test_where_no_bend_is_seen_the_way_goes_down_the_field() -> None:
    """In clutter some places see no bend: their way stays free, and is about as long."""
    other = 0
    for seed in range(4):
        navigation = noise_map(seed, 0.12)
        goal = scatter(navigation, 1, seed + 1)[0]
        poses = scatter(navigation, 60, seed)
        mine = label_states(navigation, (goal[0], goal[1]), poses, FIELD)
        exact = label_states(navigation, (goal[0], goal[1]), poses)
        other += int((mine.waypoints != exact.waypoints).any(axis=(1, 2)).sum())
        c, s = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
        x, y = mine.waypoints[..., 0].astype(float), mine.waypoints[..., 1].astype(float)
        world = np.stack([poses[:, :1] + c * x - s * y, poses[:, 1:2] + s * x + c * y], -1)
        assert all(navigation.is_free(*place) for place in world.reshape(-1, 2))
        assert (np.abs(mine.valid.astype(int) - exact.valid) <= 2).all()
    assert other > 0


def test_the_body_decides_steps_turns_and_whether_it_slides() -> None:
    grid = OccupancyGrid(np.zeros((100, 100), np.uint8), 0.1, (0.0, 0.0))
    body = AgentSpec(forward_step=0.5, turn_degrees=30.0)
    pose = np.array([[2.0, 5.0, math.pi / 2]])
    navigation = NavigationMap(grid, 0.2)
    labels = label_states(navigation, (8.0, 5.0), pose, FIELD, agent=body)
    assert labels.actions6[0].tolist() == [3, 3, 3, 1, 1, 1]
    cells = np.ones((60, 60), np.uint8)
    cells[10:50, 10:50] = 0
    cells[30, 50:56], cells[31:34, 55] = 0, 0  # one cell wide, and its arms shorter than a step
    nook = NavigationMap(OccupancyGrid(cells, 0.05, (0.0, 0.0)), 0.0)
    field = nook.geodesic((0.6, 0.6))
    inside = np.array([55.5 * 0.05, 33.5 * 0.05, math.radians(7.0)])
    for sliding in (False, True):
        agent = AgentSpec(radius=0.0, sliding=sliding)
        walk = plan_from(field, inside, FIELD, agent)
        end = walk_actions(nook, agent, inside, walk)[0][-1]
        assert field.distance_at(end[0], end[1]) <= 0.25


def test_states_without_a_way_are_refused_by_row(plan: NavigationMap) -> None:
    goal = tuple(scatter(plan, 1, 0)[0, :2].tolist())
    good = scatter(plan, 2, 0)
    for bad in ([-50.0, 0.0, 0.0], [math.nan, 0.0, 0.0], [*good[0, :2], math.inf]):
        with pytest.raises(PlanError) as caught:
            label_states(plan, goal, np.vstack([good, bad]), FIELD)
        assert caught.value.where == "state 2"
    assert len(label_states(plan, goal, np.empty((0, 3)), FIELD)) == 0


# ---------------------------------------------------------------------------- in a dataset


@pytest.fixture(scope="module")
def built(data_suite: Suite, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    layout = PictureSettings(layout="none")
    own = BuildSettings(chunk=3, labels=FIELD, pictures=layout)
    return build_dataset(data_suite, tmp_path_factory.mktemp("field") / "data", own)


def test_a_dataset_says_how_it_is_labelled_and_its_walks_are_the_labels_own(
    built: Dataset, labels_only: Dataset
) -> None:
    about = open_dataset(built.folder).about
    assert about.settings.labels.variant == "field"
    assert set(built.sampled) == set(labels_only.sampled)
    for name in built.sampled:
        rows, episode = built.rows(name), built.episode(name)
        assert rows.executed.tolist() == rows.actions[:, 0].tolist()
        assert rows.executed[-1] == 0 and rows.distance[-1] <= 0.25
        assert not rows.collided.any()
        navigation = built.navigation(episode.scene_id)
        poses, actions = plan_expert(navigation, episode, FIELD)
        again = label_along(navigation, episode, poses, actions, FIELD)
        np.testing.assert_array_equal(rows.actions, again.actions6)
        np.testing.assert_array_equal(rows.waypoints, again.waypoints)


def test_verify_makes_the_same_labels_again(
    built: Dataset, copy_of: Callable[[Dataset], Path]
) -> None:
    from gn0.data.sample_table import (
        EpisodeRows,
        decode_rows,
        encode_rows,
        encode_table,
        load_sample_table,
    )

    assert verify_dataset(built.folder).ok
    folder = copy_of(built)
    path = folder / built.about.parts[0].path
    blocks = list(decode_rows(load_sample_table(path)))
    actions = blocks[0].actions.copy()
    actions[1, 0] = 3 - actions[1, 0]
    fields = {name: getattr(blocks[0], name) for name in EpisodeRows.__dataclass_fields__}
    blocks[0] = EpisodeRows(**{**fields, "actions": actions})
    path.write_bytes(encode_table(encode_rows(blocks)))
    (damage,) = verify_dataset(folder).damages
    assert damage.rows == (f"row 2 (episode {blocks[0].episode_id!r}, step 1), actions",)
