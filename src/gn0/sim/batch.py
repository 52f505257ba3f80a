"""Many agents in many scenes, stepped together: the engine under `VectorEnv`.

Each agent is a `Simulator` of its own in all but memory and speed: the same poses, collisions,
ends and observations, bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.errors import SimError
from gn0.geometry import F32, F64, Pose2D
from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import AgentSpec
from gn0.scenes.scene import Scene
from gn0.sim.batch_eyes import BatchEyes, OpenPeople, Snapshot
from gn0.sim.batch_kernels import (
    AgentArrays,
    EpisodeArrays,
    place_agents,
    read_goal_vectors,
    read_poses,
    read_ranges,
    step_agents,
)
from gn0.sim.batch_people import CompanyBatch
from gn0.sim.batch_tables import EpisodeTable, MapTable
from gn0.sim.ground import GroundStore
from gn0.sim.open import name_look
from gn0.sim.sensors import SensorConfig
from gn0.sim.state import OBSERVED

if TYPE_CHECKING:
    from gn0.sim.sensors import SensorSuite

FIELD_MEMORY = 512 * 2**20  # bytes of geodesic fields


class BatchStep(NamedTuple):
    """Outcome of one action each.

    Attributes:
        progress: [N] m, geodesic distance gained.
        stopped: [N], the agent said STOP.
        truncated: [N], the step limit was reached.
    """

    progress: F64
    stopped: NDArray[np.bool_]
    truncated: NDArray[np.bool_]


class AgentsHere:
    """Agents where they stand now; see `gn0.sim.sensor.sensor.Agents`.

    Args:
        batch: in which they are.
        which: [K] their numbers.
        limit: goal vectors are clipped to ±limit [m].
    """

    def __init__(self, batch: SimulatorBatch, which: NDArray[np.int64], limit: float) -> None:
        self._batch, self._which, self._limit = batch, which, limit

    def poses(self) -> F64:
        """[K, 3] x, y [m], yaw [rad]."""
        return self._batch.poses(self._which)

    def goal_vectors(self) -> F32:
        """[K, 2] forward, left [m]."""
        out = np.empty((len(self._which), 2), np.float32)
        read_goal_vectors(self._which, *self._batch.known(), np.float32(self._limit), out)
        return out

    def ranges(self) -> F32:
        """[K, R] m."""
        config = self._batch.config
        rays = 2 * np.pi * np.arange(config.range_rays) / config.range_rays
        agents, episodes = self._batch.known()
        out = np.empty((len(self._which), len(rays)), np.float32)
        read_ranges(
            *(self._which, agents, self._batch.table.maps.arrays, episodes),
            *(rays, float(config.range_limit), out),
        )
        self._batch.company.limit_ranges(self._which, agents, episodes, rays, out)
        return out


class SimulatorBatch:
    """N agents of one body, each in an episode of its own.

    Args:
        count: N.
        scenes: scene id → how to get the scene; each is loaded when first needed.
        config: sensors they carry, and cameras.
        agent: the body; the preset's when None.
        max_steps: actions until an episode is truncated.
        open_suite: scene id → the sensors of one agent in that scene; needed for pictures.
        scenes_kept: picture-making scenes held while no agent is in them.
        field_memory: bytes that geodesic fields may take.
        navigation: scene id → a map that is there already; what is built of it is left with it.
        open_people: scene id and its sensors → what shows people; needed for pictures of them.

    Raises:
        SimError: a number out of range, a turn that never comes full circle, or pictures asked
            for without `open_suite`.
    """

    def __init__(
        self,
        count: int,
        scenes: Mapping[str, Callable[[], Scene]],
        config: SensorConfig,
        *,
        agent: AgentSpec | None = None,
        max_steps: int = 500,
        open_suite: Callable[[str], SensorSuite] | None = None,
        scenes_kept: int = 4,
        field_memory: int = FIELD_MEMORY,
        navigation: Mapping[str, NavigationMap] | None = None,
        open_people: OpenPeople | None = None,
    ) -> None:
        if count < 1 or max_steps < 1:
            raise SimError(
                f"{count} agents of {max_steps} steps", remedy="allow at least one of each"
            )
        self.count = count
        self.config = config
        self.agent = agent or config.preset.agent
        self.max_steps = max_steps
        ground = GroundStore(scenes, self.agent.radius, lent=navigation)
        self.table = EpisodeTable(MapTable(ground), self.agent, field_memory)
        self.state = AgentArrays(
            np.full(count, -1, np.int32),
            np.zeros((count, 2)),
            np.zeros(count, np.int32),
            np.zeros(count, np.int32),
            np.zeros(count, np.bool_),
            np.zeros(count),
        )
        self.company = CompanyBatch(count, self.agent, ground, self.table.episodes)
        self._everyone = np.arange(count)
        self.eyes: BatchEyes | None = None
        self._at_once = tuple(s for s in config.carried.sensors if s.many is not None)
        self._strange = {
            s.name: s.find_space(config) for s in self._at_once if s.name not in OBSERVED
        }
        later = sorted(s.name for s in config.carried.sensors if s.many is None)
        if later:
            if open_suite is None:
                raise SimError(
                    f"sensors {later} need pictures",
                    remedy="use VectorEnv, or hand open_suite to SimulatorBatch",
                )
            self.eyes = BatchEyes(count, config, open_suite, scenes_kept, self.agent, open_people)

    @property
    def sensors(self) -> frozenset[str]:
        """What each agent carries."""
        return self.config.active

    def place(self, which: NDArray[np.int64], chosen: NDArray[np.int64]) -> None:
        """Begin episodes `chosen` [K] (numbers of `table`) with agents `which` [K].

        Raises:
            EpisodeError: see `Simulator.reset`; then no agent has moved.
        """
        table = self.table
        table.prepare(chosen, self.state.episode)
        self.company.prepare(chosen, self.state.episode)
        place_agents(which, chosen, self.state, table.maps.arrays, table.fields, table.arrays)
        self.company.place(which, chosen, self.state)
        table.touch(chosen)
        if self.eyes is not None:
            self.eyes.begin(which)

    def step(self, actions: NDArray[np.integer]) -> BatchStep:
        """Take one action 0..3 each.

        Raises:
            SimError: wrong shape or type, or an invalid action; then no agent has moved.
        """
        codes = check_actions(actions, self.count)
        if self.eyes is not None:
            self.eyes.keep_views()
        step = BatchStep(
            np.empty(self.count), np.empty(self.count, np.bool_), np.empty(self.count, np.bool_)
        )
        self._move(codes, self.state, self.table.arrays, self.agent.forward_step, step)
        return step

    def _move(
        self,
        codes: NDArray[np.int64],
        agents: AgentArrays,
        episodes: EpisodeArrays,
        forward: float,
        step: BatchStep,
        shares: F64 | None = None,
    ) -> None:
        """Take one action each, people with it where an environment has some."""
        table = self.table
        known = (codes, agents, table.maps.arrays, table.fields, episodes)
        body = forward, bool(self.agent.sliding), self.max_steps
        if self.company:
            self.company.step(*known, *body, step, shares)
        else:
            step_agents(*known, *body, *step)

    def poses(self, which: NDArray[np.int64] | None = None) -> F64:
        """Poses [K, 3] (x, y [m], yaw [rad]) of agents `which`, or of all."""
        chosen = self._everyone if which is None else which
        out = np.empty((len(chosen), 3))
        read_poses(chosen, *self.known(), out)
        return out

    def observe(
        self, which: NDArray[np.int64] | None = None, limit: float = np.inf
    ) -> dict[str, Any]:
        """What agents `which` [K] sense where they stand, an array [K, …] a sensor.

        Goal vectors are clipped to ±limit [m]. Pictures come from `look`.
        """
        chosen = self._everyone if which is None else which
        agents = AgentsHere(self, chosen, limit)
        found: dict[str, Any] = {}
        for sensor in self._at_once:
            space = self._strange.get(sensor.name)
            if space is not None:
                found[sensor.name] = sensor.measure_many(agents, space, len(chosen))
            elif sensor.many is not None:
                found[sensor.name] = sensor.many(agents)
        return found

    def known(self) -> tuple[AgentArrays, EpisodeArrays]:
        """Agents and their episodes, as the kernels read them."""
        return self.state, self.table.arrays

    def pose(self, agent: int) -> Pose2D:
        """The pose of one agent."""
        return Pose2D(*self.poses(np.array([agent]))[0].tolist())

    def snapshot(self, which: NDArray[np.int64] | None = None) -> Snapshot | None:
        """What `draw` needs to know of agents `which` as they stand now; None without pictures."""
        if self.eyes is None:
            return None
        chosen = self._everyone if which is None else which
        episodes = [self.table.episodes[n] for n in self.state.episode[chosen].tolist()]
        scenes = [name_look(episode) for episode in episodes]
        steps = self.state.steps[chosen].tolist()
        people = [self.company.state_of(i) for i in chosen.tolist()]
        return self.eyes.snapshot(chosen, scenes, self.poses(chosen), episodes, steps, people)

    def draw(self, snapshots: Sequence[Snapshot]) -> list[dict[str, Any]]:
        """The pictures of snapshots, arrays or lists [K, …] a sensor; see `BatchEyes.draw`.

        To be called after every `place` and `step`, the last snapshot being of all agents moved.
        """
        assert self.eyes is not None
        return self.eyes.draw(snapshots)


def check_actions(actions: Any, count: int) -> NDArray[np.int64]:
    """Actions as int64 [N].

    Raises:
        SimError: wrong shape or type, or a value outside 0..3.
    """
    codes = np.asarray(actions)
    if codes.shape != (count,) or codes.dtype.kind not in "iu":
        raise SimError(
            f"actions are {codes.dtype} {codes.shape}",
            remedy=f"give {count} integers: STOP 0, FORWARD 1, LEFT 2, RIGHT 3",
        )
    if codes.min() < 0 or codes.max() > 3:
        bad = int(np.flatnonzero((codes < 0) | (codes > 3))[0])
        raise SimError(
            f"{codes[bad]} is not an action",
            where=f"agent {bad}",
            remedy="give STOP 0, FORWARD 1, LEFT 2 or RIGHT 3",
        )
    return np.ascontiguousarray(codes, np.int64)
