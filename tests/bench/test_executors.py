"""Executors: the same bytes wherever the workers live, and whatever happens to them there."""

from __future__ import annotations

import builtins
import json
import shutil
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest

from gn0.bench import protocol, runner
from gn0.bench.executors import CODE, MODULE, open_pool, pool_of
from gn0.bench.runner import run_suite
from gn0.bench.scene_archive import pack_folder, read_parcel, unpack_scene
from gn0.bench.worker_messages import Lease, Open, Ready
from gn0.errors import BenchError, ConfigError, FormatError, PolicyError, StorageError
from gn0.jobs.cluster import local_cluster
from gn0.jobs.hosts_ray import HostsRay
from gn0.jobs.process import describe_end
from gn0.missions.episode import AgentSpec
from gn0.suites.suite import Suite

SAME = ("results.jsonl", "trajectories.jsonl", "summary.json")
PLUGIN = Path(__file__).parent / "plugin"
check_code = HostsRay._check_code  # the real one; most tests here must not mind an edit


def outputs(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in SAME}


def episodes_of(out: Path) -> dict[str, Any]:
    return dict(json.loads((out / "run.json").read_text())["episodes"])


@pytest.fixture(scope="module", autouse=True)
def still_code() -> Iterator[None]:
    """Pretend that nobody edits the package while these tests stop and resume runs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "code_version", lambda: "1.0+still")
        patch.setattr(HostsRay, "_check_code", lambda *_: None)
        patch.syspath_prepend(str(PLUGIN))
        yield


@pytest.fixture(scope="module")
def cluster(still_code: None, scratch_cache: None) -> Iterator[None]:
    """One Ray cluster of this machine for all tests here."""
    pytest.importorskip("ray", reason="Ray is not installed: pip install -e '.[scale]'")
    with warnings.catch_warnings():
        # Ray's own files and sockets, closed when its processes end
        warnings.simplefilter("ignore", ResourceWarning)
        warnings.simplefilter("ignore", DeprecationWarning)
        with local_cluster(2):
            yield


@pytest.fixture(scope="module")
def unbroken(
    still_code: None,
    flats_suite: Suite,
    tmp_path_factory: pytest.TempPathFactory,
    no_processes: Callable[[], AbstractContextManager[None]],
) -> Path:
    """One worker in this process, in order, never interrupted."""
    out = tmp_path_factory.mktemp("unbroken") / "run"
    with no_processes():
        run_suite(flats_suite, "odd", out, plugin_modules=("odd_policies",))
    return out


def settings(**more: Any) -> Open:
    values: dict[str, Any] = {
        "policy": "random", "options": {}, "plugin_modules": (), "camera": "gn_bench",
        "backend": "auto", "agent": AgentSpec(), "max_steps": 60, "success_radius": 3.0,
    }  # fmt: skip
    return Open(**values | more)


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_ray_writes_the_same_bytes(
    cluster: None, flats_suite: Suite, unbroken: Path, tmp_path: Path, workers: int
) -> None:
    out = tmp_path / "run"
    run_suite(
        flats_suite, "odd", out, workers=workers, shuffle_seed=workers, executor="ray",
        plugin_modules=("odd_policies",),
    )  # fmt: skip
    assert outputs(out)["results.jsonl"] == outputs(unbroken)["results.jsonl"]
    assert outputs(out) == outputs(unbroken)


@pytest.mark.slow
@pytest.mark.parametrize("odd", ["bereave", "die"])
def test_a_killed_actor_or_worker_loses_nothing(
    cluster: None, flats_suite: Suite, unbroken: Path, tmp_path: Path, odd: str
) -> None:
    out = tmp_path / "run"
    summary = run_suite(
        flats_suite, "odd", out, workers=2, executor="ray", plugin_modules=("odd_policies",),
        policy_options={"odd": odd, "when": "sofa", "marks": str(tmp_path / "mark")},
    )  # fmt: skip
    assert summary.ok and (tmp_path / "mark").exists()
    for name in ("results.jsonl", "trajectories.jsonl"):
        assert (out / name).read_bytes() == (unbroken / name).read_bytes()
    attempts = [e["attempts"] for e in episodes_of(out).values()]
    assert sorted(attempts)[-2:] == [1, 2], "exactly one episode was tried again"


@pytest.mark.slow
def test_a_run_begun_by_one_executor_is_finished_by_the_other(
    cluster: None, flats_suite: Suite, unbroken: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    shutil.copytree(unbroken, out)
    journal = out / "journal.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(lines[: len(lines) // 2]))
    for name in SAME:
        (out / name).unlink()
    run_suite(flats_suite, "odd", out, executor="ray", plugin_modules=("odd_policies",))
    assert outputs(out) == outputs(unbroken)


@pytest.mark.slow
def test_a_hung_worker_of_ray_is_ended_and_shows_where_it_hung(
    cluster: None, flats_suite: Suite, tmp_path: Path
) -> None:
    summary = run_suite(
        flats_suite, "odd", tmp_path / "run", executor="ray", episode_time_limit=1.0,
        plugin_modules=("odd_policies",), policy_options={"odd": "hang", "when": "desk"},
        max_episodes=6,
    )  # fmt: skip
    assert summary.failed and all("longer than 1 s" in r.reason for r in summary.failed)
    words = episodes_of(tmp_path / "run")[summary.failed[0].episode]["traceback"]
    assert "in misbehave" in words


@pytest.mark.slow
def test_a_scene_travels_to_a_machine_that_does_not_see_its_folder(
    cluster: None, flats_suite: Suite
) -> None:
    episode = flats_suite.episodes[0]
    lease = Lease(
        episode=episode,
        folder=str(flats_suite.scene_folder(episode.scene_id)),
        hash=flats_suite.scene_hash(episode.scene_id),
    )
    hosts = HostsRay(MODULE, 1, code=CODE, always_ship=True)
    with pool_of(hosts, settings(agent=episode.agent), 1) as pool:
        worker = pool.start()
        kinds = []
        while "Done" not in kinds:
            heard = pool.hear(60)
            assert heard is not None and heard.message is not None
            kinds.append(type(heard.message).__name__)
            if isinstance(heard.message, Ready):
                pool.send(worker, lease)
        host, process = hosts.pids(worker.number)
        assert host and process and host != process
        ended = pool.end(worker)
        assert ended.how == "was killed by SIGKILL"
    assert kinds == ["Ready", "Begun", "Done"]


@pytest.mark.slow
def test_a_machine_with_other_code_is_refused_by_name(
    cluster: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(HostsRay, "_check_code", check_code)
    monkeypatch.setattr(protocol, "code_version", lambda: "0.0.1+older")
    with (
        open_pool("ray", settings(), 1) as pool,
        pytest.raises(BenchError, match=r"runs gn0 .*, this one 0\.0\.1\+older"),
    ):
        pool.start()
        pool.hear(60)


@pytest.mark.slow
def test_more_workers_than_the_cluster_has_cores_are_refused(cluster: None) -> None:
    with pytest.raises(BenchError, match="900 workers, but the Ray cluster has 2 CPUs"):
        open_pool("ray", settings(), 900)


def test_without_ray_the_error_says_what_to_type(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def refuse(name: str, *rest: Any) -> Any:
        if name == "ray":
            raise ImportError("no ray here")
        return real(name, *rest)

    monkeypatch.delitem(sys.modules, "ray", raising=False)
    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(BenchError, match=r"pip install -e '\.\[scale\]'"):
        open_pool("ray", settings(), 1)
    with pytest.raises(ConfigError, match="no executor 'slurm'"):
        open_pool("slurm", settings(), 1)  # type: ignore[arg-type]


def test_a_worker_that_keeps_dying_while_it_builds_its_policy_ends_the_run(
    flats_suite: Suite, tmp_path: Path
) -> None:
    with pytest.raises(PolicyError, match="ended with exit code 7 while it built policy 'odd'"):
        run_suite(
            flats_suite, "odd", tmp_path / "run", plugin_modules=("odd_policies",),
            policy_options={"odd": "stillborn"},
        )  # fmt: skip


def test_a_worker_killed_once_while_it_builds_its_policy_is_replaced(
    flats_suite: Suite, unbroken: Path, tmp_path: Path
) -> None:
    options = {"odd": "stillborn", "marks": str(tmp_path / "mark")}
    assert run_suite(
        flats_suite, "odd", tmp_path / "run", plugin_modules=("odd_policies",),
        policy_options=options,
    ).ok  # fmt: skip
    same = (tmp_path / "run" / "results.jsonl").read_bytes()
    assert same == (unbroken / "results.jsonl").read_bytes()


def test_a_parcel_holds_a_folder_and_nothing_climbs_out_of_it(
    flat_folder: Path, tmp_path: Path
) -> None:
    parcel = pack_folder(flat_folder)
    assert pack_folder(flat_folder) == parcel
    folder = unpack_scene(parcel, "abc", tmp_path)
    assert folder == tmp_path / "abc"
    for path in flat_folder.rglob("*"):
        if path.is_file():
            assert (folder / path.relative_to(flat_folder)).read_bytes() == path.read_bytes()
    assert unpack_scene(b"unread: it is there", "abc", tmp_path) == folder
    evil = parcel.replace(b"scene.json", b"../ne.json")
    with pytest.raises(StorageError, match="climbs out"):
        unpack_scene(evil, "def", tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["abc"]


def test_a_cut_or_forged_parcel_is_refused(flat_folder: Path) -> None:
    parcel = pack_folder(flat_folder)
    assert len(read_parcel(parcel)) >= 4
    for bad in (
        b"", b"PK\3\4" + parcel, parcel[:17], parcel[:40], parcel[:-1], parcel + b"x",
        parcel[:8] + b"\xff" * 8 + parcel[16:], parcel[:16] + b"\xff" * 16 + parcel[32:],
    ):  # fmt: skip
        with pytest.raises(FormatError):
            read_parcel(bad)


@pytest.mark.parametrize(
    ("code", "words"),
    [(None, "stopped answering"), (-9, "was killed by SIGKILL"), (3, "ended with exit code 3"),
     (-99, "was killed by signal 99")],
)  # fmt: skip
def test_an_end_is_told_in_words(code: int | None, words: str) -> None:
    assert describe_end(code) == words
