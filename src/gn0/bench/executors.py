"""Executors: where the workers of a run live, and what the runner knows about each.

`process` keeps them on this machine as child processes; `ray` spreads them over a Ray cluster. What
a worker does, and so every byte of a result, is the same on each of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from gn0.bench.scene_archive import MARKER, pack_folder, unpack_scene
from gn0.bench.worker_messages import FromWorker, Lease, Open
from gn0.errors import BenchError
from gn0.jobs.executors import ExecutorName, open_hosts
from gn0.jobs.hosts import Goods, Hosts
from gn0.jobs.pool import Pool, Worker

MODULE = "gn0.bench.episode_worker"
CODE = "gn0.bench.protocol:code_version"
RECEIVE = f"{__name__}:receive_lease"
LOAD_TIME_LIMIT = 900.0  # s to load a scene and to build the policy


@dataclass(eq=False)
class EpisodeSeat(Worker):
    """One worker as the runner sees it.

    Attributes:
        scene: the scene it has loaded, or is loading.
        leased: the episodes it holds a lease of, and by when each that has begun must have ended
            (monotonic time [s]); infinity for one that has not.
        alone: its one episode is not to run beside others.
        ready: its policy is built.
        due: by when it must have built its policy, or begun an episode.
    """

    scene: str = ""
    leased: dict[str, float] = field(default_factory=dict)
    alone: bool = False
    ready: bool = False

    @property
    def deadline(self) -> float:
        """Monotonic time [s] after which it counts as hung."""
        begun = min(self.leased.values(), default=float("inf"))
        waits = not self.ready or (bool(self.leased) and begun == float("inf"))
        return self.due if waits else begun


EpisodePool = Pool[EpisodeSeat, FromWorker]


def open_pool(
    executor: ExecutorName,
    settings: Open,
    workers: int,
    *,
    ray_address: str = "",
    gpus: float = 0,
) -> EpisodePool:
    """Workers that run episodes, none started yet.

    Raises:
        ConfigError: unknown executor.
        BenchError: `ray` is not installed, or its cluster does not serve.
    """
    hosts = open_hosts(executor, MODULE, workers, code=CODE, ray_address=ray_address, gpus=gpus)
    return pool_of(hosts, settings, workers)


def pool_of(hosts: Hosts, settings: Open, workers: int) -> EpisodePool:
    """Workers that run episodes on these hosts; each is told first which policy to build."""

    def greet(worker: EpisodeSeat) -> Open:
        return msgspec.structs.replace(settings, slot=worker.slot)

    return Pool(hosts, workers, EpisodeSeat, FromWorker, greet=greet, goods=_pack_scene)


def _pack_scene(message: Any) -> Goods | None:
    """The scene of a lease, for a machine that does not see its folder."""
    if not isinstance(message, Lease):
        return None
    folder = Path(message.folder)
    return Goods(message.hash, folder / MARKER, lambda: pack_folder(folder), RECEIVE)


def receive_lease(line: bytes, parcel: bytes) -> bytes:
    """A lease whose scene came along, on the machine of the worker."""
    lease = msgspec.json.decode(line, type=Lease)
    folder = str(unpack_scene(parcel, lease.hash))
    return msgspec.json.encode(msgspec.structs.replace(lease, folder=folder))


def check_workers(workers: int) -> int:
    """The number of workers, if it makes sense.

    Raises:
        BenchError: less than one, or beyond reason.
    """
    if not 1 <= workers <= 1024:
        raise BenchError(f"{workers} workers", where="--workers", remedy="give 1 to 1024")
    return workers


def check_agents(agents: int) -> int:
    """The number of agents a worker, if it makes sense.

    Raises:
        BenchError: less than one, or beyond reason.
    """
    if not 1 <= agents <= 4096:
        raise BenchError(f"{agents} agents", where="--agents", remedy="give 1 to 4096")
    return agents
