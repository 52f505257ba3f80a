"""What takes long to import is left out of processes that run and draw episodes."""

import subprocess
import sys

STARTED = (
    "gn0.bench.episode_worker",
    "gn0.bench.runner",
    "gn0.bench.report",
    "gn0.data.build",
    "gn0.render.share.server",
    "gn0.sim.vector",
    "gn0.suites.named_suites",
)
LATE = ("scipy.spatial", "scipy.ndimage", "scipy.special", "scipy.optimize", "matplotlib", "torch")


def test_processes_of_a_run_start_without_what_few_of_them_need():
    code = f"import sys, {', '.join(STARTED)}; print(*(m for m in {LATE} if m in sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    assert done.stdout.split() == []
