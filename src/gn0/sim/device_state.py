"""`SimulatorDevice`: the state of N agents on a device, and the kernels that move them.

The engine under `VectorEnvDevice`, as `SimulatorBatch` is under `VectorEnv`: the same floats. A
step is one launch (two when the actions come from the device), and nothing in it waits for the
device: what the host must know of it, it reads some steps later.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray, Download
from gn0.errors import DeviceError, SimError
from gn0.missions.episode import AgentSpec, Episode
from gn0.scenes.scene import Scene
from gn0.sim.batch import check_actions
from gn0.sim.device_layout import (
    CLEAR,
    OUTPUT_FIELDS,
    OUTPUTS,
    SOURCE,
    THREADS,
    WORLD,
    blocks_of,
    pack_struct,
)
from gn0.sim.device_people import CompanyDevice
from gn0.sim.device_queue import EpisodeQueue
from gn0.sim.device_records import (
    CopyBytes,
    CopyWords,
    FillQueue,
    PlaceAgents,
    ReadActions,
    ReadRanges,
    StepAgents,
)
from gn0.sim.device_store import EpisodeStore, MapPictures
from gn0.sim.env import STEP_COST, SUCCESS_REWARD
from gn0.sim.sensors import SensorConfig

AGENTS_MAX = 2**20
STEPS_MAX = 2**31 - 1
_ON_CARD = (2, 13)  # kDLCUDA, kDLCUDAManaged
_NEXT, _STAY = -2, -1  # what `place_agents` understands beside slots
_STATE = (
    ("slot", np.int32, ()),
    ("position", np.float64, (2,)),
    ("turns", np.int32, ()),
    ("steps", np.int32, ()),
    ("collided", np.bool_, ()),
    ("distance", np.float64, ()),
)


class SimulatorDevice:
    """N agents of one body on a device, each in an episode of its own.

    Args:
        count: N.
        device: where they are.
        scenes: scene id → how to get the scene.
        episodes: to draw from.
        config: their sensors.
        agent: the body.
        max_steps: actions until an episode is truncated.
        success_distance: geodesic distance [m] below which STOP succeeds.
        memory: bytes of maps and fields.
        host_memory: bytes of fields kept on the host.
        ahead: draws held ready for each.
        pictures: look → static map pictures, when they are wanted.
        company: what people around agents are to them.
        roles: episode → what its people bring to their looks, when they are drawn.

    Attributes:
        outputs: what the last step or reset wrote, [N, …] by name; see `device_layout`.
        steps: taken so far.

    Raises:
        SimError: a number out of range, or a turn that never comes full circle.
        DeviceMemoryError: the device is too small.
    """

    def __init__(
        self,
        count: int,
        device: Device,
        scenes: Mapping[str, Callable[[], Scene]],
        episodes: Sequence[Episode],
        config: SensorConfig,
        *,
        agent: AgentSpec,
        max_steps: int,
        success_distance: float,
        memory: int,
        host_memory: int,
        ahead: int,
        pictures: Callable[[str], MapPictures] | None = None,
        company: type[CompanyDevice] = CompanyDevice,
        roles: Callable[[Episode], NDArray[Any]] | None = None,
    ) -> None:
        if not 1 <= count <= AGENTS_MAX or max_steps < 1 or not 1 <= ahead <= 1024:
            raise SimError(
                f"{count} agents of {max_steps} steps with {ahead} draws ahead",
                remedy=f"give 1 to {AGENTS_MAX} agents, a step or more, and 1 to 1024 draws",
            )
        self.count, self.device, self.config = count, device, config
        self.ahead, self.steps, self.max_steps = ahead, 0, max_steps
        self.kernels = device.load(SOURCE)
        rays = None
        if "ranges" in config.active:
            rays = 2 * np.pi * np.arange(config.range_rays) / config.range_rays
        self.store = EpisodeStore(
            *(device, self.kernels, scenes, agent, memory),
            host_memory=host_memory,
            rays=rays,
            pictures=pictures,
            roles=roles,
        )
        self.company = company(self)
        self.numbers = self.add_episodes(episodes)
        self.queue = EpisodeQueue(count, ahead, self.numbers, self.store)
        self.state = {name: device.zeros((count, *shape), kind) for name, kind, shape in _STATE}
        self.views = device.zeros(count, np.int32) if config.carried.views else None
        self._ring = device.zeros((count, ahead), np.int32)
        self._filled = device.zeros(count, np.int32)
        # draws begun [N], then the status words: together, so that one copy tells both
        self._words = device.upload(np.array([0] * count + [CLEAR] * 3, np.int32))
        self._pinned = device.pinned(count + 3, np.int32)
        self._codes = device.zeros(count, np.uint8)
        vectors = "goal_vector" in config.active
        wanted = [f for f in OUTPUT_FIELDS if vectors or not f[0].endswith("goal_vector")]
        self.outputs = {name: device.zeros((count, *shape), kind) for name, kind, shape in wanted}
        self.ranges = self.final_ranges = None
        if rays is not None:
            shape = (count, config.range_rays)
            self.ranges = device.zeros(shape, np.float32)
            self.final_ranges = device.zeros(shape, np.float32)
        self._settings = {
            "forward": agent.forward_step,
            "success_distance": success_distance,
            "step_cost": STEP_COST,
            "success_reward": SUCCESS_REWARD,
            "count": count,
            "ahead": ahead,
            "circle": self.store.circle,
            "max_steps": max_steps,
        }
        self._rows: DeviceArray | None = None
        self._world: np.void | None = None
        self._plain = pack_struct(OUTPUTS, **self.outputs)
        self._stepper = "slide_agents" if agent.sliding else "step_agents"
        self._asked: tuple[int, Download] | None = None
        self._exact = -1  # steps after which the host knew all that had happened
        self._safe = 0  # steps after which the queues may be empty, as far as is known

    def add_episodes(self, episodes: Sequence[Episode]) -> NDArray[np.int64]:
        """Numbers [K] of episodes, with room for their people; nothing is loaded or checked yet."""
        self.company.make_room(episodes, self.store.agent)
        return self.store.add(episodes)

    @property
    def status(self) -> DeviceArray:
        """Words that kernels tell the host of errors with."""
        return self._words[self.count :]

    @property
    def world(self) -> np.void:
        """The struct `World` that kernels take."""
        if self._world is None or self._rows is not self.store.rows:
            self._rows = self.store.rows
            self._world = pack_struct(
                WORLD,
                episodes=self._rows,
                queue=self._ring,
                filled=self._filled,
                cursor=self._words,
                status=self.status,
                views=self.views,
                **self.state,
                **self._settings,
            )
        return self._world

    def launch(self, name: str, items: int, record: NamedTuple) -> None:
        """Run a kernel with a thread for each of `items`."""
        self.kernels[name].launch(blocks_of(items), THREADS, record)

    def reset(
        self,
        which: NDArray[np.int64],
        seeds: Sequence[int | None] | None,
        chosen: NDArray[np.int64] | None,
    ) -> None:
        """Begin episodes with agents `which`: the next drawn, or `chosen` [K] numbers.

        Raises:
            EpisodeError: an episode does not fit its scene; then no agent has moved.
            SimError: an action was none, in a step before.
        """
        self.catch_up(fill=False)
        self.queue.seed(which, seeds)
        orders = np.full(self.count, _STAY, np.int32)
        self._fill()
        if chosen is None:
            orders[which] = _NEXT
        else:
            orders[which] = self.store.pin(chosen)
            self.queue.play(which, orders[which])
        self._begin(orders)
        self._exact = -1
        self._safe = self.steps + self.ahead - (chosen is None)

    def place(self, which: NDArray[np.int64], chosen: NDArray[np.int64]) -> None:
        """Begin episodes `chosen` [K] with agents `which`, and make none ready to follow them.

        For agents that do not end over there: see `limit_steps`.

        Raises:
            EpisodeError, PlanError: an episode does not fit its scene; then no agent has moved.
        """
        orders = np.full(self.count, _STAY, np.int32)
        orders[which] = self.store.pin(chosen)
        self.queue.play(which, orders[which])
        self._begin(orders)

    def _begin(self, orders: NDArray[np.int32]) -> None:
        slots = self.device.upload(orders)
        if self.company:
            self.company.place(slots, self._plain)
        else:
            self.launch("place_agents", self.count, PlaceAgents(self.world, slots, self._plain))
        self._sense()

    def limit_steps(self, most: int) -> None:
        """Truncate episodes after so many actions from now on."""
        if most != self._settings["max_steps"]:
            self._settings["max_steps"], self._world = most, None

    def say_all(self) -> None:
        """Write anew what all sense where they stand; waits for nothing."""
        self._begin(np.full(self.count, _STAY, np.int32))

    def tell_all(self) -> None:
        """After agents were put elsewhere: fill queues, and say what all sense where they stand."""
        self._fill()
        self.say_all()
        self._safe = self.steps + self.ahead

    def read_actions(self, actions: Any, codes: DeviceArray | None = None) -> DeviceArray:
        """Actions [N] as codes uint8 [N] on the device, into `codes` when given.

        Those that are on the device already are checked there: see `catch_up`.

        Raises:
            SimError: wrong shape or type, or an invalid host action; then nobody has moved.
        """
        codes = self._codes if codes is None else codes
        if not isinstance(actions, DeviceArray):
            if not is_on_card(actions):
                found = check_actions(actions, self.count).astype(np.uint8)
                return self.device.upload(found, codes)
            from gn0.device.dlpack import wrap_array  # not needed for our own arrays

            actions = wrap_array(actions, self.device)
        if actions.shape != (self.count,) or actions.dtype.kind not in "iu":
            raise SimError(
                f"actions are {actions.dtype} {actions.shape}",
                remedy=f"give {self.count} integers: STOP 0, FORWARD 1, LEFT 2, RIGHT 3",
            )
        reading = ReadActions(
            w=self.world,
            actions=actions,
            width=np.int32(actions.dtype.itemsize),
            step=np.int32(self.steps),
            codes=codes,
        )
        self.launch("read_actions", self.count, reading)
        return codes

    def step(self, codes: DeviceArray, into: Mapping[str, DeviceArray] | None = None) -> None:
        """Take one action each; see `outputs`, some of which may go elsewhere: `into` [N, …].

        `prepare_step` comes first.
        """
        outputs = self._plain
        if into:
            outputs = pack_struct(OUTPUTS, **(self.outputs | dict(into)))
        if self.company:
            self.company.step(codes, outputs)
        else:
            self.launch(self._stepper, self.count, StepAgents(self.world, codes, outputs))
        self.steps += 1
        if self.final_ranges is not None:
            slots, poses = self.outputs["final_slot"], self.outputs["final_pose"]
            turns = self.outputs["final_turns"]
            self._read_ranges(slots, poses, turns, self.final_ranges, "final_")
        self._sense()

    def _sense(self) -> None:
        if self.ranges is not None:
            self._read_ranges(
                self.state["slot"], self.outputs["pose"], self.state["turns"], self.ranges
            )

    def _read_ranges(
        self,
        slots: DeviceArray,
        poses: DeviceArray,
        turns: DeviceArray,
        out: DeviceArray,
        prefix: str = "",
    ) -> None:
        rays = self.config.range_rays
        reading = ReadRanges(
            w=self.world,
            slots=slots,
            poses=poses,
            turns=turns,
            rays=np.int32(rays),
            limit=np.float64(self.config.range_limit),
            out=out,
        )
        self.launch("read_ranges", self.count * rays, reading)
        if self.company:
            self.company.shorten(slots, poses, turns, out, prefix)

    def prepare_step(self) -> None:
        """See to it that each agent has a next episode, whatever the coming step brings.

        Waits for the device only if it is `ahead` steps behind.

        Raises:
            EpisodeError: an episode that is drawn does not fit its scene.
            SimError: an action was none, in a step before; no agent has moved since.
        """
        if self._safe - self.steps > self.ahead // 2:
            return
        if self._asked is None:
            self._asked = (self.steps, self.device.download_async(self._words, self._pinned))
        if self._asked[1].done or self.steps >= self._safe:
            self._learn(*self._asked)

    def catch_up(self, fill: bool = True) -> None:
        """Wait for the device and learn what has happened there; then fill the queues.

        Raises:
            SimError: an action was none, in a step before; no agent has moved since.
        """
        self._asked = (self.steps, self.device.download_async(self._words, self._pinned))
        self._learn(*self._asked, fill=fill)

    def settle(self) -> None:
        """`catch_up`, unless nobody has moved since the last one: then it waits for nothing."""
        if self._exact != self.steps:
            self.catch_up()

    def _learn(self, at: int, download: Download, fill: bool = True) -> None:
        words = download.numpy()
        self._asked = None
        agent, empty, step = words[self.count :].tolist()
        if agent != CLEAR:
            self.device.upload(np.full(3, CLEAR, np.int32), self.status)
            late, self.steps = self.steps - step, step
            self._safe = step
            raise SimError(
                f"an action {late} steps ago was not one of 0..3; no agent has moved since",
                where=f"agent {agent}",
                remedy="give STOP 0, FORWARD 1, LEFT 2 or RIGHT 3",
            )
        if empty != CLEAR:
            raise DeviceError(
                "an episode ended and none was ready to follow",
                where=f"agent {empty}",
                remedy="reset the environment, and report this",
            )
        self.queue.advance(words[: self.count])
        if at == self.steps:
            self._exact = at
        if fill:
            self._fill()
            self._safe = at + self.ahead

    def _fill(self) -> None:
        filled = self.queue.refill()
        if filled is not None:
            entries, count = filled
            filling = FillQueue(
                w=self.world,
                list=self.device.upload(entries),
                entries=np.int32(count),
                queue=self._ring,
                filled=self._filled,
            )
            self.launch("fill_queue", max(self.count, count), filling)

    def copy(self, source: DeviceArray, target: DeviceArray) -> None:
        """Copy an array on the device into another of the same size."""
        wide = source.nbytes % 4 == 0 and not (source.pointer | target.pointer) & 3
        size = source.nbytes // (4 if wide else 1)
        record = (CopyWords if wide else CopyBytes)(source, np.uint64(size), target)
        kernel = self.kernels["copy_words" if wide else "copy_bytes"]
        kernel.launch(blocks_of(size, 256), 256, record)


def is_on_card(actions: Any) -> bool:
    """Whether an array of another library lies in the memory of a GPU."""
    try:
        return int(actions.__dlpack_device__()[0]) in _ON_CARD
    except (AttributeError, TypeError, BufferError, RuntimeError):
        return hasattr(actions, "__cuda_array_interface__")
