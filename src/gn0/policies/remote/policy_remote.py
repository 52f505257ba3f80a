"""A policy that lives in a server: `gn0 bench run SUITE --policy remote`.

It speaks the released GN-Bench protocol. Pictures are gathered while the actions of an answer are
carried out and sent with the next question; moves in metres and radians are carried out in the
agent's own frame, so the server needs no pose and gets none unless asked for.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from gn0.errors import ConfigError, PolicyError
from gn0.geometry import U8
from gn0.paper import TURN_DEGREES
from gn0.policies.remote.answers import (
    ActionFormat,
    Answer,
    Delta,
    build_displacement,
    is_stop,
    read_answer,
)
from gn0.policies.remote.client import RemoteClient
from gn0.policies.remote.extension import (
    KEY,
    Greeting,
    ObservationSender,
    read_greeting,
)
from gn0.policies.text import find_parser
from gn0.sim.policy import SLOT_VARIABLE
from gn0.sim.state import Action, AnyAction, Observation

UNIDENTIFIED = "unidentified"  # of a server that does not say who it is
FRAMES_KEPT = 64  # pictures since the last question, at least


class PolicyRemote:
    """Asks a server what to do.

    Args:
        url: the server's address.
        ports: several servers on the host of `url`, one for each worker in turn: a list, or
            "8001,8002".
        action_num: actions of an answer that are carried out before the next question.
        action_format: auto, discrete or nav_delta: what the answers are, if they do not say so.
        translation_frame: chunk_start: the translations of an answer refer to the heading at the
            time of the question; current: to the heading reached. Turns add up in both.
        answers: whose words the server answers with: navid, uninavid or navila; "" for none.
        turn_degrees: the agent's turn, of which the turns of such words are made [degrees].
        pose: tell the server x, y [m] and yaw [rad] with each question.
        stop_eps: a move with all its numbers within this is a STOP [m, rad].
        max_translation, max_yaw: longest step [m] and turn [rad] of an answer; 0 leaves them.
        connect_timeout, request_timeout, metadata_timeout: see `RemoteClient` [s].
        name: what the policy is called in results.

    Raises:
        ConfigError: an option has no meaning.
        PolicyError: no server answers.
    """

    def __init__(
        self,
        url: str = "ws://127.0.0.1:8000",
        *,
        ports: str | int | Sequence[int] = (),
        action_num: int = 8,
        action_format: ActionFormat = "auto",
        translation_frame: str = "chunk_start",
        answers: str = "",
        turn_degrees: float = TURN_DEGREES,
        pose: bool = False,
        stop_eps: float = 1e-3,
        max_translation: float = 0.0,
        max_yaw: float = 0.0,
        connect_timeout: float = 30.0,
        request_timeout: float = 120.0,
        metadata_timeout: float = 2.0,
        name: str = "remote",
    ) -> None:
        _check("action_num", action_num, int, 1, 1024)
        _check_choice("action_format", action_format, ("auto", "discrete", "nav_delta"))
        _check_choice("translation_frame", translation_frame, ("chunk_start", "current"))
        _check("turn_degrees", turn_degrees, float, 1e-3, 180.0)
        _check("stop_eps", stop_eps, float, 0.0, 1e6)
        _check("max_translation", max_translation, float, 0.0, 1e6)
        _check("max_yaw", max_yaw, float, 0.0, 1e6)
        _check("connect_timeout", connect_timeout, float, 0.0, 1e6)
        _check("metadata_timeout", metadata_timeout, float, 0.0, 1e6)
        _check("request_timeout", request_timeout, float, 1e-3, 1e6)
        if not isinstance(name, str) or not name.strip() or len(name) > 80:
            raise ConfigError(f"name is {name!r}", remedy="give a short text")
        self.name = name
        self.action_num = action_num
        self.action_format = action_format
        self.translation_frame = translation_frame
        self.stop_eps = stop_eps
        self.max_translation, self.max_yaw = max_translation, max_yaw
        self.answers, self.turn_degrees = answers, turn_degrees
        self.send_pose = bool(pose)
        self._parse = find_parser(answers) if answers else None
        self.client = RemoteClient(
            pick_url(url, ports),
            connect_timeout=connect_timeout,
            request_timeout=request_timeout,
            metadata_timeout=metadata_timeout,
        )
        self.client.connect()
        self.greeting: Greeting = read_greeting(self.client.metadata)
        wants = set(self.greeting.wants) - {"pose"}
        self.sensors: frozenset[str] = frozenset(wants | ({"pose"} if self.send_pose else set()))
        self._sender = ObservationSender()
        self._seed = 0
        self._forget("", "")

    @property
    def card_rows(self) -> tuple[tuple[str, str], ...]:
        """What the protocol card says about it."""
        parts = [f"at most {self.action_num} actions of an answer are carried out"]
        parts.append(f"moves refer to the heading at {self.translation_frame}")
        parts.append("pose sent with each question" if self.send_pose else "no pose sent")
        parts.append("the server is told the episode's id")
        if self.greeting.extended:
            named = f" of {self.greeting.name!r}" if self.greeting.name else ""
            parts.append(f"extension v1{named}")
        rows = [("remote policy", "; ".join(parts))]
        if self.answers:
            turns = max(1, round(30.0 / self.turn_degrees))
            rows.append(
                (
                    "answers in words",
                    f"as {self.answers} speaks; a turn of 30° is {turns} actions and counts as "
                    f"{turns} steps; what cannot be read is a STOP and is counted",
                )
            )
        return tuple(rows)

    def identity(self) -> dict[str, str]:
        """Who the server says it is."""
        return dict(self.greeting.identity) or {"server": UNIDENTIFIED}

    def _forget(self, instruction: str, session: str) -> None:
        self._instruction, self._session = instruction, session
        self._frames: list[U8] = []
        self._pending: list[Action | Delta] = []
        self._turned = 0.0  # rad since the last question
        self._queries = 0
        self._begun = False
        self._counts: dict[str, int] = {}
        self._sender.reset()

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode; the server is told when the first action is wanted."""
        self._seed = int(rng.integers(2**62))  # the server's share of the episode's chance
        self._forget(instruction, f"session-{self._seed:016x}")

    def reset_session(self, session: str) -> None:
        """Call the episode's session by the episode's name, as the released harness does."""
        self._session = session

    def notes(self) -> dict[str, int]:
        """What was odd in this episode, counted."""
        return dict(self._counts)

    def act(self, observation: Observation) -> AnyAction:
        """The next action of the last answer, or of a new one.

        Raises:
            PolicyError: the server is gone, hangs, or does not answer with actions.
        """
        if observation.rgb is not None:
            self._frames.append(observation.rgb)
            kept = max(FRAMES_KEPT, 4 * self.action_num)
            if len(self._frames) > kept:
                del self._frames[:-kept]
        if not self._pending:
            answer = self._ask(observation)
            self._pending = list(answer.actions[: self.action_num])
            self._turned = 0.0
        if not self._pending:
            return Action.STOP
        action = self._pending.pop(0)
        if isinstance(action, Action):
            if action == Action.STOP:
                self._pending.clear()
            return action
        if is_stop(action, self.stop_eps):
            self._pending.clear()
            return Action.STOP
        turned = self._turned if self.translation_frame == "chunk_start" else 0.0
        move = build_displacement(action, turned, self.max_translation, self.max_yaw)
        self._turned += move.turn
        return move

    def _ask(self, observation: Observation) -> Answer:
        if not self._begun:
            self._begin()
        payload: dict[str, Any] = {"endpoint": "infer"}
        if self._frames:
            payload["images"] = self._frames[-1] if not self._queries else _stack(self._frames)
        payload["instruction"] = self._instruction
        payload["session_id"] = self._session
        if self.send_pose and observation.pose is not None:
            payload["state.nav_pose"] = np.array(observation.pose, np.float32)
        if self.greeting.extended:
            payload[KEY] = self._sender.pack(observation)
            if not self._queries:
                payload[KEY]["seed"] = self._seed
        reply = self.client.request(payload)
        self._queries += 1
        self._frames.clear()
        answer = read_answer(
            reply,
            action_format=self.action_format,
            parse_text=self._parse_text if self._parse else None,
        )
        self._count("answers not understood", not answer.understood)
        self._count("moves dropped, not finite", answer.dropped)
        return answer

    def _parse_text(self, text: str) -> Any:
        assert self._parse is not None
        return self._parse(text, self.turn_degrees)

    def _begin(self) -> None:
        """Tell the server that an episode begins; one that does not know how is left alone."""
        if not self.client.connected:
            self._call_again()  # it was restarted between two episodes
        reset: dict[str, Any] = {"endpoint": "reset"}
        if self.greeting.extended:
            reset["session_id"] = self._session
        try:
            self.client.request(reset)
        except PolicyError:
            if self.client.connected:
                self._count("resets refused", 1)
            else:
                self._call_again()
        self._begun = True

    def _call_again(self) -> None:
        """Connect once more, to the server that it was.

        Raises:
            PolicyError: nobody answers, or another server does.
        """
        self.client.connect()
        now = read_greeting(self.client.metadata)
        if now != self.greeting:
            self.client.close()
            raise PolicyError(
                f"the policy server at {self.client.url} is another one now: "
                f"{_tell(now)}, before {_tell(self.greeting)}",
                remedy="serve the model that the run began with",
            )

    def _count(self, what: str, times: int) -> None:
        if times:
            self._counts[what] = self._counts.get(what, 0) + int(times)


def _tell(greeting: Greeting) -> str:
    return ", ".join(f"{what} {value}" for what, value in greeting.identity) or UNIDENTIFIED


def _stack(frames: list[U8]) -> U8:
    """Pictures [T, H, W, 3]; one alone is not copied."""
    return frames[0][None] if len(frames) == 1 else np.stack(frames)


def pick_url(url: str, ports: str | int | Sequence[int]) -> str:
    """The address of this worker's server: that of `url`, or with one of `ports`, in turn.

    Raises:
        ConfigError: a port is not a port number.
    """
    if isinstance(ports, str):
        listed: list[Any] = [part.strip() for part in ports.split(",") if part.strip()]
    else:
        listed = [ports] if isinstance(ports, int) else list(ports)
    try:
        numbers = [int(port) for port in listed]
    except (TypeError, ValueError):
        numbers = [0]
    if not all(0 < number < 65536 for number in numbers):
        raise ConfigError(f"ports is {ports!r}", remedy="give e.g. 8001,8002")
    if not numbers:
        return url
    slot = os.environ.get(SLOT_VARIABLE, "0")
    number = numbers[(int(slot) if slot.isdigit() else 0) % len(numbers)]
    scheme, _, rest = str(url).partition("://")
    host = rest.partition("/")[0]
    host = host if host.endswith("]") else host.rpartition(":")[0] or host
    return f"{scheme}://{host}:{number}"


def _check(name: str, value: Any, kind: type, low: float, high: float) -> None:
    fits = isinstance(value, int) if kind is int else isinstance(value, int | float)
    if not fits or isinstance(value, bool) or not low <= value <= high:
        raise ConfigError(f"{name} is {value!r}", remedy=f"give a number from {low:g} to {high:g}")


def _check_choice(name: str, value: Any, known: Sequence[str]) -> None:
    if value not in known:
        raise ConfigError(f"{name} is {value!r}", remedy="known: " + ", ".join(known))
