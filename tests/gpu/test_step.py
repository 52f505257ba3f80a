"""Agents on the device: bit by bit those of VectorEnv, in numbers; tensors without a copy."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.errors import SimError
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.device_rollout import RolloutCollector
from gn0.sim.vector import VectorEnv
from gn0.testing.scenes import build_floor_plan, build_map_scene, build_point_episodes

WALK = [0.05, 0.55, 0.2, 0.2]


@pytest.fixture(scope="module")
def plans():
    grids = [build_floor_plan(i, width=6.0 + i, depth=5.0) for i in range(3)]
    scenes = [build_map_scene(grid, f"plan-{i}") for i, grid in enumerate(grids)]
    return scenes, [
        episode
        for scene in scenes
        for episode in build_point_episodes(scene, NavigationMap(scene.grid, 0.2), 10)
    ]


@pytest.mark.small
@pytest.mark.parametrize("memory", [2**30, 400_000])
def test_all_floats_are_those_of_the_cpu(device, plans, memory) -> None:
    """Thousands of agents on a card; collisions, autoresets, maps that come and go."""
    scenes, episodes = plans
    count, steps = (2048, 200) if device.kind == "cuda" else (6, 25)
    if memory < 2**30:
        count, steps = 2, 4 * steps
    settings = {"episodes": episodes, "sensors": ("goal_vector", "ranges", "pose"),
                "max_steps": 30}  # fmt: skip
    there = VectorEnvDevice(count, scenes, device=device, memory=memory, ahead=2, **settings)
    here = VectorEnv(count, scenes, **settings)
    rng = np.random.default_rng(1)
    seen, want = there.reset(seed=5)[0], here.reset(seed=5)[0]
    for t in range(steps):
        for name in ("goal_vector", "ranges", "pose", "collided"):
            assert seen[name].numpy().tobytes() == want[name].tobytes(), (t, name)
        actions = rng.choice(4, count, p=WALK)
        seen, rewards, terminated, truncated, infos = there.step(device.upload(actions))
        want, gains, stopped, cut, facts = here.step(actions)
        assert rewards.numpy().tobytes() == gains.tobytes()
        assert (terminated.numpy() == stopped).all()
        assert (truncated.numpy() == cut).all()
        assert infos["distance_to_goal"].numpy().tobytes() == facts["distance_to_goal"].tobytes()
        if (stopped | cut).any():
            final = infos["final_info"]
            for name in ("pose", "distance_to_goal", "success"):
                assert final[name].numpy().tobytes() == facts["final_info"][name].tobytes()
    assert (there.simulator.store.dropped > 0) == (memory < 2**30)


@pytest.mark.small
def test_bodies_that_slide_do_so_as_on_the_cpu(device, plans) -> None:
    """Rooms and a thicket of single cells; what is left of a cut move goes along the walls."""
    cells = (np.random.default_rng(5).random((90, 70)) < 0.12).astype(np.uint8)
    cells[[0, -1]] = cells[:, [0, -1]] = 1
    thicket = build_map_scene(OccupancyGrid(cells, 0.07, (-2.0, 1.0)), "thicket")
    body = AgentSpec(radius=0.10, camera_height=1.25, forward_step=0.6, sliding=True)
    scenes = [*plans[0], thicket]
    episodes = [
        episode
        for scene in scenes
        for episode in build_point_episodes(scene, NavigationMap(scene.grid, 0.1), 6, agent=body)
    ]
    count, steps = (2048, 300) if device.kind == "cuda" else (30, 40)
    settings = {"episodes": episodes, "sensors": ("pose",), "max_steps": 40, "agent": body}
    there = VectorEnvDevice(count, scenes, device=device, **settings)
    here = VectorEnv(count, scenes, **settings)
    seen, want = there.reset(seed=5)[0], here.reset(seed=5)[0]
    rng, slid = np.random.default_rng(2), 0
    for t in range(steps):
        before = want["pose"][:, :2].copy()
        actions = rng.choice(4, count, p=[0.01, 0.69, 0.2, 0.1])
        seen, rewards, *_ = there.step(device.upload(actions))
        want, gains, stopped, cut, _ = here.step(actions)
        for name in ("pose", "collided"):
            assert seen[name].numpy().tobytes() == want[name].tobytes(), (t, name)
        assert rewards.numpy().tobytes() == gains.tobytes()
        moved = np.linalg.norm(want["pose"][:, :2] - before, axis=1)
        slid += int((want["collided"].astype(bool) & ~(stopped | cut) & (moved > 0.1)).sum())
    assert slid > 2 * steps


@pytest.mark.small
def test_a_bad_action_on_the_device_is_told(device, plans) -> None:
    scenes, episodes = plans
    env = VectorEnvDevice(40, scenes, episodes=episodes, device=device)
    env.reset(seed=0)
    actions = np.ones(40, np.int64)
    actions[[33, 7]] = 4, -1
    env.step(device.upload(actions))
    with pytest.raises(SimError, match="agent 7"):
        env.synchronize()
    env.step(device.upload(np.ones(40, np.int64)))
    env.synchronize()


def test_torch_sees_the_same_memory(card, plans) -> None:
    torch = pytest.importorskip("torch")
    scenes, episodes = plans
    env = VectorEnvDevice(512, scenes, episodes=episodes, device=card, max_steps=30)
    env.reset(seed=0)
    rollouts = RolloutCollector(env, 40, ("goal_vector",))

    def policy(seen):
        forward, left = torch.from_dlpack(seen["goal_vector"]).T
        turn = torch.where(left > 0, 2, 3)
        return torch.where(left.abs() < 0.3 * forward, 1, turn)

    first = rollouts.collect(policy)
    rewards = torch.from_dlpack(first.rewards)
    assert rewards.data_ptr() == first.rewards.pointer
    assert rewards.is_cuda
    kept = rewards.clone()
    env.reset(seed=0)
    again = rollouts.collect(lambda seen: policy(seen).to(torch.int32))
    assert bool((torch.from_dlpack(again.rewards) == kept).all())
    side = torch.cuda.Stream()
    with torch.cuda.stream(side):  # actions made on another stream are waited for
        env.reset(seed=0)
        third = rollouts.collect(policy)
    assert (third.rewards.numpy() == kept.cpu().numpy()).all()
