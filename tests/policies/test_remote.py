"""A policy behind a socket: the released client's behaviour, and a fault that names itself."""

from __future__ import annotations

import base64
import hashlib
import math
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from gn0.errors import ConfigError, PolicyError
from gn0.missions.goal import sample_goal_episodes
from gn0.policies.remote.client import RemoteClient, check_url, find_token_for
from gn0.policies.remote.policy_remote import PolicyRemote, pick_url
from gn0.policies.remote.wire import encode_message
from gn0.sim.open import open_simulator
from gn0.sim.rollout import run_episode
from gn0.sim.simulator import Simulator
from gn0.sim.state import Action, Displacement, Observation
from gn0.testing.scenes import build_room_scene
from gn0_trials.rogue_servers import ROGUES, answer_each, serve_bare

S, F, L, R = Action
Ask = Callable[..., PolicyRemote]


def picture(number: int, pose: Any = None) -> Observation:
    return Observation(
        number, 0.5 * number, "go", rgb=np.full((4, 6, 3), number, np.uint8), pose=pose
    )


@pytest.fixture
def ask() -> Iterator[Callable[..., PolicyRemote]]:
    """Build policies that are closed again."""
    made: list[PolicyRemote] = []

    def build(url: str, **options: Any) -> PolicyRemote:
        made.append(
            PolicyRemote(
                url, **{"metadata_timeout": 0.0, "connect_timeout": 5.0, "request_timeout": 10.0}
                | options
            )
        )  # fmt: skip
        return made[-1]

    yield build
    for policy in made:
        policy.client.close()


def begin(policy: PolicyRemote, session: str = "house_7") -> None:
    policy.reset("go", np.random.default_rng(0))
    policy.reset_session(session)


# The released protocol.


def test_pictures_go_as_in_the_released_client(ask: Ask) -> None:
    """First HWC; then THWC: all since the last question, the current one last."""
    asked: list[dict[str, Any]] = []

    def answer(request: dict[str, Any], number: int) -> Any:
        asked.append(request)
        return {"action_type": "discrete", "actions": [[1, 2], [3], [1, 1, 0, 2]][number]}

    with serve_bare(answer_each(answer)) as url:
        policy = ask(url)
        begin(policy)
        actions = [policy.act(picture(n)) for n in range(6)]
    assert actions == [F, L, R, F, F, S]
    assert [list(request) for request in asked] == [
        ["endpoint", "images", "instruction", "session_id"]
    ] * 3
    assert asked[0]["images"].shape == (4, 6, 3) and asked[0]["images"][0, 0, 0] == 0
    assert asked[1]["images"][:, 0, 0, 0].tolist() == [1, 2]
    assert asked[2]["images"][:, 0, 0, 0].tolist() == [3]
    assert {(r["instruction"], r["session_id"]) for r in asked} == {("go", "house_7")}


def test_the_bytes_on_the_wire_are_those_of_the_released_client(ask: Ask) -> None:
    """Nothing of ours reaches a server that did not ask for it."""
    frames: list[bytes] = []

    def handle(connection: Any) -> None:
        for frame in connection:
            frames.append(frame)
            connection.send(encode_message({"actions": [0]}))

    with serve_bare(handle) as url:
        policy = ask(url)
        begin(policy, "a_1")
        policy.act(picture(5))
    array = (
        b"\x84\xc4\x0b__ndarray__\xc3\xc4\x04data\xc4\x48" + bytes([5]) * 72
        + b"\xc4\x05dtype\xa3|u1\xc4\x05shape\x93\x04\x06\x03"
    )  # fmt: skip
    assert frames == [
        b"\x81\xa8endpoint\xa5reset",
        b"\x84\xa8endpoint\xa5infer\xa6images" + array
        + b"\xabinstruction\xa2go\xaasession_id\xa3a_1",
    ]  # fmt: skip


def test_at_most_so_many_pictures_are_kept(ask: Ask) -> None:
    counts: list[int] = []

    def answer(request: dict[str, Any], number: int) -> Any:
        counts.append(len(request["images"]) if number else 1)
        return {"actions": [1] * 100}

    with serve_bare(answer_each(answer)) as url:
        policy = ask(url, action_num=100)
        begin(policy)
        for number in range(201):
            policy.act(picture(number % 200))
        policy = ask(url, action_num=2)
        begin(policy)
        for number in range(5):
            policy.act(picture(number))
    assert counts == [1, 100, 100, 1, 2, 2]


def test_only_action_num_actions_are_carried_out_and_stop_clears_the_rest(ask: Ask) -> None:
    with serve_bare(answer_each(lambda request, number: {"actions": [1, 2, 3, 0, 1]})) as url:
        policy = ask(url, action_num=3)
        begin(policy)
        assert [policy.act(picture(n)) for n in range(6)] == [F, L, R] * 2
        policy = ask(url)
        begin(policy)
        assert [policy.act(picture(n)) for n in range(5)] == [F, L, R, S, F]


@pytest.mark.parametrize("reply", [{"actions": []}, {"action.nav_delta": [[math.nan, 0, 0]]}])
def test_an_empty_answer_means_stop(ask: Ask, reply: dict[str, Any]) -> None:
    with serve_bare(answer_each(lambda request, number: reply)) as url:
        policy = ask(url)
        begin(policy)
        assert policy.act(picture(0)) == S
    dropped = {"moves dropped, not finite": 1} if "action.nav_delta" in reply else {}
    assert policy.notes() == dropped


@pytest.mark.parametrize("frame", ["chunk_start", "current"])
def test_moves_are_carried_out_as_the_released_client_does(ask: Ask, frame: str) -> None:
    """Compared with a literal pose integration in the world frame, without obstacles."""
    deltas = [[0.3, 0.1, 0.5], [0.2, -0.1, -1.0], [0.1, 0.0, 0.25], [0.0, 0.2, 0.0]]
    with serve_bare(answer_each(lambda request, number: {"action.nav_delta": deltas})) as url:
        policy = ask(url, translation_frame=frame)
        begin(policy)
        x, y, yaw = 1.0, 2.0, 0.7
        seen = (x, y, yaw)
        for query in range(2):
            base = yaw
            for dx, dy, dyaw in deltas:
                move = policy.act(picture(query))
                assert isinstance(move, Displacement)
                there = move.at(type("P", (), dict(zip(("x", "y", "yaw"), seen, strict=True)))())  # type: ignore[arg-type]
                seen = (there.x, there.y, there.yaw)
                heading = base if frame == "chunk_start" else yaw
                x += math.cos(heading) * dx - math.sin(heading) * dy
                y += math.sin(heading) * dx + math.cos(heading) * dy
                yaw += dyaw
                assert seen == pytest.approx((x, y, yaw), abs=1e-6)


def test_a_small_move_is_a_stop_and_clears_the_rest(ask: Ask) -> None:
    rows = [[0.25, 0, 0], [1e-3, -1e-3, 0], [0.25, 0, 0]]
    with serve_bare(answer_each(lambda request, number: {"action.nav_delta": rows})) as url:
        policy = ask(url)
        begin(policy)
        kinds = [type(policy.act(picture(n))) for n in range(3)]
    assert kinds == [Displacement, Action, Displacement]


def test_the_pose_is_told_only_when_asked_for(ask: Ask) -> None:
    asked: list[dict[str, Any]] = []

    def answer(request: dict[str, Any], number: int) -> Any:
        asked.append(request)
        return {"actions": [0]}

    with serve_bare(answer_each(answer)) as url:
        for pose in (False, True):
            policy = ask(url, pose=pose)
            begin(policy)
            policy.act(picture(0, pose=(1.0, 2.0, 3.0) if pose else None))
            assert policy.sensors == ({"rgb", "pose"} if pose else {"rgb"})
            assert ("no pose sent" in dict(policy.card_rows)["remote policy"]) is not pose
    assert "state.nav_pose" not in asked[0]
    told = asked[1]["state.nav_pose"]
    assert told.dtype == np.float32 and told.tolist() == [1.0, 2.0, 3.0]
    assert list(asked[1])[-1] == "state.nav_pose"


def test_greetings_are_optional_and_may_come_late(ask: Ask) -> None:
    def greet_late(connection: Any) -> None:
        time.sleep(0.3)
        connection.send(encode_message({"model": "big"}))
        answer_each(lambda request, number: {"actions": [1]})(connection)

    with serve_bare(greet_late) as url:
        policy = ask(url, metadata_timeout=0.05)
        assert policy.client.metadata == {}
        time.sleep(0.5)
        begin(policy)
        assert policy.act(picture(0)) == F
        assert policy.client.metadata == {"model": "big"}
    with serve_bare(greet_late) as url:
        assert ask(url, metadata_timeout=5.0).client.metadata == {"model": "big"}


@pytest.mark.parametrize(
    "greeting",
    [
        {},
        {"gn0": 5},
        {"gn0": {"version": "1"}},
        {"gn0": {"version": 0, "wants": ["depth"]}},
        {"gn0": {"version": True, "wants": ["depth"]}},
    ],
)
def test_a_greeting_that_means_nothing_changes_nothing(ask: Ask, greeting: dict[str, Any]) -> None:
    def handle(connection: Any) -> None:
        connection.send(encode_message(greeting))
        answer_each(lambda request, number: {"actions": ["gn0" in request and 1]})(connection)

    with serve_bare(handle) as url:
        policy = ask(url, metadata_timeout=5.0)
        begin(policy)
        assert policy.sensors == {"rgb"} and policy.act(picture(0)) == S


def test_a_newer_extension_and_unknown_wishes_are_tolerated(ask: Ask) -> None:
    def handle(connection: Any) -> None:
        about = {"version": 7, "wants": ["depth", "smell", 3, "pose"], "name": "x\ny" * 99}
        connection.send(encode_message({"gn0": about}))
        answer_each(lambda request, number: {"actions": [request["gn0"]["step"]]})(connection)

    with serve_bare(handle) as url:
        policy = ask(url, metadata_timeout=5.0)
        assert policy.sensors == {"depth"}  # no pose: the user did not allow it
        assert len(policy.greeting.name) <= 80 and "\n" not in policy.greeting.name
        begin(policy)
        seen = Observation(1, 0.5, "go", depth=np.ones((2, 2), np.float32))
        assert policy.act(seen) == F


def test_a_server_that_does_not_know_reset_is_asked_all_the_same(ask: Ask) -> None:
    def handle(connection: Any) -> None:
        for frame in connection:
            reset = b"reset" in frame
            connection.send("unknown endpoint" if reset else encode_message({"actions": [2]}))

    with serve_bare(handle) as url:
        policy = ask(url)
        begin(policy)
        assert policy.act(picture(0)) == L
        assert policy.notes() == {"resets refused": 1}


def test_answers_in_words(ask: Ask) -> None:
    said = ["turn left 30 degrees", "what?"]
    reply = answer_each(lambda request, number: {"action_type": "text", "text": said[number]})
    with serve_bare(reply) as url:
        policy = ask(url, answers="navid")
        begin(policy)
        assert [policy.act(picture(n)) for n in range(3)] == [L, L, S]
        assert policy.notes() == {"answers not understood": 1}
        assert "2 actions" in dict(policy.card_rows)["answers in words"]


def test_a_server_restarted_between_episodes_is_found_again(ask: Ask) -> None:
    handler = answer_each(lambda request, number: {"actions": [1]})
    with serve_bare(handler) as url:
        policy = ask(url)
        begin(policy)
        assert policy.act(picture(0)) == F
    with serve_bare(handler, port=int(url.rpartition(":")[2])) as again:
        assert again == url
        begin(policy)
        assert policy.act(picture(0)) == F


# Whatever goes wrong.

EXPECTED = {
    "hangs": "no answer within 1 s",
    "drips": "no answer within 1 s",
    "answers with text": "CUDA out of memory at line 3",
    "answers twice": "nobody asked for",
    "sends a huge frame": "more than the 4194304 bytes",
    "announces an endless frame": "more than the 4194304 bytes",
    "closes with a reason": "code 1011: out of memory",
    "drops the line": "broke the connection off",
    "sends objects": "dtype",
    "lies about a shape": "shape",
    "lies about a dtype": "shape",
    "sends an unknown action": "unknown action 7",
    "speaks in words unasked": "is a text",
    "announces four billion actions": "4294967295",
    "nests without end": "deeper",
}


@pytest.mark.parametrize("name", ROGUES)
def test_each_misbehaviour_ends_the_episode_in_time_and_says_what_happened(
    ask: Ask, name: str
) -> None:
    with serve_bare(ROGUES[name]) as url:
        policy = ask(url, request_timeout=1.0)
        begin(policy)
        started = time.monotonic()
        with pytest.raises(PolicyError, match=EXPECTED.get(name, "policy server|answer")) as caught:
            for number in range(20):
                policy.act(picture(number))
        assert time.monotonic() - started < 30
        assert caught.value.remedy and "\n" not in str(caught.value)


@pytest.mark.parametrize("frame", ["hello", b"\xc1", b"\x93\x01\x02\x03"])
def test_a_greeting_in_another_tongue_is_refused(ask: Ask, frame: str | bytes) -> None:
    def handle(connection: Any) -> None:
        connection.send(frame)
        connection.recv()

    with serve_bare(handle) as url, pytest.raises(PolicyError, match="127"):
        ask(url, metadata_timeout=5.0)


def test_a_server_that_does_not_listen_is_left_in_time() -> None:
    """It shakes hands and never reads again: sending fails after the time limit."""
    held: list[socket.socket] = []

    def shake_hands(listener: socket.socket) -> None:
        channel, _ = listener.accept()
        held.append(channel)
        key = re.search(rb"Sec-WebSocket-Key: (\S+)", channel.recv(65536))
        assert key is not None
        digest = hashlib.sha1(key[1] + b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11").digest()
        channel.sendall(
            b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Accept: " + base64.b64encode(digest) + b"\r\n\r\n"
        )

    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=shake_hands, args=(listener,))
        thread.start()
        url = f"ws://127.0.0.1:{listener.getsockname()[1]}"
        client = RemoteClient(url, metadata_timeout=0.0, request_timeout=1.0)
        client.connect()
        thread.join()
        started = time.monotonic()
        with pytest.raises(PolicyError, match="policy server"):
            client.request({"images": np.zeros((40, 480, 640, 3), np.uint8)})
        assert time.monotonic() - started < 15
        assert not client.connected
        held[0].close()


def test_a_server_that_is_down_is_one_clear_error(ask: Ask) -> None:
    with serve_bare(lambda connection: None) as url:
        pass
    with pytest.raises(PolicyError, match="no policy server at ws://127") as caught:
        ask(url, connect_timeout=0.3)
    assert "start it" in caught.value.remedy and "connect_timeout" in caught.value.remedy


def test_a_server_that_starts_late_is_waited_for(ask: Ask) -> None:
    with serve_bare(lambda connection: None) as url:
        port = int(url.rpartition(":")[2])
    done = threading.Event()

    def start_late() -> None:
        time.sleep(0.6)
        with serve_bare(lambda connection: done.wait(10), port=port):
            done.wait(10)

    thread = threading.Thread(target=start_late)
    thread.start()
    try:
        assert ask(url, connect_timeout=8.0).client.connected
    finally:
        done.set()
        thread.join()


def test_something_else_on_the_port_is_not_waited_for_forever() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        url = f"ws://127.0.0.1:{listener.getsockname()[1]}"
        client = RemoteClient(url, connect_timeout=0.5)
        with pytest.raises(PolicyError, match="says nothing"):
            client.connect()


# Addresses and options.


@pytest.mark.parametrize(
    "url",
    ["", "127.0.0.1:8000", "http://127.0.0.1:8000", "ws://", "ws://a:b@127.0.0.1", "ws://[", 7],
)
def test_no_address_is_refused(url: Any) -> None:
    with pytest.raises(ConfigError, match="not the address"):
        check_url(url, "")


@pytest.mark.parametrize(
    ("named", "url", "sent"),
    [
        ("", "ws://127.0.0.1:8000", True),
        ("", "ws://[::1]:8000", True),
        ("", "wss://robots.example.org", False),
        ("robots.example.org", "wss://robots.example.org", True),
        ("robots.example.org", "wss://robots.example.org:9000", True),
        ("robots.example.org:9000", "wss://robots.example.org", False),
        ("other, Robots.example.org:443", "wss://robots.example.org", True),
        ("robots.example.org", "wss://robots.example.org.evil.example", False),
        ("robots.example.org", "wss://evil.example/robots.example.org", False),
        ("robots.example.org", "ws://127.0.0.1:8000", False),
        ("robots.example.org", "ws://[bad", False),
    ],
)
def test_a_token_belongs_to_the_host_it_was_given_for(
    monkeypatch: pytest.MonkeyPatch, named: str, url: str, sent: bool
) -> None:
    monkeypatch.setenv("GN0_TOKEN", "a-secret")
    monkeypatch.setenv("GN0_TOKEN_HOST", named)
    assert find_token_for(url) == ("a-secret" if sent else "")
    if not sent and "example" in url:
        with pytest.raises(ConfigError, match="no token for it") as caught:
            RemoteClient(url)
        assert "GN0_TOKEN_HOST=" in caught.value.remedy and "a-secret" not in str(caught.value)


def test_another_machine_needs_a_token(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GN0_TOKEN", raising=False)
    for host in ("10.0.0.5", "example.org", "0.0.0.0", "127.0.0.1.example.org", "[2001:db8::1]"):
        with pytest.raises(ConfigError, match="another machine") as caught:
            RemoteClient(f"ws://{host}:8000")
        assert "GN0_TOKEN" in caught.value.remedy
    for host in ("127.0.0.1", "localhost", "127.8.9.1", "[::1]"):
        assert RemoteClient(f"ws://{host}:8000").url.endswith(":8000")
    monkeypatch.setenv("GN0_TOKEN", "a-secret")
    RemoteClient("wss://robots.example.org", token="given with the address".replace(" ", "-"))
    monkeypatch.setenv("GN0_TOKEN", "a\r\nX-Evil: 1")
    with pytest.raises(ConfigError, match="blanks") as caught:
        RemoteClient("ws://127.0.0.1:8000")
    assert "Evil" not in str(caught.value)


def test_each_worker_takes_its_own_port(monkeypatch: pytest.MonkeyPatch) -> None:
    url = "ws://127.0.0.1:8000"
    assert pick_url(url, ()) == url
    for slot, port in (("0", 8001), ("1", 8002), ("2", 8001)):
        monkeypatch.setenv("GN0_WORKER_SLOT", slot)
        for ports in ("8001,8002", [8001, 8002]):
            assert pick_url(url, ports) == f"ws://127.0.0.1:{port}"
    assert pick_url("ws://[::1]:80", 8005) == "ws://[::1]:8005"
    for ports in ("a", [0], [70000], [None]):
        with pytest.raises(ConfigError, match="ports"):
            pick_url(url, ports)


@pytest.mark.parametrize(
    "options",
    [
        {"action_num": 0},
        {"action_num": 2.5},
        {"action_format": "dance"},
        {"translation_frame": "world"},
        {"answers": "gpt"},
        {"request_timeout": 0},
        {"request_timeout": math.nan},
        {"turn_degrees": 0},
        {"stop_eps": -1},
        {"name": ""},
    ],
)
def test_options_without_meaning_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ConfigError):
        PolicyRemote("ws://127.0.0.1:1", connect_timeout=0.0, **options)


# In the simulator.


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    return open_simulator(build_room_scene(), sensors={"ranges"}, max_steps=40)


def test_moves_are_cut_by_collision(ask: Ask, simulator: Simulator) -> None:
    """A server that walks into the wall gets no further than the wall."""
    rows = {"action.nav_delta": [[50.0, 0.0, 0.0]]}
    episode = sample_goal_episodes(simulator.scene, simulator.navigation, 1, 3)[0]

    def handle(connection: Any) -> None:
        connection.send(encode_message({"gn0": {"version": 1, "wants": ["ranges"]}}))
        answer_each(lambda request, number: rows)(connection)

    with serve_bare(handle) as url:
        policy = ask(url, action_num=1, metadata_timeout=5.0)
        trajectory = run_episode(simulator, policy, episode)
    assert trajectory.collided[0] and not trajectory.stopped
    assert set(trajectory.actions) == {-1} and trajectory.steps == 40
    # the strides up to the wall, then one at the wall again and again
    assert trajectory.costs[0] > 1 and set(trajectory.costs[1:]) == {1}
    assert all(simulator.navigation.region_of(p.x, p.y) >= 0 for p in trajectory.poses)
