"""People around agents on a device: what VectorEnv plays, to the bit; on the host emulation."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import gymnasium
import msgspec
import numpy as np
import pytest

from gn0.device.device import DeviceArray
from gn0.device.host import DeviceHost
from gn0.errors import EpisodeError, SimError
from gn0.maps.grid import OccupancyGrid
from gn0.missions.episode import AgentSpec, Episode, MissionFollow, MissionGoal
from gn0.people import person, reach, route
from gn0.people.person import EpisodePerson
from gn0.sim import device_people
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.device_plans import PlansDevice
from gn0.sim.vector import VectorEnv
from gn0.testing.scenes import build_map_scene

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
BODY = AgentSpec(radius=0.25, step_seconds=0.2)  # two ticks an action
WALK = [0.02, 0.7, 0.14, 0.14]  # STOP, FORWARD, LEFT, RIGHT
BY = {"": 0, "agent": 1, "person": 2}
SENSORS = ("ranges", "pose", "goal_vector")


def same(mine, theirs, what="") -> None:
    """Equal type and bytes."""
    mine = mine.numpy() if isinstance(mine, DeviceArray) else np.asarray(mine)
    theirs = np.asarray(theirs)
    if theirs.dtype == object:
        theirs = np.array([BY[value] for value in theirs.tolist()])
    assert mine.dtype == theirs.dtype, what
    np.testing.assert_array_equal(mine, theirs, err_msg=what)
    assert mine.tobytes() == theirs.tobytes(), what


TOLD = ("people", "hit_person", "hit_by", "hit_tick", "pose", "distance_to_goal")


def assert_same_told(env, mine, theirs) -> None:
    """Infos, and every column of everybody."""
    for name in TOLD:
        same(mine[name], theirs[name], name)


def assert_same_people(env, twin) -> None:
    crowd = twin.batch.company.crowd
    there = crowd.route >= 0
    same(env.simulator.company.read_state("real")[there], crowd.real[there])
    same(env.simulator.company.read_state("whole")[there], crowd.whole[there])


def build_pair(halls, count, device=None, **settings):
    scenes, episodes = halls
    settings = {"sensors": SENSORS, "agent": BODY, "max_steps": 80, "episodes": episodes} | settings
    env = VectorEnvDevice(count, scenes, device=device or DeviceHost(3), **settings)
    return env, VectorEnv(count, scenes, **settings)


def play(env, twin, rounds, seed=0, odds=WALK) -> dict[str, int]:
    """Step both; what there was to see."""
    rng = np.random.default_rng(seed)
    seen = {"agent": 0, "person": 0, "ended": 0}
    for _ in range(rounds):
        actions = rng.choice(4, env.num_envs, p=odds)
        mine, theirs = env.step(actions), twin.step(actions)
        for k, name in enumerate(("rewards", "terminated", "truncated"), 1):
            same(mine[k], theirs[k], name)
        for name, value in theirs[0].items():
            same(mine[0][name], value, name)
        assert_same_told(env, mine[4], theirs[4])
        assert_same_people(env, twin)
        ended = theirs[2] | theirs[3]
        final = mine[4]["final_info"]
        told = theirs[4]["final_info"] if ended.any() else {}
        for name in ("people", "hit_person", "hit_tick", "success") if told else ():
            same(final[name], told[name], f"final {name}")
        for i in np.flatnonzero(ended):
            assert final["hit_by"].numpy()[i] == BY[told["hit_by"][i]]
            for name in ("ranges", "goal_vector", "collided"):
                same(mine[4]["final_obs"][name].numpy()[i], theirs[4]["final_obs"][i][name], name)
        for by in (theirs[4]["hit_by"], *([told["hit_by"]] if told else [])):
            for who in by[by.astype(bool)]:
                seen[who] += 1
        seen["ended"] += int(ended.sum())
    return seen


def test_it_plays_people_as_the_vector_env_does(halls) -> None:
    """Hundreds of steps in both halls, with 0 to 5 people, over autoresets and resets of some."""
    env, twin = build_pair(halls, 40)
    assert_same_told(env, env.reset(seed=3)[1], twin.reset(seed=3)[1])
    seen = play(env, twin, 220)
    assert seen["agent"] > 100 and seen["ended"] > 100
    mask = np.arange(40) % 3 == 0
    options = {"reset_mask": mask}
    mine, theirs = env.reset(options=options)[1], twin.reset(options=options)[1]
    same(mine["people"].numpy()[mask], theirs["people"][mask])
    play(env, twin, 20, seed=1)


@pytest.mark.parametrize("sliding", [False, True])
def test_long_actions_and_bodies_that_slide(halls, sliding, monkeypatch) -> None:
    """Five ticks an action; an agent at a wall is cut by it, and by people as well."""
    body = AgentSpec(radius=0.2, sliding=sliding)
    env, twin = build_pair(halls, 24, agent=body)
    assert env.simulator.company.lanes == 8
    if sliding:  # as where there are many environments
        monkeypatch.setattr(device_people, "BLOCKS", 1)
        assert env.simulator.company.lanes == 16
    assert_same_told(env, env.reset(seed=5)[1], twin.reset(seed=5)[1])
    seen = play(env, twin, 60, odds=[0.01, 0.79, 0.1, 0.1])
    assert seen["agent"] > 40


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
    env, twin = build_pair((scenes, following), 4, max_steps=30)
    assert_same_told(env, env.reset(seed=1)[1], twin.reset(seed=1)[1])
    assert play(env, twin, 35, odds=[0.4, 0.4, 0.1, 0.1])["ended"] == 4, "at step 30 alone"


def test_saved_states_go_on_with_their_people(halls) -> None:
    """In the same places and in others, as if never left."""
    env, _ = build_pair(halls, 6)
    env.reset(seed=2)
    actions = np.random.default_rng(3).choice(4, (60, 6), p=WALK)

    def go_on(rows) -> list[bytes]:
        told = []
        for row in rows:
            seen, rewards, *_, infos = env.step(row)
            told.append(
                seen["ranges"].numpy().tobytes()
                + rewards.numpy().tobytes()
                + b"".join(infos[name].numpy().tobytes() for name in TOLD)
            )
        return told

    go_on(actions[:20])
    states = env.save_state()
    first = go_on(actions[20:])
    env.restore_state(states)
    assert go_on(actions[20:]) == first
    env.restore_state(states.join(states), rows=np.arange(6) + 6)
    assert go_on(actions[20:]) == first
    infos = env.restore_state(states)[1]
    before, poses = infos["people"].numpy(), infos["pose"].numpy()
    infos = env.restore_state(states, agents=[4, 1], rows=[1, 4])[1]
    assert infos["people"].numpy()[[4, 1]].tobytes() == before[[1, 4]].tobytes()
    assert infos["pose"].numpy()[[4, 1]].tobytes() == poses[[1, 4]].tobytes()


def test_more_people_may_come_later(halls) -> None:
    """Who is there stays as it was when an episode with more people is handed in."""
    scenes, episodes = halls
    few = [e for e in episodes if len(e.people) <= 2]
    env, twin = build_pair((scenes, few), 3, max_steps=500)
    env.reset(seed=0)
    twin.reset(seed=0)
    for number in (4, 5):  # three people, then five
        mask = np.arange(3) == number % 2
        options = {"episode": episodes[number], "reset_mask": mask}
        assert_same_people(env, twin)
        mine, theirs = env.reset(options=options)[1], twin.reset(options=options)[1]
        same(mine["people"].numpy()[mask], theirs["people"][mask])
        play(env, twin, 12, odds=[0.0, 0.8, 0.1, 0.1])


@pytest.fixture(scope="module")
def corridors():
    """Three widths of a corridor with a bay, and episodes in which six people meet there."""
    scenes, episodes = [], []
    for k, width in enumerate((18, 28, 40)):  # cells of 5 cm
        cells = np.ones((width + 44, 200), np.uint8)
        cells[2 : width + 2, 2:-2] = 0
        cells[width:-10, 90:120] = 0
        middle = (width + 4) * 0.025
        scenes.append(build_map_scene(OccupancyGrid(cells, 0.05, (0.0, 0.0)), f"corridor-{k}"))
        for seed in range(4):
            ends = (0.7, 9.2)
            people = [
                EpisodePerson(
                    number=n + 1, identity=f"drawn:0:{n + 1}", speed=0.5 + 0.1 * n,
                    path=((0.8 + 1.5 * n, middle), (ends[(n + seed) % 2 or n == 0], middle)),
                    after=("back", "end")[n % 2], seed=7 * seed + n,
                )
                for n in range(6)
            ]  # fmt: skip
            if seed == 1:
                people[3] = EpisodePerson(
                    number=4, identity="drawn:0:4", path=((5.3, middle),), behaviour="stand"
                )
            if seed == 2:  # two go round the bay, against each other
                ring = [(5.0, middle), (5.6, middle), (5.6, middle + 1.2), (5.0, middle + 1.2)]
                people[3:4] = [
                    EpisodePerson(
                        number=number, identity="drawn:0:9", path=(*path, path[0]), after="loop",
                        speed=0.7, seed=number,
                    )
                    for number, path in ((9, ring), (10, [ring[2], *ring[1::-1], ring[3]]))
                ]  # fmt: skip
            goal = MissionGoal(goal=(9.0, middle), object_id="", category="bed", instruction="Go.")
            episode = Episode(
                id=f"corridor-{k}-{seed}", scene_id=f"corridor-{k}", mission=goal,
                start=(4.55, middle, 0.0), path=((4.55, middle), goal.goal), people=tuple(people),
            )  # fmt: skip
            episodes.append(episode)
    return scenes, episodes


def test_who_blocks_each_other_resolves_it_as_on_the_cpu(corridors) -> None:
    """Waiting, going round, making room, turning back, lent claims: every branch, every column."""
    env, twin = build_pair(corridors, 24, max_steps=300, sensors=())
    options = {"episode": [k % 12 for k in range(24)]}
    env.reset(options=options)
    twin.reset(options=options)
    seen = dict.fromkeys(("round", "turned", "aside", "lent", "pressed", "squeezed"), 0)
    for row in np.random.default_rng(0).choice([1, 2, 3], (160, 24), p=[0.5, 0.25, 0.25]):
        env.step(row)
        twin.step(row)
        assert_same_people(env, twin)
        crowd = twin.batch.company.crowd
        whole = crowd.whole[crowd.route >= 0].T
        goes_round, turned = whole[reach.MODE] == reach.ROUND, whole[reach.TURNED]
        seen["round"] += goes_round.sum()
        seen["turned"] += turned.max()
        seen["aside"] += (whole[reach.ASIDE_LEFT] > 0).sum()
        seen["lent"] += (whole[reach.LENT_LEFT] > 0).sum()
        seen["pressed"] += (whole[reach.PRESSED] > 0).sum()
        seen["squeezed"] += (goes_round & (turned % 4 > 1)).sum()
    assert min(seen.values()) > 50, seen


@pytest.mark.slow
def test_no_thread_reads_what_another_may_be_writing(halls, corridors) -> None:
    for scenes in (halls, corridors):
        env, twin = build_pair(scenes, 37, device=DeviceHost(2, checked=True))
        env.reset(seed=1)
        twin.reset(seed=1)
        play(env, twin, 12)


def test_who_cannot_be_placed_is_refused_by_name(halls) -> None:
    episodes = halls[1]
    env, _ = build_pair(halls, 2)
    env.reset(seed=0)
    with pytest.raises(EpisodeError, match="small-1"):
        env.place("small-1", [[2.0, 0.6, 0.0]] * 2)
    with pytest.raises(EpisodeError, match="people"):
        env.place_uniform(0)
    with pytest.raises(EpisodeError, match="small-1"):
        PlansDevice(env, np.array([1]), np.array([[2.0, 0.6, 0.0]]))
    through = EpisodePerson(number=2, identity="drawn:0:1", path=((0.7, 3.0), (5.3, 3.0)))
    bad = msgspec.structs.replace(episodes[-1], id="bad", people=(through,))
    with pytest.raises(EpisodeError, match="wall"):
        env.reset(options={"episode": bad})
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(2, np.int64))


def test_states_before_people_do_not_join_those_after(halls) -> None:
    scenes, episodes = halls
    env, _ = build_pair((scenes, [e for e in episodes if not e.people]), 2)
    env.reset(seed=0)
    alone = env.save_state()
    env.reset(options={"episode": episodes[1]})
    with pytest.raises(SimError, match="before there were people"):
        alone.join(env.save_state())


def test_kernels_have_the_numbers_of_the_numba_code() -> None:
    """Every `#define` of a number that reach.py or route.py names, too."""
    folder = Path(device_people.__file__).parent / "kernels"
    parts = ("reach", "weigh", "detour", "tick")
    text = "".join((folder / f"{name}.cu").read_text() for name in parts)
    found = dict(re.findall(r"^#define (\w+) \(?(-?[\d.e-]+)\)?", text, re.M))
    known = vars(person) | vars(route) | vars(reach)
    both = {name: float(value) for name, value in found.items() if name in known}
    assert both == {name: known[name] for name in both}
    assert len(both) >= 33
    columns = re.findall(r"f\((\d+), (\w+), \w+\)", text)
    assert all(known[name.upper()] == int(number) for number, name in columns)
    assert len(columns) == reach.REALS + reach.WHOLES
    lists = re.findall(r"__constant__ (?:double|int) (\w+)\[\d+\] = \{([^}]*)\}", text)
    theirs = [reach.ROUND_COS, reach.ROUND_SIN, reach.ROUND_COS20, reach.ROUND_SIN20, reach.TURNS]
    assert [tuple(map(float, values.split(","))) for _, values in lists] == theirs
