"""Record which kernels GN0's jobs call from Python, for `src/gn0/kernels/kernel_list.txt`.

Each job is a few commands in miniature, run with a hook in every process (`kernel_site`). Commands
of a job come after those of the jobs that made what they read.

    python -m gn0_trials.kernel_record FOLDER          # record all jobs, and write the list
    python -m gn0_trials.kernel_record FOLDER walk     # these jobs only
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from gn0.kernels.kernel_list import FILE, read_list, write_list
from gn0.storage import cache_dir

SITE = Path(__file__).parent / "kernel_site"
_FLAT = "scene generate --size small --density 5000 --light draft --seed 1 --out flat --overwrite"
JOBS: dict[str, tuple[str, ...]] = {
    "scene": (_FLAT,),
    "missions": (
        "missions generate flat --per-scene 3 --people 3 --out goals",
        "missions generate flat --types follow --per-scene 1 --out follows",
    ),
    "walk": (
        "bench run goals --policy random --limit 2 --videos 1 --fresh --out walked",
        "bench run goals --policy oracle --limit 1 --no-report --fresh --out guided",
    ),
    "follow": ("bench run follows --policy oracle --limit 1 --videos 1 --fresh --out followed",),
    "data": (
        "data build goals --layout none --out labels",
        "data build follows --out samples",
    ),
    "device": ("figures people.sim.cuda --out board", "! many"),
    "train": (  # it needs torch
        "train sft goals --split all --held-out= --size nano --samples 64 --batch 8 --agents 4 "
        "--device host --overwrite --out trained",
    ),
}
NEEDS = {  # what jobs find in the folder is made by these
    "missions": "scene", "walk": "missions", "follow": "missions", "data": "missions",
    "train": "missions",
}  # fmt: skip


def record_job(job: str, folder: Path, environment: dict[str, str] | None = None) -> list[str]:
    """The calls of a job's commands, each once, in the order in which they came.

    Args:
        job: one of `JOBS`.
        folder: where they run; what earlier jobs made lies there.
        environment: beside ours.

    Raises:
        RuntimeError: a command failed.
    """
    calls = (folder / f"{job}.calls").resolve()
    calls.unlink(missing_ok=True)
    cache = (folder / f"cache-{job}").resolve()  # with nothing kept that kernels had made
    cache.mkdir(mode=0o700, exist_ok=True)
    if (cache_dir() / "emulation").is_dir() and not (cache / "emulation").exists():
        (cache / "emulation").symlink_to(cache_dir() / "emulation")
    paths = [str(SITE), *filter(None, sys.path)]
    ours = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(paths),
        "GN0_KERNEL_CALLS": str(calls),
        "GN0_CACHE": str(cache),
        "NUMBA_CACHE_DIR": os.environ.get("NUMBA_CACHE_DIR") or str(cache_dir() / "numba"),
        "GN0_DEVICE": "host" if job in ("device", "train") else "none",
        **(environment or {}),
    }
    for command in JOBS[job]:
        module = ("gn0_trials.kernel_record",) if command.startswith("!") else ("gn0",)
        done = subprocess.run(
            [sys.executable, "-m", *module, *shlex.split(command)],
            cwd=folder, env=ours, capture_output=True, text=True, errors="replace",
        )  # fmt: skip
        if done.returncode not in (0, 1):  # 1: a finding, as of episodes that failed
            raise RuntimeError(f"gn0 {command}: {done.returncode}\n{done.stderr[-3000:]}")
    return list(dict.fromkeys(calls.read_text("utf-8").splitlines())) if calls.exists() else []


def step_many() -> None:
    """Step so many agents, alone and among people, that all threads do: other kernels than few."""
    from gn0.sim.batch_people_kernels import PARALLEL_FROM
    from gn0.sim.vector import VectorEnv
    from gn0_figures.people_sim import FOLLOWER, plan_episodes

    scenes, episodes = plan_episodes(1, 3)
    for some in ([msgspec.structs.replace(e, people=()) for e in episodes], episodes):
        env = VectorEnv(
            *(PARALLEL_FROM, scenes), episodes=some, agent=FOLLOWER, sensors=("goal_vector",)
        )
        env.reset(seed=0)
        env.step(np.ones(PARALLEL_FROM, np.int64))


def main(arguments: Sequence[str]) -> int:
    """Record jobs and write the list; 1 when a call cannot be written down."""
    if arguments[0] == "!":
        step_many()
        return 0
    folder = Path(arguments[0])
    folder.mkdir(parents=True, exist_ok=True)
    known: dict[str, Sequence[str]] = dict(read_list()) if FILE.exists() else {}
    unknown: list[str] = []
    for job in arguments[1:] or JOBS:
        calls = record_job(job, folder)
        known[job] = [call for call in calls if not call.startswith("?")]
        unknown += [call for call in calls if call.startswith("?")]
        print(f"{job}: {len(known[job])} calls")
    FILE.write_text(write_list({job: known[job] for job in JOBS if job in known}), "utf-8")
    print(*unknown, sep="\n")
    return 1 if unknown else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
