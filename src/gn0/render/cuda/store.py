"""Many clouds on one device under a memory budget: loaded when first drawn, least recent out first.

A cloud goes under a key (a scene, or a scene and its light) and carries the content hash of what
it was made from. The same key with another hash is another scene: the old splats are dropped at
once, so a scene that was swapped on disk is never shown as it was.
"""

from __future__ import annotations

import contextlib
from collections import OrderedDict, deque
from collections.abc import Callable, Collection, Generator, Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice

from gn0.device.device import Device
from gn0.errors import DeviceMemoryError, RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.jobs.process import count_cores
from gn0.render.cuda.cloud import CloudDevice
from gn0.render.cuda.pack import CloudReady, cloud_bytes, prepare_cloud, upload_cloud

_SMALLER = "use backend 'cpu', or a scene with fewer splats or a lower SH degree"
SHARE = 0.6  # of the memory that is free at the start, for clouds; the rest is for drawing
_AHEAD, _THREADS = 2**29, 16  # bytes of clouds that are loaded before their turn, by how many cores
_WAITING = 3  # threads a core: the looks of a scene wait for the first of them, and take none
Load = Callable[[], GaussianCloud | CloudReady]


@dataclass(frozen=True)
class CloudSource:
    """Where a cloud comes from.

    Attributes:
        load: gives the cloud, each time it is brought to the device; may run in a thread of its
            own, while another cloud is brought there or drawn.
        digest: content hash of what `load` gives; "" when nobody knows.
    """

    load: Load
    digest: str = ""


class CloudStore:
    """Clouds by key; those in use stay, others give way.

    Args:
        device: where they live.
        memory: bytes that clouds may take; 0.6 of what is free now when None.
    """

    def __init__(self, device: Device, memory: int | None = None) -> None:
        self.device = device
        self.on_drop: Callable[[str], None] = lambda key: None  # told who has to go, before it does
        self.memory = int(SHARE * device.memory()[0]) if memory is None else memory
        self._sources: dict[str, CloudSource] = {}
        self._held: OrderedDict[str, CloudDevice] = OrderedDict()  # least recent first
        self._kept: set[str] = set()  # never dropped to make room
        self._sizes: dict[str, int] = {}  # bytes of what was here at some time
        self._apart: frozenset[str] = frozenset()  # what last did not fit together
        self.loads = 0  # clouds brought here so far, for figures

    def __contains__(self, key: str) -> bool:
        return key in self._sources

    @property
    def used(self) -> int:
        """Bytes of the clouds that are here."""
        return sum(cloud.nbytes for cloud in self._held.values())

    @property
    def resident(self) -> list[str]:
        """Keys of the clouds that are here, least recently used first."""
        return list(self._held)

    def holds(self, key: str) -> bool:
        """Whether a cloud is here; any thread may ask."""
        return key in self._held

    def add(self, key: str, load: Load, digest: str = "") -> bool:
        """Name a cloud; it is loaded when first drawn.

        The same key again keeps what is here only if the hash is the same, or, without hashes, if
        `load` is the very same. Otherwise it is loaded anew.

        Returns:
            Whether the key was new or its cloud has changed.
        """
        source, known = CloudSource(load, digest), self._sources.get(key)
        same = known is not None and (
            known.digest == digest if digest or known.digest else known.load == load
        )
        self._sources[key] = source
        if not same:
            self._forget(key)
        return not same

    def keep(self, key: str, cloud: GaussianCloud, digest: str = "") -> CloudDevice:
        """Bring a cloud here now, to stay until it is removed; nobody is asked for it again.

        Raises:
            RenderError, DeviceMemoryError: see `groups`.
        """
        self.add(key, _no_load, digest)
        self._drop(key)
        found = self._bring(key, cloud, {})
        assert found is not None
        self._kept.add(key)
        return found

    def remove(self, key: str) -> None:
        """Forget a cloud; one that is not here is no error."""
        self._sources.pop(key, None)
        self._forget(key)

    def _forget(self, key: str) -> None:
        self._sizes.pop(key, None)
        self._apart = frozenset()
        self._drop(key)

    def digest(self, key: str) -> str:
        """Content hash of a cloud, as it was added.

        Raises:
            RenderError: no such key.
        """
        return self._source(key).digest

    def groups(self, keys: Sequence[str]) -> Generator[dict[str, CloudDevice]]:
        """The clouds of `keys`, in groups that fit together; what is in a group stays for its turn.

        One group when all fit; a group is emptied when the next is asked for. What is here already
        comes first, so that it is not dropped to make room before its turn; then by name, so that
        looks of one scene are loaded side by side. While one cloud is brought here, or a group is
        drawn, the next one is loaded beside.

        Raises:
            RenderError: no such key, or a cloud that cannot be drawn.
            DeviceMemoryError: a cloud is larger than all memory for clouds, or than the device.
        """
        wanted = list(dict.fromkeys(keys))
        for key in wanted:
            self._source(key)
        wanted.sort(key=lambda key: (key not in self._held, key))
        group: dict[str, CloudDevice] = {}
        missing = [key for key in wanted if key not in self._held]
        ahead = _load_ahead({key: self._source(key).load for key in missing})
        with contextlib.closing(ahead):
            for key in wanted:
                found = self._held.get(key)
                if found is None:
                    if key in missing:
                        cloud = next(cloud for name, cloud in ahead if name == key)
                    else:  # it was here when we began
                        cloud = self._source(key).load()
                    found = self._bring(key, cloud, group)
                    if found is None:  # not beside those of the group: draw them first
                        yield group
                        group.clear()  # whoever still holds it must not keep the memory
                        found = self._bring(key, cloud, group)
                    assert found is not None
                self._held.move_to_end(key)
                group[key] = found
            if group:
                yield group

    def together(self, keys: Sequence[str]) -> dict[str, CloudDevice] | None:
        """The clouds of `keys`, all here at once; None where they do not fit together.

        Nothing is loaded in vain for keys that did not fit before.

        Raises:
            RenderError, DeviceMemoryError: see `groups`.
        """
        wanted = frozenset(keys)
        need = sum(self._sizes.get(key, 0) for key in wanted)
        if need > self.memory or (self._apart and self._apart <= wanted):
            return None
        with contextlib.closing(self.groups(keys)) as groups:
            found = dict(next(groups, {}))
        if len(found) < len(wanted):
            self._apart = wanted
            return None
        return found

    def touch(self, keys: Iterable[str | None]) -> None:
        """Clouds are used now: they give way after the others."""
        for key in keys:
            if key is not None and key in self._held:
                self._held.move_to_end(key)

    def open(self, key: str) -> CloudDevice:
        """One cloud, brought here if need be.

        Raises:
            RenderError, DeviceMemoryError: see `groups`.
        """
        return next(self.groups([key]))[key]

    def give_way(self, pinned: Collection[str] = ()) -> bool:
        """Drop the least recently used cloud that is not `pinned`; whether there was one."""
        for key in self._held:
            if key not in pinned and key not in self._kept:
                self._drop(key)
                return True
        return False

    def _drop(self, key: str) -> None:
        if key in self._held:
            self.on_drop(key)
            del self._held[key]
        self._kept.discard(key)

    def _source(self, key: str) -> CloudSource:
        if key not in self._sources:
            raise RenderError(f"no scene {key!r} has been added", remedy="call add first")
        return self._sources[key]

    def _bring(
        self, key: str, cloud: GaussianCloud | CloudReady, pinned: dict[str, CloudDevice]
    ) -> CloudDevice | None:
        """Upload a cloud; None when there is room only without those `pinned`."""
        need = self._sizes[key] = cloud_bytes(len(cloud), cloud.sh_degree)
        if need > self.memory:
            raise DeviceMemoryError(
                f"scene {key!r} needs {need / 2**20:.0f} MiB, more than the "
                f"{self.memory / 2**20:.0f} MiB for all scenes",
                where=self.device.name,
                remedy=f"allow more memory, or {_SMALLER}",
            )
        while self.used + need > self.memory:
            if not self.give_way(pinned):
                return None
        while True:
            try:
                found = upload_cloud(self.device, cloud)
                break
            except DeviceMemoryError as error:
                if self.give_way(pinned):
                    continue
                if pinned:
                    return None
                raise DeviceMemoryError(
                    f"scene {key!r} needs {need / 2**20:.0f} MiB, and "
                    f"{self.device.memory()[0] / 2**20:.0f} MiB are free",
                    where=self.device.name,
                    remedy=_SMALLER,
                ) from error
        self._held[key] = found
        self.loads += 1
        return found


def _load_ahead(
    loads: Mapping[str, Load],
) -> Generator[tuple[str, GaussianCloud | CloudReady], None, None]:
    """What some loaders give, in order; those that follow run while one is made use of.

    One of them at least, and as many as `_AHEAD` bytes of host memory hold, by the last one's size.
    """
    if len(loads) < 2:
        yield from ((key, load()) for key, load in loads.items())
        return
    most = _WAITING * min(_THREADS, count_cores())
    with ThreadPoolExecutor(most, "load clouds") as pool:
        coming = iter(loads.items())
        waiting: deque[tuple[str, Future[CloudReady]]] = deque()

        def begin(count: int) -> None:
            for key, load in islice(coming, max(0, count - len(waiting))):
                waiting.append((key, pool.submit(_get_ready, load)))

        begin(2)
        try:
            while waiting:
                key, begun = waiting.popleft()
                ready = begun.result()
                size = cloud_bytes(len(ready), ready.sh_degree)
                begin(max(1, min(most, _AHEAD // max(size, 1))))
                yield key, ready
        finally:  # an error, or nobody wants the others
            for _, begun in waiting:
                begun.cancel()


def _get_ready(load: Load) -> CloudReady:
    cloud = load()
    return cloud if isinstance(cloud, CloudReady) else prepare_cloud(cloud)


def _no_load() -> GaussianCloud:
    raise RenderError("a cloud that was to stay has been dropped", where="CloudStore")
