"""How a worker process ended is told as it was."""

import sys
import threading
from pathlib import Path

import pytest

from gn0.jobs.process import WorkerProcess


@pytest.mark.parametrize(
    ("ending", "told"),
    [
        ("raise SystemExit(4)", "ended with exit code 4"),
        ("os.close(1); time.sleep(0.3); os._exit(5)", "ended with exit code 5"),
        ("os.kill(os.getpid(), signal.SIGTERM)", "was killed by SIGTERM"),
    ],
)
def test_one_that_goes_by_itself_was_not_killed_by_us(
    tmp_path: Path, ending: str, told: str
) -> None:
    (tmp_path / "leaver.py").write_text(f"import os, signal, sys, time\n{ending}\n")
    gone = threading.Event()
    worker = WorkerProcess(
        "leaver", lambda line: gone.set() if line is None else None, 1, [str(tmp_path), *sys.path]
    )
    assert gone.wait(30)
    worker._listeners[0].join(10)
    assert worker.end().how == told


def test_one_that_stays_is_killed_at_once(tmp_path: Path) -> None:
    (tmp_path / "stayer.py").write_text("import time\nprint(1, flush=True)\ntime.sleep(60)\n")
    begun = threading.Event()
    worker = WorkerProcess("stayer", lambda _: begun.set(), 1, [str(tmp_path), *sys.path])
    assert begun.wait(30)
    assert worker.end().how == "was killed by SIGKILL"
