"""`StreamWalks`: stretches of walks, step after step, for policies that remember.

N agents walk side by side; a stretch is T steps of all of them, and the next one begins where it
ends. The expert drives, and in later rounds policies do, too:

    stream = StreamWalks(env, ["rgb", "depth"], view, 32, seed=0)
    stream.begin(0, [])                         # teacher forcing
    stretch = stream.draw()                     # [T, N]

Data aggregation (DAgger, https://arxiv.org/abs/1011.0686) without storing it: in round r agents are
shared out evenly among the expert and the policies of rounds 1 to r, each as it was when its round
began, so that what is drawn has the states of all rounds, and is ever new.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import torch
from torch import Tensor

from gn0.errors import ConfigError, FormatError
from gn0.paper import STOP
from gn0.policies.bae.policy_settings import SQUARE_NAMES
from gn0.seeds import derive_seed, random_stream
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.ego_map import MapView
from gn0.training.streams.agent_places import note_agents, put_agents
from gn0.training.streams.step_ring import find_torch_device
from gn0.training.streams.stream_live import STOP_DISTANCE, check_stream

Beta = Callable[[int], float]


@dataclass(frozen=True)
class Stretch:
    """T steps of N agents, all on one device; its memory is the stream's until the next is drawn.

    Attributes:
        pictures: [T, N, H, W, 3] uint8, depth [T, N, H, W] float32 m, by name.
        texts: int64 [T, N] numbers of instructions.
        last: int64 [T, N] action before; -1 where an episode begins.
        expert: int64 [T, N] what the expert would do.
        turns: bool [T, N] where that is another action than the expert's before, or the first.
        progress: float32 [T, N] share of the way that is behind the agent, -1 to 1; NaN where
            nobody knows.
    """

    pictures: Mapping[str, Tensor]
    texts: Tensor
    last: Tensor
    expert: Tensor
    turns: Tensor
    progress: Tensor


class Driver(Protocol):
    """A policy that drives some of the agents, and does not learn meanwhile.

    Attributes:
        memory: of its agents, on their device.
    """

    memory: Tensor

    def choose(self, pictures: Sequence[Tensor], texts: Tensor, last: Tensor) -> Tensor:
        """Logits [n, 4] of its agents' next actions; it remembers the step.

        Args:
            pictures: [n, ...] each.
            texts: int64 [n] numbers of instructions.
            last: int64 [n] actions before; -1 where an episode begins.
        """
        ...


class StreamWalks:
    """Stretches of walks that go on; resumes exactly at their ends.

    Args:
        env: `VectorEnvDevice`, this stream's alone.
        pictures: by name: rgb, depth, or squares of its ego map.
        view: of the environment's ego map.
        steps: T of a stretch.
        seed: of all that is drawn here.
        beta: round → chance that the expert drives a step of a policy's agent.
        stop_share: chance that a STOP of the policy's, which is not the expert's, is carried out;
            else the expert's action is, so that walks do not end where they begin.
        stop_distance: where labels say STOP [m].

    Raises:
        ConfigError: no steps, or shares out of range.
    """

    def __init__(
        self,
        env: VectorEnvDevice,
        pictures: Sequence[str],
        view: MapView,
        steps: int,
        *,
        seed: int,
        beta: Beta = lambda _: 1.0,
        stop_share: float = 0.2,
        stop_distance: float = STOP_DISTANCE,
    ) -> None:
        if steps < 1 or not 0 <= stop_share <= 1:
            raise ConfigError(
                f"stretches of {steps} steps, stop_share {stop_share}",
                remedy="give a step or more, and a share from 0 to 1",
            )
        self.env, self.view, self.steps, self.seed = env, view, steps, seed
        self.beta, self.stop_share, self.stop_distance = beta, stop_share, stop_distance
        self.device, self.names = find_torch_device(env), tuple(pictures)
        self.round, self.count = 0, 0
        self.drivers: list[Driver] = []
        self._kept: dict[str, Tensor] = {}
        env.expect_labels()
        self._episode = torch.zeros(env.num_envs, dtype=torch.int64, device=self.device)
        self._last = torch.full_like(self._episode, -1)
        self._before = torch.full_like(self._episode, -1)  # of the expert
        self._whole = torch.zeros(env.num_envs, dtype=torch.float64, device=self.device)

    @cached_property
    def texts(self) -> tuple[str, ...]:
        """Instructions by number."""
        return tuple(episode.instruction for episode in self.env.episodes)

    def begin(self, number: int, drivers: Sequence[Driver]) -> None:
        """Begin a round: all agents begin episodes.

        Args:
            number: of the round; 0 is the expert's alone.
            drivers: one for each of the rounds 1 to `number`; driver k, from 0, has the agents
                `share(k + 1)`.
        """
        check_stream(self.device)
        self._set(number, drivers)
        self.env.reset(seed=self._seeds())
        self._read_episodes()
        self._last.fill_(-1)
        self._before.fill_(-1)

    def _set(self, number: int, drivers: Sequence[Driver]) -> None:
        if len(drivers) != number or number >= self.env.num_envs:
            raise ConfigError(
                f"round {number} of {self.env.num_envs} agents with {len(drivers)} policies",
                where="rounds",
                remedy="give one policy a round, and more agents than rounds",
            )
        self.round, self.drivers = number, list(drivers)

    def share(self, number: int) -> slice:
        """The agents of the policy of a round; those of 0 are the expert's."""
        return slice(number, None, self.round + 1)

    def _seeds(self) -> list[int]:
        seed = derive_seed(self.seed, "walks", self.round) % 2**62
        return [seed + i for i in range(self.env.num_envs)]

    def _read_episodes(self) -> None:
        self._episode.copy_(torch.from_dlpack(self.env.simulator.outputs["episode"]))

    def draw(self) -> Stretch:
        """The next T steps; waits for nothing."""
        check_stream(self.device)
        size = (self.steps, self.env.num_envs)
        numbers = torch.empty((3, *size), dtype=torch.int64, device=self.device)
        turns = torch.empty(size, dtype=torch.bool, device=self.device)
        progress = torch.empty(size, dtype=torch.float32, device=self.device)
        for t in range(self.steps):
            labels = self.env.labels(self.stop_distance)
            expert = torch.from_dlpack(labels.actions)[:, 0].long()
            left = torch.from_dlpack(labels.distance)
            begins = self._last < 0
            self._whole = torch.where(begins, left, self._whole)
            self._before.masked_fill_(begins, -1)
            numbers[0, t], numbers[1, t], numbers[2, t] = self._episode, self._last, expert
            turns[t] = expert != self._before
            progress[t] = measure_progress(self._whole, left)
            shown = self._keep(t)
            action = self._choose(expert, shown)
            self._before.copy_(expert)
            self._move(action)
        texts, last, wanted = numbers
        return Stretch(self._kept, texts, last, wanted, turns, progress)

    def _keep(self, t: int) -> list[Tensor]:
        """Copies of the pictures that agents see now, in the order of names."""
        seen = self.env.observe() if self.names else {}
        squares: dict[str, Any] = {}
        if "ego_map" in seen:
            whole: Any = torch.from_dlpack(seen["ego_map"])
            squares = dict(zip(SQUARE_NAMES, self.view.split(whole), strict=False))
        shown = []
        for name in self.names:
            now: Tensor = squares[name] if name in squares else torch.from_dlpack(seen[name])
            if name not in self._kept:
                self._kept[name] = now.new_zeros((self.steps, *now.shape))
            self._kept[name][t].copy_(now)
            shown.append(self._kept[name][t])
        return shown

    def _choose(self, expert: Tensor, shown: Sequence[Tensor]) -> Tensor:
        """What each agent does: int64 [N]."""
        if not self.drivers:
            return expert
        count = len(expert)
        chances = random_stream(self.seed, "walks chances", self.count).random((3, count))
        coins, draws, stops = torch.from_numpy(chances).to(self.device, non_blocking=True)
        action = expert.clone()
        for number, driver in enumerate(self.drivers, 1):
            mine = self.share(number)
            told = driver.choose(
                [one[mine] for one in shown], self._episode[mine], self._last[mine]
            )
            edges = told.double().softmax(-1).cumsum(-1)[:, :-1]
            said = (draws[mine, None] >= edges).sum(-1)
            vetoed = (said == STOP) & (expert[mine] != STOP) & (stops[mine] >= self.stop_share)
            taught = (coins[mine] < self.beta(number)) | vetoed
            action[mine] = torch.where(taught, expert[mine], said)
        return action

    def _move(self, action: Tensor) -> None:
        _, _, terminated, truncated, _ = self.env.step(action.to(torch.uint8))
        ended = (torch.from_dlpack(terminated) | torch.from_dlpack(truncated)).bool()
        self._last = torch.where(ended, -1, action)
        self._read_episodes()
        self.count += 1

    # --- going on where it was left ------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """Where it stands, as JSON, but for `arrays`; waits for the device."""
        return {
            "round": self.round,
            "count": self.count,
            "steps": self.steps,
            "there": note_agents(self.env),
        }

    def arrays(self) -> dict[str, Tensor]:
        """Where it stands, as tensors: copies."""
        found = {"last": self._last, "before": self._before, "whole": self._whole}
        found |= {f"driver_{k}": one.memory for k, one in enumerate(self.drivers)}
        return {name: one.clone() for name, one in found.items()}

    def restore(
        self, state: Mapping[str, Any], arrays: Mapping[str, Tensor], drivers: Sequence[Driver]
    ) -> None:
        """Go on from there: the same stretches follow.

        Args:
            state: of `state`.
            arrays: of `arrays`.
            drivers: of the round.

        Raises:
            ConfigError: the state is of other agents, steps or drivers.
            FormatError: it is none of ours.
        """
        check_stream(self.device)
        try:
            number, count, steps = (int(state[name]) for name in ("round", "count", "steps"))
            there = dict(state["there"])
            self._last.copy_(arrays["last"])
            self._before.copy_(arrays["before"])
            self._whole.copy_(arrays["whole"])
            for k, driver in enumerate(drivers):
                driver.memory.copy_(arrays[f"driver_{k}"])
        except (KeyError, TypeError, ValueError, RuntimeError) as error:
            raise FormatError(f"not the state of walks: {error}", where="stream") from None
        if steps != self.steps:
            raise ConfigError(
                f"stretches of {steps} steps, here are {self.steps}",
                remedy="resume with the settings of the run",
            )
        self._set(number, drivers)
        self.count = count
        put_agents(self.env, self._seeds(), there)
        self._read_episodes()


def measure_progress(whole: Tensor, left: Tensor) -> Tensor:
    """The share of the way that is behind, (d₀ - d) / d₀, as float32.

    Below -1, farther from the goal than twice the way, it is -1: the monitor's tanh says no less.

    Args:
        whole: m to the goal at the start, d₀; 0 or infinite where nobody knows: NaN.
        left: m to the goal, d; likewise.
    """
    known = torch.isfinite(whole) & torch.isfinite(left) & (whole > 0)
    share = (whole - left) / torch.where(known, whole, 1.0)
    return torch.where(known, share, torch.nan).float().clamp(-1, 1)
