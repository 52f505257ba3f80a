"""Executors by name: which hosts a command opens for its workers."""

from __future__ import annotations

import math
from typing import Literal, get_args

from gn0.errors import ConfigError
from gn0.jobs.hosts import Hosts, HostsProcess

ExecutorName = Literal["process", "ray"]
MOST_WORKERS = 1024


def check_executor(executor: str, workers: int) -> None:
    """Refuse what cannot be opened.

    Raises:
        ConfigError: no such executor, or a number of workers that makes no sense.
    """
    if not 1 <= workers <= MOST_WORKERS:
        raise ConfigError(
            f"{workers} workers", where="--workers", remedy=f"give 1 to {MOST_WORKERS}"
        )
    if executor not in get_args(ExecutorName):
        raise ConfigError(f"no executor {executor!r}", where="--executor", remedy="process or ray")


def check_gpus(executor: str, gpus: float) -> None:
    """Refuse GPUs that nobody can set aside.

    Raises:
        ConfigError: a number that makes no sense, or workers of this machine.
    """
    if not (math.isfinite(gpus) and gpus >= 0):
        raise ConfigError(f"{gpus} GPUs a worker", where="--gpus", remedy="give 0 or more")
    if gpus and executor != "ray":
        raise ConfigError(
            "only Ray sets GPUs aside for workers",
            where="--gpus",
            remedy="leave it out: on this machine one process draws for all workers",
        )
    if gpus > 1 and gpus != int(gpus):
        raise ConfigError(
            f"{gpus:g} GPUs a worker", where="--gpus", remedy="give a part of one, or whole ones"
        )


def open_hosts(
    executor: ExecutorName,
    module: str,
    size: int,
    *,
    code: str,
    ray_address: str = "",
    gpus: float = 0,
) -> Hosts:
    """The hosts of an executor, none started yet.

    Args:
        executor: "process" on this machine, "ray" on a cluster.
        module: what each worker runs, as `python -m`.
        size: how many at a time.
        code: "module:name" of a function that names the code that decides results: machines of a
            cluster must agree on it.
        ray_address: of a running cluster; "" starts one of this machine.
        gpus: cards for each worker of a cluster.

    Raises:
        ConfigError: see `check_executor`.
        BenchError: Ray is not installed, no cluster answers, or it has too few CPUs.
    """
    check_executor(executor, size)
    check_gpus(executor, gpus)
    if executor == "process":
        return HostsProcess(module, size)
    from gn0.jobs.hosts_ray import HostsRay

    return HostsRay(module, size, code=code, gpus=gpus, address=ray_address)
