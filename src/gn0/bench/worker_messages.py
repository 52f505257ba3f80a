"""Messages between a run and its workers: one JSON line each, checked against a schema."""

from __future__ import annotations

from typing import Any

import msgspec

from gn0.bench.results import EpisodeResult, EpisodeTrace, PolicyCard
from gn0.missions.controls import Control
from gn0.missions.episode import AgentSpec, Episode


class Open(msgspec.Struct, frozen=True, kw_only=True, tag="open"):
    """First message to a worker: which policy, with which body and eyes.

    Attributes:
        policy: plug-in name.
        options: keyword arguments of the policy.
        plugin_modules: modules to import first, so that they can register plug-ins.
        slot: the worker's place among its fellows, 0 for the first; a successor takes it over.
        agents: how many episodes it runs side by side, where the policy can.
        on_device: whether these are on the device that is here, where it can have them.
        isolated: folder below which the policy's own process runs; "" where it runs in the worker.
        drawing: address of the drawing process for all workers; "" where each does itself.
        control: what is taken away from the policy; texts are replaced in the leases.
        bank: folder of the bank of people whom episodes name; "" without one.
        camera, backend, agent, map_mode, max_steps, success_radius, profile: see `SuiteFile`.
    """

    policy: str
    options: dict[str, Any]
    plugin_modules: tuple[str, ...]
    camera: str
    backend: str
    agent: AgentSpec
    max_steps: int
    success_radius: float
    map_mode: str = "prior"
    profile: str = "default"
    slot: int = 0
    drawing: str = ""
    isolated: str = ""
    agents: int = 1
    on_device: bool = False
    control: Control = "none"
    bank: str = ""


class Lease(msgspec.Struct, frozen=True, kw_only=True, tag="lease"):
    """Run this episode in the scene of that folder and hash.

    Attributes:
        alone: not beside others; the worker has no other lease then.
    """

    episode: Episode
    folder: str
    hash: str
    alone: bool = False


class Ready(msgspec.Struct, frozen=True, kw_only=True, tag="ready"):
    """The policy is built.

    Attributes:
        card: who it is.
        alone: why its episodes run one at a time although several were asked for; "" otherwise.
        on_host: why its agents are on the CPU although a device is here for them; "" otherwise.
    """

    card: PolicyCard
    alone: str = ""
    on_host: str = ""


class Refused(msgspec.Struct, frozen=True, kw_only=True, tag="refused"):
    """The policy cannot be built: the run cannot go on.

    Attributes:
        what: what is wrong.
        traceback: for people; "" when `what` says it all.
        remedy: what the user can do.
    """

    what: str
    traceback: str
    remedy: str = ""


class Begun(msgspec.Struct, frozen=True, kw_only=True, tag="begun"):
    """The scene is loaded and the episode starts now: its time limit counts from here."""

    episode: str


class Parted(msgspec.Struct, frozen=True, kw_only=True, tag="parted"):
    """The episode cannot begin beside others: it wants to be leased alone."""

    episode: str


class Done(msgspec.Struct, frozen=True, kw_only=True, tag="done"):
    """The episode is over."""

    result: EpisodeResult
    trace: EpisodeTrace
    seconds: float
    steps: int


class Broke(msgspec.Struct, frozen=True, kw_only=True, tag="broke"):
    """The episode raised an exception.

    Attributes:
        episode: its id.
        what: type and text of the exception.
        traceback: for people.
        beside: others were in progress, and any of them may have raised it.
        fatal: it is not the episode's fault, and every other one would meet it too.
    """

    episode: str
    what: str
    traceback: str
    fatal: bool = False
    beside: bool = False


ToWorker = Open | Lease
FromWorker = Ready | Refused | Begun | Parted | Done | Broke
