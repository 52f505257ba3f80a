"""Agents on a device put anywhere, and saved states that go on as if never left."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import EpisodeError, SimError
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode, MissionInstruction
from gn0.render.camera import Camera
from gn0.render.cuda.batch import RendererBatch
from gn0.sim import presets
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.device_states import pick_rows
from gn0.sim.presets import CameraPreset
from gn0.sim.simulator import Simulator
from gn0.testing.scenes import (
    build_floor_plan,
    build_map_scene,
    build_point_episodes,
    build_room_scene,
    with_goal_sets,
)

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
SENSORS = ("goal_vector", "ranges", "pose", "instruction_index")
ODDS = (0.02, 0.58, 0.2, 0.2)


@pytest.fixture(scope="module")
def plans():
    """Two maps of different size, and episodes that alternate between them."""
    grids = [build_floor_plan(0), build_floor_plan(1, width=8.0, depth=7.0, resolution=0.04)]
    scenes = [build_map_scene(grid, f"plan-{i}") for i, grid in enumerate(grids)]
    listed = [build_point_episodes(s, NavigationMap(s.grid, 0.2), 6, seed=5) for s in scenes]
    return scenes, with_goal_sets([e for pair in zip(*listed, strict=True) for e in pair])


@pytest.fixture
def tiny(monkeypatch) -> str:
    """A preset of small pictures, by its name."""
    camera = Camera.from_hfov(24, 20, 90)
    preset = CameraPreset("tiny", camera, camera, history_tile=(8, 4))
    monkeypatch.setitem(presets._BY_NAME, "tiny", preset)
    return "tiny"


def open_env(plans, count, device=None, **settings) -> VectorEnvDevice:
    scenes, episodes = plans
    settings = {"sensors": SENSORS, "max_steps": 40} | settings
    return VectorEnvDevice(
        count, scenes, episodes=episodes, device=device or DeviceHost(3), **settings
    )


def tell(values) -> bytes:
    """All bytes of observations, rewards, ends and infos."""
    if isinstance(values, dict):
        return b"".join(name.encode() + tell(values[name]) for name in sorted(values))
    if isinstance(values, tuple):
        return b"".join(map(tell, values))
    return (values if isinstance(values, np.ndarray) else values.numpy()).tobytes()


def go_on(env, actions) -> list[bytes]:
    return [tell(env.step(row)) for row in actions]


def many_actions(seed, rounds, count) -> np.ndarray:
    return np.random.default_rng(seed).choice(4, (rounds, count), p=ODDS)


def references(env) -> list[int]:
    store = env.simulator.store
    return sorted(store._references[store._references > 0].tolist())


def test_a_restored_state_goes_on_as_if_never_left(plans) -> None:
    """Ends and the episodes that follow included, as often as it is restored."""
    env = open_env(plans, 12, ahead=3)
    env.reset(seed=5)
    go_on(env, many_actions(0, 17, 12))
    saved = env.save_state()
    here = tell(env.observe())
    actions = many_actions(1, 60, 12)
    told = go_on(env, actions)
    for seed in (2, 3):
        go_on(env, many_actions(seed, 23, 12))
        seen, _ = env.restore_state(saved)
        assert tell(seen) == here
        assert go_on(env, actions) == told
    ends = sum(int(env.step(row)[1].numpy().sum() != 0) for row in actions[:3])
    assert ends


def test_some_agents_are_restored_and_the_others_stay(plans) -> None:
    env, twin = open_env(plans, 8), open_env(plans, 8)
    for one in (env, twin):
        one.reset(seed=1)
        go_on(one, many_actions(4, 9, 8))
    saved = env.save_state([6, 2])
    assert saved.agents.tolist() == [6, 2] and len(saved) == 2 and saved.nbytes > 0
    actions = many_actions(5, 12, 8)
    apart = actions.copy()
    apart[:, [6, 2]] = (1, 2)
    go_on(env, apart)
    env.restore_state(saved)
    late, early = env.save_state(), twin.save_state()
    for name in saved.rows:  # where they stood
        rows = late.rows[name].numpy(), early.rows[name].numpy()
        assert rows[0][[6, 2]].tobytes() == rows[1][[6, 2]].tobytes(), name
    go_on(twin, actions)
    others = [0, 1, 3, 4, 5, 7]
    for name, values in twin.save_state().rows.items():
        assert late.rows[name].numpy()[others].tobytes() == values.numpy()[others].tobytes(), name


@pytest.mark.slow
def test_copies_of_a_state_end_alike(plans) -> None:
    """Eight answers to one state; with draws of their own they part after the end."""
    env = open_env(plans, 8, device=DeviceHost(2, checked=True))
    env.reset(seed=9)
    go_on(env, many_actions(6, 11, 8))
    saved = env.save_state(np.arange(3, 5))
    for draws in (False, True):
        env.restore_state(saved, rows=np.repeat([0, 1], 4), draws=draws)
        followed = False
        for action in (1, 1, 2, 1, 3, 1, 0, 1, 1):
            if followed and not draws:
                break
            seen, rewards, stopped, cut, infos = env.step(np.full(8, action))
            followed = bool((stopped.numpy() | cut.numpy()).all())
            alike = {name: infos[name] for name in ("pose", "episode", "distance_to_goal")}
            alike |= {"rewards": rewards, "cut": cut, "ranges": seen["ranges"]}
            for name, values in alike.items():
                for group in (values.numpy()[:4], values.numpy()[4:]):
                    found = len({row.tobytes() for row in group})
                    if draws or not followed or name in ("rewards", "cut"):
                        assert found == 1, name
                    elif name == "episode":
                        assert found > 1
        assert followed or draws


def test_placed_agents_move_as_one_that_was_put_there(plans) -> None:
    """Any heading: poses, collisions and distances of a Simulator in that state."""
    scenes, episodes = plans
    env = open_env(plans, 6)
    env.reset(seed=2)
    rng = np.random.default_rng(7)
    chosen = [episodes[k] for k in (3, 0, 7, 4, 3, 3)]
    maps = {scene.id: NavigationMap(scene.grid, 0.2) for scene in scenes}
    poses = []
    for episode in chosen:
        free = np.argwhere(~maps[episode.scene_id].blocked)
        regions = maps[episode.scene_id].regions_of(episode.destination)
        while True:
            row, col = free[rng.integers(len(free))]
            grid = maps[episode.scene_id].grid
            x = grid.origin[0] + (col + rng.uniform(0.1, 0.9)) * grid.resolution
            y = grid.origin[1] + (row + rng.uniform(0.1, 0.9)) * grid.resolution
            if maps[episode.scene_id].region_of(x, y) in regions:
                break
        poses.append((x, y, rng.uniform(-3, 9)))
    seen, infos = env.place(chosen, poses, steps=[0, 1, 2, 3, 4, 36])
    twins = []
    for episode, pose, steps in zip(chosen, poses, (0, 1, 2, 3, 4, 36), strict=True):
        scene = next(s for s in scenes if s.id == episode.scene_id)
        twin = Simulator(scene, navigation=maps[scene.id], max_steps=40)
        twin.reset(episode)
        state = replace(twin.save_state(), x=pose[0], y=pose[1], steps=steps, turns=0,
                        base=math.remainder(pose[2], math.tau))  # fmt: skip
        twin.restore_state(state)
        twins.append(twin)
    ends = 0
    for t in range(12):
        for k, twin in enumerate(twins):
            if twin.over:
                continue
            assert env.episodes[infos["episode"].numpy()[k]] == chosen[k]
            assert infos["pose"].numpy()[k].tobytes() == np.array(twin.pose).tobytes()
            field = twin.navigation.geodesic(chosen[k].destination)
            assert infos["distance_to_goal"].numpy()[k] == field.distance_at(*twin.pose[:2])
        actions = rng.choice(4, 6, p=(0.0, 0.6, 0.2, 0.2))
        seen, _, _, cut, infos = env.step(actions)
        for k, twin in enumerate(twins):
            if not twin.over:
                result = twin.step(int(actions[k]))
                assert bool(cut.numpy()[k]) == result.truncated, t
                if not result.truncated:
                    assert bool(seen["collided"].numpy()[k]) == result.collided
                ends += result.truncated
    assert ends == 1


def test_poses_of_a_walk_need_no_headings_of_their_own(plans) -> None:
    """Put where another run stood, agents go on with its bytes."""
    env, twin = open_env(plans, 5), open_env(plans, 5)
    twin.reset(seed=3)
    for row in many_actions(8, 13, 5):
        infos = twin.step(row)[4]
    env.reset(seed=77)
    env.place(infos["episode"].numpy(), infos["pose"], steps=twin.simulator.state["steps"])
    assert not env.simulator.store._turned
    names = ("position", "turns", "steps", "distance")
    for row in many_actions(9, 10, 5):
        for name in names:
            same = env.simulator.state[name], twin.simulator.state[name]
            assert same[0].numpy().tobytes() == same[1].numpy().tobytes(), name
        row[row == 0] = 2
        env.step(row)
        infos = twin.step(row)[4]
        if infos["_final_info"].numpy().any():
            break


def test_refusals_name_agent_and_pose_and_nobody_moves(plans) -> None:
    _, episodes = plans
    env = open_env(plans, 4)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.place(episodes[0], [(0.0, 0.0, 0.0)] * 4)
    env.reset(seed=1)
    env.synchronize()
    before, held = tell(env.observe()), references(env)
    good = env.simulator.outputs["pose"].numpy()
    numbers = env.simulator.outputs["episode"].numpy()
    for bad, why in (
        ((-50.0, 1.0, 0.0), "blocked for an agent of radius 0.2 m"),
        ((float("nan"), 1.0, 0.0), "NaN or infinity"),
        ((1.0, 1.0, float("inf")), "NaN or infinity"),
    ):
        poses = good.copy()
        poses[2] = bad
        with pytest.raises(SimError, match=why) as told:
            env.place(numbers, poses + np.array([0, 0, 0.01]))
        assert "agent 2" in str(told.value) and repr(episodes[numbers[2]].id) in str(told.value)
        with pytest.raises(SimError, match="agent 3"):
            env.place(numbers[2:3], [bad], agents=[3])
        assert references(env) == held
    for wrong in ({"agents": [4]}, {"agents": [1, 1]}, {"agents": []}, {"agents": "all"},
                  {"steps": 40}, {"steps": -1}, {"steps": [0.5] * 4}, {"steps": [1, 2]},
                  {"collided": [True]},
                  {"tiles": np.zeros((4, 1, 8, 8, 3), np.uint8)}):  # fmt: skip
        with pytest.raises(SimError):
            env.place(numbers, good, **wrong)
    for poses in (good[:3], good[:, :2], "there", [[1, 2, 3], [4]]):
        with pytest.raises(SimError):
            env.place(numbers, poses)
    with pytest.raises(EpisodeError):
        env.place([999] * 4, good)
    assert tell(env.observe()) == before
    assert env.simulator.outputs["pose"].numpy().tobytes() == good.tobytes()


def test_ground_that_the_goal_cannot_be_reached_from() -> None:
    """Two rooms and no door: places in the other one are refused, and never drawn."""
    cells = np.zeros((40, 80), np.bool_)
    cells[[0, -1]] = cells[:, [0, -1]] = cells[:, 40] = True
    scene = build_map_scene(OccupancyGrid(cells, 0.1, (-2.0, 1.0)), "apart")
    start, goal = (-1.0, 2.0, 0.3), (0.5, 4.0)
    episode = Episode(id="a", scene_id="apart", start=start, path=(start[:2], goal),
                      mission=MissionInstruction(goal=goal, instruction="Go."))  # fmt: skip
    env = VectorEnvDevice(300, scene, episodes=[episode], device=DeviceHost(1), sensors=("pose",))
    env.reset(seed=0)
    with pytest.raises(SimError, match="no way to the goal"):
        env.place("a", [(4.0, 3.0, 0.0)], agents=[7])
    pose = env.place_uniform(4)[1]["pose"].numpy()
    assert pose[:, 0].min() >= -1.8 and pose[:, 0].max() <= 1.9
    assert pose[:, 1].min() >= 1.2 and pose[:, 1].max() <= 4.8
    low, high = np.array([-1.7, 1.3]), np.array([1.7, 4.7])  # the free part of the room
    share = (pose[:, :2] - low) / (high - low)
    assert np.abs(share.mean(0) - 0.5).max() < 0.06
    assert np.abs(share.std(0) - 12**-0.5).max() < 0.04


def test_uniform_states_are_drawn_from_the_seed_alone(plans) -> None:
    scenes, episodes = plans
    env, few = open_env(plans, 120), open_env(plans, 12, device=DeviceHost(2, checked=True))
    env.reset(seed=0)
    few.reset(seed=8)
    _, infos = env.place_uniform(6)
    poses, numbers = infos["pose"].numpy(), infos["episode"].numpy()
    maps = {scene.id: NavigationMap(scene.grid, 0.2) for scene in scenes}
    for pose, number in zip(poses, numbers, strict=True):
        episode = env.episodes[number]
        navigation = maps[episode.scene_id]
        assert navigation.region_of(*pose[:2]) in navigation.regions_of(episode.destination)
        turns = math.remainder(pose[2] - episode.start[2], math.radians(15))
        assert abs(turns) < 1e-9
    assert set(numbers.tolist()) == set(range(len(episodes)))
    assert (env.simulator.state["steps"].numpy() == 0).all()
    again = few.place_uniform(6, agents=np.arange(11, -1, -1))[1]
    assert again["pose"].numpy()[::-1].tobytes() == poses[:12].tobytes()
    assert again["episode"].numpy()[::-1].tolist() == numbers[:12].tolist()
    assert few.place_uniform(7)[1]["pose"].numpy().tobytes() != poses[:12].tobytes()
    chosen = few.place_uniform(7, episodes=[episodes[2]] * 12)[1]
    assert set(chosen["episode"].numpy().tolist()) == {2}
    go_on(env, many_actions(0, 20, 120))


def test_states_bring_their_tiles_and_uniform_ones_are_black(tiny) -> None:
    scene = build_room_scene()
    episodes = build_point_episodes(scene, NavigationMap(scene.grid, 0.2), 3, seed=5)
    device = DeviceHost()
    env = VectorEnvDevice(
        2, scene, episodes=episodes, device=device, renderer=RendererBatch(device), preset=tiny,
        sensors=("rgb", "history", "goal_picture"), max_steps=60,
    )  # fmt: skip
    env.reset(seed=1)
    walk = np.random.default_rng(3).choice(4, (17, 2), p=(0.0, 0.4, 0.3, 0.3))
    go_on(env, walk)
    saved = env.save_state()
    here, then = tell(env.observe()), go_on(env, walk)
    black = env.place_uniform(2)[0]["history"].numpy()
    assert not black.any()
    seen, infos = env.restore_state(saved)
    assert tell(seen) == here
    mosaic, numbers, poses = (
        seen["history"].numpy(),
        infos["episode"].numpy(),
        infos["pose"].numpy(),
    )
    hit = seen["collided"].numpy()
    assert go_on(env, walk) == then
    height, width = mosaic.shape[1] // 4, mosaic.shape[2] // 4
    tiles = mosaic.reshape(2, 4, height, 4, width, 3).swapaxes(2, 3)
    tiles = tiles.reshape(2, 16, height, width, 3)
    for given in (tiles, device.upload(np.ascontiguousarray(tiles))):
        env.place_uniform(3)
        again = env.place(numbers, poses, steps=17, collided=hit, tiles=given)[0]
        assert tell(again) == here
    assert go_on(env, walk) == then
    few = env.place(numbers[:1], poses[:1], agents=[1], tiles=tiles[:1, :5])[0]
    shown = few["history"].numpy()[1].reshape(4, height, 4, width, 3).swapaxes(1, 2)
    shown = shown.reshape(16, height, width, 3)
    assert (shown[:5] == tiles[0, :5]).all() and not shown[5:].any()
    env.step(np.full(2, 2))
    (moved,) = env.save_state([1]).rows["views"].numpy().tolist()
    assert moved == 6
    with pytest.raises(SimError, match="tiles are"):
        env.place(numbers, poses, tiles=tiles[:, :, :2])
    with pytest.raises(SimError, match="tiles are"):
        env.place(numbers, poses, tiles=tiles.astype(np.float32))


def test_headings_of_ones_own_come_and_go(plans) -> None:
    """A memory that is too small: what nobody plays any more makes room, and comes back."""
    env = open_env(plans, 3, memory=700_000, ahead=1)
    env.reset(seed=2)
    store = env.simulator.store
    rng, saved, told = np.random.default_rng(1), None, None
    for n in range(30):
        poses = env.simulator.outputs["pose"].numpy() + np.array([0, 0, rng.uniform(0.01, 0.1)])
        env.place(env.simulator.outputs["episode"].numpy(), poses)
        assert (env.simulator.outputs["pose"].numpy()[:, :2] == poses[:, :2]).all()
        go_on(env, many_actions(n, 6, 3))
        if n == 4:
            env.place(env.simulator.outputs["episode"].numpy(), env.simulator.outputs["pose"])
            env.place(env.simulator.outputs["episode"].numpy(),
                      env.simulator.outputs["pose"].numpy() + np.array([0, 0, 0.05]))  # fmt: skip
            saved = env.save_state()
            told = go_on(env, many_actions(99, 20, 3))
    assert store.dropped > 10
    assert len(store._turned) == len(store._base_of) <= 2 * 3  # these, and those before
    env.restore_state(saved)
    assert go_on(env, many_actions(99, 20, 3)) == told
    assert sum(references(env)) == 3 + int((env.simulator.queue.filled
                                            - env.simulator.queue.known).sum())  # fmt: skip


@pytest.mark.parametrize("wrong", [{}, None, [1]])
def test_what_is_no_saved_states_is_refused_by_name(wrong) -> None:
    with pytest.raises(SimError, match="are not saved states"):
        pick_rows(wrong, None)


def test_states_are_joined_and_those_of_others_refused(plans) -> None:
    env, other = open_env(plans, 4), open_env(plans, 4)
    env.reset(seed=1)
    other.reset(seed=1)
    first = env.save_state([0])
    go_on(env, many_actions(3, 8, 4))
    second = env.save_state([3, 1])
    both = first.join(second)
    assert both.agents.tolist() == [0, 3, 1] and both.nbytes == first.nbytes + second.nbytes
    pose = env.restore_state(both, agents=[2, 0, 1])[1]["pose"].numpy()
    assert pose[2].tobytes() == env.restore_state(first)[1]["pose"].numpy()[0].tobytes()
    assert pose[[0, 1]].tobytes() == env.restore_state(second)[1]["pose"].numpy()[[3, 1]].tobytes()
    with pytest.raises(SimError, match="not of one environment"):
        first.join(other.save_state())
    with pytest.raises(SimError, match="another environment"):
        other.restore_state(first)
    for wrong in ({"rows": [1]}, {"rows": [0, 0]}, {"agents": [1, 2]}, {"rows": [[0]]}):
        with pytest.raises(SimError):
            env.restore_state(first, **wrong)
