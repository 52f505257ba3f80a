"""`StreamCollected`: states that were gathered once, in epochs that have each of them once.

stream = StreamCollected(live, states=300_032, seed=0)
stream.collect(save)
states = stream.draw(512)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.errors import ConfigError, FormatError, SimError
from gn0.seeds import random_stream
from gn0.sim.sensors import MapFrame
from gn0.training.streams.live_counts import LiveCounts
from gn0.training.streams.samples import LabelledStates
from gn0.training.streams.stream_live import StreamLive, check_stream

EVERY = 16  # steps of all agents from saving to saving


class StreamCollected:
    """The first N states of walks, shuffled anew for each epoch.

    An epoch is a permutation that its number and the seed decide; a batch may end one and begin the
    next. Resumes exactly, in mid-collection and in mid-epoch: see `StreamLive.state`.

    Args:
        live: whose agents walk; new, this stream's alone, and its ring keeps all N states.
        states: N.
        seed: of the order, and of which mosaics are black.
        dark: share of samples whose mosaic is black.

    Attributes:
        steps: that all agents take for it; states of the last one may be left over.
        drawn: samples so far.

    Raises:
        ConfigError: no states, or more than the ring keeps.
    """

    def __init__(self, live: StreamLive, states: int, *, seed: int, dark: float = 0.0) -> None:
        self.live, self.states, self.seed, self.dark = live, states, seed, dark
        self.steps, self.drawn = count_steps(states, live.env.num_envs), 0
        if states < 1 or self.steps > live.ring.steps:
            raise ConfigError(
                f"{states} states of a ring that keeps {live.ring.steps * live.env.num_envs}",
                where="states",
                remedy="give 1 or more, and a ring that keeps them all",
            )
        self._order = lru_cache(maxsize=2)(self._shuffle)

    @property
    def texts(self) -> tuple[str, ...]:
        """Instructions by episode number."""
        return self.live.texts

    @property
    def frames(self) -> tuple[MapFrame, ...]:
        """The whole map of each episode, by number."""
        return self.live.frames

    @property
    def whole(self) -> bool:
        """Whether all states are there."""
        return self.live.ring.count >= self.steps

    def collect(self, save: Callable[[], None] | None = None, every: int = EVERY) -> LiveCounts:
        """Let the agents walk until all states are there; nothing if they are.

        Args:
            save: called every so many steps, when `state` may be kept.
            every: steps between two calls.

        Returns:
            What the walks came to, steps before a resume included.
        """
        check_stream(self.live.ring.device)
        while not self.whole:
            if save is not None and self.live.ring.count % every == 0 and self.live.ring.count:
                save()
            self.live.step()
        return self.live.tell(reset=False)

    def count_variety(self) -> tuple[int, int]:
        """Different states (episode and pose, to a mm and a mrad), and different episodes.

        Waits for the device.
        """
        ring = self.live.ring
        episode, pose = (
            ring[name].flatten(0, 1)[: self.states].cpu().numpy() for name in ("episode", "pose")
        )
        rows = np.column_stack([episode, np.rint(1000 * pose).astype(np.int64)])
        return len(np.unique(rows, axis=0)), len(np.unique(episode))

    def draw(self, count: int) -> LabelledStates:
        """The next states.

        Raises:
            SimError: not all are collected.
        """
        if not self.whole:
            raise SimError("states are drawn before all are there", remedy="call collect() first")
        check_stream(self.live.ring.device)
        numbers = self.order(self.drawn, count)
        dark = random_stream(self.seed, "collected samples", self.drawn).random(count) < self.dark
        self.drawn += count
        return self.live.ring.draw(numbers, dark)

    def order(self, begin: int, count: int) -> NDArray[np.int64]:
        """Which states are samples `begin` to `begin + count`, int64 [count]."""
        places = np.arange(begin, begin + count)
        epochs = places // self.states
        found = np.empty(count, np.int64)
        for epoch in np.unique(epochs):
            here = epochs == epoch
            found[here] = self._order(int(epoch))[places[here] % self.states]
        return found

    def _shuffle(self, epoch: int) -> NDArray[np.int64]:
        return random_stream(self.seed, "collected order", epoch).permutation(self.states)

    def state(self) -> dict[str, Any]:
        """Where it stands, as JSON: what `restore` takes; waits for the device."""
        return {"states": self.states, "drawn": self.drawn, "walks": self.live.state()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from there: agents walk again as they did, and the same states follow.

        Raises:
            ConfigError: the state is of another number of states, agents or steps.
            FormatError: it is none of ours.
        """
        walks, drawn = state.get("walks"), state.get("drawn")
        if not (isinstance(walks, Mapping) and type(drawn) is int and drawn >= 0):
            raise FormatError(f"no state of collected states: {drawn!r} drawn", where="stream")
        if state.get("states") != self.states:
            raise ConfigError(
                f"{state.get('states')} states were collected, here are {self.states}",
                remedy="resume with the settings of the run",
            )
        self.live.restore(walks)
        self.drawn = drawn


def count_steps(states: int, agents: int) -> int:
    """Steps of so many agents that give so many states, or a few more."""
    return -(-states // agents)
