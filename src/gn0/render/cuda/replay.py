"""A drawing call that was recorded: other poses and other pictures, all else as it was.

A call of few views is over on the device before the host has said all that it consists of. So a
call that comes again is recorded as one graph; then only poses and addresses of pictures go over.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.device.device import Device, DeviceArray, Graph
from gn0.errors import RenderError
from gn0.geometry import F32
from gn0.render.cuda.instances import WRONG_PART
from gn0.render.cuda.lists import Lists
from gn0.render.cuda.records import SentWords
from gn0.render.cuda.tables import NOWHERE, TARGET
from gn0.render.renderer import ALL_OUTPUTS, RenderResult

_NOT_HELD = 3
_WRONG = (  # with a view, as `views.cu` numbers it
    ("a view is not finite", ""),
    ("a view is not a rigid transform", "give a rotation and a translation, world to camera"),
    ("a view shows a scene that is not here", "give numbers of keys that are not None"),
)

_PART = 2**31  # top bit of such a word: of an instance; then three bits say what
_OFFSETS = 4

NO_ROOM = 2**64 - 1  # where a list has outgrown its own
_SILENCE = 0xFEFEFEFEFEFEFEFE  # where no word has come yet: never a word
_EAGER = 2e-4  # s that the host waits without sleeping
_NAP = 2e-5  # s
_DOUBT = 0.05  # s after which it asks whether the device is lost


class SetMissingError(RenderError):
    """A view on the device is to be drawn from a visible set that is not there."""


@dataclass(frozen=True, eq=False)
class PicturesDevice:
    """Pictures of V views on a device; a field is None when it was not asked for.

    Attributes:
        rgb: uint8 [V, H, W, 3], or float32 with `rgb_float`.
        depth: camera z of the expected surface [V, H, W] float32 m; +inf where alpha < 0.5.
        alpha: accumulated opacity [V, H, W] float32 in 0..1.
        semantic, instance: category and object numbers [V, H, W] uint32.
    """

    rgb: DeviceArray | None
    depth: DeviceArray | None
    alpha: DeviceArray | None
    semantic: DeviceArray | None = None
    instance: DeviceArray | None = None

    def numpy(self) -> RenderResult:
        """Copies in host memory."""
        held = (getattr(self, name) for name in ALL_OUTPUTS)
        return RenderResult(*(None if array is None else array.numpy() for array in held))


def build_target(pictures: PicturesDevice, background: F32) -> np.void:
    """Where pictures go, as kernels see it."""
    rgb, depth, alpha = pictures.rgb, pictures.depth, pictures.alpha
    target = np.zeros(1, TARGET)
    if rgb is not None:
        target["rgb_f32" if rgb.dtype == np.float32 else "rgb_u8"] = rgb.pointer
    target["depth"] = 0 if depth is None else depth.pointer
    target["alpha"] = 0 if alpha is None else alpha.pointer
    target["background"] = background
    found: np.void = target[0]
    return found


def raise_wrong(word: int) -> None:
    """Raise the error that the device told of, if any.

    Raises:
        SetMissingError: the visible set of a view is not there.
        RenderError: a view or an instance is not finite, not rigid, or of nothing that is here.
    """
    if word & NOWHERE == NOWHERE:
        return
    if word & _PART:
        number, why = (word & (_PART - 1)) >> 3, word & 7
        what, remedy = WRONG_PART[why]
        whose = f"{'view' if why == _OFFSETS else 'instance'} {number}"
        raise RenderError(what, where=whose, remedy=remedy)
    where = f"view {(word & NOWHERE) >> 2}"
    if word & 3 == _NOT_HELD:
        raise SetMissingError("its visible set is not on the device", where=where)
    what, remedy = _WRONG[word & 3]
    raise RenderError(what, where=where, remedy=remedy)


class Heard:
    """Words in pinned memory that the device writes while it works on.

    Args:
        device: writes.
    """

    def __init__(self, device: Device) -> None:
        self._device, self._said = device, device.pinned(4, np.uint64)
        place = self._said.ctypes.data
        self.words = DeviceArray(device, place, (4,), self._said.dtype, self._said)

    def hush(self) -> None:
        """Forget the last words; only when nothing is under way that writes others."""
        self._said[:] = _SILENCE

    def wait(self) -> tuple[int, int, int, int]:
        """What the lists are, and a view that is none (see `raise_wrong`).

        Returns:
            Entries that all lists need room for (`NO_ROOM`: one has outgrown its own), those of
            the longest, the view, and the entries that there are.

        Raises:
            DeviceError: the device is lost.
        """
        said, begin, asked = self._said, time.perf_counter(), 0.0
        while True:
            needed, longest, wrong, entries = said.tolist()
            if _SILENCE not in (needed, longest, wrong, entries):
                return needed, longest, wrong, entries
            waited = time.perf_counter() - begin
            time.sleep(0.0 if waited < _EAGER else _NAP)
            if waited > asked + _DOUBT:  # a device that is lost never says a word
                asked = waited
                self._device.event().done  # noqa: B018


class ReplayHeader:
    """What goes over for each call, and what comes back: a pinned block each.

    Args:
        device: draws.
        count: of views.
        instances: of all of them together.
        lit: whether instances have gains.
        free: whether each call says which clouds they are of.
    """

    def __init__(
        self,
        device: Device,
        count: int,
        instances: int = 0,
        *,
        lit: bool = False,
        free: bool = False,
    ) -> None:
        behind = TARGET.itemsize + count * 128
        gains = behind + instances * 128
        clouds = gains + instances * 48 * lit
        size = clouds + instances * 4 * free
        block = device.pinned(size, np.uint8)
        self.heard = Heard(device)
        self.target = device.empty(TARGET.itemsize // 4, np.uint32)
        self.poses = DeviceArray(
            *(device, block.ctypes.data + TARGET.itemsize, (count, 4, 4), np.dtype(np.float64)),
            block,
        )
        words = DeviceArray(
            device, block.ctypes.data, (len(self.target),), np.dtype(np.uint32), block
        )
        self.sent = SentWords(words, self.target, np.uint32(len(self.target)))
        self._places = block[:32].view(np.uint64)
        self._background = block[32:44].view(np.float32)
        self._poses = block[TARGET.itemsize : behind].view(np.float64).reshape(count, 4, 4)
        self._part_poses = block[behind:gains].view(np.float64).reshape(instances, 4, 4)
        self._gains = block[gains:clouds].view(np.float32).reshape(-1, 4, 3)
        self._chosen = block[clouds:].view(np.int32)
        self.part_poses, self.gains, self.chosen = (
            DeviceArray(device, array.ctypes.data, array.shape, array.dtype, block)
            for array in (self._part_poses, self._gains, self._chosen)
        )

    def write(
        self,
        poses: NDArray[np.floating],
        pictures: PicturesDevice,
        background: F32,
        part_poses: NDArray[np.floating] | None = None,
        gains: F32 | None = None,
        chosen: NDArray[np.int32] | None = None,
    ) -> None:
        """Say what is to be drawn; only when the words of the call before have come."""
        rgb, depth, alpha = pictures.rgb, pictures.depth, pictures.alpha
        as_float = rgb is not None and rgb.dtype == np.float32
        place = 0 if rgb is None else rgb.pointer
        self._places[:] = (
            *((0, place) if as_float else (place, 0)),
            0 if depth is None else depth.pointer,
            0 if alpha is None else alpha.pointer,
        )
        self._background[:] = background
        self._poses[:] = poses
        if part_poses is not None:
            self._part_poses[:] = part_poses
        if gains is not None:
            self._gains[:] = gains
        if chosen is not None:
            self._chosen[:] = chosen
        self.heard.hush()


class Replay:
    """A recorded call; see `Drawer.record`.

    Args:
        header: what goes over and comes back.
        graph: does all the rest.
        lists: with what room.
        held: what else the graph's work uses.
    """

    def __init__(self, header: ReplayHeader, graph: Graph, lists: Lists, held: Any) -> None:
        self._header = header
        self._graph: Graph | None = graph
        self._lists: Lists | None = lists
        self._held = held

    @property
    def alive(self) -> bool:
        """Whether what it was recorded with is still there."""
        return self._graph is not None

    def drop(self) -> None:
        """Let go of everything."""
        self._graph = self._lists = self._held = None

    def draw(
        self,
        poses: NDArray[np.floating],
        pictures: PicturesDevice,
        background: F32,
        part_poses: NDArray[np.floating] | None = None,
        gains: F32 | None = None,
        chosen: NDArray[np.int32] | None = None,
    ) -> int | None:
        """Draw as many views as were recorded; the pictures may still be under way.

        Args:
            poses: world-to-camera [V, 4, 4].
            pictures: what to fill.
            background: float32 [3].
            part_poses: part-to-world [I, 4, 4] of as many instances as were recorded.
            gains: theirs, float32 [I, 4, 3], if they had some.
            chosen: slots of their clouds, int32 [I], where they are of a table.

        Returns:
            Entries of the lists; None when they had no room, and nothing was drawn.

        Raises:
            RenderError: a view is not finite or not rigid.
            SetMissingError: the visible set of one is not here.
            DeviceError: the device is lost.
        """
        assert self._graph is not None and self._lists is not None
        self._header.write(poses, pictures, background, part_poses, gains, chosen)
        lists = self._lists
        try:
            self._graph.launch()
            needed, longest, wrong, entries = self._header.heard.wait()
        except BaseException:
            self.drop()  # it may still be at work with what the next call would write over
            raise
        raise_wrong(wrong)
        return entries if lists.holds(needed, longest) else None
