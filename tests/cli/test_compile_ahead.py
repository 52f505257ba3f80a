"""What a job will want next is compiled beside it, and what that is the list knows."""

from __future__ import annotations

import inspect
import itertools
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from gn0.cli import compile_ahead as ahead
from gn0.cli.main import KERNELS, VERBS
from gn0.kernels.kernel_list import find_kernel, list_calls, read_list
from gn0.kernels.kernel_types import call_text, read_type
from gn0_trials.kernel_record import JOBS, NEEDS, record_job

ROOT = Path(__file__).resolve().parents[2]
SMALL = ("maps.inflate._squared_distances bool[2C]", "maps.regions._flood bool[2C]")


def compile_cold(cache: Path, code: str) -> str:
    """What a process with a cache of kernels of its own prints."""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache)}, cwd=ROOT,
    )  # fmt: skip
    return done.stdout


COMPILE = f"""
from gn0.kernels import kernel_list
kernel_list.read_list = lambda text=None: {{"walk": {SMALL!r}}}
from gn0.cli.compile_ahead import compile_all, is_compiled
told = []
before = is_compiled("walk")
found = compile_all("walk", processes=2, progress=lambda stage, done, total: told.append(done))
print(before, found.made, found.kept, found.failed, told, is_compiled("walk"))
"""
USE = """
import numpy as np
from gn0.maps.inflate import _squared_distances
_squared_distances(np.zeros((4, 4), np.bool_))
print(sum(_squared_distances.stats.cache_hits.values()))
"""


def test_what_is_compiled_ahead_is_loaded_by_who_needs_it(tmp_path: Path) -> None:
    """The types of the list are those of real calls, or the code would be compiled again."""
    cache = tmp_path / "kernels"
    assert compile_cold(cache, COMPILE).strip() == "False 2 0 0 [1, 2] True"
    assert compile_cold(cache, COMPILE).strip() == "True 0 2 0 [1, 2] True"
    assert compile_cold(cache, USE).strip() == "1"


def test_a_list_of_other_code_stops_nobody(tmp_path: Path) -> None:
    code = COMPILE.replace("maps.regions._flood bool[2C]", "maps.regions.gone bool[2C]")
    assert compile_cold(tmp_path / "kernels", code).strip() == "False 1 0 1 [1, 2] False"


def test_without_a_cache_nothing_is_compiled(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    said = compile_cold(tmp_path / "file" / "kernels", COMPILE)
    assert said.strip() == "False 0 0 0 [] False"


def test_who_is_not_waited_for_any_more_has_not_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    """One process says that there is no cache while another is still at its call."""
    asked, told, workers = threading.Event(), [], itertools.count()

    class Worker:
        def __init__(self, _module: str, say: Any, *_: object) -> None:
            self._say, self._silent = say, next(workers) == 0

        def send(self, _call: bytes) -> None:
            if self._silent:
                asked.set()
            else:
                asked.wait(60.0)
                self._say(b"nowhere")

        def end(self) -> None:
            pass

    monkeypatch.setattr(ahead, "WorkerProcess", Worker)
    found = ahead.compile_all("walk", processes=2, progress=lambda _s, done, _t: told.append(done))
    assert found == ahead.Compiled() and not told


@pytest.mark.parametrize(
    ("compiled", "cores", "rank", "begun"),
    [(False, 4, "0", 1), (True, 4, "0", 0), (False, 2, "0", 0), (False, 8, "1", 0)],
)
def test_processes_begin_where_they_help_and_end_with_the_work(
    monkeypatch: pytest.MonkeyPatch, compiled: bool, cores: int, rank: str, begun: int
) -> None:
    asked: list[tuple[Sequence[str], int]] = []
    stopped = threading.Event()

    def compile_until(jobs: Sequence[str], count: int, progress: Any, ended: Any) -> None:
        asked.append((jobs, count))
        ended.wait(60.0)
        stopped.set()

    monkeypatch.setattr(ahead, "_compile", compile_until)
    monkeypatch.setattr(ahead, "is_compiled", lambda *jobs: compiled)
    monkeypatch.setattr(ahead, "count_cores", lambda: cores)
    monkeypatch.setenv("LOCAL_RANK", rank)
    with ahead.compile_ahead("walk"):
        pass
    assert asked == [(("walk",), cores - 1)] * begun
    assert stopped.is_set() == bool(begun)


def test_verbs_ask_for_jobs_that_were_recorded() -> None:
    assert set(KERNELS) <= set(VERBS)
    assert {job for jobs in KERNELS.values() for job in jobs} <= set(read_list()) == set(JOBS)


def test_each_call_names_a_kernel_and_its_arguments() -> None:
    for call in list_calls():
        kernel = find_kernel(call)
        kinds = [read_type(text) for text in call.split()[1:]]
        inspect.signature(kernel.py_func).bind(*kinds)
        assert call_text(call.split()[0], kinds) == call


@pytest.mark.slow
@pytest.mark.parametrize("job", JOBS)
def test_the_list_has_all_that_a_job_calls(job: str, record: Callable[[str], list[str]]) -> None:
    """If it has not: `python -m gn0_trials.kernel_record FOLDER` records it again."""
    if job == "train" and not find_spec("torch"):
        pytest.skip("training needs torch")
    calls = record(job)
    assert calls and set(calls) <= set(list_calls())


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], list[str]]:
    """What a job calls, once it and those that make what it finds have run."""
    folder = tmp_path_factory.mktemp("recorded")

    @cache
    def calls_of(job: str) -> list[str]:
        if job in NEEDS:
            calls_of(NEEDS[job])
        return record_job(job, folder)

    return calls_of
