"""Ray, if it is installed: a cluster on this machine, or one that is already running."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from typing import Any

from gn0.errors import BenchError

OBJECT_STORE = 256 * 2**20  # bytes of the store of a cluster of this machine alone


def import_ray() -> Any:
    """Ray, told not to phone home.

    Raises:
        BenchError: it is not installed.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    try:
        import ray
    except ImportError as error:
        raise BenchError(
            "Ray is not installed",
            where="--executor ray",
            remedy="pip install -e '.[scale]', or use --executor process",
        ) from error
    return ray


@contextlib.contextmanager
def local_cluster(cpus: int) -> Iterator[None]:
    """A Ray cluster of this machine alone for the length of a block, shared by the runs in it.

    Raises:
        BenchError: Ray is not installed, or does not start.
    """
    ray = import_ray()
    join_cluster(ray, cpus)
    try:
        yield
    finally:
        ray.shutdown()


def join_cluster(ray: Any, cpus: int, address: str = "", *, gpus: float = 0) -> None:
    """Connect to a running cluster, or start one of this machine alone with so many CPUs.

    Args:
        ray: the module.
        cpus: of a cluster that is started here.
        address: of a running one ("auto", or host:port); "" starts one.
        gpus: that its workers will ask for; one that is started here then has this machine's.

    Raises:
        BenchError: no cluster answers.
    """
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    options["address"] = address or "local"  # else Ray takes one that it finds on this machine
    if not address:
        options |= {"num_cpus": cpus, "include_dashboard": False}
        options |= {} if gpus else {"num_gpus": 0}
        options |= {"object_store_memory": OBJECT_STORE}
    try:
        ray.init(**options)
    except (ConnectionError, OSError, RuntimeError, ValueError, TimeoutError) as error:
        raise BenchError(
            f"Ray does not start or answer: {str(error).splitlines()[0] if str(error) else ''}",
            where=f"--ray-address {address}" if address else "--executor ray",
            remedy="check `ray status`, or leave out --ray-address to use this machine alone"
            if address
            else "use --executor process, which needs no cluster",
        ) from error
