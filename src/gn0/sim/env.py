"""Gymnasium environments: `gymnasium.make("gn0.sim.env:gn0/GoalNav-v1")`.

Importing this module, or `gn0.register_envs()`, registers the ids:

* `gn0/GoalNav-v1`: instruction, colour and depth, as VLN agents have them;
* `gn0/MapNav-v1`: colour, history mosaic, BEV and occupancy picture, as map-based agents have them;
* `gn0/PointNav-v1`: goal vector and range ring, no pictures: tens of thousands of steps a second;
* `gn0/FollowNav-v1`: the same as GoalNav, to follow a person, see `gn0.sim.follow_env`.

An id's version is raised whenever its numbers change. `gymnasium.make_vec("gn0/PointNavDevice-v1")`
and its like are the same environments on a GPU, see `gn0.sim.device_env`.

Reward of a step, all distances geodesic [m]:
    (distance before − distance after) − 0.01 + 2.5 · [STOP and distance after < success_distance]
Of several goals the nearest counts; where the goal is an area, STOP succeeds inside it only.
so a run without detour collects about its length and the bonus. The environment ends on STOP
(terminated) or after `max_steps` (truncated); it never acts for the agent.

An observation holds the sensors that are named in `sensors=` and `collided`; the ids above name
`instruction` among theirs. Left out of the list (`sensors=("goal_vector", "ranges")`) it is absent;
`instruction_tokens` is the same as numbers, see `gn0.sim.words`. `action_space="continuous"` takes
displacements that the body can do in one step, see `gn0.sim.continuous`.

In `gymnasium.make_vec(..., vectorization_mode="async")` pass `vector_kwargs={"shared_memory":
False}`: Gymnasium reads texts from shared memory only once, so instructions would stay blank.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from gn0.config import whole_number
from gn0.errors import ConfigError, EpisodeError, brief
from gn0.geometry import U8, Pose2D
from gn0.missions.episode import AgentSpec, Episode
from gn0.people.person import PEOPLE_MOST
from gn0.scenes.scene import Scene
from gn0.sim.continuous import build_action_space, read_action
from gn0.sim.ego_map import MapView, read_map_view
from gn0.sim.env_arguments import (
    check_motions,
    check_settings,
    episode_index,
    read_code,
    read_options,
)
from gn0.sim.motion import Motion
from gn0.sim.noise import Noise
from gn0.sim.open import name_look, open_simulator, split_look
from gn0.sim.presets import CameraPreset, find_preset
from gn0.sim.sensor.sensor import MAP_SIDE
from gn0.sim.sensor.table import carry_sensors
from gn0.sim.sensors import SensorConfig, check_map_mode
from gn0.sim.simulator import Simulator
from gn0.sim.state import Observation
from gn0.sim.tasks import TaskSet, load_tasks
from gn0.sim.top_down_map import TopDownMap
from gn0.sim.words import Vocabulary, WordTable, split_sensors, word_spaces

STEP_COST = 0.01
SUCCESS_REWARD = 2.5
if TYPE_CHECKING:
    from gn0.avatars.bank import AvatarBank
    from gn0.sim.people import Company

SIMULATORS_KEPT = 4  # scenes held ready at a time


class GoalNavEnv(gymnasium.Env[dict[str, Any], Any]):
    """Goal navigation in splat scenes.

    Observations are a dict of the chosen sensors plus `collided`. `info` holds what a robot cannot
    know (pose, distance to goal, success): for logs, never for the agent. In episodes with people
    it also holds `people` float64 [16, 4], x, y [m] and the cosine and sine of the heading of each,
    `people_count` of them and zeros after that, `hit_person`, the number of the person for whom the
    last move was cut (0: of nobody), `hit_by`, who came nearer (`agent`, `person` or ""), and
    `hit_tick`, at which tick (0: at none). Gymnasium's vectors can stack them; the names are those
    of `VectorEnv`, where nobody is NaN.

    Args:
        scene: a Scene or a scene folder; the built-in two-room flat when absent.
        suite: a suite folder, instead of a scene.
        episodes: episodes or a Parquet file of them; sampled when absent.
        sensors: any of `gn0 list sensors`, instruction (text), instruction_tokens and
            instruction_index among them; what is not named is absent.
        preset: camera preset by name.
        backend: renderer backend.
        agent: the body, instead of the preset's.
        max_steps: actions until truncation.
        success_distance: geodesic distance [m] below which STOP succeeds.
        render_mode: "rgb_array" gives the colour picture from `render()`.
        map_mode: what bev and occupancy show: the whole scene (prior), what the agent has seen
            (explored), or nothing (none); the suite's, else prior.
        map_view: squares of the sensor ego_map, and the arrow of the occupancy picture; see
            `gn0.sim.ego_map.MapView`, whose fields it may also be.
        motions: what moves in each scene, by its id, see `gn0.sim.motion`.
        action_space: "discrete" (STOP 0, FORWARD 1, LEFT 2, RIGHT 3), or "continuous", see
            `gn0.sim.continuous`.
        copy: arrays are the caller's own; without, they are not to be written to.
        channels_first: pictures are [3, H, W] rather than [H, W, 3].
        top_down_map: `info["top_down_map"]` follows the agent, see `gn0.sim.top_down_map`.
        noise: what the body adds to depth, pose and moves, see `gn0.sim.noise`.
        history_tile: (width, height) [px] of a view in the mosaic, instead of the preset's.
        bank: of the people of episodes who have names in one, its folder or itself.
        vocabulary: how `instruction_tokens` are made, bytes when None; see
            `gn0.sim.words.Vocabulary`, whose fields it may also be.
    """

    metadata = {  # noqa: RUF012 (Gymnasium's own declaration)
        "render_modes": ["rgb_array"],
        "render_fps": 2,
    }

    def __init__(
        self,
        scene: Scene | Path | str | None = None,
        suite: Path | str | None = None,
        episodes: Sequence[Episode] | Path | str | None = None,
        *,
        sensors: Iterable[str] = ("instruction", "rgb", "depth"),
        preset: str | None = None,
        backend: str = "auto",
        agent: AgentSpec | None = None,
        max_steps: int | None = None,
        success_distance: float = 3.0,
        render_mode: str | None = None,
        map_mode: str | None = None,
        map_view: MapView | Mapping[str, Any] | None = None,
        motions: Mapping[str, Motion] | None = None,
        action_space: str = "discrete",
        copy: bool = True,
        channels_first: bool = False,
        top_down_map: bool = False,
        noise: Noise | None = None,
        history_tile: tuple[int, int] | None = None,
        vocabulary: Vocabulary | Mapping[str, Any] | None = None,
        bank: AvatarBank | Path | str | None = None,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ConfigError(f"no render mode {render_mode!r}", remedy="give None or 'rgb_array'")
        check_settings(
            backend=backend,
            agent=agent,
            noise=noise,
            success_distance=success_distance,
            history_tile=history_tile,
        )
        self.render_mode = render_mode
        self.sensors, self.words = split_sensors(sensors)
        self.success_distance = success_distance
        self.copy, self.channels_first = copy, channels_first
        self._shows_map = top_down_map
        self._noise = noise
        self._bank = bank
        self._map_view = read_map_view(map_view)
        self._map: TopDownMap | None = None
        self._backend = backend
        self.tasks = load_tasks(
            scene, suite, episodes, preset=preset, agent=agent, max_steps=max_steps
        )
        self._motions = check_motions(motions, self.tasks.scenes)
        self.map_mode = check_map_mode(map_mode or self.tasks.map_mode, self.sensors)
        self._drawn = self.sensors | ({"rgb"} if render_mode else frozenset())
        self._simulators: OrderedDict[str, Simulator] = OrderedDict()
        self._simulator: Simulator | None = None
        self._picture: U8 | None = None
        self._distance = 0.0
        self.continuous = action_space == "continuous"
        self.action_space = build_action_space(action_space)
        self._camera = camera = find_preset(self.tasks.preset, history_tile=history_tile)
        self._carried = carry_sensors(self.sensors).sensors
        maps = shape_of_maps(self.tasks, self.sensors, camera)
        own = build_spaces(self.sensors, camera, maps, view=self._map_view)
        self._shapes = {name: space.shape for name, space in own.items()}
        self._numbers = {episode: k for k, episode in enumerate(dict.fromkeys(self.tasks.episodes))}
        self._pictures = picture_names(self.sensors, camera) if channels_first else frozenset()
        table = None
        if "instruction_tokens" in self.words:
            table = self._tokens = WordTable(self.tasks.episodes, vocabulary)
        self.observation_space = spaces.Dict(
            build_spaces(self.sensors, camera, maps, channels_first, self._map_view)
            | word_spaces(self.words, self.tasks.episodes, table)
            | {"collided": spaces.Discrete(2)}
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode drawn by the environment's own generator.

        `options={"episode": id or index or Episode}` chooses one.

        Raises:
            EpisodeError: no such episode, or it does not fit its scene.
            ConfigError: no such option, or the seed is not a whole number.
        """
        options = read_options(options, ("episode",))
        if seed is not None:
            seed = whole_number(seed, "seed", -math.inf)  # Gymnasium takes True for 1
        super().reset(seed=seed)
        episode = self._choose(options.get("episode"))
        self._simulator = self._open(name_look(episode))
        observation = self._simulator.reset(episode)
        self._distance = self._measure(self._simulator.pose)
        if self._shows_map:
            self._map = TopDownMap(self._simulator.navigation, self._simulator.max_steps)
            self._map.reset(episode)
        return self._pack(observation), self._info(False)

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Take one of STOP 0, FORWARD 1, LEFT 2, RIGHT 3, or a continuous action.

        Raises:
            SimError: before reset, after the end, or no such action.
        """
        simulator = self._simulator
        if simulator is None:
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        before = self._distance
        result = simulator.step(
            read_action(action, simulator.agent) if self.continuous else read_code(action)
        )
        self._distance = self._measure(simulator.pose)
        within = simulator.episode.success_within(self.success_distance)
        success = result.terminated and self._distance < within
        reward = before - self._distance - STEP_COST + (SUCCESS_REWARD if success else 0.0)
        return (
            self._pack(result.observation),
            float(reward),
            result.terminated,
            result.truncated,
            self._info(success),
        )

    def render(self) -> U8 | None:
        """The latest colour picture [H, W, 3] with render_mode "rgb_array"; else None."""
        if self.render_mode is None or self._picture is None:
            return None
        return self._picture.copy()

    def close(self) -> None:
        """Release scenes and renderers."""
        self._simulators.clear()
        self._simulator = None
        self._picture = None
        self._map = None

    @property
    def simulator(self) -> Simulator:
        """The simulator of the episode in progress: privileged access for experts.

        Raises:
            EpisodeError: before the first reset.
        """
        if self._simulator is None:
            raise EpisodeError("no episode yet", remedy="call reset() first")
        return self._simulator

    @property
    def episodes(self) -> Sequence[Episode]:
        """Episodes by number, as `instruction_index` names them."""
        return tuple(self._numbers)

    def _choose(self, wanted: Any) -> Episode:
        episodes = self.tasks.episodes
        if wanted is None:
            return episodes[int(self.np_random.integers(len(episodes)))]
        if isinstance(wanted, Episode):
            return wanted
        if 0 <= (index := episode_index(wanted)) < len(episodes):
            return episodes[index]
        for episode in episodes:
            if isinstance(wanted, str) and episode.id == wanted:
                return episode
        raise EpisodeError(
            f"no episode {brief(wanted)}",
            remedy=f"give an id, an Episode or 0..{len(episodes) - 1}",
        )

    def _open(self, look: str) -> Simulator:
        if look not in self._simulators:
            scene_id, light = split_look(look)
            if scene_id not in self.tasks.scenes:
                raise EpisodeError(f"scene {scene_id!r} is not here", remedy="open it with scene=")
            self._simulators[look] = open_simulator(
                self.tasks.scenes[scene_id](),
                self._camera,
                self._backend,
                self._drawn,
                self.tasks.agent,
                self.tasks.max_steps,
                map_mode=self.map_mode,
                map_view=self._map_view,
                light=light,
                motion=self._motions.get(scene_id),
                noise=self._noise,
                bank=self._bank,
            )
        self._simulators.move_to_end(look)
        while len(self._simulators) > SIMULATORS_KEPT:
            self._simulators.popitem(last=False)
        return self._simulators[look]

    def _measure(self, pose: Pose2D) -> float:
        assert self._simulator is not None
        field = self._simulator.navigation.geodesic(self._simulator.episode.destination)
        return field.distance_at(pose.x, pose.y)

    def _info(self, success: bool) -> dict[str, Any]:
        simulator = self.simulator
        shown: dict[str, Any] = {}
        if self._map is not None:
            shown["top_down_map"] = self._map.update(simulator.pose, simulator.steps)
        return {
            "episode_id": simulator.episode.id,
            "scene_id": simulator.scene.id,
            "pose": np.array(simulator.pose, np.float64),
            "distance_to_goal": self._distance,
            "success": success,
            **shown,
            **_tell_people(simulator.company),
        }

    def _pack(self, observation: Observation) -> dict[str, Any]:
        """The observation as a dict of arrays, fresh and writable with `copy`."""
        self._picture = observation.rgb
        packed: dict[str, Any] = {
            "instruction": observation.instruction,
            "collided": np.int64(observation.collided),
        }
        if "instruction_index" in self.words:
            number = self._numbers.setdefault(self.simulator.episode, len(self._numbers))
            packed["instruction_index"] = np.array(number, np.int32)
        if "instruction_tokens" in self.words:
            packed["instruction_tokens"] = self._tokens.row(self.simulator.episode)
        for sensor in self._carried:
            value = observation.read(sensor.name)
            if self.copy or sensor.array is not None:
                value = sensor.as_array(value)
            shape = self._shapes[sensor.name]
            if value.shape != shape:  # a map smaller than the largest
                sides = zip(value.shape, shape, strict=True)  # type: ignore[arg-type]
                value = np.pad(value, [(0, room - side) for side, room in sides])
            if sensor.name in self._pictures:
                value = move_channels(value, self.copy)
            packed[sensor.name] = value
        return {key: packed[key] for key in self.observation_space}  # type: ignore[attr-defined]


def _tell_people(company: Company) -> dict[str, Any]:
    """Where people are, and whether one was run into; nothing where there is nobody."""
    if not company:
        return {}
    hit, people = company.hit, np.zeros((PEOPLE_MOST, 4))
    people[: len(company)] = np.hstack([company.places, company.faces])
    return {
        "people": people,
        "people_count": len(company),
        "hit_person": 0 if hit is None else hit.number,
        "hit_by": "" if hit is None else hit.by,
        "hit_tick": 0 if hit is None else hit.tick,
    }


def build_spaces(
    sensors: Iterable[str],
    preset: CameraPreset,
    map_shape: tuple[int, int] | None,
    channels_first: bool = False,
    view: MapView | None = None,
) -> dict[str, spaces.Space[Any]]:
    """The observation space of each sensor; maps of several scenes share the largest size."""
    config = SensorConfig(active=frozenset(sensors), preset=preset, map_view=view or MapView())
    found: dict[str, spaces.Space[Any]] = {}
    for sensor in sorted(config.carried.sensors, key=lambda sensor: sensor.name):
        space = sensor.find_space(config).sized(map_shape)
        space = space.channels_first() if channels_first else space
        found[sensor.name] = spaces.Box(space.low, space.high, space.shape, space.dtype)
    return found


def picture_names(sensors: Iterable[str], preset: CameraPreset) -> frozenset[str]:
    """Those sensors that give pictures [H, W, 3]."""
    config = SensorConfig(active=frozenset(sensors), preset=preset)
    carried = config.carried.sensors
    return frozenset(s.name for s in carried if s.find_space(config).is_picture)


def move_channels(pictures: NDArray[Any], copy: bool) -> NDArray[Any]:
    """Pictures […, H, W, 3] as […, 3, H, W]; in memory of their own with `copy`."""
    moved = np.moveaxis(pictures, -1, -3)
    return np.ascontiguousarray(moved) if copy else moved


def shape_of_maps(
    tasks: TaskSet, sensors: Iterable[str], preset: CameraPreset
) -> tuple[int, int] | None:
    """(H, W) [px] that holds every map picture; None where no sensor gives one."""
    config = SensorConfig(active=frozenset(sensors), preset=preset)
    sized = [s for s in config.carried.sensors if MAP_SIDE in s.find_space(config).shape]
    return largest_map(tasks) if sized else None


def largest_map(tasks: TaskSet) -> tuple[int, int]:
    """(H, W) [px] that holds the map picture of every scene."""
    shapes = [make().grid.shape for make in tasks.scenes.values()]
    return max(h for h, _ in shapes), max(w for _, w in shapes)


ENVIRONMENTS: dict[str, dict[str, Any]] = {
    "gn0/GoalNav-v1": {"sensors": ("instruction", "rgb", "depth")},
    "gn0/MapNav-v1": {"sensors": ("instruction", "rgb", "history", "bev", "occupancy")},
    "gn0/PointNav-v1": {"sensors": ("instruction", "goal_vector", "ranges")},
}


FOLLOWING = "gn0/FollowNav-v1"


def register_envs() -> None:
    """Register GN0's environments with Gymnasium; may be called again."""
    for name, settings in ENVIRONMENTS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                id=name,
                entry_point="gn0.sim.env:GoalNavEnv",
                vector_entry_point="gn0.sim.vector:VectorEnv",
                kwargs=settings,
            )
            gymnasium.register(  # many at once on a GPU: tensors in, tensors out
                id=name.replace("-v", "Device-v"),
                vector_entry_point="gn0.sim.device_env:VectorEnvDevice",
                kwargs={"sensors": ("instruction_index", *settings["sensors"][1:])},
            )
    if FOLLOWING not in gymnasium.registry:
        gymnasium.register(
            id=FOLLOWING,
            entry_point="gn0.sim.follow_env:FollowNavEnv",
            vector_entry_point="gn0.sim.follow_vector:FollowVectorEnv",
            kwargs={"sensors": ("instruction", "rgb", "depth")},
        )


register_envs()
