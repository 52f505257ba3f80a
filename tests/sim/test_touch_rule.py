"""One rule of a touch: environments, batches, a run's judge and its counter agree on every walk."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from gn0.bench.company_watch import CompanyWatch, FollowReferee
from gn0.missions.episode import AgentSpec, Episode, MissionFollow
from gn0.missions.follow_rules import FOLLOW, FOLLOW_EVT, touched_person
from gn0.people.person import EpisodePerson
from gn0.scenes import build_example_scene
from gn0.sim import open_simulator
from gn0.sim.follow_env import FollowNavEnv
from gn0.sim.follow_vector import FollowVectorEnv

FLAT = build_example_scene()
BODY = AgentSpec(radius=0.25, step_seconds=0.2)
ACTIONS = 60


def _person(number: int, *path: tuple[float, float], **more: object) -> EpisodePerson:
    behaviour = "stand" if len(path) == 1 else "script"
    return EpisodePerson(
        number=number, identity=f"drawn:0:{number}", path=path, behaviour=behaviour, **more
    )


def _episode() -> Episode:
    people = (
        _person(5, (3.3, 2.5), (1.3, 2.5), speed=0.6, after="back"),
        _person(2, (1.3, 1.5), (3.3, 1.5), speed=1.4, after="back"),
        _person(9, (3.0, 2.0)),
    )
    mission = MissionFollow(goal=(1.3, 2.5), instruction="Follow.", human="", person=5)
    return Episode(
        id="e", scene_id=FLAT.id, mission=mission, start=(2.0, 2.1, 0.0),
        path=((2.0, 2.1), (1.3, 2.5)), people=people,
    )  # fmt: skip


@pytest.mark.parametrize(("by", "touched"), [("agent", 4), ("person", None)])
def test_a_touch_is_a_cut_by_the_agent(by: str, touched: int | None) -> None:
    cut = SimpleNamespace(number=4, by=by, tick=1)
    assert touched_person(cut) == touched
    assert touched_person(None) is None
    assert FOLLOW.touches(3.0, hit=True) and not FOLLOW.touches(0.3, hit=False)
    assert FOLLOW_EVT.touches(0.499, hit=False) and not FOLLOW_EVT.touches(0.5, hit=True)
    watch = CompanyWatch(SimpleNamespace(company=SimpleNamespace(places=np.zeros((1, 2)))))  # type: ignore[arg-type]
    watch(None, SimpleNamespace(info={"hit_person": cut}))  # type: ignore[arg-type]
    assert watch.touches == ([] if touched is None else [(0, 4)])


def test_a_person_that_walks_into_a_move_ends_no_environment() -> None:
    env = FollowVectorEnv(2, FLAT, episodes=[_episode()], sensors=(), agent=BODY)
    env.reset(seed=0)
    hit = env.batch.company.crowd.hit
    hit[:] = [[1, 0, 1], [1, 1, 1]]  # row of the person from 1, who came (agent, person), tick
    assert env.batch.company.hits(np.arange(2)).by.tolist() == ["agent", "person"]
    assert env.batch.company.touched().tolist() == [True, False]


def test_all_give_the_same_verdict_on_the_same_walk() -> None:
    """Many walks at random among people: the first touch, by five who judge."""
    episode = _episode()
    stream = np.random.default_rng(3)
    ends: set[str | None] = set()
    many = FollowVectorEnv(12, FLAT, episodes=[episode], sensors=(), agent=BODY)
    plans = stream.choice([1, 2, 3], (12, ACTIONS), p=[0.7, 0.15, 0.15])
    plans[0] = 2  # turns on the spot: people go round it
    many.reset(seed=0)
    told = np.full(12, -1)
    for k in range(ACTIONS):
        _, _, ended, _, infos = many.step(plans[:, k])
        last = infos["final_info"]["end"] if "final_info" in infos else np.full(12, "")
        told[(last == "touch") & ended & (told < 0)] = k
    for row, plan in enumerate(plans):
        env = FollowNavEnv(FLAT, episodes=[episode], sensors=(), agent=BODY)
        env.reset(seed=0)
        simulator = open_simulator(FLAT, "follower", sensors=[])
        watch = CompanyWatch(simulator)
        judge = FollowReferee(simulator, episode, FOLLOW, sight=FLAT.grid)
        for one in (watch, judge):
            one(simulator.reset(episode), None)
        taken = 0
        for action in plan.tolist():
            taken += 1
            *_, info = env.step(action)
            result = simulator.step(action)
            watch(result.observation, result)
            over = judge(result.observation, result)
            assert (info["end"] or None) == judge.end
            assert bool(watch.touches) == (judge.end == "touch")
            if over:
                break
        assert (told[row] == taken - 1) == (judge.end == "touch")
        ends.add(judge.end)
    assert ends == {"touch", None}
