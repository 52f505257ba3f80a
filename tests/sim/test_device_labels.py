"""Labels of agents on a device are those of the CPU, to the bit; on the host emulation of a GPU."""

from __future__ import annotations

import shutil

import gymnasium
import numpy as np
import pytest
from msgspec.structs import replace

from gn0.data.field_labels import label_poses
from gn0.device.host import DeviceHost
from gn0.errors import SimError
from gn0.maps.field_expert import ROUNDING, label_field
from gn0.maps.goal_places import GoalSet, GoalSetInner
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.ground import list_headings
from gn0.testing.scenes import (
    build_floor_plan,
    build_map_scene,
    build_point_episodes,
    with_goal_sets,
)

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")


def clutter(seed: int, density: float = 0.1) -> OccupancyGrid:
    """Ground so narrow that steps back, nooks and ways without a bend in sight occur."""
    rng = np.random.default_rng(seed)
    cells = (rng.random((50, 50)) < density).astype(np.uint8)
    cells[:2] = cells[-2:] = cells[:, :2] = cells[:, -2:] = 1
    return OccupancyGrid(cells, 0.1, (-2.0, 3.0))


def build(grids: list[OccupancyGrid], count: int, agent: AgentSpec, **settings):
    """An environment on maps, and its maps inflated."""
    scenes = [build_map_scene(grid, f"plan-{i}") for i, grid in enumerate(grids)]
    ground = {s.id: NavigationMap(s.grid, agent.radius) for s in scenes}
    listed = [build_point_episodes(s, ground[s.id], 6, seed=5, agent=agent) for s in scenes]
    episodes = with_goal_sets([e for group in zip(*listed, strict=True) for e in group])
    own = {"sensors": (), "agent": agent, "episodes": episodes, "device": DeviceHost(3)}
    return VectorEnvDevice(count, scenes, **(own | settings)), ground


def assert_same(env: VectorEnvDevice, ground: dict[str, NavigationMap], stop: float = 0.25):
    """Every label of the environment is that of the CPU; returns what it says [N, 6]."""
    labels = env.labels() if stop == 0.25 else env.labels(stop)
    mine = [array.numpy() for array in labels]
    simulator = env.simulator
    agent = simulator.store.agent
    numbers = simulator.outputs["episode"].numpy()
    bases = simulator.store.bases_at(simulator.state["slot"].numpy())  # of who was put somewhere
    turned = [
        episode if np.isnan(base) else replace(episode, start=(*episode.start[:2], float(base)))
        for episode, base in zip([env.episodes[n] for n in numbers.tolist()], bases, strict=True)
    ]
    places, turns = (simulator.state[name].numpy() for name in ("position", "turns"))
    for i, number in enumerate(numbers.tolist()):
        episode = env.episodes[number]
        theirs = label_field(
            ground[episode.scene_id].geodesic(episode.destination), places[i : i + 1],
            list_headings(turned[i], agent)[None], turns[i : i + 1], np.zeros(1, np.int64),
            near=stop - ROUNDING, step=agent.forward_step, sliding=bool(agent.sliding),
        )  # fmt: skip
        for name, ours, wanted in zip(theirs._fields, mine, theirs, strict=True):
            assert ours.dtype == wanted.dtype, name
            np.testing.assert_array_equal(ours[i], wanted[0], f"{name} of agent {i}")
            assert ours[i].tobytes() == wanted[0].tobytes(), name
    np.testing.assert_array_equal(mine[3], simulator.outputs["distance"].numpy())
    return mine[0]


@pytest.mark.parametrize("sliding", [False, True])
def test_labels_are_those_of_the_cpu_wherever_agents_go(sliding: bool) -> None:
    """In rooms, goal sets and areas among them, as new episodes begin all the time."""
    agent = AgentSpec(sliding=sliding)
    env, ground = build([build_floor_plan(0), build_floor_plan(1)], 12, agent, max_steps=25)
    env.reset(seed=1)
    rng = np.random.default_rng(0)
    said: set[int] = set()
    for turn in range(40):
        if turn % 3 == 0:
            said |= set(assert_same(env, ground)[:, 0].tolist())
        env.step(rng.choice(4, 12, p=(0.05, 0.65, 0.15, 0.15)))
    assert said == {0, 1, 2, 3}


def test_labels_go_further_into_areas_where_they_are_told_to() -> None:
    """STOP is that of the CPU, and behind the first free ground of the area."""
    env, _ = build([build_floor_plan(0)], 6, AgentSpec())
    deeper = [
        replace(e, goal_set=GoalSetInner(areas=e.goal_set.areas, depth=0.5)) if e.in_area else e
        for e in env.episodes
    ]
    env, ground = build([build_floor_plan(0)], 6, AgentSpec(), episodes=deeper)
    env.reset(seed=1)
    ended = 0
    for _ in range(60):
        labels = assert_same(env, ground)
        for i in np.flatnonzero(labels[:, 0] == 0):
            episode = env.episodes[int(env.simulator.outputs["episode"].numpy()[i])]
            if not episode.in_area:
                continue
            ended += 1
            own = GoalSet(areas=episode.goal_set.areas)
            field = ground[episode.scene_id].geodesic(own)
            outside = np.argwhere(~ground[episode.scene_id].blocked & ~field.inside)
            centres = field.grid.centres_of(outside)
            at = env.simulator.state["position"].numpy()[i]
            assert np.hypot(*(centres - at).T).min() > 0.45
        env.step(labels[:, 0].astype(np.int64))
    assert ended


@pytest.mark.parametrize("turn_degrees", [15.0, 30.0, 10.0])
def test_also_in_clutter_and_for_other_bodies(turn_degrees: float) -> None:
    """36 headings are more than a warp has lanes."""
    agent = AgentSpec(radius=0.1, turn_degrees=turn_degrees, forward_step=0.25)
    env, ground = build([clutter(1), clutter(2, 0.2)], 16, agent, max_steps=60)
    env.reset(seed=2)
    rng = np.random.default_rng(1)
    for turn in range(18):
        if turn % 6 == 5:
            assert_same(env, ground, stop=0.4 if turn == 5 else 0.25)
        env.step(rng.choice(4, 16, p=(0.0, 0.8, 0.1, 0.1)))


def test_agents_put_at_any_pose_are_labelled_as_poses_are() -> None:
    """`label_states` of the poses themselves says the same, to the bit."""
    env, ground = build([build_floor_plan(0)], 8, AgentSpec())
    env.reset(seed=0)
    navigation = ground["plan-0"]
    rng = np.random.default_rng(3)
    for episode in env.episodes[:3]:
        field = navigation.geodesic(episode.destination)
        free = np.argwhere(field.label >= 0)
        places = navigation.grid.centres_of(free[rng.integers(len(free), size=8)])
        poses = np.column_stack([places, rng.uniform(-3.0, 3.0, 8)])
        env.place(episode.id, poses)
        mine = [array.numpy() for array in env.labels()]
        theirs = label_poses(field, poses, env.tasks.agent, 0.25 - ROUNDING)
        for ours, wanted in zip(mine, theirs, strict=True):
            assert ours.tobytes() == wanted.tobytes()
    assert_same(env, ground)


def test_who_does_what_the_labels_say_arrives() -> None:
    env, _ = build([build_floor_plan(2)], 8, AgentSpec(), max_steps=400, copy=True)
    env.reset(seed=4, options={"episode": [0, 1, 2, 3, 4, 5, 0, 1]})
    stopped = np.zeros(8, bool)
    for _ in range(150):
        actions = env.labels().actions.numpy()[:, 0].astype(np.int64)
        seen, _, terminated, _, infos = env.step(actions)
        ended = terminated.numpy()
        assert (infos["final_info"]["distance_to_goal"].numpy()[ended] <= 0.25).all()
        assert not seen["collided"].numpy().any()
        stopped |= ended
        if stopped.all():
            break
    assert stopped.all()


def test_no_thread_reads_what_another_may_be_writing() -> None:
    device = DeviceHost(2, checked=True)
    env, ground = build([clutter(1)], 6, AgentSpec(radius=0.1), device=device)
    env.reset(seed=1)
    assert_same(env, ground)


def test_what_labels_need_makes_room_with_the_episodes() -> None:
    """In memory for few of them, each goal of 24 is labelled rightly, again and again."""
    grids = [build_floor_plan(k, width=7.0, depth=7.0) for k in range(4)]
    env, ground = build(grids, 2, AgentSpec(), memory=2**18, ahead=1)
    env.reset(seed=0)
    for turn in range(30):
        if turn % 5 == 0:
            assert_same(env, ground)
        env.step([0, 0])
    assert env.simulator.store.dropped > 0


def test_labels_before_a_reset_or_of_no_distance_are_refused() -> None:
    env, _ = build([build_floor_plan(0)], 1, AgentSpec())
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.labels()
    env.reset(seed=0)
    for stop in (0.0, -1.0, float("nan"), 11.0):
        with pytest.raises(SimError, match="labels that stop"):
            env.labels(stop)


def test_labels_that_are_expected_build_no_field_twice() -> None:
    """Those that are not cost a second look at every goal that is played; they are the same."""
    env, ground = build([build_floor_plan(seed) for seed in range(3)], 6, AgentSpec())
    surprised, _ = build([build_floor_plan(seed) for seed in range(3)], 6, AgentSpec())
    env.expect_labels()
    for one in (env, surprised):
        one.reset(seed=0)
    built = env.simulator.store.fields_built
    assert surprised.simulator.store.fields_built == built
    assert_same(env, ground)
    assert_same(surprised, ground)
    assert env.simulator.store.fields_built == built
    assert surprised.simulator.store.fields_built == 2 * built
    for mine, theirs in zip(env.labels(), surprised.labels(), strict=True):
        assert (mine.numpy() == theirs.numpy()).all()
