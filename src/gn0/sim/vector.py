"""`VectorEnv`: thousands of `GoalNavEnv` in one, over many scenes, stepped by one kernel.

    env = gymnasium.make_vec("gn0.sim.env:gn0/PointNav-v1", num_envs=4096)

Environment i, seeded with s, plays exactly what `GoalNavEnv` seeded with s plays: the same
episodes in the same order, the same observations, rewards and infos. An episode that ends is
followed by the next in the same step (Gymnasium's `AutoresetMode.SAME_STEP`): the observation is
the new episode's first, and `infos["final_obs"]`, `infos["final_info"]` hold the old one's last.

Where episodes have people, infos also hold `people` [N, P, 4], x, y [m] and the unit vector of each
one's heading (NaN for nobody), and of a move that was cut because of a person `hit_person`, its
number (0 none), `hit_by`, who came nearer ("agent" or "person"), and `hit_tick`, the tick of the
action, from 1, that the agent did not do (0 none).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from gn0.config import whole_number
from gn0.errors import ConfigError, EpisodeError, brief
from gn0.geometry import F64, U8
from gn0.missions.episode import AgentSpec, Episode
from gn0.render.open import visible_backend
from gn0.scenes.scene import Scene
from gn0.sim.batch import FIELD_MEMORY, SimulatorBatch
from gn0.sim.batch_continuous import SimulatorBatchContinuous
from gn0.sim.batch_eyes import Snapshot
from gn0.sim.continuous import build_action_space
from gn0.sim.ego_map import MapView, read_map_view
from gn0.sim.env import (
    STEP_COST,
    SUCCESS_REWARD,
    build_spaces,
    move_channels,
    picture_names,
    shape_of_maps,
)
from gn0.sim.env_arguments import (
    check_motions,
    check_settings,
    episode_index,
    read_options,
    read_seeds,
)
from gn0.sim.motion import Motion
from gn0.sim.noise import Noise
from gn0.sim.open import open_simulator, split_look
from gn0.sim.presets import find_preset
from gn0.sim.sensor.goal_vector import VECTOR_LIMIT
from gn0.sim.sensor.sensor import MAP_SIDE
from gn0.sim.sensors import (
    SensorConfig,
    SensorSuite,
    check_map_mode,
)
from gn0.sim.tasks import load_tasks
from gn0.sim.walkers import WalkersHost
from gn0.sim.words import Vocabulary, WordTable, split_sensors, word_spaces

if TYPE_CHECKING:
    from gn0.avatars.bank import AvatarBank
    from gn0.sim.people_eyes import PeopleEyes

_DRAWS = 64  # episodes that an environment draws ahead


class VectorEnv(gymnasium.vector.VectorEnv[dict[str, Any], NDArray[Any], NDArray[Any]]):
    """Goal navigation in many scenes at once; see `GoalNavEnv` for what one of them is.

    Args:
        num_envs: how many environments.
        scene: a Scene, a scene folder, or several; the built-in two-room flat when absent.
        suite: a suite folder, instead of scenes.
        episodes: episodes or a Parquet file of them; sampled when absent.
        sensors: any of `gn0 list sensors`, instruction (text), instruction_tokens and
            instruction_index among them; what is not named is absent.
        preset: camera preset by name.
        backend: renderer backend.
        agent: the body, instead of the preset's.
        max_steps: actions until truncation.
        success_distance: geodesic distance [m] below which STOP succeeds.
        render_mode: "rgb_array" gives the colour pictures from `render()`.
        scenes_kept: scenes whose renderer is kept while no environment is in them.
        field_memory: bytes of distance fields kept.
        visible_sets: draw pictures from the splats visible near each place, not from all; see
            `gn0.render.visible`.
        map_mode: what bev and occupancy show, see `GoalNavEnv`; the suite's, else prior.
        map_view: squares of the sensor ego_map, and the arrow of the occupancy picture; see
            `gn0.sim.ego_map.MapView`, whose fields it may also be.
        motions: what moves in each scene, by its id, see `gn0.sim.motion`.
        action_space: "discrete" or "continuous", see `gn0.sim.continuous`.
        copy: observations are the caller's own; without, pictures are the environment's memory
            and hold until the next step or reset.
        channels_first: pictures are [N, 3, H, W] rather than [N, H, W, 3].
        noise: what each body adds to depth and pose, see `gn0.sim.noise`; moves are exact here.
        history_tile: (width, height) [px] of a view in the mosaic, instead of the preset's.
        vocabulary: how `instruction_tokens` are made, bytes when None; see
            `gn0.sim.words.Vocabulary`, whose fields it may also be.
        bank: of the people of episodes who have names in one, its folder or itself.

    Raises:
        ConfigError: an unknown sensor, preset, backend, action space or render mode.
        EpisodeError: no episode, one of a scene that is not here, or with people whom nobody plays.
        SimError: num_envs < 1, or an agent whose turns never come full circle.
        StorageError, FormatError: a file is missing or broken.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (Gymnasium's own declaration)
        "render_modes": ["rgb_array"],
        "render_fps": 2,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        scene: Scene | Path | str | Sequence[Scene | Path | str] | None = None,
        suite: Path | str | None = None,
        episodes: Sequence[Episode] | Path | str | None = None,
        *,
        sensors: Iterable[str] = ("instruction", "goal_vector"),
        preset: str | None = None,
        backend: str = "auto",
        agent: AgentSpec | None = None,
        max_steps: int | None = None,
        success_distance: float = 3.0,
        render_mode: str | None = None,
        scenes_kept: int = 4,
        field_memory: int = FIELD_MEMORY,
        visible_sets: bool = False,
        map_mode: str | None = None,
        map_view: MapView | Mapping[str, Any] | None = None,
        motions: Mapping[str, Motion] | None = None,
        action_space: str = "discrete",
        copy: bool = True,
        channels_first: bool = False,
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
        self.num_envs = num_envs = whole_number(num_envs, "num_envs", -np.inf)
        self.sensors, self.words = split_sensors(sensors)
        self.single_action_space = build_action_space(action_space)
        self.success_distance = success_distance
        self.copy, self.channels_first = copy, channels_first
        self.tasks = load_tasks(
            scene, suite, episodes, preset=preset, agent=agent, max_steps=max_steps
        )
        self._motions = check_motions(motions, self.tasks.scenes)
        self._bank = bank
        self.map_mode = check_map_mode(map_mode or self.tasks.map_mode, self.sensors)
        self._camera = camera = find_preset(self.tasks.preset, history_tile=history_tile)
        self.noise = noise or Noise()
        self._map_view = read_map_view(map_view)
        if self.noise.moves:
            raise ConfigError(
                "the agents of a VectorEnv move without noise",
                remedy="use GoalNavEnv, or leave out noise.actuation",
            )
        self._backend = visible_backend(backend) if visible_sets else backend
        self._drawn = self.sensors | ({"rgb"} if render_mode else frozenset())
        engine = SimulatorBatchContinuous if action_space == "continuous" else SimulatorBatch
        self.batch: SimulatorBatch = engine(
            num_envs,
            self.tasks.scenes,
            SensorConfig(
                active=frozenset(self._drawn),
                preset=camera,
                map_view=self._map_view,
                map_mode=self.map_mode,
                noise=self.noise,
            ),
            agent=self.tasks.agent,
            max_steps=self.tasks.max_steps,
            open_suite=self._open_suite,
            scenes_kept=whole_number(scenes_kept, "scenes_kept", 0),
            field_memory=whole_number(field_memory, "field_memory", 0),
            open_people=self._open_people,
        )
        if self.batch.eyes is not None:
            self.batch.eyes.reuses = not copy
        self._numbers = self.batch.table.add(self.tasks.episodes)
        map_shape = shape_of_maps(self.tasks, self.sensors, camera)
        carried = self.batch.config.carried.sensors
        self._padded = [
            s.name for s in carried if MAP_SIDE in s.find_space(self.batch.config).shape
        ]
        self._moved = picture_names(self.sensors, camera) if channels_first else frozenset()
        own = build_spaces(self.sensors, camera, map_shape, view=self._map_view)
        self._shapes = {name: own[name].shape for name in self._padded}
        self._spelt = {s.name: s.as_array for s in carried if s.array is not None and not s.many}
        self._words = None
        if "instruction_tokens" in self.words:
            self._words = WordTable(self.batch.table.episodes, vocabulary)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.single_observation_space = spaces.Dict(
            build_spaces(self.sensors, camera, map_shape, channels_first, self._map_view)
            | word_spaces(self.words, self.tasks.episodes, self._words)
            | {"collided": spaces.Discrete(2)}
        )
        self.observation_space = _batch_dict(self.single_observation_space, num_envs)
        self._everyone = np.arange(num_envs)
        # each runs up to _DRAWS draws ahead of the episodes that are played
        self._streams: list[np.random.Generator | None] = [None] * num_envs
        self._queue = np.zeros((num_envs, _DRAWS), np.int64)
        self._cursor = np.full(num_envs, _DRAWS)
        self._pictures: U8 | None = None
        self._begun = False
        self._name()

    def _name(self) -> None:
        """Texts by episode number, so that a step looks none of them up one by one."""
        listed = self.batch.table.episodes
        self._ids, self._scene_ids, self._texts = (
            np.array([None, *values], object)[1:]
            for values in (
                [e.id for e in listed],
                [e.scene_id for e in listed],
                [e.instruction for e in listed],
            )
        )
        self._most_people = max(len(e.people) for e in listed)
        if self._most_people and self.batch.eyes is not None:
            from gn0.people.cast import Cast  # bodies are needed only for pictures

            cast = Cast(self._bank)
            for episode in listed:
                cast.check(episode.people, f"episode {episode.id!r}")
        if self._words is not None:
            self._words.extend(listed)

    def _open_suite(self, look: str) -> SensorSuite:
        scene_id, light = split_look(look)
        return open_simulator(
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
        ).suite

    def _open_people(self, look: str, suite: SensorSuite) -> PeopleEyes:
        from gn0.sim.people_eyes import PeopleEyes  # bodies are needed only for pictures

        scene_id, light = split_look(look)
        assert suite.renderer is not None
        return PeopleEyes(self.tasks.scenes[scene_id](), suite.renderer, self._bank, light)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin an episode in each environment, or in those of `options["reset_mask"]`.

        An integer seed s seeds environment i with s + i, as Gymnasium's own vectors do; None goes
        on with the streams there are. `options={"episode": id or index or Episode}` chooses one
        for all; a list chooses one for each.

        Raises:
            EpisodeError: no such episode, or it does not fit its scene.
            ConfigError: seeds or mask of another length or type, or no such option.
            ClosedEnvironmentError: it was closed.
        """
        self._check_open()
        options = read_options(options, ("episode", "reset_mask"))
        which = self._masked(options.get("reset_mask"))
        self._seed(which, read_seeds(seed, self.num_envs))
        if options.get("episode") is not None:
            chosen = self._choose(options["episode"])[which]
        else:
            chosen = self._draw_episodes(which)
        self._place(which, chosen)
        self._begun = True
        (observation,) = self._finish([(self._everyone, self._sense(self._everyone))])
        return observation, self._infos(which, np.zeros(self.num_envs, np.bool_))

    def step(
        self, actions: Any
    ) -> tuple[dict[str, Any], NDArray[Any], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Take one action each: STOP 0, FORWARD 1, LEFT 2, RIGHT 3, or a row of four numbers.

        Raises:
            SimError: wrong shape or type, or no such action; then nobody has moved.
            EpisodeError: the next episode of an environment does not fit its scene.
        """
        self._check_open()
        if not self._begun:
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        rewards, terminated, truncated, success = self._judge(*self.batch.step(actions))
        ended = np.flatnonzero(terminated | truncated)
        parts, final_info = [], {}
        if len(ended):
            final_info = self._infos(ended, success)
            parts.append((ended, self._sense(ended)))
            self._place(ended, self._draw_episodes(ended))
            success = np.zeros(self.num_envs, np.bool_)
        parts.append((self._everyone, self._sense(self._everyone)))
        *finals, observation = self._finish(parts)
        infos = self._infos(self._everyone, success)
        for final in finals:
            infos |= {
                "final_obs": self._split(ended, final),
                "_final_obs": _mask(ended, self.num_envs),
                "final_info": final_info,
                "_final_info": _mask(ended, self.num_envs),
            }
        return observation, rewards, terminated, truncated, infos

    def _place(self, which: NDArray[np.int64], chosen: NDArray[np.int64]) -> None:
        """Begin episodes `chosen` [K] with agents `which` [K]."""
        self.batch.place(which, chosen)

    def _judge(
        self, progress: F64, stopped: NDArray[np.bool_], truncated: NDArray[np.bool_]
    ) -> tuple[F64, NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        """Rewards, which episodes have ended or were cut off, and which succeeded, [N] each."""
        distance, episode = self.batch.state.distance, self.batch.state.episode
        own = self.batch.table.reach[episode]
        success = stopped & (distance < np.where(own > 0, own, self.success_distance))
        rewards = progress - STEP_COST
        rewards[success] += SUCCESS_REWARD
        return rewards, stopped, truncated, success

    def _tell_more(self, which: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        """What else infos hold of agents `which` [K]."""
        return {}

    @property
    def episodes(self) -> Sequence[Episode]:
        """Episodes by number, as `instruction_index` names them."""
        return self.batch.table.episodes

    def render(self) -> tuple[U8, ...] | None:
        """The latest colour pictures [H, W, 3] with render_mode "rgb_array"; else None."""
        if self.render_mode is None or self._pictures is None:
            return None
        return tuple(self._pictures.copy())

    def claim(self) -> WalkersHost:
        """The agents themselves, for a rollout; the environment must be reset afterwards."""
        self._begun = False
        return WalkersHost(self.batch)

    def close_extras(self, **kwargs: Any) -> None:
        """Release scenes and renderers."""
        del self.batch
        self._pictures = None
        self._begun = False

    def _check_open(self) -> None:
        if self.closed:
            raise gymnasium.error.ClosedEnvironmentError("this VectorEnv was closed: make another")

    def _masked(self, mask: Any) -> NDArray[np.int64]:
        if mask is None:
            return self._everyone
        mask = np.asarray(mask)
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ConfigError(
                f"reset_mask is {mask.dtype} {mask.shape}",
                remedy=f"give {self.num_envs} booleans, at least one of them True",
            )
        if not self._begun and not mask.all():
            raise gymnasium.error.ResetNeeded("reset all environments before some of them")
        return np.flatnonzero(mask)

    def _seed(self, which: NDArray[np.int64], seeds: list[int | None] | None) -> None:
        for i in which.tolist():
            given = None if seeds is None else seeds[i]
            if given is not None or self._streams[i] is None:
                self._streams[i], _ = seeding.np_random(given)
                self._cursor[i] = _DRAWS

    def _draw_episodes(self, which: NDArray[np.int64]) -> NDArray[np.int64]:
        """The next episode's number for each of `which`, from its own stream."""
        for i in which[self._cursor[which] == _DRAWS].tolist():
            stream = self._streams[i]
            assert stream is not None
            self._queue[i] = stream.integers(len(self._numbers), size=_DRAWS)
            self._cursor[i] = 0
        drawn = self._queue[which, self._cursor[which]]
        self._cursor[which] += 1
        return self._numbers[drawn]

    def _choose(self, wanted: Any) -> NDArray[np.int64]:
        """Numbers [N] of the episodes named in `options["episode"]`."""
        many = wanted if isinstance(wanted, list | tuple | np.ndarray) else [wanted]
        if len(many) not in (1, self.num_envs):
            raise EpisodeError(
                f"{len(many)} episodes for {self.num_envs} environments",
                remedy="give one each, or one for all",
            )
        known = {episode.id: number for number, episode in enumerate(self.tasks.episodes)}
        numbers = []
        for value in many:
            if isinstance(value, Episode):
                if self._words is not None:
                    self._words.row(value)  # it may be refused
                numbers.append(int(self.batch.table.add([value])[0]))
                continue
            index = known.get(value, -1) if isinstance(value, str) else episode_index(value)
            if not 0 <= index < len(self._numbers):
                raise EpisodeError(
                    f"no episode {brief(value)}",
                    remedy=f"give an id, an Episode or 0..{len(self._numbers) - 1}",
                )
            numbers.append(int(self._numbers[index]))
        if len(self._ids) < len(self.batch.table.episodes):
            self._name()
        return np.resize(np.array(numbers, np.int64), self.num_envs)

    def _sense(self, which: NDArray[np.int64]) -> tuple[dict[str, Any], Snapshot | None]:
        """What agents `which` sense now, and what their pictures will need."""
        found = self.batch.observe(which, VECTOR_LIMIT)
        found["collided"] = self.batch.state.collided[which].astype(np.int64)
        number = self.batch.state.episode[which]
        if "instruction" in self.words:
            found["instruction"] = tuple(self._texts[number].tolist())
        if "instruction_tokens" in self.words:
            assert self._words is not None
            found["instruction_tokens"] = self._words.rows[number]
        if "instruction_index" in self.words:
            found["instruction_index"] = number.astype(np.int32)
        return found, self.batch.snapshot(which)

    def _finish(
        self, parts: list[tuple[NDArray[np.int64], tuple[dict[str, Any], Snapshot | None]]]
    ) -> list[dict[str, Any]]:
        """Observations of all parts, their pictures drawn in one call a scene."""
        found = [values for _, (values, _) in parts]
        snapshots = [snapshot for _, (_, snapshot) in parts if snapshot is not None]
        if snapshots:
            for values, pictures in zip(found, self.batch.draw(snapshots), strict=True):
                values |= pictures
            if self.render_mode is not None:
                self._pictures = found[-1]["rgb"]
        for values in found:
            for name in self._spelt:
                values[name] = np.stack([self._spelt[name](value) for value in values[name]])
            for name in self._padded:
                values[name] = _pad(values[name], self._shapes[name])
            for name in self._moved:
                values[name] = move_channels(values[name], self.copy)
        names = list(self.single_observation_space)  # type: ignore[call-overload]
        return [{name: values[name] for name in names} for values in found]

    def _infos(self, which: NDArray[np.int64], success: NDArray[np.bool_]) -> dict[str, Any]:
        """What a robot cannot know, of agents `which`, as Gymnasium lays it out."""
        state, mask = self.batch.state, _mask(which, self.num_envs)
        number = state.episode[which]
        values = {
            "episode_id": self._ids[number],
            "scene_id": self._scene_ids[number],
            "pose": self.batch.poses(which),
            "distance_to_goal": state.distance[which],
            "success": success[which],
        }
        if self._most_people:
            hits = self.batch.company.hits(which)
            values |= {
                "people": self.batch.company.places(which, self._most_people),
                "hit_person": hits.number,
                "hit_by": hits.by,
                "hit_tick": hits.tick,
            }
        values |= self._tell_more(which)
        infos: dict[str, Any] = {}
        for name, value in values.items():
            if len(which) == self.num_envs:
                infos[name] = value
            else:
                empty = None if value.dtype == object else 0
                infos[name] = np.full((self.num_envs, *value.shape[1:]), empty, value.dtype)
                infos[name][which] = value
            infos["_" + name] = mask.copy()
        return infos

    def _split(self, which: NDArray[np.int64], values: dict[str, Any]) -> NDArray[np.object_]:
        """Observations of `which`, one dict each, in an array [N] of None otherwise."""
        out = np.full(self.num_envs, None, object)
        columns = {
            name: [np.array(v) for v in value] if name == "instruction_index" else value
            for name, value in values.items()
        }
        rows = zip(*columns.values(), strict=True)
        for i, row in zip(which.tolist(), rows, strict=True):
            out[i] = dict(zip(columns, row, strict=True))
        return out


def _mask(which: NDArray[np.int64], count: int) -> NDArray[np.bool_]:
    mask = np.zeros(count, np.bool_)
    mask[which] = True
    return mask


def _pad(pictures: list[NDArray[Any]], shape: tuple[int, ...] | None) -> NDArray[Any]:
    """Map pictures of several scenes in one array [K, H, W, …], black to the right and below."""
    assert shape is not None
    out = np.zeros((len(pictures), *shape), pictures[0].dtype)
    for row, picture in zip(out, pictures, strict=True):
        row[tuple(slice(side) for side in picture.shape)] = picture
    return out


def _batch_dict(single: spaces.Dict, count: int) -> spaces.Dict:
    """`batch_space`, but the copies of a text space are one object: thousands are slow to make."""
    batched: dict[str, spaces.Space[Any]] = {}
    for name, space in single.items():
        if isinstance(space, spaces.Text):
            batched[name] = spaces.Tuple([space] * count)
        else:
            batched[name] = batch_space(space, count)
    return spaces.Dict(batched)
