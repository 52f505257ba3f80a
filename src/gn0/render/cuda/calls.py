"""Drawing calls that come again: one that came twice is recorded, and from then on only replayed.

What a call was prepared with (clouds, visible sets, buffers) may change at any time; whoever
changes it says so, or has a version. A call that cannot be replayed is drawn the long way.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gn0.errors import DeviceMemoryError, RenderError
from gn0.render.camera import Camera
from gn0.render.cuda.draw import Drawer
from gn0.render.cuda.instances import Instances
from gn0.render.cuda.replay import PicturesDevice, Replay, SetMissingError
from gn0.render.cuda.visible import Cell, VisibleSets
from gn0.render.renderer import LABELS, Output, RenderOptions

CALLS = 8  # kinds of calls that are remembered
Record = Callable[[], Replay | None]


class Call(NamedTuple):
    """What makes two calls alike: all but the poses."""

    camera: Camera
    keys: tuple[str | None, ...] | str
    shape: tuple[int, ...]
    outputs: tuple[Output, ...]
    background: tuple[float, ...] | None
    visible: bool | VisibleSets | None
    instances: tuple[object, ...] | None = None


def name_call(
    camera: Camera,
    views: NDArray[np.floating],
    keys: Sequence[str | None] | str,
    outputs: tuple[Output, ...],
    background: Sequence[float] | None,
    visible: bool | VisibleSets | Sequence[Cell | None] | None,
    instances: Instances | None = None,
) -> Call | None:
    """What a call is remembered by; None if it is not of a kind that is, as with labels."""
    if set(outputs) & set(LABELS):
        return None
    if not (visible is None or isinstance(visible, bool | VisibleSets)):
        return None
    if views.dtype.kind not in "fiu" or views.shape[-2:] != (4, 4) or not 2 <= views.ndim <= 3:
        return None
    if not views.size or (background is not None and np.shape(background) != (3,)):
        return None
    named = keys if isinstance(keys, str) else tuple(keys)
    behind = None if background is None else tuple(background)
    moving = None if instances is None else instances.kind
    return Call(camera, named, views.shape, tuple(outputs), behind, visible, moving)


@dataclass(eq=False)
class _Seen:
    """A kind of call that has come before, and how to draw the next without its preparations.

    Attributes:
        drawer: drew it.
        sets: the visible sets that it is drawn from, in the versions that they had.
        replay: None until it comes again.
    """

    drawer: Drawer
    sets: list[tuple[VisibleSets, int]]
    replay: Replay | None = None

    def holds(self, drawer: Drawer) -> bool:
        """Whether a drawer can draw it as it was recorded."""
        return (
            self.replay is not None
            and self.replay.alive
            and self.drawer is drawer
            and all(sets.version == version for sets, version in self.sets)
        )


class RecordedCalls:
    """The kinds of calls that came last.

    Args:
        options: image formation of all of them.
    """

    def __init__(self, options: RenderOptions) -> None:
        self._options = options
        self._seen: OrderedDict[Call, _Seen] = OrderedDict()  # last used last

    def draw(
        self,
        call: Call,
        drawer: Drawer,
        views: NDArray[np.floating],
        instances: Instances | None = None,
    ) -> PicturesDevice | None:
        """Draw as a call like it was drawn; None where none was, or it cannot be done so.

        Raises:
            DeviceError: the device is lost.
        """
        seen = self._seen.get(call)
        if seen is None or drawer.on_stage is not None or not seen.holds(drawer):
            return None
        assert seen.replay is not None
        options = self._options
        try:
            count = 1 if views.ndim == 2 else len(views)
            pictures = drawer.pictures(call.camera, count, call.outputs, options.rgb_float)
            colour = options.background if call.background is None else call.background
            behind = np.array(colour, np.float32)
            moving: tuple[Any, ...] = ()
            if instances is not None:
                free = instances.table is not None
                moving = (instances.poses, instances.gains, instances.chosen if free else None)
            if seen.replay.draw(views, pictures, behind, *moving) is not None:
                self._seen.move_to_end(call)
                return pictures
        except (DeviceMemoryError, SetMissingError):
            pass
        except RenderError:
            return None  # the long way says what is wrong with a view, and the next may be right
        self._seen.pop(call, None)  # the long way makes room for it, or brings its sets
        return None

    def note(self, call: Call, drawer: Drawer, record: Record, sets: Sequence[VisibleSets]) -> None:
        """A call was drawn from some visible sets; one that came before is recorded.

        Raises:
            DeviceError: the device is lost.
        """
        for other in self._seen.values():
            if not other.holds(drawer):
                other.replay = None  # nor must it keep sets that have given way
        versions = [(one, one.version) for one in sets]
        seen = self._seen.get(call)
        if seen is None:
            self._seen[call] = _Seen(drawer, versions)
            while len(self._seen) > CALLS:
                self._seen.popitem(last=False)
        elif seen.replay is None and drawer.on_stage is None:
            with suppress(DeviceMemoryError):
                seen.drawer, seen.replay, seen.sets = drawer, record(), versions
        self._seen.move_to_end(call)

    def forget(self) -> None:
        """Something that calls were prepared with has changed, or its memory is wanted."""
        self._seen.clear()
