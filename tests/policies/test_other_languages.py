"""Servers in other languages: keys that they can hold, and the recipes as they are shipped."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from gn0.errors import FormatError
from gn0.missions.goal import sample_goal_episodes
from gn0.policies.remote.extension import wants_text_keys
from gn0.policies.remote.policy_remote import PolicyRemote
from gn0.policies.remote.wire import decode_message, encode_message
from gn0.sim.open import open_simulator
from gn0.sim.rollout import run_episode
from gn0.testing.scenes import build_room_scene

SERVERS = Path(__file__).resolve().parent.parent.parent / "examples" / "servers"


def test_keys_inside_of_arrays_are_texts_for_who_asks() -> None:
    """Written out by hand, as the msgpack specification has it: 0xab and 0xa4 begin texts."""
    array = np.array([1.0], "<f4")
    expected = (
        b"\x84\xab__ndarray__\xc3\xa4data\xc4\x04\x00\x00\x80\x3f\xa5dtype\xa3<f4\xa5shape\x91\x01"
    )
    assert encode_message(array, text_keys=True) == expected
    for data in (expected, encode_message(array)):
        read = decode_message(data)
        assert read.dtype == np.float32 and read.tolist() == [1.0]
    scalar = decode_message(encode_message(np.float32(2.5), text_keys=True))
    assert scalar == np.float32(2.5) and scalar.dtype == np.float32


def test_text_keys_are_checked_as_byte_strings_are() -> None:
    with pytest.raises(FormatError, match="dtype"):
        decode_message(
            encode_message({"__ndarray__": True, "data": b"", "dtype": "O", "shape": []})
        )
    with pytest.raises(FormatError, match="needs 4 bytes"):
        decode_message(
            encode_message({"__ndarray__": True, "data": b"", "dtype": "<f4", "shape": [1]})
        )


@pytest.mark.parametrize(
    ("greeting", "asked"),
    [
        ({"gn0": {"version": 1, "keys": "text"}}, True),
        ({"keys": "text"}, True),
        ({"gn0": {"version": 1}}, False),
        ({"gn0": {"version": 1, "keys": ["text"]}}, False),
        ({}, False),
    ],
)
def test_a_greeting_may_ask_for_them(greeting: dict[str, object], asked: bool) -> None:
    assert wants_text_keys(greeting) is asked


@pytest.fixture
def node_server(tmp_path: Path) -> Iterator[str]:
    """The JavaScript recipe with its two packages, where node and npm's registry are."""
    node, npm = shutil.which("node"), shutil.which("npm")
    if not node or not npm:
        pytest.skip("no node and npm here: the JavaScript recipe is not run")
    shutil.copy(SERVERS / "server.mjs", tmp_path)
    install = [npm, "install", "--silent", "--no-audit", "ws@8", "@msgpack/msgpack@3"]
    try:
        done = subprocess.run(
            install, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
        )
    except subprocess.TimeoutExpired:
        pytest.skip("npm's registry does not answer: the JavaScript recipe is not run")
    if done.returncode:
        pytest.skip(f"npm cannot install ws and @msgpack/msgpack: {done.stderr[-200:]}")
    with subprocess.Popen(
        [node, "server.mjs", "0"], cwd=tmp_path, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        yield process.stdout.readline().strip()
        process.terminate()


@pytest.mark.slow
def test_the_javascript_recipe_drives_an_agent(node_server: str) -> None:
    scene = build_room_scene()
    policy = PolicyRemote(node_server)
    assert policy.sensors == {"ranges"} and policy.greeting.name == "javascript"
    simulator = open_simulator(scene, sensors=policy.sensors, max_steps=80)
    episode = sample_goal_episodes(scene, simulator.navigation, 1, 3)[0]
    trajectory = run_episode(simulator, policy, episode)
    assert trajectory.stopped and {1, 2} <= set(trajectory.actions)
    policy.client.close()
