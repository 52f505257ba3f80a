"""Agents on a device put anywhere: at poses of episodes, at random, or back into a saved state."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import DeviceArray
from gn0.errors import EpisodeError, SimError, brief
from gn0.geometry import F64, wrap_angle
from gn0.seeds import random_stream
from gn0.sim.device_layout import blocks_of
from gn0.sim.device_people import KEPT as PEOPLE_ROWS
from gn0.sim.device_queue import Draws
from gn0.sim.device_records import (
    FindPlaces,
    JudgePlaces,
    KeepTiles,
    MoveRows,
    PutAgents,
    TurnAgents,
)
from gn0.sim.device_state import is_on_card
from gn0.sim.ground import list_headings
from gn0.sim.history import LENGTH

if TYPE_CHECKING:
    from gn0.sim.device_eyes import EyesDevice
    from gn0.sim.device_state import SimulatorDevice
    from gn0.sim.device_store import EpisodeStore

_ROWS = ("position", "turns", "steps", "collided", "distance")  # of a state, beside its episode
_FAULTS = {1: "is blocked for an agent of radius {0:g} m", 2: "has no way to the goal"}
_SEARCH = 256  # threads that look for a free cell
_BYTES = 256  # threads a block of kernels that have one a byte


class Ready(NamedTuple):
    """Poses as kernels take them.

    Attributes:
        numbers: [K] of episodes.
        bases: [K] rad, what headings count from; NaN: from the start's.
        turns: [K] whole turns since.
    """

    numbers: NDArray[np.int64]
    bases: F64
    turns: NDArray[np.int32]


class PlacesKept(NamedTuple):
    """Places of episodes that stay on the device.

    Attributes:
        slots: [K] where the episodes are, one reference for each.
        there: the same on the device.
        points: float64 [K, 2] m on the device.
        turns: [K] whole turns since what their headings count from.
    """

    slots: NDArray[np.int32]
    there: DeviceArray
    points: DeviceArray
    turns: NDArray[np.int32]


class Places(NamedTuple):
    """Where agents are to stand.

    Attributes:
        poses: [K, 3] x, y [m], yaw [rad].
        steps: [K] taken so far.
        collided: bool [K], the action before was cut short.
        tiles: uint8 [K, n, h, w, 3], earlier views, newest first.
        views: n; 0 without.
    """

    poses: F64
    steps: NDArray[np.int32]
    collided: NDArray[np.bool_]
    tiles: DeviceArray | None = None
    views: int = 0


@dataclass(frozen=True, eq=False)
class AgentStates:
    """The states of K agents of an environment, to be restored there as often as wanted.

    Attributes:
        agents: int64 [K] whose they were.
        numbers: int64 [K] of the episodes that they play.
        nbytes: bytes that they take on the device.
    """

    agents: NDArray[np.int64]
    numbers: NDArray[np.int64]
    bases: F64
    rows: dict[str, DeviceArray]
    draws: list[Draws]
    store: EpisodeStore

    @property
    def nbytes(self) -> int:
        """Bytes on the device, tiles of earlier views included."""
        return sum(array.nbytes for array in self.rows.values())

    def __len__(self) -> int:
        return len(self.agents)

    def join(self, *others: AgentStates) -> AgentStates:
        """These and others of the same environment as one, row behind row.

        Raises:
            SimError: they are of different environments, or people came in between.
        """
        if any(other.store is not self.store for other in others):
            raise SimError(
                "these states are not of one environment", remedy="join those that it saved itself"
            )
        states = (self, *others)
        if any(set(other.rows) != set(self.rows) for other in others):
            raise SimError(
                "some of these states were saved before there were people",
                remedy="join states of people with each other",
            )
        rows = {}
        for name, array in self.rows.items():
            shape = (sum(len(other) for other in states), *array.shape[1:])
            rows[name] = self.store.device.empty(shape, array.dtype)
            begin = 0
            for other in states:
                part = rows[name][begin : begin + len(other)]
                _move(other.store, other.rows[name], None, None, len(other), part)
                begin += len(other)
        return AgentStates(
            np.concatenate([other.agents for other in states]),
            np.concatenate([other.numbers for other in states]),
            np.concatenate([other.bases for other in states]),
            rows,
            [draws for other in states for draws in other.draws],
            self.store,
        )


class StatesDevice:
    """Puts agents of a simulator where they are wanted.

    Args:
        simulator: theirs.
        eyes: theirs; None without pictures.
    """

    def __init__(self, simulator: SimulatorDevice, eyes: EyesDevice | None) -> None:
        self._simulator, self._eyes = simulator, eyes

    def place(self, agents: NDArray[np.int64], numbers: NDArray[np.int64], places: Places) -> None:
        """Put `agents` [K] at places of episodes `numbers` [K].

        Raises:
            SimError: a pose that is not finite, on blocked ground or out of reach of the goal;
                then nobody has moved.
            EpisodeError: an episode does not fit its scene.
        """
        self._simulator.catch_up()
        self.refuse_people(numbers)
        kept = self.keep(numbers, places.poses, agents)
        simulator, device, count = self._simulator, self._simulator.device, len(agents)
        slots, there, points = kept.slots, kept.there, kept.points
        self._put(agents, slots, there, points, kept.turns, places)
        if places.tiles is not None:
            rings = self._rings()
            assert rings is not None
            size = math.prod(rings.shape[2:])
            keeping = KeepTiles(
                tiles=places.tiles,
                agents=device.upload(agents.astype(np.int32)),
                views=np.int32(places.views),
                size=np.uint64(size),
                count_=np.int32(count),
                rings=rings,
            )
            blocks = blocks_of(size * places.views * count, _BYTES)
            simulator.kernels["keep_tiles"].launch(blocks, _BYTES, keeping)
        simulator.tell_all()

    def refuse_people(self, numbers: NDArray[np.int64]) -> None:
        """Refuse episodes with people for what would leave open where those are.

        Raises:
            EpisodeError: names the first of `numbers` [K] that has people.
        """
        episodes = self._simulator.store.episodes
        for number in np.unique(numbers).tolist():
            if episodes[number].people:
                raise EpisodeError(
                    f"has {len(episodes[number].people)} people, and nobody knows where they are "
                    "when its agent is put somewhere",
                    where=f"episode {episodes[number].id!r}",
                    remedy="begin it with reset(), or go back to it with restore_state()",
                )

    def keep(
        self,
        numbers: NDArray[np.int64],
        poses: F64,
        agents: NDArray[np.int64] | None = None,
    ) -> PlacesKept:
        """Places [K] of episodes, whose slots stay until they are released; waits for the device.

        People of these episodes are not there: see `refuse_people`.

        Raises:
            SimError: as for `place`, naming row k where `agents` [K] are not given.
            EpisodeError: an episode does not fit its scene.
        """
        count = len(numbers)
        names = [f"agent {k}" for k in agents.tolist()] if agents is not None else []
        for k in np.flatnonzero(~np.isfinite(poses).all(1))[:1].tolist():
            who = names[k] if names else f"place {k}"
            raise self._refusal(who, numbers[k], poses[k], "holds NaN or infinity")
        simulator, device = self._simulator, self._simulator.device
        ready = self._read_poses(numbers, poses)
        slots = simulator.store.pin_turned(ready.numbers, ready.bases)
        points = device.upload(np.ascontiguousarray(poses[:, :2]))
        there, verdicts = device.upload(slots), device.zeros(count, np.uint8)
        judging = JudgePlaces(simulator.world, there, points, np.int32(count), verdicts)
        simulator.launch("judge_places", count, judging)
        wrong = verdicts.numpy()
        for k in np.flatnonzero(wrong)[:1].tolist():
            simulator.store.release(slots)
            fault = _FAULTS[int(wrong[k])].format(simulator.store.agent.radius)
            who = names[k] if names else f"place {k}"
            raise self._refusal(who, numbers[k], poses[k], fault)
        return PlacesKept(slots, there, points, ready.turns)

    def read_places(self, count: int, poses: Any, steps: Any, collided: Any, tiles: Any) -> Places:
        """What a caller gives for so many agents.

        Raises:
            SimError: another shape, type or number.
        """
        shown = _as_array(poses, np.float64)
        if shown.shape != (count, 3):
            raise SimError(
                f"poses are {shown.shape}", remedy=f"give x, y and yaw for each of {count} agents"
            )
        taken = _as_array(steps, None)
        most = self._simulator.max_steps
        whole = taken.dtype.kind in "iu" and taken.shape in ((), (count,))
        if not whole or taken.min() < 0 or taken.max() >= most:
            raise SimError(
                f"steps are {taken.dtype} {taken.shape}",
                remedy=f"give whole numbers from 0 to {most - 1}, one or {count} of them",
            )
        hit = _as_array(collided, None)
        if hit.dtype.kind not in "biu" or hit.shape not in ((), (count,)):
            raise SimError(
                f"collided is {hit.dtype} {hit.shape}", remedy=f"give one bool, or {count} of them"
            )
        walked = np.array(np.broadcast_to(taken, (count,)), np.int32)
        cut = np.array(np.broadcast_to(hit != 0, (count,)))
        if tiles is None:
            return Places(shown, walked, cut)
        ring = self._read_tiles(count, tiles)
        return Places(shown, walked, cut, ring, ring.shape[1])

    def _read_tiles(self, count: int, tiles: Any) -> DeviceArray:
        """Earlier views [K, n, h, w, 3] on the device."""
        rings, device = self._rings(), self._simulator.device
        if rings is None:
            raise SimError(
                "no sensor looks at earlier views", remedy="leave out tiles, or carry `history`"
            )
        given = tiles
        if is_on_card(tiles):
            from gn0.device.dlpack import wrap_array  # not needed for our own arrays

            given = wrap_array(tiles, device)
        elif not isinstance(tiles, DeviceArray):
            given = np.ascontiguousarray(_as_array(tiles, None))
        size = rings.shape[2:]
        long = len(given.shape) == 5 and 1 <= given.shape[1] <= LENGTH
        if (
            given.dtype != np.uint8
            or not long
            or (given.shape[0], *given.shape[2:]) != (count, *size)
        ):
            raise SimError(
                f"tiles are {given.dtype} {given.shape}",
                remedy=f"give uint8 [{count}, up to {LENGTH}, {', '.join(map(str, size))}]",
            )
        return given if isinstance(given, DeviceArray) else device.upload(given)

    def place_uniform(
        self,
        seed: int,
        agents: NDArray[np.int64],
        numbers: NDArray[np.int64] | None,
        near: tuple[float, float] = (0.0, math.inf),
    ) -> None:
        """Put `agents` [K] at free places, uniform over where their goals can be reached from.

        A share of them, `near`, is within so many metres of way. The episode, unless `numbers`
        [K] names it, the place and one of the headings that whole turns lead to come from stream
        "uniform states" of the seed, who is near from "near the goal"; row k depends on k alone.

        Raises:
            EpisodeError: an episode does not fit its scene; then nobody has moved.
        """
        simulator, device, count = self._simulator, self._simulator.device, len(agents)
        chances = random_stream(seed, "uniform states").random((count, 5))
        own = simulator.numbers
        if numbers is None:
            numbers = own[(chances[:, 0] * len(own)).astype(np.int64)]
        turns = (chances[:, 1] * simulator.store.circle).astype(np.int32)
        reaches = np.full(count, math.inf)
        reaches[random_stream(seed, "near the goal").random(count) < near[0]] = near[1]
        simulator.settle()
        self.refuse_people(numbers)
        slots = simulator.store.pin(numbers)
        there, points = device.upload(slots), device.zeros((count, 2), np.float64)
        finding = FindPlaces(
            w=simulator.world,
            slots=there,
            chances=device.upload(np.ascontiguousarray(chances[:, 2:])),
            reaches=device.upload(reaches),
            positions=points,
        )
        simulator.kernels["find_places"].launch(count, _SEARCH, finding)
        fresh = Places(np.zeros((0, 3)), np.zeros(count, np.int32), np.zeros(count, np.bool_))
        self._put(agents, slots, there, points, turns, fresh)
        simulator.tell_all()

    def turn(self, turns: DeviceArray) -> None:
        """Turn all agents by so many whole turns int32 [N]; waits for nothing."""
        simulator = self._simulator
        simulator.launch("turn_agents", simulator.count, TurnAgents(simulator.world, turns))
        simulator.say_all()

    def save(self, agents: NDArray[np.int64]) -> AgentStates:
        """The states of `agents` [K], in memory of their own."""
        simulator = self._simulator
        simulator.catch_up()
        slots = simulator.queue.playing(agents)
        chosen = simulator.device.upload(agents.astype(np.int32))
        rows = {}
        for name, array in self._state().items():
            shape = (len(agents), *array.shape[1:])
            rows[name] = simulator.device.empty(shape, array.dtype)
            _move(simulator.store, array, chosen, None, len(agents), rows[name])
        if simulator.company:
            rows |= simulator.company.save(chosen)
        return AgentStates(
            agents.copy(),
            simulator.store.numbers_at(slots),
            simulator.store.bases_at(slots),
            rows,
            simulator.queue.save(agents),
            simulator.store,
        )

    def check(
        self, states: AgentStates, agents: NDArray[np.int64], rows: NDArray[np.int64]
    ) -> None:
        """Refuse what cannot be restored; else wait for the device.

        Raises:
            SimError: states of another environment, not a row for each agent, or an action was
                none, in a step before.
        """
        if states.store is not self._simulator.store:
            raise SimError(
                "these states were saved in another environment",
                remedy="restore them where save_state gave them",
            )
        if len(agents) != len(rows):
            raise SimError(
                f"{len(rows)} saved states for {len(agents)} agents",
                remedy="give as many `rows` as `agents`",
            )
        self._simulator.catch_up()

    def restore(
        self,
        states: AgentStates,
        agents: NDArray[np.int64],
        rows: NDArray[np.int64],
        *,
        draws: bool,
    ) -> None:
        """Put `agents` [K] into the saved states at `rows` [K]; `check` comes first.

        With `draws` they also go on to the episodes that would have followed there.
        """
        simulator = self._simulator
        slots = simulator.store.pin_turned(states.numbers[rows], states.bases[rows])
        to = simulator.device.upload(agents.astype(np.int32))
        chosen = simulator.device.upload(rows.astype(np.int32))
        for name, array in self._state().items():
            _move(simulator.store, states.rows[name], chosen, to, len(agents), array)
        seats = simulator.device.upload(slots)
        _move(simulator.store, seats, None, to, len(agents), simulator.state["slot"])
        if simulator.company and PEOPLE_ROWS[0] in states.rows:
            simulator.company.restore(states.rows, chosen, to)
        simulator.queue.play(agents, slots)
        if draws:
            simulator.queue.restore(agents, [states.draws[k] for k in rows.tolist()])
        simulator.tell_all()

    def _rings(self) -> DeviceArray | None:
        eyes = self._eyes
        return None if eyes is None else eyes.tiles(self._simulator)

    def _state(self) -> dict[str, DeviceArray]:
        """The arrays [N, …] that an agent's state is in, beside its episode."""
        found = {name: self._simulator.state[name] for name in _ROWS}
        found |= self._simulator.company.arrays
        if self._simulator.views is not None:
            found["views"] = self._simulator.views
        rings = self._rings()
        return found if rings is None else found | {"tiles": rings}

    def _put(
        self,
        agents: NDArray[np.int64],
        slots: NDArray[np.int32],
        there: DeviceArray,
        points: DeviceArray,
        turns: NDArray[np.int32],
        places: Places,
    ) -> None:
        simulator, count = self._simulator, len(agents)
        upload = simulator.device.upload
        putting = PutAgents(
            w=simulator.world,
            agents=upload(agents.astype(np.int32)),
            slots=there,
            positions=points,
            turns=upload(turns),
            steps=upload(places.steps),
            views=upload(np.full(count, places.views, np.int32)),
            collided=upload(places.collided),
            count_=np.int32(count),
        )
        simulator.launch("put_agents", count, putting)
        simulator.queue.play(agents, slots)

    def _read_poses(self, numbers: NDArray[np.int64], poses: F64) -> Ready:
        """Headings as whole turns from the start's where they are, else from themselves."""
        store = self._simulator.store
        bases, turns = np.full(len(numbers), np.nan), np.zeros(len(numbers), np.int32)
        known: dict[int, dict[float, int]] = {}
        for k, (number, yaw) in enumerate(zip(numbers.tolist(), poses[:, 2].tolist(), strict=True)):
            if number not in known:
                headings = list_headings(store.episodes[number], store.agent)[:, 0].tolist()
                known[number] = {heading: turn for turn, heading in enumerate(headings)}
            yaw = wrap_angle(yaw)
            if yaw in known[number]:
                turns[k] = known[number][yaw]
            else:
                bases[k] = yaw
        return Ready(numbers, bases, turns)

    def _refusal(self, who: str, number: int, pose: F64, fault: str) -> SimError:
        x, y, yaw = pose.tolist()
        episode = self._simulator.store.episodes[number]
        return SimError(
            f"pose ({x:.3f}, {y:.3f}) m, {yaw:.3f} rad {fault}",
            where=f"{who}, episode {episode.id!r}",
            remedy="give a place from which the goal can be reached; nobody has moved",
        )


def _move(
    store: EpisodeStore,
    source: DeviceArray,
    chosen: DeviceArray | None,
    to: DeviceArray | None,
    count: int,
    target: DeviceArray,
) -> None:
    """Rows `chosen` [K] of an array to rows `to` [K] of another; None: row k."""
    size = source.nbytes // len(source)
    moving = MoveRows(
        in_=source,
        from_=chosen,
        to=to,
        size=np.uint64(size),
        count_=np.int32(count),
        out=target,
    )
    store.kernels["move_rows"].launch(blocks_of(size * count, _BYTES), _BYTES, moving)


def pick_rows(states: AgentStates, rows: Any) -> NDArray[np.int64]:
    """Rows of saved states as int64 [K]; all of them when None.

    Raises:
        SimError: they are no such rows, or no saved states.
    """
    if not isinstance(states, AgentStates):
        raise SimError(
            f"{brief(states)} are not saved states", remedy="give what save_state() returned"
        )
    return np.arange(len(states)) if rows is None else _pick("rows", rows, len(states))


def pick_agents(agents: Any, count: int) -> NDArray[np.int64]:
    """Some of so many agents as int64 [K], each once.

    Raises:
        SimError: they are no such agents, or one comes twice.
    """
    found = _pick("agents", agents, count)
    if len(np.unique(found)) != len(found):
        raise SimError("an agent is named twice", remedy="name each once")
    return found


def _pick(what: str, values: Any, count: int) -> NDArray[np.int64]:
    found = _as_array(values, None)
    whole = found.ndim == 1 and found.size and found.dtype.kind in "iu"
    if not whole or found.min() < 0 or found.max() >= count:
        raise SimError(
            f"{what} are {found.dtype} {found.shape}",
            remedy=f"give whole numbers from 0 to {count - 1}",
        )
    return found.astype(np.int64)


def _as_array(values: Any, dtype: Any) -> NDArray[Any]:
    """Values in host memory."""
    try:
        return np.asarray(values.numpy() if isinstance(values, DeviceArray) else values, dtype)
    except (TypeError, ValueError, OverflowError) as error:
        raise SimError(
            f"a {type(values).__name__} is not an array of numbers ({error})",
            remedy="give what NumPy understands, or a DeviceArray",
        ) from None
