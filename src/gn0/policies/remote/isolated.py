"""A policy of any kind in a process of its own, behind the socket protocol.

It shares no memory with the harness, is given no path of suite or scene, and runs in an empty
folder; it has the same user, so files are not isolated. Chance and observations are the very ones
that it gets in-process, so its results are the same bytes.
"""

from __future__ import annotations

import os
import queue
import secrets
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import msgspec
import numpy as np

from gn0.errors import PolicyError
from gn0.jobs.process import WorkerProcess, count_cores
from gn0.policies.remote.client import RemoteClient
from gn0.policies.remote.extension import KEY, ObservationSender
from gn0.policies.remote.own_process import BUILD_LIMIT, Introduction, Told
from gn0.seeds import save_stream
from gn0.sim.state import AnyAction, Displacement, Observation, Teleport

# says where the scenes are, where we stand, or opens other doors
_KEPT_BACK = ("GN0_DATA", "GN0_TOKEN", "PWD", "OLDPWD", "_")


class _Elsewhere(Exception):  # noqa: N818
    """A traceback of the policy's own process."""


class PolicyIsolated:
    """Starts the process, and asks it for every action.

    Args:
        policy: plug-in name.
        options: its keyword arguments.
        plugin_modules: modules that it imports first; they are not imported here.
        folder: an empty folder to run in; made when it is not there.
        paths: its import path.
        request_timeout: seconds until an action that does not come counts as hung.

    Raises:
        PolicyError: it cannot be built, or is handed the simulator and so cannot be isolated.
    """

    def __init__(
        self,
        policy: str,
        options: Mapping[str, Any],
        plugin_modules: Sequence[str],
        *,
        folder: Path,
        paths: Sequence[str],
        request_timeout: float = 1e6,
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        lines: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        threads = os.environ.get("OMP_NUM_THREADS", "")
        self._process = WorkerProcess(
            "gn0.policies.remote.own_process",
            lines.put,
            int(threads) if threads.isdigit() else count_cores(),
            paths,
            folder=folder,
            left_out=_KEPT_BACK,
        )
        token = secrets.token_urlsafe()
        told = Told(
            policy=policy, options=dict(options), plugin_modules=tuple(plugin_modules), token=token
        )
        self._process.send(msgspec.json.encode(told))
        about = self._read(lines)
        self.name = about.name
        self.sensors = cast("frozenset[str]", frozenset(about.sensors))
        self._about = about
        self._client = RemoteClient(
            about.url, connect_timeout=5.0, request_timeout=request_timeout, token=token
        )
        self._sender = ObservationSender()
        self._episodes = 0
        self._notes: dict[str, int] = {}
        self._first = ""
        self._instruction = ""

    def _read(self, lines: queue.SimpleQueue[bytes | None]) -> Introduction:
        try:
            line = lines.get(timeout=BUILD_LIMIT)
        except queue.Empty:
            ended = self._process.end()
            raise PolicyError(
                f"it was not built within {BUILD_LIMIT:g} s", remedy="see where it hangs"
            ) from None
        try:
            about = msgspec.json.decode(line or b"", type=Introduction)
        except msgspec.DecodeError:
            ended = self._process.end()
            raise PolicyError(
                f"its own process {ended.how}\n{ended.last_words}", remedy="see its last words"
            ) from None
        if about.fault:
            self._process.end()
            raise PolicyError(about.fault, remedy=about.remedy)
        return about

    @property
    def card_rows(self) -> tuple[tuple[str, str], ...]:
        """Rows of its own for the protocol card."""
        return self._about.rows

    def identity(self) -> dict[str, str]:
        """What it declares itself to be."""
        return dict(self._about.identity)

    def notes(self) -> dict[str, int]:
        """What it says was odd in this episode."""
        return dict(self._notes)

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode; its process is told with the first question."""
        self._episodes += 1
        self._instruction, self._first = instruction, save_stream(rng)
        self._notes = {}
        self._sender.reset()

    def act(self, observation: Observation) -> AnyAction:
        """Its next action.

        Raises:
            PolicyError: it raised an exception, or its process is gone.
        """
        payload: dict[str, Any] = {
            "endpoint": "infer",
            "instruction": self._instruction,
            "session_id": f"episode {self._episodes}",  # a number: names say where it is
            KEY: self._sender.pack(observation),
        }
        if observation.rgb is not None:
            payload["images"] = observation.rgb
        if self._first:
            payload[KEY]["stream"], self._first = self._first, ""
        try:
            reply = self._client.request(payload)
        except PolicyError as error:
            if self._client.connected:
                raise
            ended = self._process.end()
            raise PolicyError(
                f"its own process {ended.how}\n{ended.last_words}".rstrip(), remedy=error.remedy
            ) from None
        try:
            return self._understand(reply)
        except (KeyError, TypeError, ValueError, AttributeError):
            raise PolicyError("its own process does not answer as it should") from None

    def _understand(self, reply: Any) -> AnyAction:
        if "fault" in reply:
            raise PolicyError(str(reply["fault"])) from _Elsewhere(f"\n{reply['traceback']}")
        self._notes = {str(what)[:200]: int(count) for what, count in reply["notes"].items()}
        said, values = reply["said"], reply["values"]
        if said == "teleport":
            return Teleport(*map(float, values))
        if said == "displacement":
            return Displacement(*map(float, values))
        action: AnyAction = values  # the simulator says what is no action
        return action

    def close(self) -> None:
        """End its process."""
        self._client.close()
        self._process.end()
