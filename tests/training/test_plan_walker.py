"""Plans lead where the simulator's collision rule on the CPU says, to the bit."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gn0.errors import SimError  # noqa: E402
from gn0.maps.navigation import NavigationMap  # noqa: E402
from gn0.missions.episode import AgentSpec  # noqa: E402
from gn0.paper import FORWARD, LEFT, RIGHT, STOP  # noqa: E402
from gn0.sim.collision import move_agent  # noqa: E402
from gn0.sim.kinematics import Heading, step_forward  # noqa: E402
from gn0.training.rl.plan_walker import PlanWalker  # noqa: E402


def walk_on_cpu(navigation, agent, start, pose, plan):
    """Poses and cut-short FORWARDs of a plan, action by action."""
    x, y, yaw = pose
    headings = [Heading(start, k, agent.turn_degrees) for k in range(24)]
    turns = [heading.yaw for heading in headings].index(yaw)
    poses, cut = [], []
    for k, action in enumerate(plan):
        hit = False
        if STOP not in plan[: k + 1]:
            if action == FORWARD:
                ahead = step_forward(x, y, headings[turns % 24].yaw, agent.forward_step)
                x, y, _, hit = move_agent(navigation, x, y, *ahead, agent)
            turns += (action == LEFT) - (action == RIGHT)
        poses.append((x, y, headings[turns % 24].yaw))
        cut.append(hit)
    return poses, cut


@pytest.mark.parametrize("sliding", [False, True])
def test_plans_end_where_the_rule_on_the_cpu_says(make_env, rooms, sliding) -> None:
    agent = AgentSpec(radius=0.2, sliding=sliding)
    own = [msgspec.structs.replace(episode, agent=agent) for episode in rooms[1]]
    env = make_env(6, sensors=("goal_vector",), agent=agent, episodes=own)
    env.reset(seed=0)
    env.place_uniform(3)
    infos = env.turn_agents(np.arange(6, dtype=np.int32))[1]
    episode, pose = (torch.from_dlpack(infos[name]).clone() for name in ("episode", "pose"))
    walker = PlanWalker(env, episode, pose)
    stream = np.random.default_rng(1)
    count = 200
    rows = stream.integers(0, 6, count)
    plans = stream.choice(4, (count, 6), p=(0.06, 0.64, 0.15, 0.15))
    plans[:6] = FORWARD  # into the wall ahead
    walks = walker.walk(torch.from_numpy(rows), torch.from_numpy(plans))
    navigation = NavigationMap(rooms[0][0].grid, 0.2)
    for k in range(count):
        number = int(episode[rows[k]])
        start = env.episodes[number].start[2]
        place = tuple(pose[rows[k]].tolist())
        poses, cut = walk_on_cpu(navigation, agent, start, place, plans[k].tolist())
        assert walks.poses[k].tolist() == [list(one) for one in poses]
        assert walks.cut[k].tolist() == cut
    assert walks.cut.any() and not walks.cut.all()


def test_agents_neither_disturb_plans_nor_feel_them(make_env) -> None:
    """Time limits and a STOP that ends an episode are of agents; plans know nothing of them."""
    env, twin = (make_env(3, sensors=("goal_vector",), max_steps=4) for _ in range(2))
    twin.reset(seed=2)
    pose = torch.from_dlpack(env.reset(seed=2)[1]["pose"]).clone()
    episode = torch.from_dlpack(env._telling.inform()["episode"]).clone()
    walker = PlanWalker(env, episode, pose)
    rows, plans = torch.arange(3), torch.tensor([[FORWARD] * 6, [LEFT, STOP] * 3, [RIGHT] * 6])
    first = walker.walk(rows, plans)
    for step in range(9):
        actions = np.full(3, FORWARD if step % 5 else STOP)
        one, other = env.step(actions), twin.step(actions)
        assert one[4]["pose"].numpy().tobytes() == other[4]["pose"].numpy().tobytes()
        again = walker.walk(rows.flip(0), plans.flip(0))
        assert torch.equal(again.poses.flip(0), first.poses)
        assert torch.equal(again.cut.flip(0), first.cut)
    assert first.poses[1, 1:].tolist() == [first.poses[1, 0].tolist()] * 5  # frozen by STOP
    walker.close()
    with pytest.raises(SimError, match="given up"):
        walker.walk(rows, plans)


def test_places_in_a_wall_and_other_shapes_are_refused(make_env) -> None:
    env = make_env(2, sensors=("goal_vector",))
    pose = torch.from_dlpack(env.reset(seed=2)[1]["pose"]).clone()
    episode = torch.from_dlpack(env._telling.inform()["episode"]).clone()
    outside = pose.clone()
    outside[1, 0] = 500.0
    with pytest.raises(SimError, match=r"place 1, episode .*blocked"):
        PlanWalker(env, episode, outside)
    outside[1, 0] = torch.nan
    with pytest.raises(SimError, match="NaN"):
        PlanWalker(env, episode, outside)
    walker = PlanWalker(env, episode, pose)
    with pytest.raises(SimError, match="rows are"):
        walker.walk(torch.arange(3), torch.zeros((2, 6), dtype=torch.int64))
