"""`StreamLive`: samples of agents that walk while a model learns, driven by expert or policy.

Every step that an agent takes is a labelled state in a `StepRing`, and batches are drawn uniformly
out of it. How many steps are taken before which batch follows from the number of samples alone.

    stream = StreamLive(env, StepRing(env, 400), seed=0)
    states = stream.draw(512)

Order on a card: the environment works on the legacy default stream, which is torch's default
stream, too. So what is drawn is ready for what torch is told next, and the environment's next step
comes behind what torch was told before; neither waits. `draw` refuses another current stream.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gn0.errors import ConfigError, FormatError, SimError
from gn0.paper import FORWARD, STOP
from gn0.policies.bae.draws import NEVER
from gn0.seeds import derive_seed, random_stream
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.device_labels import LabelsDevice
from gn0.sim.sensors import MapFrame
from gn0.training.inputs import InputMixture
from gn0.training.streams.agent_places import (
    pack_array,
    pack_places,
    place_agents,
    read_places,
    unpack_array,
    unpack_places,
)
from gn0.training.streams.live_counts import COUNTED, LiveCounts
from gn0.training.streams.samples import LabelledStates
from gn0.training.streams.step_ring import StepRing

STOP_DISTANCE = 1.0  # m, of the labels that policies are trained on
Driver = Callable[..., Tensor]  # of `LabelledStates`, and of draws where there are any


@dataclass(frozen=True)
class Drawing:
    """Whose answers are drawn, so that no policy turns left and right for ever.

    Attributes:
        after: actions without getting anywhere.
        slots: of an answer, each with a number of its own.
    """

    after: int
    slots: int


class StreamLive:
    """Samples of walks that go on while they are drawn.

    Resumes exactly, whoever drives: `state` holds where all agents stood some time ago and what
    each has done since, so `restore` walks that way again, draws the pictures that were in the
    ring once more, and goes on from there with the same bytes. This takes as long as drawing a
    ring of pictures, and at most twice as many steps as it keeps. The rest is the driver's: one
    that remembers something or learns must itself be as it was.

    Args:
        env: `VectorEnvDevice`, this stream's alone; `ego_map` of it is muted.
        ring: of this environment, empty.
        seed: of everything that is drawn here.
        ratio: new states a sample.
        fill: steps before the first batch; 64, or what the ring keeps if less, when None.
        driver: actions int64 [N], or the next K of each agent [N, K] (it is then asked every K
            steps; who begins an episode meanwhile follows the expert until then). It is given
            states whose pictures are made when they are looked at. None: the expert. Or one for
            each of a policy's inputs, by name, with
        inputs: how often which of them drives: one for all agents from decision to decision.
            None: `driver` is one alone.
        beta: samples drawn so far → chance that the expert drives an agent until the next
            decision; 0 when None.
        stop_share: chance that a STOP which is not the expert's is carried out; else the expert's
            action is.
        confirm: like `driver`, the one of the same input, asked again about STOPs behind the first
            action of an answer before they are carried out, [M] or [M, K] actions of M agents;
            None: nobody is.
        confirmed: M, of which further ones at the same step follow the expert for that step; an
            eighth of the agents when None.
        drawing: whose answers are drawn. The drivers are then given numbers, too, float32
            [N, slots] in [0, 1), and below 0 of agents whose answer is the most probable one.
        rescue: actions that led nowhere after which the expert drives an agent until the next
            decision, so that one which stands at a wall is not hundreds of states; 0: never.
        stop_distance: where labels say STOP [m].
        dark: share of samples whose mosaic is black.
        lazy: pictures are made when they are looked at, before the next draw; those that nobody
            looks at cost nothing.

    Raises:
        ConfigError: a number out of range, or a ring that is not empty or another environment's.
    """

    def __init__(
        self,
        env: VectorEnvDevice,
        ring: StepRing,
        *,
        seed: int,
        ratio: float = 0.5,
        fill: int | None = None,
        driver: Driver | Mapping[str, Driver] | None = None,
        inputs: Mapping[str, float] | None = None,
        beta: Callable[[int], float] | None = None,
        stop_share: float = 0.2,
        confirm: Driver | Mapping[str, Driver] | None = None,
        confirmed: int | None = None,
        drawing: Drawing | None = None,
        rescue: int = 0,
        stop_distance: float = STOP_DISTANCE,
        dark: float = 0.1,
        lazy: bool = False,
    ) -> None:
        fill = min(64, ring.steps) if fill is None else fill
        shares_right = all(0 <= share <= 1 for share in (stop_share, dark))
        if not (0 < ratio <= 1000 and fill >= 1 and shares_right and rescue >= 0):
            raise ConfigError(
                f"ratio {ratio}, fill {fill}, stop_share {stop_share}, dark {dark}, "
                f"rescue {rescue}",
                remedy="give a ratio above 0, a step or more, shares from 0 to 1, and 0 or more "
                "actions",
            )
        if ring.env is not env or ring.count:
            raise ConfigError("a ring that is in use", remedy="give a new StepRing of the env")
        self.env, self.ring, self.seed = env, ring, seed
        self.ratio, self.fill, self.lazy = ratio, fill, lazy
        self.driver, self.beta = driver, beta
        self.inputs = InputMixture(inputs, derive_seed(seed, "live inputs")) if inputs else None
        for one in (driver, confirm):
            if one is not None and isinstance(one, Mapping) != (self.inputs is not None):
                raise ConfigError(
                    "shares of inputs and one driver, or several drivers and no shares",
                    where="inputs",
                    remedy="give a driver and a share for each input, or one driver alone",
                )
            if isinstance(one, Mapping) and one.keys() != (inputs or {}).keys():
                raise ConfigError(
                    f"drivers of {', '.join(one)} for inputs {', '.join(inputs or {})}",
                    where="inputs",
                    remedy="give a driver for each input",
                )
        self.stop_share, self.stop_distance, self.dark = stop_share, stop_distance, dark
        self.drawn = 0
        count, self._device = env.num_envs, ring.device
        self.confirm, self.confirmed = confirm, count_confirmed(count)
        if confirmed is not None:
            self.confirmed = confirmed
        self.drawing, self.rescue = drawing, rescue
        self._last = torch.full((count,), -1, dtype=torch.int8, device=self._device)
        self._idle = torch.zeros(count, dtype=torch.int32, device=self._device)
        self._plan: Tensor | None = None  # of the policy [N, K], −1 where the expert drives
        self._at = 0  # in the plan
        self._log = torch.zeros((2 * ring.steps, count), dtype=torch.uint8, device=self._device)
        self._bases: list[tuple[int, dict[str, NDArray[Any]]]] = []
        self._tally = torch.zeros(len(COUNTED) - 1, dtype=torch.int64, device=self._device)
        self._steps = 0
        self._mute()
        self._views = "rgb" in env.sensors
        env.expect_labels()
        self._begin()

    @cached_property
    def texts(self) -> tuple[str, ...]:
        """Instructions by episode number."""
        return tuple(episode.mission.instruction for episode in self.env.episodes)

    @property
    def frames(self) -> tuple[MapFrame, ...]:
        """The whole map of each episode, by number."""
        return self.ring.frames

    def draw(self, count: int) -> LabelledStates:
        """The next states, uniform over the ring; first the steps that are due are taken.

        Raises:
            ConfigError: torch's current stream is not its default one.
        """
        check_stream(self._device)
        self._walk_on(count)
        stream = random_stream(self.seed, "live samples", self.drawn)
        numbers = stream.integers(*self.ring.window, size=count)
        dark = stream.random(count) < self.dark
        self.drawn += count
        return self.ring.draw(numbers, dark, **({"lazy": True} if self.lazy else {}))

    def _walk_on(self, count: int) -> None:
        due = self.fill + int(self.ratio * (self.drawn + count) / self.env.num_envs)
        while self.ring.count < due:
            self.step()

    def step(self) -> None:
        """Put the states that agents are in into the ring, and let each take a step."""
        if self.ring.count % self.ring.steps == 0:
            self._note()
        labels = self._look()
        expert = torch.from_dlpack(labels.actions)[:, 0]
        actions = self._choose(expert)
        self._move(actions)

    def _look(self) -> LabelsDevice:
        labels = self.env.labels(self.stop_distance)
        self.ring.put(labels, self._last)
        return labels

    def _choose(self, expert: Tensor) -> Tensor:
        """What each agent does: uint8 [N]."""
        if self._plan is None or self._at >= self._plan.shape[1]:
            self._decide()
        if self._plan is None:
            return expert.to(torch.uint8)
        if self.confirm is not None and self._at:
            self._ask_again()
        said = self._plan[:, self._at]
        self._at += 1
        asked = said >= 0
        stops = random_stream(self.seed, "live stops", self.ring.count).random(len(said))
        kept = self.ring._send(stops < self.stop_share)
        vetoed = (said == STOP) & (expert != STOP) & ~kept
        due, stopped = asked & (expert == STOP), said == STOP
        self._count("asked", asked, asked & (said == expert))
        self._count("due", due, stopped, due & stopped)
        return torch.where(asked & ~vetoed, said, expert).to(torch.uint8)

    def _decide(self) -> None:
        """Ask the policy; who is driven by the expert has −1 in the plan."""
        self._plan, self._at = None, 0
        beta = 0.0 if self.beta is None else self.beta(self.drawn)
        if self.driver is None or beta >= 1:
            return
        driver = self._pick(self.driver, self.ring.count)
        plan = _ask(driver, self.ring.latest(), self._draw_numbers())
        if beta > 0:
            coins = random_stream(self.seed, "live drivers", self.ring.count)
            expert = self.ring._send(coins.random(len(plan)) < beta)
            plan = plan.masked_fill(expert[:, None], -1)
        if self.rescue:
            plan = plan.masked_fill((self._idle >= self.rescue)[:, None], -1)
        self._plan = plan.clone()

    def _pick(self, driver: Driver | Mapping[str, Driver], step: int) -> Driver:
        """The driver of a decision that was made when the ring had counted so many steps."""
        if not isinstance(driver, Mapping):
            return driver
        assert self.inputs is not None  # checked when it was made
        return driver[self.inputs.choose(step)]

    def _draw_numbers(self) -> Tensor | None:
        """Numbers by which the answers of who gets nowhere are drawn."""
        if self.drawing is None:
            return None
        stream = random_stream(self.seed, "live draws", self.ring.count)
        numbers = stream.random((len(self._idle), self.drawing.slots), np.float32)
        lost = self._idle >= self.drawing.after
        return self.ring._send(numbers).masked_fill(~lost[:, None], float(NEVER))

    def _ask_again(self) -> None:
        """Ask anew who is about to stop by an answer of steps ago; waits for nothing."""
        assert self._plan is not None and self.confirm is not None
        plan, at = self._plan, self._at
        wanted = plan[:, at] == STOP
        rows = torch.argsort(wanted.to(torch.int8), descending=True, stable=True)[: self.confirmed]
        again = self._pick(self.confirm, self.ring.count - at)  # of who said so
        numbers = self._draw_numbers()
        draws = None if numbers is None else numbers[rows]
        answers = _ask(again, self.ring.latest().pick(rows), draws)
        left = min(plan.shape[1] - at, answers.shape[1])
        chosen, own = wanted[rows], plan[rows]
        own[:, at : at + left] = torch.where(
            chosen[:, None], answers[:, :left], own[:, at : at + left]
        )
        without_room = wanted.index_fill(0, rows, False)
        plan[:, at].masked_fill_(without_room, -1)
        plan[rows] = own

    def _count(self, name: str, *masks: Tensor) -> None:
        """Add to a count and those behind it."""
        at = COUNTED.index(name) - 1
        self._tally[at : at + len(masks)] += torch.stack([mask.sum() for mask in masks])

    def _move(self, actions: Tensor) -> None:
        """All take a step; `ring.count` counts it already."""
        self._log[(self.ring.count - 1) % len(self._log)] = actions
        seen, _, terminated, truncated, infos = self.env.step(actions)
        ended = torch.from_dlpack(terminated) | torch.from_dlpack(truncated)
        self._last = torch.where(ended, -1, actions.to(torch.int8)).to(torch.int8)
        if self._plan is not None:
            self._plan.masked_fill_(ended[:, None], -1)
        forward = actions == FORWARD
        hit = torch.from_dlpack(seen["collided"]).bool()
        hit = torch.where(ended, torch.from_dlpack(infos["final_obs"]["collided"]).bool(), hit)
        self._idle = (self._idle + 1).masked_fill_(ended | (forward & ~hit), 0)
        arrived = torch.from_dlpack(infos["final_info"]["success"])
        self._count("forwards", forward, forward & hit, ended, ended & arrived)
        self._steps += 1

    def tell(self, *, reset: bool = True) -> LiveCounts:
        """What happened on the way; waits for the device."""
        found = LiveCounts(self._steps * self.env.num_envs, *self._tally.tolist())
        if reset:
            self._tally.zero_()
            self._steps = 0
        return found

    # --- going on where it was left ------------------------------------------------------------

    def _mute(self, *more: str) -> None:
        self.env.mute(*(("ego_map",) if "ego_map" in self.env.sensors else ()), *more)

    def _begin(self) -> None:
        self.env.reset(seed=self._seeds())

    def _seeds(self) -> list[int]:
        seed = derive_seed(self.seed, "live episodes") % 2**62
        return [seed + i for i in range(self.env.num_envs)]

    def _note(self) -> None:
        """Note where all stand; what was noted before the last time but one is not needed."""
        found = {
            **read_places(self.env),
            "last": self._last.cpu().numpy().copy(),
            "idle": self._idle.cpu().numpy().copy(),
        }
        self._bases = [*self._bases[-1:], (self.ring.count, found)]

    def state(self) -> dict[str, Any]:
        """Where it stands, as JSON: what `restore` takes; waits for the device.

        About two bits for each state that the ring holds, twice.
        """
        base, found = self._base_of(self.ring.count)
        rows = np.arange(base, self.ring.count) % len(self._log)
        log = self._log.cpu().numpy()[rows] if len(rows) else np.zeros((0, 0), np.uint8)
        plan = None
        if self._plan is not None:
            plan = self._plan.cpu().numpy()
        there = {}
        if found:
            there = {
                **pack_places(found),
                "last": pack_array(found["last"], np.int8),
                "idle": pack_array(found["idle"], np.int32),
            }
        return {
            "drawn": self.drawn,
            "steps": self.ring.count,
            "agents": self.env.num_envs,
            "ring": self.ring.steps,
            "base": base,
            "there": there,
            "actions": pack_array(pack_actions(log), np.uint8),
            "plan": None if plan is None else pack_array(plan, np.int8),
            "at": self._at,
            "told": [self._steps, *self._tally.tolist()],
        }

    def _base_of(self, count: int) -> tuple[int, dict[str, NDArray[Any]]]:
        """The latest note from which all that the ring holds was walked."""
        oldest = max(count - self.ring.steps, 0)
        known = [(step, found) for step, found in self._bases if step <= oldest]
        return known[-1] if known else (0, {})

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from there: the same states follow.

        Raises:
            ConfigError: the state is of other agents or another ring.
            FormatError: it is none of ours.
        """
        check_stream(self._device)
        env, ring = self.env, self.ring
        if (state.get("agents"), state.get("ring")) != (env.num_envs, ring.steps):
            raise ConfigError(
                f"a stream of {state.get('agents')} agents and {state.get('ring')} steps, here are "
                f"{env.num_envs} and {ring.steps}",
                remedy="resume with the settings of the run",
            )
        try:
            base, count = int(state["base"]), int(state["steps"])
            rows = (count - base, env.num_envs)
            log = unpack_actions(unpack_array(state["actions"], np.uint8, None), rows)
            there = state["there"]
            if there:
                last = unpack_array(there["last"], np.int8, (env.num_envs,))
                idle = unpack_array(there["idle"], np.int32, (env.num_envs,))
                there = unpack_places(there, env.num_envs)
            plan, at, drawn = state["plan"], int(state["at"]), int(state["drawn"])
            steps, *told = map(int, state.get("told", [0] * len(COUNTED)))  # older ones have none
            if len(told) != len(COUNTED) - 1:
                raise ValueError(f"{len(told)} counts")
            later = None
            if plan is not None:
                later = unpack_array(plan, np.int8, None).reshape(env.num_envs, -1)
        except (KeyError, TypeError, ValueError, zlib.error) as error:
            raise FormatError(f"not a live stream's state: {error}", where="stream") from None
        self._bases, self._plan, self._at = [], None, 0
        self._last.fill_(-1)
        self._idle = torch.zeros_like(self._idle)
        self._mute()
        self._begin()
        ring.skip(base)
        if there:
            place_agents(env, self._seeds(), there)
            self._last.copy_(torch.from_numpy(last.copy()))
            self._idle.copy_(torch.from_numpy(idle.copy()))
        self._again(log, count)
        self._plan = None if later is None else torch.from_numpy(later.copy()).to(self._device)
        self._at, self.drawn, self._steps = at, drawn, steps
        self._tally.copy_(torch.tensor(told))

    def _again(self, log: NDArray[np.uint8], count: int) -> None:
        """Take steps anew; pictures are drawn of those that the ring is to hold."""
        ring, env = self.ring, self.env
        silent = self._views and "history" not in env.sensors
        for row in log:
            if ring.count % ring.steps == 0:
                self._note()
            actions = torch.from_numpy(row.copy()).to(self._device)
            if ring.count < count - ring.steps:
                if silent:
                    self._mute("rgb")
                ring.skip(ring.count + 1)
                if ring.count >= count - ring.steps:
                    self._mute()
            else:
                self._look()
            self._move(actions)


def count_confirmed(agents: int) -> int:
    """How many of so many agents are asked again about a STOP at once, at most."""
    return max(1, agents // 8)


def _ask(driver: Driver, states: LabelledStates, draws: Tensor | None) -> Tensor:
    """A policy's actions int8 [N, K]."""
    with torch.no_grad():
        plan = driver(states) if draws is None else driver(states, draws)
    plan = plan.to(torch.int8)
    plan = plan[:, None] if plan.ndim == 1 else plan
    if plan.ndim != 2 or len(plan) != len(states) or not plan.shape[1]:
        raise SimError(
            f"the policy gave actions {tuple(plan.shape)}",
            remedy=f"give [{len(states)}] or [{len(states)}, K] actions",
        )
    return plan


def check_stream(device: torch.device) -> None:
    """Refuse a current stream of torch's that the simulator's work is not in order with.

    Raises:
        ConfigError: it is not the default one.
    """
    if device.type == "cuda":
        default = torch.cuda.default_stream(device)
        if torch.cuda.current_stream(device) != default:
            raise ConfigError(
                "states are drawn on a stream of their own",
                remedy="draw outside of `torch.cuda.stream(…)`; graphs may replay there",
            )


def pack_actions(actions: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Actions of any shape, four a byte."""
    flat = actions.ravel()
    quads = np.append(flat, np.zeros(-len(flat) % 4, np.uint8)).reshape(-1, 4)
    found: NDArray[np.uint8] = (quads << np.array([0, 2, 4, 6], np.uint8)).sum(1, dtype=np.uint8)
    return found


def unpack_actions(packed: NDArray[np.uint8], shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Actions of `pack_actions`.

    Raises:
        ValueError: there are not so many.
    """
    flat = (packed[:, None] >> np.array([0, 2, 4, 6], np.uint8)).ravel()
    found: NDArray[np.uint8] = (flat & np.uint8(3))[: shape[0] * shape[1]].reshape(shape)
    return found
