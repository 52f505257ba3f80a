"""`VectorEnvDevice`: `VectorEnv` on a GPU, made for training: tensors in, tensors out.

    env = VectorEnvDevice(4096, scenes, sensors=("goal_vector",))
    seen, infos = env.reset(seed=0)
    seen, rewards, terminated, truncated, infos = env.step(actions)  # a torch tensor on the GPU
    forward, left = torch.from_dlpack(seen["goal_vector"]).T

Environment i, seeded with s, plays exactly what `VectorEnv` seeded with s plays: the same episodes,
poses, collisions, distances and rewards, to the bit. A step waits for nothing: it is queued behind
what was queued before, and so are the results.

Where episodes have people, infos also hold `people`, `hit_person`, `hit_by` and `hit_tick`, as
those of `VectorEnv` do, on the device; `hit_by` is a number there: 0 nobody, 1 the agent, 2 the
person.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from gn0.config import whole_number
from gn0.device.device import Device, DeviceArray
from gn0.errors import ConfigError, SimError
from gn0.maps.field_expert import STOP_DISTANCE
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec, Episode
from gn0.progress import Progress
from gn0.render.renderer import Renderer
from gn0.scenes.scene import Scene
from gn0.sim.continuous import build_action_space
from gn0.sim.device_choice import choose_episodes, choose_masked
from gn0.sim.device_eyes import device_reader, refuse_host_sensors
from gn0.sim.device_labels import ExpertDevice, LabelsDevice
from gn0.sim.device_people import CompanyDevice
from gn0.sim.device_sight import admit_people, open_eyes
from gn0.sim.device_state import SimulatorDevice
from gn0.sim.device_states import AgentStates, StatesDevice, pick_agents, pick_rows
from gn0.sim.device_telling import TellingDevice
from gn0.sim.device_walkers import WalkersDevice
from gn0.sim.device_words import LayoutDevice, Observations, WordsDevice, rename_words
from gn0.sim.ego_map import MapView, read_map_view
from gn0.sim.env import build_spaces, picture_names, shape_of_maps
from gn0.sim.env_arguments import (
    check_motions,
    check_settings,
    read_options,
    read_seeds,
)
from gn0.sim.motion import Motion
from gn0.sim.presets import find_preset
from gn0.sim.sensors import (
    SensorConfig,
    check_map_mode,
)
from gn0.sim.tasks import load_tasks
from gn0.sim.words import Vocabulary, WordTable, split_sensors, word_spaces

if TYPE_CHECKING:
    from gn0.avatars.bank import AvatarBank

MEMORY = 2**32  # bytes of maps and distance fields
HOST_MEMORY = 2**31  # bytes of distance fields beside them
AHEAD = 8  # draws held ready an environment


class VectorEnvDevice(gymnasium.vector.VectorEnv[Observations, Any, DeviceArray]):
    """Goal navigation in many scenes at once, on a device; see `VectorEnv` for the task.

    What `reset` and `step` give are DeviceArrays [N, …] (`torch.from_dlpack(x)`), the
    environment's own memory: they hold until the next step or reset, see `copy`. A device has no
    texts: `instruction_tokens` are theirs, `instruction_index` is a number in `episodes`.

    Args:
        num_envs: how many environments.
        scene: a Scene, a scene folder, or several; the built-in two-room flat when absent.
        suite: a suite folder, instead of scenes.
        episodes: episodes or a Parquet file of them; sampled when absent.
        device: where they are; a Device, or a name that `open_device` knows.
        sensors: any of `gn0 list sensors` that a device reads, instruction_tokens and
            instruction_index among them; what is not named is absent.
        preset: camera preset by name.
        renderer: draws colour, depth and BEV: a `Renderer` on the same device, or the name
            of one.
        agent: the body, instead of the preset's.
        max_steps: actions until truncation.
        success_distance: geodesic distance [m] below which STOP succeeds.
        memory: bytes that maps and distance fields may take on the device. What is played, or
            may be within `ahead` episodes, is never dropped, and may take more.
        host_memory: bytes of maps and fields kept in host memory, from where those that made
            room on the device come back.
        ahead: draws held ready an environment. The host looks at the device every `ahead` / 2
            steps; fewer draws keep fewer distance fields there.
        visible_sets: draw from the splats visible near each place, not from all.
        map_mode: what bev and occupancy show, prior or none; the suite's, else prior.
        map_view: squares of the sensor ego_map, and the arrow of the occupancy picture; see
            `gn0.sim.ego_map.MapView`, whose fields it may also be.
        motions: what moves in each scene, by its id, see `gn0.sim.motion`.
        strict: wait after each step with actions from the device, and raise at once if one is
            none; else some steps later, and nobody has moved in the meantime.
        final_pictures: draw for `infos["final_obs"]` what was seen last in episodes that ended.
            This waits for the device.
        action_space: "discrete"; `VectorEnv` has continuous ones.
        copy: what reset and step give are copies; without, it is the environment's memory and
            holds until the next step or reset.
        channels_first: pictures are [N, 3, H, W] rather than [N, H, W, 3].
        history_tile: (width, height) [px] of a view in the mosaic, instead of the preset's.
        vocabulary: how `instruction_tokens` are made, bytes when None; see
            `gn0.sim.words.Vocabulary`, whose fields it may also be.
        bank: of the people of episodes who have names in one, its folder or itself.
        people_memory: bytes that people in poses may take on the device, beside `memory`; 512 MB
            when None. Those who make room are posed again when they are seen.

    Raises:
        ConfigError: an unknown sensor, preset or renderer, maps that agents make themselves,
            continuous actions, or what is not drawn beside people: motions, last pictures.
        EpisodeError: no episode, one of a scene that is not here, or with people whom nobody plays.
        SimError: num_envs < 1 or too many, or an agent whose turns never come full circle.
        DeviceError: no such device here. DeviceMemoryError: it is too small.
        StorageError, FormatError: a file is missing or broken.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (Gymnasium's own declaration)
        "render_modes": [],
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    _company: type[CompanyDevice] = CompanyDevice

    def __init__(
        self,
        num_envs: int = 1,
        scene: Scene | Path | str | Sequence[Scene | Path | str] | None = None,
        suite: Path | str | None = None,
        episodes: Sequence[Episode] | Path | str | None = None,
        *,
        device: Device | str = "auto",
        sensors: Iterable[str] = ("instruction_index", "goal_vector"),
        preset: str | None = None,
        renderer: Renderer | str = "cuda",
        agent: AgentSpec | None = None,
        max_steps: int | None = None,
        success_distance: float = 3.0,
        memory: int = MEMORY,
        host_memory: int = HOST_MEMORY,
        ahead: int = AHEAD,
        visible_sets: bool = False,
        map_mode: str | None = None,
        map_view: MapView | Mapping[str, Any] | None = None,
        motions: Mapping[str, Motion] | None = None,
        strict: bool = False,
        final_pictures: bool = False,
        action_space: str = "discrete",
        copy: bool = False,
        channels_first: bool = False,
        history_tile: tuple[int, int] | None = None,
        vocabulary: Vocabulary | Mapping[str, Any] | None = None,
        bank: AvatarBank | Path | str | None = None,
        people_memory: int | None = None,
    ) -> None:
        check_settings(agent=agent, success_distance=success_distance, history_tile=history_tile)
        self.num_envs = num_envs = whole_number(num_envs, "num_envs", -np.inf)
        self.sensors, words = split_sensors(sensors)
        self.words = rename_words(words)
        self.single_action_space = build_action_space(action_space)
        if action_space != "discrete":
            raise ConfigError(
                f"agents on a device take no {action_space} actions",
                remedy="leave out action_space, or use VectorEnv (gn0/PointNav-v1 and its like)",
            )
        self.success_distance = success_distance
        self.strict, self.final_pictures = strict, final_pictures
        self.tasks = load_tasks(
            scene, suite, episodes, preset=preset, agent=agent, max_steps=max_steps
        )
        self.map_mode = check_map_mode(map_mode or self.tasks.map_mode, self.sensors)
        camera = find_preset(self.tasks.preset, history_tile=history_tile)
        view = read_map_view(map_view)
        config = SensorConfig(
            active=frozenset(self.sensors), preset=camera, map_view=view, map_mode=self.map_mode
        )
        carried = config.carried
        refuse_host_sensors(carried.sensors)
        self._at_once = tuple(
            (s.name, device_reader(s, config)) for s in carried.sensors if s.many is not None
        )
        map_shape = shape_of_maps(self.tasks, self.sensors, camera)
        self.device = _open(device) if isinstance(device, str) else device
        self._config = config
        self._eyes = open_eyes(
            *(config, self.tasks, self.device, num_envs, renderer, map_shape),
            visible_sets=visible_sets,
            motions=check_motions(motions, self.tasks.scenes),
            bank=bank,
            people_memory=people_memory,
            last=final_pictures,
        )
        self._admit(self.tasks.episodes)
        self.simulator = SimulatorDevice(
            num_envs,
            self.device,
            self.tasks.scenes,
            self.tasks.episodes,
            config,
            agent=self.tasks.agent,
            max_steps=self.tasks.max_steps,
            success_distance=success_distance,
            memory=memory,
            host_memory=host_memory,
            ahead=ahead,
            pictures=None if self._eyes is None else self._eyes.open_look,
            company=self._company,
            roles=None if self._eyes is None else self._eyes.roles_of,
        )
        self.copy, self.channels_first = copy, channels_first
        table = None
        if "instruction_tokens" in self.words:
            table = WordTable(self.simulator.store.episodes, vocabulary)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.single_observation_space = spaces.Dict(
            build_spaces(self.sensors, camera, map_shape, channels_first, view)
            | word_spaces(self.words, self.tasks.episodes, table)
            | {"collided": spaces.Discrete(2)}
        )
        moved = picture_names(self.sensors, camera) if channels_first else ()
        self._telling = TellingDevice(
            self.simulator,
            self._eyes,
            self._at_once,
            WordsDevice(self.simulator, self.words, table),
            LayoutDevice(self.simulator, moved, copy),
            tuple(self.single_observation_space.spaces),
            last_pictures=final_pictures,
        )
        self._states = StatesDevice(self.simulator, self._eyes)
        self._everyone = np.arange(num_envs)
        self._expert: ExpertDevice | None = None
        self._begun = False

    @cached_property
    def observation_space(self) -> spaces.Space[Any]:  # type: ignore[override]
        """Of all environments; made when asked for, as its bounds take as much as the pictures."""
        return batch_space(self.single_observation_space, self.num_envs)

    @property
    def episodes(self) -> Sequence[Episode]:
        """Episodes by number, as `infos["episode"]` names them; their texts are here."""
        return self.simulator.store.episodes

    @property
    def scene_ids(self) -> Sequence[str]:
        """Scenes by number, as `infos["scene"]` names them."""
        return self.simulator.store.scene_ids

    @property
    def token_table(self) -> DeviceArray:
        """Tokens int32 [E, L] by number of the episode, as `instruction_index` gives it.

        Raises:
            ConfigError: `instruction_tokens` is not among the sensors.
        """
        return self._telling.words.table

    @property
    def memory(self) -> dict[str, int]:
        """Bytes on the device: maps and fields that are there, pictures of all agents, people."""
        pictures = (
            0 if self._eyes is None else self._eyes.bytes_of(self.num_envs, self.final_pictures)
        )
        found = {"maps and fields": self.simulator.store.pool.held, "pictures": pictures}
        if self.simulator.company:
            found["people"] = self.simulator.company.nbytes
        return found

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin an episode in each environment, or in those of `options["reset_mask"]`.

        Seeds, masks and `options={"episode": …}` are those of `VectorEnv.reset`. Waits for the
        device, and for distance fields of episodes that were not played before.

        Raises:
            EpisodeError: no such episode, or it does not fit its scene.
            ConfigError: seeds or mask of another length or type.
            SimError: a device action before was none.
        """
        options = read_options(options, ("episode", "reset_mask"))
        which = choose_masked(options.get("reset_mask"), self.num_envs, begun=self._begun)
        seeds = read_seeds(seed, self.num_envs)
        chosen = None
        if options.get("episode") is not None:
            chosen = self._choose(options["episode"])[which]
        self._begun = False  # if this fails, all must be reset
        self.simulator.limit_steps(self.tasks.max_steps)
        self.simulator.reset(which, seeds, chosen)
        self._begun = True
        return self._telling.observe(), self._telling.inform()

    def place(
        self,
        episodes: Any,
        poses: Any,
        *,
        agents: Any = None,
        steps: Any = 0,
        collided: Any = False,
        tiles: Any = None,
    ) -> tuple[Observations, dict[str, Any]]:
        """Put agents at poses of episodes, as if they had walked there; it waits for the device.

        Args:
            episodes: ids, indices or Episodes, as `options["episode"]` takes them: one for all, or
                one each.
            poses: [K, 3] x, y [m], yaw [rad]. Any yaw will do; whole turns from the start's, as
                `infos["pose"]` gives them, take no memory.
            agents: [K] their numbers; all when None. The others stay where they are.
            steps: taken so far, one number or [K].
            collided: whether the action before was cut short, one bool or [K].
            tiles: uint8 [K, n, h, w, 3], up to sixteen earlier views, newest first, reduced to
                `CameraPreset.history_tile`; without any the mosaic is black. A DeviceArray or
                anything that NumPy understands.

        Raises:
            SimError: a pose on blocked ground, out of reach of the goal or not finite, named with
                its agent; numbers or tiles of another shape. Then nobody has moved.
            EpisodeError: no such episode, or it does not fit its scene.
            ResetNeeded: the environment was never reset.
        """
        which = self._pick_agents(agents)
        there = self._states.read_places(len(which), poses, steps, collided, tiles)
        self._states.place(which, self._choose(episodes, len(which)), there)
        return self._telling.observe(), self._telling.inform()

    def place_uniform(
        self,
        seed: int,
        *,
        agents: Any = None,
        episodes: Any = None,
        near: tuple[float, float] = (0.0, np.inf),
    ) -> tuple[Observations, dict[str, Any]]:
        """Put agents at random where their goals can be reached from.

        It waits for the device where agents have walked since it was last called.

        The place is uniform over that ground, the heading over those that whole turns lead to. The
        mosaic is black and no step is taken. What is drawn comes from the seed's own stream: the
        k-th of `agents` gets the same, however many there are.

        Args:
            seed: of the stream.
            agents: [K] their numbers; all when None. The others stay where they are.
            episodes: as for `place`; drawn, too, when None.
            near: a share of the agents, and how far from its goal each of them is put at most,
                in metres of way.

        Raises:
            EpisodeError: see `place`; then nobody has moved.
            ResetNeeded: the environment was never reset.
        """
        which = self._pick_agents(agents)
        numbers = None if episodes is None else self._choose(episodes, len(which))
        self._states.place_uniform(int(seed), which, numbers, near)
        return self._telling.observe(), self._telling.inform()

    def turn_agents(self, turns: Any) -> tuple[Observations, dict[str, Any]]:
        """Turn all agents on the spot by whole turns; no step is taken, and nothing is waited for.

        Args:
            turns: int32 [N], to the left where positive; a DeviceArray, or what NumPy understands.

        Raises:
            SimError: another shape or type.
            ResetNeeded: the environment was never reset.
        """
        self._pick_agents(None)
        given = turns if isinstance(turns, DeviceArray) else np.asarray(turns)
        if given.shape != (self.num_envs,) or given.dtype != np.int32:
            raise SimError(
                f"turns are {given.dtype} {given.shape}", remedy=f"give int32 [{self.num_envs}]"
            )
        if not isinstance(given, DeviceArray):
            given = self.device.upload(given)
        self._states.turn(given)
        return self._telling.observe(), self._telling.inform()

    def mute(self, *names: str) -> None:
        """Leave picture sensors out of observations from now on; without names, none.

        Their maps stay where they are, and the others cost what they cost without them: for
        steps of which nobody looks at every picture.

        Raises:
            ConfigError: no such picture sensor is carried, or it is rgb and history is carried.
        """
        if names and self._eyes is None:
            raise ConfigError(f"sensor {names[0]!r} is not carried", remedy="leave it out")
        if self._eyes is not None:
            self._eyes.mute(names)

    def write_tiles(self, out: DeviceArray) -> None:
        """What agents see, reduced as for the mosaic, into uint8 [N, h, w, 3] on the device.

        The tile that `history` keeps of it when the agents act; see `CameraPreset.history_tile`.

        Raises:
            ConfigError: agents see no colours. SimError: memory of another shape.
        """
        if self._eyes is None:
            raise ConfigError("agents see no colours", remedy="carry rgb")
        self._eyes.write_tiles(self.simulator, out)

    def prepare_all(self) -> int:
        """Bring maps, fields and labels' ways of all episodes to the device; how many there are.

        In the order of their numbers, while they fit `memory`: placing agents then costs the host
        no more than looking numbers up. What is there may still make room for others.

        Raises:
            EpisodeError: an episode does not fit its scene.
        """
        return self._find_expert().bring_all(np.unique(self.simulator.numbers))

    def watch_opening(self, progress: Progress) -> None:
        """Tell of scenes in their lights as their splats are loaded; threads that load tell it."""
        if self._eyes is not None:
            self._eyes.watch_opening(progress)

    def expect_labels(self) -> None:
        """Labels will be asked for: what they need of a goal is found with its field from now on.

        Without it the first call of `labels` builds all fields that are played once more.
        """
        self._find_expert()

    def _find_expert(self) -> ExpertDevice:
        if self._expert is None:
            self._expert = ExpertDevice(self.simulator)
        return self._expert

    def save_state(self, agents: Any = None) -> AgentStates:
        """The states of agents [K], or of all, to go on from as often as wanted.

        Episode, pose, steps, tiles of earlier views and the episodes that come next: all that
        decides what follows. Copies of their own on the device; it waits for the device.

        Raises:
            SimError: no such agents.
            ResetNeeded: the environment was never reset.
        """
        return self._states.save(self._pick_agents(agents))

    def restore_state(
        self, states: AgentStates, *, agents: Any = None, rows: Any = None, draws: bool = True
    ) -> tuple[Observations, dict[str, Any]]:
        """Put agents into saved states; it waits for the device.

        Args:
            states: that this environment saved.
            agents: [K] numbers; those that were saved when None, or all where `rows` are as many.
                The others stay where they are.
            rows: [K] rows of the states; all when None. A row may come several times: eight
                answers to 64 states are `rows=np.repeat(np.arange(64), 8)`.
            draws: go on to the episodes that would have followed, too; else to those that come
                next in each environment of its own.

        Raises:
            SimError: states of another environment, or numbers that do not fit them.
            ResetNeeded: the environment was never reset.
        """
        chosen = pick_rows(states, rows)
        if agents is None and rows is None:
            agents = states.agents
        which = self._pick_agents(agents)
        self._states.check(states, which, chosen)
        self._begun = False  # if this fails, all must be reset
        self._states.restore(states, which, chosen, draws=draws)
        self._begun = True
        return self._telling.observe(), self._telling.inform()

    def step(
        self, actions: Any
    ) -> tuple[Observations, DeviceArray, DeviceArray, DeviceArray, dict[str, Any]]:
        """Take one action each: STOP 0, FORWARD 1, LEFT 2, RIGHT 3.

        Args:
            actions: [N] integers: a DeviceArray, a tensor on the same GPU (torch, CuPy, …), or
                anything that NumPy understands.

        Returns:
            observations; rewards float64 [N] m; terminated, truncated bool [N]; infos with
            `episode`, `scene`, `pose`, `distance_to_goal`, `success` and, valid where
            `_final_info` is True, `final_info` and `final_obs` of episodes that ended.

        Raises:
            SimError: wrong shape or type, or no such action; then nobody has moved. Values on
                the device are checked there, see `strict`.
            EpisodeError: an episode among those drawn does not fit its scene.
        """
        self._advance(actions, None, None)
        final = self._telling.inform_last()
        rewards, terminated, truncated = (
            self.simulator.outputs[name] for name in ("rewards", "terminated", "truncated")
        )
        own = self._telling.layout.own
        infos = self._telling.inform() | final
        return self._telling.observe(), own(rewards), own(terminated), own(truncated), infos

    def step_into(
        self, actions: Any, codes: DeviceArray, into: Mapping[str, DeviceArray]
    ) -> Observations:
        """`step`, with results where the caller wants them; see `RolloutCollector`.

        Args:
            actions: as for `step`.
            codes: uint8 [N], where the actions are kept.
            into: outputs by name (`gn0.sim.device_layout.OUTPUT_FIELDS`), in place of our own.
        """
        self._advance(actions, codes, into)
        return self._telling.observe()

    def observe(self) -> Observations:
        """What was last observed.

        Raises:
            ResetNeeded: the environment was never reset.
        """
        if not self._begun:
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        return self._telling.observe_again()

    def labels(self, stop_distance: float = STOP_DISTANCE) -> LabelsDevice:
        """What the expert would do where each agent stands: labels of variant `field`.

        To the bit what `gn0.maps.field_expert.label_field` says of the same places and headings.
        The first call brings what labels need of each goal to the device; from then on a goal's
        comes with its first episode. Waits for nothing else.

        Args:
            stop_distance: STOP within this walking distance of the goal, in line of sight [m].

        Raises:
            ResetNeeded: the environment was never reset.
            SimError: the distance is out of range.
            DeviceMemoryError: maps, fields and what labels need do not fit the device.
        """
        if not self._begun:
            raise gymnasium.error.ResetNeeded("call reset() before labels()")
        return LabelsDevice(
            *map(self._telling.layout.own, self._find_expert().label(stop_distance))
        )

    def _advance(
        self, actions: Any, codes: DeviceArray | None, into: Mapping[str, DeviceArray] | None
    ) -> None:
        if not self._begun:
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        simulator = self.simulator
        simulator.prepare_step()
        codes = simulator.read_actions(actions, codes)
        if self._eyes is not None:
            self._eyes.keep_views(simulator)
        simulator.step(codes, into)
        if self.strict and not isinstance(actions, np.ndarray | list):
            simulator.catch_up()

    def claim(self, navigation: Mapping[str, NavigationMap] | None = None) -> WalkersDevice:
        """The agents themselves, for a rollout; the environment must be reset afterwards.

        Args:
            navigation: scene id → a map that is there already; what is built of it is left with it.
        """
        self._begun = False
        self.simulator.store.ground.lend(navigation or {})
        return WalkersDevice(self.simulator, self._eyes, self._at_once, self.tasks.max_steps)

    def synchronize(self) -> None:
        """Wait until all steps are done.

        Raises:
            SimError: a device action was none; no agent has moved since.
        """
        self.simulator.catch_up()

    def close_extras(self, **kwargs: Any) -> None:
        """Release scenes, renderer and device memory."""
        self._eyes, self._expert, self._begun = None, None, False
        del self.simulator, self._telling, self._states

    def _admit(self, episodes: Sequence[Episode]) -> None:
        """Refuse episodes that cannot be played here.

        Raises:
            EpisodeError: names the first of them.
        """
        admit_people(episodes, self._config, self._eyes)

    def _pick_agents(self, agents: Any) -> NDArray[np.int64]:
        """Numbers [K] of agents, each once; all when None."""
        if not self._begun:
            raise gymnasium.error.ResetNeeded("call reset() first")
        return self._everyone if agents is None else pick_agents(agents, self.num_envs)

    def _choose(self, wanted: Any, count: int | None = None) -> NDArray[np.int64]:
        """Numbers [N] of the episodes named in `options["episode"]`, or of `count`."""
        count = self.num_envs if count is None else count
        own = self.simulator.numbers
        return choose_episodes(wanted, count, own, lambda: self._known, self._add)

    def _add(self, episode: Episode) -> int:
        """The number of an episode that may be a new one."""
        self._telling.words.check(episode)
        self._admit([episode])
        return int(self.simulator.add_episodes([episode])[0])

    @cached_property
    def _known(self) -> dict[str, int]:
        """Indices of the episodes by id; of several with one id the last."""
        return {episode.id: number for number, episode in enumerate(self.tasks.episodes)}


def _open(name: str) -> Device:
    from gn0.device.open import open_device  # a Device that is handed in needs none

    return open_device(name)
