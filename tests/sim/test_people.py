"""People around the simulator's agent: moves that stop at them, pictures that show them."""

from __future__ import annotations

from functools import partial

import msgspec
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import SyncVectorEnv

from gn0.avatars import AvatarBank, generate_bank
from gn0.errors import EpisodeError
from gn0.geometry import Pose2D
from gn0.missions.episode import AgentSpec, Episode, MissionGoal
from gn0.people.person import EpisodePerson
from gn0.people.walk import walk_alone
from gn0.render import Camera
from gn0.scenes import build_example_scene
from gn0.sim import Displacement, Simulator, Teleport, open_simulator
from gn0.sim.env import GoalNavEnv
from gn0.sim.presets import find_preset

FLAT = build_example_scene()
BODY = AgentSpec(radius=0.25, step_seconds=0.2)  # two ticks an action
EYES = msgspec.structs.replace(
    find_preset("gn_bench"), agent=BODY,
    rgb=Camera.from_vfov(96, 72, 70.0), depth=Camera.from_vfov(96, 72, 70.0),
)  # fmt: skip
FORWARD, LEFT = 1, 2
AHEAD = (3.2, 2.5)


def stander(x: float = AHEAD[0], y: float = AHEAD[1], **more: object) -> EpisodePerson:
    fields = {"number": 4, "identity": "drawn:0:1", "path": ((x, y),), "behaviour": "stand"}
    return EpisodePerson(**{**fields, **more})  # type: ignore[arg-type]


def walker(*path: tuple[float, float], **more: object) -> EpisodePerson:
    fields = {"number": 7, "identity": "drawn:0:2", "path": path, "behaviour": "script"}
    return EpisodePerson(**{**fields, **more})  # type: ignore[arg-type]


def episode(*people: EpisodePerson, start: tuple[float, float, float] = (2.0, 2.5, 0.0)) -> Episode:
    goal = MissionGoal(goal=(6.0, 2.5), object_id="", category="bed", instruction="Go.")
    return Episode(
        id="e", scene_id=FLAT.id, mission=goal, start=start, path=(start[:2], goal.goal),
        people=people,
    )  # fmt: skip


@pytest.fixture(scope="module")
def blind() -> Simulator:
    return open_simulator(FLAT, EYES, sensors=["ranges"])


@pytest.fixture(scope="module")
def bank(tmp_path_factory) -> AvatarBank:
    folder = tmp_path_factory.mktemp("bank")
    generate_bank(folder, count=2, seed=1, density=0.05)
    return AvatarBank(folder)


def away(simulator: Simulator) -> float:
    """Nearest centre of a person [m]."""
    place = simulator.pose.x, simulator.pose.y
    return float(np.linalg.norm(simulator.company.places - place, axis=1).min())


def test_a_move_stops_at_the_tick_before_it_would_touch(blind) -> None:
    blind.reset(episode(stander()))
    hits = []
    for _ in range(6):
        result = blind.step(FORWARD)
        hits.append((result.collided, result.info["hit_person"]))
        assert away(blind) >= 0.5
    hit = hits[-1][1]
    assert hit.number == 4 and hit.by == "agent" and hits[-1][0]
    assert hits[0] == (False, None)
    assert blind.pose.x == pytest.approx(2.625)  # ticks of 0.125 m: one more would touch at 2.7


def test_long_moves_stop_at_people_and_last_as_long_as_they_got(blind) -> None:
    for move in (Displacement(3.0, 0.0, 0.0), Teleport(5.0, 2.5, 0.0)):
        blind.reset(episode(stander()))
        result = blind.step(move)
        assert result.collided and result.info["hit_person"].number == 4
        assert 0.5 <= away(blind) < 0.63
        assert result.steps == 3 and blind.time == pytest.approx(0.6)
    blind.reset(episode(walker((3.0, 3.0), (3.0, 1.5), after="back")))
    result = blind.step(Displacement(0.0, 0.0, np.pi))  # twelve turns of 15 degrees
    assert result.steps == 12
    track = walk_alone(blind.company.people[0], 2.4)
    assert tuple(blind.company.places[0]) == tuple(track.place[24])


def test_people_do_in_the_simulator_what_they_do_alone(blind) -> None:
    person = walker((5.0, 3.5), (5.0, 2.0), (6.5, 2.0), after="back", speed=0.8)
    blind.reset(episode(person, start=(1.0, 2.6, 0.0)))
    track = walk_alone(person, 20)
    for step in range(1, 90):
        blind.step(LEFT)
        assert tuple(blind.company.places[0]) == tuple(track.place[2 * step])
        assert tuple(blind.company.faces[0]) == tuple(track.face[2 * step])


def test_nobody_walks_into_an_agent_that_stands(blind) -> None:
    blind.reset(episode(walker((3.5, 2.5), (1.3, 2.5), after="back", speed=1.6)))
    least = 9.0
    for _ in range(200):
        result = blind.step(LEFT)
        assert not result.collided and result.info["hit_person"] is None
        least = min(least, away(blind))
    assert 0.5 <= least < 0.75


def test_without_people_nothing_changes(blind) -> None:
    blind.reset(episode())
    result = blind.step(FORWARD)
    assert "hit_person" not in result.info
    assert blind.pose == Pose2D(2.25, 2.5, 0.0) and blind.save_state().people is None
    stands = episode(stander(6.5, 1.6))
    poses = []
    for one in (episode(), stands):
        blind.reset(one)
        actions = [FORWARD, LEFT, FORWARD, FORWARD, Displacement(1.3, 0.2, 0.4), FORWARD] * 3
        poses.append([(blind.step(action), blind.pose)[1] for action in actions])
    assert poses[0] == poses[1]  # cut into ticks, with nobody near: the same bits


def test_restored_states_go_on_with_the_same_people(blind) -> None:
    def go() -> list[bytes]:
        return [(blind.step(k % 3 + 1), blind.company.state.real.tobytes())[1] for k in range(30)]

    blind.reset(episode(walker((3.0, 3.0), (3.0, 1.5), after="back"), stander(5.0)))
    for _ in range(7):
        blind.step(LEFT)
    kept = blind.save_state()
    first = go()
    blind.reset(episode())
    blind.restore_state(kept)
    assert go() == first


def test_range_rays_end_at_people(blind) -> None:
    empty = blind.reset(episode()).ranges
    seen = blind.reset(episode(stander())).ranges
    assert seen[0] == pytest.approx(1.2 - 0.25 - 0.25, abs=1e-6)
    assert (seen <= empty).all() and seen[36] == empty[36]


def test_people_in_walls_are_refused_at_reset(blind) -> None:
    with pytest.raises(EpisodeError, match="person 7 comes nearer") as caught:
        blind.reset(episode(walker((3.0, 2.5), (3.0, 9.0))))
    assert "episode 'e', person 7, path" in caught.value.where


def test_people_are_seen_where_they_are_now(bank) -> None:
    names = ("rgb", "depth", "history", "who", "people_seen", "bev", "occupancy", "goal_picture")
    eyes = open_simulator(FLAT, EYES, sensors=names, bank=bank, backend="cpu")
    bare = eyes.reset(episode())
    assert not bare.more["who"].any() and not bare.more["people_seen"].any()
    moving = walker((3.4, 1.8), (3.4, 2.3), identity="p0000", speed=1.2, bank=bank.content_hash)
    first = eyes.reset(episode(moving, stander(3.2, 3.0, identity="p0001")))
    assert (first.rgb != bare.rgb).any() and (first.depth < bare.depth - 0.3).any()
    for same in ("bev", "occupancy", "goal_picture"):
        assert np.array_equal(first.read(same), bare.read(same)), same
    assert set(np.unique(first.more["who"])) == {0, 4, 7}
    seen = first.more["people_seen"]
    assert seen[3, 0] > 0.5 and seen[6, 1] == (first.more["who"] == 7).sum()
    rows, columns = np.nonzero(first.more["who"] == 4)
    box = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
    assert tuple(seen[3, 2:].astype(int)) == box
    place = Pose2D(2.0, 2.5, 0.0)
    later = [eyes.step(0).observation]
    eyes.reset(episode(moving))
    for turn in (2, 3) * 6:  # back to the same pose, while somebody walks past
        later.append(eyes.step(turn).observation)
    assert eyes.pose == place and (later[-1].rgb != later[2].rgb).any()
    assert np.array_equal(eyes.observe_at(place).rgb, later[-1].rgb)
    elsewhere = eyes.observe_at(Pose2D(1.2, 2.5, 0.0))
    assert (elsewhere.more["who"] == 7).any() and eyes.pose == place
    assert (later[-1].history != bare.history).any()


def test_who_is_beside_the_picture_is_not_posed(bank) -> None:
    """And what is seen, who it is and how much of him are the same bytes as if all were."""
    names = ("rgb", "depth", "who", "people_seen")
    people = (
        walker((3.4, 1.2), (3.4, 2.3), identity=bank.names[0], speed=1.2, bank=bank.content_hash),
        *(
            stander(*spot, number=n, identity=bank.names[n % 2])
            for n, spot in ((1, (0.8, 3.4)), (2, (1.5, 1.4)), (3, (2.7, 1.0)))
        ),
    )
    seen, asked = [], []
    for all_round in (False, True):
        eyes = open_simulator(FLAT, EYES, sensors=names, bank=bank, backend="cpu")
        if all_round:
            eyes._suite.sight = None
        shown = [eyes.reset(episode(*people))]
        turns = (LEFT, LEFT, FORWARD, LEFT, LEFT, LEFT, FORWARD, LEFT, LEFT, LEFT, LEFT, LEFT)
        shown += [eyes.step(turn).observation for turn in turns]
        seen.append([[one.read(name).tobytes() for name in names] for one in shown])
        asked.append(eyes._people.posed.hits + eyes._people.posed.misses)
    assert seen[0] == seen[1]
    assert any(np.frombuffer(one[2], np.uint8).any() for one in seen[0]), "somebody is seen"
    assert asked[0] < 0.6 * asked[1]


def test_who_is_around_is_looked_up_once_for_all_pictures_of_a_moment(bank, monkeypatch) -> None:
    names = ("rgb", "depth", "who", "people_seen")
    eyes = open_simulator(FLAT, EYES, sensors=names, bank=bank, backend="cpu")
    eyes.reset(
        episode(
            stander(identity=bank.names[0]), walker((3.4, 1.8), (3.4, 2.3), identity=bank.names[1])
        )
    )
    show, shown = eyes._people.show, []
    monkeypatch.setattr(eyes._people, "show", lambda *how: shown.append(how) or show(*how))
    for turn in (LEFT, 3, FORWARD):
        eyes.step(turn)
    assert len(shown) == 3
    eyes.observe_at(Pose2D(1.2, 2.5, 0.0))
    assert len(shown) == 4, "from elsewhere others are seen"
    eyes.show_people(eyes.pose, 60.0)
    eyes.look_at_people()
    assert len(shown) == 6, "clouds of a camera of somebody else's may have taken their place"


def test_the_agents_own_map_goes_by_time_where_people_move_and_only_there(bank) -> None:
    simulator = open_simulator(FLAT, EYES, bank=bank, sensors=["occupancy"], map_mode="explored")
    for people, timed in (((), False), ((stander(identity=bank.names[0]),), True)):
        simulator.reset(episode(*people))
        simulator.step(LEFT)
        kept = simulator.save_state().explored
        assert (kept.time is not None) == timed


def test_unknown_people_are_refused_before_anything_is_built(bank) -> None:
    eyes = open_simulator(FLAT, EYES, sensors=["rgb"], bank=bank, backend="cpu")
    with pytest.raises(EpisodeError, match="nobody is called 'p0009'"):
        eyes.reset(episode(stander(identity="p0009")))
    with pytest.raises(EpisodeError, match="is of bank 0000"):
        eyes.reset(episode(stander(identity="p0001", bank="0000")))
    without = open_simulator(FLAT, EYES, sensors=["rgb"], backend="cpu")
    with pytest.raises(EpisodeError, match="none was given"):
        without.reset(episode(stander(identity="p0001")))


def test_the_environment_tells_of_people() -> None:
    episodes = [episode(stander(), walker((5.0, 3.3), (5.0, 1.5), after="back"))]
    environment = GoalNavEnv(FLAT, episodes=episodes, sensors=("goal_vector", "ranges"), agent=BODY)
    check_env(environment, skip_render_check=True)
    _, info = environment.reset(seed=1)
    assert info["people"].shape == (16, 4) and info["people_count"] == 2
    assert info["people"][:2].any(axis=1).all() and not info["people"][2:].any()
    assert (info["hit_person"], info["hit_by"], info["hit_tick"]) == (0, "", 0)
    for _ in range(6):
        *_, info = environment.step(FORWARD)
    assert (info["hit_person"], info["hit_by"]) == (4, "agent") and info["hit_tick"] > 0


def test_gymnasium_stacks_what_environments_tell_of_people() -> None:
    """One with two people, one with one: equal shapes, whoever was run into."""
    casts = [(stander(), walker((5.0, 3.3), (5.0, 1.5), after="back")), (stander(),)]

    def make(cast: tuple[EpisodePerson, ...]) -> GoalNavEnv:
        return GoalNavEnv(FLAT, episodes=[episode(*cast)], sensors=("ranges",), agent=BODY)

    envs = SyncVectorEnv([partial(make, cast) for cast in casts])
    _, infos = envs.reset(seed=1)
    assert infos["people"].shape == (2, 16, 4)
    assert infos["people_count"].tolist() == [2, 1]
    assert infos["people"].any(axis=2).sum(axis=1).tolist() == [2, 1]
    for _ in range(6):
        *_, infos = envs.step(np.array([FORWARD, LEFT]))
    assert infos["hit_person"].tolist() == [4, 0]
    assert list(infos["hit_by"]) == ["agent", ""]
    envs.close()
