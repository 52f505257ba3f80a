"""Follow missions: the reference replays to the bit, keeps its rules, and the words fit one."""

from __future__ import annotations

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from gn0.avatars.likeness import Sight, words_apart
from gn0.data import follow_missions
from gn0.data.follow_missions import FollowMission, FollowMissions, make_follow_missions
from gn0.data.follow_reference import FollowTracker, follow_task, person_track, with_reference
from gn0.errors import EpisodeError, FormatError, PlanError
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode, MissionFollow, check_episode
from gn0.missions.episode_files import load_episodes, save_episodes
from gn0.missions.follow_rules import FOLLOW
from gn0.missions.generate.follow_settings import FOLLOW_REASONS, FollowSettings
from gn0.missions.generate.follow_tracks import load_tracks, tracks_table
from gn0.missions.generate.path_pool import save_table
from gn0.people.identities import find_identity
from gn0.sim.simulator import Simulator
from gn0.sim.state import Action
from gn0_trials.follow_hall import BODY, SETTINGS, build_hall, hall_paths

HALL = build_hall()
NAVIGATION = NavigationMap(HALL.grid, BODY.radius)
PATHS = hall_paths(HALL).records


def make(seed: int, paths: int = len(PATHS), **follow: object) -> FollowMissions:
    settings = msgspec.structs.replace(SETTINGS, follow=FollowSettings(**follow))  # type: ignore[arg-type]
    return make_follow_missions(HALL, NAVIGATION, PATHS[:paths], settings, seed, agent=BODY)


@pytest.fixture(scope="module")
def made() -> FollowMissions:
    return make(0)


@pytest.fixture(scope="module")
def missions(made: FollowMissions) -> tuple[FollowMission, ...]:
    assert len(made.missions) >= 3
    return made.missions


def test_the_reference_replays_to_the_bit_in_the_simulator(
    missions: tuple[FollowMission, ...],
) -> None:
    for mission in missions:
        episode, track = mission.episode, mission.track
        simulator = Simulator(HALL, navigation=NAVIGATION, agent=BODY, max_steps=300)
        simulator.reset(episode)
        poses, places = [simulator.pose], [simulator.company.places[0].copy()]
        for code in episode.mission.reference_actions:  # type: ignore[union-attr]
            result = simulator.step(code)
            assert not result.terminated and result.info["hit_person"] is None
            poses.append(simulator.pose)
            places.append(simulator.company.places[0].copy())
        assert np.array_equal(np.array(poses), track.poses)
        assert np.array_equal(np.array(places), track.places)
        assert track.time[-1] == pytest.approx(0.2 * len(track.actions))
        alone = person_track(episode.people[0], track.time[-1])  # nobody held the person up
        assert np.array_equal(alone.places[::2], track.places)


def test_references_keep_their_rules(missions: tuple[FollowMission, ...]) -> None:
    for mission in missions:
        episode, track = mission.episode, mission.track
        away = track.places - track.poses[:, :2]
        gaps = np.hypot(*away.T)[1:]
        bearing = np.arctan2(away[:, 1], away[:, 0]) - track.poses[:, 2]
        off = np.degrees(np.abs((bearing + math.pi) % (2 * math.pi) - math.pi))[1:]
        bad = (gaps < 0.8) | (gaps > 3.5) | (off > 45.0)
        assert bad.mean() <= 0.10 and track.violations >= bad.sum()
        assert track.violations <= 0.10 * len(track.actions)
        seconds = episode.mission.seconds  # type: ignore[union-attr]
        assert 12 <= seconds <= 60
        assert len(track.actions) == min(math.ceil(round((seconds + 3) / 0.2, 6)), 300)
        start, spot = episode.start, episode.people[0].spot
        assert math.dist(start[:2], spot) >= 0.8
        assert math.atan2(spot[1] - start[1], spot[0] - start[0]) == pytest.approx(start[2])
        assert episode.path[0] == start[:2] and episode.path[-1] == tuple(track.poses[-1, :2])
        assert episode.goal == episode.people[0].path[-1]


def test_others_stay_away_and_look_as_their_level_says() -> None:
    for level in ("distractors", "ambiguous"):
        for mission in make(3, 3, levels=(level,)).missions:
            episode = mission.episode
            assert episode.mission.level == level  # type: ignore[union-attr]
            words = [find_identity(person.identity).words() for person in episode.people]
            for other in words[1:]:
                apart = words_apart(words[0], other, Sight())
                assert len(apart) == 1 if level == "ambiguous" else len(apart) >= 3
            simulator = Simulator(HALL, navigation=NAVIGATION, agent=BODY, max_steps=300)
            simulator.reset(episode)
            for code in episode.mission.reference_actions:  # type: ignore[union-attr]
                simulator.step(code)
                places = simulator.company.places
                if len(places) > 1:
                    assert np.hypot(*(places[1:] - places[0]).T).min() >= 0.6
            said = msgspec.json.decode(mission.track.said)
            assert said["sex"] in ("woman", "man", "person")
            assert mission.track.decides in ("looks", "first view")


def test_the_same_seed_gives_the_same_missions(made: FollowMissions) -> None:
    again = make(0, 2)
    few = [m for m in made.missions if m.episode.path_id in {p.path_id for p in PATHS[:2]}]
    assert [m.episode for m in again.missions] == [m.episode for m in few]
    assert [m.track for m in again.missions] == [m.track for m in few]
    assert make(1, 1).missions != again.missions[:1]


def test_whatever_falls_has_a_reason_that_is_explained(made: FollowMissions) -> None:
    assert made.candidates == len(made.missions) + sum(made.fell.values())
    assert set(made.fell) <= set(FOLLOW_REASONS)
    too_much = make(0, 2, least_length=40.0)
    assert not too_much.missions and too_much.fell == {"short": 2}
    near = make(0, 2, range=(0.1, 0.2), levels=("single",))
    assert not near.missions and set(near.fell) & {"too far too often", "too far too long"}


def test_files_keep_them_and_their_tracks(
    missions: tuple[FollowMission, ...], tmp_path: Path
) -> None:
    episodes = [mission.episode for mission in missions]
    save_episodes(tmp_path / "e.parquet", episodes, {"hall": HALL.grid})
    assert load_episodes(tmp_path / "e.parquet") == episodes
    rows = [mission.track for mission in missions]
    save_table(tmp_path / "t.parquet", tracks_table(rows))
    assert load_tracks(tmp_path / "t.parquet") == rows
    short = msgspec.structs.replace(rows[0], person_x=rows[0].person_x[1:])
    save_table(tmp_path / "s.parquet", tracks_table([short]))
    with pytest.raises(FormatError, match="person_x"):
        load_tracks(tmp_path / "s.parquet")


def test_vlnce_files_have_the_reference_as_their_ground_truth(
    missions: tuple[FollowMission, ...], tmp_path: Path
) -> None:
    from gn0.missions.sets.vlnce import ExporterVlnce

    exporter, episodes = ExporterVlnce(), [mission.episode for mission in missions]
    exporter.save(exporter.build(episodes, {}, "test"), tmp_path / "test.json.gz")
    read = exporter.load(tmp_path / "test.json.gz")
    assert not any("no ground truth" in note for note in read.notes)
    for task, episode in zip(read.tasks, episodes, strict=True):
        assert task.instruction == episode.instruction
        truth = read.native.truth[task.id]
        actions = episode.mission.actions  # type: ignore[union-attr]
        assert truth["actions"] == [int(code) for code in actions if code != "0"] + [0]
        assert truth["forward_steps"] == actions.count("1")
        places = [(x, -z) for x, _, z in truth["locations"]]  # x right, y up, z back
        assert np.allclose(places, episode.path, atol=1e-9)
        assert len(places) == 1 + actions.count("1")


def test_missions_of_before_are_read_and_say_nothing_more(tmp_path: Path) -> None:
    old = MissionFollow(goal=(3.0, 3.0), instruction="Follow me.", human="p0001")
    episode = Episode(id="a", scene_id="hall", mission=old, start=(2.0, 3.0, 0.0), path=())
    save_episodes(tmp_path / "e.parquet", [episode], {"hall": HALL.grid})
    import pyarrow.parquet as pq

    assert "follow" not in pq.read_schema(tmp_path / "e.parquet").names
    assert load_episodes(tmp_path / "e.parquet") == [episode] and episode.followed is None
    with pytest.raises(PlanError, match="whom to follow"):
        follow_task(episode)


def test_a_mission_without_meaning_is_refused(missions: tuple[FollowMission, ...]) -> None:
    episode = missions[0].episode
    mission = episode.mission
    for field, value in (
        ("person", 17), ("category", "dance"), ("level", "crowd"), ("distance", -1.0),
        ("lateral", 9.0), ("seconds", math.nan), ("actions", "0124"),
    ):  # fmt: skip
        with pytest.raises(EpisodeError, match=field):
            msgspec.structs.replace(mission, **{field: value})
    missing = msgspec.structs.replace(mission, person=16)
    with pytest.raises(EpisodeError, match="person 16 is to be followed"):
        check_episode(msgspec.structs.replace(episode, mission=missing))


def test_stop_stands_still_where_a_person_is_followed(
    missions: tuple[FollowMission, ...],
) -> None:
    simulator = Simulator(HALL, navigation=NAVIGATION, agent=BODY, max_steps=300)
    simulator.reset(missions[0].episode)
    pose, place = simulator.pose, simulator.company.places[0].copy()
    for _ in range(10):
        result = simulator.step(Action.STOP)
        assert not result.terminated and simulator.pose == pose
    assert simulator.time == pytest.approx(2.0)
    assert math.dist(place, simulator.company.places[0]) > 0.3


def test_a_reference_is_refused_for_the_reason_that_it_fell_for(
    missions: tuple[FollowMission, ...],
) -> None:
    episode = missions[0].episode
    settings = FollowSettings()
    tracker = FollowTracker(HALL, NAVIGATION, settings, FOLLOW)
    found, reason = tracker.track(episode)
    assert found is not None and reason == ""
    assert with_reference(episode, found) == episode
    again = tracker.replay(episode)
    assert np.array_equal(again.poses, found.poses) and np.array_equal(again.people, found.people)
    assert np.array_equal(again.violations, found.violations) and not again.touched
    for wrong, said in (
        ({"range": (0.8, 0.9)}, "too far"),
        ({"range": (3.0, 3.5)}, "too near"),
        ({"off_axis": 0.01, "violations": 0.0}, "off axis"),
    ):
        strict = FollowTracker(HALL, NAVIGATION, msgspec.structs.replace(settings, **wrong))
        found, reason = strict.track(episode)
        assert found is None and reason.startswith(said)


@pytest.mark.parametrize("level", ["distractors", "ambiguous"])
def test_a_count_asked_for_is_kept(level: str) -> None:
    found = make(1, 1, levels=(level,), count=5)
    assert found.missions
    assert {len(mission.episode.people) for mission in found.missions} == {5}
    full = make(1, 1, levels=(level,), count=8, others=5.0, attempts=1)
    assert not full.missions and sum(full.fell.values()) == 1


def test_a_unit_of_work_is_found_by_its_name() -> None:
    from gn0.suites import generation

    module, name = generation._FOLLOW_UNIT.split(":")
    assert module == follow_missions.__name__ and hasattr(follow_missions, name)
