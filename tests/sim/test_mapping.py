"""Map modes: what the maps of an observation may hold, and that they hold no more."""

from __future__ import annotations

import dataclasses

import gymnasium
import numpy as np
import pytest

from gn0.errors import ConfigError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import Pose2D
from gn0.maps.grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from gn0.missions.episode import Episode, MissionInstruction
from gn0.scenes.occupancy import BAND
from gn0.scenes.scene import Scene, SceneSourceInfo
from gn0.seeds import random_stream
from gn0.sim.mapping import UNSEEN, build_preset_fan
from gn0.sim.open import open_simulator
from gn0.sim.presets import find_preset
from gn0.sim.sensors import SensorConfig, check_map_mode
from gn0.sim.state import Action, Observation

MAPS = frozenset({"bev", "occupancy"})
WALK = [1, 2, 1, 1, 3, 3, 1, 2, 2, 2, 1]


@pytest.fixture(scope="module")
def explorer(room_scene):
    return open_simulator(room_scene, "vlnce", sensors=MAPS, map_mode="explored")


def bytes_of(observation: Observation) -> bytes:
    values = dataclasses.asdict(observation)
    arrays = [v.tobytes() for v in values.values() if isinstance(v, np.ndarray)]
    rest = repr({k: v for k, v in values.items() if not isinstance(v, np.ndarray)})
    return b"".join(arrays) + rest.encode()


def test_it_begins_with_what_is_in_view_and_under_its_feet(
    explorer, room_scene, make_episode
) -> None:
    prior = open_simulator(room_scene, "vlnce", sensors=MAPS)
    observation = explorer.reset(make_episode())
    full = prior.reset(make_episode())
    assert observation.occupancy.shape == full.occupancy.shape
    assert observation.bev.shape == full.bev.shape
    assert observation.bev_metres_per_pixel == full.bev_metres_per_pixel
    known = (observation.occupancy != 127).any(axis=2)
    assert 0.05 < known.mean() < 0.7
    grid = explorer._mapper.grid
    row, col = grid.cell_of(1.0, 2.5)
    assert (grid.cells[row - 2 : row + 3, col - 2 : col + 3] == FREE).all()
    unseen = (observation.bev == UNSEEN).all(axis=2)
    assert unseen.mean() > 0.2
    assert (full.bev == UNSEEN).all(axis=2).mean() < 0.01


def test_discs_are_drawn_as_on_the_prior_map(explorer, room_scene, make_episode) -> None:
    prior = open_simulator(room_scene, "vlnce", sensors={"occupancy"})
    for simulator in (explorer, prior):
        simulator.reset(make_episode())
        simulator.step(Action.FORWARD)
    a, b = explorer.step(Action.FORWARD), prior.step(Action.FORWARD)
    for colour in ((0, 255, 0), (255, 0, 0)):
        np.testing.assert_array_equal(
            (a.observation.occupancy == colour).all(axis=2),
            (b.observation.occupancy == colour).all(axis=2),
        )


def test_it_agrees_with_the_scene_and_grows(explorer, room_scene, make_episode) -> None:
    explorer.reset(make_episode())
    before = (explorer._mapper.grid.cells != UNKNOWN).sum()
    for action in WALK:
        explorer.step(action)
    cells, true = explorer._mapper.grid.cells, room_scene.grid.cells
    assert (cells != UNKNOWN).sum() > before
    assert (true[cells == FREE] == FREE).mean() > 0.95
    assert (cells == OCCUPIED).any()


def test_reset_forgets_and_the_same_walk_makes_the_same_map(explorer, make_episode) -> None:
    def walk() -> list[bytes]:
        seen = [bytes_of(explorer.reset(make_episode()))]
        return seen + [bytes_of(explorer.step(action).observation) for action in WALK]

    first = walk()
    explorer.reset(make_episode(start=(6.0, 2.5, 3.0), goal=(1.0, 2.5)))
    explorer.step(Action.FORWARD)
    assert walk() == first


def test_a_saved_state_holds_the_map(explorer, make_episode) -> None:
    explorer.reset(make_episode())
    explorer.step(Action.FORWARD)
    state = explorer.save_state()
    then = [bytes_of(explorer.step(action).observation) for action in WALK]
    explorer.restore_state(state)
    assert [bytes_of(explorer.step(action).observation) for action in WALK] == then


def test_a_look_from_elsewhere_is_not_remembered(explorer, make_episode) -> None:
    explorer.reset(make_episode())
    explorer.step(Action.LEFT)
    before = explorer._mapper.save()
    there = explorer.observe_at(Pose2D(6.0, 2.5, 0.0))
    after = explorer._mapper.save()
    np.testing.assert_array_equal(before.belief, after.belief)
    assert (there.occupancy != 127).any(axis=2).sum() > (before.occupancy != 127).any(axis=2).sum()


def test_what_an_observation_holds_does_not_change_later(explorer, make_episode) -> None:
    observation = explorer.reset(make_episode())
    digest = bytes_of(observation)
    for action in WALK:
        explorer.step(action)
    assert bytes_of(observation) == digest
    with pytest.raises(ValueError):
        observation.bev[0] = 0


def test_maps_are_made_without_the_policy_asking_for_pictures(explorer, make_episode) -> None:
    observation = explorer.reset(make_episode())
    assert observation.rgb is None and observation.depth is None


def test_without_maps_a_map_is_refused(room_scene) -> None:
    with pytest.raises(ConfigError, match="'none' has no bev and no occupancy"):
        open_simulator(room_scene, sensors=MAPS, map_mode="none")
    with pytest.raises(ConfigError, match="known: prior, explored, none"):
        open_simulator(room_scene, map_mode="half")
    with pytest.raises(ConfigError):
        SensorConfig(active=MAPS, map_mode="none")
    assert check_map_mode("none", {"rgb", "depth", "ranges"}) == "none"
    open_simulator(room_scene, sensors={"ranges"}, map_mode="none")


def test_environments_take_the_mode() -> None:
    env = gymnasium.make("gn0.sim.env:gn0/MapNav-v1", map_mode="explored", preset="vlnce")
    observation, _ = env.reset(seed=1)
    assert env.observation_space.contains(observation)
    assert (observation["occupancy"] == 127).any()
    env.close()
    with pytest.raises(ConfigError, match="'none'"):
        gymnasium.make("gn0.sim.env:gn0/MapNav-v1", map_mode="none")


@pytest.mark.parametrize("name", ["gn_bench", "datagen", "gn0_ce", "vlnce_r2r", "n1_125cm_45deg"])
def test_every_camera_has_a_fan_of_rays(name: str) -> None:
    preset = find_preset(name)
    fan = build_preset_fan(preset, preset.agent, 2.3)
    assert fan.band == BAND and len(fan.cols) <= 480 and len(fan.rows) <= 180
    assert fan.bins.min() == 0 and fan.bins.max() == len(fan.angles) - 1
    width, height = preset.picture_size
    assert fan.colour_rows.max() < height and fan.colour_cols.max() < width
    assert (fan.colour_rows >= 0).mean() > 0.9
    assert fan.blind > 0 and np.isfinite(fan.blind)


def closed_room(furniture: float | None) -> Scene:
    """A room of 4 x 4 m without a door, and beside it one that holds a box at y = `furniture`."""
    sheets = []
    step = 0.05
    along, up = np.arange(0, 4 + step, step), np.arange(0, 2.5 + step, step)

    def sheet(a, b, place) -> None:
        u, v = (c.ravel() for c in np.meshgrid(a, b))
        for layer in range(4):
            sheets.append(place(u, v, 0.02 * layer))

    sheet(along, up, lambda u, v, d: np.stack([0 * u - d, u, v], 1))
    sheet(along, up, lambda u, v, d: np.stack([0 * u + 4 + d, u, v], 1))
    sheet(along, up, lambda u, v, d: np.stack([u, 0 * u - d, v], 1))
    sheet(along, up, lambda u, v, d: np.stack([u, 0 * u + 4 + d, v], 1))
    sheet(along, along, lambda u, v, d: np.stack([u, v, 0 * u - d], 1))
    sheet(along, along, lambda u, v, d: np.stack([u, v, 0 * u + 2.5 + d], 1))
    points = np.concatenate(sheets)
    cells = np.full((100, 180), UNKNOWN, np.uint8)
    cells[10:90, 10:90] = FREE  # the room lies at 0..4 m, the grid begins at -0.5 m
    if furniture is not None:
        cells[10:90, 92:170] = FREE
        row = int((furniture + 0.5) / 0.05)
        cells[row : row + 20, 110:130] = OCCUPIED
        box = np.stack(np.meshgrid(*[np.linspace(0, 1, 12)] * 3), -1).reshape(-1, 3)
        points = np.concatenate([points, box + np.array((5.0, furniture, 0.0))])
    count = len(points)
    colour = random_stream(3, "closed room").uniform(-1, 1, (len(np.concatenate(sheets)), 1, 3))
    sh = np.full((count, 1, 3), 1.5)
    sh[: len(colour)] = colour
    cloud = GaussianCloud(
        means=points.astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        scales=np.full((count, 3), 0.04, np.float32),
        opacities=np.full(count, 1.0, np.float32),
        sh=sh.astype(np.float32),
    )
    return Scene(
        id="closed",
        source=SceneSourceInfo(kind="example", detail="a closed room"),
        grid=OccupancyGrid(cells, 0.05, (-0.5, -0.5)),
        objects=(),
        rooms=(),
        bounds=np.array([[-0.5, -0.5, 0.0], [8.5, 4.5, 2.5]]),
        load_cloud=lambda: cloud,
        cloud_hash=cloud.content_hash,
    )


def test_nothing_behind_closed_walls_is_in_any_observation() -> None:
    """Whatever stands in the next room, an explored map is the same, to the byte."""
    episode = Episode(
        id="e0",
        scene_id="closed",
        mission=MissionInstruction(goal=(3.2, 3.2), instruction="Look."),
        start=(1.0, 1.0, 0.3),
        path=((1.0, 1.0), (3.2, 3.2)),
    )
    walk = random_stream(0, "leak").choice(4, 40, p=[0.0, 0.5, 0.25, 0.25]).tolist()

    def look(furniture: float | None, mode: str) -> list[bytes]:
        scene = closed_room(furniture)
        simulator = open_simulator(
            scene, "vlnce", sensors={*MAPS, "rgb", "depth", "ranges"}, map_mode=mode
        )
        seen = [bytes_of(simulator.reset(episode))]
        return seen + [bytes_of(simulator.step(action).observation) for action in walk]

    told = look(0.5, "explored")
    assert told == look(2.5, "explored")
    assert told == look(None, "explored")
    assert look(0.5, "prior") != look(2.5, "prior"), "the prior map does show it"
