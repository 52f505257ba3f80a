"""Runs that ask a server: killed, misled, abandoned, and still each episode has one true line."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gn0.bench import runner
from gn0.bench.results import RunSummary, count_notes, load_results, load_summary
from gn0.bench.runner import run_suite
from gn0.cli import bench_run
from gn0.errors import ConfigError, PolicyError
from gn0.jobs.pool import Worker, free_slot
from gn0.policies.remote.wire import decode_message, encode_message
from gn0.suites.suite import Suite
from gn0_trials.rogue_servers import ROGUES, serve_bare

pytestmark = pytest.mark.usefixtures("workers_here")

ROOT = Path(__file__).resolve().parent.parent.parent
SAME = ("results.jsonl", "trajectories.jsonl", "summary.json")
QUICK = {"connect_timeout": 5.0, "request_timeout": 2.0, "metadata_timeout": 0.5}


def outputs(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in SAME}


@pytest.fixture(scope="module", autouse=True)
def still_code() -> Iterator[None]:
    """Pretend that nobody edits the package while these tests stop and resume runs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "code_version", lambda: "1.0+still")
        yield


@pytest.fixture(autouse=True)
def no_token(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GN0_TOKEN", raising=False)


def ask(suite: Suite, out: Path, url: str, **more: Any) -> RunSummary:
    options = QUICK | {"url": url} | more.pop("options", {})
    return run_suite(suite, "remote", out, policy_options=options, **more)


def greet(connection: Any) -> None:
    """No pictures, so that nothing has to be rendered."""
    connection.send(encode_message({"gn0": {"version": 1, "name": "test", "wants": ["ranges"]}}))


def walk(connection: Any, request: dict[str, Any]) -> None:
    if request["endpoint"] == "reset":
        connection.send(encode_message({"status": "ok"}))
    else:
        step = request["gn0"]["step"]
        connection.send(encode_message({"actions": [1, 1, 2] if step < 20 else [0]}))


def walker(connection: Any) -> None:
    greet(connection)
    for frame in connection:
        walk(connection, decode_message(frame))


def test_a_run_asks_a_server_and_says_so_on_its_card(flats_suite: Suite, tmp_path: Path) -> None:
    with serve_bare(walker) as url:
        summary = ask(flats_suite, tmp_path / "two", url, workers=2, max_episodes=4)
        ask(flats_suite, tmp_path / "one", url, workers=1, max_episodes=4, shuffle_seed=3)
    assert summary.ok and summary.expected == 4
    assert outputs(tmp_path / "two") == outputs(tmp_path / "one")
    card = dict(summary.protocol)
    assert card["policy"] == "remote" and card["the policy sees"] == "ranges"
    assert "no pose sent" in card["remote policy"] and "'test'" in card["remote policy"]
    assert all(b'"notes"' not in line for line in outputs(tmp_path / "one").values())


def test_a_successor_takes_over_the_place_of_the_worker_it_replaces() -> None:
    workers: dict[int, Worker] = {}
    for number in (4, 5, 6):
        workers[number] = Worker(number, free_slot(workers))
    assert [worker.slot for worker in workers.values()] == [0, 1, 2]
    del workers[5]
    assert free_slot(workers) == 1


def test_each_worker_asks_a_server_of_its_own(flats_suite: Suite, tmp_path: Path) -> None:
    """One port a worker, as the released harness is run."""
    asked: dict[int, int] = {0: 0, 1: 0}

    def counted(which: int) -> Any:
        def handle(connection: Any) -> None:
            asked[which] += 1
            walker(connection)

        return handle

    with serve_bare(counted(0)) as one, serve_bare(counted(1)) as two:
        ports = [int(url.rpartition(":")[2]) for url in (one, two)]
        summary = ask(
            flats_suite, tmp_path, one, workers=2, max_episodes=6, options={"ports": ports}
        )
    assert summary.ok and asked == {0: 1, 1: 1}


def test_what_was_odd_is_counted_in_results(flats_suite: Suite, tmp_path: Path) -> None:
    def handle(connection: Any) -> None:
        greet(connection)
        for frame in connection:
            if b"reset" in frame:
                connection.send("reset? never heard of it")
            else:
                connection.send(encode_message({"action_type": "text", "text": "hm"}))

    with serve_bare(handle) as url:
        summary = ask(
            flats_suite,
            tmp_path,
            url,
            max_episodes=1,
            options={"answers": "uninavid", "pose": True},
        )
    result = load_results(tmp_path)[0]
    assert result.status == "valid" and result.stopped
    assert result.notes == {"answers not understood": 1, "resets refused": 1}
    assert count_notes(tmp_path) == dict.fromkeys(result.notes, (1, 1))
    card = dict(summary.protocol)
    assert "2 actions" in card["answers in words"] and "odometry" in card["the policy sees"]


def test_one_bad_episode_costs_itself_and_no_other(flats_suite: Suite, tmp_path: Path) -> None:
    """The server chokes on one session: that one fails by name, after one more try."""
    bad = sorted(e.id for e in flats_suite.episodes)[1]
    tries: list[str] = []

    def handle(connection: Any) -> None:
        greet(connection)
        for frame in connection:
            request = decode_message(frame)
            if request.get("session_id") == bad and request["endpoint"] == "infer":
                tries.append(bad)
                connection.send("CUDA error: device-side assert\nTraceback …")
            else:
                walk(connection, request)

    with serve_bare(handle) as url:
        summary = ask(flats_suite, tmp_path, url, max_episodes=4)
    assert summary.valid == 3 and summary.exit_code == 1
    (failed,) = summary.failed
    assert failed.episode == bad and failed.status == "failed"
    assert "CUDA error: device-side assert" in failed.reason and "\n" not in failed.reason
    assert tries == [bad, bad]
    assert load_summary(tmp_path).failed == summary.failed


CI_ROGUES = ("hangs", "answers with noise", "drops the line", "lies about a shape")


def check_rogue(suite: Suite, out: Path, name: str) -> None:
    """Every episode fails with a reason, and the run is over all the same."""
    with serve_bare(ROGUES[name]) as url:
        summary = ask(suite, out, url, max_episodes=2, workers=2)
    assert summary.expected == 2 and summary.valid == 0
    assert all(r.status == "failed" and "PolicyError" in r.reason for r in summary.failed)
    assert summary.exit_code == 1


@pytest.mark.slow
@pytest.mark.parametrize("name", CI_ROGUES)
def test_a_misbehaving_server_costs_its_episodes_never_the_run(
    flats_suite: Suite, tmp_path: Path, name: str
) -> None:
    check_rogue(flats_suite, tmp_path, name)


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", sorted(ROGUES.keys() - set(CI_ROGUES)))
def test_every_misbehaving_server_costs_its_episodes_never_the_run(
    flats_suite: Suite, tmp_path: Path, name: str
) -> None:
    check_rogue(flats_suite, tmp_path, name)


def test_a_server_that_is_down_is_told_in_one_sentence(flats_suite: Suite, tmp_path: Path) -> None:
    with serve_bare(walker) as url:
        pass
    with pytest.raises(PolicyError, match="no policy server at ws://127") as caught:
        ask(flats_suite, tmp_path, url, options={"connect_timeout": 0.5})
    assert "Traceback" not in str(caught.value) and "start it" in str(caught.value)
    with serve_bare(walker) as other:  # a run that never began binds nobody to its address
        assert ask(flats_suite, tmp_path, other, max_episodes=1).ok


def test_a_server_that_dies_for_good_ends_the_run_which_goes_on_later(
    flats_suite: Suite, tmp_path: Path
) -> None:
    """It dies of its third episode. What is done stays done; the third fails by name at last."""
    poison = sorted(e.id for e in flats_suite.episodes)[2]
    dead = threading.Event()

    def mortal(connection: Any) -> None:
        if dead.is_set():
            return
        greet(connection)
        for frame in connection:
            request = decode_message(frame)
            if request.get("session_id") == poison and request["endpoint"] == "infer":
                dead.set()
                connection.socket.shutdown(socket.SHUT_RDWR)
                return
            walk(connection, request)

    with serve_bare(mortal) as url:
        for done in (2, 3):  # the second time, dying of it counts as its failure
            dead.clear()
            with pytest.raises(PolicyError, match=f"{done} of 4 episodes are done") as caught:
                ask(flats_suite, tmp_path, url, max_episodes=4)
            assert "the same command goes on" in str(caught.value)
    with serve_bare(walker, port=int(url.rpartition(":")[2])):
        kept = ask(flats_suite, tmp_path, url, max_episodes=4, keep_failed=True)
        mended = ask(flats_suite, tmp_path, url, max_episodes=4)
    (failed,) = kept.failed
    assert failed.episode == poison and kept.valid == 3
    assert "broke the connection off" in failed.reason
    assert mended.ok


def test_options_are_read_from_the_command_line(flats_suite: Suite, tmp_path: Path) -> None:
    assert bench_run.read_options(("url=ws://h:1", "pose=true", "turn-degrees=30", "a==")) == {
        "url": "ws://h:1", "pose": True, "turn_degrees": 30, "a": "="
    }  # fmt: skip
    for wrong in ("url", "=1", "a b=1"):
        with pytest.raises(ConfigError, match="policy option"):
            bench_run.read_options((wrong,))
    with pytest.raises(ConfigError, match="twice"):
        bench_run.read_options(("a=1", "a=2"))
    with pytest.raises(PolicyError, match="action_num, action_format"):
        run_suite(flats_suite, "remote", tmp_path, policy_options={"colour": "red"})


def test_the_command_line_says_with_its_exit_code_that_an_episode_failed(
    flats_suite: Suite, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(out: str, url: str) -> int:
        options = (f"url={url}", "metadata_timeout=0.5", "request_timeout=2")
        return bench_run.run(
            bench_run.Args(
                suite=str(flats_suite.folder), out=str(tmp_path / out), policy="remote",
                policy_option=options, limit=1, no_report=True,
            )
        )  # fmt: skip

    def silly(connection: Any) -> None:
        greet(connection)
        for _ in connection:
            connection.send(encode_message({"actions": [9]}))

    with serve_bare(walker) as url:
        assert run("good", url) == 0
    with serve_bare(silly) as url:
        assert run("bad", url) == 1
    assert "unknown action 9" in capsys.readouterr().out


# The example server, with the run killed twice.

PARENT = """
from gn0.bench import runner
from gn0.bench.runner import run_suite
runner.code_version = lambda: "1.0+still"
from gn0.suites.suite import load_suite
run_suite(load_suite({suite!r}), "remote", {out!r}, workers=2,
          policy_options={{"url": {url!r}, "connect_timeout": 60}})
"""


@pytest.fixture(scope="module")
def example_server() -> Iterator[str]:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    example = ROOT / "examples" / "03_policy_server.py"
    process = subprocess.Popen([sys.executable, str(example), str(port)])
    yield f"ws://127.0.0.1:{port}"
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=20) is not None


def finished(out: Path) -> int:
    path = out / "journal.jsonl"
    return path.read_bytes().count(b'"type": "result"') if path.exists() else 0


@pytest.mark.slow
def test_killed_twice_a_run_against_the_example_server_ends_with_the_same_bytes(
    flats_suite: Suite, tmp_path: Path, example_server: str
) -> None:
    broken, unbroken = tmp_path / "broken", tmp_path / "unbroken"
    code = PARENT.format(suite=str(flats_suite.folder), out=str(broken), url=example_server)
    for kill in (1, 2):
        process = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
        until = time.monotonic() + 240
        while finished(broken) < 3 * kill and process.poll() is None:
            assert time.monotonic() < until, "the run does not get on"
            time.sleep(0.02)
        assert process.poll() is None, "it was too quick to be killed"
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        assert finished(broken) < 12 and not (broken / "results.jsonl").exists()
    options = {"url": example_server, "connect_timeout": 60}
    summary = run_suite(flats_suite, "remote", broken, workers=2, policy_options=options)
    run_suite(flats_suite, "remote", unbroken, policy_options=options)
    assert summary.ok and summary.expected == 12
    assert outputs(broken) == outputs(unbroken)
    lines = [line.split(b"\t")[0] for line in (broken / "journal.jsonl").read_bytes().splitlines()]
    names = [r["result"]["episode"] for r in map(json.loads, lines) if r["type"] == "result"]
    assert len(names) == len(set(names)) == 12
