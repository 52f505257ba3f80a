"""What a renderer holds on a device, and what of it gives way where memory is short."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Collection, Sequence
from typing import TypeVar

from gn0.device.device import Device
from gn0.errors import DeviceMemoryError
from gn0.render.cuda.calls import RecordedCalls
from gn0.render.cuda.cloud import CloudDevice
from gn0.render.cuda.floors import Arranged, arrange_floors
from gn0.render.cuda.named import NamedClouds
from gn0.render.cuda.parts import Part, clear_sets, list_sets
from gn0.render.cuda.store import CloudStore
from gn0.render.cuda.visible import VisibleSets
from gn0.render.renderer import RenderOptions

_SETS_SHARE = 0.1  # of the memory that is free at the start, for visible sets
T = TypeVar("T")


class HeldScenes:
    """Scenes, their visible sets, clouds with names, and calls that were made ready with them.

    Args:
        device: where they are.
        options: image formation of the calls.
        memory: bytes that clouds may take; 0.6 of what is free now when None.
        sets_memory: bytes that visible sets may take; a tenth of what is free now when None.

    Attributes:
        store: the scenes.
        sets: visible sets by scene, least recently used first.
        named: clouds with names, for instances of them.
        calls: those that came last.
        arranged: the sets of the call that came last; None where they must be arranged anew.
    """

    def __init__(
        self, device: Device, options: RenderOptions, memory: int | None, sets_memory: int | None
    ) -> None:
        self._device = device
        self.store = CloudStore(device, memory)
        share = int(_SETS_SHARE * device.memory()[0])
        self.sets_memory = share if sets_memory is None else sets_memory
        self.sets: OrderedDict[str, VisibleSets] = OrderedDict()
        self.store.on_drop = self._let_go
        self.named = NamedClouds(device)
        self.arranged: Arranged | None = None
        self.calls = RecordedCalls(options)

    def forget_calls(self) -> None:
        """Something that calls were prepared with has changed, or its memory is wanted."""
        self.arranged = None
        self.calls.forget()

    def drop_sets(self, key: str) -> None:
        """A scene's splats are others now, or gone: so are its visible sets."""
        self.sets.pop(key, None)
        self.forget_calls()

    def arrange(
        self,
        keys: list[str | None],
        clouds: Sequence[CloudDevice | None],
        visible: bool | VisibleSets,
    ) -> Arranged:
        """The clouds of `keys` with the visible sets that are here; kept while those are."""
        mine = [None if key is None else self.sets.get(key) for key in keys]
        if isinstance(visible, VisibleSets):
            mine = [None if key is None else visible for key in keys]
        self.arranged = arrange_floors(self._device, keys, clouds, mine, self.arranged)
        return self.arranged

    def trim_sets(self, used: Collection[str]) -> None:
        """Keep the sets of all scenes within their memory; those just `used` go last."""
        for key in used:
            if key in self.sets:
                self.sets.move_to_end(key)
        total = sum(sets.used for sets in self.sets.values())
        for sets in self.sets.values():
            if total <= self.sets_memory:
                break
            total -= sets.used
            sets.clear()
            self.forget_calls()

    def with_room(
        self,
        attempt: Callable[[], T],
        wanted: Collection[str] = (),
        parts: Sequence[Part | None] = (),
        pinned: Collection[str] = (),
    ) -> T:
        """What `attempt` gives. Where memory is short, scenes give way, then sets.

        Those that this call has `wanted` go after all others, and those `pinned` never.

        Raises:
            DeviceMemoryError: there is no room even so.
        """
        cleared = False
        while True:
            try:
                return attempt()
            except DeviceMemoryError:
                self.forget_calls()  # they hold sets and clouds
                self.named.let_go()
                if self.store.give_way(wanted) or self.store.give_way(pinned):
                    continue
                if cleared or not clear_sets([*self.sets.values(), *list_sets(list(parts))]):
                    raise
                cleared = True  # once: the next attempt brings back those that it needs

    def _let_go(self, key: str) -> None:
        """A cloud is about to give way: its sets must not keep its memory."""
        self.forget_calls()
        if key in self.sets:
            self.sets[key].let_go()
