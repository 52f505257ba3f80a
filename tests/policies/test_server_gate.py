"""A crowded policy server: a queue with an end, and those beyond it are told when to come again."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection
from websockets.sync.client import connect as connect_to

from gn0.errors import ConfigError, PolicyError
from gn0.policies.remote.client import RemoteClient, read_busy
from gn0.policies.remote.gate import BusyError, Gate
from gn0.policies.remote.server import CONNECTIONS_LIMIT, PolicyServer
from gn0.policies.remote.wire import REQUEST_LIMITS, decode_message, encode_message
from gn0.policies.simple import PolicyRandom

TRY_AGAIN_LATER = 1013  # RFC 6455's registry of close codes at IANA: "Try Again Later"


def connect(url: str, **options: Any) -> ClientConnection:
    """An open connection that lives until it is closed: what `websockets` 16 and 17 both know."""
    return connect_to(url, **options).__enter__()


class PolicyHeld:
    """Answers when it is let: the event is shared by all of its kind."""

    name = "held"
    sensors: frozenset[Any] = frozenset()
    go = threading.Event()
    at_once = 0
    most_at_once = 0

    def reset(self, instruction: str, rng: np.random.Generator) -> None:
        pass

    def act(self, observation: Any) -> int:
        cls = type(self)
        cls.at_once += 1
        cls.most_at_once = max(cls.most_at_once, cls.at_once)
        cls.go.wait(60.0)
        cls.at_once -= 1
        return 1


@pytest.fixture(autouse=True)
def held() -> Iterator[None]:
    PolicyHeld.go.clear()
    PolicyHeld.at_once = PolicyHeld.most_at_once = 0
    yield
    PolicyHeld.go.set()


def question(extended: bool = True) -> bytes:
    asked: dict[str, Any] = {"endpoint": "infer", "instruction": "go", "session_id": "s"}
    return encode_message(asked | ({"gn0": {"version": 1}} if extended else {}))


def wait_until(true: Any) -> None:
    for _ in range(400):
        if true():
            return
        time.sleep(0.01)
    raise AssertionError("it never came to that")


@pytest.mark.parametrize("clients", [1, 10, 100])
def test_a_crowd_is_served_or_told_when_to_come_again(
    clients: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All ask at once while the policy thinks: queue + 1 are kept, every other hears "busy"."""
    monkeypatch.setattr("gn0.policies.remote.server.CONNECTIONS_LIMIT", 200)
    queue = 4
    with (
        PolicyServer(PolicyHeld, port=0, token="", queue=queue) as server,
        contextlib.ExitStack() as stack,
    ):
        crowd = [stack.enter_context(connect(server.url)) for _ in range(clients)]
        for guest in crowd:
            guest.recv(timeout=10.0)
        kept, away = crowd[: queue + 1], crowd[queue + 1 :]
        for guest in kept:
            guest.send(question())
        wait_until(lambda: server._gate.inside == len(kept))
        for guest in away:
            guest.send(question())
        for guest in away:
            answer = decode_message(guest.recv(timeout=10.0))
            assert answer["status"] == "busy" and answer["retry_after"] > 0
        assert server._gate.inside == len(kept)
        PolicyHeld.go.set()
        for guest in kept:
            assert decode_message(guest.recv(timeout=10.0))["actions"] == [1]
        wait_until(lambda: server._gate.inside == 0)
        assert PolicyHeld.most_at_once == 1


def test_a_client_without_the_extension_is_asked_by_close_code_to_try_later() -> None:
    with PolicyServer(PolicyHeld, port=0, token="", queue=0) as server:
        first, second = connect(server.url), connect(server.url)
        for guest in (first, second):
            guest.recv(timeout=5.0)
        first.send(question(extended=False))
        wait_until(lambda: server._gate.inside == 1)
        second.send(question(extended=False))
        with pytest.raises(ConnectionClosed) as closed:
            second.recv(timeout=5.0)
        assert closed.value.rcvd is not None and closed.value.rcvd.code == TRY_AGAIN_LATER
        with pytest.raises(InvalidStatus) as refused:  # and newcomers at the door
            connect(server.url)
        response = refused.value.response
        assert response.status_code == 503 and int(response.headers["Retry-After"]) >= 1
        PolicyHeld.go.set()
        assert decode_message(first.recv(timeout=5.0))["actions"] == [1]
        first.close()


def test_our_client_comes_again_until_it_is_answered() -> None:
    with PolicyServer(PolicyHeld, port=0, token="", queue=0) as server:
        blocking = connect(server.url)
        blocking.recv(timeout=5.0)
        client = RemoteClient(server.url, request_timeout=20.0, token="")
        client.connect()
        blocking.send(question())
        wait_until(lambda: server._gate.inside == 1)
        threading.Timer(0.3, PolicyHeld.go.set).start()
        request = {"endpoint": "infer", "instruction": "go", "session_id": "t", "gn0": {}}
        assert client.request(request)["actions"] == [1]
        PolicyHeld.go.clear()
        blocking.recv(timeout=5.0)
        blocking.send(question())
        wait_until(lambda: server._gate.inside == 1)
        client.request_timeout = 0.1
        with pytest.raises(PolicyError, match="too busy"):
            client.request(request)
        PolicyHeld.go.set()
        blocking.close()


def test_requests_that_need_no_policy_never_wait() -> None:
    with PolicyServer(PolicyHeld, port=0, token="", queue=0) as server:
        first, second = connect(server.url), connect(server.url)
        for guest in (first, second):
            guest.recv(timeout=5.0)
        first.send(question())
        wait_until(lambda: server._gate.inside == 1)
        second.send(encode_message({"endpoint": "reset"}))
        assert decode_message(second.recv(timeout=5.0)) == {"status": "ok"}
        PolicyHeld.go.set()
        first.close(), second.close()


def test_silent_guests_make_room_when_the_house_is_full(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gn0.policies.remote.server.CONNECTIONS_LIMIT", 3)
    monkeypatch.setattr("gn0.policies.remote.server.SILENT_TIMEOUT", 0.2)
    with PolicyServer(PolicyRandom, port=0, token="") as server:
        worker = connect(server.url)
        worker.recv(timeout=5.0)
        worker.send(question())
        worker.recv(timeout=5.0)
        silent = [connect(server.url) for _ in range(2)]
        for guest in silent:
            guest.recv(timeout=5.0)
        time.sleep(0.3)
        late = RemoteClient(server.url, connect_timeout=10.0, token="")
        late.connect()  # turned away once, which makes the silent ones go
        for guest in silent:
            with pytest.raises(ConnectionClosed):
                guest.recv(timeout=5.0)
        worker.send(question())  # one who asks keeps the seat
        assert decode_message(worker.recv(timeout=5.0))["action_type"] == "discrete"
        late.close(), worker.close()


def test_an_idle_connection_is_closed() -> None:
    with PolicyServer(PolicyRandom, port=0, token="", idle_timeout=0.2) as server:
        guest = connect(server.url)
        guest.recv(timeout=5.0)
        with pytest.raises(ConnectionClosed):
            guest.recv(timeout=5.0)


def test_held_bytes_are_bounded() -> None:
    gate = Gate(queue=10, size=1000)
    with gate.enter(900):
        with pytest.raises(BusyError), gate.enter(200):
            pass
        assert gate.inside == 1
    with gate.enter(5000):  # alone, one question passes whatever its size: the wire bounds that
        pass
    assert gate.inside == 0 and not gate.is_full


class Clock:
    """Time that passes when it is told to."""

    now = 1000.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    found = Clock()
    monkeypatch.setattr("gn0.policies.remote.gate.time", found)
    return found


def ask(gate: Gate, clock: Clock, who: str, thinking: float = 0.1) -> float | None:
    """Seconds after which to come again; None if the question was answered."""
    try:
        with gate.enter(1, who):
            clock.now += thinking
    except BusyError as busy:
        return busy.retry_after
    return None


def test_a_crowd_that_is_told_off_comes_back_one_by_one(clock: Clock) -> None:
    """Nobody knocks twice: the times told are a question's length apart."""
    gate = Gate(queue=0)
    for _ in range(50):  # the gate learns how long a question takes
        ask(gate, clock, "teacher")
    with gate.enter(1, "first"):
        told = [ask(gate, clock, f"guest {k}") for k in range(20)]
    assert told == pytest.approx([0.1 * (k + 1) for k in range(20)], rel=0.01)
    begun = clock.now
    for k, seconds in enumerate(told):
        assert seconds is not None
        clock.now = max(clock.now, begun + seconds)
        assert ask(gate, clock, f"guest {k}") is None


def test_who_never_pauses_keeps_nobody_out(clock: Clock) -> None:
    gate = Gate(queue=0)
    turns, again = {"greedy": 0, "patient": 0}, {"greedy": 0.0, "patient": 0.0}
    inside, until = contextlib.ExitStack(), 0.0
    asks = ""  # whose question is answered
    for _ in range(20_000):
        clock.now += 0.001
        if asks and clock.now >= until:
            inside.close()
            turns[asks] += 1
            asks = ""
        for who in ("greedy", "patient"):  # one asks all the time, the other when it is told to
            if who == asks or (who == "patient" and clock.now < again[who]):
                continue
            try:
                inside.enter_context(gate.enter(1, who))
                asks, until = who, clock.now + 0.1
            except BusyError as busy:
                again[who] = clock.now + busy.retry_after
    inside.close()
    assert turns["patient"] >= 0.4 * sum(turns.values()) >= 0.4 * 180


def test_who_leaves_or_stays_away_is_not_waited_for(clock: Clock) -> None:
    gate = Gate(queue=0)
    for _ in range(50):
        ask(gate, clock, "patient")
    with gate.enter(1, "patient"):
        assert ask(gate, clock, "gone") is not None
    clock.now += 0.05
    assert ask(gate, clock, "newcomer") is not None
    gate.forget("gone"), gate.forget("newcomer")  # they have hung up
    assert ask(gate, clock, "next") is None
    with gate.enter(1, "patient"):
        assert ask(gate, clock, "late") is not None
    clock.now += 0.25  # and who does not come is not waited for
    assert ask(gate, clock, "next") is None


def test_a_failing_question_gives_its_place_back() -> None:
    gate = Gate(queue=0)
    for _ in range(3):
        with pytest.raises(ValueError, match="policy"), gate.enter(1):
            raise ValueError("policy")
    assert gate.inside == 0


def test_defaults_are_those_of_the_promise() -> None:
    assert REQUEST_LIMITS.size == 16 * 2**20
    assert CONNECTIONS_LIMIT == 64
    for wrong in ({"queue": -1}, {"held_bytes": 0}, {"idle_timeout": 0.0}):
        with pytest.raises(ConfigError, match="idle after"):
            PolicyServer(PolicyRandom, port=0, token="", **wrong)


@pytest.mark.parametrize(
    ("answer", "seconds"),
    [
        ({"status": "busy", "retry_after": 0.5}, 0.5),
        ({"status": "busy", "retry_after": float("nan")}, 0.25),
        ({"status": "busy", "retry_after": 1e9}, 30.0),
        ({"status": "busy", "retry_after": "soon"}, 0.25),
        ({"status": "busy"}, 0.25),
        ({"status": "ok"}, None),
        ([1], None),
    ],
)
def test_whatever_a_busy_server_says_is_bounded(answer: Any, seconds: float | None) -> None:
    assert read_busy(answer) == seconds
