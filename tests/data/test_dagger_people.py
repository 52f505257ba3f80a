"""DAgger among people: labels for where people go next, ends by the rules, the same bytes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from gn0.data.collect import build_dagger, describe_summary, sum_up
from gn0.data.dagger import collect_visited
from gn0.data.dagger_follow import FollowExpert
from gn0.data.dataset import open_dataset
from gn0.data.expert_labels import EXACT
from gn0.data.sample_table import EpisodeRows
from gn0.data.settings import BuildSettings, DaggerSettings, PictureSettings
from gn0.errors import PlanError
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode, MissionFollow, MissionGoal
from gn0.missions.generate.follow_settings import FollowSettings
from gn0.people.person import EpisodePerson
from gn0.people.walk import walk_alone
from gn0.plugins import build_plugin
from gn0.scenes.folder import save_scene
from gn0.sim.simulator import Simulator
from gn0.suites.generation import generate_missions
from gn0.suites.suite import Suite, load_suite
from gn0_trials.follow_hall import BODY, SETTINGS, build_hall

pytestmark = pytest.mark.usefixtures("workers_here")
STEP = 0.2  # s
ROOM = 0.25 + 0.25  # m: discs of the agent and of a person


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Suite:
    """Missions to follow somebody in one hall."""
    root = tmp_path_factory.mktemp("follow")
    save_scene(build_hall(), root / "hall")
    follow = FollowSettings(
        levels=("single", "distractors"),
        seconds=(8.0, 14.0),
        cruise=1.0,
        turn=0.0,
        least_length=5.0,
    )
    few = msgspec.structs.replace(SETTINGS, per_scene=2, follow=follow)
    generate_missions([root / "hall"], root / "suite", few, seed=1, name="trial")
    return load_suite(root / "suite")


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    hall = build_hall()
    return Simulator(hall, navigation=NavigationMap(hall.grid, BODY.radius), agent=BODY)


def collect(simulator: Simulator, policy: str, episode: Episode, **other: object) -> EpisodeRows:
    asked = DaggerSettings(**{"policy": policy, "halting": "none", **other})  # type: ignore[arg-type]
    return collect_visited(simulator, build_plugin("policy", policy, {}), episode, asked, EXACT)


@pytest.fixture(scope="module")
def expert(simulator: Simulator, suite: Suite) -> list[EpisodeRows]:
    """The expert alone in each mission."""
    return [collect(simulator, "always_stop", episode, beta=1.0) for episode in suite.episodes]


def crossing() -> Episode:
    """To a goal at the end of a corridor, which somebody walks to and fro."""
    person = EpisodePerson(
        number=1, identity="drawn:0:1", path=((10.5, 3.5), (7.0, 3.5)), after="back", speed=0.6
    )
    return Episode(
        id="crossing",
        scene_id="hall",
        mission=MissionGoal(goal=(10.2, 6.0), object_id="", category="", instruction="Go there."),
        start=(4.0, 3.5, 0.0),
        path=((4.0, 3.5), (10.2, 3.5), (10.2, 6.0)),
        agent=BODY,
        people=(person,),
    )


def windows(actions: np.ndarray, length: int = 6) -> np.ndarray:
    rest = np.r_[actions, np.zeros(length, np.int8)]
    return np.lib.stride_tricks.sliding_window_view(rest, length)[: len(actions)]


def test_the_expert_alone_walks_the_reference_and_labels_say_what_it_does_next(
    expert: list[EpisodeRows], suite: Suite
) -> None:
    for episode, rows in zip(suite.episodes, expert, strict=True):
        assert isinstance(episode.mission, MissionFollow)
        assert "".join(map(str, rows.executed.tolist())) == episode.mission.actions
        np.testing.assert_array_equal(rows.actions, windows(rows.executed))
        assert rows.person == episode.mission.person and rows.source == "dagger"
        assert set(rows.policy_actions) == {(0,)}


def test_the_way_ahead_is_the_way_that_is_walked(expert: list[EpisodeRows]) -> None:
    """Of its 1.5 m nine points in ten lie within half a step of where the expert then walks."""
    rows = expert[0]
    off = []
    for k, (x, y, yaw) in enumerate(rows.poses):
        line = rows.poses[k:, :2] - (x, y)
        own = rows.waypoints[k, : min(int(rows.valid[k]), 7)]
        c, s = np.cos(yaw), np.sin(yaw)
        there = np.column_stack([c * own[:, 0] - s * own[:, 1], s * own[:, 0] + c * own[:, 1]])
        off += np.hypot(*(there[:, None] - line[None]).transpose(2, 0, 1)).min(1).tolist()
    assert np.quantile(off, 0.9) <= 0.125


def test_labels_are_for_where_the_person_is_that_the_policy_holds_up(
    simulator: Simulator, suite: Suite
) -> None:
    """The track of beforehand goes on without the person; what is foretold begins where it is."""
    (episode, *_) = suite.episodes
    person = episode.followed
    assert person is not None
    track = walk_alone(person, 60.0)
    along = track.place[np.searchsorted(track.walked, 4.0)]  # the agent stands on its way
    x, y = map(float, along)
    blocked = msgspec.structs.replace(episode, start=(x, y, 0.0))
    rows = collect(simulator, "always_stop", blocked, beta=0.0)
    assert rows.people is not None
    row = episode.people.index(person)
    ticks = np.minimum(round(10 * STEP) * np.arange(len(rows)), len(track.place) - 1)
    off = np.hypot(*(track.place[ticks] - rows.people.places[:, row]).T)
    assert off.max() > 0.5  # it waits, and goes round
    assert (rows.executed == 0).all() and not rows.collided.any()
    simulator.reset(blocked)
    expert = FollowExpert(simulator, blocked, simulator.scene.grid)
    for _ in range(int(off.argmax())):
        simulator.step(0)
    ahead = expert.foretell()
    np.testing.assert_array_equal(ahead.places[0], simulator.company.places)
    now = ahead.track.place_at(simulator.time)
    assert np.allclose(now, rows.people.places[off.argmax(), row], rtol=0, atol=1e-9)
    assert ahead.track.arcs[-1] > ahead.track.arc_at(simulator.time)  # on it goes


def test_labels_step_on_nobody(simulator: Simulator, suite: Suite) -> None:
    """What the expert would do from a state, done: no move is cut short by a person."""
    for episode in suite.episodes:
        rows = collect(simulator, "random", episode, beta=0.6)
        expert = rows.executed == rows.actions[:, 0]
        assert not rows.collided[expert & (rows.executed == 1)].any()


def test_a_touch_ends_it_and_so_does_loss(simulator: Simulator, suite: Suite) -> None:
    (episode, *_) = suite.episodes
    hit = collect(simulator, "straight_at_the_person", episode, beta=0.0)
    assert hit.collided[-1] and not hit.collided[:-1].any()
    assert hit.distance[-1] < ROOM + 0.25 + 1.0 * STEP
    lost = collect(simulator, "always_stop", episode, beta=0.0)
    far = lost.distance > 4.0  # more than 20 steps beyond; the last one ends it
    assert 19 <= int(far.sum()) <= 21 and far[-1]
    assert len(lost) < len(episode.mission.actions)  # type: ignore[union-attr]


def test_a_demonstration_is_labelled_with_what_was_done(simulator: Simulator, suite: Suite) -> None:
    (episode, *_) = suite.episodes
    rows = collect(simulator, "straight_at_the_person", episode, beta=0.0, demonstrate=True)
    assert rows.source == "demonstration"
    np.testing.assert_array_equal(rows.actions, windows(rows.executed))


def test_to_a_goal_the_expert_waits_for_people_and_labels_say_so(simulator: Simulator) -> None:
    episode = crossing()
    rows = collect(simulator, "always_stop", episode, beta=1.0)
    np.testing.assert_array_equal(rows.actions, windows(rows.executed))
    assert rows.executed[-1] == 0 and rows.distance[-1] <= 0.25 and not rows.collided.any()
    assert rows.people is not None and rows.person == 0
    bare = collect(simulator, "always_stop", msgspec.structs.replace(episode, people=()), beta=1.0)
    assert len(rows) > len(bare) and bare.people is None
    gaps = np.hypot(*(rows.people.places[:, 0] - rows.poses[:, :2]).T)
    assert gaps.min() >= ROOM - 1e-9


SETS = BuildSettings(
    chunk=1,
    pictures=PictureSettings(layout="none"),
    dagger=DaggerSettings(policy="random", beta=0.8, halting="none", max_steps=300),
)


def test_workers_and_agents_change_no_byte_and_the_sum_tells_followers_apart(
    suite: Suite, tmp_path: Path, files_of: Callable[[Path], dict[str, bytes]]
) -> None:
    done = build_dagger(suite, tmp_path / "one", SETS)
    build_dagger(suite, tmp_path / "two", SETS, workers=2, agents=4)
    assert files_of(tmp_path / "two") == files_of(tmp_path / "one")
    found = sum_up(open_dataset(tmp_path / "one"))
    assert found.following_episodes == found.episodes == len(suite.episodes)
    assert found.following == found.states == done.about.rows and found.arrived == 0
    rows = [rows for part in done.about.parts for rows in done.part_rows(part)]
    near = sum(int((one.distance <= 3.0).sum()) for one in rows)
    assert found.followed == near
    assert f"{near / found.states:.1%}" in describe_summary(found)


def test_a_mission_that_does_not_say_whom_to_follow_is_refused(
    simulator: Simulator, suite: Suite
) -> None:
    (episode, *_) = suite.episodes
    untold = msgspec.structs.replace(
        episode, mission=msgspec.structs.replace(episode.mission, person=0)
    )
    with pytest.raises(PlanError, match="whom to follow"):
        collect(simulator, "always_stop", untold)
