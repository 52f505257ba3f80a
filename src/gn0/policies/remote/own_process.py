"""The process of an isolated policy: builds it, says what it is, and serves it to one client.

Started by `gn0.policies.remote.isolated` as `python -m gn0.policies.remote.own_process`.
"""

from __future__ import annotations

import operator
import traceback
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import msgspec
import numpy as np

from gn0.bench.identity import read_identity
from gn0.errors import Gn0Error
from gn0.geometry import U8
from gn0.jobs.child import open_channel
from gn0.plugins import build_plugin, describe_error
from gn0.policies.remote.server import PolicyServer
from gn0.sim.policy import Policy, PolicyNotes, PolicyPrivileged
from gn0.sim.state import Displacement, Observation, Teleport

BUILD_LIMIT = 900.0  # s


class Told(msgspec.Struct, frozen=True, kw_only=True):
    """All that the process is told: which policy, and the word by which its client is known."""

    policy: str
    options: dict[str, Any]
    plugin_modules: tuple[str, ...]
    token: str


class Introduction(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What the process says of itself, once.

    Attributes:
        url: where it serves.
        name, sensors, rows, identity: see `gn0.bench.results.PolicyCard`.
        fault: why it cannot serve; "" when it does.
        remedy: what to do about that.
    """

    url: str = ""
    name: str = ""
    sensors: tuple[str, ...] = ()
    rows: tuple[tuple[str, str], ...] = ()
    identity: tuple[tuple[str, str], ...] = ()
    fault: str = ""
    remedy: str = ""


class AnswererExact:
    """A policy that is answered for word by word: nothing is converted, faults are told."""

    def __init__(self, policy: Policy) -> None:
        self.policy = policy
        self.name = str(policy.name)
        self.sensors: frozenset[str] = frozenset(policy.sensors)
        self._fault: dict[str, str] | None = None

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._fault = None
        try:
            self.policy.reset(instruction, rng)
        except Exception as error:
            self._fault = _tell_fault(error)

    def answer(self, observation: Observation, frames: Sequence[U8]) -> dict[str, Any]:
        """One action, as it was said."""
        if self._fault is not None:
            return self._fault
        try:
            said, values = _spell(self.policy.act(observation))
            notes = self.policy.notes() if isinstance(self.policy, PolicyNotes) else {}
        except Exception as error:
            return _tell_fault(error)
        return {"said": said, "values": values, "notes": notes}


def _spell(action: Any) -> tuple[str, Any]:
    if isinstance(action, Teleport):
        return "teleport", [float(v) for v in action]
    if isinstance(action, Displacement):
        return "displacement", [float(v) for v in action]
    try:
        return "action", action if isinstance(action, bool) else operator.index(action)
    except TypeError:
        return "nothing", repr(action)[:200]


def _tell_fault(error: Exception) -> dict[str, str]:
    return {"fault": describe_error(error), "traceback": traceback.format_exc()[-20_000:]}


def introduce(told: Told) -> tuple[Introduction, PolicyServer | None]:
    """Build the policy and a server for it; or say why not."""
    try:
        for module in told.plugin_modules:
            import_module(module)
        policy = build_plugin("policy", told.policy, told.options)
        if isinstance(policy, PolicyPrivileged):
            return Introduction(
                fault=f"policy {told.policy!r} is handed the simulator, which is elsewhere",
                remedy="run it without --isolate: it is an oracle",
            ), None
        identity = read_identity(policy)
        server = PolicyServer(lambda: AnswererExact(policy), port=0, token=told.token)
    except Gn0Error as error:
        what = f"{error.where}: {error.what}" if error.where else error.what
        return Introduction(fault=what, remedy=error.remedy), None
    except Exception as error:
        return Introduction(
            fault=f"{describe_error(error)}\n{traceback.format_exc()}",
            remedy="see the traceback above",
        ), None
    return Introduction(
        url=server.url,
        name=str(policy.name),
        sensors=tuple(sorted(policy.sensors)),
        rows=policy.card_rows if isinstance(policy, PolicyNotes) else (),
        identity=identity,
    ), server


def main() -> int:
    """Serve until the parent is gone."""
    inbox, say = open_channel()
    about, server = introduce(msgspec.json.decode(inbox.get(), type=Told))
    say(msgspec.json.encode(about))
    if server is None:
        return 1
    server.serve_forever()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
