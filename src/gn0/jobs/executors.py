"""Executors by name: which hosts a command opens for its workers."""

from __future__ import annotations

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


def open_hosts(
    executor: ExecutorName, module: str, size: int, *, code: str, ray_address: str = ""
) -> Hosts:
    """The hosts of an executor, none started yet.

    Args:
        executor: "process" on this machine, "ray" on a cluster.
        module: what each worker runs, as `python -m`.
        size: how many at a time.
        code: "module:name" of a function that names the code that decides results: machines of a
            cluster must agree on it.
        ray_address: of a running cluster; "" starts one of this machine.

    Raises:
        ConfigError: see `check_executor`.
        BenchError: Ray is not installed, no cluster answers, or it has too few CPUs.
    """
    check_executor(executor, size)
    if executor == "process":
        return HostsProcess(module, size)
    from gn0.jobs.hosts_ray import HostsRay

    return HostsRay(module, size, code=code, address=ray_address)
