"""The server kit: a class behind a socket acts as it does in-process, and guards its door."""

from __future__ import annotations

import contextlib
import http.client
import logging
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection
from websockets.sync.client import connect as connect_to

from gn0.errors import ConfigError, FormatError, PolicyError
from gn0.geometry import Pose2D
from gn0.missions.goal import sample_goal_episodes
from gn0.policies.remote.policy_remote import PolicyRemote
from gn0.policies.remote.server import PolicyServer, PolicySession, build_reply
from gn0.policies.remote.wire import WireLimits, decode_message, encode_message
from gn0.policies.simple import PolicyRandom, PolicyStraight, PolicyWallFollower
from gn0.sim.open import open_simulator
from gn0.sim.rollout import run_episode
from gn0.sim.state import Action, Displacement, Observation, Teleport
from gn0.testing.policy_check import check_policy
from gn0.testing.scenes import build_room_scene

S, F, L, R = Action


def connect(url: str, **options: Any) -> ClientConnection:
    """An open connection that lives until it is closed: what `websockets` 16 and 17 both know."""
    return connect_to(url, **options).__enter__()


@pytest.fixture
def server() -> Iterator[PolicyServer]:
    with PolicyServer(PolicyWallFollower, port=0, token="") as running:
        yield running


def infer(**changes: Any) -> dict[str, Any]:
    request = {"endpoint": "infer", "instruction": "go", "session_id": "s", "gn0": {}}
    return request | changes


# The same policy on both sides.


@pytest.mark.parametrize("factory", [PolicyWallFollower, PolicyStraight])
def test_a_served_policy_acts_as_it_does_in_process(factory: type) -> None:
    scene = build_room_scene()
    with PolicyServer(factory, port=0, token="") as server:
        remote = PolicyRemote(server.url)
        assert remote.sensors == factory.sensors
        simulator = open_simulator(scene, sensors=remote.sensors, max_steps=120)
        for episode in sample_goal_episodes(scene, simulator.navigation, 3, 3):
            served = run_episode(simulator, remote, episode)
            assert served == run_episode(simulator, factory(), episode)
        remote.client.close()


def test_a_served_policy_keeps_the_whole_contract() -> None:
    """Chance included: a session's stream is named by the session."""
    with PolicyServer(PolicyRandom, port=0, token="") as server:
        made = []

        def build() -> PolicyRemote:
            made.append(PolicyRemote(server.url))
            return made[-1]

        check_policy(build)
        for policy in made:
            policy.client.close()


def test_all_sensors_arrive_and_still_pictures_only_once() -> None:
    seen: list[Observation] = []
    frames: list[int] = []

    class AnswererAll:
        name = "all"
        sensors = frozenset(
            {"rgb", "depth", "bev", "occupancy", "history", "ranges", "goal_vector", "goal_picture"}
        )

        def reset(self, instruction: str, rng: np.random.Generator) -> None:
            seen.clear()

        def answer(self, observation: Observation, pictures: Any) -> Any:
            seen.append(observation)
            frames.append(len(pictures))
            return [[0.25, 0.0, 0.1], [0.25, 0.0, 0.0]]

    rng = np.random.default_rng(0)

    def shot(shape: tuple[int, ...], kind: Any = np.uint8) -> Any:
        return rng.integers(0, 255, shape).astype(kind)

    bev, goal = shot((5, 7, 3)), shot((4, 6, 3))
    sent = [
        Observation(
            step, 0.5 * step, "go to the sofa", rgb=shot((4, 6, 3)), depth=shot((4, 6), np.float32),
            bev=bev, bev_metres_per_pixel=0.05, map_origin=(-1.5, 2.0),
            occupancy=shot((5, 7, 3)), history=shot((8, 6, 3)),
            ranges=shot((9,), np.float32), goal_vector=(1.5, -0.5), goal_picture=goal,
            pose=Pose2D(1.0, 2.0, 0.5), collided=step == 2,
        )
        for step in range(4)
    ]  # fmt: skip
    with PolicyServer(AnswererAll, port=0, token="") as server:
        policy = PolicyRemote(server.url, pose=True)
        assert policy.sensors == AnswererAll.sensors | {"pose"}
        policy.reset("go to the sofa", rng)
        sizes: list[int] = []
        request = policy.client.request

        def weigh(payload: dict[str, Any]) -> Any:
            sizes.append(len(payload.get("gn0", {}).keys() & {"bev", "goal_picture"}))
            return request(payload)

        policy.client.request = weigh  # type: ignore[method-assign]
        for observation in sent:
            policy.act(observation)
        policy.client.close()
    assert sizes == [0, 2, 0] and frames == [1, 2]
    for before, after in zip((sent[0], sent[2]), seen, strict=True):
        for name, value in vars(before).items():
            found = getattr(after, name)
            if isinstance(value, np.ndarray):
                assert found.dtype == value.dtype and np.array_equal(found, value), name
            else:
                assert found == value, name


@pytest.mark.parametrize(
    ("said", "actions"),
    [
        (F, [F]),
        (2, [L]),
        (np.int64(3), [R]),
        ([1, Action.LEFT], [F, L]),
        (["forward", "left"], [F, L]),
        (np.array([1, 2]), [F, L]),
        ([], [S]),
        (Displacement(0.25, 0.0, 0.0), [Displacement(0.25, 0.0, 0.0)]),
        ([[0.25, 0.0, 0.5]], [Displacement(0.25, 0.0, 0.5)]),
        (np.array([[0.25, 0.0, 0.5]]), [Displacement(0.25, 0.0, 0.5)]),
        ({"action.vlnce": [3]}, [R]),
        ("turn left 30 degrees", [L, L]),
    ],
)
def test_whatever_a_policy_may_say(said: Any, actions: list[Any]) -> None:
    class PolicySays(PolicyRandom):
        def act(self, observation: Observation) -> Any:
            return said

    with PolicyServer(PolicySays, port=0, token="") as server:
        policy = PolicyRemote(server.url, answers="navid")
        policy.reset("go", np.random.default_rng(0))
        assert [policy.act(Observation(0, 0.0, "go")) for _ in actions] == actions
        policy.client.close()


def test_a_teleport_becomes_a_move_where_the_pose_is_known() -> None:
    seen = Observation(0, 0.0, "go", pose=Pose2D(1.0, 1.0, np.pi / 2))
    reply = build_reply(Teleport(1.0, 2.0, 0.0), seen)
    assert reply["actions"][0] == pytest.approx([1.0, 0.0, -np.pi / 2])
    with pytest.raises(PolicyError, match="pose"):
        build_reply(Teleport(1.0, 2.0, 0.0), Observation(0, 0.0, "go"))
    with pytest.raises(PolicyError, match="said"):
        build_reply(None, seen)


def test_a_failing_policy_tells_its_client_and_lives_on(caplog: pytest.LogCaptureFixture) -> None:
    class PolicyFails(PolicyRandom):
        def act(self, observation: Observation) -> Any:
            if observation.instruction == "fail":
                raise RuntimeError("CUDA out of memory")
            return L

    with PolicyServer(PolicyFails, port=0, token="") as server:
        policy = PolicyRemote(server.url)
        policy.reset("fail", np.random.default_rng(0))
        with caplog.at_level(logging.CRITICAL), pytest.raises(PolicyError, match="out of memory"):
            policy.act(Observation(0, 0.0, "fail"))
        policy.reset("go", np.random.default_rng(1))
        assert policy.act(Observation(0, 0.0, "go")) == L
        policy.client.close()


def test_each_connection_has_a_policy_of_its_own() -> None:
    class PolicyCounts(PolicyRandom):
        def reset(self, instruction: str, rng: np.random.Generator) -> None:
            self.count = 0

        def act(self, observation: Observation) -> Any:
            self.count += 1
            return [self.count % 4]

    with PolicyServer(PolicyCounts, port=0, token="") as server:
        policies = [PolicyRemote(server.url) for _ in range(3)]
        for policy in policies:
            policy.reset("go", np.random.default_rng(0))
        assert [[p.act(Observation(0, 0.0, "go")) for _ in range(3)] for p in policies] == [
            [F, L, R]
        ] * 3
        for policy in policies:
            policy.client.close()


# The door.


def test_other_machines_need_a_token(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GN0_TOKEN", raising=False)
    for host in ("0.0.0.0", "::", "192.168.1.2", ""):
        with pytest.raises(ConfigError, match="token") as caught:
            PolicyServer(PolicyRandom, host=host, port=0)
        assert "GN0_TOKEN" in caught.value.remedy


def test_the_token_is_wanted_from_everybody(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GN0_TOKEN", raising=False)
    with PolicyServer(PolicyRandom, port=0, token="right-one") as server:
        with pytest.raises(PolicyError, match="HTTP 401") as caught:
            PolicyRemote(server.url)
        assert "GN0_TOKEN" in caught.value.remedy
        monkeypatch.setenv("GN0_TOKEN", "wrong-one")
        with pytest.raises(PolicyError, match="HTTP 401"):
            PolicyRemote(server.url)
        for value in ("right-one", "Bearer right-on", "bearer right-one", "Bearer right-one2", "é"):
            with pytest.raises(InvalidStatus):
                connect(server.url, additional_headers={"Authorization": value})
        monkeypatch.setenv("GN0_TOKEN", "right-one")
        PolicyRemote(server.url).client.close()


def test_who_comes_when_the_house_is_full_is_turned_away_and_let_in_later(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("gn0.policies.remote.server.CONNECTIONS_LIMIT", 2)
    with PolicyServer(PolicyRandom, port=0, token="") as server:
        inside = [connect(server.url) for _ in range(2)]
        for guest in inside:
            guest.recv(timeout=5.0)  # the greeting: it has a seat
        with pytest.raises(InvalidStatus, match="503"):
            connect(server.url)
        inside[0].close()
        for _ in range(100):
            try:
                connect(server.url).close()
                break
            except InvalidStatus:
                time.sleep(0.05)  # the seat is given back by another thread
        else:
            pytest.fail("the seat of one who left stays taken")
        inside[1].close()


def test_pages_in_a_browser_are_turned_away(server: PolicyServer) -> None:
    with pytest.raises(InvalidStatus, match="403"):
        connect(server.url, origin="http://evil.example")


def test_a_port_that_is_taken_is_said(server: PolicyServer) -> None:
    with pytest.raises(ConfigError, match="cannot listen"):
        PolicyServer(PolicyRandom, port=int(server.url.rpartition(":")[2]), token="")


def test_requests_beyond_the_limit_end_the_connection() -> None:
    limits = WireLimits(size=10_000)
    with PolicyServer(PolicyRandom, port=0, token="", limits=limits) as server:
        policy = PolicyRemote(server.url)
        policy.reset("go", np.random.default_rng(0))
        big = Observation(0, 0.0, "go" * 9000)
        policy._instruction = big.instruction
        with pytest.raises(PolicyError, match="1009"):
            policy.act(big)


BROKEN = {
    "no map": [1],
    "no endpoint": {},
    "an unknown endpoint": {"endpoint": "shell", "command": "ls"},
    "an endpoint that is an array": {"endpoint": np.zeros(3, np.float32)},
    "an endpoint that is no text": {"endpoint": ["infer"]},
    "an instruction that is no text": infer(instruction=5),
    "an endless instruction": infer(instruction="x" * 200_000),
    "a session that is no text": infer(session_id=b"s"),
    "pictures of floats": infer(images=np.zeros((4, 4, 3))),
    "pictures of one colour": infer(images=np.zeros((4, 4, 1), np.uint8)),
    "no pictures at all": infer(images=np.zeros((0, 4, 4, 3), np.uint8)),
    "a list of pictures": infer(images=[np.zeros((4, 4, 3), np.uint8)]),
    "an extension that is no map": infer(gn0=1),
    "depth of bytes": infer(gn0={"depth": np.zeros((4, 4), np.uint8)}),
    "a flat map": infer(gn0={"bev": np.zeros((4, 4), np.uint8)}),
    "a map of four colours": infer(gn0={"bev": np.zeros((4, 4, 4), np.uint8)}),
    "a step that is no number": infer(gn0={"step": "1"}),
    "an origin of one number": infer(gn0={"map_origin": [1.0]}),
    "a scale that is no number": infer(gn0={"bev_metres_per_pixel": None, "time": "now"}),
    "a pose of two": infer(gn0={"pose": [1.0, 2.0]}),
    "a goal of text": infer(gn0={"goal_vector": ["a", "b"]}),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_requests_are_refused_in_words(name: str) -> None:
    session = PolicySession(PolicyRandom())
    with pytest.raises(FormatError) as caught:
        session.reply(BROKEN[name])
    assert caught.value.remedy


def exchange(url: str, frames: list[bytes | str]) -> list[bytes | str]:
    with connect(url, compression=None) as channel:
        channel.recv(timeout=10)
        replies = []
        for frame in frames:
            channel.send(frame)
            replies.append(channel.recv(timeout=10))
        return replies


def test_text_and_noise_are_answered_with_a_text(
    server: PolicyServer, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.CRITICAL):
        replies = exchange(
            server.url, ["hello", b"\xc1", encode_message({"endpoint": "x"}), b"\x91" * 5000]
        )
        assert all(isinstance(reply, str) for reply in replies)
        good = exchange(server.url, [encode_message({"endpoint": "reset"})])
    assert decode_message(good[0]) == {"status": "ok"}  # type: ignore[arg-type]


FUZZ = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@FUZZ
@given(frames=st.lists(st.binary(max_size=300) | st.text(max_size=30), max_size=4))
def test_no_frames_bring_the_server_down(
    server: PolicyServer, caplog: pytest.LogCaptureFixture, frames: list[bytes | str]
) -> None:
    with caplog.at_level(logging.CRITICAL):
        exchange(server.url, frames)


@FUZZ
@given(noise=st.binary(max_size=400), handshake=st.booleans())
def test_no_bytes_on_the_line_bring_the_server_down(
    server: PolicyServer, noise: bytes, handshake: bool
) -> None:
    """Raw noise, before and after the handshake; the next client is served."""
    host, port = "127.0.0.1", int(server.url.rpartition(":")[2])
    with socket.create_connection((host, port), timeout=10) as channel:
        if handshake:
            channel.sendall(
                b"GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
            )
        with contextlib.suppress(OSError):
            channel.sendall(noise)
            channel.shutdown(socket.SHUT_WR)
            while channel.recv(65536):
                pass
    policy = PolicyRemote(server.url)
    policy.client.close()


def test_what_is_no_websocket_is_told_so(server: PolicyServer) -> None:
    asked = http.client.HTTPConnection("127.0.0.1", int(server.url.rpartition(":")[2]), timeout=10)
    asked.request("GET", "/")
    assert asked.getresponse().status == 426
    asked.close()


def test_closing_the_server_ends_its_threads() -> None:
    before = threading.active_count()
    with PolicyServer(PolicyRandom, port=0, token="") as server:
        policies = [PolicyRemote(server.url) for _ in range(4)]
    for policy in policies:
        policy.client.close()
    for _ in range(100):
        if threading.active_count() <= before:
            break
        threading.Event().wait(0.05)
    assert threading.active_count() <= before


def test_who_is_inside_when_the_server_closes_is_told_that_it_goes_away() -> None:
    with PolicyServer(PolicyRandom, port=0, token="") as server:
        guest = connect(server.url)
        guest.recv(timeout=5.0)
    with pytest.raises(ConnectionClosed):
        guest.recv(timeout=5.0)
    assert guest.close_code == 1001  # RFC 6455, 7.4.1: going away
