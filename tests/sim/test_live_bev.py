"""`bev_live` shows everybody where they are now; the other maps never show anybody."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from gn0.errors import ConfigError
from gn0.geometry import Pose2D
from gn0.missions.episode import AgentSpec, Episode, MissionFollow, MissionGoal
from gn0.people.person import EpisodePerson
from gn0.render import Camera
from gn0.scenes import build_example_scene
from gn0.sim import Simulator, VectorEnv, VectorEnvDevice, open_simulator
from gn0.sim.env import GoalNavEnv
from gn0.sim.live_bev import draw_people
from gn0.sim.presets import find_preset

FLAT = build_example_scene(spacing=0.1)
BODY = AgentSpec(radius=0.25, step_seconds=0.2)
EYES = msgspec.structs.replace(
    find_preset("gn_bench"), agent=BODY,
    rgb=Camera.from_vfov(48, 36, 70.0), depth=Camera.from_vfov(48, 36, 70.0),
)  # fmt: skip
BLUE, GREEN, RED, WHITE = (40, 96, 214), (34, 150, 84), (255, 0, 0), (255, 255, 255)
STANDER = EpisodePerson(
    number=4, identity="drawn:0:1", path=((3.2, 3.2),), behaviour="stand", yaw=np.pi / 2
)
WALKER = EpisodePerson(number=7, identity="drawn:0:2", path=((3.4, 1.6), (3.4, 2.3)), speed=1.0)
MAPS = ("bev", "occupancy", "bev_live")


def episode(*people: EpisodePerson, follow: int = 0) -> Episode:
    mission: MissionGoal | MissionFollow = MissionGoal(
        goal=(6.0, 2.5), object_id="", category="bed", instruction="Go."
    )
    if follow:
        mission = MissionFollow(goal=(6.0, 2.5), instruction="Go.", human="x", person=follow)
    return Episode(
        id="e", scene_id=FLAT.id, mission=mission, start=(2.0, 2.5, 0.0),
        path=((2.0, 2.5), (6.0, 2.5)), people=people,
    )  # fmt: skip


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    return open_simulator(FLAT, EYES, sensors=[*MAPS, "goal_picture"])


def spots(picture: np.ndarray, colour: tuple[int, int, int], simulator: Simulator) -> np.ndarray:
    """Places [N, 2] m of the pixels of a colour: rows go south from the map's upper edge."""
    rows, columns = np.nonzero((picture == colour).all(axis=2))
    x0, y0, _, _ = simulator.scene.grid.bounds
    scale = simulator.scene.grid.resolution
    height = picture.shape[0]
    return np.column_stack([x0 + (columns + 0.5) * scale, y0 + (height - rows - 0.5) * scale])


def test_everybody_is_where_they_are_now_and_the_other_maps_show_nobody(simulator) -> None:
    alone = simulator.reset(episode())
    own = simulator.reset(episode(STANDER, WALKER, follow=7))
    for name in ("bev", "occupancy", "goal_picture"):
        assert own.read(name).tobytes() == alone.read(name).tobytes(), name
    nobody = alone.read("bev_live")
    assert not len(spots(nobody, BLUE, simulator)) and not len(spots(nobody, GREEN, simulator))
    changed = (nobody != alone.bev).any(axis=2)
    assert changed.sum() == (nobody[changed] == RED).all(axis=1).sum() > 0  # the agent alone
    stands = spots(own.read("bev_live"), BLUE, simulator)
    assert stands.mean(axis=0) == pytest.approx((3.2, 3.25), abs=0.06)  # and a nose to the north
    assert (stands[:, 1] - 3.2).max() > 0.3 and (3.2 - stands[:, 1]).max() < 0.26
    area = np.pi * 0.25**2 / FLAT.grid.resolution**2
    assert area < len(stands) < 1.5 * area
    before = spots(own.read("bev_live"), GREEN, simulator).mean(axis=0)
    for _ in range(5):
        later = simulator.step(0).observation.read("bev_live")
    after = spots(later, GREEN, simulator).mean(axis=0)
    moved = simulator.company.places[1] - (3.4, 1.6)
    assert moved[1] > 0.3 and after - before == pytest.approx(moved, abs=0.06)
    elsewhere = simulator.observe_at(Pose2D(2.4, 2.0, 1.0)).read("bev_live")
    assert np.array_equal(spots(elsewhere, GREEN, simulator).mean(axis=0), after)
    assert not np.array_equal(spots(elsewhere, RED, simulator), spots(later, RED, simulator))
    with pytest.raises(ValueError, match="read-only"):
        later[0, 0] = 0
    again = simulator.reset(episode(STANDER, WALKER, follow=7))
    assert again.read("bev_live").tobytes() == own.read("bev_live").tobytes()


def test_environments_show_the_same_bytes_and_a_device_says_that_it_has_none(simulator) -> None:
    played = msgspec.structs.replace(episode(STANDER, WALKER), agent=BODY)
    settings = {"episodes": [played], "sensors": MAPS, "agent": BODY}
    single, many = GoalNavEnv(FLAT, **settings), VectorEnv(2, FLAT, **settings)
    one, _ = single.reset(seed=0)
    both, _ = many.reset(seed=0)
    simulator.reset(played)
    assert single.observation_space["bev_live"].contains(one["bev_live"])
    for action in (2, 2, 3):
        one = single.step(action)[0]
        both = many.step(np.full(2, action))[0]
        want = simulator.step(action).observation
        for name in MAPS:
            for found in (one[name], both[name][0], both[name][1]):
                assert np.asarray(found).tobytes() == want.read(name).tobytes(), name
    assert len(spots(one["bev_live"], BLUE, simulator)) > 150
    with pytest.raises(ConfigError, match="'bev_live'"):
        VectorEnvDevice(2, FLAT, episodes=[episode()], sensors=("bev_live",), agent=BODY)


def test_people_are_cut_at_the_edge_and_who_is_followed_lies_on_top() -> None:
    places = np.array([[0.0, 0.0], [5.0, 5.0], [0.3, 0.0], [-9.0, 2.0]])
    faces = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 0.0], [0.0, 1.0]])
    picture = np.zeros((100, 80, 3), np.uint8)
    draw_people(picture, (0.0, 0.0), 0.05, places, faces, 0.25, followed=0)
    assert tuple(picture[-1, 0]) == GREEN and tuple(picture[-1, 7]) == GREEN  # its nose, over both
    assert tuple(picture[-1, 10]) == BLUE
    assert not picture[:80].any()  # the others are beyond
    assert (picture == WHITE).all(axis=2).any()
