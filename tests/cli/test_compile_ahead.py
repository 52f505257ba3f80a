"""What a first run will want next is compiled beside it."""

from __future__ import annotations

import subprocess
from typing import Any

import pytest

from gn0.cli import compile_ahead as ahead


def test_kernels_of_a_first_run_are_used() -> None:
    """It must go on to plan and draw in the built-in flat: nobody hears of it when it fails."""
    ahead.use_kernels()


@pytest.mark.parametrize(
    ("compiled", "cores", "begun"), [(False, 2, 1), (True, 2, 0), (False, 1, 0)]
)
def test_a_process_is_begun_where_it_helps_and_ended_with_the_work(
    monkeypatch: pytest.MonkeyPatch, compiled: bool, cores: int, begun: int
) -> None:
    processes: list[subprocess.Popen[bytes]] = []

    class Watched(subprocess.Popen):  # type: ignore[type-arg]
        def __init__(self, *args: Any, **kwargs: Any) -> None:
            super().__init__(*args, **kwargs)
            processes.append(self)

    monkeypatch.setattr(ahead.subprocess, "Popen", Watched)
    monkeypatch.setattr(ahead, "_CODE", "import time; time.sleep(60)")
    monkeypatch.setattr(ahead, "_is_compiled", lambda: compiled)
    monkeypatch.setattr(ahead.os, "cpu_count", lambda: cores)
    with ahead.compile_ahead():
        assert len(processes) == begun
        assert all(process.poll() is None for process in processes)
    assert all(process.poll() is not None for process in processes)
