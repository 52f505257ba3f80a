"""Runs: the same bytes whatever happens to the workers, and a clear end for everything else."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from gn0.bench import episode_worker, runner
from gn0.bench.results import load_results, load_summary
from gn0.bench.runner import run_suite
from gn0.errors import BenchError, ConfigError, EpisodeError, PolicyError, StorageError
from gn0.locked_folder import lock_folder
from gn0.storage import Journal
from gn0.suites.suite import Suite

SAME = ("results.jsonl", "trajectories.jsonl", "summary.json")
PLUGIN = Path(__file__).parent / "plugin"


def outputs(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in SAME}


@pytest.fixture(scope="module", autouse=True)
def still_code() -> Iterator[None]:
    """Pretend that nobody edits the package while these tests stop and resume runs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "code_version", lambda: "1.0+still")
        yield


@pytest.fixture(autouse=True)
def odd_policies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(PLUGIN))


def run_odd(suite: Suite, out: Path, workers: int = 1, **more: object) -> runner.RunSummary:
    options = {k: more.pop(k) for k in ("odd", "when", "marks", "pause") if k in more}
    return run_suite(
        suite,
        "odd",
        out,
        workers=workers,
        policy_options=options,
        plugin_modules=("odd_policies",),
        **more,  # type: ignore[arg-type]
    )


@pytest.fixture(scope="module")
def unbroken(
    still_code: None, flats_suite: Suite, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """One worker, in order, never interrupted."""
    out = tmp_path_factory.mktemp("unbroken") / "run"
    sys.path.insert(0, str(PLUGIN))
    try:
        run_odd(flats_suite, out, pause=0.001)
    finally:
        sys.path.remove(str(PLUGIN))
    return out


@pytest.mark.parametrize(("workers", "shuffle"), [(3, 11), (1, 5)])
def test_any_number_of_workers_in_any_order_gives_the_same_bytes(
    flats_suite: Suite,
    unbroken: Path,
    tmp_path: Path,
    request: pytest.FixtureRequest,
    workers: int,
    shuffle: int | None,
) -> None:
    if workers == 1:
        request.getfixturevalue("worker_here")
    run_odd(flats_suite, tmp_path / "run", workers, shuffle_seed=shuffle, pause=0.001)
    assert outputs(tmp_path / "run") == outputs(unbroken)


def test_a_finished_run_is_not_run_again_and_times_stay_out_of_results(
    flats_suite: Suite, unbroken: Path
) -> None:
    before = outputs(unbroken)
    journal = (unbroken / "journal.jsonl").read_bytes()
    run_odd(flats_suite, unbroken, pause=0.001)
    assert outputs(unbroken) == before
    assert (unbroken / "journal.jsonl").read_bytes() == journal
    about = json.loads((unbroken / "run.json").read_text())
    assert all(e["seconds"] > 0 for e in about["episodes"].values())
    assert b"seconds" not in before["results.jsonl"] + before["summary.json"]


PARENT = """
import sys
sys.path.insert(0, {plugin!r})
from gn0.bench import runner
from gn0.bench.runner import run_suite
runner.code_version = lambda: "1.0+still"
from gn0.suites.suite import load_suite
run_suite(load_suite({suite!r}), "odd", {out!r}, workers={workers}, shuffle_seed={shuffle},
          policy_options={{"pause": 0.001}}, plugin_modules=("odd_policies",))
"""


def start_parent(suite: Suite, out: Path, workers: int, shuffle: int) -> subprocess.Popen[bytes]:
    code = PARENT.format(
        plugin=str(PLUGIN), suite=str(suite.folder), out=str(out), workers=workers, shuffle=shuffle
    )
    return subprocess.Popen(
        [sys.executable, "-c", code], stderr=subprocess.PIPE, start_new_session=True
    )


def children_of(pid: int) -> list[int]:
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError, IndexError, ValueError):
            if int(stat.read_text().rpartition(")")[2].split()[1]) == pid:
                found.append(int(stat.parent.name))
    return found


def wait_gone(pids: list[int], seconds: float) -> list[int]:
    """Those still alive (zombies do not count) after at most so long."""

    def alive(pid: int) -> bool:
        try:
            return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
        except OSError:
            return False

    until = time.monotonic() + seconds
    left = [p for p in pids if alive(p)]
    while left and time.monotonic() < until:
        time.sleep(0.05)
        left = [p for p in left if alive(p)]
    return left


def finished(out: Path) -> int:
    path = out / "journal.jsonl"
    return path.read_bytes().count(b'"type": "result"') if path.exists() else 0


def interrupt(
    process: subprocess.Popen[bytes], out: Path, after: int, extra: float, how: int
) -> list[int]:
    """Send a signal once `after` episodes are finished and a moment has passed; its workers."""
    until = time.monotonic() + 60
    while process.poll() is None and finished(out) < after and time.monotonic() < until:
        time.sleep(0.01)
    time.sleep(extra)
    workers = children_of(process.pid)
    process.send_signal(how)
    process.wait(timeout=30)
    return workers


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_killed_at_random_moments_a_run_resumes_without_losing_or_repeating(
    flats_suite: Suite, unbroken: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    chance = random.Random(20261121)
    kills = 0
    while kills < 6:
        process = start_parent(flats_suite, out, workers=1 + kills % 3, shuffle=kills)
        goal = min(finished(out) + chance.randint(0, 2), 11)
        workers = interrupt(process, out, goal, chance.uniform(0.0, 0.25), signal.SIGKILL)
        assert process.stderr is not None
        process.stderr.close()
        assert not wait_gone(workers, 5.0), "a worker outlived its parent"
        kills += 1
        if kills == 3:  # a power cut in the middle of a line
            with open(out / "journal.jsonl", "ab") as stream:
                stream.write(b'{"type": "result", "result": {"epis')
    run_odd(flats_suite, out, 2, pause=0.001)
    assert outputs(out) == outputs(unbroken)
    lines = [line.split(b"\t")[0] for line in (out / "journal.jsonl").read_bytes().splitlines()]
    names = [r["result"]["episode"] for r in map(json.loads, lines) if r["type"] == "result"]
    assert sorted(names) == sorted(e.id for e in flats_suite.episodes), "lost or repeated"


@pytest.mark.slow
def test_a_kill_after_any_write_loses_nothing(flats_suite: Suite, cut_after_writes) -> None:
    whole, cuts = cut_after_writes(lambda out: run_odd(flats_suite, out, max_episodes=3))
    assert len(cuts) > 12
    for left in cuts:
        run_odd(flats_suite, left, max_episodes=3)
        assert outputs(left) == outputs(whole), left
        assert {p.name for p in left.iterdir()} == {p.name for p in whole.iterdir()}


@pytest.mark.usefixtures("worker_here")
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_ctrl_c_ends_all_workers_and_the_run_goes_on_later(
    flats_suite: Suite, unbroken: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    process = start_parent(flats_suite, out, workers=2, shuffle=1)
    begin = time.monotonic()
    workers = interrupt(process, out, 1, 0.0, signal.SIGINT)
    assert process.stderr is not None
    assert b"KeyboardInterrupt" in process.stderr.read() or finished(out) == 12
    process.stderr.close()
    assert not wait_gone(workers, 5.0)
    assert time.monotonic() - begin < 90
    run_odd(flats_suite, out, pause=0.001)
    assert outputs(out) == outputs(unbroken)


@pytest.mark.usefixtures("worker_here")
def test_a_damaged_tail_of_the_journal_costs_only_that_episode(
    flats_suite: Suite, unbroken: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    shutil.copytree(unbroken, out)
    journal = out / "journal.jsonl"
    data = journal.read_bytes()
    journal.write_bytes(data[:-40] + b"\x00" * 25)
    for name in SAME:
        (out / name).unlink()
    run_odd(flats_suite, out, pause=0.001)
    assert outputs(out) == outputs(unbroken)


def test_a_journal_of_something_else_is_refused_and_leftovers_are_swept(
    flats_suite: Suite, unbroken: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    shutil.copytree(unbroken, out)
    (out / ".gn0-tmp-left").write_text("half a result")
    with Journal(out / "journal.jsonl") as journal:
        journal.append({"type": "result", "result": {"episode": 5}})
    with pytest.raises(BenchError, match=r"journal\.jsonl: line \d+ is not one of ours"):
        run_odd(flats_suite, out, pause=0.001)
    assert not (out / ".gn0-tmp-left").exists()
    with Journal(tmp_path / "other" / "journal.jsonl") as journal:
        journal.append(["a list"])
    with pytest.raises(BenchError, match="another suite"):
        run_odd(flats_suite, tmp_path / "other")


@pytest.mark.usefixtures("worker_here")
def test_another_run_in_the_same_folder_is_refused(
    flats_suite: Suite, unbroken: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "run"
    shutil.copytree(unbroken, out)
    before = outputs(out)
    with pytest.raises(BenchError, match=r"another config.*--fresh"):
        run_odd(flats_suite, out, pause=0.002)
    with pytest.raises(BenchError, match="another config"):
        run_odd(flats_suite, out, pause=0.001, max_episodes=3)
    monkeypatch.setattr(runner, "code_version", lambda: "0.0.1+older")
    with pytest.raises(BenchError, match="another code"):
        run_odd(flats_suite, out, pause=0.001)
    assert outputs(out) == before
    monkeypatch.undo()
    monkeypatch.syspath_prepend(str(PLUGIN))
    summary = run_odd(flats_suite, out, pause=0.001, max_episodes=3, resume=False)
    assert (summary.expected, summary.valid) == (3, 3)


@pytest.mark.usefixtures("worker_here")
def test_a_run_without_one_scored_episode_stands_in_nobodys_way(
    flats_suite: Suite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise EpisodeError("nobody knows 'p0001'")

    with monkeypatch.context() as patch:
        patch.setattr(episode_worker, "run_episode", refuse)
        summary = run_odd(flats_suite, tmp_path / "run", max_episodes=2)
        assert [r.status for r in summary.failed] == ["invalid"] * 2
        told: list[str] = []
        run_odd(flats_suite, tmp_path / "run", max_episodes=2, tell=told.append)
        assert told[0].endswith(
            "2 of them are invalid: if the cause is gone, --fresh runs all again"
        )
    again = run_odd(flats_suite, tmp_path / "run", max_episodes=2, pause=0.001)  # another config
    assert again.valid == 2
    with pytest.raises(BenchError, match="another config"):  # and what was scored is kept
        run_odd(flats_suite, tmp_path / "run", max_episodes=2)


def test_two_runs_at_once_in_one_folder_are_refused(flats_suite: Suite, tmp_path: Path) -> None:
    with lock_folder(_made(tmp_path / "run")), pytest.raises(BenchError, match="another run is"):
        run_odd(flats_suite, tmp_path / "run")


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder


@pytest.mark.parametrize(
    ("odd", "when", "workers", "reason", "shown"),
    [
        ("raise", "sofa", 1, "ValueError: the policy lost its mind", "in misbehave"),
        ("die", "coffee", 2, "was killed by SIGKILL", ""),
        ("exit", "wardrobe", 1, "ended with exit code 7", ""),
    ],
)
def test_a_dying_policy_costs_its_episodes_only_and_names_them(
    flats_suite: Suite,
    tmp_path: Path,
    odd: str,
    when: str,
    workers: int,
    reason: str,
    shown: str,
    caplog: pytest.LogCaptureFixture,
    request: pytest.FixtureRequest,
) -> None:
    if odd == "raise":
        request.getfixturevalue("worker_here")
    summary = run_odd(flats_suite, tmp_path / "run", workers, odd=odd, when=when)
    expected = {e.id for e in flats_suite.episodes if when in e.instruction}
    assert expected and len(expected) < 12
    assert {r.episode for r in summary.failed} == expected
    assert {r.reason for r in summary.failed} == {reason}
    assert (summary.expected, summary.valid) == (12, 12 - len(expected))
    assert not summary.ok and summary.exit_code == 1
    about = json.loads((tmp_path / "run" / "run.json").read_text())
    for name in expected:
        assert about["episodes"][name]["attempts"] == 2
        assert shown in about["episodes"][name]["traceback"]
        assert f"episode {name} failed twice: {reason}" in caplog.text and shown in caplog.text
    assert load_summary(tmp_path / "run") == summary
    assert len(load_results(tmp_path / "run")) == 12


def test_a_hanging_policy_is_ended_soon_after_its_limit_and_shows_where_it_hung(
    flats_suite: Suite, tmp_path: Path
) -> None:
    begin = time.monotonic()
    summary = run_odd(
        flats_suite, tmp_path / "run", odd="hang", when="desk", max_episodes=2,
        episode_time_limit=2.0,
    )  # fmt: skip
    assert time.monotonic() - begin < 60
    stuck = [e for e in flats_suite.episodes[:2] if "desk" in e.instruction]
    assert stuck and [r.episode for r in summary.failed] == [e.id for e in stuck]
    assert all(r.reason == "took longer than 2 s" for r in summary.failed)
    about = json.loads((tmp_path / "run" / "run.json").read_text())
    assert "in misbehave" in about["episodes"][stuck[0].id]["traceback"]


@pytest.mark.slow
def test_a_policy_that_never_lets_go_of_the_interpreter_is_ended_too(
    flats_suite: Suite, tmp_path: Path
) -> None:
    summary = run_odd(
        flats_suite, tmp_path / "run", odd="grip", when="desk", max_episodes=2,
        episode_time_limit=3.0,
    )  # fmt: skip
    stuck = [e for e in flats_suite.episodes[:2] if "desk" in e.instruction]
    assert stuck and [r.episode for r in summary.failed] == [e.id for e in stuck]
    assert summary.exit_code == 1 and summary.valid == 2 - len(stuck)
    about = json.loads((tmp_path / "run" / "run.json").read_text())
    assert "in misbehave" in about["episodes"][stuck[0].id]["traceback"], "it shows where"


def test_a_policy_that_eats_all_memory_costs_its_episodes_by_name(
    flats_suite: Suite, tmp_path: Path
) -> None:
    summary = run_odd(flats_suite, tmp_path / "run", odd="gorge", when="desk", max_episodes=2)
    stuck = {e.id for e in flats_suite.episodes[:2] if "desk" in e.instruction}
    assert stuck and {r.episode for r in summary.failed} == stuck
    for failure in summary.failed:
        assert "MemoryError" in failure.reason or "was killed by SIG" in failure.reason
    assert summary.valid == 2 - len(stuck)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_ctrl_c_ends_a_worker_that_never_lets_go_of_the_interpreter(
    flats_suite: Suite, tmp_path: Path
) -> None:
    code = PARENT.replace('"pause": 0.001', '"odd": "grip", "when": ""').format(
        plugin=str(PLUGIN), suite=str(flats_suite.folder), out=str(tmp_path / "run"), workers=2,
        shuffle=1,
    )  # fmt: skip
    process = subprocess.Popen(
        [sys.executable, "-c", code], stderr=subprocess.PIPE, start_new_session=True
    )
    until = time.monotonic() + 60
    journal = tmp_path / "run" / "journal.jsonl"
    while time.monotonic() < until and not (
        journal.exists() and journal.read_bytes().count(b'"type": "lease"') == 2
    ):
        time.sleep(0.05)
    workers = interrupt(process, tmp_path / "run", 0, 1.0, signal.SIGINT)
    assert process.stderr is not None
    process.stderr.close()
    assert len(workers) == 2 and not wait_gone(workers, 5.0)


def test_an_episode_that_breaks_once_gets_its_second_chance(
    flats_suite: Suite, unbroken: Path, tmp_path: Path
) -> None:
    summary = run_odd(
        flats_suite, tmp_path / "run", odd="die", when="sofa", marks=str(tmp_path / "mark")
    )
    assert summary.ok
    same = (tmp_path / "run" / "results.jsonl").read_bytes()
    assert same == (unbroken / "results.jsonl").read_bytes()


def test_a_policy_that_prints_does_not_confuse_the_run(
    flats_suite: Suite, unbroken: Path, tmp_path: Path
) -> None:
    assert run_odd(flats_suite, tmp_path / "run", odd="print", when="").ok
    same = (tmp_path / "run" / "results.jsonl").read_bytes()
    assert same == (unbroken / "results.jsonl").read_bytes()


@pytest.mark.usefixtures("worker_here")
def test_a_pose_that_is_not_a_number_fails_the_episode_by_name(
    flats_suite: Suite, tmp_path: Path
) -> None:
    summary = run_odd(flats_suite, tmp_path / "run", odd="nan", when="bed ", max_episodes=6)
    assert summary.failed and all("returned no valid action" in r.reason for r in summary.failed)
    assert all(i.count == summary.valid for i in summary.metrics.values())


def test_a_policy_that_cannot_be_built_ends_the_run_with_its_traceback(
    flats_suite: Suite, tmp_path: Path
) -> None:
    with pytest.raises(PolicyError, match="weights are missing") as error:
        run_odd(flats_suite, tmp_path / "run", odd="unbuildable")
    assert "odd_policies.py" in str(error.value)
    assert not (tmp_path / "run" / "summary.json").exists()


def test_an_unknown_policy_is_refused_before_anything_is_written(
    flats_suite: Suite, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match="no policy named 'orakel'"):
        run_suite(flats_suite, "orakel", tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_an_unwritable_place_is_refused_before_the_work(flats_suite: Suite, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(StorageError, match="part of the path is a file"):
        run_odd(flats_suite, tmp_path / "file" / "run")


def test_a_full_disk_is_told_before_the_work(
    flats_suite: Suite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=1000))
    with pytest.raises(StorageError, match="the disk is full"):
        run_odd(flats_suite, tmp_path / "run")
    assert [p.name for p in (tmp_path / "run").iterdir()] == []


@pytest.mark.usefixtures("worker_here")
def test_a_disk_that_fills_up_during_a_run_ends_it_and_the_run_goes_on_later(
    flats_suite: Suite, unbroken: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, calls = os.fsync, []

    def full(fd: int) -> None:
        calls.append(fd)
        if len(calls) > 12:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(fd)

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageError, match="the disk is full"):
        run_odd(flats_suite, tmp_path / "run", pause=0.001)
    monkeypatch.setattr(os, "fsync", real)
    assert not (tmp_path / "run" / "summary.json").exists()
    run_odd(flats_suite, tmp_path / "run", pause=0.001)
    assert outputs(tmp_path / "run") == outputs(unbroken)


def test_settings_without_sense_are_refused(flats_suite: Suite, tmp_path: Path) -> None:
    for more in ({"workers": 0}, {"episode_time_limit": 0.0}, {"max_episodes": 0}):
        with pytest.raises(BenchError):
            run_suite(flats_suite, "random", tmp_path / "run", **more)  # type: ignore[arg-type]


def test_a_missing_plugin_module_is_said_before_any_work(
    flats_suite: Suite, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match="no_such_module"):
        run_suite(flats_suite, "random", tmp_path / "out", plugin_modules=("no_such_module",))
    assert not (tmp_path / "out").exists()
