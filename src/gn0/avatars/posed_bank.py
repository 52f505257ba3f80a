"""Posed people that are kept: a cloud is made when it is first asked for, others make room.

A walk repeats itself: who has gone through a cycle is posed no more. Clouds have names for a
renderer. A name that became free is given to another cloud of about its size, so that what a
renderer keeps by name stays bounded as well. For the CPU renderer clouds are posed as it draws
them, 40 bytes a splat in all: it knows those as long as they are here.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from gn0.avatars.reuse import ReuseOrder
from gn0.errors import ConfigError
from gn0.gaussians.cloud import GaussianCloud
from gn0.render.cpu_posed import PosedPacked

BUDGET = 512 * 2**20  # of posed clouds [bytes]
NEARER = 0.06  # `Instance.nearer` of people [m], so that floors do not come before their shoes
SPLAT_BYTES = 136  # of a splat of a plain cloud: 44 that a pose changes, 92 as a renderer packs it

Pose = Callable[[], GaussianCloud]


@dataclass(frozen=True, eq=False)
class PosedCloud:
    """A posed cloud and the name by which a renderer knows it, until another cloud has the name.

    Attributes:
        key: what was asked for.
        name: for `Renderer.name_cloud` and `Instance`.
        cloud: the splats.
    """

    key: Hashable
    name: str
    cloud: GaussianCloud | PosedPacked

    @property
    def nbytes(self) -> int:
        """Bytes that are its own, those that a renderer keeps of it included."""
        if isinstance(self.cloud, PosedPacked):
            return self.cloud.nbytes
        return SPLAT_BYTES * len(self.cloud)


@runtime_checkable
class PosesPacked(Protocol):
    """What poses a cloud, and can do it as the CPU renderer draws it: `PoseShown`."""

    def __call__(self) -> GaussianCloud:
        """The cloud."""
        ...

    def pack(self) -> PosedPacked:
        """The same, to the bit."""
        ...


class _NamesClouds(Protocol):
    def name_cloud(self, name: str, cloud: GaussianCloud) -> None: ...


class _NamesPacked(Protocol):
    def name_packed(self, name: str, posed: PosedPacked) -> None: ...


class PosedBank:
    """Posed clouds by key, under a budget. For one thread.

    A key tells all that a cloud depends on, as (digest of the avatar, clip, phase, level of
    detail, yaw of the head): equal keys, equal clouds.

    Args:
        budget: bytes of all clouds together, as posed and as a renderer packs them; the arrays
            that an avatar's clouds share are not counted.
        prefix: how names begin.
        packed: whether what `PosesPacked` is posed so; for renderers that `name_packed`.

    Attributes:
        hits, misses: how many clouds were there when they were asked for, and how many not.

    Raises:
        ConfigError: the budget is not above 0.
    """

    def __init__(
        self, budget: int = BUDGET, *, prefix: str = "posed", packed: bool = False
    ) -> None:
        if budget <= 0:
            raise ConfigError(
                f"{budget} bytes for posed people", where="PosedBank", remedy="give more than 0"
            )
        self.budget, self.prefix, self.packed = budget, prefix, packed
        self.hits = self.misses = 0
        self._held: dict[Hashable, PosedCloud] = {}
        self._order = ReuseOrder()
        self._bytes = 0
        self._free: dict[int, list[str]] = {}  # names, by size
        self._given: dict[int, int] = {}  # names so far, by size

    def __len__(self) -> int:
        return len(self._held)

    def __contains__(self, key: object) -> bool:
        return key in self._held

    @property
    def bytes(self) -> int:
        """Bytes of all clouds, never above the budget."""
        return self._bytes

    @property
    def hit_rate(self) -> float:
        """Share of clouds that were there when they were asked for; 0 before any was."""
        return self.hits / max(self.hits + self.misses, 1)

    def fetch(self, wanted: Sequence[tuple[Hashable, Pose]]) -> list[PosedCloud]:
        """The clouds of one picture, made where they are not here.

        They stay, and keep their names, until the next call; what is expected to be asked for last
        makes room for them, see `gn0.avatars.reuse`.

        Args:
            wanted: a key and the function that poses it, for each; keys may repeat.

        Raises:
            ConfigError: together they are larger than the budget; nothing is kept of this call
                beyond what fitted.
        """
        now = dict(wanted)
        lacking = [key for key in now if key not in self._held]
        self.misses += len(lacking)
        self.hits += len(wanted) - len(lacking)
        self._order.ask(now)
        try:
            for key in lacking:
                self._hold(key, now[key])
        finally:
            for key in lacking:
                if key not in self._held:
                    self._order.drop(key)
        return [self._held[key] for key, _ in wanted]

    def tell(self, renderer: _NamesClouds | _NamesPacked, posed: Sequence[PosedCloud]) -> None:
        """Make clouds known to a renderer, under their names; those it knows cost nothing."""
        for each in posed:
            if isinstance(each.cloud, PosedPacked):
                renderer.name_packed(each.name, each.cloud)  # type: ignore[union-attr]
            else:
                renderer.name_cloud(each.name, each.cloud)  # type: ignore[union-attr]

    def _hold(self, key: Hashable, pose: Pose) -> None:
        cloud: GaussianCloud | PosedPacked
        if self.packed and isinstance(pose, PosesPacked):
            cloud = pose.pack()
        else:
            cloud = pose()
        sort = len(cloud).bit_length()
        made = PosedCloud(key, "", cloud)
        self._make_room(made.nbytes)
        free = self._free.setdefault(sort, [])
        if not free:
            number = self._given[sort] = self._given.get(sort, 0) + 1
            free.append(f"{self.prefix}/{sort}/{number}")
        self._held[key] = PosedCloud(key, free.pop(), cloud)
        self._bytes += made.nbytes

    def _make_room(self, size: int) -> None:
        while self._bytes + size > self.budget:
            key = self._order.choose() if self._held else None
            if key is None:
                raise ConfigError(
                    f"the people of one picture need more than {self.budget:,} bytes",
                    where="PosedBank.fetch",
                    remedy="give a larger budget, or draw people at coarser levels of detail",
                )
            gone = self._held.pop(key)
            self._order.drop(key)
            self._bytes -= gone.nbytes
            self._free.setdefault(len(gone.cloud).bit_length(), []).append(gone.name)
