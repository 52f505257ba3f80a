"""Times each kernel of a step among people, and counts what everybody does.

`python -m gn0_figures.tune --people` prints it for 0, 1, 5 and 8 people around 4,096 agents, as in
`gn0 figures people.sim.cuda` (a tiny case on the host emulation). Nothing is written.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import msgspec
import numpy as np

from gn0.device.device import Device, DeviceArray, Event, Kernel
from gn0.missions.episode import Episode
from gn0.people.reach import (
    ASIDE_LEFT,
    BLOCKED_BY,
    CLIP,
    MODE,
    NOBODY,
    ROUND,
    TURNED,
    WALK,
    X,
)
from gn0.scenes.scene import Scene
from gn0.seeds import random_stream
from gn0.sim.device_env import VectorEnvDevice
from gn0_figures.device import is_emulation, median
from gn0_figures.device_rates import WALK as ACTIONS
from gn0_figures.device_rates import measure_rate
from gn0_figures.people_sim import FOLLOWER, plan_episodes

PEOPLE = (0, 1, 5, 8)
ENVS = 4096
SETTLED = 60  # steps before the first that counts: people have met each other by then
BUSY = 2**28  # bytes that are copied before a step, so that its launches wait in the queue
_COPY = "copy_words"


@dataclass(frozen=True, eq=False)
class Clock:
    """Moments around launches.

    Attributes:
        device: has the clock.
        marks: name of a kernel, before it, after it.
    """

    device: Device
    marks: list[tuple[str, Event, Event]] = field(default_factory=list)

    def read(self) -> dict[str, float]:
        """Milliseconds by kernel since the last time."""
        spent: dict[str, float] = defaultdict(float)
        for name, begin, end in self.marks:
            spent[name] += self.device.elapsed(begin, end)
        self.marks.clear()
        return spent


class ClockedKernel:
    """A kernel whose launches a clock notes; see `gn0.device.device.Kernel`."""

    def __init__(self, kernel: Kernel, clock: Clock) -> None:
        self.name = kernel.name
        self.kernel, self.clock = kernel, clock

    def launch(
        self,
        grid: int | tuple[int, ...],
        block: int | tuple[int, ...],
        record: NamedTuple,
        *,
        shared: int = 0,
    ) -> None:
        """Run it between two events."""
        begin = self.clock.device.event()
        self.kernel.launch(grid, block, record, shared=shared)
        self.clock.marks.append((self.kernel.name, begin, self.clock.device.event()))


def clock_kernels(env: VectorEnvDevice) -> Clock:
    """Have every launch of a simulator noted from now on."""
    clock, simulator = Clock(env.device), env.simulator
    company: Any = simulator.company
    wrapped: list[dict[str, Kernel]] = [
        {name: ClockedKernel(kernel, clock) for name, kernel in kernels.items()}
        for kernels in (simulator.kernels, company.kernels)
    ]
    simulator.kernels, company._kernels = wrapped
    return clock


def time_kernels(
    env: VectorEnvDevice, actions: Sequence[DeviceArray], settled: int
) -> dict[str, tuple[float, float]]:
    """Median and longest milliseconds of each kernel of a step, after so many `settled` steps.

    A card that waits for launches would count the waiting: it copies something before each step.
    """
    clock = clock_kernels(env)
    size = 64 if is_emulation(env.device) else BUSY
    blocks = [env.device.zeros(size, np.uint8) for _ in range(2)]
    spent: dict[str, list[float]] = defaultdict(list)
    for t, row in enumerate(actions):
        for _ in range(4):
            env.simulator.copy(*blocks)
        env.step(row)
        env.device.synchronize()
        taken = clock.read()
        for name, value in taken.items() if t >= settled else ():
            if name != _COPY:
                spent[name].append(value)
    return {name: (median(values), max(values)) for name, values in spent.items()}


def time_queue(env: VectorEnvDevice, actions: Sequence[DeviceArray]) -> tuple[float, float]:
    """Milliseconds that the host takes for a step, and until the device is done with one."""
    env.device.synchronize()
    start = time.perf_counter()
    for row in actions:
        env.step(row)
    queued = time.perf_counter()
    env.device.synchronize()
    done = time.perf_counter()
    return tuple((t - start) * 1e3 / len(actions) for t in (queued, done))  # type: ignore[return-value]


def count_people(env: VectorEnvDevice) -> dict[str, float]:
    """Shares of what everybody does now, and how many of a block leave their path for somebody."""
    company = env.simulator.company
    whole, told = company.read_state("whole"), company.outputs["people"].numpy()
    there = ~np.isnan(told[..., X])
    mode, total = whole[..., MODE], max(int(there.sum()), 1)
    aside = there & (mode == ROUND)
    shares = {
        "walk on their path": there & (mode != ROUND) & (whole[..., CLIP] == WALK),
        "stand": there & (mode != ROUND) & (whole[..., CLIP] != WALK),
        "are blocked": there & (whole[..., BLOCKED_BY] != NOBODY),
        "go round": aside & (whole[..., ASIDE_LEFT] == 0),
        "squeeze": aside & (whole[..., ASIDE_LEFT] == 0) & (whole[..., TURNED] % 4 > 1),
        "make room": aside & (whole[..., ASIDE_LEFT] > 0),
    }
    blocks = np.add.reduceat(aside.sum(axis=1), np.arange(0, len(aside), company.lanes))
    return {name: float(who.sum()) / total for name, who in shares.items()} | {
        "of a block go round or make room, on average": float(blocks.mean()),
        "of a block go round or make room, at most": float(blocks.max()),
    }


def list_lines(device: Device, most: Sequence[int] = PEOPLE) -> Iterator[str]:
    """What there is to print, with up to so many people an environment each."""
    tiny = is_emulation(device)
    count, steps, settled = (16, 2, 1) if tiny else (ENVS, 160, SETTLED)
    scenes, episodes = plan_episodes(*((1, 2) if tiny else (8, 32)), most=max(most))
    drawn = random_stream(0, "figure actions").choice(4, (steps, count), p=ACTIONS)
    uploaded = device.upload(drawn.astype(np.int64))
    actions = [uploaded[t] for t in range(steps)]
    for people in most:
        env = _open(device, count, scenes, episodes, people)
        env.reset(seed=0)
        for row in actions[:settled]:
            env.step(row)
        host, whole = time_queue(env, actions[settled:])
        yield (
            f"{people} people: {host:.4f} ms a step on the host, {whole:.4f} ms until it is done, "
            f"{count / whole * 1e3:,.0f} agent-steps/s; by events {measure_rate(env, steps):,.0f}"
        )
        env.reset(seed=0)
        for name, (middle, longest) in time_kernels(env, actions, settled).items():
            yield f"  {name:16} {middle:8.4f} ms, at most {longest:8.4f}{_say_size(env, name)}"
        if people:
            yield from (f"  {value:8.3f} {name}" for name, value in count_people(env).items())
        del env


def _open(
    device: Device,
    count: int,
    scenes: Sequence[Scene],
    episodes: Sequence[Episode],
    people: int,
) -> VectorEnvDevice:
    some = [msgspec.structs.replace(e, people=e.people[:people]) for e in episodes]
    return VectorEnvDevice(
        count, scenes, episodes=some, device=device, agent=FOLLOWER, sensors=("goal_vector",)
    )


def _say_size(env: VectorEnvDevice, name: str) -> str:
    """Registers and local memory of a kernel, where the device tells."""
    kernels = {**env.simulator.kernels, **env.simulator.company.kernels}
    kernel: Any = kernels[name]
    resources = getattr(kernel.kernel, "resources", None)
    if resources is None:
        return ""
    found = resources()
    return (
        f"; {found.registers} registers, {found.local} B local and {found.shared} B shared memory"
    )
