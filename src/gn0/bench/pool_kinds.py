"""The one place that knows which executors there are."""

from __future__ import annotations

from gn0.bench.executors import Pool
from gn0.bench.pool_process import PoolProcess
from gn0.bench.worker_messages import Open
from gn0.errors import BenchError
from gn0.jobs import ExecutorName


def open_pool(
    executor: ExecutorName, settings: Open, workers: int, *, ray_address: str = ""
) -> Pool:
    """The pool of an executor, not started yet.

    Raises:
        BenchError: unknown executor, or `ray` is not installed.
    """
    if executor == "process":
        return PoolProcess(settings, workers)
    if executor == "ray":
        from gn0.bench.pool_ray import PoolRay

        return PoolRay(settings, workers, address=ray_address)
    raise BenchError(f"no executor {executor!r}", where="--executor", remedy="process or ray")
