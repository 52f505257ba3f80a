"""Units of work are done once each, whatever happens to the processes that do them."""

from __future__ import annotations

import os
import signal
import threading
import warnings
from pathlib import Path
from typing import Any

import pytest

import gn0
from gn0.errors import BenchError, ConfigError, FormatError, JobError
from gn0.jobs import run_jobs
from gn0.jobs.cluster import join_cluster
from gn0.jobs.process import WorkerProcess
from gn0.jobs.run import TRIES

WORK = """
import os, signal, sys, time
from pathlib import Path
from gn0.errors import FormatError

def square(payload):
    print("this is not a message")
    return {"square": payload["n"] ** 2, "pid": os.getpid()}

def fall_once(payload):
    mark = Path(payload["mark"])
    if payload["n"] == 2 and not mark.exists():
        mark.write_text("")
        os.kill(os.getpid(), signal.SIGKILL)
    return {"n": payload["n"]}

def fall(payload):
    sys.stderr.write("no room left for this\\n"); sys.stderr.flush()
    os.kill(os.getpid(), signal.SIGKILL)

def count_and_fall(payload):
    with open(payload["mark"], "a") as file:
        file.write("x")
    os.kill(os.getpid(), signal.SIGKILL)

def hang(payload):
    if payload["n"] == 1:
        time.sleep(60)
    return {}

def refuse(payload):
    raise FormatError("bad header", file="a.ply", offset=7, remedy="write it again")

def tell(payload, progress):
    for done in range(4):
        progress("writing", done, 3)
    return {"n": payload["n"]}

def see_cards(payload):
    return {"cards": os.environ.get("CUDA_VISIBLE_DEVICES", "")}

def stumble(payload):
    return {}["nothing"]
"""


SOURCE = Path(gn0.__file__).parent.parent


@pytest.fixture(autouse=True)
def work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "gn0_test_work.py").write_text(WORK)
    monkeypatch.syspath_prepend(str(tmp_path))


def run(name: str, count: int = 5, **options: Any) -> dict[int, dict[str, Any]]:
    found: dict[int, dict[str, Any]] = {}

    def note(index: int, answer: dict[str, Any]) -> None:
        assert index not in found
        found[index] = answer

    extra = options.pop("extra", {})
    payloads = [{"n": n, **extra} for n in range(count)]
    run_jobs(f"gn0_test_work:{name}", payloads, done=note, **options)
    return found


@pytest.mark.parametrize("workers", [1, 2])
def test_each_unit_is_answered_once(workers: int) -> None:
    found = run("square", workers=workers)
    assert {i: a["square"] for i, a in found.items()} == {i: i * i for i in range(5)}
    elsewhere = {a["pid"] for a in found.values()} - {os.getpid()}
    assert len(elsewhere) == (0 if workers == 1 else 2)


def test_a_worker_that_dies_takes_nothing_with_it(tmp_path: Path) -> None:
    found = run("fall_once", workers=2, extra={"mark": str(tmp_path / "mark")})
    assert sorted(a["n"] for a in found.values()) == [0, 1, 2, 3, 4]


def test_a_unit_that_kills_two_workers_is_named_with_their_last_words() -> None:
    names = [f"scene {i}" for i in range(5)]
    with pytest.raises(JobError, match=r"worker of scene \d was killed by SIGKILL, 2 times") as e:
        run("fall", workers=2, names=names)
    assert "no room left for this" in str(e.value)


def test_a_unit_that_hangs_is_given_up() -> None:
    with pytest.raises(JobError, match=r"unit 1 hung"):
        run("hang", workers=2, limit=1.5)


@pytest.mark.parametrize("workers", [1, 2])
def test_errors_cross_the_border_as_they_are(workers: int) -> None:
    with pytest.raises(FormatError, match=r"a.ply, byte 7: bad header \(write it again\)"):
        run("refuse", workers=workers)
    with pytest.raises(JobError, match=r"unit \d failed: KeyError: 'nothing'") as error:
        run("stumble", workers=workers)
    assert "gn0_test_work.py" in error.value.remedy


def test_settings_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ConfigError, match="0 workers"):
        run("square", workers=0)
    with pytest.raises(ConfigError, match="no executor 'slurm'"):
        run("square", executor="slurm")
    assert run("square", 0, workers=4) == {}


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="this system has no SIGSTOP")
def test_a_worker_that_is_slow_to_say_where_it_is_is_waited_for(tmp_path: Path) -> None:
    """It is stopped, and goes on a fifth of a second after it was asked."""
    ready = threading.Event()
    (tmp_path / "gn0_test_waits.py").write_text(
        "import faulthandler, signal, time\nfaulthandler.register(signal.SIGUSR1)\n"
        "print('here', flush=True)\ntime.sleep(60)\n"
    )
    worker = WorkerProcess("gn0_test_waits", lambda line: ready.set(), 1, [str(tmp_path)])
    try:
        assert ready.wait(30.0)
        os.kill(worker.pid, signal.SIGSTOP)
        threading.Timer(0.2, os.kill, (worker.pid, signal.SIGCONT)).start()
        assert "most recent call first" in worker.ask_where()
    finally:
        worker.end()


@pytest.mark.slow
def test_ray_tries_a_unit_twice_as_processes_do(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("ray", reason="Ray is not installed: pip install -e '.[scale]'")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{SOURCE}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # as below
        warnings.simplefilter("ignore", DeprecationWarning)
        with pytest.raises(JobError, match=r"worker of unit 0 was killed by SIGKILL, 2 times"):
            run("count_and_fall", 1, executor="ray", extra={"mark": str(tmp_path / "mark")})
    assert (tmp_path / "mark").read_text() == "x" * TRIES


@pytest.mark.slow
def test_ray_gives_up_what_hangs_and_tells_of_steps(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    pytest.importorskip("ray", reason="Ray is not installed: pip install -e '.[scale]'")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{SOURCE}")
    steps: list[tuple[str, int, int]] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # as below
        warnings.simplefilter("ignore", DeprecationWarning)
        run("tell", 1, executor="ray", steps=lambda *step: steps.append(step))
        with pytest.raises(JobError, match=r"unit 1 hung, 2 times"):
            run("hang", 2, workers=2, executor="ray", limit=8.0)
    assert steps[-1] == ("writing", 3, 3)


@pytest.mark.slow
def test_ray_gives_each_worker_cards_of_its_own(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Ray counts the cards that it is told of; here are none that could be used."""
    ray = pytest.importorskip("ray", reason="Ray is not installed: pip install -e '.[scale]'")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{SOURCE}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # as below
        warnings.simplefilter("ignore", DeprecationWarning)
        ray.init("local", num_cpus=2, num_gpus=2, include_dashboard=False, log_to_driver=False)
        try:
            found = run("see_cards", 2, workers=2, executor="ray", gpus=1)
            with pytest.raises(BenchError, match=r"2 workers of 2 GPUs each, but .* has 2 GPUs"):
                run("see_cards", 2, workers=2, executor="ray", gpus=2)
        finally:
            ray.shutdown()
    assert sorted(answer["cards"] for answer in found.values()) == ["0", "1"]


def test_gpus_that_nobody_can_set_aside_are_refused() -> None:
    with pytest.raises(ConfigError, match="only Ray sets GPUs aside"):
        run("square", gpus=1)
    for gpus in (-1, float("nan"), 1.5):
        with pytest.raises(ConfigError, match="GPUs a worker"):
            run("square", executor="ray", gpus=gpus)


@pytest.mark.slow
def test_ray_gives_the_same_answers(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="Ray is not installed: pip install -e '.[scale]'")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{SOURCE}")
    with warnings.catch_warnings():
        # Ray's own files and sockets, closed when its processes end
        warnings.simplefilter("ignore", ResourceWarning)
        warnings.simplefilter("ignore", DeprecationWarning)
        found = run("square", workers=2, executor="ray")
    assert {i: a["square"] for i, a in found.items()} == {i: i * i for i in range(5)}


@pytest.mark.slow
def test_a_cluster_that_nobody_named_is_left_alone(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """By itself, Ray joins what runs on the machine, or what its environment names."""
    pytest.importorskip("ray", reason="Ray is not installed: pip install -e '.[scale]'")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{SOURCE}")
    monkeypatch.setenv("RAY_ADDRESS", "127.0.0.1:9")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # as above
        warnings.simplefilter("ignore", DeprecationWarning)
        found = run("square", 2, executor="ray")
    assert {i: answer["square"] for i, answer in found.items()} == {0: 0, 1: 1}


@pytest.mark.parametrize(
    ("address", "said"),
    [("", "--executor process"), ("10.0.0.1:6379", "leave out --ray-address")],
)
def test_who_gets_no_cluster_is_told_what_he_can_do(address: str, said: str) -> None:
    class Ray:
        @staticmethod
        def init(**_options: object) -> None:
            raise RuntimeError("no port is free\nand much more")

    with pytest.raises(BenchError, match="no port is free") as told:
        join_cluster(Ray, 2, address)
    assert said in str(told.value) and "much more" not in str(told.value)


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("count", [1, 5])
def test_the_bar_moves_while_units_are_at_work(workers: int, count: int) -> None:
    """What several units say of the same step is added up; what is said of units stays as it is."""
    units: list[tuple[str, int, int]] = []
    steps: list[tuple[str, int, int]] = []
    run(
        "tell", count, workers=workers,
        progress=lambda *step: units.append(step), steps=lambda *step: steps.append(step),
    )  # fmt: skip
    assert units == [("units", done, count) for done in range(count + 1)]
    assert steps[-1] == ("writing", 3 * count, 3 if count == 1 else 0)
    assert [done for _, done, _ in steps] == sorted(done for _, done, _ in steps)
    assert len(steps) >= 2 * count  # a worker leaves out what nobody could read
