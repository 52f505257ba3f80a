"""One rule of a touch: environments, batches, a run's judge and its counter agree on every walk."""

from __future__ import annotations

from types import SimpleNamespace

import msgspec
import numpy as np
import pytest

from gn0.bench.company_watch import CompanyWatch, FollowReferee
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode, MissionFollow
from gn0.missions.follow_rules import FOLLOW, FOLLOW_EVT, touched_person
from gn0.people.crowd import CrowdState
from gn0.people.person import EpisodePerson
from gn0.people.reach import X0, Y0, X, Y
from gn0.scenes import build_example_scene
from gn0.sim import open_simulator
from gn0.sim import people as sim_people
from gn0.sim.follow_env import FollowNavEnv
from gn0.sim.follow_vector import FollowVectorEnv
from gn0.sim.people import Company

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


def test_no_cut_is_a_person_s_doing_however_quick_they_are() -> None:
    """Each may use half of a gap, so of two who would touch the agent has done more; or stood."""
    quick = tuple(
        msgspec.structs.replace(one, speed=1.6) if len(one.path) > 1 else one
        for one in _episode().people
    )
    simulator = open_simulator(FLAT, "follower", sensors=[], max_steps=1000)
    stream, cuts, stood = np.random.default_rng(1), 0, 0
    for _ in range(5):
        simulator.reset(msgspec.structs.replace(_episode(), people=quick))
        for action in stream.choice(4, 120, p=[0.2, 0.5, 0.15, 0.15]).tolist():
            cut = simulator.step(action).info["hit_person"]
            away = np.hypot(*(simulator.company.places - simulator.pose[:2]).T).min()
            assert away >= 2 * 0.25 - 1e-9
            stood += action != 1 and away < 0.6
            if action != 1:
                assert cut is None  # nobody walks into who stands
            elif cut is not None:
                assert cut.by == "agent"
                cuts += 1
    assert cuts > 50 and stood > 50


@pytest.mark.parametrize(("step", "by"), [(0.0, "agent"), (0.03, "agent"), (0.2, "person")])
def test_the_record_says_who_moved_more(
    step: float, by: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Somebody of other rules than ours, who walks on whoever is there."""
    company = Company(NavigationMap(FLAT.grid, BODY.radius), BODY)
    company.begin(msgspec.structs.replace(_episode(), people=(_person(9, (2.65, 2.1)),)))

    def walk_on(state: CrowdState, *_: object, **more: object) -> None:
        row = state.real[0, 0]
        row[[X0, Y0]] = row[[X, Y]]
        row[X] -= step

    monkeypatch.setattr(sim_people, "step_crowd", walk_on)
    company.move(2.0, 2.1, 2.25, 2.1)  # two ticks of 0.125 m; 0.15 m are left between them
    assert company.hit is not None
    assert (company.hit.number, company.hit.by) == (9, by)
    assert company.hit.tick == (1 if step > 0.02 else 2)
    assert touched_person(company.hit) == (9 if by == "agent" else None)
