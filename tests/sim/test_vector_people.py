"""VectorEnv among people: what a `Simulator` of each episode plays, to the bit."""

from __future__ import annotations

import msgspec
import numba
import numpy as np
import pytest

from gn0.avatars import AvatarBank, generate_bank
from gn0.errors import EpisodeError
from gn0.missions.episode import AgentSpec, Episode, MissionFollow, MissionGoal
from gn0.people.person import EpisodePerson
from gn0.render import Camera
from gn0.scenes import build_example_scene
from gn0.sim import batch_people, batch_people_kernels
from gn0.sim.continuous import read_action
from gn0.sim.env import GoalNavEnv
from gn0.sim.open import open_simulator
from gn0.sim.presets import find_preset
from gn0.sim.vector import VectorEnv

BODY = AgentSpec(radius=0.25, step_seconds=0.2)  # two ticks an action
WALK = [0.02, 0.7, 0.14, 0.14]  # STOP, FORWARD, LEFT, RIGHT


def _to_go(twin) -> float:
    """Geodesic distance to the goal [m]."""
    return twin.navigation.geodesic(twin.episode.destination).distance_at(*twin.pose[:2])


def _compare(env, twins, episodes, actions, as_one) -> dict[str, int]:
    """Step an environment and a `Simulator` for each of its agents; what there was to see."""
    by_id = {e.id: e for e in episodes}
    _, infos = env.reset(seed=3)
    seen = {"agent": 0, "person": 0, "ended": 0}

    def begin(i: int):
        twin = twins[infos["scene_id"][i]]
        twin.reset(by_id[infos["episode_id"][i]])
        return twin, twin.save_state()

    states = [begin(i) for i in range(env.num_envs)]
    for row in actions:
        observation, rewards, terminated, truncated, infos = env.step(row)
        for i, (twin, state) in enumerate(states):
            twin.restore_state(state)
            before = _to_go(twin)
            result = twin.step(as_one(row[i]))
            after = _to_go(twin)
            ended = result.terminated or result.truncated
            assert (terminated[i], truncated[i]) == (result.terminated, result.truncated)
            told = infos["final_info"] if ended else infos
            found = infos["final_obs"][i] if ended else {k: v[i] for k, v in observation.items()}
            assert tuple(told["pose"][i]) == twin.pose
            assert found["collided"] == result.collided
            assert found["ranges"].tobytes() == result.observation.ranges.tobytes()
            assert rewards[i] == before - after - 0.01 + 2.5 * told["success"][i]
            company, count = twin.company, len(twin.company)
            want = np.hstack([company.places, company.faces])
            assert told["people"][i, :count].tobytes() == want.tobytes()
            assert np.isnan(told["people"][i, count:]).all()
            hit = company.hit
            assert (told["hit_person"][i], told["hit_by"][i], told["hit_tick"][i]) == (
                (0, "", 0) if hit is None else (hit.number, hit.by, hit.tick)
            )
            if not ended and count:
                mine = env.batch.company.state_of(i)
                assert mine.real.tobytes() == company.state.real.tobytes()
                assert mine.whole.tobytes() == company.state.whole.tobytes()
            if hit is not None:
                seen[hit.by] += 1
            seen["ended"] += ended
            states[i] = begin(i) if ended else (twin, twin.save_state())
    return seen


def _twins(scenes):
    return {s.id: open_simulator(s, sensors=["ranges"], agent=BODY, max_steps=80) for s in scenes}


def test_it_plays_people_as_simulators_do(halls) -> None:
    """Poses, people, hits, ranges, rewards and ends over both halls, autoresets included."""
    scenes, episodes = halls
    env = VectorEnv(12, scenes, episodes=episodes, sensors=("ranges",), agent=BODY, max_steps=80)
    actions = np.random.default_rng(0).choice(4, (160, 12), p=WALK)
    seen = _compare(env, _twins(scenes), episodes, actions, int)
    assert seen["agent"] > 20 and seen["ended"] > 20


def test_continuous_actions_among_people_are_the_simulator_s(halls) -> None:
    """Short strides arrive before the action is over, people go on."""
    scenes, episodes = halls
    env = VectorEnv(
        6, scenes, episodes=episodes, sensors=("ranges",), agent=BODY, max_steps=80,
        action_space="continuous",
    )  # fmt: skip
    rng = np.random.default_rng(1)
    actions = rng.uniform(-1, 1, (100, 6, 4)).astype(np.float32)
    actions[..., 0] = np.abs(actions[..., 0])
    actions[..., 3] = np.where(rng.random((100, 6)) < 0.02, 1.0, 0.0)
    seen = _compare(env, _twins(scenes), episodes, actions, lambda row: read_action(row, BODY))
    assert seen["ended"]


def test_stop_stands_still_where_somebody_is_followed(halls) -> None:
    scenes, episodes = halls
    following = [
        msgspec.structs.replace(
            e,
            mission=MissionFollow(
                goal=e.goal, instruction="Follow.", human="x", person=e.people[0].number
            ),
        )
        for e in episodes
        if e.people
    ]
    env = VectorEnv(4, scenes, episodes=following, sensors=("ranges",), agent=BODY, max_steps=80)
    actions = np.random.default_rng(4).choice(4, (90, 4), p=[0.4, 0.4, 0.1, 0.1])
    assert _compare(env, _twins(scenes), following, actions, int)["ended"] == 4, "at step 80 alone"


def test_many_are_the_same_on_any_threads_in_any_order(halls, monkeypatch) -> None:
    """Parallel or serial, one thread or all, environments turned round: the same bytes."""
    scenes, episodes = halls
    count = 160
    actions = np.random.default_rng(2).choice(4, (30, count), p=WALK)

    def play(order, threads: int, parallel: bool):
        least = 1 if parallel else count + 1
        monkeypatch.setattr(batch_people_kernels, "PARALLEL_FROM", least)
        env = VectorEnv(count, scenes, episodes=episodes, sensors=(), agent=BODY, max_steps=20)
        before = numba.get_num_threads()
        numba.set_num_threads(min(threads, before))
        try:
            env.reset(seed=[int(k) for k in order])
            for row in actions:
                *_, infos = env.step(row[order])
        finally:
            numba.set_num_threads(before)
        back = np.argsort(order)
        names = ("pose", "people", "hit_person", "hit_tick", "distance_to_goal")
        return [infos[name][back].tobytes() for name in names]

    there, turned = np.arange(count), np.arange(count)[::-1]
    first = play(there, 1, False)
    assert play(turned, 4, True) == first
    assert play(there, 1, True) == first


def test_routes_that_are_dropped_are_packed_again(halls, monkeypatch) -> None:
    """Little memory for routes changes nothing."""
    scenes, episodes = halls

    def play() -> bytes:
        env = VectorEnv(7, scenes, episodes=episodes, sensors=(), agent=BODY, max_steps=9)
        env.reset(seed=5)
        for _ in range(40):
            *_, infos = env.step(np.ones(7, np.int64))
        return infos["people"].tobytes() + infos["pose"].tobytes()

    plenty = play()
    tight = batch_people.CompanyBatch.__init__.__defaults__[0], 0
    monkeypatch.setattr(batch_people.CompanyBatch.__init__, "__defaults__", tight)
    assert play() == plenty


def test_where_nobody_is_nothing_is_told_of_people(halls) -> None:
    scenes, episodes = halls
    alone = [e for e in episodes if not e.people]
    env = VectorEnv(2, scenes, episodes=alone, sensors=(), agent=BODY)
    _, infos = env.reset(seed=0)
    assert "people" not in infos and not env.batch.company


def test_a_path_through_a_wall_is_refused_and_nobody_moves(halls) -> None:
    scenes, episodes = halls
    person = EpisodePerson(
        number=2, identity="drawn:0:1", path=((0.7, 3.0), (5.3, 3.0))
    )  # through the pillar
    bad = msgspec.structs.replace(episodes[-1], id="bad", people=(person,))
    env = VectorEnv(2, scenes, episodes=episodes, sensors=(), agent=BODY)
    _, infos = env.reset(seed=0)
    with pytest.raises(EpisodeError, match="wall"):
        env.reset(options={"episode": bad})
    assert env.step(np.zeros(2, int))[4]["pose"].shape == infos["pose"].shape


FLAT = build_example_scene()
SMALL = Camera.from_vfov(64, 48, 70.0)
EYES = msgspec.structs.replace(find_preset("gn_bench"), agent=BODY, rgb=SMALL, depth=SMALL)


def test_pictures_show_people_as_a_simulator_s(tmp_path, monkeypatch) -> None:
    """Colour, depth and who is who, while people move and agents stand, in groups of calls."""
    generate_bank(tmp_path, count=1, seed=1, density=0.05)
    bank = AvatarBank(tmp_path)
    names = sorted(bank.names)
    goal = MissionGoal(goal=(6.0, 2.5), object_id="", category="bed", instruction="Go.")
    walker = EpisodePerson(number=7, identity=names[0], path=((3.2, 2.2), (3.2, 2.9)), after="back")
    other = EpisodePerson(number=2, identity=names[0], path=((4.2, 2.4),), behaviour="stand")
    made = [
        Episode(
            id=name, scene_id=FLAT.id, mission=goal, start=(2.0, 2.5, yaw),
            path=((2.0, 2.5), goal.goal), people=people,
        )
        for name, yaw, people in (("two", 0.0, (walker, other)), ("one", 0.2, (walker,)),
                                  ("none", 0.1, ()))
    ]  # fmt: skip
    monkeypatch.setattr("gn0.sim.vector.find_preset", lambda *_, **__: EYES)
    monkeypatch.setattr("gn0.sim.batch_eyes.CLOUDS_AT_ONCE", 2)
    sensors = ("rgb", "depth", "who", "people_seen")
    env = VectorEnv(3, FLAT, episodes=made, sensors=sensors, agent=BODY, max_steps=4, bank=bank)
    twin = open_simulator(FLAT, EYES, sensors=sensors, bank=bank, max_steps=4)
    observation, infos = env.reset(seed=0, options={"episode": ["two", "one", "none"]})
    states = []
    for episode in made:
        twin.reset(episode)
        states.append(twin.save_state())
    shown = set()
    for action in (0, 2, 1, 2):  # STOP is not taken: it would end the episode
        codes = np.full(3, action or 3)
        before = observation
        observation, _, _, truncated, infos = env.step(codes)
        for i in range(3):
            twin.restore_state(states[i])
            result = twin.step(int(codes[i]))
            states[i] = twin.save_state()
            found = (
                infos["final_obs"][i] if truncated[i] else {k: v[i] for k, v in observation.items()}
            )
            for name in sensors:
                want = result.observation.read(name)
                assert np.asarray(found[name]).tobytes() == np.asarray(want).tobytes(), name
            shown |= set(np.unique(found["who"]).tolist())
        assert not np.array_equal(before["rgb"][0], observation["rgb"][0])
    assert shown == {0, 2, 7}


def test_the_maps_that_agents_make_let_go_of_people_as_alone(tmp_path) -> None:
    """Somebody walks through the view and out of it: the map's clock is each agent's own."""
    generate_bank(tmp_path, count=1, seed=1, density=0.02)
    flat = build_example_scene()
    passer = EpisodePerson(
        number=1, identity="p0000", path=((3.1, 2.3), (3.1, 1.4), (1.4, 1.4)), speed=1.2
    )
    goal = MissionGoal(goal=(6.0, 2.5), object_id="", category="bed", instruction="Go.")
    episode = Episode(
        id="e", scene_id=flat.id, mission=goal, start=(1.6, 2.5, 0.0),
        path=((1.6, 2.5), goal.goal), people=(passer,),
    )  # fmt: skip
    told = {
        "episodes": [episode], "sensors": ("occupancy",), "map_mode": "explored",
        "preset": "tiny_128", "agent": BODY,
    }  # fmt: skip
    env, twin = VectorEnv(2, flat, bank=tmp_path, **told), GoalNavEnv(flat, bank=tmp_path, **told)
    many, _ = env.reset(seed=0)
    one, _ = twin.reset(seed=0)
    met = one["occupancy"].copy()
    for k in range(45):
        action = 2 + k % 2
        many, *_ = env.step(np.array([action, action]))
        one, *_ = twin.step(action)
        for row in many["occupancy"]:
            assert row.tobytes() == one["occupancy"].tobytes()
    assert (met != one["occupancy"]).any()
