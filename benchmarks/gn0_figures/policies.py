"""Figures of policies in other processes: what a question costs, and what bad servers cost."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gn0.bench.run_state import JOURNAL
from gn0.bench.runner import run_suite
from gn0.errors import PolicyError
from gn0.policies.remote.policy_remote import PolicyRemote
from gn0.policies.remote.wire import decode_message, encode_message
from gn0.progress import Progress
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene
from gn0.sim.state import Observation
from gn0.suites.suite import build_suite
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_most
from gn0_trials.fuzz import find_target, fuzz_reader
from gn0_trials.rogue_servers import ROGUES, serve_bare

QUESTIONS = 300
WIDTH, HEIGHT = 480, 360
MUTANTS = 1_000_000
KILLS = 2
EPISODES = 24
SAME = ("results.jsonl", "trajectories.jsonl", "summary.json")
_SERVER = """
import sys, time
from gn0.policies.remote.server import PolicyServer
class PolicyStill:
    name, sensors = "still", frozenset({sensors!r})
    def reset(self, instruction, rng): pass
    def answer(self, observation, frames): return [1] * {actions}
from gn0.policies.simple import PolicyWallFollower
class PolicySlow(PolicyStill):
    def answer(self, observation, frames):
        time.sleep({thinking})
        return [1]
with PolicyServer({policy}, port=0, token="", queue={queue}) as server:
    print(server.url, flush=True)
    sys.stdin.read()
"""


@contextlib.contextmanager
def _serve_elsewhere(policy: str, sensors: list[str], actions: int = 1) -> Iterator[str]:
    """A server kit in a process of its own; gives its address."""
    code = _SERVER.format(
        policy=policy, sensors=sensors, actions=actions, thinking=THINKING, queue=QUEUE
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdin is not None and process.stdout is not None
    try:
        yield process.stdout.readline().strip()
    finally:
        process.stdin.close()
        process.wait(timeout=30)
        process.stdout.close()


def _median_ms(times: int, *acts: Callable[[], object]) -> list[float]:
    spent: list[list[float]] = [[] for _ in acts]
    for _ in range(times):
        for act, seconds in zip(acts, spent, strict=True):
            start = time.perf_counter()
            act()
            seconds.append(time.perf_counter() - start)
    return [float(np.median(seconds)) * 1e3 for seconds in spent]


def measure_round_trip(context: FigureContext) -> list[FigureRow]:
    """One picture there, one action back; beside a client as the websockets package has it."""
    from websockets.sync.client import connect

    rng = np.random.default_rng(0)  # a picture with some structure, neither blank nor noise
    coarse = rng.integers(0, 256, (HEIGHT // 8, WIDTH // 8, 3)).astype(np.uint8)
    picture = coarse.repeat(8, 0).repeat(8, 1) + rng.integers(0, 4, (HEIGHT, WIDTH, 3)).astype(
        np.uint8
    )
    seen = Observation(0, 0.0, "Go to the sofa in the living room.", rgb=picture)
    request = {"endpoint": "infer", "images": picture, "instruction": "Go.", "session_id": "a"}
    with _serve_elsewhere("PolicyStill", ["rgb"]) as url:
        policy = PolicyRemote(url, action_num=1)
        policy.reset("Go to the sofa in the living room.", rng)
        for _ in range(20):
            policy.act(seen)
        with connect(url, max_size=None, ping_interval=None) as channel:  # offers to deflate
            channel.recv()

            def ask() -> None:
                channel.send(encode_message(request))
                decode_message(channel.recv())  # type: ignore[arg-type]

            # in turn, so that whatever else this machine does hits both alike
            ours, plain = _median_ms(QUESTIONS, lambda: policy.act(seen), ask)
        policy.client.close()
    message = encode_message(request)
    (coding,) = _median_ms(QUESTIONS, lambda: decode_message(encode_message(request)))
    detail = (
        f"one {WIDTH}×{HEIGHT} picture ({len(message) / 1e3:.0f} kB) a question over loopback, "
        f"server kit in another process, median of {QUESTIONS}"
    )
    return [
        FigureRow(name="remote query, round trip", value=ours, unit="ms", detail=detail),
        FigureRow(name="remote queries", value=1e3 / ours, unit="/s", detail=detail),
        FigureRow(
            name="remote query, part of it that is coding",
            value=coding,
            unit="ms",
            detail="request written and read again, this process alone",
        ),
        FigureRow(
            name="remote query against a bare websockets client",
            value=ours / plain,
            unit="×",
            detail="same server, same bytes, same run; below 1 is faster than the bare client",
        ),
    ]


def measure_fuzz(context: FigureContext) -> list[FigureRow]:
    """Mutants of messages, read as client and as server."""
    rows = []
    for name in ("wire-reply", "wire-request"):
        report = fuzz_reader(find_target(name), count=MUTANTS, seed=1, progress=context.progress)
        detail = (
            f"{report.inputs:,} mutants, {report.accepted:,} read, {report.refused:,} refused, "
            f"slowest {report.slowest_s * 1e3:.0f} ms, "
            f"memory +{report.peak_growth_bytes / 1e6:.0f} MB"
        )
        rows.append(row_at_most(f"{name}: foreign exceptions", report.foreign, 0, "", detail))
        rows.append(row_at_most(f"{name}: hangs", report.hangs, 0, "", detail))
    return rows


def _ask_rogue(name: str) -> str:
    """What is said of a server that misbehaves; "" when nothing is."""
    with serve_bare(ROGUES[name]) as url:
        policy = PolicyRemote(url, metadata_timeout=0.0, request_timeout=1.0)
        policy.reset("go", np.random.default_rng(0))
        seen = Observation(0, 0.0, "go", rgb=np.zeros((4, 6, 3), np.uint8))
        try:
            for _ in range(20):
                policy.act(seen)
        except PolicyError as error:
            return str(error)
        finally:
            policy.client.close()
    return ""


def measure_rogues(context: FigureContext) -> list[FigureRow]:
    """Servers that break the protocol, each in its own way."""
    slowest, unsaid = 0.0, []
    for done, name in enumerate(ROGUES):
        context.progress("servers that misbehave", done, len(ROGUES))
        start = time.perf_counter()
        if not _ask_rogue(name):
            unsaid.append(name)
        slowest = max(slowest, time.perf_counter() - start)
    detail = f"{len(ROGUES)} ways to misbehave, request timeout 1 s; slowest {slowest:.1f} s"
    return [row_at_most("misbehaving servers not named", len(unsaid), 0, "", detail)]


CROWD = (1, 10, 100)  # clients
CROWD_SECONDS = 4.0
QUEUE = 1
THINKING = 0.02  # s the served policy takes


def _crowd(url: str, clients: int, seconds: float) -> tuple[list[float], list[float]]:
    """Seconds of answered and of refused questions, of so many clients who never wait."""
    from websockets.exceptions import InvalidStatus, WebSocketException
    from websockets.sync.client import connect

    question = encode_message(
        {"endpoint": "infer", "instruction": "go", "session_id": "s", "gn0": {"version": 1}}
    )
    answered: list[float] = []
    refused: list[float] = []
    until = time.perf_counter() + seconds

    def ask() -> None:
        channel: Any = None
        while time.perf_counter() < until:
            begun = time.perf_counter()
            try:
                if channel is None:
                    opened = connect(url, compression=None, ping_interval=None)
                    channel = opened.__enter__()  # kept across turns
                    channel.recv()
                    continue
                channel.send(question)
                said = decode_message(channel.recv())
            except (WebSocketException, OSError) as error:  # 503 at the door, or hung up on
                channel = None
                refused.append(time.perf_counter() - begun)
                told = error.response.headers if isinstance(error, InvalidStatus) else {}
                time.sleep(min(float(told.get("Retry-After", 0.25)), seconds))
                continue
            took = time.perf_counter() - begun
            busy = said.get("status") == "busy"
            (refused if busy else answered).append(took)
            if busy:
                time.sleep(said["retry_after"])
        if channel is not None:
            channel.close()

    threads = [threading.Thread(target=ask) for _ in range(clients)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return answered, refused


def measure_crowd(context: FigureContext) -> list[FigureRow]:
    """A server that thinks for 20 ms, asked by 1, 10 and 100 clients at once."""
    rows, alone = [], 0.0
    with _serve_elsewhere("PolicySlow", []) as url:
        for done, clients in enumerate(CROWD):
            context.progress("crowds", done, len(CROWD))
            answered, refused = _crowd(url, clients, CROWD_SECONDS)
            p99 = float(np.percentile(answered, 99)) * 1e3
            alone = alone or p99
            detail = (
                f"a policy of {THINKING * 1e3:.0f} ms, queue {QUEUE}, {CROWD_SECONDS:g} s; "
                f"{len(answered)} answered, {len(refused)} told to come again; clients are threads "
                "of one process beside the server's on the same cores"
            )
            name = f"policy server, {clients} clients: answered, 99th percentile"
            if clients == CROWD[0]:
                rows.append(FigureRow(name=name, value=p99, unit="ms", detail=detail))
                continue
            rows.append(
                row_at_most(f"{name}, to one client's", p99 / alone, QUEUE + 1.5, "×", detail)
            )
            away = float(np.percentile(refused, 99)) * 1e3 if refused else 0.0
            rows.append(
                row_at_most(
                    f"policy server, {clients} clients: told to come again, 99th percentile",
                    away, 50, "ms", detail,
                )
            )  # fmt: skip
    return rows


_PARENT = """
import sys
from gn0.bench import runner
from gn0.suites.suite import load_suite
runner.code_version = lambda: "trial"
suite, out, url = sys.argv[1:]
runner.run_suite(load_suite(suite), "remote", out, workers=2, policy_options={"url": url})
"""


def _finished(out: Path) -> int:
    path = out / JOURNAL
    return path.read_bytes().count(b'"type": "result"') if path.exists() else 0


def _kill_run(suite: Path, out: Path, url: str, after: int) -> None:
    """Start a run and kill it with -9 once so many episodes are done."""
    process = subprocess.Popen([sys.executable, "-c", _PARENT, str(suite), str(out), url])
    until = time.monotonic() + 300
    while _finished(out) < after and process.poll() is None and time.monotonic() < until:
        time.sleep(0.01)
    with contextlib.suppress(ProcessLookupError):
        os.kill(process.pid, signal.SIGKILL)
    process.wait()


def measure_resume(context: FigureContext) -> list[FigureRow]:
    """A run with two workers that ask a server, killed twice and resumed, and an unbroken one."""
    from gn0.bench import runner

    scene, suite = context.work / "flat", context.work / "suite"
    save_scene(build_example_scene(), scene)
    built = build_suite([scene], suite, count=EPISODES, seed=5, max_steps=300)
    broken, whole = context.work / "broken", context.work / "whole"
    version, runner.code_version = runner.code_version, lambda: "trial"
    try:
        with _serve_elsewhere("PolicyWallFollower", []) as url:
            left = []
            for kill in range(KILLS):
                _kill_run(suite, broken, url, after=(kill + 1) * EPISODES // (KILLS + 1))
                left.append(_finished(broken))
            options: dict[str, Any] = {"url": url}
            quiet: Progress = context.progress
            summary = run_suite(
                built, "remote", broken, workers=2, policy_options=options, progress=quiet
            )
            run_suite(built, "remote", whole, workers=1, policy_options=options, progress=quiet)
    finally:
        runner.code_version = version
    different = sum((broken / n).read_bytes() != (whole / n).read_bytes() for n in SAME)
    detail = (
        f"{EPISODES} episodes, wall follower behind the server kit, --workers 2, kill -9 of the "
        f"parent with {' and '.join(map(str, left))} episodes done; {summary.valid} scored"
    )
    return [
        row_at_most("files that differ after two kills and a resume", different, 0, "", detail),
        row_at_most("episodes lost or failed", summary.expected - summary.valid, 0, "", detail),
    ]


FIGURES: list[Figure] = [
    Figure("policies.round_trip", "Asking a policy server", measure_round_trip, 0.3),
    Figure("policies.fuzz", "A million mutants of the wire", measure_fuzz, 8.0),
    Figure("policies.crowd", "A crowded policy server", measure_crowd, 0.3),
    Figure("policies.rogues", "Policy servers that misbehave", measure_rogues, 0.5),
    Figure("policies.resume", "A run against a server, killed twice", measure_resume, 1.0),
]
