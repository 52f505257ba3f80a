"""FollowNav: rules and rewards of following, alone and by the many."""

from __future__ import annotations

import math
import warnings
from functools import partial

import gymnasium
import msgspec
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from hypothesis import given, settings
from hypothesis import strategies as st

import gn0
from gn0.errors import EpisodeError, SimError
from gn0.missions.episode import AgentSpec, Episode, MissionFollow
from gn0.missions.follow_rules import FOLLOW, FollowCount, FollowSight, count_step
from gn0.missions.follow_target import FollowTarget
from gn0.people.person import EpisodePerson
from gn0.scenes import build_example_scene
from gn0.sim.follow_env import FollowNavEnv
from gn0.sim.follow_tally import ENDS, FollowTally
from gn0.sim.follow_vector import FollowVectorEnv

gn0.register_envs()
FLAT = build_example_scene()
BODY = AgentSpec(radius=0.25, step_seconds=0.2)
STOP, FORWARD, LEFT = 0, 1, 2


def _episode(*path: tuple[float, float], name: str = "e", **more: object) -> Episode:
    behaviour = "stand" if len(path) == 1 else "script"  # who stands faces along +x
    person = EpisodePerson(
        number=5, identity="drawn:0:1", path=path, speed=0.8, behaviour=behaviour
    )
    mission = MissionFollow(
        goal=path[-1], instruction="Follow.", human="drawn:0:1", person=5, distance=1.0
    )
    return Episode(
        id=name, scene_id=FLAT.id, mission=mission, start=(2.0, 2.5, 0.0),
        path=((2.0, 2.5), path[-1]), people=(person,), **more,
    )  # fmt: skip


def test_it_passes_gymnasium_s_own_check() -> None:
    env = gymnasium.make("gn0/FollowNav-v1", sensors=("instruction", "ranges"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped, skip_render_check=True)
    env.close()


def test_gymnasium_s_own_vector_of_them_is_ours() -> None:
    """Equal shapes for one person and two; observations, rewards, ends and infos of ours."""
    other = EpisodePerson(number=2, identity="drawn:0:2", path=((3.0, 1.5),), behaviour="stand")
    alone = _episode((3.0, 2.5), (3.4, 2.5))
    episodes = [alone, msgspec.structs.replace(alone, people=(*alone.people, other))]
    asked = {"sensors": ("ranges",), "agent": BODY}

    def make(one: Episode) -> gymnasium.Env:
        return gymnasium.make("gn0/FollowNav-v1", scene=FLAT, episodes=[one], **asked)

    made = [partial(make, one) for one in episodes]
    single = SyncVectorEnv(made, autoreset_mode=AutoresetMode.SAME_STEP)
    ours = [FollowVectorEnv(1, FLAT, episodes=[e], **asked) for e in episodes]
    seen, infos = single.reset(seed=4)
    first = [env.reset(seed=4) for env in ours]
    assert infos["people"].shape == (2, 16, 4) and infos["people_count"].tolist() == [1, 2]
    ended = 0
    for action in [LEFT, 3, *[FORWARD] * 14]:
        for row, (found, told) in enumerate(first):
            assert np.array_equal(seen["ranges"][row], found["ranges"][0])
            count = infos["people_count"][row]
            assert np.array_equal(infos["people"][row][:count], told["people"][0])
            for key in ("hit_person", "hit_by", "follows", "end"):
                assert infos[key][row] == told[key][0], key
        seen, rewards, over, cut, infos = single.step(np.array([action, action]))
        taken = [env.step(np.array([action])) for env in ours]
        first = [(step[0], step[4]) for step in taken]
        for row, step in enumerate(taken):
            assert (rewards[row], over[row], cut[row]) == (step[1][0], step[2][0], step[3][0])
        ended += int(over.sum())
    assert ended > 0  # it ran into the person ahead, and began anew
    single.close()


def test_standing_still_ends_nothing_and_a_touch_ends_it() -> None:
    env = FollowNavEnv(FLAT, episodes=[_episode((3.2, 2.5))], sensors=(), agent=BODY)
    env.reset(seed=0)
    _, reward, terminated, truncated, info = env.step(STOP)
    assert not terminated and not truncated
    assert reward == pytest.approx(0.1), "it follows where it stands, and comes no nearer"
    assert info["follows"] and info["faced"]
    assert info["person_distance"] == pytest.approx(1.2)
    _, reward, *_, info = env.step(FORWARD)
    # the place to be is 1 m behind the person, at 2.2 m; from 0.2 m before it to 0.05 m past it
    assert reward == pytest.approx(0.1 + 0.2 - 0.05)
    for _ in range(3):
        _, reward, terminated, _, info = env.step(FORWARD)
        if terminated:
            break
    assert info["end"] == "touch" and not info["success"] and reward < -0.9
    with pytest.raises(SimError, match="over"):
        env.step(STOP)


def test_who_keeps_up_until_the_person_has_arrived_succeeds() -> None:
    """Three seconds after its end at 0.8 m/s, in sight and within three metres."""
    env = FollowNavEnv(FLAT, episodes=[_episode((3.0, 2.5), (3.4, 2.5))], sensors=(), agent=BODY)
    env.reset(seed=0)
    steps, terminated = 0, False
    while not terminated:
        *_, terminated, _, info = env.step(STOP)
        steps += 1
    assert info["end"] == "over" and info["success"]
    assert 3.0 + 0.4 / 0.8 <= steps * 0.2 <= 3.0 + 3.0


def test_a_back_turned_sees_nobody() -> None:
    env = FollowNavEnv(FLAT, episodes=[_episode((3.2, 2.5))], sensors=(), agent=BODY)
    env.reset(seed=0)
    faced = [env.step(LEFT)[4]["faced"] for _ in range(24)]  # 15° each, all the way round
    assert faced == [True] * 3 + [False] * 17 + [True] * 4


def test_many_are_as_each_alone() -> None:
    """Rewards, ends, infos and observations, bit for bit, over autoresets."""
    shared = {"sensors": ("ranges", "pose"), "max_steps": 40}
    env = FollowVectorEnv(5, FLAT, **shared)
    singles = [
        FollowNavEnv(FLAT, episodes=env.tasks.episodes, **shared, agent=BODY) for _ in range(5)
    ]
    _, infos = env.reset(seed=3)
    for i, single in enumerate(singles):
        single.reset(seed=3 + i)
    rng = np.random.default_rng(0)
    ends = set()
    for row in rng.choice(4, (130, 5), p=[0.1, 0.6, 0.15, 0.15]):
        observation, rewards, terminated, truncated, infos = env.step(row)
        for i, single in enumerate(singles):
            seen, reward, ended, cut, told = single.step(int(row[i]))
            assert (rewards[i], terminated[i], truncated[i]) == (reward, ended, cut)
            many = infos["final_info"] if ended or cut else infos
            for name in ("follows", "faced", "person_distance", "end", "success"):
                assert many[name][i] == told[name], name
            if ended or cut:
                ends.add(told["end"])
                assert infos["final_obs"][i]["pose"].tobytes() == seen["pose"].tobytes()
                seen, told = single.reset()
            assert infos["episode_id"][i] == told["episode_id"]
            for name, value in seen.items():
                assert np.array_equal(observation[name][i], value), name
    assert {"touch", "steps"} <= ends


def test_make_vec_gives_it() -> None:
    env = gymnasium.make_vec("gn0/FollowNav-v1", num_envs=3, sensors=("ranges",))
    observation, _ = env.reset(seed=1)
    assert observation in env.observation_space
    _, rewards, *_ = env.step(env.action_space.sample())
    assert rewards.shape == (3,)
    env.close()


def test_an_episode_must_say_whom() -> None:
    nobody = msgspec.structs.replace(
        _episode((3.2, 2.5)), mission=MissionFollow(goal=(3.2, 2.5), instruction="Go.", human="x")
    )
    for make in (FollowNavEnv, lambda *a, **k: FollowVectorEnv(2, *a, **k)):
        with pytest.raises(EpisodeError, match="whom to follow"):
            make(FLAT, episodes=[nobody], sensors=(), agent=BODY)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6))
def test_the_tally_counts_as_the_rules_do(seed: int) -> None:
    """Random tracks, judged by `count_step` of each agent alone."""
    rng = np.random.default_rng(seed)
    count, steps = 4, 60
    tally = FollowTally(count, 0.2, steps)
    start = np.zeros((count, 3))
    people = np.column_stack(
        [rng.uniform(1, 3, count), np.zeros(count), np.ones(count), np.zeros(count)]
    )
    targets = [FollowTarget(0, 1.5, 0.3)] * count
    tally.begin(np.arange(count), targets, start, people)
    counts, over = [FollowCount()] * count, [math.inf] * count
    going = [True] * count
    rules = msgspec.structs.replace(FOLLOW, max_steps=steps)
    for k in range(steps):
        people[:, 0] += rng.uniform(-0.1, 0.4, count)
        poses = start + rng.uniform(-0.5, 0.5, (count, 3))
        sight, hit = rng.random(count) < 0.8, rng.random(count) < 0.01
        arrived = np.full(count, k > 35) & (rng.random(count) < 0.5)
        step = tally.step(poses, people, sight=sight, hit=hit, arrived=arrived)
        for i in range(count):
            if not going[i]:
                continue
            dx, dy = people[i, :2] - poses[i, :2]
            bearing = math.degrees(math.atan2(dy, dx) - poses[i, 2])
            faced = bool(sight[i]) and abs(bearing) <= 45.0
            distance = math.hypot(dx, dy)
            if arrived[i]:
                over[i] = min(over[i], (k + 1) * 0.2)
            counts[i], end, success = count_step(
                counts[i], FollowSight(distance, faced, hit=bool(hit[i])), rules,
                step_seconds=0.2, over_at=over[i],
            )  # fmt: skip
            assert ENDS[tally.end[i]] == (end or "")
            assert bool(step.success[i]) == success
            assert bool(tally.follows[i]) == (faced and distance <= 3.0)
            going[i] = end is None
