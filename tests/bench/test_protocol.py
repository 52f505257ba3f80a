"""The protocol card says what was done, identities change when a result could, scenes load once."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from gn0.bench.protocol import code_version, config_hash, protocol_card
from gn0.bench.results import PolicyCard
from gn0.bench.runner import run_suite
from gn0.bench.schedule import Schedule
from gn0.missions.episode import Episode, MissionFollow
from gn0.suites.suite import Suite

pytestmark = pytest.mark.usefixtures("workers_here")


def card_of(suite: Suite, **fields: object) -> dict[str, str]:
    card = PolicyCard(**{"name": "p", "sensors": (), "privileged": False, **fields})  # type: ignore[arg-type]
    return dict(protocol_card(suite, card, "1.0+abc"))


def test_the_card_tells_how_long_an_action_takes_where_it_is_not_half_a_second(
    flats_suite: Suite,
) -> None:
    """Such runs are not compared with others: their rows of actions differ."""
    quick = msgspec.structs.replace(flats_suite.about.agent, step_seconds=0.2)
    about = msgspec.structs.replace(flats_suite.about, agent=quick)
    other = card_of(Suite(flats_suite.folder, about, flats_suite.episodes))["actions"]
    assert other == card_of(flats_suite)["actions"] + ", 0.2 s an action"


def test_the_card_tells_what_counts_where_somebody_is_followed(flats_suite: Suite) -> None:
    assert "following" not in card_of(flats_suite)
    first, *others = flats_suite.episodes
    mission = MissionFollow(goal=(1.0, 1.0), instruction="Follow the man.", human="drawn:0:1")
    episodes = (msgspec.structs.replace(first, mission=mission), *others)
    told = card_of(Suite(flats_suite.folder, flats_suite.about, episodes))["following"]
    assert told.startswith(f"1 of {len(episodes)} episodes") and "within 3 m" in told
    assert "0.4% to 30%" in told and "STOP stands still" in told and "20 steps beyond 4 m" in told
    about = msgspec.structs.replace(flats_suite.about, profile="evt")
    evt = card_of(Suite(flats_suite.folder, about, episodes))["following"]
    assert "more than 3000 pixels" in evt and "below 0.5 m" in evt and "STOP ends" in evt


def test_the_card_of_a_run_of_few_episodes_counts_those(flats_suite: Suite, tmp_path: Path) -> None:
    mission = MissionFollow(goal=(1.0, 1.0), instruction="Follow the man.", human="drawn:0:1")
    alike = [msgspec.structs.replace(e, mission=mission) for e in flats_suite.episodes]
    suite = Suite(flats_suite.folder, flats_suite.about, tuple(alike))
    card = PolicyCard(name="p", sensors=(), privileged=False)
    told = dict(protocol_card(suite, card, "1.0", episodes=suite.episodes[:1]))
    assert told["following"].startswith("1 of 1 episode:")
    assert told["suite"].endswith(f"; of its {len(alike)} episodes the first 1, by id")
    whole = dict(protocol_card(suite, card, "1.0", episodes=suite.episodes))
    assert whole == dict(protocol_card(suite, card, "1.0"))
    assert "by id" not in whole["suite"]
    summary = run_suite(flats_suite, "straight", tmp_path, max_episodes=2)
    assert dict(summary.protocol)["suite"].endswith("the first 2, by id")


def test_the_card_tells_an_oracle_from_a_robot(flats_suite: Suite) -> None:
    oracle = card_of(flats_suite, privileged=True)["the policy sees"]
    told = card_of(flats_suite, sensors=("goal_vector",))["the policy sees"]
    robot = card_of(flats_suite, sensors=("depth", "rgb"))["the policy sees"]
    blind = card_of(flats_suite)["the policy sees"]
    assert "an oracle" in oracle and "where the goal is" in told
    assert robot == "depth, rgb" and blind.startswith("nothing but the instruction")


def test_the_card_follows_the_suites_settings(flats_suite: Suite) -> None:
    card = card_of(flats_suite)
    assert card["step limit"].startswith("60 steps") and "0.2 m" in card["agent"]
    assert "480×360" in card["camera"] and "vfov 70.00°" in card["camera"]
    assert "walking distance" in card["navigation error"]
    about = msgspec.structs.replace(flats_suite.about, profile="paper", success_radius=1.5)
    paper = card_of(Suite(flats_suite.folder, about, flats_suite.episodes))
    assert "straight distance" in paper["navigation error"] and "< 1.5 m" in paper["success"]


def test_a_real_run_writes_the_card_of_its_own_policy(flats_suite: Suite, tmp_path: Path) -> None:
    summary = run_suite(flats_suite, "straight", tmp_path, max_episodes=1)
    card = dict(summary.protocol)
    assert card["policy"] == "straight" and "goal_vector" in card["the policy sees"]
    assert card["code"] == f"gn0 {code_version()}" and flats_suite.hash in card["suite"]


def test_the_identity_changes_with_whatever_decides_a_result(flats_suite: Suite) -> None:
    base = config_hash(flats_suite, "random", {}, "cpu", 12)
    assert config_hash(flats_suite, "random", {}, "cpu", 12) == base
    others = {
        config_hash(flats_suite, "straight", {}, "cpu", 12),
        config_hash(flats_suite, "random", {"seed": 1}, "cpu", 12),
        config_hash(flats_suite, "random", {}, "cuda", 12),
        config_hash(flats_suite, "random", {}, "cpu", 11),
        config_hash(flats_suite, "random", {}, "cpu", 12, bank="0" * 32),
        config_hash(
            Suite(flats_suite.folder, flats_suite.about, flats_suite.episodes[1:]),
            "random", {}, "cpu", 12,
        ),
    }  # fmt: skip
    assert len(others) == 6 and base not in others


def episodes_in(*scenes: str) -> list[Episode]:
    return [
        msgspec.convert(
            {
                "id": f"{scene}_{i}", "scene_id": scene, "start": (0, 0, 0), "path": [],
                "mission": {"type": "goal", "goal": (0, 0), "object_id": "o", "category": "c",
                            "instruction": "Go."},
            },
            Episode,
        )
        for scene in scenes
        for i in range(10)
    ]  # fmt: skip


def test_each_worker_loads_a_scene_once_while_there_is_work_in_it() -> None:
    for seed in (None, 3):
        schedule = Schedule(episodes_in("a", "b", "c", "d"), seed)
        scene = {0: "", 1: ""}
        loads: list[str] = []
        ran: list[str] = []
        while len(schedule):
            for worker in (0, 1):
                episode = schedule.next(scene[worker], [scene[1 - worker]])
                if episode is None:
                    continue
                if episode.scene_id != scene[worker]:
                    loads.append(episode.scene_id)
                scene[worker] = episode.scene_id
                ran.append(episode.id)
        assert len(ran) == len(set(ran)) == 40
        assert sorted(loads) == ["a", "b", "c", "d"], "nobody loads what another works on"


def test_the_last_scene_is_shared_and_a_broken_episode_comes_back_first() -> None:
    schedule = Schedule(episodes_in("a"))
    first = schedule.next("", [])
    assert first is not None and schedule.next("", ["a"]) is not None
    schedule.put_back(first)
    assert schedule.next("a", []) is first
    assert len(schedule) == 8
