"""Fuzz targets of the remote policy protocol: replies as a client reads them, requests as a server.

`python -m gn0_trials.fuzz wire-reply --count 1000000` and `wire-request` run them.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from gn0.errors import FormatError
from gn0.policies.remote.answers import Answer, read_answer
from gn0.policies.remote.extension import read_greeting
from gn0.policies.remote.server import PolicySession
from gn0.policies.remote.wire import REPLY_LIMITS, decode_message, encode_message
from gn0.policies.text import parse_navid, parse_navila, parse_uninavid
from gn0.sim.state import Action, Observation
from gn0_trials.fuzz import FuzzTarget

_TOKENS = (
    b"__ndarray__", b"__npgeneric__", b"\xc4\x05dtype\xa3|O8", b"\xa3<f4", b"\xa3|u1", b"\xa3<c8",
    b"\xdd\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff", b"\xc6\xff\xff\xff\xff", b"\xc1", b"\xd4\0\0",
    b"\x91" * 64, b"\xa7actions", b"\xabaction_type", b"\xa9nav_delta", b"\xcb\x7f\xf8\0\0\0\0\0\0",
    b"\xcf\xff\xff\xff\xff\xff\xff\xff\xff", b"\xa3gn0", b"\xa4pose", b"\xa5depth",
)  # fmt: skip


class _PolicyLooks:
    """Touches all that it is given."""

    name = "looks"
    sensors: frozenset[str] = frozenset()

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self.seed = rng.random()

    def act(self, observation: Observation) -> Action:
        """Look at every array."""
        for value in vars(observation).values():
            if isinstance(value, np.ndarray):
                value.tobytes()
        return Action.FORWARD


def _named(error: FormatError, path: Path) -> FormatError:
    return FormatError(
        error.what, file=path, offset=error.offset, field=error.field, remedy=error.remedy
    )


def _read_reply(path: Path) -> Answer:
    try:
        value = decode_message(path.read_bytes(), REPLY_LIMITS)
    except FormatError as error:
        raise _named(error, path) from None
    if isinstance(value, dict):
        read_greeting(value)
    for parse in (parse_uninavid, parse_navila):
        if isinstance(value, dict) and isinstance(value.get("text"), str):
            parse(value["text"])
    return read_answer(value, parse_text=parse_navid)


def _check_answer(answer: Answer) -> None:
    for action in answer.actions:
        assert isinstance(action, Action) or all(map(math.isfinite, action)), "not finite"


def _read_request(path: Path) -> dict[str, Any]:
    session = PolicySession(_PolicyLooks())
    try:
        request = decode_message(path.read_bytes())
        session.reply(request)
        return session.reply(request)
    except FormatError as error:
        raise _named(error, path) from None


def _check_reply(reply: dict[str, Any]) -> None:
    assert decode_message(encode_message(reply)) == reply, "a reply that cannot be sent"


def reply_target() -> FuzzTarget:
    """Replies and greetings of every kind."""
    delta = np.array([[0.25, 0.0, 0.1], [0.2, -0.1, 0.0]], np.float32)
    replies: dict[str, Any] = {
        "discrete": {"action_type": "discrete", "actions": [1, 1, 2, 0]},
        "names": {"actions": ["move_forward", "<left>", "stop"]},
        "array": {"action.vlnce": np.array([1, 2, 3])},
        "deltas": {"action_type": "nav_delta", "actions": delta.tolist()},
        "delta array": {"action.nav_delta": delta},
        "scalar": {"action": np.int64(1), "score": np.float32(0.5)},
        "text": {"action_type": "text", "text": "The next action is turn left 30 degrees."},
        "greeting": {"gn0": {"version": 1, "name": "x", "wants": ["rgb", "depth"]}, "actions": []},
    }
    corpus = {name: encode_message(reply) for name, reply in replies.items()}
    return FuzzTarget("wire-reply", _read_reply, corpus, _check_answer, _TOKENS)


def request_target() -> FuzzTarget:
    """Requests with and without the extension."""
    picture = np.arange(4 * 6 * 3, dtype=np.uint8).reshape(4, 6, 3)
    plain = {"endpoint": "infer", "images": picture, "instruction": "Go.", "session_id": "a_1"}
    more: dict[str, Any] = {
        "version": 1, "step": 3, "time": 1.5, "collided": True, "seed": 7,
        "depth": np.ones((3, 4), np.float32), "bev": picture, "occupancy": picture,
        "bev_metres_per_pixel": 0.05, "map_origin": [-1.0, 2.5],
        "goal_vector": [1.0, 2.0], "pose": [0.0, 1.0, 2.0],
        "ranges": np.ones(5, np.float32),
    }  # fmt: skip
    requests: dict[str, Any] = {
        "reset": {"endpoint": "reset"},
        "first": plain,
        "later": plain | {"images": np.stack([picture] * 3)},
        "pose": plain | {"state.nav_pose": np.zeros(3, np.float32)},
        "extended": plain | {"gn0": more},
    }
    corpus = {name: encode_message(request) for name, request in requests.items()}
    return FuzzTarget("wire-request", _read_request, corpus, _check_reply, _TOKENS)
